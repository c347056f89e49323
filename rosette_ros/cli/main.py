# SPDX-License-Identifier: Apache-2.0
"""The command `rosette`: finds the verb, runs it, and is the one place where errors are printed.

A module of verbs has a table `IMPLEMENTED`: of each verb the function that declares its arguments and the one that
carries it out, or a table of its words with what they do and theirs. It is imported on demand, so that `rosette plan`
loads neither ROS nor the plotting library.
"""

import argparse
import codecs
import errno
import gc
import io
import logging
import os
import shlex
import shutil
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TypeAlias

from rosette_ros.cell.ending import ENDING
from rosette_ros.cli.arguments import ENDS, UsageError, expand_home, keep_inputs, load
from rosette_ros.core.run.errors import RosetteError, one_line, unknown_name, visible
from rosette_ros.core.run.number_words import show_angles
from rosette_ros.core.run.typed_words import typed
from rosette_ros.invocation import __version__
from rosette_ros.nodes.environment import check_middleware

SIGNS = {'−': '-', '–': '-', '─': '-', '±': '+-', '→': '->', 'µ': 'u', '°': 'deg', 'σ': 'sigma', 'Δ': 'd', '·': '.',
         '✓': 'ok', '✗': 'x', **dict(zip('▁▂▃▄▅▆▇█', '12345678', strict=True))}
"""Signs that are printed, and what a terminal without them shows: a number keeps its sign."""
GROUPS = {
    'try': {
        'demo': ('demo', 'calibrate a simulated rotary table from start to end'),
        'envelope': ('hidden_demo', 'open the envelope of demo --hidden: hidden and found effects'),
        'shell': ('main', 'a shell that finds rosette and the Python with ROS')},
    'measure': {
        'plan': ('plan', 'what a plan measures and determines; plans side by side'),
        'advise': ('plan', 'what an order of measurement can show, and what to measure next'),
        'check-cmm': ('cell', 'try a CMM before a calibration: what its node does wrong'),
        'dme': ('dme', 'a CMM with an I++ DME server: check it, its paths; or a server for tests'),
        'cell': ('cell', 'a whole cell on this computer: starts its nodes, restarts failed nodes'),
        'calibrate': ('cell', 'start a calibration in a running cell and wait for the result')},
    'evaluate': {
        'evaluate': ('evaluate', 'the six error motions of a run, with uncertainties'),
        'diagnose': ('evaluate', 'which physical effect is missing from the model'),
        'compare': ('evaluate', 'where a model fails on a run, and by how much of the noise'),
        'compare-curves': ('curves', 'curves of runs or tables, also of the maker, without offsets and clamping'),
        'budget': ('products', 'the uncertainty budget of a run (GUM), confirmed by Monte Carlo')},
    'improve': {
        'effects': ('effects', 'the library of physical effects, or one of them explained'),
        'add': ('effects', 'add effects to a model file; with --run, the residual before and after'),
        'remove': ('effects', 'remove an effect from a model file; with --run, the residual before and after'),
        'correct': ('products', 'a correction of the table from a run: for ROS, as a table, for LinuxCNC'),
        'verify': ('products', 'whether a correction did what it promised, by a run before and one after')},
    'document': {
        'report': ('report', 'a run on three pages: verdict and curves, where the model fails, conditions'),
        'studio': ('studio', 'a page in the browser: verdict, curves, maps, what is missing, a running cell'),
        'certificate': ('certificate', 'a calibration certificate (DCC, PDF) of a run, or its check')},
    'archive': {
        'info': ('info', 'what is in a run'),
        'runs': ('runs', 'the runs in a folder, with their verdicts'),
        'archive': ('archive', 'many runs of many cells: add, ask, evaluate under another model'),
        'trend': ('archive', 'how a table changes over the runs of an archive; when to calibrate again'),
        'import': ('data', 'convert a table of ball centres, ours or another program\'s, to a log'),
        'export': ('data', 'convert a run to a ball-centre table (CSV)'),
        'replay': ('replay', 'publish the messages of a log again, for an evaluator')}}
"""By what one wants to do: verb: (module in rosette_ros.cli, what it does). A new verb is two functions and a line."""
VERBS = {verb: what for group in GROUPS.values() for verb, what in group.items()}

FEWER_COLLECTIONS = 10_000
"""New objects after which garbage is looked for: figures are made of many and leave little; a twelfth of a report."""
WITH_ROS = ('cell', 'check-cmm', 'calibrate', 'studio', 'replay')
"""Verbs that load ROS."""
Arguments: TypeAlias = Callable[[argparse.ArgumentParser], None]
Carry: TypeAlias = Callable[[argparse.Namespace], int | None]
Implementation: TypeAlias = tuple[Arguments, Carry] | Mapping[str, tuple[str, Arguments, Carry]]
"""What a module of verbs has of one: its arguments and its function; or by word what it does, and the same of it."""

