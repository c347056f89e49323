# SPDX-License-Identifier: Apache-2.0
"""Which messages of a topic are used while its publishers are found: what DDS and the graph know at each moment."""

from types import SimpleNamespace

import pytest

from rosette_ros.nodes.liveliness import LEAVES, TopicPublishers
from rosette_ros.nodes.qos import STATUS_LOST


class Topic:
    """What a node and a subscription are told of a topic: publishers on the graph, and how many are matched."""

    def __init__(self):
        """Start without a publisher."""
        self.on_graph, self.matched = [], 0
        self.name_of = lambda number: f'node_{number}'

    def resolve_topic_name(self, name):
        """Return the name of the topic."""
        return f'/rosette/{name}'

    def get_publishers_info_by_topic(self, _):
        """Return the publishers on the graph."""
        return [SimpleNamespace(endpoint_gid=[number] * 16, node_namespace='/rosette', node_name=self.name_of(number))
                for number in self.on_graph]

    def get_publisher_count(self):
        """Return how many are matched."""
        return self.matched


@pytest.fixture
def clock(monkeypatch):
    """Return the time that is read, which tests set."""
    made = SimpleNamespace(now=100.0)
    monkeypatch.setattr('rosette_ros.nodes.liveliness.time', SimpleNamespace(monotonic=lambda: made.now))
    return made


def publishers_of(topic, peer):
    """Return a TopicPublishers of a topic, whose subscription it is too."""
    made = TopicPublishers(topic, 'run_state', peer)
    made.judge(topic)
    return made


def test_while_there_are_two_nothing_is_used(clock):
    """From the moment that the second one is matched, which may be before the graph shows it, until it is seen to have
    left: what it had published is delivered by then."""
    topic = Topic()
    made = publishers_of(topic, SimpleNamespace(publishers=list, running=lambda: 0, is_of=lambda gid: False))
    topic.on_graph, topic.matched = [1], 1
    assert made.admits()
    topic.matched = 2
    assert not made.admits()
    topic.on_graph = [1, 2]
    made.watch()
    assert not made.admits()
    assert made.conflict == '2 nodes publish /rosette/run_state (/rosette/node_1 and /rosette/node_2)'
    topic.on_graph, topic.matched = [1], 1
    assert not made.admits()
    made.watch()
    assert made.admits() and made.conflict == ''
    assert made.ignored == 3


def test_an_idle_one_does_not_count_beside_another(clock):
    """A sequencer that measures nothing; alone, it counts."""
    topic = Topic()
    made = publishers_of(topic, SimpleNamespace(publishers=list, running=lambda: 0, is_of=lambda gid: False))
    made.is_idle = lambda gid: gid == bytes([1] * 16)
    for there, used in ([1], 1), ([1, 2], 2), ([2], 2), ([1], 1):
        topic.on_graph, topic.matched = there, len(there)
        made.look()
        assert made.admits() and made.used == {bytes([used] * 16)} and len(made.running) == len(there)
    topic.on_graph, topic.matched = [1, 2, 3], 3
    assert not made.admits() and len(made.found) == 2


def test_a_node_without_a_status_that_is_started_again_is_told_as_that(clock):
    """While its process before may still be on the graph: nothing of either is used. Later there are two of one name,
    as where another process has another name, or one process publishes twice."""
    topic = Topic()
    peer = SimpleNamespace(publishers=list, running=lambda: 1, is_of=lambda gid: False)
    made = publishers_of(topic, peer)
    topic.name_of = lambda number: 'cmm'
    topic.on_graph, topic.matched = [1], 1
    made.look()
    clock.now += 100.0
    topic.on_graph, topic.matched = [1, 2], 2
    assert not made.admits() and made.is_restart
    assert made.conflict == '/rosette/cmm was restarted, and its process before leaves the graph within 20 s'
    clock.now += LEAVES
    made.watch()
    assert not made.admits() and not made.is_restart
    assert made.conflict == '2 nodes publish /rosette/run_state (/rosette/cmm and /rosette/cmm)'
    topic.on_graph, topic.matched = [2], 1
    made.watch()
    assert made.admits() and made.used == {bytes([2] * 16)}
    topic.name_of = lambda number: f'node_{number}'
    topic.on_graph, topic.matched = [2, 3], 2
    assert not made.admits() and not made.is_restart
    topic.name_of, peer.publishers = lambda number: 'cmm', lambda: topic.get_publishers_info_by_topic('')
    topic.on_graph, topic.matched = [2, 4], 2
    peer.running = lambda: 2
    made.look()
    assert len(made.found) == 2 and not made.is_restart, 'their statuses say that both run'


def test_another_publisher_that_is_alone_is_used(clock):
    """Until then that which was alone last."""
    topic, used = Topic(), []
    made = publishers_of(topic, SimpleNamespace(publishers=list, running=lambda: 0, is_of=lambda gid: False))
    for others in ([1], [1, 2], [2], [], [2], [3]):
        topic.on_graph, topic.matched = others, len(others)
        made.look()
        used.append(max(made.used)[0])
    assert used == [1, 1, 2, 2, 2, 3]


def test_a_restarted_node_is_there_before_its_first_status(clock):
    """The last status of the one before is forgotten meanwhile; one that is never heard has ended."""
    topic, heard = Topic(), 1

    peer = SimpleNamespace(
        publishers=lambda: topic.get_publishers_info_by_topic(''), running=lambda: heard, is_of=lambda gid: False)
    made = publishers_of(topic, peer)
    topic.on_graph, topic.matched = [1], 1
    made.watch()
    topic.on_graph, topic.matched = [], 0
    clock.now += 0.4
    made.look()
    topic.on_graph, topic.matched, heard = [2], 1, 0
    made.look()
    assert made.found == {bytes([2] * 16)}
    clock.now += STATUS_LOST
    made.watch()
    assert not made.found
    heard = 1
    made.watch()
    assert made.found == {bytes([2] * 16)}
