# SPDX-License-Identifier: Apache-2.0
"""What needs no nodes runs where only Python is: no modules and signals of POSIX; files named as Windows names them."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from test_layers import FILES, PACKAGE, ROS, WITHOUT_ROS, layer, module_of, nodes, tree_of

from rosette_ros.cli.main import main
from rosette_ros.core.run.scheme import plan
from rosette_ros.invocation import _quoted
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.text_file import path_of
from rosette_ros.simulation import Machine, MachineConfig

ONLINE = {'cli.cell', 'cli.demo_cell', 'cli.replay', 'studio.cell_watcher'}
"""Modules beside nodes/ and cell/ that need ROS 2, which is not for Windows here."""
BASE = ('asyncio', 'concurrent.futures', 'ctypes.util', 'importlib.metadata', 'jinja2',
        'matplotlib.backends.backend_agg', 'matplotlib.figure', 'mcap.reader', 'mcap_ros2.decoder', 'pydantic',
        'rich.progress', 'scipy.linalg', 'scipy.optimize', 'scipy.special', 'tempfile', 'uuid', 'yaml')
EXTRAS = ('dask', 'distributed', 'duckdb', 'fsspec', 'lxml.etree', 'multiprocessing.forkserver', 'nicegui',
          'plotly.graph_objects', 'pyarrow.parquet', 'pypdf', 'reportlab.graphics', 'reportlab.platypus')
"""Loaded before: what other packages ask for is theirs."""
PLAIN = f'''
import enum, importlib, os, signal, sys
for name in others:
    importlib.import_module(name)
for name in ('resource', 'fcntl', 'termios', 'tty', 'pty', 'pwd', 'grp', *{sorted(ROS)!r}):
    sys.modules[name] = None
for name in ('SIGHUP', 'SIGKILL', 'SIGUSR1', 'SIGUSR2', 'SIGCHLD', 'SIGALRM', 'SIGPIPE', 'pthread_sigmask', 'alarm',
             'siginterrupt', 'sigwait', 'setitimer'):
    delattr(signal, name)
signal.Signals = enum.IntEnum('Signals', {{name: signal.Signals[name] for name in ('SIGINT', 'SIGTERM', 'SIGABRT')}})
for name in ('O_NONBLOCK', 'O_DIRECTORY', 'O_CLOEXEC', 'O_NOFOLLOW', 'O_SYNC', 'fchmod', 'fork', 'getuid', 'geteuid',
             'getgid', 'killpg', 'mkfifo', 'chown', 'sched_getaffinity', 'set_blocking', 'statvfs', 'uname', 'pread',
             'pwrite', 'posix_fallocate', 'fdatasync', 'sync', 'setsid', 'nice'):
    delattr(os, name)
os.name = 'other'
'''


def in_plain_python(script, cwd, others=BASE):
    """Run a script in an interpreter without what only POSIX has; return it when it has ended."""
    words = [sys.executable, '-X', 'utf8', '-c', f'others = {others!r}{PLAIN}{script}']
    return subprocess.run(words, capture_output=True, text=True, cwd=cwd, check=False, timeout=300,
                          env={**os.environ, 'MATPLOTLIBRC': os.devnull})


@pytest.mark.long
def test_all_that_needs_no_nodes_is_imported(tmp_path):
    """Every module of the offline layers, of the studio and of the verbs."""
    modules = [module_of(path) for path in FILES if layer(path) in (*WITHOUT_ROS, 'studio', 'cli')]
    wanted = [name for name in modules if name.removeprefix('rosette_ros.') not in ONLINE]
    done = in_plain_python(f'for name in {wanted!r}: importlib.import_module(name)', tmp_path, BASE + EXTRAS)
    assert done.returncode == 0, done.stderr


NAME = r'D:\Läufe 2026\tisch (1).csv'
VERBS = (('evaluate', NAME, '--json'), ('evaluate', NAME), ('diagnose', NAME), ('compare', NAME), ('info', NAME),
         ('report', NAME, '-o', r'C:\aus gabe.html'), ('import', NAME, '-o', r'D:log'),
         ('plan', 'row:4', '--balls', '5', '--radius-mm', '182.5', '-o', r'C:\p.csv'),
         ('correct', NAME, '-o', r'C:\korrektur.yaml', '--force'),
         ('demo', '--offline', '--balls', '5', '--output', r'C:\runs'))


def test_verbs_work_with_names_of_windows(tmp_path, monkeypatch, capsys):
    """With a drive, backslashes, a blank and an umlaut; the JSON is that of this system."""
    config = MachineConfig().changed(plate={'balls': 5})
    write_csv(Machine(config).run(plan(5, 'row')), tmp_path / NAME)
    done = in_plain_python('from rosette_ros.cli.main import main\n'
                           f'for words in {VERBS!r}:\n'
                           '    if main(words): sys.exit(" ".join(words))\n', tmp_path)
    assert (done.returncode, done.stderr) == (0, '')
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    assert main([*VERBS[0]]) == 0
    assert done.stdout.partition('\n')[0] + '\n' == capsys.readouterr().out


def test_addresses_of_files_have_drives():
    """file:///C:/ is C:/, and ~ may stand before a backslash."""
    assert path_of('file:///C:/l%C3%A4ufe/a.csv') == 'C:/läufe/a.csv'
    assert path_of(r'C:\a.csv') == r'C:\a.csv'
    assert path_of('~') == str(Path.home())


def test_commands_are_quoted_as_their_shell_takes_them(monkeypatch):
    """That of Windows takes single quotes for letters."""
    assert _quoted(r'C:\a b.csv') == r"'C:\a b.csv'"
    monkeypatch.setattr(os, 'name', 'nt')
    assert [_quoted(one) for one in (r'C:\a b.csv', r'C:\a.csv')] == [r'"C:\a b.csv"', r'C:\a.csv']


def opened_without_encoding(tree):
    """Return the lines where text is read or written in the encoding of the system."""
    return [call.lineno for call in nodes(tree) if isinstance(call, ast.Call) and (
        (isinstance(call.func, ast.Attribute) and call.func.attr in ('read_text', 'write_text')
         and isinstance(call.func.value, ast.Name | ast.Call | ast.BinOp | ast.Attribute)
         and len(call.args) < (1 if call.func.attr == 'read_text' else 2)
         and not any(one.arg == 'encoding' for one in call.keywords))
        or (isinstance(call.func, ast.Name) and call.func.id == 'open'
            and not any(one.arg in ('encoding', 'opener') for one in call.keywords)
            and not (len(call.args) > 1 and isinstance(call.args[1], ast.Constant) and 'b' in call.args[1].value)))]


def test_text_has_its_encoding():
    """In the whole package: that of Windows is none that a log or a table has."""
    found = {path.relative_to(PACKAGE).as_posix(): lines for path in FILES
             if (lines := opened_without_encoding(tree_of(path)))}
    assert found == {}


@pytest.mark.parametrize(('text', 'found'), [
    ('open(a)', [1]), ('open(a, "rb")', []), ('open(a, encoding="utf-8")', []), ('a.read_text()', [1]),
    ('a.read_text("utf-8")', []), ('(a / b).write_text(x)', [1]), ('a.write_text(x, encoding="utf-8")', [])])
def test_the_rule_sees_what_is_wrong(text, found):
    """On texts that keep and break it."""
    assert opened_without_encoding(ast.parse(text)) == found
