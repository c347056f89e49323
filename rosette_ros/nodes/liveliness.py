# SPDX-License-Identifier: Apache-2.0
"""Who has which role in a cell, as /diagnostics and the graph show it: which nodes are there, disconnected, restarted.

The process that is heard first has a role until its statuses stay away: what another one says does not count. A node
whose status stays away, or whose publisher is taken down, is disconnected. A CMM without such a status is judged by its
publishers and subscriptions alone: killed and started again, it is on the graph twice for a while."""

import os
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.time import Time
from std_msgs.msg import Header

from rosette_ros.nodes import names, qos
from rosette_ros.nodes.graph_node import UNNAMED, name_of

PROCESS, PROBLEM, HEARS, BUSY_S, UP_S = 'process', 'problem', 'hears', 'busy_s', 'up_s'
"""Values of a node's status: the unique name of its process, which ends with the part of its GIDs that all have in
common; why it cannot work, empty while it can; `process` of the nodes whose statuses it receives; s, since it called
something back; s, since it began, or stood still for so long that another one may have its role."""
BETWEEN = '; '
_LONGEST_STEP = 0.4  # between two looks for statuses: longer, and the node that looks stood still, s
_PARTICIPANT = 12  # bytes of a GID that name the participant (DDS-RTPS 2.2, section 8.2.4.1)
LEAVES = 20.0  # a process that was killed stays on the graph for so long at most, the lease of Fast DDS, s
SETTLING = 1.0  # how long all nodes have to be present before a run: discovery takes its time in each of them, s


def process_of(gid: Any) -> bytes:
    """Return the part of an endpoint's GID that all endpoints of a process have in common."""
    return bytes(gid)[:_PARTICIPANT]


def started(node: str, pid: int) -> str:
    """Return what the name of a node's process begins with."""
    return f'{node} {pid} '


