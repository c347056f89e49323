# SPDX-License-Identifier: Apache-2.0
"""The set-up and the packaging: what is pinned, declared and done, and what is said where it cannot be done."""

import ast
import importlib.util
import os
import re
import resource
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

import rosette_ros
from rosette_ros.nodes import names

ROOT = Path(__file__).resolve().parents[1]
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
"""Imported modules that rosdep does not know, and what installs them; the README says how."""

SCRIPT = re.compile(r"'(\w+) = ([\w.]+):(\w+)'")


def load(name):
    """Import a file of tools/, which is no package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / 'tools' / f'{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def setup_venv():
    """The set-up as a module."""
    return load('setup_venv')


@pytest.fixture
def clone(setup_venv, monkeypatch, tmp_path):
    """The set-up in a small clone whose steps write down that they were done and do nothing else."""
    for name, text in {
        'msg_defs/msg/A.msg': 'float64 a\n', 'tools/tf2_msgs/package.xml': '', 'requirements/requirements.lock': '',
        'tools/venv_hook.py': '', 'tools/idl_cache.py': '', 'tools/byte_code.py': '', 'package.xml': '',
        'setup.cfg': '', 'setup.py': '',
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    venv = tmp_path / '.venv'
    state = venv / 'rosette'
    for name, value in {
        'ROOT': tmp_path, 'VENV': venv, 'STATE': state, 'LOCK': tmp_path / 'requirements/requirements.lock',
        'HOOK': tmp_path / 'tools/venv_hook.py', 'IDL_CACHE': tmp_path / 'tools/idl_cache.py',
        'BYTE_CODE': tmp_path / 'tools/byte_code.py',
        'INTERFACES': (tmp_path / 'msg_defs', tmp_path / 'tools/tf2_msgs'), 'check_machine': lambda: None,
    }.items():
        monkeypatch.setattr(setup_venv, name, value)
    done = []
    monkeypatch.setattr(setup_venv, 'install_packages',
                        lambda: (state.mkdir(parents=True, exist_ok=True), done.append('packages')))
    monkeypatch.setattr(setup_venv, 'build_messages', lambda: done.append('messages'))
    monkeypatch.setattr(setup_venv, 'install_package', lambda: done.append('package'))
    monkeypatch.setattr(setup_venv, 'compile_imports', lambda: done.append('byte code'))
    setup_venv.done = done
    return setup_venv


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


# What is pinned and declared


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
    assert all(f'pip install {name}' in (ROOT / 'README.md').read_text() for name in WITHOUT_KEY.values())
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
                             'table_corrector', 'trend_monitor'}
    for module, function in commands.values():
        tree = ast.parse(ROOT.joinpath(*module.split('.')).with_suffix('.py').read_text(encoding='utf-8'))
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        names |= {target.id for node in tree.body if isinstance(node, ast.Assign) for target in node.targets
                  if isinstance(target, ast.Name)}
        assert function in names, module


def test_launch_file_starts_commands_that_exist():
    """The executables that the launch file names are commands of setup.py, each node under its own name."""
    tree = ast.parse((ROOT / 'launch' / 'cell.launch.py').read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == 'node']
    started = {(call.args[1].value, call.args[0].value) for call in calls}
    assert started == {('recorder', 'recorder'), ('evaluator', 'evaluator'), ('sequencer', 'sequencer'),
                       ('cmm', 'simulated_cmm'), ('cmm', 'dme_cmm'), ('trend_monitor', 'trend_monitor')}
    assert {command for _, command in started} <= set(scripts())


def test_launch_file_of_the_corrector_starts_a_command_that_exists():
    """With an argument for each parameter of the node, whatever they are."""
    text = (ROOT / 'launch' / 'table_corrector.launch.py').read_text()
    assert names.TABLE_CORRECTOR in scripts() and 'executable=names.TABLE_CORRECTOR' in text
    assert text.count('for one in WANTED') == 2


# What the set-up does


@pytest.mark.skipif(Path(sys.prefix) != ROOT / '.venv', reason='runs in another environment than .venv')
def test_second_setup_does_nothing(setup_venv):
    """Nothing is pending after a set-up, and another one says nothing and takes under a second of computing."""
    assert [title for title, *_ in setup_venv.pending()] == [], 'run `make setup` first'
    began = computing()
    outcome = subprocess.run([ROOT / 'tools' / 'setup.sh'], capture_output=True, text=True, check=True)
    assert outcome.stdout + outcome.stderr == ''
    assert computing() - began < 1.0


def computing():
    """Return the CPU time that processes started here have used, s: it does not depend on what else runs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_steps_are_done_once(clone):
    """The first set-up does all steps, the second none."""
    clone.set_up()
    assert clone.done == ['packages', 'messages', 'package', 'byte code']
    clone.set_up()
    assert clone.done == ['packages', 'messages', 'package', 'byte code']


