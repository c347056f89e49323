# SPDX-License-Identifier: Apache-2.0
"""What the recorder remembers and writes: one log after the other. No ROS here."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from rosette_ros.core.errors import CellError, InvalidData
from rosette_ros.data.cdr import decode_message
from rosette_ros.data.log_writer import COMPRESSIONS, LogWriter
from rosette_ros.data.ros2msg import parse_schema
from rosette_ros.nodes.settings import Wanted

LATCHED_KEPT = 10
RECENT_KEPT = 256

LOG = (
    Wanted('compression', 'none', 'how the chunks of a log are compressed', choices=tuple(COMPRESSIONS)),
    Wanted('max_file_mb', 0, 'a log goes on in a new file after so many MB; 0: however many', 0, 1_000_000),
    Wanted('max_file_s', 0, 'a log goes on in a new file after so many s of ROS time; 0: however many', 0,
           10_000_000),
)
"""Parameters of a log; a change holds from the next one on."""

STATES = ('rosette_msgs/msg/Model', 'rosette_msgs/msg/ErrorMotions', 'rosette_msgs/msg/RunState')
"""Types of which the last message holds until the next: it is repeated where a log goes on in a new file."""
BY_THE_CLOCK = ('diagnostic_msgs/msg/DiagnosticArray', 'rosgraph_msgs/msg/Clock', 'std_msgs/msg/Header')
"""Types of what comes again and again, health, time and heartbeats: whoever says no more than that has finished."""
FRAMES, FRAMES_TOPIC = 'tf2_msgs/msg/TFMessage', 'tf_static'


class Memory(Enum):
    """What becomes of a message while no log is open.

    NONE: it belongs to no run; LATCHED: it holds until the next one and opens every log; RECENT:
    it belongs to the request that will open a log, or says in which state the nodes were when it
    came, and stands at the head of that log.
    """

    NONE = 'none'
    LATCHED = 'latched'
    RECENT = 'recent'


class Message(NamedTuple):
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
    Qos of the publishers of a topic; settings: returns the values of LOG for the next log, name to value.
    """

    def __init__(self, recent, qos_of, settings=dict):
        """Start without topics and without a log."""
        self._recent_kept = recent
        self._qos_of = qos_of
        self._settings = settings
        self._definitions = {}
        self._memory = {}
        self._by_the_clock = set()
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
        if definition.name in BY_THE_CLOCK:
            self._by_the_clock.add(topic)
        if memory is Memory.LATCHED:
            self._latched[topic] = deque(maxlen=LATCHED_KEPT)

    def take(self, message: Message):
        """Take a message: into the open log, else into memory."""
        if message.topic not in self._by_the_clock:
            self.heard = message.heard
        memory = self._memory[message.topic]
        if memory is Memory.LATCHED:
            self._latched[message.topic].append(message)
        if self._writer is not None:
            self._write(message, message.log_time)
        elif memory is Memory.RECENT:
            self._recent.append(message)

    @property
    def directory(self):
        """The folder of the open log."""
        return self._writer.directory

    def lose(self, count):
        """Take note that messages were lost on the way."""
        if self.is_open:
            self._lost += count

    def open(self, directory, run_id, now, log_time, earlier=(), custom_data=None):
        """Open the log of a run; messages of an earlier part, latched and recent ones come first.

        now: steady time, s; log_time: ROS time, ns, for what was heard before; earlier: Messages; custom_data:
        mapping of texts for metadata.yaml. Raises InvalidData where the directory holds a log already,
        CellError where one is open.
        """
        if self.is_open:
            raise CellError(f'the log of run {self.run_id} is open; wanted it closed first')
        self._writer = LogWriter(directory, Path(directory).name, custom_data=custom_data,
                                 **_options(self._settings()))
        self.run_id, self.failure, self._lost = run_id, '', 0
        self._written = set()
        for topic in self._definitions:
            profiles = self._qos_of(topic)
            if profiles:
                self._add_to_log(topic, profiles)
        for message in earlier:
            self._write(message, log_time)
        for kept in self._latched.values():
            for message in kept:
                self._write(message, log_time)
        for message in self._recent:
            if now - message.heard <= self._recent_kept:
                self._write(message, message.log_time)
        self._recent.clear()

    def close(self):
        """Close the log and return its Summary; raises CellError where the disk refuses."""
        writer, self._writer = self._writer, None
        writer.close()
        return Summary(writer.directory, writer.message_count, self._lost)

    def flush(self):
        """Bring all that is written to the disk."""
        if self._writer is not None and not self.failure:
            self._guard(self._writer.flush)

    def flush_if_due(self):
        """Bring what has waited long enough to the disk."""
        if self._writer is not None and not self.failure:
            self._guard(self._writer.flush_if_due)

    def _write(self, message, log_time):
        if self.failure:
            self._lost += 1
            return
        if message.topic not in self._written:
            self._add_to_log(message.topic, self._qos_of(message.topic))
        self._guard(self._writer.write, message.topic, message.data, log_time, message.publish_time)

    def _add_to_log(self, topic, profiles):
        self._writer.add_topic(topic, self._definitions[topic], profiles, state_of(topic, self._definitions[topic]))
        self._written.add(topic)

    def _guard(self, write, *args):
        """Write; a refusal of the disk is kept in words, the cell goes on."""
        try:
            write(*args)
        except (CellError, InvalidData) as error:
            self.failure = str(error)
            self._lost += 1


def _options(values):
    """Return what LogWriter is told of the values of LOG; 0 means None."""
    megabytes, seconds = values.get('max_file_mb', 0), values.get('max_file_s', 0)
    return {'compression': values.get('compression', 'none'), 'max_file_seconds': seconds or None,
            'max_file_bytes': 1_000_000 * megabytes or None}


def state_of(topic, definition):
    """Return the function that says of a message's bytes what it is the state of, None where messages pass.

    A message of static frames holds for the frames that it names: others may have been latched by others.
    """
    if definition.name in STATES:
        return lambda data: ''
    if definition.name == FRAMES and topic.split('/')[-1] == FRAMES_TOPIC:
        schema = parse_schema(definition.name, definition.text)
        return lambda data: _frames(schema, data)
    return None


def _frames(schema, data):
    """Return the names of the frames in a message of transforms; one that cannot be read stands for itself."""
    try:
        return tuple(sorted(one.child_frame_id for one in decode_message(schema, data).transforms))
    except (InvalidData, ValueError):
        return data
