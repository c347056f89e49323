# SPDX-License-Identifier: Apache-2.0
"""The packaging: what is pinned, what is declared, and that commands and launch files fit together."""

import ast
import functools
import os
import re
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

import rosette_ros
from rosette_ros import requirements
from rosette_ros.cell.supervisor import MODULES, Cell
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.log_run import BALL_CENTRE, PROBE_TARGET, TF_MESSAGE
from rosette_ros.io.type_definitions import StoredTypes, TypeLibrary
from rosette_ros.nodes import names

BASE_PYTHON = sys._base_executable
ROOT = Path(__file__).resolve().parents[1]
LAUNCH = '''
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

service, source = LaunchService(), PythonLaunchDescriptionSource(sys.argv[1])
service.include_launch_description(LaunchDescription([
    IncludeLaunchDescription(source, launch_arguments=[('log_dir', sys.argv[2])])]))
sys.exit(service.run())
'''
CELL_LAUNCH = ROOT / 'launch' / 'cell.launch.py'
LOCK = ROOT / 'requirements' / 'requirements.lock'

ROSDEP_KEYS = {
    'jinja2': 'python3-jinja2',
    'lxml': 'python3-lxml',
    'lz4': 'mcap-ros2-support',
    'markupsafe': 'python3-jinja2',
    'matplotlib': 'python3-matplotlib',
    'mcap': 'mcap-ros2-support',
    'mcap_ros2': 'mcap-ros2-support',
    'numpy': 'python3-numpy',
    'pydantic': 'python3-pydantic',
    'pydantic_core': 'python3-pydantic',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'yaml': 'python3-yaml',
    'zstandard': 'mcap-ros2-support',
}
"""Imported module to rosdep key; ROS packages are their own keys."""
WITHOUT_KEY = {
    'dask', 'distributed', 'duckdb', 'fsspec', 'nicegui', 'plotly', 'pyarrow', 'pypdf', 'reportlab', 'starlette'}
"""Imported modules that rosdep does not know; docs/commands.md says how they are installed."""
SCRIPT = re.compile(r"'(\w+) = ([\w.]+):(\w+)'")


def manifest(path):
    """Return the root of a package.xml."""
    return ElementTree.parse(ROOT / path).getroot()


def declared(root, *tags):
    """Return what a package.xml declares under some tags."""
    return {element.text for tag in tags for element in root.iter(tag)}


@functools.cache
def imported(*folders):
    """Return the top-level modules that the Python files below some folders import, without Python's own."""
    names = set()
    for path in (path for folder in folders for path in (ROOT / folder).rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module.partition('.')[0])
    return names - set(sys.stdlib_module_names) - {'rosette_ros'}


def scripts():
    """Return the commands of setup.py: name to (module, function)."""
    return {name: (module, function) for name, module, function in SCRIPT.findall((ROOT / 'setup.py').read_text())}


def test_lock_pins_every_package_by_version_and_hash():
    """Each entry of the lock is name==version, with markers at most, and has a hash."""
    entries = re.split(r'^(?=\S)', LOCK.read_text(), flags=re.MULTILINE)[1:]
    assert len(entries) > 100
    for entry in entries:
        assert re.match(r'[a-z0-9-]+(\[[a-z0-9,-]+\])?==[\w.!+-]+( ; [^\\]+)? \\\n', entry), entry.splitlines()[0]
        assert '--hash=sha256:' in entry


def test_lock_pins_one_version_for_every_python():
    """No package has a second version for another Python."""
    names = re.findall(r'^([a-z0-9-]+)(?:\[.*?\])?==', LOCK.read_text(), flags=re.MULTILINE)
    assert [name for name in names if names.count(name) > 1] == []


def test_lock_covers_the_requirements():
    """What requirements.in names is in the lock."""
    locked = set(re.findall(r'^([a-z0-9-]+)', LOCK.read_text(), flags=re.MULTILINE))
    wanted = re.findall(r'^([\w-]+)', (ROOT / 'requirements' / 'requirements.in').read_text(), flags=re.MULTILINE)
    wanted += [name_of(one) for one in (*requirements.BASE, *requirements.every_extra()['all'])]
    assert {name.replace('_', '-') for name in wanted} - locked == set()


@pytest.mark.parametrize('name', ['requirements.in', 'requirements.lock'])
def test_requirements_name_no_host_and_no_path(name):
    """Packages come from wherever this machine's pip gets them."""
    text = (ROOT / 'requirements' / name).read_text()
    assert '://' not in text
    assert not re.search(r'^\s*(-i|-f|--(extra-)?index-url|--find-links|--trusted-host)\b', text, re.MULTILINE)
    assert not re.search(r'(^|\s|@|=)(\.{0,2}/|file:)', re.sub(r'^#.*', '', text, flags=re.MULTILINE))


