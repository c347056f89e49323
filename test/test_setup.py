# SPDX-License-Identifier: Apache-2.0
"""The set-up: what is done, what is said where it cannot be done, and what the environment's Python finds."""

import importlib.util
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]


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
        'tools/venv_hook.py': '', 'tools/byte_code.py': '', 'package.xml': '',
        'setup.cfg': '', 'setup.py': '',
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    venv = tmp_path / '.venv'
    state = venv / 'rosette'
    for name, value in {
        'ROOT': tmp_path, 'VENV': venv, 'STATE': state, 'LOCK': tmp_path / 'requirements/requirements.lock',
        'HOOK': tmp_path / 'tools/venv_hook.py',
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
    for name in ('ROOT', 'VENV', 'STATE', 'LOCK', 'HOOK', 'BYTE_CODE'):
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


def test_a_long_step_says_on_a_terminal_how_far_it_is(clone, monkeypatch, capsys):
    """How many of its steps Ninja has done, after every second; what was written is wiped out at the end."""
    log = clone.STATE / 'log' / 'latest_build' / 'rosette_msgs' / 'stdout.log'
    log.parent.mkdir(parents=True)
    log.write_text('-- Configuring done\n[1/202] one\n[45/202] other\n')
    monkeypatch.setattr(sys.stdout, 'isatty', lambda: True, raising=False)
    clone.wait_for(subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1.2)']))
    shown = capsys.readouterr().out
    assert shown.startswith(' 1 s, 45 of 202\b')
    assert shown.endswith(f'{" " * 15}{15 * chr(8)}')
