# SPDX-License-Identifier: Apache-2.0
"""The demo: a whole calibration in a simulated cell; the verification of the paper.

The machine behind a cell keeps its errors, clock and noise from run to run; what a person would switch in the firmware
or turn on the table, or a correction, is written to its file between two runs.
"""

import random
import shlex
import time
from argparse import ArgumentParser, Namespace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from rosette_ros.analysis import MOST_BALLS_ADVISED, MOST_BALLS_JUDGED, analyse, judge, summarise
from rosette_ros.api.documents import verification_of
from rosette_ros.calibration.settings import run_name
from rosette_ros.cli import hidden_demo
from rosette_ros.cli.arguments import IN_LOG, UsageError, add_shared, load, made_folder, number, until, whole
from rosette_ros.cli.console import console, doing, fit_rows, head, pairs, print_parts, print_verdict
from rosette_ros.cli.hidden_demo import MACHINE, compare, shown, write_machine
from rosette_ros.cli.report import print_result
from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.run.scheme import order_name, plan
from rosette_ros.invocation import command, program
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.text_file import write_text
from rosette_ros.io.type_definitions import StoredTypes
from rosette_ros.nodes.environment import check_middleware
from rosette_ros.presentation.formatting import millimetres
from rosette_ros.presentation.plots.plot_style import save
from rosette_ros.presentation.plots.result_plots import Series, six_curves
from rosette_ros.presentation.report import open_source, report_html
from rosette_ros.presentation.report.verification import MAKER_COLUMNS, ROLES, verification_html
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.presentation.tables import curves
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.effect_words import fixed
from rosette_ros.words.verdict_words import verdict_text

OFFLINE = ('--offline',)
MOST_RUNS = 100
NODES = 'demo without --offline'
TABLE = {'translation_um': 0.5, 'rotation_urad': 3.0, 'axial_correction': False, 'angular_correction': False}
"""The table of the demo has not been corrected yet: its errors stand above the noise."""


def demo_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--balls', metavar='N', type=whole(None, 72), default=12,
                        help='balls on the plate = table positions (default 12)')
    parser.add_argument('--order', help='order of measurement (default interleaved: it shows nearly all effects)')
    drawn = random.SystemRandom().randrange(10**6)
    parser.add_argument('--hidden', metavar='SEED', nargs='?', type=whole(0, 2**31), const=drawn,
                        help='hide physical effects in the machine, drawn from SEED (a new one if none is given), '
                        'the sealed envelope says which')
    parser.add_argument('--open', action='store_true', help='with --hidden: open the envelope '
                        'at the end (otherwise on a key press, or by rosette envelope RUN)')
    parser.add_argument('--runs', metavar='N', type=whole(1, MOST_RUNS), default=1, help='with --hidden: measure so '
                        'many runs of the machine, one after the other, to be diagnosed together')
    parser.add_argument('--until', metavar='P', type=until, help='with --hidden: measure on until what is hidden '
                        'is settled with this probability, such as 0.95')
    parser.add_argument('--verification', action='store_true', help="measure the paper's four runs under "
                        'different conditions and two more, and report how well they agree')
    parser.add_argument('--seed', type=whole(0, 2**31), default=1,
                        help='draws machine and noise, and the order random (default 1)')
    parser.add_argument('--axis', metavar=('X', 'Y', 'Z'), type=number('a direction'), nargs=3, default=(0.0, 0.0, 1.0),
                        help='direction of the table axis in the machine (default 0 0 1; 1 0 0: a table along x)')
    parser.add_argument('--dme', action='store_true', help='the machine is behind an I++ DME server and is measured '
                        'touch by touch, as a real CMM would be')
    add_shared(parser, '--identity', help=IN_LOG)
    add_shared(parser, '--output', '--angle-unit')
    add_shared(parser, '--domain', help='ROS domain (default: a free one)')
    parser.add_argument('--offline', action='store_true', help='measure without nodes, in this process: for any '
                        'computer, ROS 2 is not needed; the table is written as a log all the same')
    parser.add_argument('--keep', action='store_true', help='leave the cell running afterwards, until Ctrl-C')


