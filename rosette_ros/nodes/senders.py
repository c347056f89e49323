# SPDX-License-Identifier: Apache-2.0
"""Who publishes what a node uses: one process a topic, and never two at once.

rclpy does not say which publisher a message came from. But a publisher is known before its first message is delivered:
while a topic has two, and for SETTLING s after, none of its messages is used: what one that has left had published may
be taken late. Another publisher than before is used when it has been alone for as long. The publisher of a process
that was killed stays on the graph for up to 20 s; heartbeats tell it apart.
"""

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from rosette_ros.nodes.graph_node import name_of
from rosette_ros.nodes.liveliness import SETTLING, NodeMonitor, process_of
from rosette_ros.nodes.qos import HEARTBEAT_LOST


class Sender:
    """The publisher of a topic whose messages are used.

    peer: monitor of the node that it should be. on_change: called when another process has taken its place; on_rivals:
    called with the words when there are several for SETTLING s, as a node that was killed and its successor are not;
    alive: the endpoints of processes that run, their GIDs; bound: the one that is used; is_bound: whether there is no
    other; refused: number of messages that were not used.
    """

    def __init__(self, node: Node, topic: str, peer: NodeMonitor) -> None:
        """Start without a publisher."""
        self._node, self._peer = node, peer
        self.on_change: Callable[[], object] = lambda: None
        self.on_rivals: Callable[[str], object] = lambda words: None
        self.topic = node.resolve_topic_name(topic)
        self._subscription: Subscription | None = None
        self.alive: frozenset[bytes] = frozenset()
        self.bound: frozenset[bytes] = frozenset()
        self.is_bound, self.refused = True, 0
        self._names: dict[bytes, str] = {}
        self._first_seen: dict[bytes, float] = {}
        self._matched, self._running, self._since = 0, 0, 0.0
        self._last_rivals, self._is_told = -SETTLING, False

    def judge(self, subscription: Subscription) -> None:
        """Take note of the subscription whose messages `admits` judges."""
        self._subscription = subscription

    def admits(self) -> bool:
        """Return whether a message that was delivered just now may be used."""
        if self._count() != self._matched:
            self.look()
        self.refused += not self.is_bound
        return self.is_bound

    @property
    def rivals(self) -> str:
        """That more than one node publishes the topic, in words; '' where it is not so."""
        if len(self.alive) < 2:
            return ''
        who = ' and '.join(sorted(self._names[gid] for gid in self.alive))
        return f'{len(self.alive)} nodes publish {self.topic} ({who})'

    def watch(self) -> None:
        """Look where something may have changed without a publisher that comes or goes; call it often."""
        is_plain = self.is_bound and len(self.alive) == len(self._names) < 2 and self._running >= len(self.alive)
        if not is_plain or (self._count(), self._peer.running()) != (self._matched, self._running):
            self.look()

    def look(self) -> None:
        """Find out which publishers are alive, and whether the one that is used is alone."""
        now = time.monotonic()
        self._matched, self._running = self._count(), self._peer.running()
        alive = self._find_alive(now)
        if alive != self.alive:
            self.alive, self._since, self._is_told = alive, now, False
        if len(alive) > 1:
            self._last_rivals = now
            if not self._is_told and now - self._since >= SETTLING:
                self._is_told = True
                self.on_rivals(self.rivals)
        is_settled = now - self._since >= SETTLING and not self._peer.is_open
        if len(alive) == 1 and not alive <= self.bound and (not self.bound or is_settled):
            before, self.bound = self.bound, alive
            if before:
                self.on_change()
        # a publisher is matched a moment before it is on the graph, and its first message may be there by then
        self.is_bound = alive <= self.bound and now - self._last_rivals >= SETTLING and (
            self._subscription is None or self._matched <= len(self._names))

    def _count(self) -> int:
        subscription = self._subscription
        return self._node.count_publishers(self.topic) if subscription is None else subscription.get_publisher_count()

    def _find_alive(self, now: float) -> frozenset[bytes]:
        """Return the publishers whose process runs: without heartbeat all, with heartbeat as many as are heard.

        Those that were found last are taken to run: a new one is never mistaken for one that has ended, nor before its
        first heartbeat is received."""
        infos: list[Any] = self._node.get_publishers_info_by_topic(self.topic)
        self._names = {bytes(one.endpoint_gid): name_of(one) for one in infos}
        self._first_seen = {gid: self._first_seen.get(gid, now) for gid in self._names}
        beating = {process_of(one.endpoint_gid) for one in self._peer.publishers()}
        found = sorted(self._names, key=lambda gid: self._first_seen[gid])
        with_heartbeat = [gid for gid in found if process_of(gid) in beating]
        is_new = any(now - self._first_seen[gid] < HEARTBEAT_LOST for gid in with_heartbeat[-1:])
        ended = with_heartbeat[:max(len(with_heartbeat) - max(self._running, is_new), 0)]
        return frozenset(self._names) - frozenset(ended)
