# SPDX-License-Identifier: Apache-2.0
"""Nodes take no events of the middleware; who cannot be connected to them is found on the graph."""

import pytest
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosette_msgs.msg import BallCentre, RunState

from rosette_ros.nodes import qos
from rosette_ros.nodes.base_node import CellNode
from rosette_ros.nodes.graph_node import GraphNode

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
VOLATILE = QoSProfile(depth=10)


@pytest.fixture
def nodes(domain_id):
    """Yield a GraphNode and a Node of others."""
    context = Context()
    context.init(domain_id=domain_id)
    made = GraphNode('mine', namespace='/rosette', context=context), Node('bridge', namespace='/cmm', context=context)
    yield made
    for node in made:
        node.destroy_node()
    context.try_shutdown()


def test_no_publisher_or_subscription_takes_events(nodes):
    """Also not those that rclpy makes itself: an event that is taken can hang the node."""
    mine, bridge = nodes
    for node in nodes:
        node.create_publisher(BallCentre, 'ball_centre', qos.ANSWER)
        node.create_subscription(BallCentre, 'ball_centre', lambda _: None, qos.ANSWER)
    assert len(list(mine.publishers)) > 1  # of parameter events, too
    assert [handler for one in (*mine.publishers, *mine.subscriptions) for handler in one.event_handlers] == []
    assert [handler for one in bridge.subscriptions for handler in one.event_handlers] != [], 'or there is no need'


def test_a_publisher_that_cannot_be_received_is_told(nodes, wait_until):
    """Best effort where it has to be reliable; one that fits is not mentioned."""
    mine, bridge = nodes
    mine.create_subscription(BallCentre, 'ball_centre', lambda _: None, qos.ANSWER)
    fits = bridge.create_publisher(BallCentre, '/rosette/ball_centre', qos.ANSWER)
    wait_until(lambda: mine.count_publishers('ball_centre'))
    assert mine.unconnected() == set()
    bridge.create_publisher(BallCentre, '/rosette/ball_centre', BEST_EFFORT)
    wait_until(mine.unconnected)
    assert mine.unconnected() == {'nothing that /cmm/bridge publishes on /rosette/ball_centre is received: Best effort '
                                  'publisher and reliable subscription'}
    assert fits.get_subscription_count() == 1


def test_a_subscription_whose_deadline_nobody_keeps_is_told(nodes, wait_until):
    """Beside one that fits: only the one that does not is named."""
    mine, bridge = nodes
    offered = mine.create_publisher(BallCentre, 'ball_centre', qos.ANSWER)
    fits = bridge.create_subscription(BallCentre, '/rosette/ball_centre', lambda _: None, qos.ANSWER)
    bridge.create_subscription(BallCentre, '/rosette/ball_centre', lambda _: None,
                               QoSProfile(depth=10, deadline=Duration(seconds=1)))
    wait_until(lambda: fits.get_publisher_count() and offered.get_subscription_count() and mine.unconnected())
    assert mine.unconnected() == {'/cmm/bridge receives nothing that is published on /rosette/ball_centre: '
                                  'Subscription has a deadline, but publisher does not'}


def test_a_subscription_that_receives_nothing_is_told(nodes, wait_until):
    """A reader that wants what was published before it came, of a topic that does not keep it."""
    mine, bridge = nodes
    mine.create_publisher(RunState, 'run_state', VOLATILE)
    bridge.create_subscription(RunState, '/rosette/run_state', lambda _: None, qos.STATE)
    wait_until(mine.unconnected)
    assert mine.unconnected() == {'/cmm/bridge receives nothing that is published on /rosette/run_state: Volatile '
                                  'publisher and transient local subscription'}


def test_what_is_due_after_a_time_is_done_once(ros):
    """An executor that is late calls a timer twice: a CMM answered a target twice."""
    with ros():
        node, done = CellNode('late'), []
        node.after(100.0, lambda: done.append(1))
        timer = list(node.timers)[-1]
        for _ in range(2):
            timer.callback()
        node.destroy_node()
    assert done == [1]
