# SPDX-License-Identifier: Apache-2.0
"""Heartbeats: who of the cell is there, noticed within a second.

Each node beats on `<node>/alive` with a name that only this process has. Who watches is told by the middleware
that a publisher has gone (liveliness) or has stopped to beat (deadline), and by the name that it is another one.
"""

import uuid

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from std_msgs.msg import Header

from rosette_ros.nodes import names, qos


class Beat:
    """The heartbeat of a node.

    words: why it cannot do its work, '' while it can; hears: names of the processes whose beats it hears.
    """

    def __init__(self, node):
        """Create the publisher on a Node."""
        self._node = node
        self._life = f'{node.get_name()} {uuid.uuid4().hex[:12]}'
        self._told = None
        self.words, self.hears = '', ()
        self._publisher = node.create_publisher(
            Header, f'{node.get_name()}/{names.ALIVE}', qos.ALIVE,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False))

    def beat_if_due(self, now):
        """Beat where the last beat is long enough ago; now: steady time, s."""
        if self._told is None or now - self._told >= qos.BEAT_PERIOD:
            self._told = now
            lines = (self._life, ' '.join(self.words.split()), *self.hears)
            self._publisher.publish(Header(stamp=self._node.now().to_msg(), frame_id='\n'.join(lines)))


def read_beat(frame_id):
    """Return (life, words, hears) of a heartbeat; what it leaves out is '' or ()."""
    life, *rest = frame_id.split('\n')
    return life, ''.join(rest[:1]), tuple(rest[1:])


class Watch:
    """What is known of the life of another node of the cell.

    life: name of the process that beats, '' before the first beat; words, hears: as of Beat; has_gone:
    whether one was there that is no more and nothing was heard of a successor; is_late: whether it does not beat
    in time.
    """

    def __init__(self, node, peer):
        """Watch the node named `peer` from a CellNode."""
        self._node, self._heard = node, {}
        self.life, self.words, self.hears = '', '', ()
        self._alive, self.has_gone = 0, False
        self.is_late = False
        node.create_subscription(
            Header, f'{peer}/{names.ALIVE}', self._on_beat, qos.ALIVE,
            callback_group=MutuallyExclusiveCallbackGroup(), event_callbacks=SubscriptionEventCallbacks(
                liveliness=self._on_liveliness, deadline=self._on_deadline, use_default_callbacks=False))

    @property
    def lives(self):
        """How many processes beat under this name at the moment."""
        now = self._node.seconds()
        self._heard = {life: heard for life, heard in self._heard.items() if now - heard < qos.BEAT_LOST}
        return len(self._heard)

    def _on_beat(self, message):
        self.life, self.words, self.hears = read_beat(message.frame_id)
        self.is_late = False
        self._heard[self.life] = self._node.seconds()
        if self._alive:  # else it is the last beat of one who has gone
            self.has_gone = False

    def _on_liveliness(self, event):
        self._alive = event.alive_count
        if not self._alive:
            self.has_gone = True

    def _on_deadline(self, event):
        self.is_late = True
