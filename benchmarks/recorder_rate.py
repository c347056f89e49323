# SPDX-License-Identifier: Apache-2.0
"""Whether the recorder loses a message at a high rate: python -m benchmarks.recorder_rate [--rate N] [--seconds S].

The recorder node runs in a process and ROS domain of its own; its log is opened and closed by its services. Two
processes publish ProbeTarget and BallCentre as in a cell: rclpy, the same topics, reliable. They keep what is not
acknowledged (history: keep all), so that a rate that they keep is one that arrives. The log is read by the mcap
library: every seq has to be in it, once.
"""

import argparse
import copy
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import rclpy
from mcap.reader import make_reader
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy
from rclpy.serialization import deserialize_message
from rosette_msgs.msg import BallCentre, ProbeTarget
from rosette_msgs.srv import StartRecording, StopRecording

from rosette_ros.cell.client import GraphClient
from rosette_ros.cell.supervisor import Cell, added_environment, cell_environment
from rosette_ros.nodes import names, qos

DOMAIN = 101
KINDS = {names.PROBE_TARGET: (ProbeTarget, qos.TARGET), names.BALL_CENTRE: (BallCentre, qos.ANSWER)}
RUN_ID = 'rosette_20260412_083000_diagonal'
PATIENCE = 60.0
MB = 1e6


@dataclass(frozen=True)
class Result:
    """What was sent and what is in the log; rate: kept by the slower publisher, 1/s; cpu: s; memory: at most, bytes."""

    rate: float
    sent: int
    lost: int
    repeated: int
    cpu: float
    memory: int

    def __str__(self):
        return (f'{self.rate:.0f} messages/s kept by each of two publishers, {self.sent} sent, {self.lost} lost, '
                f'{self.repeated} twice; recorder: {self.cpu:.1f} CPU s, at most {self.memory / MB:.0f} MB')


def publisher_main(topic, rate, seconds):
    """Publish seq 1, 2, 3 ... of a topic, print how many once the recorder has all."""
    rclpy.init()
    kind, profile = KINDS[topic]
    node = Node(f'load_{topic}', namespace=names.NAMESPACE, enable_rosout=False)
    profile = copy.copy(profile)
    profile.history = HistoryPolicy.KEEP_ALL
    publisher = node.create_publisher(kind, topic, profile)
    message = kind(run_id=RUN_ID, table_position=1, ball=1, cmm_position=1)
    message.header.frame_id = 'machine'
    message.header.stamp = node.get_clock().now().to_msg()
    while not publisher.get_subscription_count():
        time.sleep(0.02)
    print('ready', flush=True)
    sys.stdin.readline()
    sent, began = 0, time.perf_counter()
    while (now := time.perf_counter() - began) < seconds:
        if sent >= rate * now:
            time.sleep(1 / rate)
            continue
        message.seq = sent + 1
        try:
            publisher.publish(message)
        except rclpy_implementation.RCLError:  # no room: the recorder has not acknowledged enough
            continue
        sent += 1
    publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    print(sent, flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


class Recording(GraphClient):
    """Opens and closes logs by the recorder's services; a context manager."""

    def __init__(self):
        """Join the graph."""
        super().__init__('load', DOMAIN, names.NAMESPACE, enable_rosout=False)
        self._start = self._node.create_client(StartRecording, names.START_RECORDING)
        self._stop = self._node.create_client(StopRecording, names.STOP_RECORDING)

    def start(self):
        """Open a log."""
        self._call(self._start, StartRecording.Request(run_id=RUN_ID))

    def stop(self):
        """Close it, as soon as the request is in it; return its folder."""
        while not (response := self._call(self._stop, StopRecording.Request(run_id=RUN_ID))).log:
            time.sleep(0.1)
        return Path(response.log)

    def _call(self, client, request):
        if not client.wait_for_service(PATIENCE):
            raise RuntimeError(f'expected the service {client.srv_name}, found none')
        future = client.call_async(request)
        self._executor.spin_until_future_complete(future, PATIENCE)
        response = future.result()
        if response is None or not (response.success or getattr(response, 'missing', ())):
            raise RuntimeError(f'{client.srv_name}: {response.message if response else "no answer"}')
        return response


def memory_of(pid, name):
    """Return an entry of a process's status, bytes."""
    lines = Path('/proc', str(pid), 'status').read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(name)))


def cpu_seconds(pid):
    """Return the CPU seconds of a process: fields 14 and 15 of its stat; the name, field 2, may hold spaces."""
    fields = Path('/proc', str(pid), 'stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def seqs_in(log, topic, kind, validate_crcs=False):
    """Return the seq of every message on a topic in all files of a log, read by the mcap library."""
    found = []
    for path in sorted(log.glob('*.mcap')):
        with open(path, 'rb') as stream:
            reader = make_reader(stream, validate_crcs=validate_crcs)
            messages = reader.iter_messages([f'/{names.NAMESPACE}/{topic}'], log_time_order=False)
            found += [deserialize_message(message.data, kind).seq for _, _, message in messages]
    return found


def measure(rate, seconds):
    """Return the Result of two publishers at a rate for so long."""
    os.environ.update(added_environment(os.environ))
    with tempfile.TemporaryDirectory() as folder, Cell(
            DOMAIN, nodes=(names.RECORDER,), log_dir=folder, simulated_time=False) as cell, Recording() as recording:
        recording.start()
        pid = cell.processes[names.RECORDER].popen.pid
        before = cpu_seconds(pid)
        processes = {topic: subprocess.Popen(
            [sys.executable, '-m', 'benchmarks.recorder_rate', '--publish', topic, '--rate', str(rate), '--seconds',
             str(seconds)], env=cell_environment(DOMAIN), text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            for topic in KINDS}
        for process in processes.values():
            process.stdout.readline()
        for process in processes.values():
            process.stdin.close()
        sent = {topic: int(process.stdout.read()) for topic, process in processes.items()}
        for process in processes.values():
            process.wait()
        cpu, memory = cpu_seconds(pid) - before, memory_of(pid, 'VmHWM')
        log = recording.stop()
        heard = {topic: seqs_in(log, topic, KINDS[topic][0]) for topic in KINDS}
    return Result(
        min(sent.values()) / seconds, sum(sent.values()),
        sum(len(set(range(1, count + 1)) - set(heard[topic])) for topic, count in sent.items()),
        sum(len(seqs) - len(set(seqs)) for seqs in heard.values()), cpu, memory)


def main(args=None):
    """Measure and print; return 1 where a message was lost or is there twice."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.recorder_rate', description=__doc__.partition('\n')[0])
    parser.add_argument('--rate', type=float, default=2000.0, help='messages a second of each publisher (default 2000)')
    parser.add_argument('--seconds', type=float, default=60.0, help='how long both publish (default 60)')
    parser.add_argument('--publish', choices=tuple(KINDS), help=argparse.SUPPRESS)
    options = parser.parse_args(args)
    if options.publish:
        publisher_main(options.publish, options.rate, options.seconds)
        return 0
    result = measure(options.rate, options.seconds)
    print(result)
    return int(bool(result.lost or result.repeated))


if __name__ == '__main__':
    sys.exit(main())
