# SPDX-License-Identifier: Apache-2.0
"""rosette calibrate: asks a running cell for a calibration and ends with its result."""

import sys
from pathlib import Path

from rich.markup import escape

from rosette_ros.cli.arguments import whole
from rosette_ros.cli.domain import add_domain, add_namespace
from rosette_ros.cli.main import UsageError
from rosette_ros.cli.progress import ProgressDisplay
from rosette_ros.cli.screen import console
from rosette_ros.cli.summary import curve_table
from rosette_ros.core.errors import CellError
from rosette_ros.core.scheme import ORDERS
from rosette_ros.nodes.client import CellClient

INTERRUPTED = 130


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('--order', default='', help=f'one of {", ".join(ORDERS)} '
                        '(default: as the sequencer is configured)')
    parser.add_argument('--seed', type=whole(0, 2**53), default=0, help='draws the order random')
    parser.add_argument('--options', metavar='YAML', default='',
                        help='further options of the goal, such as "repeats: 5"')
    parser.add_argument('--resume', metavar='RUN',
                        help='go on with a run that was broken off: its log, by name or path')
    add_namespace(parser)
    add_domain(parser)


def run(options):
    """Run the calibration to its end; Ctrl-C cancels it."""
    if options.resume is not None and not options.resume.strip():
        raise UsageError('--resume: wanted the log of a run, by name or path, got nothing; without --resume a new '
                         'run begins')
    with CellClient(options.domain, options.namespace) as client:
        outcome = calibrate(client, order=options.order, seed=options.seed,
                            options=options.options, resume=_log(options.resume or ''))
    if outcome.cancelled:
        print(f'rosette: {outcome.message}{_rest(outcome, client)}', file=sys.stderr)
        return INTERRUPTED
    out = console()
    out.print(f'[bold]{escape(outcome.run_id)}[/]')
    out.print(curve_table(outcome.error_motions))
    out.print(f'\n{escape(outcome.message)}', soft_wrap=True)
    if outcome.verdict:
        out.print(escape(outcome.verdict), soft_wrap=True)
    if outcome.log:
        out.print(f'\nLog: {escape(str(outcome.log))}', soft_wrap=True)
    return 0


def _log(resume):
    """Return how the cell is told which log is meant: by its whole path where it is on this computer."""
    path = Path(resume)
    return str(path.resolve()) if resume and path.is_dir() else resume


def _rest(outcome, client):
    """Say where the measured balls are, and how to go on."""
    if not outcome.log:
        return ''
    return f'; what was measured is in {outcome.log}, go on with: {client.resume_command(outcome.log)}'


def calibrate(client, **goal):
    """Run a calibration with progress on stderr and return its Outcome.

    Raises CellError where the cell refuses, fails or goes away.
    """
    with ProgressDisplay() as display:
        try:
            outcome = client.calibrate(on_progress=display.show, **goal)
        except TimeoutError as error:
            raise CellError(f'{error}; look at the output of the sequencer') from error
    if not (outcome.success or outcome.cancelled):
        raise CellError(f'calibration failed: {outcome.message}{_rest(outcome, client)}')
    return outcome
