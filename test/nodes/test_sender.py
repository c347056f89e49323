# SPDX-License-Identifier: Apache-2.0
"""Which messages of a topic are used while its publishers are found: what DDS and the graph know at each moment."""

from types import SimpleNamespace

import pytest

from rosette_ros.nodes.liveliness import SETTLING
from rosette_ros.nodes.qos import HEARTBEAT_LOST
from rosette_ros.nodes.senders import Sender


class Topic:
    """What a node and a subscription are told of a topic: publishers on the graph, and how many are matched."""

    def __init__(self):
        """Start without a publisher."""
        self.on_graph, self.matched = [], 0

    def resolve_topic_name(self, name):
        """Return the name of the topic."""
        return f'/rosette/{name}'

    def get_publishers_info_by_topic(self, _):
        """Return the publishers on the graph."""
        return [SimpleNamespace(endpoint_gid=[number] * 16, node_namespace='/rosette', node_name=f'node_{number}')
                for number in self.on_graph]

    def get_publisher_count(self):
        """Return how many are matched."""
        return self.matched


@pytest.fixture
def clock(monkeypatch):
    """Return the time that a sender reads, which tests set."""
    made = SimpleNamespace(now=100.0)
    monkeypatch.setattr('rosette_ros.nodes.senders.time', SimpleNamespace(monotonic=lambda: made.now))
    return made


def test_a_publisher_that_is_matched_but_not_on_the_graph_is_not_used(clock):
    """Its first message may be there before the graph shows it, its last one after it has left."""
    topic = Topic()
    sender = Sender(topic, 'run_state', SimpleNamespace(publishers=list, running=lambda: 0, is_open=False))
    sender.judge(topic)
    topic.on_graph, topic.matched = [1], 1
    assert sender.admits()
    topic.matched = 2
    assert not sender.admits()
    topic.on_graph = [1, 2]
    sender.watch()
    assert not sender.admits()
    assert sender.rivals == '2 nodes publish /rosette/run_state (/rosette/node_1 and /rosette/node_2)'
    clock.now += 60.0
    sender.watch()
    topic.on_graph, topic.matched = [1], 1
    assert not sender.admits()
    assert sender.rivals == ''
    clock.now += SETTLING
    sender.watch()
    assert sender.admits()
    assert sender.refused == 3


def test_a_successor_is_no_rival_and_a_second_node_is_told_once(clock):
    """A process that was killed is known to have ended a moment after its successor is there."""
    topic, told = Topic(), []
    sender = Sender(topic, 'run_state', SimpleNamespace(publishers=list, running=lambda: 0, is_open=False))
    sender.judge(topic)
    sender.on_rivals = told.append
    topic.on_graph, topic.matched = [1], 1
    sender.watch()
    for others, seconds, lines in (([1, 2], 0.0, 0), ([1, 2], 0.9 * SETTLING, 0), ([2], 0.1, 0), ([2], 60.0, 0),
                                   ([2, 3], 0.0, 0), ([2, 3], SETTLING, 1), ([2, 3], 60.0, 1)):
        topic.on_graph, topic.matched = others, len(others)
        clock.now += seconds
        sender.watch()
        assert len(told) == lines, (others, seconds)
    assert told == ['2 nodes publish /rosette/run_state (/rosette/node_2 and /rosette/node_3)']


def test_a_restarted_node_is_there_before_its_first_heartbeat(clock):
    """The last heartbeat of the one before is forgotten meanwhile; one that is never heard has ended."""
    topic, heard = Topic(), 1

    peer = SimpleNamespace(
        publishers=lambda: topic.get_publishers_info_by_topic(''), running=lambda: heard, is_open=False)
    sender = Sender(topic, 'ball_centre', peer)
    sender.judge(topic)
    topic.on_graph, topic.matched = [1], 1
    sender.watch()
    topic.on_graph, topic.matched = [], 0
    clock.now += 0.4
    sender.look()
    topic.on_graph, topic.matched, heard = [2], 1, 0
    sender.look()
    assert sender.alive == {bytes([2] * 16)}
    clock.now += HEARTBEAT_LOST
    sender.watch()
    assert not sender.alive
    heard = 1
    sender.watch()
    assert sender.alive == {bytes([2] * 16)}


def test_a_successor_is_used_once_it_is_known_that_the_one_before_has_ended(clock):
    """However long it is alone: the one before may only be late with its heartbeat."""
    topic = Topic()
    peer = SimpleNamespace(
        publishers=lambda: topic.get_publishers_info_by_topic(''), running=lambda: 1, is_open=False)
    sender = Sender(topic, 'ball_centre', peer)
    sender.judge(topic)
    topic.on_graph, topic.matched = [1], 1
    sender.watch()
    topic.on_graph, topic.matched, peer.is_open = [1, 2], 2, True
    sender.watch()
    clock.now += 2 * SETTLING
    sender.watch()
    assert sender.alive == {bytes([2] * 16)} != sender.bound
    assert not sender.admits()
    peer.is_open = False
    sender.watch()
    assert sender.bound == {bytes([2] * 16)}
    assert sender.admits()
