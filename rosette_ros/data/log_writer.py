# SPDX-License-Identifier: Apache-2.0
"""Writing a log: one directory with `<name>_0.mcap` and rosbag2's metadata.yaml.

What was written is on the disk after at most `flush_interval` seconds of wall time: the open chunk
is finished, indexed and synchronised, and metadata.yaml tells the counts so far. So a killed
process loses no more than that, and the file reads up to its last whole chunk.

A log may be split into files. Each stands alone: what holds as a state is repeated at its head, and a metadata
record says which messages are repeated, so that whoever reads the whole log counts them once.
"""

import contextlib
import os
import time
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from rosette_ros.core.errors import CellError, InvalidConfig, InvalidData
from rosette_ros.data.bag_metadata import (
    FILE_NAME,
    FileSummary,
    TopicSummary,
    bag_mapping,
    bag_text,
    qos_text,
    synchronise_folder,
    write_bag_metadata,
)
from rosette_ros.data.mcap_writer import COMPRESSIONS, McapWriter

CHUNK_SIZE = 64 * 1024
LIBRARY = 'rosette_ros'
METADATA_RECORD = 'rosbag2'
METADATA_KEY = 'serialized_metadata'
REPEATED_RECORD = 'rosette.repeated'
"""Metadata record of a further file: topic to the sequence numbers, by spaces, of what it repeats."""

MAX_CHUNKS = 100_000
"""A new file is begun after so many chunks: the index of a file is held in memory until its end.

Each chunk costs 150 bytes with 8 topics and 320 with 25. At one chunk a second this is a file of 27 hours.
"""
MAX_FILES = 500
"""No more files than this are begun for their size or time: metadata.yaml names them all, every second."""
MAX_STATES = 100
"""At most so many messages are repeated at the head of a file, the latest."""
_SEQUENCE = 0xFFFFFFFF
_LEAST_HEADS = 2  # a file is not ended for its size before so many times the size of its head


class _Topic:
    """A topic of the log: what it is, and its channel and count in the open file."""

    def __init__(self, name, definition, qos, state_of):
        self.name, self.definition, self.qos = name, definition, tuple(qos)
        self.state_of = state_of
        self.channel = None
        self.messages = 0
        self.in_file = 0
        self.repeated = 0

    def summary(self, messages):
        return TopicSummary(self.name, self.definition.name, self.definition.hash, self.qos, messages)


@dataclass(eq=False)
class _File:
    """A file of the log, as FileSummary."""

    path: str
    start_ns: int = 0
    end_ns: int = 0
    messages: int = 0

    def count(self, log_time):
        if not self.messages or log_time < self.start_ns:
            self.start_ns = log_time
        if log_time > self.end_ns:
            self.end_ns = log_time
        self.messages += 1

    def summary(self):
        return FileSummary(self.path, self.start_ns, self.end_ns, self.messages)


