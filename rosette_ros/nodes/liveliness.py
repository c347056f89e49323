# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics and the graph say about a cell: which nodes are present, settled, disconnected, restarted.

A node whose status stays away, or whose publisher is taken down, is disconnected; the name of the process in the status
tells a restarted node from the one before. A CMM without such a status is judged by its publishers and subscriptions
alone."""

import os
import threading
import time
import uuid
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import Header

from rosette_ros.nodes import names, qos
from rosette_ros.nodes.graph_node import UNNAMED, name_of

if TYPE_CHECKING:
    from rosette_ros.nodes.base_node import CellNode
    from rosette_ros.nodes.node_requests import RecorderLink

PROCESS, PROBLEM, HEARS, BUSY_S = 'process', 'problem', 'hears', 'busy_s'
"""Values of a node's status: the unique name of its process; why it cannot work, empty while it can; `process` of the
nodes whose statuses it receives; s, since it called something back."""
BETWEEN = '; '
_LONGEST_STEP = 0.4  # between two looks for statuses: longer, and the node that looks stood still, s
_PARTICIPANT = 12  # bytes of a GID that name the participant (DDS-RTPS 2.2, section 8.2.4.1)
_NODE_WORDS = {names.CMM: 'CMM', names.RECORDER: 'recorder'}
BUSY = 2.0  # a node that has called nothing back for this time is told in /diagnostics, s
RESTART = f'wait {1.5 * qos.STATUS_HANGS:g} s for rosette cell to restart it, or restart it'
SETTLING = 1.0  # how long all nodes have to be present before a run: discovery takes its time in each of them, s


def target_subscriptions(node: Node) -> list[Any]:
    """Return the subscriptions to targets of CMMs: of the processes that publish ball centres.

    Recorder, evaluator, studio and other observers subscribe too. Where no process does both, all but the cell's own
    are returned: a CMM may be two processes."""
    targets, centres = map(node.resolve_topic_name, (names.PROBE_TARGET, names.BALL_CENTRE))
    answering = {process_of(info.endpoint_gid) for info in node.get_publishers_info_by_topic(centres)}
    infos = node.get_subscriptions_info_by_topic(targets)
    return [info for info in infos if process_of(info.endpoint_gid) in answering] or [
        info for info in infos if info.node_name not in (names.RECORDER, names.EVALUATOR)]


def process_of(gid: Any) -> bytes:
    """Return the part of an endpoint's GID that all endpoints of a process have in common."""
    return bytes(gid)[:_PARTICIPANT]


def started(node: str, pid: int) -> str:
    """Return what the name of a node's process begins with."""
    return f'{node} {pid} '


