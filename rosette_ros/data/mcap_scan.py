# SPDX-License-Identifier: Apache-2.0
"""Reading MCAP files in bulk: whole chunks, and where the messages stand in them.

A file is read from front to back, so that one that ends in the middle gives everything up to its
last whole chunk. Source: MCAP specification, version 0.
"""

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.byte_views import every_byte
from rosette_ros.data.decompress import DAMAGED, DECOMPRESSORS
from rosette_ros.data.log_writer import REPEATED_RECORD

MAGIC = b'\x89MCAP0\r\n'
BATCH_BYTES = 1 << 22
"""Chunks are handed on in batches of about this size: memory stays bounded."""
MAX_CHUNK = 1 << 28
"""Larger chunks and records are not read, bytes."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
METADATA = 12
_READ = frozenset((HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, METADATA))

_RECORD = struct.Struct('<BQ')
_CHUNK_HEAD = struct.Struct('<QQQI')
_MESSAGE_HEAD = 31  # opcode 1, length 8, channel 2, sequence 4, log and publish time 8 + 8 bytes


@dataclass(frozen=True)
class Channel:
    """A channel of a file: topic, type_name, and how its messages are written."""

    topic: str
    type_name: str
    message_encoding: str
    schema_encoding: str
    schema_text: str
    metadata: dict


@dataclass(frozen=True, eq=False)
class Batch:
    """M messages of a file, in its order, standing in one buffer.

    buffer: (B,) uint8; channel: (M,) ids; log_time, publish_time: (M,) ns; start, end: (M,) of the
    data of each.
    """

    buffer: np.ndarray
    channel: np.ndarray
    log_time: np.ndarray
    publish_time: np.ndarray
    start: np.ndarray
    end: np.ndarray


@dataclass
class McapFile:
    """One MCAP file as it is read: what has been met so far.

    channels: Channel by id; metadata: mapping of each metadata record by name, the last one wins;
    chunks, messages: read so far; truncated: whether the end is missing; problems: in words; skip_repeated:
    whether what the file says that it repeats of an earlier one is passed over.
    """

    path: object
    channels: dict = field(default_factory=dict)
    metadata: dict = field(default_factory=dict)
    chunks: int = 0
    messages: int = 0
    truncated: bool = False
    problems: list = field(default_factory=list)
    skip_repeated: bool = False
    _schemas: dict = field(default_factory=dict)
    _repeated: dict = field(default_factory=dict)
    _pending: list = field(default_factory=list)
    _pending_bytes: int = 0
    _loose: list = field(default_factory=list)

    def batches(self):
        """Yield the messages of the file in Batches.

        Raises InvalidData where it is no MCAP file of profile ros2.
        """
        try:
            with open(self.path, 'rb', buffering=1 << 20) as stream:
                self._check_magic(stream)
                yield from self._read(stream)
        except OSError as error:
            raise InvalidData(f'{self.path}: wanted a log that can be read, got '
                              f'{error.strerror}; check the path and its rights') from error

    def _check_magic(self, stream):
        magic = stream.read(len(MAGIC))
        if not magic:
            raise InvalidData(f'{self.path}: is empty; wanted an MCAP log')
        if magic != MAGIC:
            raise InvalidData(f'{self.path}: is not an MCAP file: wanted it to begin with '
                              f'{MAGIC!r}, got {magic!r}')

    def _read(self, stream):
        chunk = None  # (data, offsets of messages that its indexes tell)
        ended = False
        for opcode, content in self._records(stream):
            if chunk is not None and opcode != MESSAGE_INDEX:
                self._add_chunk(*chunk)
                chunk = None
            if self._pending_bytes >= BATCH_BYTES:
                yield self._batch()
            if opcode == CHUNK:
                data = self._content(content)
                chunk = None if data is None else (data, [])
            elif opcode == MESSAGE_INDEX and chunk is not None:
                chunk[1].append(_index_offsets(content))
            elif opcode == MESSAGE:
                self._add_loose(content)
            elif opcode == FOOTER:
                ended = True
                if stream.read(len(MAGIC) + 1) != MAGIC:
                    self._tell(f'{self.path}: wanted its end behind its footer, got something else; what stands '
                               'there was not read')
                break
            else:
                self._meet(opcode, content)
        if chunk is not None:
            self._add_chunk(*chunk)
        if self._pending or self._loose:
            yield self._batch()
        if not ended:
            self.truncated = True
            self.problems.append(
                f'{self.path}: ends in the middle: the writer was killed or the file was cut; '
                f'read {self.messages} messages of {self.chunks} whole chunks')

    def _records(self, stream):
        """Yield (opcode, content) of each whole record; stop where the file is cut."""
        size = stream.seek(0, 2)
        at = stream.seek(len(MAGIC))
        first = True
        while at + _RECORD.size <= size:
            opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
            at += _RECORD.size + length
            if at > size or not opcode:
                return
            if first:
                self._check_first(opcode, length)
            if opcode not in _READ or length > MAX_CHUNK:
                if opcode in _READ:
                    self._tell(f'{self.path}: a record of {length} bytes was skipped; wanted at most {MAX_CHUNK}')
                stream.seek(at)
                continue
            content = stream.read(length)
            if first:
                self._check_profile(content)
            first = False
            yield opcode, content
        if first:
            raise InvalidData(f'{self.path}: is empty behind its first {len(MAGIC)} bytes; '
                              'wanted a log')

    def _check_first(self, opcode, length):
        if opcode != HEADER or length > MAX_CHUNK:
            raise InvalidData(f'{self.path}: is not an MCAP file: wanted a header record first, '
                              f'got a record of kind {opcode}')

    def _check_profile(self, content):
        fields = _Fields(content)
        head = self._guarded('header', lambda: (fields.text(), fields.text()))
        if head is not None and head[0] != 'ros2':
            raise InvalidData(f'{self.path}: profile: wanted ros2, got {head[0]!r:.80}; '
                              'record with ROS 2, or convert the log')

    def _guarded(self, what, parse):
        """Return what `parse` gives; a damaged record becomes a problem and None."""
        try:
            return parse()
        except (struct.error, UnicodeDecodeError, ValueError):
            self._tell(f'{self.path}: a damaged {what} record was skipped')
            return None

    def _tell(self, problem):
        """Note a problem, once."""
        if problem not in self.problems:
            self.problems.append(problem)

    def _meet(self, opcode, content):
        if opcode == SCHEMA:
            self._guarded('schema', lambda: self._add_schema(_Fields(content)))
        elif opcode == CHANNEL:
            self._guarded('channel', lambda: self._add_channel(_Fields(content)))
        elif opcode == METADATA:
            self._guarded('metadata', lambda: self._add_metadata(_Fields(content)))

    def _add_schema(self, fields):
        identifier = fields.number('<H')
        self._schemas[identifier] = (fields.text(), fields.text(),
                                     fields.text(errors='replace'))

    def _add_channel(self, fields):
        identifier, schema = fields.number('<H'), fields.number('<H')
        name, encoding, text = self._schemas.get(schema, ('', '', ''))
        topic, message_encoding = fields.text(), fields.text()
        channel = Channel(topic, name, message_encoding, encoding, text, fields.mapping())
        if schema and schema not in self._schemas:
            self._tell(f'{self.path}: topic {topic!r}: its schema, number {schema}, is missing')
        if self.channels.setdefault(identifier, channel) != channel:
            self._tell(f'{self.path}: channel {identifier} is described twice, of topic {channel.topic!r} and of '
                       f'{self.channels[identifier].topic!r}; the first holds')

    def _add_metadata(self, fields):
        name = fields.text()
        self.metadata[name] = fields.mapping()
        if name == REPEATED_RECORD and self.skip_repeated:
            self._repeated = {topic: [int(number) & 0xFFFFFFFF for number in numbers.split()]
                              for topic, numbers in self.metadata[name].items()}

    def _content(self, content):
        """Return the uncompressed bytes of a chunk record; None, and a problem, if damaged."""
        place = f'{self.path}: chunk {self.chunks + 1}'
        try:
            _, _, size, crc = _CHUNK_HEAD.unpack_from(content)
            fields = _Fields(content, _CHUNK_HEAD.size)
            compression = fields.text()
            length = fields.number('<Q')
            data = fields.rest()
        except (struct.error, UnicodeDecodeError, ValueError):
            return self._damaged(place, 'its head')
        if compression not in DECOMPRESSORS:
            raise InvalidData(f'{place}: compression: wanted none, lz4 or zstd, got '
                              f'{compression!r}; decompress the log with `mcap decompress`')
        if len(data) != length or size > MAX_CHUNK or (size > len(data) and not compression):
            return self._damaged(place, 'its length')
        try:
            data = DECOMPRESSORS[compression](data, size)
        except DAMAGED:
            return self._damaged(place, f'its {compression} data')
        if len(data) != size:
            return self._damaged(place, 'its length')
        if crc and zlib.crc32(data) != crc:
            return self._damaged(place, 'its checksum')
        return data

    def _damaged(self, place, what):
        """Note that a chunk is lost; the result, None, stands for its content."""
        self.problems.append(f'{place} is damaged ({what} is wrong): its messages are lost')
        self.chunks += 1

    def _add_chunk(self, data, indexes):
        self._gather_loose()
        self.chunks += 1
        self._pending.append((data, np.concatenate([_NONE, *indexes])))
        self._pending_bytes += len(data)

    def _add_loose(self, content):
        """Take a message that stands outside chunks."""
        if len(content) < _MESSAGE_HEAD - _RECORD.size:
            self._tell(f'{self.path}: a damaged message record was skipped')
        else:
            self._loose.append(_RECORD.pack(MESSAGE, len(content)) + content)
            self._pending_bytes += len(content) + _RECORD.size

    def _gather_loose(self):
        if self._loose:
            sizes = np.array([len(record) for record in self._loose])
            self._pending.append((b''.join(self._loose), np.cumsum(sizes) - sizes))
            self._loose = []

    def _batch(self):
        """Return the pending chunks as a Batch and forget them."""
        self._gather_loose()
        sizes = [len(data) for data, _ in self._pending]
        base = np.cumsum([0, *sizes])
        joined = b''.join(data for data, _ in self._pending)
        buffer = np.frombuffer(joined, np.uint8)
        told = [offsets + shift for (_, offsets), shift
                in zip(self._pending, base[:-1], strict=True)]
        offsets = self._told(joined, buffer, np.sort(np.concatenate([_NONE, *told])))
        if offsets is None:
            offsets = np.concatenate([_NONE, *(self._whole(joined, int(at), int(at) + size)
                                               for at, size in zip(base, sizes, strict=False))])
        self._pending, self._pending_bytes = [], 0
        offsets = self._fresh(buffer, offsets)
        self.messages += offsets.size
        if not offsets.size:
            return Batch(buffer, _NONE, _NONE, _NONE, _NONE, _NONE)
        length, times = every_byte(buffer, '<u8'), every_byte(buffer, '<i8')
        return Batch(
            buffer, every_byte(buffer, '<u2')[offsets + 9].astype(np.int64), times[offsets + 15],
            times[offsets + 23], offsets + _MESSAGE_HEAD,
            offsets + _RECORD.size + length[offsets + 1].astype(np.int64))

    def _fresh(self, buffer, offsets):
        """Return the messages without those that stand in an earlier file too."""
        if not self._repeated or not offsets.size:
            return offsets
        channel, sequence = every_byte(buffer, '<u2')[offsets + 9], every_byte(buffer, '<u4')[offsets + 11]
        repeated = np.zeros(offsets.size, dtype=bool)
        for identifier, entry in self.channels.items():
            if entry.topic in self._repeated:
                repeated |= (channel == identifier) & np.isin(sequence, self._repeated[entry.topic])
        return offsets[~repeated]

    def _told(self, data, buffer, offsets):
        """Return all messages if the indexes' `offsets` and the records between fit, else None.

        Every byte has to belong to a message that an index tells, or to a record found by walking
        through what lies between: a wrong index cannot hide or invent a message.
        """
        starts, ends = np.array([buffer.size]), np.zeros(1, np.int64)
        if offsets.size:
            if offsets[0] < 0 or offsets[-1] + _MESSAGE_HEAD > buffer.size:
                return None
            length = every_byte(buffer, '<u8')[offsets + 1]
            if (buffer[offsets] != MESSAGE).any() or (length > buffer.size).any() \
                    or (length < _MESSAGE_HEAD - _RECORD.size).any():
                return None
            starts = np.append(offsets, buffer.size)
            ends = np.append(0, offsets + _RECORD.size + length.astype(np.int64))
            if (ends > starts).any():
                return None
        between = [_NONE]
        for gap in np.flatnonzero(np.less(ends, starts)):
            found, at, short = self._walk(data, int(ends[gap]), int(starts[gap]))
            if at != starts[gap] or short:
                return None
            between.append(found)
        return np.sort(np.concatenate([offsets, *between]))

    def _whole(self, data, at, end):
        """Return the offsets of the messages of a chunk that stands from `at` to `end`."""
        offsets, stop, short = self._walk(data, at, end)
        if short:
            self._tell(f'{self.path}: a damaged message record was skipped')
        if stop != end:
            self._tell(f'{self.path}: a chunk does not end with a whole record: what stands behind the last one '
                       'that is whole is lost')
        return offsets

    def _walk(self, data, at, end):
        """Return (offsets of messages, where the last whole record ends, messages too short to be any)."""
        offsets, short = [], 0
        while at + _RECORD.size <= end:
            opcode, length = _RECORD.unpack_from(data, at)
            content = at + _RECORD.size
            if content + length > end or not opcode:
                break
            if opcode == MESSAGE and length >= _MESSAGE_HEAD - _RECORD.size:
                offsets.append(at)
            elif opcode == MESSAGE:
                short += 1
            elif opcode in (SCHEMA, CHANNEL):
                self._meet(opcode, data[content:content + length])
            at = content + length
        return np.array(offsets, dtype=np.int64), at, short


_NONE = np.zeros(0, np.int64)


class _Fields:
    """The content of a record, field by field."""

    def __init__(self, content, at=0):
        self.content, self.at = content, at

    def number(self, form):
        value, = struct.unpack_from(form, self.content, self.at)
        self.at += struct.calcsize(form)
        return value

    def text(self, errors='strict'):
        length = self.number('<I')
        if self.at + length > len(self.content):
            raise ValueError('text ends early')
        self.at += length
        return self.content[self.at - length:self.at].decode('utf-8', errors)

    def mapping(self):
        end = self.number('<I') + self.at
        if end > len(self.content):
            raise ValueError('mapping ends early')
        pairs = {}
        while self.at < end:
            key = self.text()
            pairs[key] = self.text()
        return pairs

    def rest(self):
        return memoryview(self.content)[self.at:]


def _index_offsets(content):
    """Return the offsets in a message index record, (M,); none where it is damaged."""
    if len(content) < 6 or (len(content) - 6) % 16:
        return np.zeros(0, np.int64)
    return np.frombuffer(content, '<u8', offset=6)[1::2].astype(np.int64)


