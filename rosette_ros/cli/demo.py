# SPDX-License-Identifier: Apache-2.0
"""rosette demo: a whole calibration in a simulated cell, up to the six error motions and a report."""

import argparse
import random
import shlex
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from rosette_ros import command, program
from rosette_ros.analysis import MOST_BALLS_ADVISED, MOST_BALLS_JUDGED, analyse, judge, summarise
from rosette_ros.cli import circle_demo, hidden_demo, verification_demo
from rosette_ros.cli.arguments import IN_LOG, UsageError, add_shared, whole
from rosette_ros.cli.cell import keep_running
from rosette_ros.cli.console import console, fit_rows, head, pairs, print_parts, print_verdict
from rosette_ros.cli.demo_cell import MACHINE, compare, demo_cell, shown
from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.records import CURVES
from rosette_ros.core.scheme import plan
from rosette_ros.io.log_reader import read_log
from rosette_ros.presentation.formatting import fixed, millimetres
from rosette_ros.presentation.plots.plot_style import save
from rosette_ros.presentation.plots.result_plots import Series, six_curves
from rosette_ros.presentation.report import open_source, write_report
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.presentation.tables import curves
from rosette_ros.simulation import MachineConfig
from rosette_ros.words.verdict_words import verdict_text

TABLE = {'translation_um': 0.2, 'rotation_urad': 1.5, 'axial_correction': False, 'angular_correction': False}
"""The table of the demo has not been corrected yet: its errors stand above the noise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--balls', metavar='N', type=whole(None, 72), default=12,
                        help='balls on the plate = table positions (default 12)')
    parser.add_argument('--order', help='order of measurement (default diagonal; with --hidden one that shows effects)')
    drawn = random.SystemRandom().randrange(10**6)
    parser.add_argument('--hidden', metavar='SEED', nargs='?', type=whole(0, 2**31), const=drawn,
                        help='hide physical effects in the machine, drawn from SEED (a new one if none is given), '
                        'the sealed envelope says which')
    parser.add_argument('--open', action='store_true', help='with --hidden: show all results and open the envelope '
                        'at the end (otherwise on a key press, or by rosette envelope RUN)')
    parser.add_argument('--verification', action='store_true', help="measure the paper's four runs under "
                        'different conditions and two more, and report how well they agree')
    parser.add_argument('--circle', action='store_true', help='calibrate, find what is missing, add it, correct the '
                        'table, calibrate again: the error falls to the noise')
    parser.add_argument('--seed', type=whole(0, 2**31), default=1,
                        help='draws machine and noise, and the order random (default 1)')
    parser.add_argument('--axis', metavar=('X', 'Y', 'Z'), type=float, nargs=3, default=(0.0, 0.0, 1.0),
                        help='direction of the table axis in the machine (default 0 0 1; 1 0 0: a table along x)')
    parser.add_argument('--dme', action='store_true', help='the machine is behind an I++ DME server and is measured '
                        'touch by touch, as a real CMM would be')
    add_shared(parser, '--identity', help=IN_LOG)
    add_shared(parser, '--output')
    add_shared(parser, '--domain', help='ROS domain (default: a free one)')
    parser.add_argument('--keep', action='store_true', help='leave the cell running afterwards, until Ctrl-C')


def run(options: argparse.Namespace) -> None:
    """Run the demo."""
    if options.open and options.hidden is None:
        raise InvalidConfig('demo: --open goes with --hidden only; leave it out')
    if options.verification:
        for name, given in (('--hidden', options.hidden is not None), ('--dme', options.dme),
                            ('--circle', options.circle), ('--keep', options.keep)):
            if given:
                raise InvalidConfig(f'demo: --verification and {name} exclude each other; choose one')
        verification_demo.run(options)
        return
    if options.circle and (options.hidden is not None or options.keep or options.dme):
        raise InvalidConfig('demo: --circle excludes --hidden, --keep and --dme; choose one')
    if options.dme and options.hidden is not None:
        raise InvalidConfig('demo: --dme and --hidden exclude each other: behind a server what is hidden follows the '
                            "machine's time, readings have the time of day; choose one")
    if not np.isfinite(options.axis).all() or not np.any(options.axis):
        raise UsageError('--axis: wanted 3 finite numbers that are not all 0, got '
                         f'{" ".join(f"{x:g}" for x in options.axis)}')
    if options.circle:
        circle_demo.run(options)
        return
    hidden = {} if options.hidden is None else {'hidden': {'seed': options.hidden, **hidden_demo.SIZES}}
    order = options.order or ('sensitive' if hidden else 'diagonal')
    plan(options.balls, order, options.seed)  # refuses what cannot be measured
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls}, table=TABLE,
                                     placement={'axis': options.axis}, **hidden)
    out = console()
    what = f'[bold]A simulated cell[/]: {options.balls} balls, order {order}'
    with demo_cell(out, what, config, options.domain, options.output, options.identity, options.dme) as running:
        if hidden:
            hidden_demo.seal(out, config, options.hidden, running.machine.parent)
        log_path = running.calibrate(order, options.seed, 'turning: forward')
        if hidden:
            hidden_demo.show(out, config, options.hidden, order, log_path, running.seconds, options.open)
        else:
            server = running.server
            show(out, config, log_path, running.seconds, None if server is None else server.commands.cmm.clock.now())
        if options.keep:
            running.cell.news()  # its warnings were shown while it measured
            keep_running(out, running.cell)


def show(out: Console, config: MachineConfig, log_path: Path, seconds: float, machine_s: float | None = None) -> None:
    """Print the results beside the truth, write picture and report; machine_s: time of the machine behind a server."""
    run, source = open_source(log_path)
    summary = summarise(run) if run.n <= MOST_BALLS_ADVISED else None
    fit = analyse(run) if summary is None else summary.fit
    comparison, two = compare(fit, config, read_log(log_path).frame_of(run.run_id)), partial(fixed, places=2)
    title = f'Six error motions of a simulated rotary table: {run.n} balls on R = {millimetres(run.radius)}'
    where = {'Picture': log_path / 'six-curves.png'}
    save(six_curves([Series('measured', fit.error_motions)], title, comparison.truth), where['Picture'])
    out.print(f'\n{head(run)}\n')
    if run.n <= MOST_BALLS_JUDGED:
        print_verdict(out, verdict_text(judge(run) if summary is None else summary.verdict))
    print_parts(out, [
        curves(fit.error_motions), pairs(fit_rows(fit)),
        Table('truth', 'Difference to the truth in standard uncertainties', (
            words('curve', 'curve', CURVES), column('rms', 'rms', np.sqrt(np.mean(comparison.error**2, axis=0)), two),
            column('largest', 'largest', np.abs(comparison.error).max(axis=0), two)))])
    spread = 2 / np.sqrt(2 * (comparison.error.size - 10))  # 6 n values, ten of them fixed by the gauge
    passed = 'passed' if abs(comparison.rms - 1) <= spread else 'not passed'
    out.print(f'\nDifference to the truth: [bold]rms {comparison.rms:.2f}[/] standard uncertainties; expected '
              f'{1 - spread:.2f} to {1 + spread:.2f}: {passed}')
    out.print(f'Took {seconds:.1f} s; a real cell would have measured for '
              f'{(run.time[-1] if machine_s is None else machine_s) / 3600:.1f} h\n')
    if summary is not None:
        where['Report'] = log_path / 'report.html'
        write_report(where['Report'], summary, source, shlex.join(['rosette', 'report', shown(log_path)]))
    where |= {'Log': log_path, 'Machine': log_path / MACHINE}
    out.print(pairs([(name, escape(shown(path))) for name, path in where.items()]))
    out.print('\nNext:')
    for verb in ('evaluate', 'studio', 'info', 'replay'):
        out.print(f'  {escape(command(verb, shown(log_path)))}', soft_wrap=True)
    if program() != 'rosette':
        out.print(f'To type just rosette: {escape(command("shell"))}', soft_wrap=True)