def run_demo(options: Namespace) -> None:
    """Run the demo."""
    for name, given in (('--open', options.open), ('--until', options.until), ('--runs', options.runs > 1)):
        if given and options.hidden is None:
            raise InvalidConfig(f'demo: {name} goes with --hidden only; leave it out')
    if options.open and options.runs > 1:
        raise InvalidConfig('demo: --open goes with one run only; open each envelope by rosette envelope')
    if options.offline:
        for name in ('verification', 'dme', 'keep', 'domain', 'identity', 'until'):
            if getattr(options, name) not in (None, False):
                raise InvalidConfig(f'demo: --offline excludes --{name}, which needs nodes; leave out one of them')
    if options.verification:
        for name, given in (('--hidden', options.hidden is not None), ('--dme', options.dme),
                            ('--keep', options.keep)):
            if given:
                raise InvalidConfig(f'demo: --verification and {name} exclude each other; choose one')
        verify_method(options)
        return
    if options.dme and options.hidden is not None:
        raise InvalidConfig('demo: --dme and --hidden exclude each other: behind a server what is hidden follows the '
                            "machine's time, readings have the time of day; choose one")
    if not np.isfinite(options.axis).all() or not np.any(options.axis):
        raise UsageError('--axis: expected 3 finite numbers that are not all 0, found '
                         f'{" ".join(f"{x:g}" for x in options.axis)}')
    hidden = {} if options.hidden is None else {'hidden': {'seed': options.hidden, **hidden_demo.SIZES}}
    order = order_name(options.order or 'interleaved')
    plan(options.balls, order, options.seed)  # refuses what cannot be measured
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls}, table=TABLE,
                                     placement={'axis': options.axis}, **hidden)
    out = console()
    if options.offline:
        measure_offline(out, config, order, options)
        return
    what = f'[bold]A simulated cell[/]: {options.balls} balls, order {order}'
    with in_cell().demo_cell(out, what, config, options.domain, options.output, options.identity,
                             options.dme) as running:
        if hidden:
            hidden_demo.seal(out, Machine(config), options.hidden, running.machine.parent)
        log_path = running.calibrate(order, options.seed, 'turning: forward', until_probability=options.until)
        if options.until:
            hidden_demo.show_added(out, log_path, config.plate.balls**2)
        if hidden and options.runs > 1:
            paths = [log_path, *(running.calibrate(order, options.seed + place, 'turning: forward',
                                                   until_probability=options.until)
                                 for place in range(1, options.runs))]
            hidden_demo.show_runs(out, paths)
        elif hidden:
            hidden_demo.show_hidden(out, config, options.hidden, order, log_path, running.seconds, options.open,
                                    options.until)
        else:
            server = running.server
            show_demo(out, config, log_path, running.seconds,
                      None if server is None else server.commands.cmm.clock.now())
        if options.keep:
            running.cell.news()  # its warnings were shown while it measured
            load('rosette_ros.cli.cell', NODES).keep_running(out, running.cell)


def in_cell() -> ModuleType:
    """Import what measures with nodes; raises UsageError where there is no ROS 2."""
    check_middleware()
    return load('rosette_ros.cli.demo_cell', NODES)


def measure_offline(out: Console, config: MachineConfig, order: str, options: Namespace) -> None:
    """Let the machine measure in this process, write its readings as a log, and print as after a run in a cell."""
    began, folder, machine = time.monotonic(), made_folder(options.output), Machine(config)
    out.print(f'[bold]A simulated machine[/]: {options.balls} balls, order {order}, '
              f'drawn from seed {config.seed}; no nodes')
    paths = list[Path]()
    for place in range(options.runs):
        log_path = folder / run_name(datetime.now(UTC), order, [path.name for path in folder.iterdir()])
        before = machine.state
        run = machine.run(plan(options.balls, order, options.seed + place), run_id=log_path.name)
        write_log(run, log_path, StoredTypes())
        write_machine(config, log_path / MACHINE)
        if options.hidden is not None:
            hidden_demo.seal(None if paths else out, Machine(config, before), options.hidden, log_path)
        paths.append(log_path)
    if options.runs > 1:
        hidden_demo.show_runs(out, paths)
    elif options.hidden is not None:
        hidden_demo.show_hidden(out, config, options.hidden, order, log_path, time.monotonic() - began, options.open,
                                offline=OFFLINE)
    else:
        show_demo(out, config, log_path, time.monotonic() - began, offline=OFFLINE)


