# SPDX-License-Identifier: Apache-2.0
"""rosette cell: a whole cell on this computer, watched; what dies is started again."""

import sys
import time
from datetime import datetime
from pathlib import Path

from rich.markup import escape

from rosette_ros.cli.domain import add_domain, add_namespace, domain_of_environment
from rosette_ros.cli.screen import console
from rosette_ros.cli.simulated_cell import make_folder, started
from rosette_ros.core.errors import InvalidConfig
from rosette_ros.nodes import names
from rosette_ros.nodes.cell import MODULES, Cell

LOOK_PERIOD = 0.2
"""How often the nodes are looked after, s; a dead one is started again within that."""


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('--no-simulation', action='store_true',
                        help='without the simulated CMM: a real one answers, in wall time')
    parser.add_argument('--machine', metavar='FILE', help='describes the simulated machine '
                        '(default: the machine.yaml of the package)')
    parser.add_argument('--params', metavar='FILE', help='parameters of the nodes, such as cell.yaml')
    parser.add_argument('-o', '--output', metavar='DIR', default='rosette-runs',
                        help='where logs go, one folder per run (default rosette-runs)')
    add_namespace(parser)
    add_domain(parser)


def run(options):
    """Start the cell, watch it until Ctrl-C, end it."""
    for path in filter(None, (options.machine, options.params)):
        if not Path(path).is_file():
            raise InvalidConfig(f'{path}: wanted a YAML file, got nothing there; check the path')
    if options.no_simulation and options.machine:
        raise InvalidConfig('cell: --machine describes a simulated CMM; take --no-simulation away')
    out = console()
    nodes = [name for name in MODULES if not (options.no_simulation and name == names.CMM)]
    cell = Cell(options.domain, options.namespace, machine=options.machine, params_file=options.params,
                log_dir=make_folder(options.output), nodes=nodes,
                simulated_time=not options.no_simulation)
    with started(out, cell):
        domain = domain_of_environment() if options.domain is None else options.domain
        where = f' --domain {domain}' if domain else ''
        if options.namespace != names.NAMESPACE:
            where += f' --namespace {options.namespace}'
        out.print(f'[bold]The cell is up[/]: {", ".join(nodes)} in domain {domain}, namespace '
                  f'/{escape(options.namespace.strip("/"))}; logs go to {escape(str(cell.log_dir))}',
                  soft_wrap=True)
        if options.no_simulation:
            out.print('It waits for a CMM that answers probe_target with ball_centre (docs/real-cmm.md).')
        out.print(f'In another terminal:\n  rosette calibrate{where}\nCtrl-C ends the cell.',
                  highlight=False)
        watch(cell)
    return 0


def watch(cell):
    """Start again what has died, and say so, until Ctrl-C; raises CellError where that is in vain."""
    try:
        while True:
            for words in cell.revive().values():
                print(f'{datetime.now():%H:%M:%S} {words}; started again', file=sys.stderr, flush=True)
            time.sleep(LOOK_PERIOD)
    except KeyboardInterrupt:
        print('The cell is being ended.', file=sys.stderr)
