# SPDX-License-Identifier: Apache-2.0
"""rosette demo --verification: the runs by which the paper verifies the method, over real nodes.

The machine knows its real errors. What a person would switch in the firmware or turn on the table is changed in the
machine's file between two runs; machine, clock and noise continue.
"""

import shlex
from argparse import Namespace
from typing import Any

import numpy as np
from rich.markup import escape

from rosette_ros import command
from rosette_ros.cli.console import console
from rosette_ros.cli.demo_cell import demo_cell, shown, write_machine
from rosette_ros.cli.report import print_result, verification_of
from rosette_ros.core.geometry import nominal_angles
from rosette_ros.io.text_file import write_text
from rosette_ros.presentation.report.verification import MAKER_COLUMNS, ROLES, verification_html
from rosette_ros.simulation import Machine, MachineConfig


def conditions(balls: int) -> tuple[dict[str, Any], ...]:
    """Return what is changed in the machine's configuration for each run, in the order of ROLES."""
    turned = {'clamping': {'plate_turn_deg': 360 / balls * max(1, round(balls / 4))}}
    cmm_off = {'cmm': {'correction': False}}
    return ({}, turned, cmm_off, {**cmm_off, 'table': {'axial_correction': False}},
            {'table': {'angular_correction': False}}, {})


def run(options: Namespace) -> None:
    """Measure all runs in one cell, write the maker's table and the report, and print where they are."""
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls},
                                     placement={'axis': options.axis})
    order, out, paths = options.order or 'diagonal', console(), []
    what = f'[bold]The verification of the paper[/]: {len(ROLES)} runs of {options.balls} balls, order {order}'
    with demo_cell(out, what, config, options.domain, options.output, options.identity) as running:
        for (label, _), changes in zip(ROLES, conditions(options.balls), strict=True):
            write_machine(config.changed(**changes), running.machine)
            out.print(f'[bold]{escape(label)}[/]')
            paths.append(running.calibrate(order, options.seed))
    seconds, name = running.seconds, f'verification_{paths[0].name}'
    maker, page = running.logs / f'{name}_maker.csv', running.logs / f'{name}.html'
    write_text(maker, maker_table(Machine(config)))
    verification = verification_of(paths, maker)
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
