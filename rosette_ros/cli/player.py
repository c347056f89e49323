# SPDX-License-Identifier: Apache-2.0
"""Puts the inputs of an evaluator from a log back onto the graph, byte for byte."""

import os
import time

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosette_msgs.msg import ErrorMotions

from rosette_ros.core.errors import CellError
from rosette_ros.nodes import environment, names
from rosette_ros.nodes.interfaces import interface_class

INPUTS = (names.PROBE_TARGET, names.BALL_CENTRE, names.RUN_STATE, names.TF_STATIC, names.CLOCK)
"""What an evaluator hears, by the last part of the topic."""

FASTEST = 4000
"""Most messages per second: a listener's queue of some thousand must not overflow."""
LIVE_PATIENCE = 1.5
"""How long a live cell is looked for before anything is published, s."""
_BATCH = 100
_STEP = 0.05


class Player:
    """Publishes logged messages and hears the error motions that come back; a context manager.

    topics: the TopicSummary of each topic in the log; domain: ROS domain, None for that of the
    environment. Raises CellError where the log holds no ball centres.
    """

    def __init__(self, topics, domain=None):
        """Join the graph and announce the topics."""
        os.environ.update(environment.added(os.environ))
        chosen = {topic.name: topic for topic in topics if _last(topic.name) in _LAST_PARTS}
        answers = [name for name in chosen if _last(name) == names.BALL_CENTRE]
        if not answers:
            raise CellError(f'replay: wanted a log with the topic {names.BALL_CENTRE}, got '
                            f'{", ".join(topic.name for topic in topics) or "no topics"}')
        self.namespace = answers[0].rpartition('/')[0] or '/'
        self._context = Context()
        self._context.init(domain_id=domain)
        self._node = Node(f'player_{os.getpid()}', namespace=self.namespace,
                          context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publishers = {
            name: self._node.create_publisher(interface_class(topic.type_name), name,
                                              qos_profile(topic.qos, topic.messages))
            for name, topic in chosen.items()}
        self.heard = []
        self._node.create_subscription(ErrorMotions, names.ERROR_MOTIONS, self.heard.append, 10)

    def __enter__(self):
        """Return the player."""
        return self

    def __exit__(self, *_):
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    @property
    def remappings(self):
        """Pairs of names with which an evaluator hears what was recorded, where it was recorded."""
        return () if names.TF_STATIC in self._publishers else names.remappings(self.namespace)

    def refuse_live_cell(self):
        """Raise CellError where a CMM or a sequencer is on the graph: a target would move it.

        Nodes find each other in their own time: one is looked for during LIVE_PATIENCE.
        """
        deadline = time.monotonic() + LIVE_PATIENCE
        while time.monotonic() < deadline:
            self._refuse_publishers()
            self.spin(_STEP)
        self._refuse_publishers()

    def _refuse_publishers(self):
        for topic in (names.BALL_CENTRE, names.PROBE_TARGET):
            own = self._node.resolve_topic_name(topic) in self._publishers
            if self._node.count_publishers(topic) > own:
                raise CellError(
                    f'replay: somebody else publishes {self._node.resolve_topic_name(topic)}: a '
                    'live cell is on this graph, and recorded targets would move its machine. '
                    'End the cell, or choose another --domain')

    def await_evaluator(self, timeout):
        """Return whether an evaluator hears us within `timeout`, s."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            if self._has_evaluator():
                return True
            self.spin(_STEP)
        return False

    def _has_evaluator(self):
        wanted = [publisher for name, publisher in self._publishers.items()
                  if _last(name) != names.CLOCK]
        return (all(publisher.get_subscription_count() for publisher in wanted)
                and self._node.count_publishers(names.ERROR_MOTIONS) > 0)

    def play(self, messages, rate=None):
        """Publish logged messages in order; those of other topics are left out.

        messages: LoggedMessage each; rate: how many times as fast as recorded, None: as fast as
        FASTEST allows.
        """
        began, start = time.monotonic(), None
        chosen = (message for message in messages if message.topic in self._publishers)
        for count, message in enumerate(chosen):
            start = message.log_time if start is None else start
            if rate:
                self._spin_until(began + 1e-9 * (message.log_time - start) / rate)
            elif count % _BATCH == 0:
                self._spin_until(began + count / FASTEST)
            self._publishers[message.topic].publish(message.data)

    def _spin_until(self, due):
        while (left := due - time.monotonic()) > 0:
            self.spin(min(_STEP, left))

    def await_motions(self, run_ids, timeout):
        """Return the ErrorMotions heard for each of the runs, as far as they came in time."""
        deadline = time.monotonic() + timeout
        while True:
            found = {message.run_id: message for message in self.heard}
            if all(run_id in found for run_id in run_ids) or time.monotonic() > deadline:
                return found
            self.spin(_STEP)

    def spin(self, timeout):
        """Let the graph work for at most `timeout`, s."""
        self._executor.spin_once(timeout_sec=max(timeout, 0.0))


_LAST_PARTS = frozenset(name.rpartition('/')[2] for name in INPUTS)


def _last(topic):
    return topic.rpartition('/')[2]


_HISTORY = {'keep_all': HistoryPolicy.KEEP_ALL}
_RELIABILITY = {'best_effort': ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {'transient_local': DurabilityPolicy.TRANSIENT_LOCAL}
_LIVELINESS = {'manual_by_topic': LivelinessPolicy.MANUAL_BY_TOPIC}


def qos_profile(recorded, messages):
    """Return the QoSProfile to publish with: the first recorded Qos, defaults where there is none.

    The queue is as long as there are messages, so that none is dropped before a listener has it.
    Limits in time (deadline, lifespan, lease) are left out: they were promises of a live cell.
    """
    depth = max(messages, 1)
    if not recorded:
        return QoSProfile(depth=depth)
    qos = recorded[0]
    return QoSProfile(
        history=_HISTORY.get(qos.history, HistoryPolicy.KEEP_LAST), depth=max(qos.depth, depth),
        reliability=_RELIABILITY.get(qos.reliability, ReliabilityPolicy.RELIABLE),
        durability=_DURABILITY.get(qos.durability, DurabilityPolicy.VOLATILE),
        liveliness=_LIVELINESS.get(qos.liveliness, LivelinessPolicy.AUTOMATIC))
