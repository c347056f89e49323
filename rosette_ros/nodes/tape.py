# SPDX-License-Identifier: Apache-2.0
"""What the recorder remembers and writes: one log after the other. No ROS here."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from rosette_ros.core.errors import CellError, InvalidData
from rosette_ros.data.log_writer import LogWriter

LATCHED_KEPT = 10
RECENT_KEPT = 256


class Memory(Enum):
    """What becomes of a message while no log is open.

    NONE: it belongs to no run; LATCHED: it holds until the next one and opens every log; RECENT:
    it belongs to the request that will open a log, or says in which state the nodes were when it
    came, and stands at the head of that log.
    """

    NONE = 'none'
    LATCHED = 'latched'
    RECENT = 'recent'


@dataclass(frozen=True)
class Message:
    """One message as on the wire; times in ns, heard: steady time, s."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    heard: float


@dataclass(frozen=True)
class Summary:
    """What a closed log holds."""

    directory: Path
    messages: int
    lost: int


class Tape:
    """Takes every message of the cell and keeps what belongs into a log.

    recent: how long a message of Memory.RECENT is kept for a log to come, s; qos_of: returns the
    Qos of the publishers of a topic.
    """

    def __init__(self, recent, qos_of):
        """Start without topics and without a log."""
        self._recent_kept = recent
        self._qos_of = qos_of
        self._definitions = {}
        self._memory = {}
        self._latched = {}
        self._recent = deque(maxlen=RECENT_KEPT)
        self._writer = None
        self._written = set()
        self._lost = 0
        self.run_id = ''
        self.failure = ''
        self.heard = 0.0

    @property
    def is_open(self):
        """Whether a log is open."""
        return self._writer is not None

    @property
    def messages(self):
        """Number of messages in the open log."""
        return self._writer.message_count if self._writer else 0

    @property
    def lost(self):
        """Number of messages known to be lost since the log was opened."""
        return self._lost

    def add_topic(self, topic, definition, memory):
        """Make a topic known; definition: TypeDefinition."""
        self._definitions[topic] = definition
        self._memory[topic] = memory
        if memory is Memory.LATCHED:
            self._latched[topic] = deque(maxlen=LATCHED_KEPT)

    def take(self, message: Message):
        """Take a message: into the open log, else into memory."""
        self.heard = message.heard
        memory = self._memory[message.topic]
        if memory is Memory.LATCHED:
            self._latched[message.topic].append(message)
        if self._writer is not None:
            self._write(message)
        elif memory is Memory.RECENT:
            self._recent.append(message)

    def lose(self, count):
        """Take note that messages were lost on the way."""
        if self.is_open:
            self._lost += count

    def open(self, directory, run_id, now, log_time):
        """Open the log of a run; latched and recent messages come first.

        now: steady time, s; log_time: ROS time, ns, for what was heard before. Raises InvalidData
        where the directory holds a log already, CellError where one is open.
        """
        if self.is_open:
            raise CellError(f'the log of run {self.run_id} is open; wanted it closed first')
        self._writer = LogWriter(directory, run_id)
        self.run_id, self.failure, self._lost = run_id, '', 0
        self._written = set()
        for topic in self._definitions:
            profiles = self._qos_of(topic)
            if profiles:
                self._add_to_log(topic, profiles)
        for kept in self._latched.values():
            for message in kept:
                self._write(message, log_time)
        for message in self._recent:
            if now - message.heard <= self._recent_kept:
                self._write(message)
        self._recent.clear()

    def close(self):
        """Close the log and return its Summary; raises CellError where the disk refuses."""
        writer, self._writer = self._writer, None
        writer.close()
        return Summary(writer.directory, writer.message_count, self._lost)

    def flush_if_due(self):
        """Bring what has waited long enough to the disk."""
        if self._writer is not None and not self.failure:
            self._guard(self._writer.flush_if_due)

    def _write(self, message, log_time=None):
        if self.failure:
            self._lost += 1
            return
        if message.topic not in self._written:
            self._add_to_log(message.topic, self._qos_of(message.topic))
        time = message.log_time if log_time is None else log_time
        self._guard(self._writer.write, message.topic, message.data, time, message.publish_time)

    def _add_to_log(self, topic, profiles):
        self._writer.add_topic(topic, self._definitions[topic], profiles)
        self._written.add(topic)

    def _guard(self, write, *args):
        """Write; a refusal of the disk is kept in words, the cell goes on."""
        try:
            write(*args)
        except (CellError, InvalidData) as error:
            self.failure = str(error)
            self._lost += 1