@pytest.mark.parametrize('name, again', [
    ('requirements/requirements.lock', ['packages', 'messages', 'package', 'byte code']),
    ('msg_defs/msg/A.msg', ['messages', 'byte code']),
    ('msg_defs/msg/B.msg', ['messages', 'byte code']),
    ('setup.py', ['package', 'byte code']),
])
def test_what_changed_is_done_again(clone, name, again):
    """A changed or new file brings back the steps that depend on it, and only those."""
    clone.set_up()
    clone.done.clear()
    (clone.ROOT / name).write_text('float64 b\n')
    clone.set_up()
    assert clone.done == again


def test_touched_files_change_nothing(clone):
    """The content counts, not the time."""
    clone.set_up()
    clone.done.clear()
    os.utime(clone.ROOT / 'msg_defs/msg/A.msg', (1, 1))
    clone.set_up()
    assert clone.done == []


def test_interrupted_step_is_done_again(clone, monkeypatch):
    """What was not finished is not taken for done."""
    def interrupted():
        raise KeyboardInterrupt

    clone.set_up()
    clone.done.clear()
    (clone.ROOT / 'msg_defs/msg/A.msg').write_text('float64 b\n')
    with monkeypatch.context() as patch:
        patch.setattr(clone, 'build_messages', interrupted)
        assert clone.main([]) == 130
    (clone.ROOT / 'msg_defs/msg/A.msg').write_text('float64 a\n')
    clone.set_up()
    assert clone.done == ['messages']


def test_moved_clone_is_set_up_again(clone, monkeypatch, tmp_path):
    """An environment knows where it is, so another place makes it invalid."""
    clone.set_up()
    assert clone.pending() == []
    moved = tmp_path.with_name(f'{tmp_path.name}_moved')
    tmp_path.rename(moved)
    for name in ('ROOT', 'VENV', 'STATE', 'LOCK', 'HOOK', 'IDL_CACHE', 'BYTE_CODE'):
        monkeypatch.setattr(clone, name, moved / getattr(clone, name).relative_to(tmp_path))
    monkeypatch.setattr(clone, 'INTERFACES', (moved / 'msg_defs', moved / 'tools/tf2_msgs'))
    assert [stamp.name for _, stamp, *_ in clone.pending()] == ['packages', 'messages', 'package', 'byte_code']


def test_foreign_environment_is_kept(setup_venv, monkeypatch, tmp_path):
    """A .venv that the set-up did not make is not removed."""
    monkeypatch.setattr(setup_venv, 'VENV', tmp_path)
    monkeypatch.setattr(setup_venv, 'STATE', tmp_path / 'rosette')
    (tmp_path / 'mine').mkdir()
    with pytest.raises(setup_venv.SetupError, match=r'a \.venv that was not made by `make setup`; move it away'):
        setup_venv.install_packages()
    assert [path.name for path in tmp_path.iterdir()] == ['mine']


def test_messages_that_are_no_more_are_removed(clone, tmp_path):
    """What the last build installed and this one did not goes; the rest stays."""
    clone.STATE.mkdir(parents=True)
    kept, gone = tmp_path / 'kept.py', tmp_path / 'gone.py'
    for path in (kept, gone):
        path.touch()
    clone.remove_stale({str(kept), str(gone)})
    assert kept.exists() and gone.exists()
    clone.remove_stale({str(kept)})
    assert kept.exists() and not gone.exists()


