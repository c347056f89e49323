# SPDX-License-Identifier: Apache-2.0
"""Reading logs: the messages of .mcap files, decoded by the schemas that the log carries.

A file is read from front to back by the StreamReader of the mcap library, so that one that ends in the middle gives
everything up to its last whole chunk; behind damage reading goes on with the next chunk that its summary points to.
What a record states of its own size is bounded before memory is asked for."""

import contextlib
import math
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from io import SEEK_END, BufferedReader
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io import bag_metadata as bag
from rosette_ros.io import log_run
from rosette_ros.io.log_run import RECORDS, TF_MESSAGE, LogRun
from rosette_ros.io.message_decoder import message_decoder
from rosette_ros.io.safe_yaml import BAD_VALUE
from rosette_ros.io.text_file import is_regular, reading, regular

MAGIC = b'\x89MCAP0\r\n'
MAX_RECORD = 1 << 25  # larger records and chunks are not read, bytes
MAX_EXPANSION, SPARE = 100, 4 << 20  # a log may expand to so many times its size, and so many bytes more
MAX_PROBLEMS = 20  # named of a file
READ_WITHIN, PER_BYTE = 10.0, 1e-5
"""Longest processor time for reading a log as a run, s: so much, and for each byte; a cell's takes a fifth at most."""

_INDEXES = frozenset((Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT))
_SIMULATED = log_run.SIMULATED_STATUS.encode()
_PACKED = b'\x28\xb5\x2f\xfd'  # how zstd begins: a message that rosbag2 compressed on its own
_DAMAGED = (McapError, struct.error, ArithmeticError, ValueError, MemoryError)  # what the library raises


class LogChannel(NamedTuple):
    """A channel of a file: its topic, and how its messages are written."""

    topic: str
    type_name: str
    message_encoding: str
    schema_encoding: str
    schema_text: str
    metadata: dict[str, str]

    @property
    def type_hash(self) -> str:
        """The RIHS01 type hash, '' where the log has none."""
        return self.metadata.get('topic_type_hash', '')

    @property
    def qos(self) -> tuple[bag.Qos, ...]:
        """The quality of service that its publishers offered."""
        return bag.parse_qos(self.metadata.get('offered_qos_profiles', ''))

    @property
    def is_static_frames(self) -> bool:
        """Whether it carries latched transforms."""
        return self.type_name == TF_MESSAGE and self.topic.rpartition('/')[2] == log_run.TF_STATIC


class LoggedMessage(NamedTuple):
    """One message as it stands in the log: CDR bytes, times in ns; number: 1, 2, 3 ... of its channel in the file."""

    channel: LogChannel
    log_time: int
    publish_time: int
    data: bytes
    number: int

    @property
    def topic(self) -> str:
        return self.channel.topic

    @property
    def type_name(self) -> str:
        return self.channel.type_name


class Allowance:
    """What is left of what files, read together, may take: expanded bytes, processor time in s.

    Both grow with the size of the files: a log may be as long as a run is."""

    def __init__(self, paths: Iterable[Path], within: float) -> None:
        self._paths = tuple(paths)
        size = sum(path.stat().st_size for path in self._paths if path.is_file())
        self._bytes, self._within = MAX_EXPANSION * size + SPARE, within + PER_BYTE * size
        self._until = time.thread_time() + self._within

    def take(self, expanded: int = 0) -> None:
        """Take bytes of it; raises InvalidData where too little is left."""
        self._bytes -= expanded
        over = (f'that expands to at most {MAX_EXPANSION} times its size, found a larger one' if self._bytes < 0 else
                f'that is read within {self._within:.3g} s, found a longer one' if time.thread_time() > self._until
                else '')
        if over:
            raise InvalidData(f'{self._paths[0]}: expected a log {over}; no cell writes such a log')


class _Bounded(BufferedReader):
    """A file of which nothing larger than a record is read at once; what ends early raises EndOfFile."""

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size) if size and size <= MAX_RECORD else b''
        if len(data) != size:
            raise EndOfFile
        return data


