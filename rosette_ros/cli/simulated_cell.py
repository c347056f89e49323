# SPDX-License-Identifier: Apache-2.0
"""A simulated cell for the demonstrations: its machine's file, its folder, its nodes."""

import contextlib
from pathlib import Path

import yaml

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.nodes.cell import Cell

MACHINE = 'machine.yaml'


def write_machine(config, path):
    """Write a machine configuration as YAML."""
    values = config.model_dump(mode='json', exclude={'hidden_draw'})
    if config.hidden_draw is not None:
        values['hidden'] = config.hidden_draw.model_dump(mode='json', exclude_none=True)
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
