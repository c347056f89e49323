# SPDX-License-Identifier: Apache-2.0
"""The command `rosette`: finds the verb, runs it, and is the one door through which errors leave.

A verb is a module with `add_arguments(parser)` and `run(options)`. It is imported only when it is
asked for, so that `rosette plan` waits for neither ROS nor the plotting library.
"""

import argparse
import difflib
import importlib
import os
import signal
import sys

from rosette_ros import __version__
from rosette_ros.core.errors import RosetteError

VERBS = {
    'demo': ('demo', 'calibrate a simulated rotary table from start to end'),
    'plan': ('plan', 'the target list of a measuring scheme'),
    'cell': ('cell', 'a whole cell on this computer: starts its nodes, restarts what dies'),
    'calibrate': ('calibrate', 'start a calibration in a running cell and wait for the result'),
    'evaluate': ('evaluate', 'the six error motions of a run, with uncertainties'),
    'compare': ('compare', 'a model against a run: where it fails, by how much of the noise'),
    'diagnose': ('diagnose', 'which physical effect is missing from the model'),
    'effects': ('effects', 'the library of physical effects, or one of them explained'),
    'add': ('add', 'put an effect into a model file; with --run, the error before and after'),
    'remove': ('remove', 'take an effect out of a model file; with --run, before and after'),
    'advise': ('advise', 'what an order of measurement can show, and what to measure next'),
    'report': ('report', 'a run told on one page: verdict, curves, residuals, candidates, conditions'),
    'studio': ('studio', 'a page in the browser: verdict, curves, maps, what is missing, a running cell'),
    'info': ('info', 'what is in a run'),
    'import': ('import_csv', 'a ball-centre table (CSV) becomes a log'),
    'export': ('export_csv', 'a run becomes a ball-centre table (CSV)'),
    'replay': ('replay', 'put a log back onto the graph, for an evaluator'),
}
"""Verb: (module in rosette_ros.cli, what it does). A new verb is a new module and a line here."""

_SOURCE = 'source the set-up file of ROS 2 and of the workspace'
INSTALL = {'rclpy': _SOURCE, 'rosette_msgs': _SOURCE, 'nicegui': 'pip install nicegui plotly'}
"""Package: how it is installed, where that is not its name alone."""

EXIT_OK, EXIT_ERROR, EXIT_INTERRUPTED = 0, 2, 130


class UsageError(RosetteError):
    """The command was not given as it is meant."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints leave by the same door as all others."""

    def __init__(self, **settings):
        """Take options in full only: an abbreviation may mean another thing tomorrow."""
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message):
        """Raise UsageError instead of printing the usage over several lines."""
        raise UsageError(f'{message} (see {self.prog} --help)')


def main(argv=None):
    """Run one command and return its exit code: 0, 2 after an error in one line, 130 after Ctrl-C.

    argv: the words after `rosette`; None takes them from the process. What is not a RosetteError
    is a fault of the program and comes with its traceback.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors='replace')  # a terminal without µ shows '?' in its place
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup must stay what it is
            signal.signal(number, _end)
    try:
        options = parse(sys.argv[1:] if argv is None else list(argv))
        code = options.run(options)
        sys.stdout.flush()
    except RosetteError as error:
        print(f'rosette: {" ".join(str(error).split())}', file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print('rosette: interrupted', file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has seen enough; nothing more can be written, at exit neither.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    return EXIT_OK if code is None else code


def _end(number, frame):
    """Leave through all `with` blocks: a cell that was started must not outlive its command."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


def parse(argv):
    """Return the options of a command, with `run`, what carries it out."""
    parser = Parser(
        prog='rosette', description='Calibrates rotary tables by the three-rosette method: table, '
        'ball plate and measuring machine are separated, nothing has to be calibrated before.',
        epilog='RUN is a log directory, an .mcap file or a ball-centre table (CSV). '
        '`rosette VERB --help` explains a verb.')
    parser.add_argument('--version', action='version', version=f'rosette {__version__}')
    verbs = parser.add_subparsers(metavar='VERB', parser_class=Parser)
    asked = argv[0] if argv else '--help'
    for verb, (module, text) in VERBS.items():
        of_verb = verbs.add_parser(verb, help=text, description=f'{text[0].upper()}{text[1:]}.')
        if verb == asked:
            implementation = _implementation(verb, module)
            implementation.add_arguments(of_verb)
            of_verb.set_defaults(run=implementation.run)
    if not asked.startswith('-') and asked not in VERBS:
        near = difflib.get_close_matches(asked, VERBS, 1)
        hint = f'; did you mean {near[0]!r}?' if near else ''
        raise UsageError(f'verb: wanted one of {", ".join(VERBS)}, got {asked!r}{hint}')
    return parser.parse_args(argv or [asked])


def _implementation(verb, module):
    """Return the module of a verb; a package that it needs and that is not installed is named."""
    try:
        return importlib.import_module(f'rosette_ros.cli.{module}')
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package in ('', 'rosette_ros'):
            raise
        raise UsageError(f'{verb}: wanted the Python package {package}, got none; '
                         f'{INSTALL.get(package, f"pip install {package}")}') from error


if __name__ == '__main__':
    sys.exit(main())
