# SPDX-License-Identifier: Apache-2.0
"""Reading logs: the messages of .mcap files, decoded by the schemas that the log carries.

A file is read from front to back, so that one that ends in the middle gives everything up to its last whole chunk.
The mcap library parses the records, mcap-ros2-support the messages. Where records begin and end is found here, and
their lengths are bounded before memory is asked for: behind a damaged record reading goes on with the next one.
Source: MCAP specification, version 0."""

import math
import os
import struct
import time
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema, Statistics

from rosette_ros.core.errors import InvalidData
from rosette_ros.io import bag_metadata as bag
from rosette_ros.io.log_run import NEEDED, RECORDS, TF_MESSAGE, TF_STATIC, LogRun, check_version
from rosette_ros.io.message_decoder import message_decoder
from rosette_ros.io.safe_yaml import BAD_VALUE
from rosette_ros.io.text_file import reading

MAGIC = b'\x89MCAP0\r\n'
MAX_RECORD = 1 << 28  # larger records and chunks are not read, bytes
MAX_SUMMARY = 1 << 26  # a larger summary is not used, bytes; 40 000 chunks need half of it
MAX_EXPANSION, SPARE = 100, 64 << 20  # a log may expand to so many times its size, and so many bytes more
MAX_MESSAGES, MAX_PROBLEMS = 10_000_000, 20  # of a log; named of a file
READ_WITHIN = 60.0  # longest processor time for reading a log as a run, s: 2.5 million messages of a cell

_READ = frozenset((Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA,
                   Opcode.STATISTICS))
