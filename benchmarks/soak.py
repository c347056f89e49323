# SPDX-License-Identifier: Apache-2.0
"""A cell that calibrates for long: every message in its log, memory flat: python -m benchmarks.soak [--balls N].

One calibration after the other over DDS, until so many balls are measured. After each one its log is read back by the
mcap library, counted against what was asked, and deleted. The resident memory of each node is noted after each run.
"""

import argparse
import itertools
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.recorder_rate import KINDS, memory_of, seqs_in
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import MODULES
from rosette_ros.cli.demo_cell import make_cell
from rosette_ros.cli.hidden_demo import write_machine
from rosette_ros.simulation import MachineConfig

DOMAIN = 47
ORDERS = ('diagonal', 'row', 'column', 'random')
REPEATS = 10
FLAT_MB = 10.0
"""A node that grows by more over the second half of the soak, MB, fails it."""
MB = 1 << 20


def soak(measurements, balls, folder):
    """Run the cell; return (balls measured, seconds, MB by node and run, messages lost, problems)."""
    config = MachineConfig().changed(seed=1, plate={'balls': balls})
    machine = folder / 'machine.yaml'
    write_machine(config, machine)
    memory, measured, lost, problems = {name: [] for name in MODULES}, 0, 0, []
    total = REPEATS + 2 * balls + balls**2 + 1
    with make_cell(config, machine, DOMAIN, folder / 'logs') as cell, CellClient(DOMAIN) as client:
        began = time.monotonic()
        for number, order in zip(itertools.count(1), itertools.cycle(ORDERS)):
            if measured >= measurements:
                break
            outcome = client.calibrate(order=order, seed=number, check=cell.check)
            if not outcome.success:
                problems.append(f'{outcome.run_id}: {outcome.message}')
                break
            for name, (kind, _) in KINDS.items():
                lost += len({*range(1, total + 1)} - {*seqs_in(outcome.log, name, kind, validate_crcs=True)})
            shutil.rmtree(outcome.log)
            measured += total
            for name in MODULES:
                memory[name].append(memory_of(cell.processes[name].popen.pid, 'VmRSS') / MB)
            if sys.stderr.isatty():
                print(f'\r{measured} of {measurements}', end='', file=sys.stderr)
        return measured, time.monotonic() - began, memory, lost, problems


def main(arguments=None):
    """Soak and print what was seen; return 1 where a message was lost or a node grew."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.soak', description=__doc__.partition('\n')[0])
    parser.add_argument('--measurements', type=int, default=100_000, help='balls in all (default 100000)')
    parser.add_argument('--balls', type=int, default=36, help='balls of the plate (default 36)')
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix='rosette_soak_') as folder:
        measured, seconds, memory, lost, problems = soak(options.measurements, options.balls, Path(folder))
    runs = len(next(iter(memory.values())))
    print(f'\n{measured} measurements in {runs} calibrations of {options.balls} balls, {seconds:.0f} s; '
          f'{lost} targets or answers lost')
    print(f'{"node":12}{"MB after run 1":>16}{"half-way":>12}{"at the end":>12}{"growth":>10}')
    grown = False
    for name, values in memory.items() if runs else ():
        half = values[len(values) // 2:]
        # The slope over the second half: start-up, caches and pools have settled by then.
        growth = np.polyfit(np.arange(len(half)), half, 1)[0] * len(half) if len(half) > 2 else 0.0
        grown |= growth > FLAT_MB
        print(f'{name:12}{values[0]:16.1f}{half[0]:12.1f}{values[-1]:12.1f}{growth:10.1f}')
    for problem in problems:
        print(problem)
    return int(bool(lost or problems or grown))


if __name__ == '__main__':
    sys.exit(main())
