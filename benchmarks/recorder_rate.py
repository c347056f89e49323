# SPDX-License-Identifier: Apache-2.0
"""How many messages a second the recorder takes without losing one.

    python -m benchmarks.recorder_rate [--seconds 60] [--rate N] [--compression none]
                                       [--keep-last] [--json]

The recorder node runs in a process and ROS domain of its own; its log is opened and closed by its services. Two
processes publish ProbeTarget and BallCentre as in a cell: rclpy, the same topics, reliable. First the rate is
raised until one of the two cannot keep it: a publisher keeps a rate if it sends at least 98 % of what is due. Then both
publish at the highest rate that they kept. The log is read by the mcap library: every seq has to be in it, once. Where
messages were lost, the rate is lowered by a tenth and all is measured again, until none is.

The publishers keep what is not acknowledged (history: keep all) and wait where that is too much, so that a rate that
they keep is one that arrives; where one of them did not keep it for the whole time, a lower one is tried too. With
--keep-last they have the depths of the cell, where at most one target is on its way: what is replaced before it arrived
is lost, and nothing slows the publishers down.
"""

import argparse
import copy
import itertools
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
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
from rosette_ros.cell.supervisor import MODULES, Cell, added_environment, cell_environment
from rosette_ros.nodes import names, qos

DOMAIN = 101
RCLError = rclpy_implementation.RCLError
KINDS = {names.PROBE_TARGET: (ProbeTarget, qos.TARGET), names.BALL_CENTRE: (BallCentre, qos.ANSWER)}
RUN_ID = 'rosette_20260412_083000_diagonal'
FIRST_RATE, LEAST_RATE, FINEST = 1000, 100, 0.05
"""The search begins at so many messages per second and topic and ends when it knows the highest to this part."""
KEPT, LESS = 0.98, 0.9
TRIAL_SECONDS = 3.0
PATIENCE = 60.0
MEGABYTE = 1e6


@dataclass(frozen=True)
class Result:
    """What was sent and what is in the log; memory in bytes.

    rate: messages per second of the slower publisher; asked: of each; sent: how many by topic.

    lost, repeated: by comparing the log with what was sent; growth: of the recorder's resident memory while the
    publishers sent; others: CPU seconds of whatever else ran on the computer.
    """

    rate: float
    asked: float
    sent: dict
    seconds: float
    published: int
    recorded: int
    lost: dict
    repeated: int
    files: int
    log_bytes: int
    cpu_seconds: float
    peak_memory: int
    growth: int
    others: float

    @property
    def is_kept(self):
        """Whether both publishers kept the rate that was asked."""
        return self.rate >= KEPT * self.asked

    @property
    def is_whole(self):
        """Whether every message is in the log, once."""
        return not any(self.lost.values()) and not self.repeated


@dataclass(frozen=True)
class Report:
    """What was found; tried: (asked, kept) rates of the publishers; results: the last one without loss, if any."""

    tried: tuple
    results: tuple


# A publisher, in a process of its own


