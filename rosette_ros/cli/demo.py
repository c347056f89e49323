# SPDX-License-Identifier: Apache-2.0
"""rosette demo: a whole calibration in a simulated cell, up to the six error motions and a report."""

import argparse
import time
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import Console
from rich.markup import escape

from rosette_ros.analysis import MOST_BALLS_ADVISED, MOST_BALLS_JUDGED, analyse, judge, summarise
from rosette_ros.cell.supervisor import Cell
from rosette_ros.cli import verification_demo
from rosette_ros.cli.arguments import add_domain, add_logs, whole
from rosette_ros.cli.console import console, fit_rows, head, pairs, print_parts, print_verdict
from rosette_ros.cli.demo_cell import MACHINE, compare, demo_cell, shown, truth_table
from rosette_ros.cli.hidden_demo import demo_of
from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.scheme import plan
from rosette_ros.io.log_reader import read_log
from rosette_ros.presentation.formatting import millimetres
from rosette_ros.presentation.plots.plot_style import save
from rosette_ros.presentation.plots.result_plots import Series, six_curves
from rosette_ros.presentation.report import open_source, write_report
from rosette_ros.presentation.tables import curves
from rosette_ros.simulation import MachineConfig

TABLE = {'translation_um': 0.2, 'rotation_urad': 1.5, 'axial_correction': False, 'angular_correction': False}
"""The table of the demo has not been corrected yet: its errors stand above the noise."""
PICTURE, REPORT = 'six-curves.png', 'report.html'
MOST_BALLS = 72
DRAWN = -1
"""Stands for a seed that is yet to be drawn."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--balls', metavar='N', type=whole(None, MOST_BALLS), default=12,
                        help='balls on the plate = table positions (default 12)')
    parser.add_argument('--order', help='order of measurement (default diagonal; with --hidden one that shows effects)')
    parser.add_argument('--hidden', metavar='SEED', nargs='?', type=whole(0, 2**31), default=None,
                        const=DRAWN, help='hide physical effects in the machine, drawn from SEED (a '
                        'new one if none is given), find them, and open the envelope at the end')
    parser.add_argument('--verification', action='store_true', help="measure the paper's four runs under "
                        'different conditions and two more, and report how well they agree')
    parser.add_argument('--seed', type=whole(0, 2**31), default=1,
                        help='draws machine and noise, and the order random (default 1)')
    add_logs(parser)
    add_domain(parser, 'a free one')
    parser.add_argument('--keep', action='store_true', help='leave the cell running afterwards, until Ctrl-C')


class PlainDemo:
    """A machine that hides nothing: the six curves beside the truth."""

    order, turning, groups = 'diagonal', 'forward', MappingProxyType[str, Any]({})

    def prepare(self, out: Console, config: MachineConfig, folder: Path) -> None:
        """Add no file to those of the machine, which are copied to the log."""

    def show(self, out: Console, config: MachineConfig, log_path: Path, seconds: float) -> None:
        """Print the results, write picture and report."""
        log = read_log(log_path)
        run, source = open_source(log_path)
        summary = summarise(run) if run.n <= MOST_BALLS_ADVISED else None
        fit = analyse(run) if summary is None else summary.fit
        comparison = compare(fit, config, log.frame_of(run.run_id))
        picture = log_path / PICTURE
        title = f'Six error motions of a simulated rotary table: {run.n} balls on R = {millimetres(run.radius)}'
        save(six_curves([Series('measured', fit.error_motions)], title, comparison.truth), picture)
        out.print(f'\n{head(run)}\n')
        if run.n <= MOST_BALLS_JUDGED:
            print_verdict(out, judge(run) if summary is None else summary.verdict)
        print_parts(out, [curves(fit.error_motions), pairs(fit_rows(fit)), truth_table(comparison)])
        out.print(f'\nDifference to the truth: [bold]rms {comparison.rms:.2f}[/] standard uncertainties; 1 ± '
                  f'{comparison.rms_spread:.2f} is expected')
        out.print(f'Took {seconds:.1f} s; a real cell would have measured for {run.time[-1] / 3600:.1f} h\n')
        where = [('Picture', picture)]
        if summary is not None:
            write_report(log_path / REPORT, summary, source, f'rosette report {shown(log_path)}')
            where.append(('Report', log_path / REPORT))
        where += [('Log', log_path), ('Machine', log_path / MACHINE)]
        out.print(pairs([(name, escape(shown(path))) for name, path in where]))
        out.print('\nNext:')
        for verb in ('evaluate', 'studio', 'info', 'replay'):
            out.print(f'  rosette {verb} {shown(log_path)}', soft_wrap=True)


def run(options: argparse.Namespace) -> None:
    """Run the demo."""
    if options.verification:
        if options.hidden is not None:
            raise InvalidConfig('demo: --verification and --hidden exclude each other; choose one')
        verification_demo.run(options)
        return
    demonstration = PlainDemo() if options.hidden is None else demo_of(options.hidden)
    order = options.order or demonstration.order
    plan(options.balls, order, options.seed, demonstration.turning)  # refuses what cannot be measured
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls}, table=TABLE,
                                     **demonstration.groups)
    out = console()
    what = f'[bold]A simulated cell[/]: {options.balls} balls, order {order}'
    with demo_cell(out, what, config, options.domain, options.output) as running:
        demonstration.prepare(out, config, running.machine.parent)
        log_path = running.calibrate(order, options.seed, f'turning: {demonstration.turning}')
        demonstration.show(out, config, log_path, running.seconds)
        if options.keep:
            keep(out, running.cell)


def keep(out: Console, cell: Cell) -> None:
    """Leave the cell running until Ctrl-C; raise CellError where a node fails."""
    out.print(f'\nThe cell is running in domain {cell.domain_id}. In another terminal:\n'
              f'  rosette calibrate --domain {cell.domain_id}\nCtrl-C ends the cell.', highlight=False)
    try:
        while True:
            cell.check()
            time.sleep(0.2)
    except KeyboardInterrupt:
        out.print('\nEnding the cell.')
