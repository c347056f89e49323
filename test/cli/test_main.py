# SPDX-License-Identifier: Apache-2.0
"""The command itself: verbs, help, errors, exit codes."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest
from terminal import Terminal

from rosette_ros.cli import main as main_module
from rosette_ros.cli.console import console, doing, print_json
from rosette_ros.cli.main import GROUPS, VERBS, error_lines, main
from rosette_ros.invocation import __version__

SOURCE = 'this needs ROS 2: source the set-up file of ROS 2 and of the workspace'


@pytest.mark.parametrize('words, wanted', [
    (('evalute', 'run.csv'), "Unknown verb 'evalute'. Did you mean evaluate?"),
    (('xyz',), "Unknown verb 'xyz'. rosette --help lists them."),
    (('evaluate', 'run.csv', '--jsn'), "Unknown option '--jsn'. Did you mean --json?"),
    (('dme', 'check', '--jsn'), "Unknown option '--jsn'. Did you mean --json?"),
    (('archive', 'add', 'logs', '--into', 'arc', '--cell', 'a'),
     '--cell: expected an option of this verb, found one of another; the verb with --help lists its own'),
    (('effects', 'backlash'), "Unknown effect 'backlash'. Did you mean table_backlash?"),
    (('effects', 'table_motion'), "Unknown effect 'table_motion'. Did you mean table_motions?"),
    (('add', 'noise.tails', '--model', 'no.yaml'), "Unknown effect 'noise.tails'. Did you mean noise.tail?"),
    (('plan', 'interleave', '--balls', '12', '--radius-mm', '180'),
     "Unknown order 'interleave'. Did you mean interleaved?"),
    (('report', 'run.csv', '--format', 'gif'), "argument --format: Unknown value 'gif'. Known: svg, png.")])
def test_an_unknown_name_is_answered_by_the_nearest(refused, words, wanted):
    """Not by all that there are; an abbreviation is no option either."""
    line = refused(*words)
    assert wanted in line and len(line) < 160


@pytest.mark.parametrize(('verb', 'package', 'what_to_do'), [
    ('studio', 'nicegui', 'pip install "rosette_ros[studio]", or: pip install nicegui plotly'),
    ('calibrate', 'rclpy', SOURCE), ('cell', 'action_msgs', SOURCE), ('replay', 'builtin_interfaces', SOURCE),
    ('certificate', 'lxml',
     'pip install "rosette_ros[certificate]", or: pip install lxml pypdf reportlab'),
    ('info', 'mcap_ros2', 'pip install mcap-ros2-support'),
])
def test_a_package_that_is_not_installed_is_named(verb, package, what_to_do):
    """By the name under which it is installed; the other verbs work without."""
    without = f'import sys; sys.modules[{package!r}] = None; from rosette_ros.cli.main import main; sys.exit(main())'
    done = subprocess.run([sys.executable, '-c', without, verb], capture_output=True, text=True, timeout=300,
                          check=False)
    assert done.returncode == 2
    assert done.stdout == ''
    extra = re.search(r'\[(\w+)\]', what_to_do)
    which = f'{package} of the extra {extra[1]}' if extra else package
    assert done.stderr == f'rosette: {verb}: expected the Python package {which}, found none; {what_to_do}\n'


@pytest.mark.parametrize('words', [('help',), ('help', 'correct'), ('help', 'archive', 'query')])
def test_help_of_a_verb_is_asked_for_in_either_way(capsys, words):
    """`rosette help correct` is `rosette correct --help`."""
    shown = []
    for asked in (words, (*words[1:], '--help')):
        with pytest.raises(SystemExit) as end:
            main(list(asked))
        assert end.value.code == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1] and ' '.join(words[1:]) in shown[0]


def test_without_a_verb_comes_the_help(capsys):
    """Every verb stands in it, in its group."""
    with pytest.raises(SystemExit) as end:
        main([])
    assert end.value.code == 0
    out = capsys.readouterr().out
    assert all(f'\n  {verb} ' in out for verb in VERBS) and all(f'\n{group}\n  ' in out for group in GROUPS)


@pytest.mark.parametrize('verb', VERBS)
def test_every_verb_explains_itself(verb, capsys):
    """`rosette VERB --help` works and describes the verb."""
    with pytest.raises(SystemExit) as end:
        main([verb, '--help'])
    assert end.value.code == 0
    out = ' '.join(capsys.readouterr().out.split())
    assert VERBS[verb][1][1:] in out


def test_version(capsys):
    """The version of the package."""
    with pytest.raises(SystemExit):
        main(['--version'])
    assert capsys.readouterr().out == f'rosette {__version__}\n'


def test_ctrl_c_ends_with_130(monkeypatch, capsys):
    """As the shell expects of an interrupted program."""
    def interrupt(argv):
        raise KeyboardInterrupt
    monkeypatch.setattr(main_module, 'parse', interrupt)
    assert main(['plan']) == 130
    assert capsys.readouterr().err == 'rosette: interrupted\n'


def test_a_termination_leaves_in_good_order(monkeypatch):
    """A cell that a command has started is ended before the command is."""
    left = []

    def terminate(argv):
        with contextlib.ExitStack() as stack:
            stack.callback(left.append, 'ended')
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10)
    monkeypatch.setattr(main_module, 'parse', terminate)
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as end:
            main(['demo'])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert end.value.code == 128 + signal.SIGTERM
    assert left == ['ended']


BLOCKED = '''
import ctypes, sys
from rosette_ros.cli import main

def wait_in_a_library(options):
    mutex, lock = ctypes.create_string_buffer(64), ctypes.CDLL(None).pthread_mutex_lock
    lock(mutex)
    print('waits', flush=True)
    lock(mutex)

main.IMPLEMENTED['shell'] = main.shell_arguments, wait_in_a_library
sys.argv[1:] = ['shell']
sys.exit(main.main())
'''


def test_a_termination_ends_what_waits_within_a_library():
    """Where Python comes to no handler of a signal, as within a database that opens a pipe: within 5 s."""
    with subprocess.Popen([sys.executable, '-c', BLOCKED], stdout=subprocess.PIPE, text=True) as waiting:
        try:
            assert waiting.stdout.readline() == 'waits\n'
            waiting.terminate()
            assert waiting.wait(5.0) == 128 + signal.SIGTERM
        finally:
            waiting.kill()


def test_an_error_of_the_program_is_not_hidden(monkeypatch):
    """What is no RosetteError leaves with its traceback."""
    def fail(argv):
        raise ZeroDivisionError('a bug')
    monkeypatch.setattr(main_module, 'parse', fail)
    with pytest.raises(ZeroDivisionError, match='a bug'):
        main(['plan'])


def test_plan_waits_for_nothing_it_does_not_need():
    """In a process of its own, without ROS, plotting or the simulated machine being imported."""
    script = (
        'import sys; from rosette_ros.cli.main import main\n'
        "code = main('plan --balls 6 --radius-mm 182.5 --order row --csv'.split())\n"
        "heavy = {'rclpy', 'matplotlib', 'pydantic', 'rosette_msgs'} & set(sys.modules)\n"
        "sys.exit(code or ', '.join(sorted(heavy)) or 0)\n")
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=False)
    assert done.stderr == ''
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 37


def test_a_closed_output_is_no_error():
    """As with `rosette plan ... | head -1`."""
    command = [sys.executable, '-m', 'rosette_ros.cli.main', 'plan', '--balls', '72',
               '--radius-mm', '182.5', '--order', 'row', '--csv']
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline().startswith(b'seq,cmm_position')
        process.stdout.close()
        assert process.stderr.read() == b''


def test_a_terminal_without_the_signs_shows_others():
    """Of a number above all the minus sign; nothing is replaced by a question mark."""
    done = subprocess.run([sys.executable, '-m', 'rosette_ros.cli.main', 'plan', '--balls', '3', '--radius-mm', '182.5',
                           '--order', 'row'], capture_output=True, check=True,
                          env={**os.environ, 'PYTHONIOENCODING': 'ascii'})
    assert b'|-91.25 ' in done.stdout and b'?' not in done.stdout


class Screen(io.StringIO):
    """A terminal that keeps what is written."""

    def isatty(self):
        """Be one."""
        return True


def test_long_work_shows_on_a_terminal_what_it_does_and_how_far_it_is(monkeypatch):
    """Elsewhere nothing is written."""
    for name in ('TERM', 'NO_COLOR', 'TTY_COMPATIBLE'):
        monkeypatch.delenv(name, raising=False)
    for screen in (Screen(), io.StringIO()):
        monkeypatch.setattr(sys, 'stderr', screen)
        with doing('evaluating', 3) as step:
            step('[drawing]')
            step()
        words = screen.getvalue()
        assert ('[drawing]' in words and '2/3' in words and '0:00:00' in words) == screen.isatty() == bool(words)


def test_a_long_error_has_lines_on_a_terminal(rosette):
    """What failed comes first, then what to do; a command is whole, so that it can be copied. In a pipe: one line."""
    words = ('rosette: calibration failed: target 8 (table position 1, ball 2): asked 3 times, last: no answer within '
             '0.3 s; ball 1 is where it was taught at table angle 0: check that the table counts counter-clockwise '
             'about table.axis, taught as (0, 0, 1); what was measured is in /data/left/runs/rosette_20261125_2131_row'
             '; continue with: /opt/rosette/bin/rosette calibrate --resume /data/left/runs/rosette_20261125_2131_row '
             '--domain 57 --namespace left')
    assert error_lines(words, 80) == [
        'rosette: calibration failed: target 8 (table position 1, ball 2): asked 3 times,',
        '    last: no answer within 0.3 s',
        '  ball 1 is where it was taught at table angle 0: check that the table counts',
        '    counter-clockwise about table.axis, taught as (0, 0, 1)',
        '  what was measured is in /data/left/runs/rosette_20261125_2131_row',
        '  continue with:',
        '    /opt/rosette/bin/rosette calibrate --resume /data/left/runs/rosette_20261125_2131_row --domain 57 '
        '--namespace left']
    words = ('evaluate', 'no_such_folder/' + 'and_what_is_in_it/' * 3)
    refused = rosette(*words)
    assert refused.err.count('\n') == 1
    with Terminal(sys.executable, '-m', 'rosette_ros.cli.main', *words, COLUMNS='60') as screen:
        assert screen.end() == 2
    assert screen.screen.count('\n') > 2
    assert screen.screen.split() == refused.err.replace('; ', ' ').split()


@pytest.mark.parametrize('words', [('--help',), ('effects', '--json'),
                                   ('plan', '--balls', '6', '--order', 'row', '--radius-mm', '100')])
def test_an_output_that_is_full_or_closed_is_said(words):
    """One line, exit 2: whoever reads the output later would miss what is not there."""
    with open('/dev/full', 'w') as full:
        made = subprocess.run([sys.executable, '-m', 'rosette_ros.cli.main', *words], stdout=full,
                              stderr=subprocess.PIPE, text=True, timeout=60)
    assert (made.returncode, made.stderr) == (2, 'rosette: stdout: expected an output that can be written, found: No '
                                                 'space '
                                              'left on device; write elsewhere\n')


def test_a_closed_output_is_said(monkeypatch, capfd):
    """As after >&-."""
    monkeypatch.setattr(sys, 'stdout', None)
    assert main(['--help']) == 2
    assert capfd.readouterr().err == ('rosette: stdout: expected an output that can be written, found a closed one; '
                                      'leave '
                                      'out >&-\n')


def test_nothing_that_is_read_controls_the_terminal(tmp_path, refused, capsys):
    """Names of files and columns, runs and warnings: an escape is shown as a question mark."""
    path = tmp_path / 'a\x1b]0;b\x07.csv'
    path.write_text('a\x1b[31mRED,\x9b2J,\u202eb\n1,2,3\n')
    line = refused('evaluate', path)
    assert 'a?]0;b?.csv' in line and 'a?[31mRED,?2J,?b' in line and line.rstrip('\n').isprintable()
    console().print(f'run {path.name}')
    assert capsys.readouterr().out == 'run a?]0;b.csv\n'
    told = {'run': 'a\x1b\x7f\x9b\u202eö\n'}
    print_json(told)
    line = capsys.readouterr().out
    assert line == '{"run": "a\\u001b\\u007f\\u009b\\u202eö\\n"}\n' and json.loads(line) == told