def publisher_main(topic, keeps_last):
    """Publish as standard input asks, `RUN_ID RATE SECONDS` a line; answer each with what was sent."""
    rclpy.init()
    kind, profile = KINDS[topic]
    node = Node(f'load_{topic}', namespace=names.NAMESPACE, enable_rosout=False)
    profile = copy.copy(profile)
    if not keeps_last:
        profile.history = HistoryPolicy.KEEP_ALL
    publisher = node.create_publisher(kind, topic, profile)
    message = kind(table_position=1, ball=1, cmm_position=1)
    message.header.frame_id = 'machine'
    message.header.stamp = node.get_clock().now().to_msg()
    while not publisher.get_subscription_count():
        time.sleep(0.02)
    if node.count_publishers(topic) > 1:
        sys.exit(f'somebody else publishes {topic} in ROS domain {DOMAIN}')
    print('ready', flush=True)
    for line in sys.stdin:
        message.run_id, *numbers = line.split()
        rate, seconds = map(float, numbers)
        print(publish(publisher, message, rate, seconds), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


def publish(publisher, message, rate, seconds):
    """Publish seq 1, 2, 3 ... at a rate for so long, wait until the recorder has all; return how many."""
    sent, began = 0, time.perf_counter()
    while (now := time.perf_counter() - began) < seconds:
        if sent < rate * now:
            message.seq = sent + 1
            try:
                publisher.publish(message)
            except RCLError:  # no room: the recorder has not acknowledged enough
                continue
            sent += 1
        else:
            time.sleep(1 / rate)
    publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    return sent


class Publishers:
    """The two processes that publish; a context manager."""

    def __init__(self, keeps_last):
        """Start both and wait until they see the recorder."""
        options = ['--keep-last'] if keeps_last else []
        self._processes = [subprocess.Popen(
            [sys.executable, __file__, '--publish', topic, *options], env=cell_environment(DOMAIN), text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE) for topic in KINDS]
        for process in self._processes:
            if process.stdout.readline().strip() != 'ready':
                self.close()
                raise RuntimeError('a publisher did not start')

    def __enter__(self):
        """Return the publishers."""
        return self

    def __exit__(self, *_):
        """End them."""
        self.close()

    @property
    def pids(self):
        """Their processes."""
        return [process.pid for process in self._processes]

    def send(self, run_id, rate, seconds):
        """Let both publish messages of a run; return how many messages each has sent, by topic."""
        for process in self._processes:
            process.stdin.write(f'{run_id} {rate} {seconds}\n')
            process.stdin.flush()
        return {topic: int(process.stdout.readline()) for topic, process in zip(KINDS, self._processes, strict=True)}

    def close(self):
        """End both."""
        for process in self._processes:
            process.stdin.close()
        for process in self._processes:
            process.wait()


# The recorder: its services, its process


class Recording(GraphClient):
    """Opens and closes logs by the recorder's services; a context manager."""

    def __init__(self):
        """Join the graph."""
        super().__init__('load', DOMAIN, names.NAMESPACE, enable_rosout=False)
        self._start = self._node.create_client(StartRecording, names.START_RECORDING)
        self._stop = self._node.create_client(StopRecording, names.STOP_RECORDING)

    def start(self, run_id):
        """Open a log."""
        return self._call(self._start, StartRecording.Request(run_id=run_id))

    def stop(self, run_id):
        """Close it, as soon as the request is in it; return the response."""
        while not (response := self._call(self._stop, StopRecording.Request(run_id=run_id))).log:
            time.sleep(0.1)
        return response

    def _call(self, client, request):
        if not client.wait_for_service(PATIENCE):
            raise RuntimeError(f'wanted the service {client.srv_name}, got none')
        future = client.call_async(request)
        self._executor.spin_until_future_complete(future, PATIENCE)
        response = future.result()
        if response is None or not (response.success or getattr(response, 'missing', ())):
            raise RuntimeError(f'{client.srv_name}: {response.message if response else "no answer"}')
        return response


class Usage:
    """What a process takes from now on, by /proc; `load`: the other processes of the measurement."""

    def __init__(self, pid, load):
        """Begin."""
        self._pid, self._load = pid, load
        self._begin = self._now()

    def end(self):
        """Return (CPU seconds, peak memory, its growth, CPU seconds of all that is not of the measurement)."""
        (memory, cpu, others), (memory_now, cpu_now, others_now) = self._begin, self._now()
        return cpu_now - cpu, memory_of(self._pid, 'VmHWM'), memory_now - memory, others_now - others

    def _now(self):
        cpu = cpu_seconds(self._pid)
        return memory_of(self._pid, 'VmRSS'), cpu, all_cpu_seconds() - cpu - sum(map(cpu_seconds, self._load))


def memory_of(pid, name):
    """Return an entry of a process's status, bytes."""
    lines = Path('/proc', str(pid), 'status').read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(name)))


