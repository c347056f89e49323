# SPDX-License-Identifier: Apache-2.0
"""The QoS profiles of the cell, once.

Everything is reliable. What a late joiner must know is latched (transient local). A queue holds
more than can be under way, so that a slow reader loses nothing.
"""

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth, durability=DurabilityPolicy.VOLATILE):
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, durability=durability,
                      reliability=ReliabilityPolicy.RELIABLE)


TARGET = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
"""Commands: latched for who watches. Who obeys them subscribes with ORDER, see there."""

ORDER = _profile(10)
"""For the one who obeys targets: volatile, so that no machine moves on an old command."""

ANSWER = _profile(100)
STATE = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
RESULT = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
EVENT = _profile(100)
CLOCK = _profile(10)
HEALTH = _profile(10)

BEAT_PERIOD = 0.5
"""A node beats so often, s."""
BEAT_LOST = 2.5 * BEAT_PERIOD
"""Who has not been heard for so long does not beat at the moment, s."""
ALIVE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL, deadline=Duration(seconds=1),
    liveliness=LivelinessPolicy.AUTOMATIC, liveliness_lease_duration=Duration(nanoseconds=700_000_000))
"""Heartbeats: the middleware tells within the lease that a process is no more, within the deadline that a
node has stopped to beat. On a topic of their own, so that a CMM with other QoS still fits the cell. Ten deep: in a
queue of one the beat of a twin would replace the other's."""

COLLECT = _profile(5000)
COLLECT_LATCHED = _profile(5000, DurabilityPolicy.TRANSIENT_LOCAL)
"""For those who gather all messages: the queue outlasts seconds of a full-speed run."""

RECORD = _profile(10_000)
RECORD_LATCHED = _profile(10_000, DurabilityPolicy.TRANSIENT_LOCAL)
"""For the recorder: deeper than the 5000 messages that Fast DDS holds for a reader. What does not fit is then refused,
asked for again and, where it is gone, told as lost; in a queue of 5000 it would replace another in silence."""