def test_installers_are_taken_from_the_lock(setup_venv):
    """The packages that install the others come with their hashes."""
    entries = setup_venv.locked(setup_venv.INSTALLERS)
    assert re.findall(r'^(\S+)==', entries, flags=re.MULTILINE) == ['setuptools', 'uv']
    assert entries.count('--hash=sha256:') > 2


# What is said where it cannot be done


def test_missing_things_are_named_in_one_line(setup_venv, monkeypatch, capsys, tmp_path):
    """One line says what is missing and what to install."""
    monkeypatch.setattr(setup_venv, 'has_installer', lambda: False)
    monkeypatch.setattr(setup_venv.sysconfig, 'get_path', lambda name: str(tmp_path))
    monkeypatch.setattr(setup_venv.shutil, 'which', lambda name: None)
    monkeypatch.setattr(setup_venv, 'BASE_PYTHON', Path('/usr/local/bin/python3'))
    monkeypatch.setattr(setup_venv, 'VERSION', '3.12')
    monkeypatch.delenv('CC', raising=False)
    monkeypatch.setenv('CXX', 'c++-99 -fancy')
    monkeypatch.setattr(setup_venv, 'pending', lambda: [('packages', None, '', None)])
    assert setup_venv.main([]) == 2
    assert capsys.readouterr().err == (
        "setup: missing: Python 3.12's ensurepip, Python 3.12's headers, a compiler (cc or gcc or clang), a compiler "
        '(c++-99). Install with: apt install python3.12-venv python3.12-dev gcc g++\n')


def test_other_machines_are_refused(setup_venv, monkeypatch):
    """Where no packages exist, the message says which way is left."""
    monkeypatch.setattr(setup_venv.platform, 'machine', lambda: 'aarch64')
    with pytest.raises(setup_venv.SetupError, match=r'Linux on x86-64 .* this is linux on aarch64; use a ROS 2 Jazzy'):
        setup_venv.check_machine()


def test_failed_program_shows_the_end_of_its_output(setup_venv, monkeypatch, tmp_path):
    """The message holds what the program said last, and where the rest is."""
    monkeypatch.setattr(setup_venv, 'LOG', tmp_path / 'setup.log')
    monkeypatch.setattr(setup_venv, 'ROOT', tmp_path)
    with pytest.raises(setup_venv.SetupError, match=r'sh failed; all of its output is in setup\.log, its end:\nalas'):
        setup_venv.run(['sh', '-c', 'echo alas >&2; exit 3'])


@pytest.mark.parametrize('version, code', [('3.10.12', 2), ('3.14.0', 2)])
def test_python_without_packages_is_refused(tmp_path, version, code):
    """PYTHON=... of another version is refused in one line."""
    python = tmp_path / 'python'
    python.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo "Python {version}" && exit 0\nexit 1\n')
    python.chmod(0o755)
    outcome = subprocess.run([ROOT / 'tools' / 'setup.sh'], env=os.environ | {'PYTHON': str(python)},
                             capture_output=True, text=True, check=False)
    assert outcome.returncode == code
    assert outcome.stderr == f'setup: PYTHON={python} is Python {version}; 3.11, 3.12 or 3.13 is needed.\n'


@pytest.fixture
def script(tmp_path):
    """A copy of setup.sh with nothing beside it, and in `bin` what it needs of other programs."""
    for folder in ('tools', 'bin'):
        (tmp_path / folder).mkdir()
    (tmp_path / 'bin' / 'dirname').symlink_to('/usr/bin/dirname')
    copy = tmp_path / 'tools' / 'setup.sh'
    copy.write_text((ROOT / 'tools' / 'setup.sh').read_text())
    return copy


DISTRIBUTION = Path('/usr/bin/python3')


@pytest.mark.skipif(not DISTRIBUTION.exists() or re.search(r'python3\.1[123]$', str(DISTRIBUTION.resolve())) is None,
                    reason='/usr/bin/python3 is not 3.11, 3.12 or 3.13')
@pytest.mark.parametrize('missing, chosen', [('', str(DISTRIBUTION)), ('python3-dev', 'bin/python3')])
def test_the_distributions_python_comes_first_if_it_can(script, missing, chosen):
    """Where it lacks nothing; otherwise the first on PATH makes .venv."""
    (script.parent / 'setup_venv.py').write_text(
        f'import sys\nprint({missing!r} if sys.argv[1:] == ["missing"] else sys.executable)\n')
    programs = script.parents[1] / 'bin'
    (programs / 'python3').symlink_to(sys.executable)
    outcome = subprocess.run(['/bin/sh', script], env={'PATH': str(programs)}, capture_output=True, text=True,
                             check=True)
    assert outcome.stdout.strip() == str(script.parents[1] / chosen) and outcome.stderr == ''


