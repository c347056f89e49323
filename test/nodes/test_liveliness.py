# SPDX-License-Identifier: Apache-2.0
"""The status that a node publishes about itself on /diagnostics, and when a cell is settled."""

import os
import socket
from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time

from rosette_ros.nodes import names, qos
from rosette_ros.nodes.liveliness import NodeMonitors, StatusPublisher, values_of
from rosette_ros.nodes.node_requests import BUSY, CellMonitor


class Graph:
    """A node's view of the graph, with the publishers of statuses by the names of their nodes; each is a process."""

    def __init__(self, *others):
        """Take the names, without namespace, of the nodes that are there before; words: what was logged."""
        self.names, self.sent = list(others), []

    def get_name(self):
        """Return the name."""
        return 'recorder'

    def get_namespace(self):
        """Return the namespace."""
        return '/rosette'

    def get_fully_qualified_name(self):
        """Return the name with the namespace."""
        return '/rosette/recorder'

    def resolve_topic_name(self, name):
        """Return the full name."""
        return f'/rosette/{name}'

    def create_subscription(self, *_):
        """Subscribe to nothing."""

    def create_publisher(self, *_):
        """Return a publisher to `sent`."""
        self.names.append('recorder')
        return SimpleNamespace(publish=self.sent.append)

    def get_publishers_info_by_topic(self, _):
        """Return the publishers; the participant of the nth begins with n."""
        return [SimpleNamespace(endpoint_gid=[number] * 16, node_namespace='/rosette', node_name=name)
                for number, name in enumerate(self.names)]


def publisher_of(graph):
    """Return a StatusPublisher whose messages go to graph.sent."""
    return StatusPublisher(graph, lambda: SimpleNamespace(to_msg=Time))


def taking(graph, *processes, peer='recorder'):
    """Return the monitor of a node, by which these statuses, or the values of others, were received."""
    monitors = NodeMonitors(graph)
    found = monitors.of(peer)
    for one in processes:
        found.receive({'process': one} if isinstance(one, str) else one)
    return found


@pytest.mark.parametrize(('problem', 'hears'), [
    ('', ()), ('no room', ()), ('', ('cmm 1a2b', 'evaluator 1, of its own')), ('two\nlines', ('cmm 1a2b',))])
def test_a_status_holds_what_it_was_given(problem, hears):
    """The problem is one line; every process has a name of its own; a monitor reads the same."""
    graph = Graph()
    sent, status, other = graph.sent, publisher_of(graph), publisher_of(graph)
    status.hears = hears
    status.report(problem)
    assert len(sent) == bool(problem), 'a change is published at once'
    status.describe(b'\1', 'recording', {'lost': 0})
    status.publish()
    one, = sent[-1].status
    assert (one.level, one.name, one.message, one.hardware_id) == (b'\1', 'rosette/recorder', 'recording', 'rosette')
    assert values_of(one)['lost'] == '0'
    monitor = NodeMonitors(graph)
    found = monitor.of('recorder')
    monitor._receive(sent[-1])
    assert found.process == status.process != other.process
    assert found.process == f'recorder {os.getpid()} on {socket.gethostname()} {"00" * 12}'
    assert (found.problem, found.hears) == (' '.join(problem.split()), hears)


@pytest.mark.parametrize(('cmm', 'recorder', 'hears', 'is_disconnected', 'is_settled'), [
    ('cmm 2', 'recorder 1', ('cmm 2', 'evaluator 1'), False, True),
    ('cmm 2', 'recorder 1', ('cmm 1', 'evaluator 1'), False, False),
    ('cmm 2', 'recorder 1', ('cmm 2',), False, False),
    ('cmm 2', 'recorder 1', (), False, False),
    ('', 'recorder 1', ('evaluator 1',), False, True),
    ('cmm 2', '', (), False, True),
    ('cmm 2', 'recorder 1', (), True, True),
])
def test_a_run_waits_until_the_recorder_receives_from_all(cmm, recorder, hears, is_disconnected, is_settled):
    """The status of an earlier process does not count; a node without a status is not waited for."""
    monitor = CellMonitor.__new__(CellMonitor)
    monitor._complete_since = 0.0
    monitor._monitors = {
        names.CMM: SimpleNamespace(process=cmm, is_disconnected=False),
        names.EVALUATOR: SimpleNamespace(process='evaluator 1', is_disconnected=False),
        names.RECORDER: SimpleNamespace(process=recorder, hears=hears, is_disconnected=is_disconnected)}
    assert monitor.is_settled(10.0) == is_settled
    assert not monitor.is_settled(0.5)


