# SPDX-License-Identifier: Apache-2.0
"""rosette demo: one command from nothing to six error motions, on a simulated machine."""

import contextlib
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from rich.markup import escape

from rosette_ros.analysis import Report, analyse
from rosette_ros.cli.arguments import whole
from rosette_ros.cli.calibrate import INTERRUPTED, calibrate
from rosette_ros.cli.domain import free_domain
from rosette_ros.cli.screen import console, exact, fixed, pairs, table
from rosette_ros.cli.summary import curve_table, fit_summary, head
from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.records import CURVES, remove_gauge
from rosette_ros.core.scheme import plan
from rosette_ros.data.log_reader import read_log
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.nodes.cell import Cell
from rosette_ros.nodes.client import CellClient
from rosette_ros.pictures.curves import Series, save, six_curves

TABLE = {'translation_um': 0.2, 'rotation_urad': 1.5, 'axial_correction': False,
         'angular_correction': False}
"""The table of the demo has not been corrected yet: its errors stand above the noise."""
PICTURE, MACHINE = 'six-curves.png', 'machine.yaml'
MOST_BALLS = 72


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results against the truth of the simulated machine, both freed of the gauge.

    truth: (n, 6), m and rad; error: (n, 6) differences in units of the standard uncertainty.
    """

    truth: np.ndarray
    error: np.ndarray

    @property
    def rms(self):
        """Root mean square of the normalised errors; 1 is expected."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def rms_spread(self):
        """Standard deviation expected of the rms: 6 n values, ten of them fixed by the gauge."""
        return float(1 / np.sqrt(2 * (self.error.size - 10)))


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('--balls', metavar='N', type=whole(None, MOST_BALLS), default=12,
                        help='balls on the plate = table positions (default 12)')
    parser.add_argument('--order', default='diagonal',
                        help='order of measurement (default diagonal)')
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
    began = time.monotonic()
    plan(options.balls, options.order, options.seed)  # refuses what cannot be measured
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls},
                                     table=TABLE)
    domain = free_domain() if options.domain is None else options.domain
    logs = make_folder(options.output)
    out = console()
    out.print(f'[bold]A simulated cell[/]: {options.balls} balls, order {options.order}, machine '
              f'drawn from seed {options.seed}; four ROS 2 nodes in domain {domain}')
    with tempfile.TemporaryDirectory(prefix='rosette_demo_') as folder:
        machine = Path(folder) / MACHINE
        write_machine(config, machine)
        with started(out, make_cell(config, machine, domain, logs)) as cell:
            out.print(f'  nodes are up after          {time.monotonic() - began:5.1f} s')
            with CellClient(domain) as client:
                outcome = calibrate(client, order=options.order, seed=options.seed,
                                    check=cell.check)
            if outcome.cancelled:
                print(f'rosette: {outcome.message}; what was measured is in {outcome.log}',
                      file=sys.stderr)
                return INTERRUPTED
            shutil.copy(machine, outcome.log / MACHINE)
            show(out, config, outcome.log, time.monotonic() - began)
            if options.keep:
                keep(out, cell, domain)
    return 0


def write_machine(config, path):
    """Write a machine configuration as YAML."""
    values = config.model_dump(mode='json', exclude={'hidden_draw'})
    path.write_text(yaml.safe_dump(values, sort_keys=False), encoding='utf-8')


def make_folder(path):
    """Make the folder for logs and return it; raises InvalidConfig where that cannot be."""
    logs = Path(path)
    try:
        logs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidConfig(f'{logs}: wanted a folder for logs, got: {error.strerror}; choose '
                            'another one with --output') from error
    return logs


def make_cell(config, machine, domain, logs):
    """Return the Cell with the simulated machine of a configuration."""
    params = {'sequencer': {
        'plate.balls': config.plate.balls, 'plate.radius_m': config.radius,
        'table.origin_m': [1e-3 * float(x) for x in config.placement.origin_mm]}}
    return Cell(domain, machine=machine, params=params, log_dir=logs)


@contextlib.contextmanager
def started(out, cell):
    """Start a cell, end it afterwards."""
    with contextlib.ExitStack() as stack:
        with out.status('starting the nodes'):
            stack.enter_context(cell)
        yield cell


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
    where = [('Picture', picture), ('Log', log_path), ('Machine', log_path / MACHINE)]
    out.print(pairs([(name, escape(shown(path))) for name, path in where]))
    out.print('\nNext:')
    for command in (f'evaluate {shown(log_path)}', f'info {shown(log_path)}',
                    f'replay {shown(log_path)}'):
        out.print(f'  rosette {command}', soft_wrap=True)


def compare(report: Report, config, frame):
    """Return the Comparison of a report with the machine's truth in the frame that was found."""
    motions = report.error_motions
    truth = remove_gauge(Machine(config).table_truth(motions.angle, frame))
    return Comparison(truth, (motions.values - truth) / motions.u)


def truth_table(comparison):
    """Return the table of differences to the truth, by curve."""
    made = table('difference to the truth', *CURVES)
    for name, values in (('rms in u', np.sqrt(np.mean(comparison.error**2, axis=0))),
                         ('largest in u', np.abs(comparison.error).max(axis=0))):
        made.add_row(name, *(fixed(float(value), 2) for value in values))
    return made


def shown(path):
    """Return a path as short as it can be typed from here."""
    path = Path(path).absolute()
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


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
