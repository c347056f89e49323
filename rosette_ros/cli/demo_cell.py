# SPDX-License-Identifier: Apache-2.0
"""A simulated cell of nodes in a free ROS domain, as the demonstrations measure with it."""

import contextlib
import random
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import Cell
from rosette_ros.cli.arguments import made_folder
from rosette_ros.cli.cell import calibrate, identity_parameter, refuse_second_cell, started
from rosette_ros.cli.hidden_demo import MACHINE, write_machine
from rosette_ros.core.run.errors import CellError
from rosette_ros.dme.dme_server import DmeServer, serving
from rosette_ros.dme.dme_settings import client_settings
from rosette_ros.simulation import MachineConfig

DME_SETTINGS = 'dme.yaml'
DOMAINS = range(1, 60)
"""Of demonstrations: the ports of domains below 102 lie below those that Linux assigns on its own; tests: 60 to 99."""


def free_domain() -> int:
    """Return a domain that nothing seems to use on this computer; raise CellError where all are in use."""
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        if is_free(domain):
            return domain
    raise CellError(f'ROS domain: expected a free one in 1 .. {DOMAINS[-1]}, found none; end other ROS programs or '
                    'choose one with --domain')


def is_free(domain: int) -> bool:
    """Whether nothing on this computer listens at the first ports of a domain."""
    with contextlib.suppress(OSError):
        for offset in (0, 10, 11):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(('', 7400 + 250 * domain + offset))  # DDS-RTPS 2.2, section 9.6.1.1
        return True
    return False


def make_cell(config: MachineConfig, machine: Path, domain: int, logs: Path, identity: str | None = None,
              dme: Path | None = None) -> Cell:
    """Return the cell with the simulated machine of a configuration, written to the file `machine`.

    dme: settings file of an I++ server behind which the machine is, None without one."""
    place = config.placement
    return Cell(domain, machine=machine, log_dir=logs, dme=dme, params={'recorder': {'simulated': True}, 'sequencer': {
        'plate.balls': config.plate.balls, 'plate.radius_m': config.radius,
        'table.origin_m': [1e-3 * float(x) for x in place.origin_mm],
        'table.axis': [float(x) for x in place.axis], 'table.azimuth_deg': place.azimuth_deg,
        **identity_parameter(identity)}})


@dataclass(frozen=True)
class DemoCell:
    """A running cell with a simulated machine: its client, the machine's file, the folder of the logs.

    server: that of I++ DME behind which the machine is, None without one."""

    cell: Cell
    client: CellClient
    machine: Path
    logs: Path
    began: float
    server: DmeServer | None = None

    @property
    def seconds(self) -> float:
        """Wall time since the beginning, s."""
        return time.monotonic() - self.began

    def calibrate(self, order: str, seed: int, options: str = '', **fields: Any) -> Path:
        """Run a calibration with progress on stderr; return the folder of its log, with the files of the machine.

        fields: others of the goal, as of CellClient.calibrate."""
        outcome = calibrate(self.client, order=order, seed=seed, options=options, check=self.cell.check, **fields)
        if outcome.log is None:
            raise CellError('demo: expected the log of the run, found none; see the output of the recorder')
        for path in self.machine.parent.iterdir():
            shutil.copy(path, outcome.log)
        return outcome.log


@contextlib.contextmanager
def demo_cell(out: Console, what: str, config: MachineConfig, domain: int | None, output: str,
              identity: str | None = None, has_server: bool = False) -> Iterator[DemoCell]:
    """Start a cell with a simulated machine, end it afterwards; what: printed; domain: None for a free one.

    identity: path of an identity file; has_server: the machine is behind an I++ DME server."""
    began = time.monotonic()
    is_given, domain = domain is not None, free_domain() if domain is None else domain
    logs = made_folder(output)
    out.print(f'{what}, machine drawn from seed {config.seed}; four ROS 2 nodes in domain {domain}')
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='rosette_demo_')))
        machine, dme, server = folder / MACHINE, None, None
        write_machine(config, machine)
        if has_server:
            port, server = stack.enter_context(serving(config))
            dme = folder / DME_SETTINGS
            dme.write_text(yaml.safe_dump(client_settings(config, port), sort_keys=False), 'utf-8')
            out.print(f'  I++ DME server on 127.0.0.1:{port}, one command per touch and move')
        prepared = make_cell(config, machine, domain, logs, identity, dme)
        if is_given:
            refuse_second_cell(out, prepared)
        with started(out, prepared) as cell, CellClient(domain) as client:
            made = DemoCell(cell, client, machine, logs, began, server)
            out.print(f'  nodes are running after     {made.seconds:5.1f} s')
            yield made
