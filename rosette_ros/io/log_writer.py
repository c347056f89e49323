# SPDX-License-Identifier: Apache-2.0
"""Writing a log: one directory with `<name>_0.mcap` and rosbag2's metadata.yaml.

What was written is on the disk after at most `flush_interval` seconds of wall time: the open chunk is finished,
indexed and synchronised. So a killed process loses no more than that, and the file reads up to its last whole chunk.
metadata.yaml is written at the begin, without counts, and at the end."""

import contextlib
import io
import os
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mcap_ros2.writer
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from rosette_ros.core.run.errors import CellError, InvalidConfig, InvalidData
from rosette_ros.io import bag_metadata as bag
from rosette_ros.io.text_file import give_name, synchronise_folder
from rosette_ros.io.type_definitions import TypeDefinition

CHUNK_SIZE = 64 * 1024
LIBRARY = 'rosette_ros'
COMPRESSIONS = {'none': CompressionType.NONE, 'lz4': CompressionType.LZ4, 'zstd': CompressionType.ZSTD}
DOUBLING = 10_000
"""After each so many chunks the interval from flush to flush doubles: the index of the chunks is held in memory until
the end, 1.4 kB each with 13 topics. With one a second at first this is 55 MB after 36 h, 120 MB after 45 days."""
_SEQUENCE = 0xFFFFFFFF
_MESSAGE_HEAD = 31  # bytes of a record before its data


@dataclass(eq=False)
class _Topic:
    """A topic of the log, its channel, and how many messages it has."""

    name: str
    definition: TypeDefinition
    qos: tuple[bag.Qos, ...]
    channel: int = 0
    messages: int = 0


class LogWriter(contextlib.AbstractContextManager['LogWriter']):
    """Writes one log; a single thread may use it.

    directory, name: where, and the first part of the file names; compression: of chunks, a key of COMPRESSIONS;
    chunk_size: bytes after which a chunk is finished in any case; flush_interval: s of wall time after which it is
    finished, however small, longer in long logs (DOUBLING); custom_data: for metadata.yaml; clock: wall time in s that
    never jumps.

    Raises InvalidData where the directory holds a log already: nothing is ever overwritten."""

    def __init__(self, directory: str | Path, name: str, *, compression: str = 'none', chunk_size: int = CHUNK_SIZE,
                 flush_interval: float = 1.0, custom_data: Mapping[str, str] | None = None,
                 clock: Callable[[], float] = time.monotonic) -> None:
        if compression not in COMPRESSIONS:
            raise InvalidConfig(f'compression of the log: expected one of {", ".join(COMPRESSIONS)}, found '
                                f'{compression!r}')
        self.directory, self.name = Path(directory), name
        self._compression, self._chunk_size = COMPRESSIONS[compression], chunk_size
        self._flush_interval, self._clock = flush_interval, clock
        self._custom_data, self._topics = dict(custom_data or {}), dict[str, _Topic]()
        self._file = bag.FileSummary(f'{name}_0.mcap')
        self._written: WrittenFile | None = None
        self._writer: Writer | None = None
        self._chunks = self._in_chunk = self._waiting = 0
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
        """Number of messages."""
        return self._file.messages

    def add_topic(self, topic: str, definition: TypeDefinition, qos: Iterable[bag.Qos] = ()) -> None:
        """Add a topic, once, before its first message; qos: of each of its publishers."""
        if topic in self._topics:
            raise InvalidData(f'{self.directory}: topic {topic} was added before')
        writer = self._open_writer()
        self._topics[topic] = _Topic(topic, definition, tuple(qos))
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
            writer.add_message(entry.channel, log_time, data, publish_time, entry.messages & _SEQUENCE)
            entry.messages += 1
            self._file.count(log_time)
            self._unflushed = True
            self._in_chunk += 1
            self._waiting += _MESSAGE_HEAD + len(data)
            if self._waiting > self._chunk_size:
                self._finish_chunk(writer)
        except OSError as error:
            raise self._refused(error) from error
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush where something has waited for the interval; call it from a timer too."""
        interval = self._flush_interval * 2 ** (self._chunks // DOUBLING)
        if self._unflushed and self._clock() - self._flushed_at >= interval:
            self.flush()

    def flush(self) -> None:
        """Finish the open chunk and bring everything to the disk."""
        if self._writer is not None:
            with self._disk_errors():
                self._synchronise(self._writer)

    def close(self) -> None:
        """Finish the file with its summary and write metadata.yaml; a second call does nothing."""
        if self._writer is not None:
            with self._disk_errors():
                self._close_file(self._writer)
                self._write_metadata_file()

    def damage(self, is_whole: bool = False) -> str:
        """Return how the file on the disk differs from what was flushed or refused, '' where it does not.

        is_whole: whether its bytes are read, too."""
        return self._written.damage(is_whole) if self._written else ''

    def abandon(self) -> None:
        """End without writing; damage of the file is not reported any more."""
        self._written = None
        self._stop()

    def remove(self) -> None:
        """Delete what was written, no other file, and the folder if it was made and is empty."""
        self._stop()
        if self._written:
            self._written.remove()
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
            raise InvalidData(f'{self.directory}: expected a folder for the log, found {error.strerror}; choose '
                              'another '
                              'log folder') from error
        if present:
            raise self._taken(present[0])
        return is_new

    def _taken(self, name: str) -> InvalidData:
        return InvalidData(f'{self.directory}: holds a log already ({name}); nothing is overwritten, choose another '
                           'run name or log folder')

    def _begin_file(self) -> None:
        """Open the file; it gets its name, and metadata.yaml names it, when its head is on the disk."""
        path = self.directory / self._file.path
        raw = self._written = WrittenFile(path.with_name(f'{path.name}.part'))
        self._stream, self._safe_size = io.BufferedWriter(raw), 0
        # Chunks are finished by this class, by Writer.flush: their number and size are known here.
        writer = self._writer = Writer(self._stream, chunk_size=1 << 62, compression=self._compression)
        writer.start('ros2', LIBRARY)
        self._add_metadata_record(writer)
        self._synchronise(writer)
        raw.rename(path)
        synchronise_folder(self.directory)
        self._write_metadata_file()

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
        """Remember up to where the disk has the file."""
        self._safe_size = self._stream.tell()
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

    def _mapping(self) -> dict[str, Any]:
        topics = [bag.TopicSummary(one.name, one.definition.name, one.definition.hash, one.qos, one.messages)
                  for one in self._topics.values()]
        return bag.bag_mapping(topics, [self._file], self._custom_data)

    def _add_metadata_record(self, writer: Writer) -> None:
        """Describe the file in itself."""
        writer.add_metadata(bag.METADATA_RECORD, {bag.METADATA_KEY: bag.bag_text(self._mapping())})

    def _write_metadata_file(self) -> None:
        """Describe what stands in the file: other readers count there."""
        bag.write_bag_metadata(self.directory, self._mapping(), not self._is_described)
        self._is_described = True

    @contextlib.contextmanager
    def _disk_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> CellError:
        """Give up the file, drop of it what the disk did not take, and return the CellError that says why."""
        self._stop(self._safe_size)
        self._failure = (f'{self.directory}: cannot write the log: {error.strerror}; what was recorded until the last '
                         f'flush is readable ({self._safe}). Make room and start again')
        return CellError(self._failure)


@contextlib.contextmanager
def whole_log(directory: str | Path, name: str, **options: Any) -> Iterator[LogWriter]:
    """Open a LogWriter with its options; where the log cannot be written to its end, nothing of it is left.

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