class _Records(StreamReader):
    """The reader of the library, which does not parse what only finds messages without reading all."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        return super()._read_record(0 if opcode in _INDEXES else opcode, length)


class LogFile:
    """One .mcap file as it is read.

    channels: by number; custom_data: of the last metadata record that has any; counts: messages by channel; chunks:
    read so far; summary: of its messages; truncated: whether the end is missing; problems: in words; stated: its
    messages, at least, as metadata.yaml says."""

    def __init__(self, path: Path, allowance: Allowance, stated: int = 0) -> None:
        self.path, self._allowance, self._least = path, allowance, stated
        self.channels, self.counts, self.problems = dict[int, LogChannel](), Counter[int](), list[str]()
        self.custom_data: dict[str, str] = {}
        self.chunks, self.summary, self.truncated = 0, bag.FileSummary(path.name), False
        self._schemas: dict[int, Schema] = {}
        self._undescribed, self._sound = 0, len(MAGIC)
        self._stated: int | None = None
        self._places: list[int] | None = None

    def messages(self, wanted: Callable[[LogChannel], bool] = lambda channel: True) -> Iterator[LoggedMessage]:
        """Yield the messages of the wanted channels; all are counted.

        Raises InvalidData where it is no MCAP file, or states another profile than ros2."""
        with reading(self.path, 'a log'), open(self.path, 'rb', 0, opener=regular) as raw:
            stream = _Bounded(raw, 1 << 20)
            for record in self._records(stream):
                for one in self._in_chunk(record, stream) if isinstance(record, Chunk) else (record,):
                    if not isinstance(one, Message):
                        self._describe(one)
                    elif message := self._message(one, wanted):
                        yield message
        self._compare()

    def _records(self, stream: _Bounded) -> Iterator[McapRecord]:
        """Yield the records of a file, chunks as they are; behind damage those from the next chunk of its summary on.

        `_sound`: behind the last chunk that was right."""
        is_first = True
        while True:
            reader = _Records(stream, not is_first, emit_chunks=True, validate_crcs=True,
                              record_size_limit=MAX_RECORD)
            try:
                for record in reader.records:
                    if is_first and not isinstance(record, Header):
                        raise InvalidData(f'{self.path}: is not an MCAP file: expected a header record first, none '
                                          'came')
                    is_first = False
                    self._allowance.take()
                    yield record
                if words := bag.rest_words(stream.tell(), stream.seek(0, SEEK_END)):
                    self._note(words)
                return
            except _DAMAGED as error:
                self._read_summary(stream)
                place = next((one for one in self._places or () if one >= self._sound), None)
                if is_first and (place is None or isinstance(error, InvalidMagic)):
                    raise InvalidData(f'{self.path}: is empty; expected an MCAP '
                                      'log' if not stream.seek(0, SEEK_END) else
                                      f'{self.path}: is not an MCAP file: expected it to begin with {MAGIC!r} and a '
                                      'header record') from error
                if place is None:
                    self.truncated = isinstance(error, EndOfFile)
                    if not self.truncated:
                        self._note(f'is damaged behind byte {self._sound}: the rest is lost')
                    return
                self._note('a damaged part was skipped; reading went on where the summary says')
                stream.seek(place)
                self._sound, is_first = place + 1, False

    def _read_summary(self, stream: _Bounded) -> None:
        """Take schemas, channels and places of chunks of the summary, where there is a right one."""
        at = stream.tell()
        if self._places is None:
            self._places = []
            stream.seek(0)
            try:
                summary = SeekingReader(stream, record_size_limit=MAX_RECORD).get_summary()
            except (OSError, *_DAMAGED):
                summary = None
            if summary is not None:
                for one in (*summary.schemas.values(), *summary.channels.values()):
                    self._describe(one)
                self._places = sorted(one.chunk_start_offset for one in summary.chunk_indexes)
        stream.seek(at)

    def _compare(self) -> None:
        """Take note of messages that are missing."""
        if self._undescribed:
            self._note(f'{self._undescribed} messages of channels that the log does not describe before them')
        found, stated = self.summary.messages, self._stated
        is_short = not self.problems and (stated not in (None, found) or found < self._least)
        if self.truncated:
            self._note(f'ends in the middle: the writer was killed or the file was cut; read {found} messages of '
                       f'{self.chunks} whole chunks')
        if is_short:
            self._note(f'expected {max(stated or 0, self._least)} messages, as its summary or {bag.FILE_NAME} says, '
                       'found '
                       f'{found}; it was damaged')

    def _note(self, problem: str) -> None:
        words = f'{self.path}: {problem}'
        if words not in self.problems and len(self.problems) <= MAX_PROBLEMS:
            self.problems.append(words if len(self.problems) < MAX_PROBLEMS else f'{self.path}: has more problems')

    def _describe(self, record: McapRecord) -> None:
        """Take a record that is neither message nor chunk."""
        if isinstance(record, Header) and record.profile not in ('ros2', ''):
            raise InvalidData(f'{self.path}: profile: expected ros2, found {record.profile!r:.80}; record with ROS 2, '
                              'or '
                              'convert the log')
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._add_channel(record)
        elif isinstance(record, Statistics):
            self._stated = record.message_count
        elif isinstance(record, Metadata) and record.name == bag.METADATA_RECORD:
            try:
                self.custom_data = bag.custom_data_in(record.metadata) or self.custom_data
            except ValueError:
                self._note('a damaged metadata record was skipped')

    def _add_channel(self, record: Channel) -> None:
        schema = self._schemas.get(record.schema_id) or Schema(record.schema_id, b'', '', '')
        channel = LogChannel(record.topic, schema.name, record.message_encoding, schema.encoding,
                             schema.data.decode(errors='replace'), record.metadata)
        if record.schema_id and record.schema_id not in self._schemas:
            self._note(f'topic {record.topic!r}: its schema, number {record.schema_id}, is missing')
        if (first := self.channels.setdefault(record.id, channel)) != channel:
            self._note(f'channel {record.id} is described twice, of topic {channel.topic!r} and of {first.topic!r}; '
                       'the first holds')

    def _message(self, record: Message, wanted: Callable[[LogChannel], bool]) -> LoggedMessage | None:
        """Return a message of a wanted channel; it is counted in any case."""
        number, data = record.channel_id, record.data
        channel = self.channels.get(number)
        self.summary.count(record.log_time)
        if not self.summary.messages % 1000:
            self._allowance.take()
        self.counts[number] += 1
        if channel is None:
            self._undescribed += 1
        elif wanted(channel):
            if data.startswith(_PACKED):
                with contextlib.suppress(zstandard.ZstdError):  # then it cannot be decoded, which is told
                    data = _uncompressed(data, 'zstd', MAX_RECORD)
                self._allowance.take(len(data))
            return LoggedMessage(channel, record.log_time, record.publish_time, data, self.counts[number])
        return None

    def _in_chunk(self, chunk: Chunk, stream: _Bounded) -> list[McapRecord]:
        """Return the records in a chunk; none, and a problem, where it is damaged."""
        self.chunks += 1
        wrong, size = f'its {chunk.compression} data', chunk.uncompressed_size
        if chunk.compression not in ('', 'lz4', 'zstd'):
            raise InvalidData(f'{self.path}: chunk {self.chunks}: compression: expected none, lz4 or zstd, found '
                              f'{chunk.compression!r:.80}; decompress the log with `mcap decompress`')
        if size > MAX_RECORD:
            self._note(f'a chunk that expands to {size} bytes was skipped; expected at most {MAX_RECORD}')
            return []
        try:
            data = _uncompressed(chunk.data, chunk.compression, size)
            self._allowance.take(len(data))
            wrong = 'its length' if len(data) != size else 'its checksum'
            if wrong == 'its checksum':
                records = breakup_chunk(replace(chunk, compression='', data=data), validate_crc=True)
                self._sound = stream.tell()
                return records
        except (*_DAMAGED, RuntimeError, EOFError, zstandard.ZstdError):
            pass
        self._note(f'chunk up to byte {stream.tell()} is damaged ({wrong} is wrong): its messages are lost')
        self._read_summary(stream)
        return []


def _uncompressed(data: bytes, compression: str, size: int) -> bytes:
    """Return at most one byte more than data shall have: a wrong size is seen and takes no memory."""
    if compression == 'lz4':
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    if compression == 'zstd':
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            return reader.read(size + 1)
    return data


def find_files(path: str | Path) -> bag.BagListing:
    """Return the BagListing of a log directory, in one file or in parts, or of one .mcap file.

    Raises InvalidData where there is none, or metadata.yaml is none or names a file that is missing."""
    path = Path(path)
    with reading(path, 'a log'):
        if path.is_file():
            return bag.BagListing((path,))
        if not path.is_dir():
            raise InvalidData(f'{path}: expected a log directory or an .mcap file, found '
                              f'{"a device or a pipe" if path.exists() else "nothing there; check the path"}')
        if parts := _parts_in(path):
            return bag.BagListing(parts)
        if not bag.is_named_as_log(path):
            if not (inside := runs_in(path)):
                for one in sorted(filter(is_regular, path.iterdir())):
                    with open(one, 'rb') as stream:
                        bag.refuse_other(one, stream.read(512))
                raise InvalidData(f'{path}: expected a log directory with .mcap files, found none in it')
            raise InvalidData(f'{path}: expected a run, found a folder of {len(inside)}: '
                              f'{", ".join(one.name for one in inside)}; name one of them (rosette runs lists them)')
        if packed := bag.packed_in(path):
            raise bag.packed_error(packed)
        if is_regular(path / bag.FILE_NAME):
            return bag.read_bag_metadata(path / bag.FILE_NAME)
        found = bag.files_in(path)
        numbers = [bag.numbered(one.name)[1] for one in found]
        lost = sorted({*range(numbers[0], numbers[-1])} - {*numbers})  # the oldest may be gone, which is no loss
        return bag.BagListing(found, problems=tuple(
            f'{path}: {bag.numbered(found[0].name)[0]}_{number}.mcap is missing; put it back'
            for number in lost[:bag.MOST_LOST]))


def holds_log(directory: Path) -> bool:
    """Return whether a folder is one log, by the names of its files or by what these hold."""
    return bag.is_named_as_log(directory) or bool(_parts_in(directory))


def runs_in(folder: str | Path) -> list[Path]:
    """Return the logs and tables in a folder, newest first; raises InvalidData where it cannot be read.

    The files of a folder that is one log are no runs."""
    with reading(folder, 'a folder of runs'):
        found = [path for path in Path(folder).iterdir() if _is_run(path)]
        parts = [path for path in found if path.suffix == '.mcap' and path.is_file()]
        if len(parts) > 1 and holds_log(Path(folder)):
            found = [Path(folder), *(path for path in found if path not in parts)]
        return sorted(found, key=written, reverse=True)


def written(path: str | Path) -> float:
    """Return when the last file of a log, or a table, was written, s since the epoch: what is added to its folder later
    is no part of it."""
    files = [one for one in bag.files_in(Path(path)) if is_regular(one)] if Path(path).is_dir() else []
    return max(one.stat().st_mtime for one in files or [Path(path)])


def _is_run(path: Path) -> bool:
    """Return whether a name in a folder is that of a log or a table, sound or not; a link without an end is none."""
    try:
        if bag.is_hidden(path.name):
            return False
        return holds_log(path) if path.is_dir() else path.suffix in ('.mcap', '.csv') and is_regular(path)
    except OSError:  # a folder of somebody else
        return False


def _parts_in(directory: Path) -> tuple[Path, ...]:
    """Return the files of a log that their names do not make one, but that are of one run and follow each other."""
    logs, runs = list[LogRun](), set[str]()
    with contextlib.suppress(InvalidData):
        for file in bag.files_in(directory) if directory.is_dir() and not bag.is_named_as_log(directory) else ():
            logs.append(read_log(file))
            runs |= {*logs[-1].runs, *(state.run_id for state in logs[-1].states)}
            if len(runs) != 1:
                break
        logs.sort(key=lambda log: log.start_ns)
        if len(runs) == 1 and all(before.end_ns <= after.start_ns for before, after in pairwise(logs)):
            return tuple(log.path for log in logs)
    return ()


def open_files(listing: bag.BagListing, within: float = math.inf) -> list[LogFile]:
    """Return a LogFile of each file of a log.

    within: processor time that reading may take, s; where it takes more of that, of messages or of memory than a log
    of a cell, the files raise InvalidData."""
    allowance = Allowance(listing.files, within)
    return [LogFile(path, allowance, listing.messages.get(path, 0)) for path in listing.files]


def iter_log(path: str | Path) -> Iterator[LoggedMessage]:
    """Yield every message of a log, in the order of recording."""
    for file in open_files(find_files(path)):
        yield from file.messages()


def read_log(path: str | Path) -> LogRun:
    """Return what a log directory or an .mcap file holds; a log cut short gives what is whole.

    Raises InvalidData where there is no log, it is empty, of another profile, or its ball centres cannot be decoded."""
    listing = find_files(path)
    files, log = open_files(listing, READ_WITHIN), LogRun(Path(path), listing.files)
    problems, checked = list(listing.problems), set[tuple[str, str]]()
    for file in files:
        for message in file.messages(_is_needed):
            if message.type_name == log_run.DIAGNOSTICS and (log.is_cmm_simulated or _SIMULATED not in message.data):
                continue
            schema = (message.type_name, message.channel.schema_text)
            try:
                record = decoded(message)
                if message.type_name in RECORDS and schema not in checked:
                    log_run.check_version(*schema, record)
                    checked.add(schema)
                log.add(message.type_name, record, message.log_time)
            except (InvalidData, *BAD_VALUE) as error:
                words = f'{file.path}: topic {message.topic}: message {message.number}: {error}'
                if message.type_name in RECORDS:
                    raise InvalidData(words) from error
                problems.append(words)
    counts = Counter[str]()
    for file in files:
        for number, channel in file.channels.items():
            counts[channel.topic] += file.counts[number]
    channels = {channel.topic: channel for file in files for channel in file.channels.values()}
    log.topics = tuple(bag.TopicSummary(topic, channel.type_name, channel.type_hash, channel.qos, counts[topic])
                       for topic, channel in channels.items())
    log.messages = sum(file.summary.messages for file in files)
    log.start_ns, log.end_ns = bag.span(file.summary for file in files)
    log.truncated = any(file.truncated for file in files)
    log.problems = (*problems, *(problem for file in files for problem in file.problems))
    log.custom_data = next(filter(None, (listing.custom_data, *(file.custom_data for file in reversed(files)))), {})
    return log


def _is_needed(channel: LogChannel) -> bool:
    return channel.type_name in log_run.NEEDED and (channel.type_name != TF_MESSAGE or channel.is_static_frames)


def decoded(message: LoggedMessage) -> SimpleNamespace:
    """Return the fields of a message; raises InvalidData where it cannot be decoded."""
    channel = message.channel
    if channel.message_encoding != 'cdr' or channel.schema_encoding != 'ros2msg':
        raise InvalidData(f'expected messages in cdr with a schema in ros2msg, found {channel.message_encoding!r} and '
                          f'{channel.schema_encoding!r}')
    return message_decoder(channel.type_name, channel.schema_text)(message.data)