def cpu_seconds(pid):
    """Return the CPU seconds of a process: fields 14 and 15 of its stat; the name, field 2, may hold spaces."""
    fields = Path('/proc', str(pid), 'stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def all_cpu_seconds():
    """Return the CPU seconds of the whole computer without its idle ones."""
    times = [int(field) for field in Path('/proc/stat').read_text().splitlines()[0].split()[1:9]]
    return (sum(times) - times[3] - times[4]) / os.sysconf('SC_CLK_TCK')


def recorder_pid():
    """Return the process of the recorder, a child of this one."""
    module = MODULES[names.RECORDER].encode()
    for task in Path('/proc/self/task').iterdir():
        for pid in (task / 'children').read_text().split():
            if module in Path('/proc', pid, 'cmdline').read_bytes().split(b'\0'):
                return int(pid)
    raise RuntimeError('wanted the process of the recorder among the children of this one, got none')


# The measurement


def seqs_in(log, topic, kind, validate_crcs=False):
    """Return the seq of every message on a topic in all files of a log, read by the mcap library."""
    found = []
    for path in sorted(log.glob('*.mcap')):
        with open(path, 'rb') as stream:
            reader = make_reader(stream, validate_crcs=validate_crcs)
            messages = reader.iter_messages([f'/{names.NAMESPACE}/{topic}'], log_time_order=False)
            found += [deserialize_message(message.data, kind).seq for _, _, message in messages]
    return found


def highest_rate(publishers, recording, numbers):
    """Return the highest rate that both publishers keep while the recorder records, and all rates that were tried."""
    tried, low, high = [], 0.0, float('inf')
    while high - low > FINEST * max(low, 1.0):
        rate = 0.5 * (low + high) if high < float('inf') else max(2 * low, FIRST_RATE)
        run_id = f'trial_{next(numbers)}'
        recording.start(run_id)
        sent = publishers.send(run_id, rate, TRIAL_SECONDS)
        recording.stop(run_id)
        slowest = min(sent.values()) / TRIAL_SECONDS
        tried.append((rate, slowest))
        if slowest >= KEPT * rate:
            low = rate
        else:
            high = rate
    return low, tuple(tried)


def measure(seconds, rate=None, compression='none', keeps_last=False, tell=lambda words: None):
    """Return the Report of so many seconds at a rate; None: at the highest that the publishers keep, and at less.

    tell: called with some lines of words about each rate as soon as it was tried.
    """
    os.environ.update(added_environment(os.environ))
    params = {names.RECORDER: {'compression': compression}}
    with tempfile.TemporaryDirectory() as folder, \
            Cell(DOMAIN, nodes=(names.RECORDER,), params=params, log_dir=folder, simulated_time=False), \
            Publishers(keeps_last) as publishers, Recording() as recording:
        if rate is not None:
            result = one_rate(publishers, recording, RUN_ID, rate, seconds)
            tell(words_of(result))
            return Report((), (result,))
        numbers = itertools.count(1)
        rate, tried = highest_rate(publishers, recording, numbers)
        pairs = ', '.join(f'{asked:.0f} ({kept:.0f})' for asked, kept in tried)
        tell(f'  asked of each publisher, 1/s (kept): {pairs}')
        results = []
        while not results or (not (results[-1].is_whole and results[-1].is_kept) and rate > LEAST_RATE):
            results.append(one_rate(publishers, recording, f'{RUN_ID}_{next(numbers)}', rate, seconds))
            tell(words_of(results[-1]))
            rate *= LESS
        return Report(tried, tuple(results))


def one_rate(publishers, recording, run_id, rate, seconds):
    """Return the Result of so many seconds at a rate."""
    recording.start(run_id)
    usage = Usage(recorder_pid(), [os.getpid(), *publishers.pids])
    sent = publishers.send(run_id, rate, seconds)
    used = usage.end()
    answer = recording.stop(run_id)
    return _result(Path(answer.log), rate, sent, seconds, used)


def _result(log, asked, sent, seconds, used):
    recorded, lost, repeated = 0, {}, 0
    for topic, (kind, _) in KINDS.items():
        seqs = seqs_in(log, topic, kind)
        recorded += len(seqs)
        lost[topic] = len(set(range(1, sent[topic] + 1)) - set(seqs))
        repeated += len(seqs) - len(set(seqs))
    files = sorted(log.glob('*.mcap'))
    cpu, peak, growth, others = used
    return Result(
        rate=min(sent.values()) / seconds, asked=asked, sent=sent, seconds=seconds,
        published=sum(sent.values()), recorded=recorded, lost=lost,
        repeated=repeated, files=len(files), log_bytes=sum(path.stat().st_size for path in files),
        cpu_seconds=cpu, peak_memory=peak, growth=growth, others=others)


def words_of(result):
    """Return a Result in lines for a person."""
    return (
        f'  asked of each publisher {result.asked:.0f} 1/s for {result.seconds:g} s, '
        f'{"kept" if result.is_kept else "not kept"}: '
        f'{", ".join(f"{topic} {count / result.seconds:.0f}" for topic, count in result.sent.items())} 1/s, '
        f'{result.published / result.seconds:.0f} messages/s in all\n'
        f'    published {result.published}, recorded {result.recorded}, lost {sum(result.lost.values())}, '
        f'twice {result.repeated}\n'
        f'    log of {result.log_bytes / MEGABYTE:.1f} MB in {result.files} file(s)\n'
        f'    recorder: {result.cpu_seconds:.1f} CPU seconds ({100 * result.cpu_seconds / result.seconds:.0f} % of a '
        f'core), peak memory {result.peak_memory / MEGABYTE:.0f} MB, growth {result.growth / MEGABYTE:+.1f} MB\n'
        f'    meanwhile other processes of this computer took {result.others:.1f} CPU seconds')


def main(args=None):
    """Measure and print; returns the exit code: 1 where messages were lost at every rate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seconds', type=float, default=60.0, help='how long both publish (default: 60)')
    parser.add_argument('--rate', type=float, help='messages per second and topic (default: the highest that is kept)')
    parser.add_argument('--compression', default='none', help="the recorder's compression")
    parser.add_argument('--keep-last', action='store_true', help="publish with the cell's own history depths: what the "
                        'recorder has not heard in time is replaced')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    parser.add_argument('--publish', choices=tuple(KINDS), help=argparse.SUPPRESS)
    options = parser.parse_args(args)
    if options.publish:
        publisher_main(options.publish, options.keep_last)
        return 0
    tell = (lambda words: None) if options.json else (lambda words: print(words, flush=True))
    tell(f'the recorder at the highest rate: {platform.machine()}, {os.cpu_count()} cores, load '
         f'{os.getloadavg()[0]:.1f} before')
    report = measure(options.seconds, options.rate, options.compression, options.keep_last, tell)
    if options.json:
        print(json.dumps(asdict(report)))
    return 0 if report.results[-1].is_whole else 1


if __name__ == '__main__':
    sys.exit(main())