@pytest.mark.parametrize('path, build_type', [
    ('package.xml', 'ament_python'), ('msg_defs/package.xml', 'ament_cmake')])
def test_package_xml(path, build_type):
    """Both manifests are format 3, alike in version and license, with a maintainer that can be written to."""
    root = manifest(path)
    assert root.get('format') == '3'
    assert declared(root, 'version') == {rosette_ros.__version__}
    assert declared(root, 'license') == {'Apache-2.0'}
    assert re.fullmatch(r'[\w.-]+@[\w-]+(\.[\w-]+)+', root.find('maintainer').get('email'))
    assert declared(root, 'build_type') == {build_type}


def test_setup_py_has_the_same_version():
    """setup.py repeats the version, because colcon reads it without importing the package."""
    assert f"version='{rosette_ros.__version__}'" in (ROOT / 'setup.py').read_text()


def test_package_xml_declares_what_is_imported_and_nothing_else():
    """Every module that the package and its launch file import has its rosdep key in package.xml."""
    needed = {ROSDEP_KEYS.get(name, name) for name in imported('rosette_ros', 'launch') - WITHOUT_KEY}
    assert declared(manifest('package.xml'), 'depend', 'exec_depend') == needed


def name_of(requirement):
    """Return the name of a package without version and marker."""
    return re.match(r'[\w-]+', requirement)[0]


def test_pip_installs_what_is_imported():
    """Every module outside ROS 2 is of the base, or of the extra whose folder it is in alone."""
    ros = declared(manifest('package.xml'), 'exec_depend') - {*ROSDEP_KEYS.values()}
    needed = {requirements.PACKAGES.get(name, name) for name in imported('rosette_ros')} - ros
    every = {name_of(one) for one in (*requirements.BASE, *requirements.every_extra()['all'])}
    assert needed - every == set()
    assert {name_of(one) for one in requirements.BASE} <= needed


def test_what_is_missing_is_named_as_it_is_installed():
    """The package of every imported module is the one that has it here, or that needs the one that has it."""
    assert requirements.install_command('mcap_ros2') == 'pip install mcap-ros2-support'
    assert requirements.install_command('starlette') == requirements.install_command('nicegui')
    found = metadata.packages_distributions()
    for module in imported('rosette_ros') & {*requirements.BASE, *requirements.PACKAGES}:
        package = requirements.PACKAGES.get(module, module)
        needed = map(name_of, metadata.requires(package) or ())
        has_it = {name.casefold().replace('_', '-') for name in found[module]}
        assert has_it & {name.casefold().replace('_', '-') for name in (package, *needed)}, module


def test_pages_name_the_extras():
    """docs/commands.md, and what rosdep does not know of each."""
    page = (ROOT / 'docs' / 'commands.md').read_text(encoding='utf-8')
    assert set(re.findall(r'^\| (\w+) \| pip install', page, re.MULTILINE)) == {*requirements.EXTRAS}
    for packages in requirements.EXTRAS.values():
        assert f'| {requirements.install_command(packages[0])} |' in page