_RECORD_HEAD, _MESSAGE_HEAD = struct.Struct('<BQ'), struct.Struct('<HIqq')
_FOOTER, _CHUNK_INDEX = struct.Struct('<QQI'), struct.Struct('<16xQQ')
_KNOWN, _PRIVATE = frozenset(Opcode), 0x80
_DAMAGED = (EndOfFile, struct.error, ValueError)  # what the parsers of the library raise


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
        return self.type_name == TF_MESSAGE and self.topic.rpartition('/')[2] == TF_STATIC


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
    """What is left of what files, read together, may take: expanded bytes, messages, processor time in s."""

    def __init__(self, paths: Iterable[Path], within: float) -> None:
        self._paths = tuple(paths)
        sizes = (path.stat().st_size for path in self._paths if path.is_file())
        self._bytes, self._messages = MAX_EXPANSION * sum(sizes) + SPARE, MAX_MESSAGES
        self._within, self._until = within, time.thread_time() + within

    def take(self, expanded: int, messages: int) -> None:
        """Take something of it; raises InvalidData where too little is left."""
        self._bytes, self._messages = self._bytes - expanded, self._messages - messages
        over = (f'that expands to at most {MAX_EXPANSION} times its size, got a larger one' if self._bytes < 0 else
                f'of at most {MAX_MESSAGES} messages, got more' if self._messages < 0 else
                f'that is read within {self._within:g} s, got a longer one' if time.thread_time() > self._until else '')
        if over:
            raise InvalidData(f'{self._paths[0]}: wanted a log {over}; no cell writes such a log')


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
        self._undescribed = 0
        self._stated: int | None = None

    def messages(self, wanted: Callable[[LogChannel], bool] = lambda channel: True) -> Iterator[LoggedMessage]:
        """Yield the messages of the wanted channels; all are counted.

        Raises InvalidData where it is no MCAP file of profile ros2."""
        with reading(self.path, 'a log'), open(self.path, 'rb', buffering=1 << 20) as stream:
            yield from self._read(stream, wanted)

    def _read(self, stream: IO[bytes], wanted: Callable[[LogChannel], bool]) -> Iterator[LoggedMessage]:
        size = os.fstat(stream.fileno()).st_size
        self._check_begin(stream, size)
        for opcode, length in self._records(stream, size):
            if opcode == Opcode.FOOTER:
                stream.seek(length, os.SEEK_CUR)
                if stream.read(len(MAGIC) + 1) != MAGIC:
                    self._note('wanted its end behind its footer, got something else; what stands there was not read')
                break
            if opcode in _READ and length > MAX_RECORD:
                self._note(f'a record of {length} bytes was skipped; wanted at most {MAX_RECORD}')
            elif opcode == Opcode.CHUNK:
                data = self._chunk_data(stream.read(length))
                self.chunks += 1
                if data is not None:
                    yield from self._in_chunk(data, wanted)
            elif opcode in _READ:
                yield from self._record(opcode, stream.read(length), wanted)
            elif opcode not in _KNOWN and opcode < _PRIVATE:
                self._note(f'a record of unknown kind {opcode:#04x} was skipped; it was damaged')
        else:
            self.truncated = True
        if self._undescribed:
            self._note(f'{self._undescribed} messages of channels that the log does not describe before them')
        found, stated = self.summary.messages, self._stated
        is_short = not self.problems and (stated not in (None, found) or found < self._least)
        if self.truncated:
            self._note(f'ends in the middle: the writer was killed or the file was cut; '
                       f'read {self.summary.messages} messages of {self.chunks} whole chunks')
        if is_short:
            self._note(f'wanted {max(stated or 0, self._least)} messages, as its summary or {bag.FILE_NAME} says, got '
                       f'{found}; it was damaged')

    def _records(self, stream: IO[bytes], size: int) -> Iterator[tuple[int, int]]:
        """Yield as `_records`; behind damage it goes on with the next chunk that the summary of the file points to."""
        chunks, end = self._summary(stream, size)
        places, at, row = [*sorted(chunks), end], len(MAGIC), 0
        while at + _RECORD_HEAD.size <= size:
            stream.seek(at)
            opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
            if at in chunks and (opcode, length) != (Opcode.CHUNK, chunks[at]):
                self._note(f'the head of chunk {self.chunks + 1} is damaged; it was read as the summary says')
                opcode, length = Opcode.CHUNK, chunks[at]
            while row < len(places) and places[row] <= at:
                row += 1
            following = places[row] if row < len(places) else size
            at += _RECORD_HEAD.size + length
            self._allowance.take(0, 0)
            if opcode and at <= following:
                yield opcode, length
            elif following < size:
                self._note('a damaged part was skipped; reading went on where the summary says')
                at = following
            else:
                return

    def _summary(self, stream: IO[bytes], size: int) -> tuple[dict[int, int], int]:
        """Take schemas and channels of the summary; return of each chunk in it place and length, and its own place.

        A summary without a right checksum is none: ({}, size)."""
        foot = _RECORD_HEAD.size + _FOOTER.size
        stream.seek(max(size - foot - len(MAGIC), 0))
        data = stream.read()
        if len(data) < foot + len(MAGIC) or data[foot:] != MAGIC or data[0] != Opcode.FOOTER:
            return {}, size
        begin, _, checksum = _FOOTER.unpack_from(data, _RECORD_HEAD.size)
        long = size - foot - len(MAGIC) - begin
        if not (len(MAGIC) <= begin and 0 < long <= MAX_SUMMARY):
            return {}, size
        stream.seek(begin)
        content = stream.read(long)
        if zlib.crc32(data[:foot - 4], zlib.crc32(content)) != checksum:
            return {}, size
        chunks, part = dict[int, int](), BytesIO(content)
        for opcode, length in _records(part, 0, long):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                deque(self._record(opcode, part.read(length), lambda channel: False), 0)
            elif opcode == Opcode.CHUNK_INDEX and length >= _CHUNK_INDEX.size:
                place, whole = _CHUNK_INDEX.unpack(part.read(_CHUNK_INDEX.size))
                chunks[place] = whole - _RECORD_HEAD.size
        return {place: whole for place, whole in chunks.items() if len(MAGIC) <= place < begin - whole}, begin

    def _check_begin(self, stream: IO[bytes], size: int) -> None:
        magic = stream.read(len(MAGIC))
        if not magic:
            raise InvalidData(f'{self.path}: is empty; wanted an MCAP log')
        if magic != MAGIC:
            raise InvalidData(f'{self.path}: is not an MCAP file: wanted it to begin with {MAGIC!r}, got {magic!r}')
        if size < len(MAGIC) + _RECORD_HEAD.size:
            raise InvalidData(f'{self.path}: is empty behind its first {len(MAGIC)} bytes; wanted a log')
        opcode, length = next(_records(stream, len(MAGIC), size), (None, 0))
        if opcode is None:
            return  # it ends in the middle of its first record
        if opcode != Opcode.HEADER or length > MAX_RECORD:
            raise InvalidData(f'{self.path}: is not an MCAP file: wanted a header record first, got a record of kind '
                              f'{opcode}')
        try:
            profile = Header.read(_Content(stream.read(length))).profile
        except _DAMAGED:
            self._note('a damaged header record was skipped')
            return
        if profile != 'ros2':
            raise InvalidData(f'{self.path}: profile: wanted ros2, got {profile!r:.80}; record with ROS 2, or convert '
                              'the log')

    def _note(self, problem: str) -> None:
        words = f'{self.path}: {problem}'
        if words not in self.problems and len(self.problems) <= MAX_PROBLEMS:
            self.problems.append(words if len(self.problems) < MAX_PROBLEMS else f'{self.path}: has more problems')

    def _record(self, opcode: int, content: bytes, wanted: Callable[[LogChannel], bool]) -> Iterator[LoggedMessage]:
        """Take a record that is no chunk; a damaged one becomes a problem."""
        if opcode == Opcode.MESSAGE:
            yield from self._message(content, wanted)
            return
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(_Content(content))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                self._add_channel(Channel.read(_Content(content)))
            elif opcode == Opcode.METADATA:
                record = Metadata.read(_Content(content))
                if record.name == bag.METADATA_RECORD:
                    self.custom_data = bag.custom_data_in(record.metadata) or self.custom_data
            elif opcode == Opcode.STATISTICS:
                self._stated = Statistics.read(_Content(content)).message_count
        except _DAMAGED:
            self._note(f'a damaged {Opcode(opcode).name.lower()} record was skipped')

    def _add_channel(self, record: Channel) -> None:
        schema = self._schemas.get(record.schema_id) or Schema(record.schema_id, b'', '', '')
        channel = LogChannel(record.topic, schema.name, record.message_encoding, schema.encoding,
                             schema.data.decode(errors='replace'), record.metadata)
        if record.schema_id and record.schema_id not in self._schemas:
            self._note(f'topic {record.topic!r}: its schema, number {record.schema_id}, is missing')
        first = self.channels.setdefault(record.id, channel)
        if first != channel:
            self._note(f'channel {record.id} is described twice, of topic {channel.topic!r} and of {first.topic!r}; '
                       'the first holds')

    def _message(self, content: bytes, wanted: Callable[[LogChannel], bool]) -> Iterator[LoggedMessage]:
        if len(content) < _MESSAGE_HEAD.size:
            self._note('a damaged message record was skipped')
            return
        number, _, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content)
        channel = self.channels.get(number)
        self.summary.count(log_time)
        if not self.summary.messages % 1000:
            self._allowance.take(0, 1000)
        self.counts[number] += 1
        if channel is None:
            self._undescribed += 1
        elif wanted(channel):
            yield LoggedMessage(channel, log_time, publish_time, content[_MESSAGE_HEAD.size:], self.counts[number])

    def _chunk_data(self, content: bytes) -> bytes | None:
        """Return the uncompressed bytes of a chunk record; None, and a problem, where it is damaged."""
        place, wrong = f'chunk {self.chunks + 1}', 'its head'
        try:
            chunk = Chunk.read(_Content(content))
            if chunk.compression not in ('', 'lz4', 'zstd'):
                raise InvalidData(f'{self.path}: {place}: compression: wanted none, lz4 or zstd, got '
                                  f'{chunk.compression!r}; decompress the log with `mcap decompress`')
            wrong = f'its {chunk.compression} data'
            self._allowance.take(min(chunk.uncompressed_size, MAX_RECORD), 0)
            data = _uncompressed(chunk) if chunk.uncompressed_size <= MAX_RECORD else b''
            wrong = 'its length' if len(data) != chunk.uncompressed_size else 'its checksum'
            if wrong == 'its checksum' and chunk.uncompressed_crc in (0, zlib.crc32(data)):
                return data
        except (*_DAMAGED, RuntimeError, EOFError, zstandard.ZstdError) as error:
            wrong = 'its length' if isinstance(error, EndOfFile) else wrong
        self._note(f'{place} is damaged ({wrong} is wrong): its messages are lost')
        return None

    def _in_chunk(self, data: bytes, wanted: Callable[[LogChannel], bool]) -> Iterator[LoggedMessage]:
        stream, end = BytesIO(data), 0
        for opcode, length in _records(stream, 0, len(data)):
            end += _RECORD_HEAD.size + length
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                yield from self._record(opcode, stream.read(length), wanted)
        if end != len(data):
            self._note('a chunk does not end with a whole record: what stands behind the last whole one is lost')


