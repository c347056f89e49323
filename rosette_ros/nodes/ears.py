# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that are emptied now and then instead of waking anyone for each message."""

import time

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription

from rosette_ros.nodes.runner import CellNode

REST, IDLE_REST = 0.01, 0.05
"""How long a listening node rests between two looks at its queues, while a run is on and else, s."""


class _NotForMessages(CallbackGroup):
    """Keeps subscriptions out of the executor; their events are its business as usual."""

    def can_execute(self, entity):
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity):
        return True

    def ending_execution(self, entity):
        pass


class Ears:
    """Raw subscriptions of one node to many topics.

    Waiting for messages costs an executor in Python much more than taking them: what only wants to
    hear everything, and not at once, looks a few times per second. The queues hold what comes in
    between.
    """

    def __init__(self, node, on_lost):
        """Listen to nothing yet; on_lost(topic, count) is called where messages were lost."""
        self._node = node
        self._on_lost = on_lost
        self._group = _NotForMessages()
        self._subscriptions = {}

    @property
    def topics(self):
        """The topics in the order of subscribing."""
        return tuple(self._subscriptions)

    def listen(self, topic, message_class, profile):
        """Subscribe to a topic."""
        events = SubscriptionEventCallbacks(
            message_lost=lambda event: self._on_lost(topic, event.total_count_change),
            use_default_callbacks=False)
        self._subscriptions[topic] = self._node.create_subscription(
            message_class, topic, _never, profile, raw=True, callback_group=self._group,
            event_callbacks=events)

    def take(self):
        """Return all (received, topic, data, published) since the last call, in order of receipt.

        received, published: wall time, ns; data: CDR bytes as on the wire.
        """
        heard = []
        for topic, subscription in self._subscriptions.items():
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(subscription.msg_type, True)) is not None:
                    data, info = taken
                    heard.append((info['received_timestamp'], topic, data,
                                  info['source_timestamp']))
        heard.sort(key=lambda entry: entry[0])
        return heard

    def is_connected(self):
        """Return whether every publisher known on the graph is connected to its subscription."""
        return all(subscription.get_publisher_count() >= self._node.count_publishers(topic)
                   for topic, subscription in self._subscriptions.items())


class ListeningNode(CellNode):
    """A node that looks at its queues now and then, in between does other things, and rests."""

    def __init__(self, name, wanted=()):
        """Listen to nothing yet."""
        super().__init__(name, wanted)
        self.ears = Ears(self, self.lost)
        self.rest = IDLE_REST

    def hear(self, heard):
        """Take what was said since the last step, entries as of Ears.take."""

    def lost(self, topic, count):
        """Take note that messages were lost on the way."""

    def listen(self):
        """Hear everything that has been said until now."""
        self.hear(self.ears.take())

    def step(self):
        """Hear, do one other thing, rest."""
        self.listen()
        self.executor.spin_once(timeout_sec=0)
        time.sleep(self.rest)


def _never(message):
    """Stand where rclpy wants a callback."""