class StatusPublisher:
    """Publishes the status of a node on /diagnostics, twice a second by a thread of its own: also while it computes.

    hears: `process` of the nodes whose status is received."""

    def __init__(self, node: 'CellNode') -> None:
        self._node, self._name = node, node.get_name()
        self.process = f'{started(self._name, os.getpid())}{uuid.uuid4().hex[:12]}'
        self._problem = ''
        self.hears: tuple[str, ...] = ()
        self._state: tuple[bytes, str, Mapping[str, object]] = DiagnosticStatus.OK, 'starting', {}
        self._publisher = node.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.STATUS)
        self._served, self._is_ended = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._run, name='status', daemon=True)

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
        level, sentence, values = self._state
        busy = time.monotonic() - self._served if self._served else 0.0
        own = {PROCESS: self.process, PROBLEM: self._problem, HEARS: BETWEEN.join(self.hears), BUSY_S: f'{busy:.1f}'}
        self._publisher.publish(DiagnosticArray(header=Header(stamp=self._node.now().to_msg()), status=[
            DiagnosticStatus(
                level=level, name=self._node.get_fully_qualified_name()[1:], message=sentence,
                hardware_id=self._node.get_namespace()[1:],
                values=[KeyValue(key=key, value=str(value)) for key, value in {**values, **own}.items()])]))

    def end(self) -> None:
        """Publish no more; called before the node is destroyed."""
        self._is_ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        self.publish()
        while not self._is_ended.wait(qos.STATUS_PERIOD):
            self.publish()


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by their keys."""
    return {one.key: one.value for one in status.values}


class NodeMonitor:
    """What the statuses of another node of the cell say.

    process: that of the last status, '' before the first; problem, hears, busy: as there."""

    def __init__(self, node: Node, peer: str) -> None:
        self._node, self.peer = node, peer
        self._received: dict[str, float] = {}
        self._heard: set[str] = set()  # since the last process began
        self._waited, self._last, self._watched = 0.0, 0.0, time.monotonic()
        self.process, self.problem, self.hears, self.busy = '', '', tuple[str, ...](), 0.0

    def watch(self) -> None:
        """Forget processes whose statuses stay away; called every WAKE_PERIOD.

        While this node itself stands still, statuses wait for it: that time does not count."""
        now = time.monotonic()
        self._waited, self._watched = self._waited + min(now - self._watched, _LONGEST_STEP), now
        self._received = {process: at for process, at in self._received.items()
                          if self._waited - at < qos.STATUS_LOST}

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
        return self.count() > 0 and self._waited - min(self._received.values()) > qos.STATUS_LATE

    def running(self) -> int:
        """Return how many processes run, those counted that have published no status yet."""
        return self.count() if self.process else 1

    def publishers(self) -> list[Any]:
        """Return the publishers of the status on the graph, also those of processes that were killed just now.

        One whose node has no name yet may be one of them."""
        whose = f'{self._node.get_namespace().rstrip("/")}/{self.peer}', UNNAMED
        return [one for one in self._node.get_publishers_info_by_topic(names.DIAGNOSTICS) if name_of(one) in whose]

    def receive(self, values: Mapping[str, str]) -> None:
        """Take a status, by its values; one that names no process is of another program."""
        if not values.get(PROCESS):
            return
        self.process, self.problem = values[PROCESS], values.get(PROBLEM, '')
        self.hears = tuple(filter(None, values.get(HEARS, '').split(BETWEEN)))
        self.busy = _number(values.get(BUSY_S, ''))
        if self.process not in self._received:
            self._heard.clear()
        self._heard.add(self.process)
        self._received[self.process] = self._last = self._waited


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
            self._node.create_subscription(DiagnosticArray, names.DIAGNOSTICS, self._receive, qos.STATUSES)
        name = f'{self._node.get_namespace()}/{peer}'.lstrip('/')
        if name not in self._monitors:
            self._monitors[name] = NodeMonitor(self._node, peer)
        return self._monitors[name]

    def watch(self) -> None:
        """Forget processes whose statuses stay away; called every WAKE_PERIOD."""
        for monitor in self._monitors.values():
            monitor.watch()

    def _receive(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name in self._monitors:
                self._monitors[status.name].receive(values_of(status))


class Trouble(NamedTuple):
    """What keeps a run from going on: nodes that are disconnected or restarted, several publishers of one topic, in
    words, and whether answers, or perhaps the open target, were not used because of them."""

    gone: list[str]
    restarted: list[str]
    conflict: str
    has_ignored: bool

    @property
    def nodes(self) -> list[str]:
        """The nodes that are disconnected or restarted."""
        return list(dict.fromkeys(self.gone + self.restarted))

    def __str__(self) -> str:
        """Return it in words, '' where there is none."""
        if self.nodes:
            return f'{" and ".join(f"the {_NODE_WORDS[name]}" for name in self.nodes)} is disconnected'
        others = f'another node has published {names.BALL_CENTRE} or {names.PROBE_TARGET}'
        return self.conflict or others * self.has_ignored


class CellMonitor:
    """The nodes that a calibration needs, as the graph and their statuses describe them.

    status: what the cell lacks, or that it is complete, in words."""

    def __init__(self, node: 'CellNode', recorder: 'RecorderLink') -> None:
        self._node, self._recorder = node, recorder
        self._monitors = {name: node.monitor(name) for name in names.NODES}
        self._publishers_of = {topic: node.publishers_of(topic) for topic in names.PUBLISHERS}
        self._complete_since: float | None = None
        self._endpoints: frozenset[bytes] = frozenset()
        self.status = self._logged = ''
        self._status_since = 0.0

    def missing(self, with_recorder: bool) -> list[str]:
        """Return what the cell lacks for a calibration, in words."""
        node = self._node
        missing = ['the CMM is being tried (rosette check-cmm)' if one.is_tried else
                   f'{one.conflict}: wanted one in this domain and namespace; is another cell running? Give each its '
                   'own (--domain, --namespace)' for one in self._publishers_of.values() if one.conflict]
        if not (self._publishers_of[names.BALL_CENTRE].found and target_subscriptions(node)):
            missing.append(f'no CMM: wanted one that subscribes to {names.PROBE_TARGET} and publishes '
                           f'{names.BALL_CENTRE}, got none; '
                           f'{self._remedy(names.CMM, "start simulated_cmm or connect a CMM")}')
        elif not node.has_time():
            missing.append('no time: with use_sim_time the CMM publishes /clock, none was received')
        if not self._publishers_of[names.ERROR_MOTIONS].found:
            missing.append(f'no evaluator: wanted one that publishes {names.ERROR_MOTIONS}, got none; '
                           f'{self._remedy(names.EVALUATOR, "start it")}')
        if with_recorder and (self._is_disconnected(names.RECORDER) or not self._recorder.is_there):
            missing.append(f'no recorder: wanted its service {names.START_RECORDING}, got none; '
                           f'{self._remedy(names.RECORDER, "start it, or set require_recorder to false")}')
        return missing

    def _remedy(self, name: str, words: str) -> str:
        """Return what to do where a node is missing: `words`, unless it was there."""
        return f'it has ended or hangs: {RESTART}' if self._is_disconnected(name) else words

    def update(self, now: float, with_recorder: bool) -> None:
        """Check which nodes are present; log what the cell lacks, and when it has become complete and settled.

        What it lacks is logged after SETTLING s: while nodes discover each other it changes at every moment."""
        lacks = '; '.join(self.missing(with_recorder))
        endpoints = self._find_endpoints()
        if lacks or endpoints - self._endpoints:  # those of a node that was killed leave long after it
            self._complete_since = None
        self._endpoints = endpoints
        if not lacks and self._complete_since is None:
            self._complete_since = now
        status = lacks or (names.COMPLETE if self.is_settled(now) else 'the nodes are getting connected')
        if status != self.status:
            self.status, self._status_since = status, now
        if status != self._logged and (not lacks or now - self._status_since >= SETTLING):
            log, was_complete, self._logged = self._node.get_logger(), self._logged == names.COMPLETE, status
            if lacks and was_complete and not any(one.is_tried for one in self._publishers_of.values()):
                log.warning(status)
            else:
                log.info(status)

    def is_settled(self, now: float) -> bool:
        """Return whether all nodes have been present long enough, and the recorder receives from all of them."""
        return self._complete_since is not None and now - self._complete_since >= SETTLING and self._is_recorded()

    def _is_recorded(self) -> bool:
        """Return whether the recorder receives the statuses of the others; a node without one is left out."""
        recorder = self._monitors[names.RECORDER]
        others = {monitor.process for name, monitor in self._monitors.items()
                  if name != names.RECORDER and monitor.process and not monitor.is_disconnected}
        return not recorder.process or recorder.is_disconnected or others <= set(recorder.hears)

    def processes(self) -> dict[str, str]:
        """Return what serves a run now, by node: the CMM by its endpoint, a recorder by its process."""
        recorder = self._monitors[names.RECORDER].process
        answers = b''.join(self._publishers_of[names.BALL_CENTRE].used).hex()
        return {names.CMM: answers, **({names.RECORDER: recorder} if recorder else {})}

    def trouble(self, processes: dict[str, str], ignored: int) -> 'Trouble':
        """Return what keeps a run from going on; processes, ignored: as it was asked last."""
        answers, now = self._publishers_of[names.BALL_CENTRE], self.processes()
        is_gone = {names.CMM: not answers.found & answers.used, names.RECORDER: self._is_disconnected(names.RECORDER)}
        return Trouble([name for name in processes if is_gone[name]],
                       [name for name, process in processes.items() if now.get(name) != process],
                       '; '.join(self.conflicts()), self.ignored != ignored)

    def has_new_recorder(self, processes: dict[str, str]) -> bool:
        """Return whether another recorder is there than that of a run."""
        return names.RECORDER in self.trouble(processes, self.ignored).restarted

    def conflicts(self, publisher: str = '') -> list[str]:
        """Return which topics of a run have several publishers, in words; publisher: of this node, '' of any."""
        return [one.conflict for topic, one in self._publishers_of.items()
                if one.conflict and publisher in ('', names.PUBLISHERS[topic])]

    @property
    def ignored(self) -> int:
        """Number of answers that were not used because another node published, or of targets that may not be."""
        return sum(self._publishers_of[topic].ignored for topic in (names.BALL_CENTRE, names.PROBE_TARGET))

    def problems(self, nodes: Iterable[str]) -> str:
        """Return why nodes that are there cannot do their work, in their own words; '' where all can."""
        return '; '.join(problem for name in nodes if (problem := self._monitors[name].problem)
                         and not self._is_disconnected(name))

    def is_late(self, name: str) -> bool:
        """Return whether it shows within a second whether this node is disconnected."""
        return self._monitors[name].is_late

    def busy(self) -> list[str]:
        """Return which present nodes call nothing back: they compute, or they hang."""
        return [f'{name} has answered nothing for more than {BUSY:g} s: it computes, hangs or lacks processor time'
                for name, monitor in self._monitors.items() if monitor.busy > BUSY and not monitor.is_disconnected]

    def _is_disconnected(self, name: str) -> bool:
        return self._monitors[name].is_disconnected

    def _find_endpoints(self) -> frozenset[bytes]:
        """Return the endpoints of the cell's main topics: those of a restarted node are others."""
        node = self._node
        centres, motions = map(node.resolve_topic_name, (names.BALL_CENTRE, names.ERROR_MOTIONS))
        infos = (*node.get_publishers_info_by_topic(centres), *node.get_publishers_info_by_topic(motions),
                 *node.get_subscriptions_info_by_topic(centres))
        return frozenset(bytes(info.endpoint_gid) for info in infos)
