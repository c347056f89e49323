# SPDX-License-Identifier: Apache-2.0
"""Writing one MCAP file: chunks with indexes and checksums, and the summary at its end.

A recorder has to take every message that a cell can say. This writer takes a fraction of the time of the `mcap`
library's for a message, and holds the index of a chunk as the bytes that it will be in the file, not as objects.
Source: MCAP specification, version 0.
"""

import struct
import zlib

import lz4.frame
import zstandard

MAGIC = b'\x89MCAP0\r\n'

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 1, 2, 3, 4, 5, 6, 7, 8
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 11, 12, 13, 14, 15

COMPRESSIONS = {'none': ('', bytes), 'lz4': ('lz4', lz4.frame.compress), 'zstd': ('zstd', zstandard.compress)}
"""By the name that people use: the name in the file, and the function."""

_RECORD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<BQHIQQ')
_MESSAGE_REST = _MESSAGE.size - _RECORD.size
_FOOTER = struct.Struct('<BQQQ')
_FOOTER_LENGTH = 20


class McapWriter:
    """Writes one file of profile ros2 to a binary stream that stands at its beginning.

    library: who writes; chunk_size: bytes after which a chunk is finished; compression: a key of COMPRESSIONS. The
    stream is not closed. After an OSError of the stream nothing more may be written.
    """

    def __init__(self, stream, library, chunk_size, compression='none'):
        """Write the magic bytes and the header."""
        self._stream, self._chunk_size = stream, chunk_size
        self._compression, self._compress = COMPRESSIONS[compression]
        self._size = 0
        self._schemas, self._channels = [], []
        self._counts = {}
        self._metadata_index, self._chunk_index = [], bytearray()
        self._times = None
        self._chunk, self._index = bytearray(), {}
        self.chunks = 0
        self._put(MAGIC + _record(HEADER, _text('ros2') + _text(library)))

    @property
    def size(self):
        """Bytes written so far, the open chunk included as it is before compression."""
        return self._size + len(self._chunk)

    def add_schema(self, name, encoding, data):
        """Add a schema, data: bytes; return its number."""
        number = len(self._schemas) + 1
        self._schemas.append(_record(SCHEMA, _u2(number) + _text(name) + _text(encoding) + _u4(len(data)) + data))
        self._chunk += self._schemas[-1]
        return number

    def add_channel(self, topic, message_encoding, schema, metadata):
        """Add a channel of a topic; metadata: mapping of texts; return its number."""
        number = len(self._channels) + 1
        self._channels.append(_record(CHANNEL, _u2(number) + _u2(schema) + _text(topic) + _text(message_encoding)
                                      + _mapping(metadata)))
        self._chunk += self._channels[-1]
        return number

    def add_metadata(self, name, mapping):
        """Write a metadata record, outside the chunks."""
        record = _record(METADATA, _text(name) + _mapping(mapping))
        self._metadata_index.append(_record(METADATA_INDEX, _u8(self._size, len(record)) + _text(name)))
        self._put(record)

    def add_message(self, channel, sequence, log_time, publish_time, data):
        """Add a message to the open chunk; times in ns."""
        chunk, index = self._chunk, self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
        index.append(log_time)
        index.append(len(chunk))
        chunk += _MESSAGE.pack(MESSAGE, _MESSAGE_REST + len(data), channel, sequence, log_time, publish_time)
        chunk += data
        if len(chunk) > self._chunk_size:
            self._finish_chunk()

    def flush(self):
        """Finish the open chunk, if a message is in it, and hand all to the system."""
        self._finish_chunk()
        self._stream.flush()

    def finish(self):
        """Write the end of the file: the summary with all indexes."""
        self._finish_chunk()
        self._put(bytes(self._chunk) + _record(DATA_END, _u4(0)))  # topics without messages; 0: no checksum
        start, summary, offsets = self._size, bytearray(), bytearray()
        for opcode, group in ((SCHEMA, b''.join(self._schemas)), (CHANNEL, b''.join(self._channels)),
                              (STATISTICS, self._statistics()), (CHUNK_INDEX, self._chunk_index),
                              (METADATA_INDEX, b''.join(self._metadata_index))):
            if group:
                offsets += _record(SUMMARY_OFFSET, bytes((opcode,)) + _u8(start + len(summary), len(group)))
                summary += group
        footer = _FOOTER.pack(FOOTER, _FOOTER_LENGTH, start, start + len(summary))
        summary += offsets + footer
        self._put(summary + _u4(zlib.crc32(summary)) + MAGIC)
        self._stream.flush()

    def _put(self, data):
        self._stream.write(data)
        self._size += len(data)

    def _finish_chunk(self):
        if not self._index:
            return
        data, index = bytes(self._chunk), self._index
        self._chunk, self._index = bytearray(), {}
        first = min(min(pairs[::2]) for pairs in index.values())
        last = max(max(pairs[::2]) for pairs in index.values())
        packed = self._compress(data)
        begin = self._size
        record = _record(CHUNK, _u8(first, last, len(data)) + _u4(zlib.crc32(data)) + _text(self._compression)
                         + _u8(len(packed)) + packed)
        indexes, places = bytearray(), bytearray()
        for channel, pairs in index.items():
            places += _u2(channel) + _u8(begin + len(record) + len(indexes))
            indexes += _record(MESSAGE_INDEX, _u2(channel) + _u4(8 * len(pairs)) + _u8(*pairs))
            self._counts[channel] = self._counts.get(channel, 0) + len(pairs) // 2
        self._put(record)
        self._put(indexes)
        self._chunk_index += _record(
            CHUNK_INDEX, _u8(first, last, begin, len(record)) + _u4(len(places)) + places + _u8(len(indexes))
            + _text(self._compression) + _u8(len(packed), len(data)))
        self._times = (first, last) if self._times is None else (min(first, self._times[0]), max(last, self._times[1]))
        self.chunks += 1

    def _statistics(self):
        counts = b''.join(_u2(channel) + _u8(count) for channel, count in sorted(self._counts.items()))
        return _record(STATISTICS, _u8(sum(self._counts.values())) + _u2(len(self._schemas)) + _u4(len(self._channels))
                       + _u4(0) + _u4(len(self._metadata_index)) + _u4(self.chunks) + _u8(*self._times or (0, 0))
                       + _u4(len(counts)) + counts)


def _record(opcode, content):
    return _RECORD.pack(opcode, len(content)) + content


def _u2(number):
    return number.to_bytes(2, 'little')


def _u4(number):
    return number.to_bytes(4, 'little')


def _u8(*numbers):
    return struct.pack(f'<{len(numbers)}Q', *numbers)


def _text(text):
    data = text.encode()
    return _u4(len(data)) + data


def _mapping(mapping):
    content = b''.join(_text(key) + _text(value) for key, value in mapping.items())
    return _u4(len(content)) + content
