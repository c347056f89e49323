# SPDX-License-Identifier: Apache-2.0
"""The packaging: what is pinned, what is declared, and that commands and launch files fit together."""

import ast
import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

import rosette_ros
from rosette_ros.cell.supervisor import MODULES, Cell
from rosette_ros.nodes import names

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
ARCHIVE = 'distributed duckdb fsspec pyarrow'
WITHOUT_KEY = {'nicegui': 'nicegui', 'starlette': 'nicegui', 'reportlab': 'reportlab pypdf', 'pypdf': 'reportlab pypdf',
               **dict.fromkeys(('dask', 'distributed', 'duckdb', 'fsspec', 'pyarrow'), ARCHIVE)}
"""Imported modules that rosdep does not know, and what installs them; docs/commands.md says how."""

SCRIPT = re.compile(r"'(\w+) = ([\w.]+):(\w+)'")


def manifest(path):
    """Return the root of a package.xml."""
    return ElementTree.parse(ROOT / path).getroot()


def declared(root, *tags):
    """Return what a package.xml declares under some tags."""
    return {element.text for tag in tags for element in root.iter(tag)}


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
    needed = {ROSDEP_KEYS.get(name, name) for name in imported('rosette_ros', 'launch') - set(WITHOUT_KEY)}
    assert all(f'pip install {name}' in (ROOT / 'docs/commands.md').read_text() for name in WITHOUT_KEY.values())
    assert declared(manifest('package.xml'), 'depend', 'exec_depend') == needed


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
