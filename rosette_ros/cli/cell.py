# SPDX-License-Identifier: Apache-2.0
"""rosette cell: starts the nodes of a cell on this computer and restarts failed nodes."""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from rosette_ros import command
from rosette_ros.calibration.settings import IDENTITY
from rosette_ros.cell.client import CellClient, HangDetector
from rosette_ros.cell.supervisor import CHECK_PERIOD, MODULES, MOST_PARAMETERS, Cell
from rosette_ros.cli.arguments import IN_LOG, SHARED, UsageError, add_shared, made_folder
from rosette_ros.cli.console import console
from rosette_ros.core.errors import CellError, InvalidConfig
from rosette_ros.dme.dme_settings import sequencer_parameters
from rosette_ros.io.identity_file import read_identity
from rosette_ros.io.plate_file import read_plate
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.nodes import names
from rosette_ros.nodes.dme_cmm import settings_of
from rosette_ros.nodes.parameters import sections
from rosette_ros.simulation.machine_config import MachineConfig, load_machine

CMMS = ('simulated', 'dme')
DME = CMMS[1]
ROUNDING = 1e-9  # m


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--no-simulation', action='store_true',
                        help='without the simulated CMM: a real one answers, in wall time')
    parser.add_argument('--cmm', choices=CMMS, default=CMMS[0],
                        help='simulated (default), or one with an I++ DME server, in wall time')
    parser.add_argument('--settings', metavar='FILE', help='settings file of the CMM with an I++ DME server')
    parser.add_argument('--machine', metavar='FILE', help='describes the simulated machine '
                        '(default: the machine.yaml of the package)')
    parser.add_argument('--params', metavar='FILE', help='parameters of the nodes, such as cell.yaml')
    add_shared(parser, '--identity', help=IN_LOG)
    add_shared(parser, '--output', default=None, help='folder of the logs, one folder per run (default: log_dir of the '
               'recorder in --params, or rosette-runs)')
    add_shared(parser, '--namespace', '--domain')


def run(options: argparse.Namespace) -> None:
    """Start the cell, restart failed nodes until Ctrl-C, end it; raise CellError where one fails again and again."""
    if (options.cmm == DME) != bool(options.settings):
        raise UsageError('cell: wanted --cmm dme and --settings FILE together, got one of them')
    is_real = options.no_simulation or options.cmm == DME
    for path in filter(None, (options.machine, options.params, options.settings)):
        if not Path(path).is_file():
            raise InvalidConfig(f'{path}: wanted a YAML file, found none; check the path')
    if is_real and options.machine:
        raise InvalidConfig('cell: --machine describes a simulated CMM; remove --no-simulation or --cmm dme')
    if options.no_simulation and options.cmm == DME:
        raise UsageError('cell: --cmm dme starts a CMM; remove --no-simulation')
    if options.params and not is_real:
        refuse_other_plate(options.machine, options.params)
    cmm = settings_of(options.settings)[0] if options.settings else None
    out = console()
    nodes = [name for name in MODULES if not (options.no_simulation and name == names.CMM)]
    cell = Cell(options.domain, options.namespace, machine=options.machine, params_file=options.params, nodes=nodes,
                log_dir=made_folder(options.output or log_folder(options.params)), params={
                    names.SEQUENCER: identity_parameter(options.identity) | (sequencer_parameters(cmm) if cmm else {}),
                    names.RECORDER: {'simulated': True} if cmm and cmm.simulated else {}},
                simulated_time=not is_real, dme=options.settings)
    refuse_second_cell(out, cell)
    with started(out, cell):
        keep_running(out, cell)


def given_parameters(path: str, node: str) -> Iterator[dict[str, Any]]:
    """Yield the parameters of a node in each section of a parameter file; raises InvalidConfig where it is no YAML."""
    for name, given in sections(read_yaml(path, 'a parameter file', MOST_PARAMETERS, InvalidConfig)):
        if name.rpartition('/')[2] in (node, '*', '**') and isinstance(given, dict):
            yield given