class StatusPublisher:
    """Publishes the status of a node on /diagnostics, twice a second by a thread of its own: also while it computes.

    Not for ever: that this thread runs does not show that the node works.

    hears: `process` of the nodes whose status is received; longest: how long it may compute, s."""

    def __init__(self, node: Node, now: Callable[[], Time]) -> None:
        """Publish nothing yet; now: returns the ROS time."""
        self._node, self._now = node, now
        self._problem, self.longest = '', qos.LONGEST_WORK
        self.hears: tuple[str, ...] = ()
        self._state: tuple[bytes, str, Mapping[str, object]] = DiagnosticStatus.OK, 'starting', {}
        name = node.get_fully_qualified_name()
        others = _gids(node, name)
        self._publisher = node.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.STATUS)
        own = process_of(next(iter(_gids(node, name) - others))).hex()
        self.process = f'{started(node.get_name(), os.getpid())}on {socket.gethostname()} {own}'
        self._began = self._published = time.monotonic()
        self._served, self._is_ended = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._run, name='status')

    def describe(self, level: bytes, sentence: str, values: Mapping[str, object]) -> None:
        """Say what the node does from now on."""
        self._state = level, sentence, values

    def report(self, problem: str) -> None:
        """Say why the node cannot do its work, '' where it can; a change is published at once."""
        problem = ' '.join(problem.split())
        if problem != self._problem:
            self._problem = problem
            self.publish()

    def serve(self) -> None:
        """Take note that the node calls back; called often. With the first call, publishing begins."""
        self._served = time.monotonic()
        if self._thread.ident is None:
            self._thread.start()

    def publish(self) -> None:
        """Publish one."""
        (level, sentence, values), now = self._state, time.monotonic()
        self._began, self._published = now if now - self._published > qos.STATUS_LOST else self._began, now
        own = {PROCESS: self.process, PROBLEM: self._problem, HEARS: BETWEEN.join(self.hears),
               BUSY_S: f'{self.busy:.1f}',
               UP_S: f'{self.up:.3f}'}
        self._publisher.publish(DiagnosticArray(header=Header(stamp=self._now().to_msg()), status=[
            DiagnosticStatus(
                level=level, name=self._node.get_fully_qualified_name()[1:], message=sentence,
                hardware_id=self._node.get_namespace()[1:],
                values=[KeyValue(key=key, value=str(value)) for key, value in {**values, **own}.items()])]))

    @property
    def busy(self) -> float:
        """How long it has called nothing back, s."""
        return time.monotonic() - self._served if self._served else 0.0

    @property
    def up(self) -> float:
        """How long it has run without standing still, s."""
        return time.monotonic() - self._began

    def end(self) -> None:
        """Publish no more; called before the node is destroyed."""
        self._is_ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        self.publish()
        while threading.main_thread().is_alive() and not self._is_ended.wait(qos.STATUS_PERIOD):
            if self.busy <= self.longest:
                self.publish()


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by their keys."""
    return {one.key: one.value for one in status.values}


class NodeMonitor:
    """The node that has a role in the cell, as the statuses under its name say.

    process: that has the role, or had it last, '' before the first; on_change: called when another process has taken
    it; values: of its last status; problem, hears, busy: as there."""

    def __init__(self, node: Node, peer: str) -> None:
        self._node, self.peer = node, peer
        self.on_change: Callable[[], object] = lambda: None
        self._received: dict[str, tuple[float, float]] = {}  # when, and how long each process had run then
        self._heard: set[str] = set()  # since the last process began
        self._kept: dict[str, tuple[str, Callable[[], object]]] = {}
        self._strangers: dict[str, tuple[float, str]] = {}
        self._waited, self._last, self._watched = 0.0, 0.0, time.monotonic()
        self.process, self.problem, self.hears, self.busy = '', '', tuple[str, ...](), 0.0
        self.values: Mapping[str, str] = {}

    def admit(self, process: str, topic: str, use: Callable[[], object]) -> None:
        """Call `use` for what a process says on a topic: now where it has the role, or once it has taken it."""
        if process == self.process if self.process else process.startswith(f'{self.peer} '):
            use()
        else:
            self._keep(process, topic, use)

    def _keep(self, process: str, topic: str, use: Callable[[], object]) -> None:
        self._kept[topic] = process, use
        if topic not in self._strangers:
            infos = [] if process else self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
            whose = {name_of(one) for one in infos} - {self._name}
            who = process.rpartition(' ')[0] or ' and '.join(sorted(whose)) or UNNAMED
            self._strangers[topic] = self._waited, f'what {who} publishes on {topic} is not used: it is not the ' + (
                f'{self.peer} of this cell' + f', {self.process.rpartition(" ")[0]} is' * bool(self.process))

    def elder(self, own: StatusPublisher) -> str:
        """Return another process of this name that runs, and has run for longer than this one; '' where none does."""
        others = [process for process, (at, up) in self._received.items()
                  if process != own.process and up + self._waited - at > own.up]
        return others[0] if others and self.peer in names.SINGLE and len(self.publishers()) > 1 else ''

    def is_of(self, gid: bytes) -> bool:
        """Return whether an endpoint, by its GID, is one of the process that has the role, and is heard."""
        return self.process in self._received and self.had(gid)

    def had(self, gid: bytes) -> bool:
        """Return whether an endpoint, by its GID, is one of the process that has the role, or had it last."""
        return bool(self.process) and self.process.endswith(process_of(gid).hex())

    def watch(self) -> list[str]:
        """Forget processes whose statuses stay away; return, once, in words who says something and has not the role.

        That is none which takes it just now. While this node itself stands still, statuses wait for it: that time does
        not count."""
        now = time.monotonic()
        self._waited, self._watched = self._waited + min(now - self._watched, _LONGEST_STEP), now
        self._received = {process: (at, up) for process, (at, up) in self._received.items()
                          if self._waited - at < qos.STATUS_LOST}
        told = {topic: words for topic, (since, words) in self._strangers.items()
                if words and self._waited - since > qos.STATUS_LOST and self.process in ('', *self._received)}
        self._strangers |= dict.fromkeys(told, (now, ''))
        return list(told.values())

    def count(self) -> int:
        """Return how many processes publish a status under this name now.

        One that was not heard since another one began counts no more: killed, it has been replaced by that one."""
        running = [process for process in self._received if process in self._heard]
        return min(len(running), len(self.publishers())) if running else 0

    @property
    def is_disconnected(self) -> bool:
        """Whether one was present, and neither it nor a successor is."""
        return bool(self.process) and not self.count()

    @property
    def silence(self) -> float:
        """Time since the last status of any process, s."""
        return self._waited - self._last

    @property
    def is_late(self) -> bool:
        """Whether a status is overdue, of any process, of which is not yet known whether it stays away."""
        return self.count() > 0 and self._waited - min(self._received.values())[0] > qos.STATUS_LATE

    def running(self) -> int:
        """Return how many processes run, those counted that have published no status yet."""
        return self.count() if self.process else 1

    def publishers(self) -> list[Any]:
        """Return the publishers of the status on the graph, also those of processes that were killed just now.

        One whose node has no name yet may be one of them."""
        return [one for one in self._node.get_publishers_info_by_topic(names.DIAGNOSTICS)
                if name_of(one) in (self._name, UNNAMED)]

    @property
    def _name(self) -> str:
        return f'{self._node.get_namespace().rstrip("/")}/{self.peer}'

    def receive(self, values: Mapping[str, str]) -> None:
        """Take a status, by its values; one that names no process is of another program.

        Where no process has the role, this one takes it if the graph shows a node of this name."""
        if not (process := values.get(PROCESS)):
            return
        if self.process not in self._received and process != self.process and self.publishers():
            before, self.process = self.process, process
            kept, self._kept, self._strangers = self._kept, {}, {}
            if before:
                self.on_change()
            for sender, use in kept.values():
                if sender == process:
                    use()
        if process not in self._received:
            self._heard.clear()
        if process == self.process or self.peer not in names.SINGLE:
            self._heard.add(process)
        self._last, self._received[process] = self._waited, (self._waited, _number(values.get(UP_S, '')))
        if process != self.process:
            self._keep(process, names.DIAGNOSTICS, lambda: None)
            return
        self.values, self.problem, self.busy = values, values.get(PROBLEM, ''), _number(values.get(BUSY_S, ''))
        self.hears = tuple(filter(None, values.get(HEARS, '').split(BETWEEN)))


def _gids(node: Node, name: str) -> set[bytes]:
    """Return the endpoints by which nodes of this name publish statuses."""
    return {bytes(one.endpoint_gid) for one in node.get_publishers_info_by_topic(names.DIAGNOSTICS)
            if name_of(one) == name}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # of a foreign node
        return 0.0


class NodeMonitors:
    """The NodeMonitor of each node that is asked for, by one subscription to /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._monitors: dict[str, NodeMonitor] = {}

    def of(self, peer: str) -> NodeMonitor:
        """Return the monitor of a node in the same namespace."""
        if not self._monitors:
            self._statuses = self._node.create_subscription(
                DiagnosticArray, names.DIAGNOSTICS, self._receive, qos.STATUSES)
        name = f'{self._node.get_namespace()}/{peer}'.lstrip('/')
        if name not in self._monitors:
            self._monitors[name] = NodeMonitor(self._node, peer)
        return self._monitors[name]

    def watch(self) -> list[str]:
        """Watch all; called every WAKE_PERIOD."""
        return [words for monitor in self._monitors.values() for words in monitor.watch()]

    def take(self) -> None:
        """Take the statuses that have come, while no executor does."""
        with self._statuses.handle:
            while taken := self._statuses.handle.take_message(DiagnosticArray, False):
                self._receive(taken[0])

    def _receive(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name in self._monitors:
                self._monitors[status.name].receive(values_of(status))


class TopicPublishers:
    """The publishers of a topic whose processes run: while there are two, nothing of it is used.

    rclpy does not say which publisher a message came from, but a publisher is known before its first message is
    delivered. The publisher of a process that was killed stays on the graph for up to LEAVES; statuses tell it apart.

    peer: monitor of the node that publishes it; is_idle: of an endpoint (GID), whether it does not count beside others;
    running: all endpoints; found: those that count; used: that of the last one that was alone; is_single: whether
    messages are used; ignored: number of messages that were not, without a subscription how often there were two."""

    _verb = 'publish'

    def __init__(self, node: Node, topic: str, peer: NodeMonitor) -> None:
        """Start without a publisher."""
        self._node, self._peer = node, peer
        self.is_idle: Callable[[bytes], bool] = lambda gid: False
        self.topic = node.resolve_topic_name(topic)
        self._subscription: Subscription | None = None
        self.running, self.found, self.used = frozenset[bytes](), frozenset[bytes](), frozenset[bytes]()
        self.is_single, self.ignored = True, 0
        self._names: dict[bytes, str] = {}
        self._first_seen: dict[bytes, float] = {}
        self._matched, self._peers = 0, 0

    def judge(self, subscription: Subscription) -> None:
        """Take note of the subscription whose messages `admits` judges."""
        self._subscription = subscription

    def admits(self) -> bool:
        """Return whether a message that was delivered just now may be used.

        That a second publisher has left is seen by `watch` only: until then what it had published is delivered."""
        if self._count() > self._matched:
            self.look()
        self.ignored += not self.is_single
        return self.is_single

    @property
    def conflict(self) -> str:
        """That more than one node publishes the topic, in words; '' where it is not so."""
        if self.is_restart:
            return f'{min(self._named)} was restarted, and its process before leaves the graph within {LEAVES:g} s'
        return f'{len(self.found)} nodes {self._verb} {self.topic} ({self._who})' if len(self.found) > 1 else ''

    @property
    def _who(self) -> str:
        return ' and '.join(sorted(self._names[gid] for gid in self.found))

    @property
    def _named(self) -> set[str]:
        return {self._names[gid] for gid in self.found} - {UNNAMED}

    @property
    def is_tried(self) -> bool:
        """Whether one of several tries the CMM, which needs no warning; nothing of theirs is used all the same."""
        return any(self._names[gid].rpartition('/')[2].startswith(f'{names.TRIAL}_') for gid in self.found)

    @property
    def is_restart(self) -> bool:
        """Whether there are two because a node without a status was started again: a second process of the same name,
        since no longer than the one before may stay on the graph after its end.

        One whose node has no name yet, which comes a moment after its publishers, may have that of the other."""
        processes = {process_of(gid) for gid in self.found}
        if len(processes) < 2 or len(self._named) != 1:
            return False
        last = max(self._first_seen[gid] for gid in self.found)
        return time.monotonic() - last < LEAVES and processes.isdisjoint(
            process_of(one.endpoint_gid) for one in self._peer.publishers())

    def watch(self) -> None:
        """Look where something may have changed; call it often."""
        is_plain = self.is_single and len(self.found) == len(self._names) < 2 and self._peers >= len(self.found)
        if not is_plain or (self._count(), self._peer.running()) != (self._matched, self._peers):
            self.look()

    def look(self) -> None:
        """Find out which publishers there are."""
        self._matched, self._peers = self._count(), self._peer.running()
        self.running = self._find(time.monotonic())
        self.found = frozenset(gid for gid in self.running if not self.is_idle(gid)) or self.running
        self.used = self.found if len(self.found) == 1 else self.used
        self.ignored += self._subscription is None and self.is_single and len(self.found) > 1
        # a publisher is matched a moment before it is on the graph, and its first message may be there by then
        self.is_single = len(self.found) < 2 and (self._subscription is None or self._matched <= len(self._names))

    def _infos(self) -> list[Any]:
        """Return the publishers on the graph, as rclpy describes them."""
        return self._node.get_publishers_info_by_topic(self.topic)

    def _count(self) -> int:
        subscription = self._subscription
        return self._node.count_publishers(self.topic) if subscription is None else subscription.get_publisher_count()

    def _find(self, now: float) -> frozenset[bytes]:
        """Return the publishers whose process runs: without a status all, with one that of the process that has the
        role, unless two are heard.

        Where that is not known, as many as are heard. Those that were found last are taken to run: a new one is never
        mistaken for one that has ended, nor before its first status is received."""
        self._names = {bytes(one.endpoint_gid): name_of(one) for one in self._infos()}
        self._first_seen = {gid: self._first_seen.get(gid, now) for gid in self._names}
        beating = {process_of(one.endpoint_gid) for one in self._peer.publishers()}
        found = sorted(self._names, key=lambda gid: self._first_seen[gid])
        with_status = [gid for gid in found if process_of(gid) in beating]
        is_new = any(now - self._first_seen[gid] < qos.STATUS_LOST for gid in with_status[-1:])
        own = [gid for gid in with_status if self._peer.is_of(gid)]
        ended = with_status[:max(len(with_status) - max(self._peers, is_new), 0)]
        if own and self._peers < 2:
            ended = [gid for gid in with_status if gid not in own]
        return frozenset(self._names) - frozenset(ended)


class ServiceServers(TopicPublishers):
    """The servers of a service: their responses count as messages of a topic do.

    A server is known by the publisher of its responses, as DDS names it (design.ros2.org, topic and service name
    mapping). A request goes to all servers that are there, so that one which comes later answers none before."""

    _verb = 'offer'

    def __init__(self, node: Node, service: str, peer: NodeMonitor) -> None:
        """Start without a server."""
        super().__init__(node, service, peer)
        self.topic = node.resolve_service_name(service)

    def refusal(self) -> str:
        """Return why a response would not count now, '' where it would: it is of the process that has the role alone.

        Where none has it, and of a CMM without a status, any that is alone counts."""
        self.look()
        peer = self._peer
        if not (strangers := [gid for gid in self.found if not peer.had(gid)]) or self.conflict:
            return self.conflict
        if not peer.process or not (peer.peer in names.SINGLE or peer.count()):
            return ''
        return f'{self._names[strangers[0]]}, which offers {self.topic}, is not the {peer.peer} of this cell'

    def _infos(self) -> list[Any]:
        return self._node.get_publishers_info_by_topic(f'rr{self.topic}Reply', no_mangle=True)

    def _count(self) -> int:
        return self._node.count_services(self.topic)
