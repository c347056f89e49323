# SPDX-License-Identifier: Apache-2.0
"""A node that takes no events of the middleware, and finds by the graph what cannot be connected to it.

rmw_fastrtps 8.4 takes two locks in two orders where an EventsExecutor takes events of the middleware (match,
liveliness, deadline, lost message, incompatible quality of service): a node can hang for good, most of all while it
starts and is being discovered (pull request 890 of rmw_fastrtps). rclpy takes the last one unless it is told not to."""

from collections.abc import Iterator
from typing import Any

from rclpy.duration import Infinite
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

UNNAMED = 'one whose name is not known'


def name_of(info: Any) -> str:
    """Return the name, with namespace, of the node that an endpoint belongs to."""
    return UNNAMED if 'UNKNOWN' in info.node_name else f'{info.node_namespace.rstrip("/")}/{info.node_name}'


class GraphNode(Node):
    """A rclpy Node whose publishers and subscriptions take no events."""

    def create_publisher(self, *args: Any, **settings: Any) -> Publisher:
        """Create a publisher as rclpy does, without events."""
        return super().create_publisher(
            *args, event_callbacks=PublisherEventCallbacks(use_default_callbacks=False), **settings)

    def create_subscription(self, *args: Any, **settings: Any) -> Subscription:
        """Create a subscription as rclpy does, without events."""
        return super().create_subscription(
            *args, event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False), **settings)

    def unconnected(self) -> set[str]:
        """Return what other nodes publish or subscribe to and cannot be connected, and why, in words."""
        return {*self._unreceived(), *self._undelivered()}

    def _unreceived(self) -> Iterator[str]:
        for mine in self.subscriptions:
            if mine.get_publisher_count() < self.count_publishers(mine.topic_name):
                for info in self.get_publishers_info_by_topic(mine.topic_name):
                    if why := _misfit(info.qos_profile, mine.qos_profile):
                        yield f'nothing that {name_of(info)} publishes on {mine.topic_name} is received: {why}'

    def _undelivered(self) -> Iterator[str]:
        for mine in self.publishers:
            if mine.get_subscription_count() < self.count_subscribers(mine.topic_name):
                for info in self.get_subscriptions_info_by_topic(mine.topic_name):
                    if why := _misfit(mine.qos_profile, info.qos_profile):
                        yield f'{name_of(info)} receives nothing that is published on {mine.topic_name}: {why}'


def _stated(profile: QoSProfile) -> QoSProfile:
    """Return a profile without infinite times: the graph gives them where none is stated, which would not fit those."""
    times = {name: time for name in ('deadline', 'liveliness_lease_duration')
             if (time := getattr(profile, name)).nanoseconds < Infinite.nanoseconds}
    return QoSProfile(depth=1, reliability=profile.reliability, durability=profile.durability,
                      liveliness=profile.liveliness, **times)


def _misfit(offered: QoSProfile, requested: QoSProfile) -> str:
    """Return why a publisher and a subscription cannot be connected, '' where they can."""
    fit, why = qos_check_compatible(_stated(offered), _stated(requested))
    return why.replace('ERROR: ', '').strip('; ') if fit == QoSCompatibility.ERROR else ''