def log_folder(params: str | None) -> str:
    """Return the folder of the logs that a parameter file states, or the usual one."""
    stated = [one['log_dir'] for one in (given_parameters(params, names.RECORDER) if params else ()) if
              isinstance(one.get('log_dir'), str)]
    return os.path.expanduser(stated[-1]) if stated else str(SHARED['--output']['default'])


def refuse_other_plate(machine: str | None, params: str) -> None:
    """Raise InvalidConfig where the simulated machine has not the places of the plate file in parameters."""
    for parameters in given_parameters(params, names.SEQUENCER):
        given = parameters.get('plate')
        if isinstance(given, dict) and given.get('file'):
            plate, config = read_plate(given['file']), load_machine(machine) if machine else MachineConfig()
            n = given.get('balls', config.plate.balls)
            if n != config.plate.balls or abs(plate.circle - config.radius) > ROUNDING:
                raise InvalidConfig(
                    f'{machine or "the simulated machine"}: plate: wanted balls: {n} and circle_radius_mm: '
                    f'{1e3 * plate.circle:.6g}, the places of {given["file"]} in {params}, got '
                    f'{config.plate.balls} and {config.plate.circle_radius_mm:g}')


def identity_parameter(path: str | None) -> dict[str, str]:
    """Return the parameter of the sequencer for an identity file; raises InvalidData where it is none."""
    if path is None:
        return {}
    read_identity(path)
    return {IDENTITY.name: str(Path(path).absolute())}


def keep_running(out: Console, cell: Cell) -> None:
    """Say how a cell is used; restart failed nodes and show what is new until Ctrl-C."""
    domain = int(os.environ.get('ROS_DOMAIN_ID') or 0) if cell.domain_id is None else cell.domain_id
    where = names.where(domain, cell.namespace)
    out.print(f'\n[bold]The cell is running[/]: {", ".join(cell.processes)} in domain {domain}, namespace '
              f'/{escape(cell.namespace)}; logs are written to {escape(str(cell.log_dir))}', soft_wrap=True)
    if names.CMM not in cell.processes:
        out.print('It waits for a CMM that answers probe_target with ball_centre (docs/real-cmm.md).')
    out.print(f'In another terminal:\n  {escape(command("calibrate", *where))}\nCtrl-C ends the cell.', soft_wrap=True)
    try:
        for words in cell.news():
            if not words.startswith(f'{names.SEQUENCER}: '):  # that it is complete is said above
                out.print(escape(words), soft_wrap=True)
        with contextlib.nullcontext() if has_no_enclave() else HangDetector(cell) as detector:
            while True:
                for words in cell.restart_failed(detector.hanging() if detector else ()).values():
                    print(f'{datetime.now():%H:%M:%S} {words}; restarted', file=sys.stderr, flush=True)
                for words in cell.news():
                    out.print(f'{datetime.now():%H:%M:%S} {escape(words)}', soft_wrap=True)
                time.sleep(CHECK_PERIOD)
    except KeyboardInterrupt:
        print('Ending the cell.', file=sys.stderr)


def has_no_enclave() -> bool:
    """Return whether SROS2 is in use: then this process sees nothing of the graph, as it has no enclave."""
    return os.environ.get('ROS_SECURITY_ENABLE', '').lower() == 'true'


def refuse_second_cell(out: Console, cell: Cell) -> None:
    """Raise CellError where a cell runs in the domain and namespace of one that shall be started.

    With SROS2 it cannot be seen: the sequencers refuse calibrations while there are two.
    """
    if has_no_enclave():
        return
    with out.status('searching for another cell'), CellClient(cell.domain_id, cell.namespace) as client:
        found = [name for name in client.running() if name in cell.nodes]  # a CMM of somebody else may be there already
    if found:
        where = 'this ROS domain' if cell.domain_id is None else f'domain {cell.domain_id}'
        raise CellError(f'cell: wanted no cell in {where} and namespace /{cell.namespace}, found {", ".join(found)}; '
                        'end that one, or give this one its own --domain or --namespace')


@contextlib.contextmanager
def started(out: Console, cell: Cell) -> Iterator[Cell]:
    """Start a cell, end it afterwards."""
    with contextlib.ExitStack() as stack:
        with out.status('starting the nodes'):
            stack.enter_context(cell)
        yield cell