def test_no_python_at_all(script):
    """Without any Python that fits, one line says what to install."""
    programs = script.parents[1] / 'bin'
    outcome = subprocess.run(['/bin/sh', script], env={'PATH': str(programs)}, capture_output=True, text=True,
                             check=False)
    assert outcome.returncode == 2
    [line] = outcome.stderr.splitlines()
    assert line.startswith('setup: Python 3.11, 3.12 or 3.13 is needed, found: ')
    assert 'apt install python3 python3-venv python3-dev' in line


# What the environment's Python finds


def test_environment_finds_its_own_ros_only():
    """Paths of a sourced ROS 2 and of another .venv go, all others stay behind the own ones."""
    given = {
        'AMENT_PREFIX_PATH': '/home/me/ws/install:/opt/ros/jazzy',
        'LD_LIBRARY_PATH': '/opt/ros/jazzy/lib:/usr/local/cuda/lib:/old/.venv/lib',
        'PYTHONPATH': '/home/me/ws/install/lib/python3.12/site-packages:/opt/ros/jazzy/lib/python3.12/site-packages',
        'ROSETTE_VENV': '/old/.venv',
        'HOME': '/home/me',
    }
    found = load('venv_hook').environment(given, '/new/.venv', ['/new/.venv/a.libs'])
    assert found['AMENT_PREFIX_PATH'] == '/new/.venv'
    assert found['LD_LIBRARY_PATH'] == '/new/.venv/lib:/new/.venv/a.libs:/usr/local/cuda/lib'
    assert 'PYTHONPATH' not in found
    assert found['ROSETTE_VENV'] == '/new/.venv'
    assert found['HOME'] == '/home/me'


def test_environment_keeps_a_python_path_that_is_no_ros():
    """A PYTHONPATH of the caller's own stays, also beside a folder whose name only begins like a ROS 2's."""
    given = {'AMENT_PREFIX_PATH': '/opt/ros/jazzy', 'PYTHONPATH': '/my/modules:/opt/ros/jazzy/lib:/opt/ros/jazzy2/lib'}
    found = load('venv_hook').environment(given, '/new/.venv', [])
    assert found['PYTHONPATH'] == '/my/modules:/opt/ros/jazzy2/lib'


def test_environment_keeps_a_workspace_on_top_of_it():
    """What colcon built with this environment, and was sourced, is found first."""
    given = {'AMENT_PREFIX_PATH': '/my/install:/new/.venv', 'PYTHONPATH': '/my/install/lib',
             'LD_LIBRARY_PATH': '/my/install/lib'}
    found = load('venv_hook').environment(given, '/new/.venv', [])
    assert found['AMENT_PREFIX_PATH'] == '/my/install:/new/.venv'
    assert found['PYTHONPATH'] == '/my/install/lib'
    assert found['LD_LIBRARY_PATH'] == '/my/install/lib:/new/.venv/lib'


@pytest.mark.skipif(Path(sys.prefix) != ROOT / '.venv', reason='runs in another environment than .venv')
def test_python_needs_no_sourcing():
    """A bare environment, and one with a foreign ROS 2 in it, both find the messages and their package."""
    code = ('from ament_index_python import get_package_share_directory as share; import rosette_msgs.msg, '
            "tf2_msgs.msg, rclpy; print(share('rosette_msgs'), share('rosette_ros'))")
    shares = f'{sys.prefix}/share/rosette_msgs {sys.prefix}/share/rosette_ros\n'
    for environment in ({}, {'AMENT_PREFIX_PATH': '/nowhere', 'PYTHONPATH': '/nowhere/lib', 'ROSETTE_VENV': '/other'}):
        outcome = subprocess.run([sys.executable, '-c', code], env=environment, capture_output=True, text=True,
                                 check=False)
        assert (outcome.stdout, outcome.stderr) == (shares, '')