def show_demo(out: Console, config: MachineConfig, log_path: Path, seconds: float,
              machine_s: float | None = None, offline: tuple[str, ...] = ()) -> None:
    """Print the results beside the truth, write picture and report.

    machine_s: time of the machine behind a server; offline: option of the demo where it measured without nodes."""
    run, source = open_source(log_path)
    summary = summarise(run, has_ladder=False) if run.n <= MOST_BALLS_ADVISED else None
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
        write_text(where['Report'], report_html(summary, source, shlex.join(['rosette', 'report', shown(log_path)])))
    where |= {'Log': log_path, 'Machine': log_path / MACHINE}
    out.print(pairs([(name, escape(shown(path))) for name, path in where.items()]))
    out.print('\nNext, a machine with hidden effects, to be found from the readings:')
    out.print(f'  {escape(command("demo", *offline, "--hidden"))}', soft_wrap=True)
    out.print('This run again:')
    for verb in ('evaluate', 'studio', 'info', *([] if offline else ['replay'])):
        out.print(f'  {escape(command(verb, shown(log_path)))}', soft_wrap=True)
    if program() != 'rosette':
        out.print(f'To type just rosette: {escape(command("shell"))}', soft_wrap=True)


def conditions(balls: int) -> tuple[dict[str, Any], ...]:
    """Return what is changed in the machine's configuration for each run, in the order of ROLES."""
    turned = {'clamping': {'plate_turn_deg': 360 / balls * max(1, round(balls / 4))}}
    cmm_off = {'cmm': {'correction': False}}
    return ({}, turned, cmm_off, {**cmm_off, 'table': {'axial_correction': False}},
            {'table': {'angular_correction': False}}, {})


def verify_method(options: Namespace) -> None:
    """Measure all runs in one cell, write the maker's table and the report, and print where they are."""
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls},
                                     placement={'axis': options.axis})
    order, out, paths = order_name(options.order or 'diagonal'), console(), []
    what = f'[bold]The verification of the paper[/]: {len(ROLES)} runs of {options.balls} balls, order {order}'
    with in_cell().demo_cell(out, what, config, options.domain, options.output, options.identity) as running:
        for (label, _), changes in zip(ROLES, conditions(options.balls), strict=True):
            write_machine(config.changed(**changes), running.machine)
            out.print(f'[bold]{escape(label)}[/]')
            paths.append(running.calibrate(order, options.seed))
    seconds, name = running.seconds, f'verification_{paths[0].name}'
    maker, page = running.logs / f'{name}_maker.csv', running.logs / f'{name}.html'
    write_text(maker, maker_table(Machine(config)))
    verification = verification_of(paths, maker, doing=doing)
    again = ['report', '--compare', *map(shown, paths), '--maker', shown(maker)]
    write_text(page, verification_html(verification, shlex.join(['rosette', *again])))
    out.print(f'\nTook {seconds:.1f} s; a real cell would have measured for '
              f'{sum(one.fit.run.time[-1] for one in verification.members) / 3600:.1f} h\n')
    print_result(out, verification.verdict, shown(page))
    out.print('\nAgain from the logs:')
    out.print(f'  {escape(command(*again))}', soft_wrap=True)


def maker_table(machine: Machine) -> str:
    """Return the correction tables of the table's maker as CSV text."""
    angle = nominal_angles(72)  # many more supporting points than a plate has balls
    curves = 1e6 * machine.maker_table(angle)
    lines = [f'{degrees:g},{row[2] + 0.0:.6f},{row[5] + 0.0:.6f}' for degrees, row in zip(np.rad2deg(angle), curves)]
    return '\n'.join([','.join(MAKER_COLUMNS), *lines]) + '\n'


IMPLEMENTED = {'demo': (demo_arguments, run_demo)}
