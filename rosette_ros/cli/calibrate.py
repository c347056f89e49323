# SPDX-License-Identifier: Apache-2.0
"""rosette calibrate: asks a running cell for a calibration and ends with its result."""

import sys

from rich.markup import escape

from rosette_ros.cli.arguments import whole
from rosette_ros.cli.domain import add_domain
from rosette_ros.cli.progress import ProgressDisplay
from rosette_ros.cli.screen import console
from rosette_ros.cli.summary import curve_table
from rosette_ros.core.errors import CellError
from rosette_ros.core.scheme import ORDERS
from rosette_ros.nodes import names
from rosette_ros.nodes.client import CellClient

INTERRUPTED = 130


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('--order', default='', help=f'one of {", ".join(ORDERS)} '
                        '(default: as the sequencer is configured)')
    parser.add_argument('--seed', type=whole(0, 2**53), default=0, help='draws the order random')
    parser.add_argument('--options', metavar='YAML', default='',
                        help='further options of the goal, such as "repeats: 5"')
    parser.add_argument('--namespace', metavar='NS', default=names.NAMESPACE,
                        help=f'namespace of the cell (default {names.NAMESPACE})')
    add_domain(parser)


def run(options):
    """Run the calibration to its end; Ctrl-C cancels it."""
    with CellClient(options.domain, options.namespace) as client:
        outcome = calibrate(client, order=options.order, seed=options.seed,
                            options=options.options)
    if outcome.cancelled:
        print(f'rosette: {outcome.message}; what was measured is in {outcome.log}',
              file=sys.stderr)
        return INTERRUPTED
    out = console()
    out.print(f'[bold]{escape(outcome.run_id)}[/]')
    out.print(curve_table(outcome.error_motions))
    if outcome.log:
        out.print(f'\nLog: {escape(str(outcome.log))}', soft_wrap=True)
    return 0


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
        log = f'; what was measured is in {outcome.log}' if outcome.log else ''
        raise CellError(f'calibration failed: {outcome.message}{log}')
    return outcome
