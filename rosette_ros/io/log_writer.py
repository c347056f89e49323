# SPDX-License-Identifier: Apache-2.0
"""Writing a log: one directory with `<name>_0.mcap` and rosbag2's metadata.yaml.

What was written is on the disk after at most `flush_interval` seconds of wall time: the open chunk is finished,
indexed and synchronised, and metadata.yaml gives the counts so far. So a killed process loses no more than that, and
the file reads up to its last whole chunk.

A log may be split into files. Each stands alone: what holds as a state is repeated at its head, and a metadata
record lists which messages are repeated, so that a reader of the whole log counts them once."""

import contextlib
import io
import os
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import mcap_ros2.writer
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from rosette_ros.core.errors import CellError, InvalidConfig, InvalidData
from rosette_ros.io import bag_metadata as bag
from rosette_ros.io.text_file import synchronise_folder
from rosette_ros.io.type_definitions import TypeDefinition
from rosette_ros.io.written_file import WrittenFile

CHUNK_SIZE = 64 * 1024
LIBRARY = 'rosette_ros'
COMPRESSIONS = {'none': CompressionType.NONE, 'lz4': CompressionType.LZ4, 'zstd': CompressionType.ZSTD}
MAX_CHUNKS = 40_000
"""A new file is begun after so many chunks: the index of a file is held in memory until its end.

Each chunk costs 1.4 kB with 13 topics. At one chunk a second this is a file of 11 hours and 55 MB."""
MAX_FILES = 500  # no more files than this are begun for their size or time: metadata.yaml names them all, every second
MAX_STATES = 100  # at most so many messages are repeated at the head of a file, the latest
_SEQUENCE = 0xFFFFFFFF
_LEAST_HEADS = 2  # a file is not ended for its size before so many times the size of its head
_MESSAGE_HEAD, _CHANNEL_HEAD = 31, 180  # bytes of a record before its data; about those of a schema and a channel


@dataclass(eq=False)
class _Topic:
    """A topic of the log, and its channel and counts: in the log, in the open file, repeated at heads of files."""

    name: str
    definition: TypeDefinition
    qos: tuple[bag.Qos, ...]
    state_of: Callable[[bytes], Hashable] | None
    channel: int = 0
    messages: int = 0
    in_file: int = 0
    repeated: int = 0

    def summary(self, messages: int) -> bag.TopicSummary:
        return bag.TopicSummary(self.name, self.definition.name, self.definition.hash, self.qos, messages)


