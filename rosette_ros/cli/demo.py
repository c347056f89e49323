# SPDX-License-Identifier: Apache-2.0
"""rosette demo: one command from nothing to six error motions, on a simulated machine."""

import shutil
import sys
import tempfile
import time
from pathlib import Path
from types import MappingProxyType

from rich.markup import escape

from rosette_ros.analysis import analyse
from rosette_ros.cli import hidden_demo, verification_demo
from rosette_ros.cli.arguments import whole
from rosette_ros.cli.calibrate import INTERRUPTED, calibrate
from rosette_ros.cli.domain import free_domain
from rosette_ros.cli.screen import console, pairs
from rosette_ros.cli.simulated_cell import MACHINE, make_cell, make_folder, started, write_machine
from rosette_ros.cli.summary import curve_table, fit_summary, head
from rosette_ros.cli.truth import compare, shown, truth_table
from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.scheme import plan
from rosette_ros.data.log_reader import read_log
from rosette_ros.machine import MachineConfig
from rosette_ros.nodes.client import CellClient
from rosette_ros.pictures.curves import Series, save, six_curves
from rosette_ros.report import open_source, write_report
from rosette_ros.story import MOST_BALLS_ADVISED, tell
from rosette_ros.words import exact

TABLE = {'translation_um': 0.2, 'rotation_urad': 1.5, 'axial_correction': False,
         'angular_correction': False}
"""The table of the demo has not been corrected yet: its errors stand above the noise."""
PICTURE, REPORT = 'six-curves.png', 'report.html'
MOST_BALLS = 72
DRAWN = -1
"""Stands for a seed that is yet to be drawn."""


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('--balls', metavar='N', type=whole(None, MOST_BALLS), default=12,
                        help='balls on the plate = table positions (default 12)')
    parser.add_argument('--order', help='order of measurement (default diagonal; with --hidden one '
                        'that shows effects)')
    parser.add_argument('--hidden', metavar='SEED', nargs='?', type=whole(0, 2**31), default=None,
                        const=DRAWN, help='hide physical effects in the machine, drawn from SEED (a '
                        'new one if none is given), find them, and open the envelope at the end')
    parser.add_argument('--verification', action='store_true', help="measure the paper's four runs under "
                        'different conditions and two more, and report how well they agree')
    parser.add_argument('--seed', type=whole(0, 2**31), default=1,
                        help='draws machine and noise, and the order random (default 1)')
    parser.add_argument('-o', '--output', metavar='DIR', default='rosette-runs',
                        help='where logs go, one folder per run (default rosette-runs)')
    parser.add_argument('--domain', metavar='ID', type=whole(0, 232),
                        help='ROS domain (default: a free one)')
    parser.add_argument('--keep', action='store_true',
                        help='leave the cell running afterwards, until Ctrl-C')


def run(options):
    """Run the demo."""
    if options.verification:
        if options.hidden is not None:
            raise InvalidConfig('demo: --verification and --hidden exclude each other; choose one')
        return verification_demo.run(options)
    story = PLAIN if options.hidden is None else hidden_demo.story_of(options.hidden)
    order = options.order or story.order
    plan(options.balls, order, options.seed, story.turning)  # refuses what cannot be measured
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls},
                                     table=TABLE, **story.groups)
    return perform(options, config, order, story)


def perform(options, config, order, story):
    """Run a cell with a machine, calibrate, tell what came out; return the exit code."""
    began = time.monotonic()
    domain = free_domain() if options.domain is None else options.domain
    logs = make_folder(options.output)
    out = console()
    out.print(f'[bold]A simulated cell[/]: {options.balls} balls, order {order}, machine '
              f'drawn from seed {options.seed}; four ROS 2 nodes in domain {domain}')
    with tempfile.TemporaryDirectory(prefix='rosette_demo_') as folder:
        machine = Path(folder) / MACHINE
        write_machine(config, machine)
        story.prepare(out, config, Path(folder))
        with started(out, make_cell(config, machine, domain, logs)) as cell:
            out.print(f'  nodes are up after          {time.monotonic() - began:5.1f} s')
            with CellClient(domain) as client:
                outcome = calibrate(client, order=order, seed=options.seed,
                                    options=f'turning: {story.turning}', check=cell.check)
            if outcome.cancelled:
                print(f'rosette: {outcome.message}; what was measured is in {outcome.log}',
                      file=sys.stderr)
                return INTERRUPTED
            for path in (machine, *story.papers(Path(folder))):
                shutil.copy(path, outcome.log / path.name)
            story.tell(out, config, outcome.log, time.monotonic() - began)
            if options.keep:
                keep(out, cell, domain)
    return 0


class PlainStory:
    """What is told of a machine that hides nothing: the six curves beside the truth."""

    order, turning, groups = 'diagonal', 'forward', MappingProxyType({})

    def prepare(self, out, config, folder):
        """There is nothing to seal."""

    def papers(self, folder):
        """Return the files that go into the log's folder besides the machine."""
        return ()

    def tell(self, out, config, log_path, seconds):
        """Print what came out."""
        show(out, config, log_path, seconds)


PLAIN = PlainStory()


def show(out, config, log_path, seconds):
    """Print what came out and draw the picture, all from the log alone."""
    log = read_log(log_path)
    report = analyse(log.to_run())
    comparison = compare(report, config, log.frame_of(report.run.run_id))
    picture = log_path / PICTURE
    save(six_curves([Series('measured', report.error_motions)],
                    f'Six error motions of a simulated rotary table: {report.run.n} balls on '
                    f'R = {exact(1e3 * report.run.radius, 6)} mm', comparison.truth), picture)
    out.print(f'\n{head(report.run)}\n')
    for part in (curve_table(report.error_motions), fit_summary(report),
                 truth_table(comparison)):
        out.print(part)
        out.print()
    out.print(f'Difference to the truth: [bold]rms {comparison.rms:.2f}[/] standard '
              f'uncertainties; 1 ± {comparison.rms_spread:.2f} is expected')
    measured = report.run.time[-1] / 3600
    out.print(f'Took {seconds:.1f} s; a real cell would have measured for {measured:.1f} h\n')
    where = [('Picture', picture), *report_beside(log_path, report.run.n), ('Log', log_path),
             ('Machine', log_path / MACHINE)]
    out.print(pairs([(name, escape(shown(path))) for name, path in where]))
    out.print('\nNext:')
    for command in (f'evaluate {shown(log_path)}', f'studio {shown(log_path)}', f'info {shown(log_path)}',
                    f'replay {shown(log_path)}'):
        out.print(f'  rosette {command}', soft_wrap=True)


def report_beside(log_path, balls):
    """Write the report of a run into its folder; return ('Report', path) in a list, [] for large plates."""
    if balls > MOST_BALLS_ADVISED:
        return []
    run, source = open_source(log_path)
    write_report(log_path / REPORT, tell(run), source, f'rosette report {shown(log_path)}')
    return [('Report', log_path / REPORT)]


def keep(out, cell, domain):
    """Leave the cell running until Ctrl-C; raises CellError where a node dies."""
    out.print(f'\nThe cell is running in domain {domain}. In another terminal:\n'
              f'  rosette calibrate --domain {domain}\nCtrl-C ends it.', highlight=False)
    try:
        while True:
            cell.check()
            time.sleep(0.2)
    except KeyboardInterrupt:
        out.print('\nThe cell is being ended.')
