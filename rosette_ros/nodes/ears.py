# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that a node looks into by itself instead of being called for each message.

An rclpy executor goes through all entities of a node for every message, which takes ten times as
long as taking the message. A node of the cell therefore waits for its few busy topics alone, and
lets an executor look after everything else some ten times per second. It takes messages from their
queues the way rclpy.wait_for_message does.
"""

from contextlib import ExitStack

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription


class Aside(CallbackGroup):
    """Keeps subscriptions out of an executor; their events are its business as usual."""

    def can_execute(self, entity):
        """Tell the executor what it may run."""
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity):
        """Let everything that can be executed begin."""
        return True

    def ending_execution(self, entity):
        """Do nothing: any number may run."""


class Ears:
    """The subscriptions of one node that it looks into by itself."""

    def __init__(self, node, on_lost):
        """Listen to nothing yet; on_lost(topic, count) is called where messages were lost."""
        self._node = node
        self._on_lost = on_lost
        self._group = Aside()
        self._subscriptions = {}

    @property
    def topics(self):
        """The topics in the order of subscribing."""
        return tuple(self._subscriptions)

    def listen(self, topic, message_class, profile, raw=False, tell_incompatible=False):
        """Subscribe to a topic.

        raw: take the bytes as on the wire; tell_incompatible: warn of publishers that offer
        another quality of service.
        """
        events = SubscriptionEventCallbacks(
            message_lost=lambda event: self._on_lost(topic, event.total_count_change),
            use_default_callbacks=tell_incompatible)
        self._subscriptions[topic] = self._node.create_subscription(
            message_class, topic, _never, profile, raw=raw, callback_group=self._group,
            event_callbacks=events)

    def take(self):
        """Return all (received, topic, message, published) since the last call, as received.

        received, published: wall time, ns; message: its class or, raw, its CDR bytes.
        """
        heard = []
        for topic, subscription in self._subscriptions.items():
            for message, info in take_all(subscription):
                heard.append((info['received_timestamp'], topic, message,
                              info['source_timestamp']))
        heard.sort(key=lambda entry: entry[0])
        return heard

    def wait(self, timeout):
        """Wait until a message is there, at most `timeout` s."""
        handles = [subscription.handle for subscription in self._subscriptions.values()]
        context = self._node.context.handle
        with ExitStack() as stack:
            for handle in (*handles, context):
                stack.enter_context(handle)
            wait_set = rclpy_implementation.WaitSet(len(handles), 0, 0, 0, 0, 0, context)
            wait_set.clear_entities()
            for handle in handles:
                wait_set.add_subscription(handle)
            wait_set.wait(int(1e9 * timeout))

    def is_connected(self):
        """Return whether every publisher known on the graph is connected to its subscription."""
        return all(subscription.get_publisher_count() >= self._node.count_publishers(topic)
                   for topic, subscription in self._subscriptions.items())


def take_all(subscription):
    """Return the (message, info) that wait in the queue of a subscription."""
    taken, handle = [], subscription.handle
    with handle:
        while (one := handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            taken.append(one)
    return taken


def _never(message):
    """Stand where rclpy wants a callback."""
