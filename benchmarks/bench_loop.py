# SPDX-License-Identifier: Apache-2.0
"""The closed loop of a cell against a bare rclpy round trip with the same messages.

Bare: two processes, one topic each way, a ProbeTarget there and a BallCentre back, nothing else.
Cell: four processes; every measurement is probed by the simulated machine (20 touches, sphere fit),
checked, stamped, recorded and collected for the evaluation. Usage: python benchmarks/bench_loop.py
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from rosette_msgs.msg import BallCentre, ProbeTarget

from rosette_ros.cell.client import CellClient, GraphClient
from rosette_ros.cell.supervisor import Cell, added_environment, cell_environment
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import qos

BALLS = 36
DOMAIN = 48
BARE_SECONDS = 5.0
MUST = 0.3
RUN_ID = 'rosette_20260412_083000_diagonal'


def echo():
    """Answer every target until standard input ends: the other side of the bare round trip."""
    rclpy.init()
    node = Node('echo')
    publisher = node.create_publisher(BallCentre, 'bare_centre', qos.ANSWER)

    def answer(target):
        centre = BallCentre(run_id=target.run_id, seq=target.seq, centre=target.centre)
        centre.header = target.header
        publisher.publish(centre)

    node.create_subscription(ProbeTarget, 'bare_target', answer, qos.ORDER)
    rclpy.spin(node)


class Bare(GraphClient):
    """The asking side of the bare round trip; a context manager."""

    def __init__(self):
        super().__init__('ask', DOMAIN + 1, '')
        self.publisher = self._node.create_publisher(ProbeTarget, 'bare_target', qos.ORDER)
        self._node.create_subscription(BallCentre, 'bare_centre', self._on_answer, qos.ANSWER)
        self.trips = 0

    def _on_answer(self, answer):
        self.trips += 1
        self.ask()

    def ask(self):
        """Send a target of usual size."""
        target = ProbeTarget(run_id=RUN_ID, seq=self.trips, balls=12, radius=0.1825)
        target.header.frame_id = 'machine'
        target.header.stamp = self._node.get_clock().now().to_msg()
        self.publisher.publish(target)

    def rate(self, seconds):
        """Return round trips per second, measured for so long."""
        while not (self.publisher.get_subscription_count() and self._node.count_publishers('bare_centre')):
            self._executor.spin_once(timeout_sec=0.1)
        if not self.trips:
            self.ask()
        trips, began = self.trips, time.perf_counter()
        while time.perf_counter() - began < seconds:
            self._executor.spin_once()
        return (self.trips - trips) / (time.perf_counter() - began)


def bare_rate():
    """Return round trips per second between this process and another one."""
    other = subprocess.Popen([sys.executable, __file__, 'echo'],
                             env=cell_environment(DOMAIN + 1), stderr=subprocess.DEVNULL)
    try:
        with Bare() as bare:
            bare.rate(0.5)
            return bare.rate(BARE_SECONDS)
    finally:
        other.kill()
        other.wait()


def cell_rate(folder):
    """Return (measurements per second in the n*n run, the Outcome)."""
    machine = folder / 'machine.yaml'
    machine.write_text(f'plate: {{balls: {BALLS}}}\n', encoding='utf-8')
    marks = []

    def mark(progress):
        if progress.phase == Phase.RUN:
            marks.append((time.perf_counter(), progress.done))

    with Cell(DOMAIN, machine=machine, params={'sequencer': {'plate.balls': BALLS}},
              log_dir=folder) as cell, CellClient(DOMAIN) as client:
        outcome = client.calibrate(on_progress=mark, check=cell.check)
    (began, first), (ended, last) = marks[0], marks[-1]
    return (last - first) / (ended - began), outcome


def main():
    """Print both rates and their ratio."""
    os.environ.update(added_environment(os.environ))
    before = bare_rate()
    with tempfile.TemporaryDirectory() as folder:
        loop, outcome = cell_rate(Path(folder))
    after = bare_rate()
    if not outcome.success:
        raise RuntimeError(outcome.message)
    bare = 0.5 * (before + after)
    print(f'closed loop, {BALLS} balls, {BALLS**2} measurements, recorded and evaluated')
    print(f'  bare rclpy round trip  {bare:8.0f} 1/s   ({before:.0f} before, {after:.0f} after)')
    print(f'  measurements of a cell {loop:8.0f} 1/s   ratio {loop / bare:.2f}   (wanted: {MUST})')


if __name__ == '__main__':
    echo() if sys.argv[1:] == ['echo'] else main()
