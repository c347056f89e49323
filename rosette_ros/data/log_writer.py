# SPDX-License-Identifier: Apache-2.0
"""Writing a log: one directory with `<name>_0.mcap` and rosbag2's metadata.yaml.

What was written is on the disk after at most `flush_interval` seconds of wall time: the open chunk
is finished, indexed and synchronised, and metadata.yaml tells the counts so far. So a killed
process loses no more than that, and the file reads up to its last whole chunk.
"""

import contextlib
import os
import time
from pathlib import Path

from mcap.writer import CompressionType, Writer

from rosette_ros.core.errors import CellError, InvalidConfig, InvalidData
from rosette_ros.data.bag_metadata import (
    FILE_NAME,
    FileSummary,
    TopicSummary,
    bag_mapping,
    bag_text,
    qos_text,
    write_bag_metadata,
)

COMPRESSIONS = {'none': CompressionType.NONE, 'lz4': CompressionType.LZ4,
                'zstd': CompressionType.ZSTD}
CHUNK_SIZE = 64 * 1024
LIBRARY = 'rosette_ros'
METADATA_RECORD = 'rosbag2'
METADATA_KEY = 'serialized_metadata'


class _Topic:
    """A topic of the log: what it is, and its channel and count in the open file."""

    def __init__(self, name, definition, qos):
        self.name, self.definition, self.qos = name, definition, tuple(qos)
        self.channel = None
        self.messages = 0

    def summary(self):
        return TopicSummary(self.name, self.definition.name, self.definition.hash, self.qos,
                            self.messages)


