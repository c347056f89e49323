# SPDX-License-Identifier: Apache-2.0
"""A log of 200 704 ball centres into arrays: against mcap-ros2-support and rosbags.

Ours decodes the targets as well and checks every checksum; the peers decode the ball centres only.
All three have to give the same numbers, bit for bit.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from rosette_ros.core.records import Run
from rosette_ros.core.scheme import plan
from rosette_ros.data.log_reader import BALL_CENTRE, read_log
from rosette_ros.data.run_log import ANSWER_TOPIC, write_log
from rosette_ros.data.schemas import TypeLibrary

BALLS = 448
RADIUS = 0.1825
REPEATS = 3
MUST, AIM = 10, 25


def measured(n):
    """Return a complete run of n balls with noise everywhere."""
    scheme, rng = plan(n, 'diagonal'), np.random.default_rng(1)
    noise = 1e-6 * rng.standard_normal((n * n, 4))
    return Run.from_readings(
        n, RADIUS, scheme.table_position, scheme.ball, scheme.centres(RADIUS) + noise[:, :3],
        table_angle=scheme.table_angle + noise[:, 3], approach=scheme.approach,
        time=30.0 * np.arange(n * n), temperature=20 + rng.random(n * n), run_id='benchmark')


def by_us(path):
    """Return (centre, angle, temperature) by rosette_ros."""
    answers = read_log(path).answers
    return answers.centre, answers.table_angle, answers.temperature


def by_mcap_ros2_support(path):
    """Return the same by mcap-ros2-support, in the order of the file."""
    with open(next(path.glob('*.mcap')), 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return columns(entry.decoded_message for entry in reader.iter_decoded_messages(
            topics=[ANSWER_TOPIC], log_time_order=False))


def by_rosbags(path):
    """Return the same by rosbags."""
    with AnyReader([path]) as reader:
        wanted = [entry for entry in reader.connections if entry.msgtype == BALL_CENTRE]
        return columns(reader.deserialize(data, BALL_CENTRE)
                       for _, _, data in reader.messages(wanted))


def columns(messages):
    """Return (centre, angle, temperature) of decoded messages."""
    table = np.array([(message.centre.x, message.centre.y, message.centre.z, message.table_angle,
                       message.temperature) for message in messages])
    return table[:, :3], table[:, 3], table[:, 4]


def timed(read, path, repeats=1):
    """Return (arrays, shortest processor time in s): all are single-threaded."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        arrays = read(path)
        times.append(time.process_time() - begin)
    return arrays, min(times)


def main():
    """Print the times and their ratios."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH') or sys.prefix
    library = TypeLibrary(prefixes.split(os.pathsep))
    run = measured(BALLS)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        path = write_log(run, Path(folder, 'benchmark'), library)
        writing = time.process_time() - begin
        ours, shortest = timed(by_us, path, REPEATS)
        print(f'log -> arrays, {run.size} ball centres and as many targets '
              f'({2 * run.size / writing:,.0f} messages/s written)')
        print(f'  {"rosette_ros":<20} {shortest:8.2f} s')
        for name, read in (('mcap-ros2-support', by_mcap_ros2_support), ('rosbags', by_rosbags)):
            theirs, needed = timed(read, path)
            same = all(one.tobytes() == other.tobytes()
                       for one, other in zip(ours, theirs, strict=True))
            print(f'  {name:<20} {needed:8.2f} s   ratio {needed / shortest:6.1f}   '
                  f'{"same to the last bit" if same else "DIFFERENT NUMBERS"}')
    print(f'  wanted against mcap-ros2-support: at least {MUST}, aim {AIM}')


if __name__ == '__main__':
    main()