def test_a_node_that_computes_says_so_and_is_there(wait_until):
    """Statuses begin with the first callback, are published by another thread, and end before the node does."""
    graph = Graph()
    sent, status = graph.sent, publisher_of(graph)
    status.end()
    assert sent == [], 'a node that was never called back has no thread'
    status = publisher_of(graph)
    status.serve()
    wait_until(lambda: len(sent) >= 3)  # nothing is called back meanwhile
    status.serve()
    status.end()
    published = len(sent)
    status.publish()
    busy = [float(values_of(one.status[0])['busy_s']) for one in sent]
    assert busy[0] < busy[1] < busy[2] > busy[-1]
    assert len(sent) == published + 1


class Watched:
    """A NodeMonitor of a node with a subscription, and the time that it reads."""

    def __init__(self, monkeypatch):
        """Start at a time of its own, without a publisher."""
        self.now, self.publishers = 100.0, 0
        monkeypatch.setattr('rosette_ros.nodes.liveliness.time', SimpleNamespace(monotonic=lambda: self.now))
        self.monitors = NodeMonitors(SimpleNamespace(
            get_namespace=lambda: '/rosette', create_subscription=lambda *_: None,
            get_publishers_info_by_topic=lambda _: self.publishers * [
                SimpleNamespace(node_namespace='/rosette', node_name='cmm')] + [
                SimpleNamespace(node_namespace='/rosette', node_name='recorder')]))
        self.monitor = self.monitors.of('cmm')

    def receive(self, process, busy=0.0):
        """Receive a status."""
        self.monitor.receive({'process': process, 'busy_s': str(busy)})

    def wait(self, duration, step=0.1):
        """Let time pass in steps of the node that watches."""
        for _ in range(round(duration / step)):
            self.now += step
            self.monitors.watch()


def test_a_node_whose_statuses_stay_away_is_disconnected(monkeypatch):
    """Killed: its publisher stays on the graph; taken down in good order: its publisher is not there any more."""
    watched = Watched(monkeypatch)
    monitor = watched.monitor
    assert (monitor.is_disconnected, monitor.running()) == (False, 1), 'it may publish none at all'
    watched.publishers = 1
    watched.receive('cmm 1')
    watched.wait(qos.STATUS_LATE - 0.1)
    assert (monitor.is_disconnected, monitor.is_late) == (False, False)
    watched.wait(qos.STATUS_LOST - qos.STATUS_LATE)
    assert (monitor.is_disconnected, monitor.is_late) == (False, True)
    watched.wait(0.3)
    assert (monitor.is_disconnected, monitor.is_late, monitor.running()) == (True, False, 0)
    watched.publishers = 2
    watched.receive('cmm 2')
    assert (monitor.is_disconnected, monitor.running(), monitor.process) == (False, 1, 'cmm 2')
    watched.receive('cmm 3')
    assert monitor.count() == 1, 'the one before may have been killed'
    watched.receive('cmm 2')
    assert (monitor.count(), monitor.process) == (2, 'cmm 2'), 'two of one name'
    watched.receive('cmm 3')
    assert monitor.count() == 2
    watched.publishers = 0
    assert monitor.is_disconnected


def test_a_node_that_was_replaced_is_late_until_it_is_forgotten(monkeypatch):
    """What was asked of the one that was killed is not asked again before the run knows that it has ended."""
    watched = Watched(monkeypatch)
    watched.publishers = 2
    watched.receive('cmm 1')
    watched.wait(qos.STATUS_LATE)
    watched.receive('cmm 2')
    watched.wait(0.1)
    assert watched.monitor.is_late
    watched.wait(qos.STATUS_LOST - qos.STATUS_LATE)
    assert not watched.monitor.is_late


def test_statuses_that_wait_for_a_node_that_stood_still_are_not_missed(monkeypatch):
    """After a minute of its own calculation, or of sleep of the computer, no other node seems to be disconnected."""
    watched = Watched(monkeypatch)
    watched.publishers = 1
    watched.receive('cmm 1')
    watched.wait(60.0, step=60.0)
    assert not watched.monitor.is_disconnected
    assert watched.monitor.silence < qos.STATUS_LOST
    watched.wait(2.0)
    assert watched.monitor.is_disconnected
    watched.wait(20.0)
    assert watched.monitor.silence == pytest.approx(22.4)
    watched.receive('cmm 2')
    assert watched.monitor.silence == 0.0