class LogWriter:
    """Writes one log; a single thread may use it.

    directory, name: where, and the first part of the file names; compression: of chunks, a key of
    COMPRESSIONS; chunk_size: bytes after which a chunk is finished in any case; flush_interval: s
    of wall time after which it is finished, however small; max_file_bytes, max_file_seconds:
    begin a new file after so many bytes or so much log time; custom_data: mapping of texts for
    metadata.yaml; clock: wall time in s that never jumps.

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
        self._compression, self._chunk_size = COMPRESSIONS[compression], chunk_size
        self._flush_interval, self._clock = flush_interval, clock
        self._max_bytes, self._max_ns = max_file_bytes, _nanoseconds(max_file_seconds)
        self._custom_data, self._ros_distro = dict(custom_data or {}), ros_distro
        self._topics = {}
        self._files = []
        self._failure = None
        self._writer = None
        self._prepare_directory()
        with self._disk_errors():
            self._open_file()
            self.flush()

    def __enter__(self):
        """Return the writer."""
        return self

    def __exit__(self, *_):
        """Close the log."""
        self.close()

    @property
    def counts(self):
        """Number of messages by topic."""
        return {topic.name: topic.messages for topic in self._topics.values()}

    @property
    def topics(self):
        """TopicSummary of every topic, in the order of adding."""
        return tuple(topic.summary() for topic in self._topics.values())

    @property
    def message_count(self):
        """Number of messages in all files."""
        return sum(topic.messages for topic in self._topics.values())

    @property
    def paths(self):
        """The .mcap files so far."""
        return tuple(self.directory / entry.path for entry in self._files)

    def add_topic(self, topic, definition, qos=()):
        """Add a topic, once, before its first message.

        definition: schemas.TypeDefinition; qos: Qos of each of its publishers.
        """
        if topic in self._topics:
            raise InvalidData(f'{self.directory}: topic {topic} was added before')
        self._check_open()
        self._topics[topic] = _Topic(topic, definition, qos)
        with self._disk_errors():
            self._register(self._topics[topic])

    def write(self, topic, data, log_time, publish_time):
        """Write one message: CDR bytes as on the wire, times in ns (before 1970: 0).

        Raises CellError where the disk refuses; what was flushed before stays readable.
        """
        self._check_open()
        if topic not in self._topics:
            raise InvalidData(f'{self.directory}: topic {topic} was not added to the log')
        entry = self._topics[topic]
        log_time, publish_time = max(log_time, 0), max(publish_time, 0)
        with self._disk_errors():
            if self._is_full(log_time):
                self._close_file()
                self._open_file()
            self._writer.add_message(entry.channel, log_time, data, publish_time,
                                     entry.messages & 0xFFFFFFFF)
        entry.messages += 1
        self._count_in_file(log_time)
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
            write_bag_metadata(self.directory, self._mapping())

    def close(self):
        """Finish the file with its summary and write metadata.yaml; a second call does nothing."""
        if self._writer is None:
            return
        with self._disk_errors():
            self._close_file()
            write_bag_metadata(self.directory, self._mapping())

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

    def _open_file(self):
        path = self.directory / f'{self.name}_{len(self._files)}.mcap'
        self._stream = open(path, 'xb')  # noqa: SIM115 (closed in _close_file)
        self._safe_size = 0
        self._files.append(FileSummary(path.name))
        self._writer = Writer(self._stream, chunk_size=self._chunk_size,
                              compression=self._compression)
        self._writer.start(profile='ros2', library=LIBRARY)
        self._add_metadata_record()
        for topic in self._topics.values():
            self._register(topic)
        self._unflushed, self._flushed_at = False, self._clock()

    def _register(self, topic):
        definition = topic.definition
        metadata = {'offered_qos_profiles': qos_text(topic.qos),
                    'topic_type_hash': definition.hash}
        if definition.idl:
            # An empty channel: its schema says the full names of the parts of a service, which
            # some readers of ros2msg cannot (see docs/log-format.md).
            schema = self._writer.register_schema(definition.name, 'ros2idl',
                                                  definition.idl.encode())
            self._writer.register_channel(topic.name, 'cdr', schema, metadata)
        schema = self._writer.register_schema(definition.name, 'ros2msg',
                                              definition.text.encode())
        topic.channel = self._writer.register_channel(topic.name, 'cdr', schema, metadata)

    def _count_in_file(self, log_time):
        entry = self._files[-1]
        start = min(entry.start_ns, log_time) if entry.messages else log_time
        self._files[-1] = FileSummary(entry.path, start, max(entry.end_ns, log_time),
                                      entry.messages + 1)
        self._unflushed = True

    def _is_full(self, log_time):
        entry = self._files[-1]
        if not entry.messages:
            return False
        too_long = self._max_ns is not None and log_time - entry.start_ns >= self._max_ns
        too_big = self._max_bytes is not None and self._stream.tell() >= self._max_bytes
        return too_long or too_big

    def _synchronise(self):
        self._writer.flush()
        os.fsync(self._stream.fileno())
        self._safe_size = self._stream.tell()
        self._unflushed, self._flushed_at = False, self._clock()

    def _close_file(self):
        self._synchronise()
        self._add_metadata_record()
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self._writer = None

    def _add_metadata_record(self):
        self._writer.add_metadata(METADATA_RECORD, {METADATA_KEY: bag_text(self._mapping())})

    def _mapping(self):
        return bag_mapping(self.topics, self._files, self._custom_data, self._ros_distro)

    @contextlib.contextmanager
    def _disk_errors(self):
        """Turn a refusal of the disk into words; the file is cut back to what is whole."""
        try:
            yield
        except OSError as error:
            self._abandon()
            self._failure = (
                f'{self.directory}: cannot write the log: {error.strerror}; what was recorded '
                f'until the last flush is readable ({self._files[-1].path if self._files else ""}'
                f', {self._safe_size} bytes). Make room and start again')
            raise CellError(self._failure) from error

    def _abandon(self):
        """Give up the open file: drop what the disk did not take."""
        self._writer = None
        with contextlib.suppress(OSError, ValueError):
            raw = self._stream.detach()
            raw.truncate(self._safe_size)
            raw.close()


def _nanoseconds(seconds):
    return None if seconds is None else int(seconds * 1e9)
