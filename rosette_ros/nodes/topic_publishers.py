# SPDX-License-Identifier: Apache-2.0
"""Who publishes a topic of a run: while there are two, nothing of it is used.

rclpy does not say which publisher a message came from, but a publisher is known before its first message is delivered.
The publisher of a process that was killed stays on the graph for up to 20 s; statuses tell it apart."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from rosette_ros.nodes import names
from rosette_ros.nodes.graph_node import name_of
from rosette_ros.nodes.liveliness import NodeMonitor, process_of
from rosette_ros.nodes.qos import STATUS_LOST


class TopicPublishers:
    """The publishers of a topic whose processes run.

    peer: monitor of the node that publishes it; on_change: called when another process publishes it than before;
    is_idle: of an endpoint (GID), whether it does not count beside others; running: all endpoints; found: those that
    count; used: that of the last one that was alone; is_single: whether messages are used; ignored:
    number of messages that were not, without a subscription how often there were two."""

    def __init__(self, node: Node, topic: str, peer: NodeMonitor) -> None:
        """Start without a publisher."""
        self._node, self._peer = node, peer
        self.on_change: Callable[[], object] = lambda: None
        self.is_idle: Callable[[bytes], bool] = lambda gid: False
        self.topic = node.resolve_topic_name(topic)
        self._subscription: Subscription | None = None
        self.running, self.found, self.used = frozenset[bytes](), frozenset[bytes](), frozenset[bytes]()
        self.is_single, self.ignored = True, 0
        self._names: dict[bytes, str] = {}
        self._first_seen: dict[bytes, float] = {}
        self._matched, self._peers = 0, 0

    def judge(self, subscription: Subscription) -> None:
        """Take note of the subscription whose messages `admits` judges."""
        self._subscription = subscription

    def admits(self) -> bool:
        """Return whether a message that was delivered just now may be used.

        That a second publisher has left is seen by `watch` only: until then what it had published is delivered."""
        if self._count() > self._matched:
            self.look()
        self.ignored += not self.is_single
        return self.is_single

    @property
    def conflict(self) -> str:
        """That more than one node publishes the topic, in words; '' where it is not so."""
        if len(self.found) < 2:
            return ''
        who = ' and '.join(sorted(self._names[gid] for gid in self.found))
        return f'{len(self.found)} nodes publish {self.topic} ({who})'

    @property
    def is_tried(self) -> bool:
        """Whether one of several tries the CMM, which needs no warning; nothing of theirs is used all the same."""
        return any(self._names[gid].rpartition('/')[2].startswith(f'{names.TRIAL}_') for gid in self.found)

    def watch(self) -> None:
        """Look where something may have changed; call it often."""
        is_plain = self.is_single and len(self.found) == len(self._names) < 2 and self._peers >= len(self.found)
        if not is_plain or (self._count(), self._peer.running()) != (self._matched, self._peers):
            self.look()

    def look(self) -> None:
        """Find out which publishers there are."""
        self._matched, self._peers = self._count(), self._peer.running()
        self.running = self._find(time.monotonic())
        self.found = frozenset(gid for gid in self.running if not self.is_idle(gid)) or self.running
        if len(self.found) == 1 and self.found != self.used:
            before, self.used = self.used, self.found
            if before:
                self.on_change()
        self.ignored += self._subscription is None and self.is_single and len(self.found) > 1
        # a publisher is matched a moment before it is on the graph, and its first message may be there by then
        self.is_single = len(self.found) < 2 and (self._subscription is None or self._matched <= len(self._names))

    def _count(self) -> int:
        subscription = self._subscription
        return self._node.count_publishers(self.topic) if subscription is None else subscription.get_publisher_count()

    def _find(self, now: float) -> frozenset[bytes]:
        """Return the publishers whose process runs: without a status all, with one as many as are heard.

        Those that were found last are taken to run: a new one is never mistaken for one that has ended, nor before its
        first status is received."""
        infos: list[Any] = self._node.get_publishers_info_by_topic(self.topic)
        self._names = {bytes(one.endpoint_gid): name_of(one) for one in infos}
        self._first_seen = {gid: self._first_seen.get(gid, now) for gid in self._names}
        beating = {process_of(one.endpoint_gid) for one in self._peer.publishers()}
        found = sorted(self._names, key=lambda gid: self._first_seen[gid])
        with_status = [gid for gid in found if process_of(gid) in beating]
        is_new = any(now - self._first_seen[gid] < STATUS_LOST for gid in with_status[-1:])
        ended = with_status[:max(len(with_status) - max(self._peers, is_new), 0)]
        return frozenset(self._names) - frozenset(ended)