def _records(stream: IO[bytes], at: int, size: int) -> Iterator[tuple[int, int]]:
    """Yield (opcode, length) of each whole record from `at` on, with the stream at its content."""
    while at + _RECORD_HEAD.size <= size:
        stream.seek(at)
        opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
        at += _RECORD_HEAD.size + length
        if at > size or not opcode:
            return
        yield opcode, length


class _Content(ReadDataStream):
    """The content of one record; a field that ends behind it raises EndOfFile."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if self.count + length > self._size:
            raise EndOfFile
        return super().read(length)


def _uncompressed(chunk: Chunk) -> bytes:
    """Return at most one byte more than a chunk shall have: a wrong size is seen and takes no memory."""
    most = chunk.uncompressed_size + 1
    if chunk.compression == 'lz4':
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most))
    if chunk.compression == 'zstd':
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            return reader.read(most)
    return chunk.data


def open_files(listing: bag.BagListing, within: float = math.inf) -> list[LogFile]:
    """Return a LogFile of each file of a log.

    within: processor time that reading may take, s; where it takes more of that, of messages or of memory than a log
    of a cell, the files raise InvalidData."""
    allowance = Allowance(listing.files, within)
    return [LogFile(path, allowance, listing.messages.get(path, 0)) for path in listing.files]


def iter_log(path: str | Path) -> Iterator[LoggedMessage]:
    """Yield every message of a log, in the order of recording."""
    for file in open_files(bag.find_files(path)):
        yield from file.messages()


def read_log(path: str | Path) -> LogRun:
    """Return what a log directory or an .mcap file holds; a log cut short gives what is whole.

    Raises InvalidData where there is no log, it is empty, of another profile, or its ball centres cannot be decoded."""
    listing = bag.find_files(path)
    files, log = open_files(listing, READ_WITHIN), LogRun(Path(path), listing.files)
    problems, checked = list(listing.problems), set[tuple[str, str]]()
    for file in files:
        for message in file.messages(_is_needed):
            schema = (message.type_name, message.channel.schema_text)
            try:
                record = decoded(message)
                if message.type_name in RECORDS and schema not in checked:
                    check_version(*schema, record)
                    checked.add(schema)
                log.add(message.type_name, record)
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
    found = (listing.custom_data, *(file.custom_data for file in reversed(files)))
    log.custom_data = next(filter(None, found), {})
    return log


def _is_needed(channel: LogChannel) -> bool:
    return channel.type_name in NEEDED and (channel.type_name != TF_MESSAGE or channel.is_static_frames)


def decoded(message: LoggedMessage) -> SimpleNamespace:
    """Return the fields of a message; raises InvalidData where it cannot be decoded."""
    channel = message.channel
    if channel.message_encoding != 'cdr' or channel.schema_encoding != 'ros2msg':
        raise InvalidData(f'wanted messages in cdr with a schema in ros2msg, got {channel.message_encoding!r} and '
                          f'{channel.schema_encoding!r}')
    return message_decoder(channel.type_name, channel.schema_text)(message.data)
