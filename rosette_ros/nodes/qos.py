# SPDX-License-Identifier: Apache-2.0
"""The QoS profiles of the cell, once.

Everything is reliable. What a late joiner needs is latched (transient local). A queue holds more than can be under way,
so that a slow reader loses nothing: a simulated CMM answers 400 targets in a second, and on a computer that is busy a
node sleeps for half of one."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, durability=durability,
                      reliability=ReliabilityPolicy.RELIABLE)


TARGET = _profile(500, DurabilityPolicy.TRANSIENT_LOCAL)  # commands: latched for observers; a CMM subscribes with ORDER

ORDER = _profile(10)  # for the CMM: volatile, so that no machine moves on an old command

ANSWER = _profile(500)
STATE = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
RESULT = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
EVENT = _profile(100)
CLOCK = _profile(10)
STATUS = _profile(10)
STATUSES = _profile(100)  # from all nodes of the domain

STATUS_PERIOD = 0.5  # a node publishes its status at this interval, s
STATUS_LATE = 1.5 * STATUS_PERIOD  # after this time it is waited for, and nothing is asked again, s
STATUS_LOST = 2.5 * STATUS_PERIOD  # a process without a status for this time is disconnected, s
STATUS_HANGS = 40 * STATUS_PERIOD  # after this time, its supervisor ends and restarts a process that runs, s

LONGEST_WORK = 120.0  # a node whose callback has not returned for this time publishes no status: it hangs, s

TRANSFORMS = _profile(100)
JOINTS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Joint states: the last one counts, from publishers of both reliabilities."""

COLLECT = _profile(5000)
COLLECT_LATCHED = _profile(5000, DurabilityPolicy.TRANSIENT_LOCAL)
"""For those who collect all messages: the queue outlasts seconds of a full-speed run."""

RECORD = _profile(10_000)
RECORD_LATCHED = _profile(10_000, DurabilityPolicy.TRANSIENT_LOCAL)
"""For the recorder: deeper than the 5000 messages that Fast DDS holds for a reader. What does not fit is then refused,
requested again and, where its sender has it no more, reported as lost; in a queue of 5000 it would replace another
unreported."""