EXIT_OK, EXIT_ERROR, EXIT_INTERRUPTED = 0, 2, 130
CLOSED = 'expected an output that can be written, found a closed one; leave out >&-'
UNWRITABLE = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
PATIENCE = 3.0  # a signal that asks for the end ends a verb within this time, s


class Parser(argparse.ArgumentParser):
    """An argument parser that raises its errors, so that main prints them as all others."""

    def __init__(self, **settings: Any) -> None:
        """Take options in full only: an abbreviation may mean another option in a later version."""
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise UsageError instead of printing the usage over several lines."""
        words = message.removeprefix('unrecognized arguments: ').split()
        if message.startswith('unrecognized') and (asked := next((one for one in words if one[0] == '-'), '')):
            name, known = asked.partition('=')[0], self.options()
            if name in known:
                raise UsageError(f'{name}: expected an option of this verb, found one of another; the verb with --help '
                                 'lists its own')
            raise UsageError(unknown_name('option', name, known, f'{self.prog} --help'))
        raise UsageError(f'{message} (see {self.prog} --help)')

    def options(self) -> list[str]:
        """Return the names of all options, those of its words included."""
        below = [made for action in self._actions if isinstance(action, argparse._SubParsersAction)
                 for made in action.choices.values()]
        return [*self._option_string_actions, *(name for made in below for name in made.options())]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise an error with the nearest value where there is no such choice."""
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, unknown_name('value', str(value), list(map(str, action.choices))))


def _without_signs(error: UnicodeError) -> tuple[str, int]:
    """Return what a terminal that lacks a sign shows in its place, '?' where nothing is known."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return ''.join(SIGNS.get(one, '?') for one in error.object[error.start:error.end]), error.end


codecs.register_error('signs', _without_signs)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 2 after an error in one line, 130 after Ctrl-C.

    1 where `verify` does not confirm, or `archive add` could not evaluate all.

    argv: the words after `rosette`; None takes them from the process. What is not a RosetteError is an error of the
    program and leaves its traceback.
    """
    gc.set_threshold(FEWER_COLLECTIONS)
    if logging.lastResort:
        logging.lastResort.setFormatter(_Plain())
    if sys.stdout is None:  # which `>&-` does
        _print_error(f'stdout: {CLOSED}')
        return EXIT_ERROR
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='signs')
    ends = [one for one in ENDS if signal.getsignal(one) is signal.SIG_DFL]
    for number in ends:  # nohup stays as it is
        signal.signal(number, _end)
    if argv is None and ends and os.name == 'posix':  # the process is that of the command
        told, tells = os.pipe()
        os.set_blocking(tells, False)
        signal.set_wakeup_fd(tells)
        threading.Thread(target=_end_late, args=(told, ends), name='end', daemon=True).start()
    try:
        try:
            options = parse(sys.argv[1:] if argv is None else list(argv))
        except SystemExit:  # after --help
            sys.stdout.flush()
            raise
        show_angles(vars(options).get('angle_unit', 'urad'))
        expand_home(options)
        keep_inputs(options)
        with typed():
            code = options.run(options)
        sys.stdout.flush()
    except RosetteError as error:
        _print_error(one_line(error))
        return EXIT_ERROR
    except KeyboardInterrupt as interrupt:
        _print_error(str(interrupt) or 'interrupted')
        return next((128 + one for one in ends if signal.getsignal(one) is signal.SIG_IGN), EXIT_INTERRUPTED)
    except OSError as error:
        if error.filename or error.errno not in UNWRITABLE:  # else of stdout: errors of files are met where they are
            raise
        if error.errno != errno.EPIPE:
            _print_error(f'stdout: expected an output that can be written, found: {error.strerror}; write elsewhere')
        # Nothing can be written, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK if error.errno == errno.EPIPE else EXIT_ERROR
    return EXIT_OK if code is None else code


class _Plain(logging.Formatter):
    """Warnings as they are, but for what would control a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Return a warning as text."""
        return visible(super().format(record))


def _print_error(words: str) -> None:
    """Print why a command has failed on stderr, in one line; on a terminal where that does not fit, in several."""
    lines = [visible(f'rosette: {words}')]
    if sys.stderr.isatty() and len(lines[0]) > (width := shutil.get_terminal_size().columns):
        lines = error_lines(lines[0], width)
    print('\n'.join(lines), file=sys.stderr)


