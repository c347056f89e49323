# SPDX-License-Identifier: Apache-2.0
"""The QoS profiles of the cell, once.

Everything is reliable. What a late joiner must know is latched (transient local). A queue holds
more than can be under way, so that a slow reader loses nothing.
"""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


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

COLLECT = _profile(5000)
COLLECT_LATCHED = _profile(5000, DurabilityPolicy.TRANSIENT_LOCAL)
"""For those who gather all messages: the queue outlasts seconds of a full-speed run."""
