# SPDX-License-Identifier: Apache-2.0
"""Opening logs: a recorded run of 12 balls and an imported one of 72 (5184 ball centres), beside other readers.

Ours decodes targets, answers, states and results and verifies every checksum; mcap-ros2-support and rosbags decode
the ball centres only. All have to give the same numbers, bit for bit.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from rosette_ros.core.run.geometry import Floats
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_run import BALL_CENTRE
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.type_definitions import TypeLibrary

RECORDED = Path(__file__).parents[1] / 'test' / 'golden' / 'logs' / 'log_creep_n12_diagonal'
BALLS = 72
RADIUS = 0.1825
REPEATS = 5
WANTED = {12: 0.02, BALLS: 0.4}
"""Number of balls: the time in which the log opens, s."""


def measured(n: int) -> Run:
    """Return a complete run of n balls with noise everywhere."""
    scheme, rng = plan(n, 'diagonal'), np.random.default_rng(1)
    noise = 1e-6 * rng.standard_normal((n * n, 4))
    return Run(
        n, RADIUS, scheme.table_position, scheme.ball, scheme.centres(RADIUS) + noise[:, :3],
        table_angle=scheme.table_angle + noise[:, 3], approach=scheme.approach,
        time=30.0 * np.arange(n * n), temperature=20 + rng.random(n * n), run_id='benchmark')


def by_us(path: Path) -> Floats:
    """Return centre, angle and temperature of every ball centre, (N, 5), by rosette_ros."""
    return np.array([(*one.centre, one.table_angle, one.temperature) for one in read_log(path).answers])


def by_mcap_ros2_support(path: Path) -> Floats:
    """Return the same by mcap-ros2-support, in the order of the file."""
    with open(next(path.glob('*.mcap')), 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return table(entry.decoded_message for entry in reader.iter_decoded_messages(
            topics=['/rosette/ball_centre'], log_time_order=False))


def by_rosbags(path: Path) -> Floats:
    """Return the same by rosbags."""
    with AnyReader([path]) as reader:
        wanted = [entry for entry in reader.connections if entry.msgtype == BALL_CENTRE]
        return table(reader.deserialize(data, BALL_CENTRE) for _, _, data in reader.messages(wanted))


def table(messages: Iterable[Any]) -> Floats:
    """Return the numbers of decoded messages, (N, 5)."""
    return np.array([(message.centre.x, message.centre.y, message.centre.z, message.table_angle, message.temperature)
                     for message in messages])


def timed(read: Callable[[Path], Floats], path: Path) -> tuple[Floats, float]:
    """Return (numbers, shortest processor time in s): all are single-threaded."""
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        numbers = read(path)
        times.append(time.process_time() - begin)
    return numbers, min(times)


def compare(path: Path, balls: int, source: str) -> None:
    """Print the times for one log."""
    ours, shortest = timed(by_us, path)
    print(f'{balls} balls, {source}, {len(ours)} ball centres\n'
          f'  {"rosette_ros":<20} {1e3 * shortest:8.1f} ms   wanted: at most {1e3 * WANTED[balls]:.0f} ms')
    for name, read in (('mcap-ros2-support', by_mcap_ros2_support), ('rosbags', by_rosbags)):
        theirs, needed = timed(read, path)
        same = 'same to the last bit' if ours.tobytes() == theirs.tobytes() else 'DIFFERENT NUMBERS'
        print(f'  {name:<20} {1e3 * needed:8.1f} ms   {same}')


def main() -> None:
    """Print the times of both logs."""
    compare(RECORDED, 12, 'recorded by a cell')
    prefixes = os.environ.get('AMENT_PREFIX_PATH') or sys.prefix
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        path = write_log(measured(BALLS), Path(folder, 'benchmark'), TypeLibrary(prefixes.split(os.pathsep)))
        print(f'writing {BALLS} balls takes {time.process_time() - begin:.2f} s')
        compare(path, BALLS, 'imported')


if __name__ == '__main__':
    main()