def error_lines(words: str, width: int) -> list[str]:
    """Return what a '; ' parts in lines of their own, wrapped; a command that follows 'with: ' is not."""
    lines = list[str]()
    for part in words.split('; '):
        text, lead, command = part.partition(' with: ')
        lines += textwrap.wrap(text + lead.rstrip(), width, initial_indent='  ' if lines else '',
                               subsequent_indent='    ', break_long_words=False, break_on_hyphens=False)
        lines += [f'    {command}'] * bool(command)
    return lines


def _end(number: int, frame: FrameType | None) -> NoReturn:
    """Leave through all `with` blocks: a cell ends with the command that started it."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


def _end_late(told: int, numbers: Collection[int]) -> None:
    """End the process that a signal did not end in time, as its main thread waits within a library: for a database.

    While nodes of its cell are ended it waits for that; else they end themselves, in good order."""
    while (number := os.read(told, 1)[0]) not in numbers:
        pass
    time.sleep(PATIENCE)
    with ENDING:
        os._exit(128 + number)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Return the options of a command; `run` of them carries it out, `command_line` is how it was called."""
    listed = '\n\n'.join('\n'.join([group, *(f'  {verb:<12} {text}' for verb, (_, text) in verbs.items())])
                         for group, verbs in GROUPS.items())
    parser = Parser(
        prog='rosette', formatter_class=argparse.RawDescriptionHelpFormatter,
        usage='rosette [-h] [--version] VERB ...',
        description='Calibrates rotary tables by the three-rosette method: table, ball plate and\n'
        'measuring machine are separated, none has to be calibrated before.',
        epilog=f'{listed}\n\nRUN is a log directory, an .mcap file or a ball-centre table (CSV).\n'
        '`rosette VERB --help` explains a verb.')
    parser.add_argument('--version', action='version', version=f'rosette {__version__}')
    verbs = parser.add_subparsers(metavar='VERB', prog='rosette', parser_class=Parser, help=argparse.SUPPRESS)
    if argv and argv[0] == 'help':
        argv = [*argv[1:], '--help']
    asked = argv[0] if argv else '--help'
    for verb, (module, text) in VERBS.items():
        of_verb = verbs.add_parser(verb, description=f'{text[0].upper()}{text[1:]}.')
        if verb == asked:
            has_words = declare(of_verb, implementation(verb, module))
            of_verb.set_defaults(command_line=shlex.join(['rosette', *argv]))
            if verb != 'shell' and not has_words:  # which have options of their own
                return of_verb.parse_intermixed_args(argv[1:])
    if not asked.startswith('-') and asked not in VERBS:
        raise UsageError(unknown_name('verb', asked, VERBS, 'rosette --help'))
    return parser.parse_args(argv or [asked])


def declare(parser: argparse.ArgumentParser, verb: Implementation) -> bool:
    """Add the arguments of a verb, or its words with theirs; return whether it has words."""
    if isinstance(verb, tuple):
        add_arguments, run = verb
        add_arguments(parser)
        parser.set_defaults(run=run)
        return False
    words = parser.add_subparsers(metavar='WHAT', required=True)
    for word, (text, add_arguments, run) in verb.items():
        made = words.add_parser(word, help=text, description=f'{text[0].upper()}{text[1:]}.')
        add_arguments(made)
        made.set_defaults(run=run)
    return True


def implementation(verb: str, module: str) -> Implementation:
    """Return how a verb is carried out; raise UsageError, naming the package, where one is not installed."""
    if verb in WITH_ROS:
        check_middleware()
    made: Implementation = load(f'rosette_ros.cli.{module}', verb).IMPLEMENTED[verb]
    return made


def shell_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('command', metavar='COMMAND', nargs=argparse.REMAINDER,
                        help='a command and its arguments, such as: python my_cmm.py (default: a shell)')


def run_shell(options: argparse.Namespace) -> None:
    """Become the command, or the user's shell; raises UsageError where it is not found.

    A start-up file may put other folders before ours; bash is given one that reads the user's and then ours."""
    folder = str(Path(sys.executable).parent)
    path = os.pathsep.join([folder, os.environ.get('PATH', os.defpath)])
    environment = {**os.environ, 'ROSETTE_BIN': folder, 'PATH': path}
    command = options.command or [os.environ.get('SHELL') or os.environ.get('COMSPEC', 'sh')]
    found = shutil.which(command[0], path=path)
    if found is None:
        raise UsageError(f'shell: expected a command, found {command[0]!r}, which is not found')
    if not options.command:
        print(f'{command[0]} with rosette and python of {folder}; exit leaves it', flush=True)
        if Path(found).name == 'bash':
            command += ['--rcfile', str(Path(__file__).with_name('shell.sh'))]
    os.execve(found, command, environment)


IMPLEMENTED: dict[str, Implementation] = {'shell': (shell_arguments, run_shell)}

if __name__ == '__main__':
    sys.exit(main())