def test_types_of_imported_tables_are_those_of_the_messages():
    """`make docs` writes them."""
    library, stored = TypeLibrary.from_environment(os.environ), StoredTypes()
    for name in (PROBE_TARGET, BALL_CENTRE, TF_MESSAGE):
        assert stored.definition(name) == library.definition(name)


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_a_wheel_works_in_an_empty_environment(tmp_path):
    """Pure Python, below 400 MB with what it needs, and every verb that needs no nodes; those that do say it."""
    python = tmp_path / 'env' / 'bin' / 'python'
    plain = {name: value for name, value in os.environ.items() if not re.match('AMENT|PYTHON|ROS', name)}

    def run(*words):
        return subprocess.run([*map(str, words)], cwd=tmp_path, env=plain, text=True, capture_output=True, check=False)

    source = tmp_path / 'source'
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns('.*', 'build', 'test', 'benchmarks', '*.egg-info'))
    uv = Path(sys.executable).with_name('uv')
    for step in ([uv, 'venv', '--python', BASE_PYTHON, 'env'],
                 [uv, 'build', '--wheel', '--out-dir', 'wheels', source],
                 [uv, 'pip', 'install', '--python', python, 'wheels/rosette_ros-0.1.0-py3-none-any.whl']):
        done = run(*step)
        if done.returncode and 'error sending request' in done.stderr:
            pytest.skip('no package index can be reached')
        assert done.returncode == 0, done.stderr
    size = sum(path.stat().st_size for path in (tmp_path / 'env').rglob('*') if path.is_file())
    assert size < 400e6
    measured = plan(8, 'interleaved', 1)
    centres = measured.centres(0.1825) + 1e-7 * np.random.default_rng(1).standard_normal((64, 3))
    run_of = Run(8, 0.1825, measured.table_position, measured.ball, centres, repeatability=1e-7)
    write_csv(run_of, tmp_path / 'table.csv')
    rosette = python.with_name('rosette')
    for words in ('evaluate table.csv', 'diagnose table.csv', 'compare table.csv', 'report table.csv',
                  'budget table.csv', 'plan --balls 8 --radius-mm 182.5 --order row', 'import table.csv -o log',
                  'evaluate log', 'correct log -o correction.yaml', 'info log', 'effects', 'demo --offline --balls 6'):
        done = run(rosette, *words.split())
        assert done.returncode == 0, (words, done.stderr)
    for words, need in (('certificate table.csv', 'pip install lxml pypdf reportlab'),
                        ('studio', 'pip install nicegui plotly'), ('archive --help', 'pip install dask'),
                        ('demo', 'this needs ROS 2'), ('calibrate', 'this needs ROS 2'), ('cell', 'this needs ROS 2')):
        done = run(rosette, *words.split())
        assert done.returncode == 2 and done.stderr.count('\n') == 1 and need in done.stderr, (words, done.stderr)


def test_messages_declare_what_they_contain():
    """Packages that the definitions name are dependencies of rosette_msgs."""
    named = {name for path in (ROOT / 'msg_defs').glob('*/*.*')
             for name in re.findall(r'^(\w+)/\w+', path.read_text(), flags=re.MULTILINE)}
    assert declared(manifest('msg_defs/package.xml'), 'depend') == named


def test_commands_exist():
    """Every command of setup.py is a function in a file of the package."""
    commands = scripts()
    assert set(commands) == {'rosette', 'sequencer', 'simulated_cmm', 'dme_cmm', 'cmm', 'evaluator', 'recorder',
                             'table_corrector'}
    for module, function in commands.values():
        tree = ast.parse(ROOT.joinpath(*module.split('.')).with_suffix('.py').read_text(encoding='utf-8'))
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        names |= {target.id for node in tree.body if isinstance(node, ast.Assign) for target in node.targets
                  if isinstance(target, ast.Name)}
        assert function in names, module


def test_launch_file_starts_the_cell_of_the_command():
    """The same nodes under the same names in the same order, with the same parameters, as `rosette cell`."""
    tree = ast.parse(CELL_LAUNCH.read_text())
    calls = [[one.value for one in call.args] for call in ast.walk(tree)
             if isinstance(call, ast.Call) and ast.unparse(call.func) == 'node']
    started = {(name, scripts()[command][0]): {*arguments} for command, name, *arguments in calls}
    wanted = {}
    for cell in (Cell(dme='cmm.yaml'), Cell(machine='machine.yaml')):
        wanted |= {(name, cell._modules[name]): {one for one, value in given.items() if value is not False}
                   for name, given in cell._params.items()}
    assert started == wanted
    assert list(dict.fromkeys(name for name, _ in started)) == list(MODULES)
    declared = {call.args[0].value for call in ast.walk(tree)
                if isinstance(call, ast.Call) and ast.unparse(call.func) == 'DeclareLaunchArgument'}
    assert set().union(*started.values()) <= declared


@pytest.mark.long
def test_launch_file_runs(tmp_path, domain_id):
    """Where `launch` and the built package are found: the cell is complete, and ends with the launch."""
    pytest.importorskip('launch_ros', exc_type=ImportError)
    try:
        get_package_share_directory('rosette_ros')
    except PackageNotFoundError:
        pytest.skip('the package is not built here')
    with subprocess.Popen(
            [sys.executable, '-c', LAUNCH, CELL_LAUNCH, tmp_path], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}) as running:
        try:
            assert any(names.COMPLETE in line for line in running.stdout)
            running.send_signal(signal.SIGINT)
            assert running.wait(60) == 0
        finally:
            running.kill()


def test_launch_file_of_the_corrector_starts_a_command_that_exists():
    """With an argument for each parameter of the node, whatever they are."""
    text = (ROOT / 'launch' / 'table_corrector.launch.py').read_text()
    assert names.TABLE_CORRECTOR in scripts() and 'executable=names.TABLE_CORRECTOR' in text
    assert text.count('for one in WANTED') == 2