class LogWriter:
    """Writes one log; a single thread may use it.

    directory, name: where, and the first part of the file names; compression: of chunks, a key of
    COMPRESSIONS; chunk_size: bytes after which a chunk is finished in any case; flush_interval: s
    of wall time after which it is finished, however small; max_file_bytes, max_file_seconds:
    begin a new file after so many bytes or so much log time (None: only after MAX_CHUNKS chunks);
    custom_data: mapping of texts for metadata.yaml; clock: wall time in s that never jumps.

    Raises InvalidData where the directory holds a log already: nothing is ever overwritten.
    """

    def __init__(self, directory, name, *, compression='none', chunk_size=CHUNK_SIZE,
                 flush_interval=1.0, max_file_bytes=None, max_file_seconds=None,
                 custom_data=None, ros_distro='jazzy', clock=time.monotonic):
        """Make the directory, open the first file and write metadata.yaml."""
        if compression not in COMPRESSIONS:
            raise InvalidConfig(f'compression of the log: wanted one of '
                                f'{", ".join(COMPRESSIONS)}, got {compression!r}')
        self.directory, self.name = Path(directory), name
        self._compression, self._chunk_size = compression, chunk_size
        self._flush_interval, self._clock = flush_interval, clock
        self._max_bytes, self._max_ns = max_file_bytes, _nanoseconds(max_file_seconds)
        self._custom_data, self._ros_distro = dict(custom_data or {}), ros_distro
        self._topics = {}
        self._states = {}
        self._files = []
        self._failure = None
        self._writer, self._stream, self._safe = None, None, 'nothing'
        self._prepare_directory()
        with self._disk_errors():
            self._begin_file()

    def __enter__(self):
        """Return the writer."""
        return self

    def __exit__(self, *_):
        """Close the log."""
        self.close()

    @property
    def counts(self):
        """Number of messages by topic; what a further file repeats is counted once."""
        return {topic.name: topic.messages for topic in self._topics.values()}

    @property
    def topics(self):
        """TopicSummary of every topic, in the order of adding."""
        return tuple(topic.summary(topic.messages) for topic in self._topics.values())

    @property
    def message_count(self):
        """Number of messages in all files; what a further file repeats is counted once."""
        return sum(topic.messages for topic in self._topics.values())

    @property
    def paths(self):
        """The .mcap files so far."""
        return tuple(self.directory / entry.path for entry in self._files)

    def add_topic(self, topic, definition, qos=(), state_of=None):
        """Add a topic, once, before its first message.

        definition: schemas.TypeDefinition; qos: Qos of each of its publishers; state_of: for a topic whose last
        message holds until the next, returns of a message's bytes what it is the state of (hashable): the last
        message of each is repeated at the head of every further file.
        """
        if topic in self._topics:
            raise InvalidData(f'{self.directory}: topic {topic} was added before')
        self._check_open()
        self._topics[topic] = _Topic(topic, definition, qos, state_of)
        with self._disk_errors():
            self._register(self._topics[topic])

    def write(self, topic, data, log_time, publish_time):
        """Write one message: CDR bytes as on the wire, times in ns (before 1970: 0).

        Raises CellError where the disk refuses; what was flushed before stays readable.
        """
        if self._writer is None:
            self._check_open()
        entry = self._topics.get(topic)
        if entry is None:
            raise InvalidData(f'{self.directory}: topic {topic} was not added to the log')
        if log_time < 0 or publish_time < 0:
            log_time, publish_time = max(log_time, 0), max(publish_time, 0)
        try:
            if self._is_full(log_time):
                self._close_file()
                self._begin_file(log_time)
            self._add(entry, entry.messages, log_time, publish_time, data)
        except OSError as error:
            raise self._refused(error) from error
        if entry.state_of is not None:
            self._keep_state(entry, data, publish_time)
        entry.messages += 1
        self._is_fresh = False
        self.flush_if_due()

    def flush_if_due(self):
        """Flush where something has waited for `flush_interval`; call it from a timer too."""
        if self._unflushed and self._clock() - self._flushed_at >= self._flush_interval:
            self.flush()

    def flush(self):
        """Finish the open chunk and bring everything to the disk, metadata.yaml included."""
        if self._writer is None:
            return
        with self._disk_errors():
            self._synchronise()
            self._write_metadata_file()

    def close(self):
        """Finish the file with its summary and write metadata.yaml; a second call does nothing."""
        if self._writer is None:
            return
        with self._disk_errors():
            self._close_file()
            self._write_metadata_file()

    def _check_open(self):
        if self._failure:
            raise CellError(self._failure)
        if self._writer is None:
            raise InvalidData(f'{self.directory}: the log is closed')

    def _prepare_directory(self):
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            present = sorted(path.name for path in self.directory.iterdir()
                             if path.suffix == '.mcap' or path.name == FILE_NAME)
        except OSError as error:
            raise InvalidData(f'{self.directory}: wanted a folder for the log, got '
                              f'{error.strerror}; choose another log folder') from error
        if present:
            raise InvalidData(f'{self.directory}: holds a log already ({present[0]}); nothing is '
                              'overwritten, choose another run name or log folder')

    def _begin_file(self, log_time=0):
        """Open the next file; it gets its name, and metadata.yaml names it, when its head is on the disk."""
        path = self.directory / f'{self.name}_{len(self._files)}.mcap'
        unnamed = path.with_name(f'{path.name}.part')
        self._stream, self._safe_size = open(unnamed, 'xb'), 0  # noqa: SIM115 (closed in _close_file)
        self._file = _File(path.name)
        self._write_head()
        self._repeat_states(log_time)
        self._synchronise()
        self._head_size = self._writer.size
        unnamed.rename(path)
        synchronise_folder(self.directory)
        self._files.append(self._file)
        self._note_safe()
        self._write_metadata_file()

    def _write_head(self):
        self._writer = McapWriter(self._stream, LIBRARY, self._chunk_size, self._compression)
        self._is_fresh = True
        for topic in self._topics.values():
            topic.in_file = 0
            self._register(topic)
        self._add_metadata_record()

    def _keep_state(self, topic, data, publish_time):
        """Remember a message that holds from now on; what it replaces is forgotten."""
        key = (topic.name, topic.state_of(data))
        self._states.pop(key, None)
        self._states[key] = (topic, topic.messages, publish_time, data)
        if len(self._states) > MAX_STATES:
            del self._states[next(iter(self._states))]

    def _repeat_states(self, log_time):
        """Write what holds as it was, received when the file begins, in the order in which it came."""
        numbers = sorted((topic.name, number) for topic, number, _, _ in self._states.values())
        if not numbers:
            return
        self._writer.add_metadata(REPEATED_RECORD, {
            name: ' '.join(str(number & _SEQUENCE) for _, number in group)
            for name, group in groupby(numbers, key=lambda entry: entry[0])})
        for topic, number, publish_time, data in self._states.values():
            self._add(topic, number, log_time, publish_time, data)
            topic.repeated += 1

    def _add(self, topic, number, log_time, publish_time, data):
        """Add a message to the open file; number: how many of its topic came before it."""
        self._writer.add_message(topic.channel, number & _SEQUENCE, log_time, publish_time, data)
        topic.in_file += 1
        self._file.count(log_time)
        self._unflushed = True

    def _register(self, topic):
        definition = topic.definition
        metadata = {'offered_qos_profiles': qos_text(topic.qos),
                    'topic_type_hash': definition.hash}
        if definition.idl:
            # An empty channel: its schema says the full names of the parts of a service, which
            # some readers of ros2msg cannot (see docs/log-format.md).
            schema = self._writer.add_schema(definition.name, 'ros2idl', definition.idl.encode())
            self._writer.add_channel(topic.name, 'cdr', schema, metadata)
        schema = self._writer.add_schema(definition.name, 'ros2msg', definition.text.encode())
        topic.channel = self._writer.add_channel(topic.name, 'cdr', schema, metadata)

    def _is_full(self, log_time):
        """Return whether the file shall end; one that holds nothing of its own goes on."""
        if self._is_fresh:
            return False
        if self._writer.chunks >= MAX_CHUNKS:
            return True
        if len(self._files) >= MAX_FILES:
            return False
        too_long = self._max_ns is not None and log_time - self._file.start_ns >= self._max_ns
        too_big = self._max_bytes is not None and self._writer.size >= max(
            self._max_bytes, _LEAST_HEADS * self._head_size)
        return too_long or too_big

    def _synchronise(self):
        self._writer.flush()
        os.fsync(self._stream.fileno())
        self._note_safe()
        self._unflushed, self._flushed_at = False, self._clock()

    def _note_safe(self):
        """Remember up to where the disk has the open file; one that has no name yet is none."""
        self._safe_size = self._stream.tell()
        if self._file in self._files[-1:]:
            self._safe = f'{self._file.path}, {self._safe_size} bytes'

    def _close_file(self):
        self._synchronise()
        self._add_metadata_record()
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._note_safe()
        self._stream.close()
        self._writer = None

    def _add_metadata_record(self):
        """Describe the open file, and it alone, in itself."""
        topics = [topic.summary(topic.in_file) for topic in self._topics.values()]
        self._writer.add_metadata(METADATA_RECORD, {
            METADATA_KEY: bag_text(self._mapping(topics, [self._file]))})

    def _write_metadata_file(self):
        """Describe what stands in the files: other readers count there."""
        topics = [topic.summary(topic.messages + topic.repeated) for topic in self._topics.values()]
        write_bag_metadata(self.directory, self._mapping(topics, self._files))

    def _mapping(self, topics, files):
        return bag_mapping(topics, [entry.summary() for entry in files], self._custom_data, self._ros_distro)

    @contextlib.contextmanager
    def _disk_errors(self):
        """Turn a refusal of the disk into words."""
        try:
            yield
        except OSError as error:
            raise self._refused(error) from error

    def _refused(self, error):
        """Give up the open file and return the CellError that says why."""
        self._abandon()
        self._failure = (
            f'{self.directory}: cannot write the log: {error.strerror}; what was recorded '
            f'until the last flush is readable ({self._safe}). Make room and start again')
        return CellError(self._failure)

    def _abandon(self):
        """Give up the open file: drop what the disk did not take, and what waits for it to take more."""
        self._writer = None
        with contextlib.suppress(OSError, ValueError):
            raw = self._stream.raw  # detach() or close() would flush first, and fail
            try:
                raw.truncate(self._safe_size)
            finally:
                raw.close()


def _nanoseconds(seconds):
    return None if seconds is None else int(seconds * 1e9)
