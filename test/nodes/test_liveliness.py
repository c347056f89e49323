# SPDX-License-Identifier: Apache-2.0
"""Heartbeats: what a node publishes about itself, and when a cell is settled."""

from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time

from rosette_ros.nodes import names, qos
from rosette_ros.nodes.liveliness import CellMonitor, HeartbeatPublisher


@pytest.mark.parametrize(('problem', 'hears'), [
    ('', ()), ('no room', ()), ('', ('cmm 1a2b', 'a CMM, of its own')), ('two\nlines', ('cmm 1a2b',))])
def test_a_heartbeat_holds_what_it_was_given(problem, hears):
    """The problem is one line; every process has a name of its own."""
    sent = []
    publisher = SimpleNamespace(publish=sent.append)
    node = SimpleNamespace(get_name=lambda: 'recorder', create_publisher=lambda *_, **__: publisher,
                           now=lambda: SimpleNamespace(to_msg=Time))
    heartbeat, other = HeartbeatPublisher(node), HeartbeatPublisher(node)
    heartbeat.hears = hears
    heartbeat.report(problem)
    assert len(sent) == bool(problem), 'a change is published at once'
    heartbeat.publish()
    message = sent[-1]
    assert (message.node, message.period) == ('recorder', qos.HEARTBEAT_PERIOD)
    assert message.process == heartbeat.process != other.process
    assert message.problem == ' '.join(problem.split())
    assert tuple(message.hears) == hears


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
    """The heartbeat of an earlier process does not count; a node without heartbeat is not waited for."""
    monitor = CellMonitor.__new__(CellMonitor)
    monitor._complete_since = 0.0
    monitor._monitors = {
        names.CMM: SimpleNamespace(process=cmm, is_disconnected=False),
        names.EVALUATOR: SimpleNamespace(process='evaluator 1', is_disconnected=False),
        names.RECORDER: SimpleNamespace(process=recorder, hears=hears, is_disconnected=is_disconnected)}
    assert monitor.is_settled(10.0) == is_settled
    assert not monitor.is_settled(0.5)
