# SPDX-License-Identifier: Apache-2.0
"""rosette demo --verification: the runs by which the paper verifies the method, over real nodes.

The machine knows its real errors. What a person would switch in the firmware or turn on the table is
changed in the machine's file between two runs; machine, clock and noise go on.
"""

import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.markup import escape

from rosette_ros.cli.calibrate import calibrate
from rosette_ros.cli.domain import free_domain
from rosette_ros.cli.report import say, verification_of
from rosette_ros.cli.screen import console
from rosette_ros.cli.simulated_cell import MACHINE, make_cell, make_folder, started, write_machine
from rosette_ros.cli.truth import shown
from rosette_ros.core.errors import CellError
from rosette_ros.core.geometry import nominal_angles
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.nodes.client import CellClient
from rosette_ros.report.page import write_text
from rosette_ros.report.verification import MAKER_COLUMNS, ROLES
from rosette_ros.report.verification_page import verification_html

CMM_OFF = {'cmm': {'correction': False}}
AXIAL_OFF = {**CMM_OFF, 'table': {'axial_correction': False}}
MAKER, SUPPORTING_POINTS = 'maker.csv', 72
"""A maker's correction table has many more supporting points than a plate has balls."""


def conditions(balls):
    """Return what is changed in the machine's configuration for each run, in the order of ROLES."""
    turned = {'clamping': {'plate_turn_deg': 360 / balls * max(1, round(balls / 4))}}
    return ({}, turned, CMM_OFF, AXIAL_OFF, {'table': {'angular_correction': False}}, {})


def run(options):
    """Measure all runs in one cell, and report."""
    began = time.monotonic()
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls})
    order = options.order or 'diagonal'
    domain = free_domain() if options.domain is None else options.domain
    logs = make_folder(options.output)
    out = console()
    out.print(f'[bold]The verification of the paper[/]: {len(ROLES)} runs of {options.balls} balls, order {order}, '
              f'machine drawn from seed {options.seed}; four ROS 2 nodes in domain {domain}')
    with tempfile.TemporaryDirectory(prefix='rosette_demo_') as folder:
        machine = Path(folder) / MACHINE
        write_machine(config, machine)
        with started(out, make_cell(config, machine, domain, logs)) as cell:
            out.print(f'  nodes are up after          {time.monotonic() - began:5.1f} s')
            with CellClient(domain) as client:
                paths = [measure(out, cell, client, config.changed(**changes), machine, label, order, options.seed)
                         for (label, _), changes in zip(ROLES, conditions(options.balls), strict=True)]
    tell(out, config, paths, logs, time.monotonic() - began)


def measure(out, cell, client, config, machine, label, order, seed):
    """Measure one run under changed conditions and return the path of its log."""
    write_machine(config, machine)
    out.print(f'[bold]{escape(label)}[/]')
    outcome = calibrate(client, order=order, seed=seed, check=cell.check)
    if outcome.cancelled:
        raise CellError(f'{outcome.message}; what was measured is in {outcome.log}')
    shutil.copy(machine, outcome.log / MACHINE)
    return outcome.log


def tell(out, config, paths, logs, seconds):
    """Write the maker's table and the report, and print where they are."""
    name = f'verification_{paths[0].name}'
    maker, page = logs / f'{name}_{MAKER}', logs / f'{name}.html'
    write_text(maker, maker_table(Machine(config)))
    verification = verification_of(paths, maker)
    command = ' '.join(['rosette report --compare', *(shown(path) for path in paths), '--maker', shown(maker)])
    write_text(page, verification_html(verification, command))
    out.print(f'\nTook {seconds:.1f} s; a real cell would have measured for '
              f'{sum(one.report.run.time[-1] for one in verification.members) / 3600:.1f} h\n')
    say(out, verification.verdict, shown(page))
    out.print('\nAgain from the logs:')
    out.print(f'  {escape(command)}', soft_wrap=True)


def maker_table(machine):
    """Return the correction tables of the table's maker as CSV text."""
    angle = nominal_angles(SUPPORTING_POINTS)
    curves = 1e6 * machine.maker_table(angle)
    lines = [','.join(MAKER_COLUMNS)]
    lines += [f'{degrees:g},{row[2] + 0.0:.6f},{row[5] + 0.0:.6f}'
              for degrees, row in zip(np.rad2deg(angle), curves, strict=True)]
    return '\n'.join(lines) + '\n'