def test_a_node_that_answers_nothing_is_told(monkeypatch):
    """As long as its process runs; what has ended is told as disconnected."""
    watched = Watched(monkeypatch)
    cell = CellMonitor.__new__(CellMonitor)
    cell._monitors = {names.CMM: watched.monitor}
    watched.publishers = 1
    watched.receive('cmm 1', busy=BUSY - 0.1)
    assert cell.busy() == []
    watched.receive('cmm 1', busy=12.3)
    assert cell.busy() == ['cmm has answered nothing for more than 2 s: it computes, hangs or lacks processor time']
    watched.publishers = 0
    assert cell.busy() == []


def test_the_process_that_is_heard_first_has_the_role(monkeypatch):
    """What another one says does not count while it runs: not its state, its problem, nor a restart of it. Killed, the
    other one takes the role, with what it has said last."""
    now = [100.0]
    monkeypatch.setattr('rosette_ros.nodes.liveliness.time', SimpleNamespace(monotonic=lambda: now[0]))
    said, changes, words = [], [], []
    monitor = taking(Graph('recorder', 'recorder', 'cmm'), {'process': 'recorder 1 on a 00', 'problem': ''})
    monitor.on_change = lambda: changes.append(monitor.process)
    for _ in range(5):
        now[0] += 0.5
        words += monitor.watch()
        for process in ('recorder 1 on a 00', 'recorder 2 on b 01'):
            monitor.receive({'process': process, 'problem': 'of another' if '2' in process else ''})
            monitor.admit(process, 'run_state', lambda process=process: said.append(process))
    assert (monitor.process, monitor.problem, monitor.count(), changes) == ('recorder 1 on a 00', '', 1, [])
    assert said == ['recorder 1 on a 00'] * 5
    assert words == [f'what recorder 2 on b publishes on {topic} is not used: it is not the recorder of this cell, '
                     'recorder 1 on a is' for topic in ('/diagnostics', 'run_state')], 'named once'
    for _ in range(5):
        now[0] += 0.5
        monitor.watch()
        monitor.receive({'process': 'recorder 2 on b 01'})
    assert (monitor.process, changes) == ('recorder 2 on b 01', ['recorder 2 on b 01'])
    assert said[5:] == ['recorder 2 on b 01']


def test_a_message_without_a_process_is_of_a_stranger(monkeypatch):
    """Named by the node that publishes there; so is a status under a name that no node has."""
    now = [100.0]
    monkeypatch.setattr('rosette_ros.nodes.liveliness.time', SimpleNamespace(monotonic=lambda: now[0]))
    monitor = taking(Graph('intruder'), {'process': 'cmm 1 deadbeef', 'problem': 'forged'}, peer='cmm')
    monitor.admit('', 'run', lambda: pytest.fail('used'))
    now[0] += 0.4
    assert (monitor.process, monitor.problem, monitor.watch()) == ('', '', []), 'it may just take the role'
    words = []
    for _ in range(5):
        now[0] += 0.4
        words += monitor.watch()
    assert words == [
        'what cmm 1 publishes on /diagnostics is not used: it is not the cmm of this cell',
        'what /rosette/intruder publishes on run is not used: it is not the cmm of this cell']


@pytest.mark.parametrize(('up', 'others', 'is_refused'), [
    ('60.0', 1, True), ('0.0', 1, False), ('60.0', 0, False), ('', 1, False)])
def test_the_elder_of_two_processes_keeps_the_role(up, others, is_refused):
    """One that runs for longer, where the graph shows it; the elder one itself does not end."""
    graph = Graph(*['recorder'] * others)
    own = publisher_of(graph)
    monitor = taking(graph, {'process': 'recorder 7 on b ff', 'up_s': up}, {'process': own.process, 'up_s': '0.1'})
    assert monitor.elder(own) == ('recorder 7 on b ff' if is_refused else '')


def test_a_process_that_stood_still_has_lost_its_role(monkeypatch):
    """Suspended for longer than a status may stay away, it is the younger one."""
    now = [100.0]
    monkeypatch.setattr('rosette_ros.nodes.liveliness.time', SimpleNamespace(monotonic=lambda: now[0]))
    status = publisher_of(Graph())
    for wait, up in ((1.0, 1.0), (1.0, 2.0), (qos.STATUS_LOST + 0.1, 0.0), (0.5, 0.5)):
        now[0] += wait
        status.publish()
        assert status.up == pytest.approx(up)
