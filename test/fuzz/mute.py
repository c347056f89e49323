# SPDX-License-Identifier: Apache-2.0
"""Nodes of the cell without their ends on the graph: what they publish, answer and log is kept.

Nothing they hear may end them, what they publish can be sent, and their words are one line each.
"""

from types import SimpleNamespace

import numpy as np
from hypothesis import strategies as st
from made_up_log import BALLS, RUN_ID, calibration
from made_up_messages import TEXTS, changed, is_plain, messages, whole
from rclpy.serialization import serialize_message
from rclpy.time import Time

from rosette_ros.core.run.geometry import Frame

SAID = calibration()
"""A sound calibration: (topic, message, stamp) each."""
TAUGHT = Frame(np.eye(3), np.zeros(3))
RUN_IDS = st.one_of(st.just(RUN_ID), TEXTS)
SMALL = st.one_of(st.integers(1, BALLS), whole(0, 2**32 - 1))


class Mute:
    """What a node has on the graph, kept: words that it logs, messages that it publishes."""

    def __init__(self, **attributes):
        """Stand without a graph; attributes: what the real one makes for itself."""
        self.words, self.published, self.clock = [], [], 0.0
        self.status = SimpleNamespace(report=lambda problem: None, process='mute 1')
        self.__dict__.update(attributes)

    def get_logger(self):
        """Return what keeps the words."""
        return SimpleNamespace(**dict.fromkeys(('info', 'warning', 'error'), self.words.append))

    def seconds(self):
        """Return a time that goes on."""
        self.clock += 1.0
        return self.clock

    def now(self):
        """Return a ROS time."""
        return Time(seconds=100)

    def publish(self, message):
        """Take a message; it has to be one that can be sent."""
        serialize_message(message)
        self.published.append(message)

    def resolve_topic_name(self, name):
        """Return a full name."""
        return name if name.startswith('/') else f'/{name}'


def defaults(wanted, **changes):
    """Return the parameters of a node."""
    return {**{one.name: one.default for one in wanted}, **changes}


def check_words(words):
    """Words are for one line."""
    assert all(is_plain(one) for one in words), words


FIELDS = {
    'run_id': RUN_IDS, 'seq': SMALL, 'table_position': SMALL, 'ball': SMALL, 'balls': SMALL,
    'frame_id': st.one_of(st.sampled_from(['machine', 'table']), TEXTS),
    'child_frame_id': st.one_of(st.just('table'), TEXTS),
}


def heard(*topics):
    """Return lists of (topic, message): a sound calibration in which some are changed, left out or moved."""
    own = [(topic, message) for topic, message, _ in SAID if topic in topics]
    first = dict(reversed(own))
    near = [changed(message, **FIELDS).map(lambda made, topic=topic: (topic, made)) for topic, message in own]
    far = [
        messages(type(message), **FIELDS).map(lambda made, topic=topic: (topic, made))
        for topic, message in first.items()
    ]
    one = st.one_of(st.sampled_from(near), st.sampled_from(far)).flatmap(lambda strategy: strategy)
    more = st.lists(st.tuples(st.integers(0, len(own)), st.booleans(), one), max_size=5)
    return more.map(lambda changes: _with(own, changes))


def _with(own, changes):
    said = list(own)
    for at, instead, pair in changes:
        said[at : at + instead] = [pair]
    return said