class LogWriter(contextlib.AbstractContextManager['LogWriter']):
    """Writes one log; a single thread may use it.

    directory, name: where, and the first part of the file names; compression: of chunks, a key of COMPRESSIONS;
    chunk_size: bytes after which a chunk is finished in any case; flush_interval: s of wall time after which it is
    finished, however small; max_file_bytes, max_file_seconds: begin a new file after so many bytes or so much log time
    (None: only after MAX_CHUNKS chunks); custom_data: for metadata.yaml; clock: wall time in s that never jumps.

    Raises InvalidData where the directory holds a log already: nothing is ever overwritten."""

    def __init__(self, directory: str | Path, name: str, *, compression: str = 'none', chunk_size: int = CHUNK_SIZE,
                 flush_interval: float = 1.0, max_file_bytes: int | None = None, max_file_seconds: float | None = None,
                 custom_data: Mapping[str, str] | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        if compression not in COMPRESSIONS:
            raise InvalidConfig(f'compression of the log: wanted one of {", ".join(COMPRESSIONS)}, got {compression!r}')
        self.directory, self.name = Path(directory), name
        self._compression, self._chunk_size = COMPRESSIONS[compression], chunk_size
        self._flush_interval, self._clock = flush_interval, clock
        self._max_bytes = max_file_bytes
        self._max_ns = None if max_file_seconds is None else int(max_file_seconds * 1e9)
        self._custom_data, self._topics = dict(custom_data or {}), dict[str, _Topic]()
        self._states: dict[tuple[str, Hashable], tuple[_Topic, int, int, bytes]] = {}
        self._files, self._written = list[bag.FileSummary](), list[WrittenFile]()
        self._writer: Writer | None = None
        self._failure, self._safe, self._is_described = '', 'nothing', False
        self._is_new = self._prepare_directory()
        try:
            self._begin_file()
        except BaseException as error:
            self.remove()
            if isinstance(error, FileExistsError):
                raise self._taken(Path(error.filename2 or error.filename).name) from error
            if isinstance(error, OSError):
                raise CellError(f'{self.directory}: cannot begin the log: {error.strerror}; make room and start '
                                'again') from error
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Number of messages in all files; what a further file repeats is counted once."""
        return sum(topic.messages for topic in self._topics.values())

    def add_topic(self, topic: str, definition: TypeDefinition, qos: Iterable[bag.Qos] = (),
                  state_of: Callable[[bytes], Hashable] | None = None) -> None:
        """Add a topic, once, before its first message.

        qos: of each of its publishers; state_of: for a topic whose last message holds until the next, returns of a
        message's bytes what it is the state of: the last message of each is repeated at the head of further files."""
        if topic in self._topics:
            raise InvalidData(f'{self.directory}: topic {topic} was added before')
        writer = self._open_writer()
        self._topics[topic] = _Topic(topic, definition, tuple(qos), state_of)
        with self._disk_errors():
            self._register(writer, self._topics[topic])

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Write one message: CDR bytes as on the wire, times in ns (before 1970: 0).

        Raises CellError where the disk refuses; what was flushed before stays readable."""
        writer = self._writer or self._open_writer()
        entry = self._topics.get(topic)
        if entry is None:
            raise InvalidData(f'{self.directory}: topic {topic} was not added to the log')
        log_time, publish_time = max(log_time, 0), max(publish_time, 0)
        try:
            if self._is_full(log_time):
                self._close_file(writer)
                writer = self._begin_file(log_time)
            self._add(writer, entry, entry.messages, log_time, publish_time, data)
        except OSError as error:
            raise self._refused(error) from error
        if entry.state_of is not None:
            key = (topic, entry.state_of(data))
            self._states.pop(key, None)  # what it replaces; the new one is the last
            self._states[key] = (entry, entry.messages, publish_time, data)
            if len(self._states) > MAX_STATES:
                del self._states[next(iter(self._states))]
        entry.messages += 1
        self._is_fresh = False
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush where something has waited for `flush_interval`; call it from a timer too."""
        if self._unflushed and self._clock() - self._flushed_at >= self._flush_interval:
            self.flush()

    def flush(self) -> None:
        """Finish the open chunk and bring everything to the disk, metadata.yaml included."""
        if self._writer is not None:
            with self._disk_errors():
                self._synchronise(self._writer)
                self._write_metadata_file()

    def close(self) -> None:
        """Finish the file with its summary and write metadata.yaml; a second call does nothing."""
        if self._writer is not None:
            with self._disk_errors():
                self._close_file(self._writer)
                self._write_metadata_file()

    def damage(self, is_whole: bool = False) -> str:
        """Return how the files on the disk differ from what was flushed or refused, '' where they do not.

        is_whole: whether their bytes are read, too."""
        return next(filter(None, (one.damage(is_whole) for one in self._written)), '')

    def abandon(self) -> None:
        """End without writing; damage of the files is not reported any more."""
        self._written.clear()
        self._stop()

    def remove(self) -> None:
        """Delete what was written, no other file, and the folder if it was made and is empty."""
        self._stop()
        for file in self._written:
            file.remove()
        with contextlib.suppress(OSError):
            if self._is_described:
                (self.directory / bag.FILE_NAME).unlink()
            if self._is_new:
                self.directory.rmdir()

    def _stop(self, kept: int | None = None) -> None:
        """Close the open file without writing; kept: bytes of it that stay, None for all."""
        if self._writer is not None:
            self._writer, raw = None, self._stream.raw  # detach() or close() would flush first, and fail
            with contextlib.suppress(OSError, ValueError):
                if kept is not None:
                    raw.truncate(kept)
            with contextlib.suppress(OSError, ValueError):
                raw.close()

    def _open_writer(self) -> Writer:
        """Return the writer of the open file; CellError after a refusal, InvalidData after closing."""
        if self._failure:
            raise CellError(self._failure)
        if self._writer is None:
            raise InvalidData(f'{self.directory}: the log is closed')
        return self._writer

    def _prepare_directory(self) -> bool:
        """Make the directory and return whether it is new; raises InvalidData where it holds a log."""
        is_new = not self.directory.exists()
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            present = sorted(path.name for path in self.directory.iterdir()
                             if path.suffix == '.mcap' or path.name == bag.FILE_NAME)
        except OSError as error:
            raise InvalidData(f'{self.directory}: wanted a folder for the log, got {error.strerror}; choose another '
                              'log folder') from error
        if present:
            raise self._taken(present[0])
        return is_new

    def _taken(self, name: str) -> InvalidData:
        return InvalidData(f'{self.directory}: holds a log already ({name}); nothing is overwritten, choose another '
                           'run name or log folder')

    def _begin_file(self, log_time: int = 0) -> Writer:
        """Open the next file; it gets its name, and metadata.yaml names it, when its head is on the disk."""
        path = self.directory / f'{self.name}_{len(self._files)}.mcap'
        unnamed = path.with_name(f'{path.name}.part')
        raw = WrittenFile(unnamed)
        self._written.append(raw)
        self._stream, self._safe_size = io.BufferedWriter(raw), 0
        self._file = bag.FileSummary(path.name)
        self._chunks, self._in_chunk, self._waiting, self._is_fresh = 0, 0, 0, True
        # Chunks are finished by this class, by Writer.flush: their number and size are known here.
        writer = self._writer = Writer(self._stream, chunk_size=1 << 62, compression=self._compression)
        writer.start('ros2', LIBRARY)
        for topic in self._topics.values():
            topic.in_file = 0
            self._register(writer, topic)
        self._add_metadata_record(writer)
        self._repeat_states(writer, log_time)
        self._synchronise(writer)
        self._head_size = self._stream.tell() + self._waiting
        raw.rename(path)
        synchronise_folder(self.directory)
        self._files.append(self._file)
        self._note_safe()
        self._write_metadata_file()
        return writer

    def _register(self, writer: Writer, topic: _Topic) -> None:
        """Write schema and channel of a topic.

        Some readers of ros2msg cannot name the parts of a service (docs/log-format.md): for their sake such a topic
        has a second channel without messages, before its own, whose schema in ros2idl gives the full names."""
        definition = topic.definition
        metadata = {'offered_qos_profiles': bag.qos_text(topic.qos), 'topic_type_hash': definition.hash}
        for encoding, text in (('ros2idl', definition.idl), ('ros2msg', definition.text)):
            if text or encoding == 'ros2msg':
                schema = writer.register_schema(definition.name, encoding, text.encode())
                topic.channel = writer.register_channel(topic.name, 'cdr', schema, metadata)
                self._waiting += _CHANNEL_HEAD + len(text) + sum(map(len, metadata.values()))

    def _repeat_states(self, writer: Writer, log_time: int) -> None:
        """Write what holds as it was, received when the file begins, in the order in which it came."""
        numbers = sorted((topic.name, number) for topic, number, _, _ in self._states.values())
        if not numbers:
            return
        writer.add_metadata(bag.REPEATED_RECORD, {
            name: ' '.join(str(number & _SEQUENCE) for _, number in group)
            for name, group in groupby(numbers, key=lambda entry: entry[0])})
        for topic, number, publish_time, data in self._states.values():
            self._add(writer, topic, number, log_time, publish_time, data)
            topic.repeated += 1

    def _add(self, writer: Writer, topic: _Topic, number: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Add a message to the open file; number: how many of its topic came before it."""
        writer.add_message(topic.channel, log_time, data, publish_time, number & _SEQUENCE)
        topic.in_file += 1
        self._file.count(log_time)
        self._unflushed = True
        self._in_chunk += 1
        self._waiting += _MESSAGE_HEAD + len(data)
        if self._waiting > self._chunk_size:
            self._finish_chunk(writer)

    def _is_full(self, log_time: int) -> bool:
        """Return whether the file shall end; one that holds nothing of its own goes on."""
        if self._is_fresh:
            return False
        if self._chunks >= MAX_CHUNKS:
            return True
        if len(self._files) >= MAX_FILES:
            return False
        too_long = self._max_ns is not None and log_time - self._file.start_ns >= self._max_ns
        too_big = self._max_bytes is not None and self._stream.tell() + self._waiting >= max(
            self._max_bytes, _LEAST_HEADS * self._head_size)
        return too_long or too_big

    def _finish_chunk(self, writer: Writer) -> None:
        """Write the open chunk; one without a message stays open."""
        writer.flush()
        if self._in_chunk:
            self._chunks += 1
            self._in_chunk = self._waiting = 0

    def _synchronise(self, writer: Writer) -> None:
        self._finish_chunk(writer)
        os.fsync(self._stream.fileno())
        self._note_safe()
        self._unflushed, self._flushed_at = False, self._clock()

    def _note_safe(self) -> None:
        """Remember up to where the disk has the open file; one that has no name yet is none."""
        self._safe_size = self._stream.tell()
        if self._file in self._files[-1:]:
            self._safe = f'{self._file.path}, {self._safe_size} bytes'

    def _close_file(self, writer: Writer) -> None:
        self._synchronise(writer)
        self._add_metadata_record(writer)
        writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._note_safe()
        self._stream.close()
        self._writer = None

    def _add_metadata_record(self, writer: Writer) -> None:
        """Describe the open file, and it alone, in itself."""
        topics = [topic.summary(topic.in_file) for topic in self._topics.values()]
        description = bag.bag_text(bag.bag_mapping(topics, [self._file], self._custom_data))
        writer.add_metadata(bag.METADATA_RECORD, {bag.METADATA_KEY: description})

    def _write_metadata_file(self) -> None:
        """Describe what stands in the files: other readers count there."""
        topics = [topic.summary(topic.messages + topic.repeated) for topic in self._topics.values()]
        bag.write_bag_metadata(self.directory, bag.bag_mapping(topics, self._files, self._custom_data),
                               not self._is_described)
        self._is_described = True

    @contextlib.contextmanager
    def _disk_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> CellError:
        """Give up the open file, drop of it what the disk did not take, and return the CellError that says why."""
        self._stop(self._safe_size)
        self._failure = (f'{self.directory}: cannot write the log: {error.strerror}; what was recorded until the last '
                         f'flush is readable ({self._safe}). Make room and start again')
        return CellError(self._failure)


@contextlib.contextmanager
def whole_log(directory: str | Path, name: str, **options: Any) -> Iterator[LogWriter]:
    """Open a LogWriter with its options; where the log cannot be written to its end, no file of it is left.

    Raises InvalidData where the directory holds a log, CellError where the disk refuses."""
    writer = None
    try:
        writer = LogWriter(directory, name, **options)
        with writer:
            yield writer
    except BaseException as error:
        if writer is not None:
            writer.remove()
        if isinstance(error, CellError) and isinstance(error.__cause__, OSError):
            raise CellError(f'{directory}: cannot write the log: {error.__cause__.strerror}; make room and try again, '
                            'nothing of it was kept') from error
        raise


def encode_messages(definition: TypeDefinition, messages: Iterable[Mapping[str, Any]]) -> list[bytes]:
    """Return messages of one type as CDR bytes; of each a mapping of fields, what is not given is zero or empty.

    The library encodes into an .mcap only: it is written to memory and read back."""
    stream = io.BytesIO()
    with mcap_ros2.writer.Writer(stream, compression=CompressionType.NONE) as writer:
        schema = writer.register_msgdef(definition.name, definition.text)
        for message in messages:
            writer.write_message('/', schema, message, log_time=0)
    stream.seek(0)
    return [message.data for _, _, message in NonSeekingReader(stream).iter_messages(log_time_order=False)]