class WrittenFile(io.FileIO):
    """A new file: bytes are added at its end alone, so that one that was cut is shorter than what was written.

    path: its name now. Raises FileExistsError where there is one of that name."""

    def __init__(self, path: Path) -> None:
        """Create the file."""
        super().__init__(path, 'ab', opener=lambda name, flags: os.open(name, flags | os.O_EXCL, 0o666))
        self.path, self._size = path, 0
        self._sum: int | None = 0
        self._identity = _identity(os.fstat(self.fileno()))

    def write(self, data: Any) -> int:
        """Write bytes and add them to the checksum."""
        written = super().write(data)
        self._size += written
        if self._sum is not None:
            self._sum = zlib.crc32(memoryview(data)[:written], self._sum)
        return written

    def truncate(self, size: int | None = None) -> int:
        """Cut the file; its checksum is then no longer known."""
        self._size, self._sum = super().truncate(size), None
        return self._size

    def rename(self, path: Path) -> None:
        """Give the file its final name; raises FileExistsError where there is one of that name."""
        give_name(self.path, path)
        self.path = path

    def remove(self) -> None:
        """Delete the file, unless another one has its name now."""
        with contextlib.suppress(OSError):
            if _identity(os.stat(self.path)) == self._identity:
                self.path.unlink()

    def damage(self, is_whole: bool = False) -> str:
        """Return how the file on the disk differs from what was written, '' where it does not.

        is_whole: whether its bytes are read, too."""
        try:
            status = os.stat(self.path)
            if _identity(status) != self._identity:
                return f'{self.path.name} was replaced by another file'
            if status.st_size != self._size:
                return f'{self.path.name} has {status.st_size} bytes, {self._size} were written'
            if is_whole and self._sum is not None and _sum(self.path) != self._sum:
                return f'{self.path.name} holds other bytes than were written'
        except FileNotFoundError:
            return f'{self.path.name} was deleted'
        except OSError as error:
            return f'{self.path.name} cannot be read: {error.strerror}'
        return ''


def _identity(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _sum(path: Path) -> int:
    value = 0
    with open(path, 'rb') as stream:
        while data := stream.read(1 << 20):
            value = zlib.crc32(data, value)
    return value
