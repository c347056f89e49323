# SPDX-License-Identifier: Apache-2.0
"""CDR as ROS 2 sends it: one message into an object, many messages into arrays, arrays into bytes.

A message is four bytes of encapsulation header (00 01: plain CDR, little endian), then the fields
in order, each aligned to its own size counted from behind the header; a text is its length with
the closing zero (uint32), the bytes and the zero. Source: OMG DDSI-RTPS 2.5, 10.2; XCDR1.
"""

import struct
from itertools import count
from types import SimpleNamespace

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.byte_views import byte_rows, every_byte
from rosette_ros.data.labels import Labels
from rosette_ros.data.ros2msg import MAX_DEPTH, PRIMITIVES

MAX_FIELDS = 1000
"""Messages with more fields are not read in bulk."""
HEADER = b'\x00\x01\x00\x00'

_DTYPES = {
    'bool': '?', 'byte': 'u1', 'char': 'u1', 'int8': 'i1', 'uint8': 'u1', 'int16': '<i2',
    'uint16': '<u2', 'int32': '<i4', 'uint32': '<u4', 'int64': '<i8', 'uint64': '<u8',
    'float32': '<f4', 'float64': '<f8'}
_GROUPS = 32  # different lengths of messages that are read group by group
_PEELED = 8  # different texts of one length that are looked for before sorting


# one message ---------------------------------------------------------------------------------


def decode_message(schema, data):
    """Return one message as a SimpleNamespace of its fields, nested as they are.

    Sequences of numbers are arrays, other sequences lists. Raises InvalidData where the bytes end
    early or are no little-endian CDR.
    """
    if len(data) < 4 or data[0] != 0 or data[1] != 1:
        raise InvalidData(f'{schema.name}: wanted little-endian CDR (00 01), got '
                          f'{bytes(data[:2]).hex(" ") or "nothing"}')
    return _Cursor(schema, bytes(data[4:])).message(schema.name)


class _Cursor:
    """A place in the bytes behind the encapsulation header."""

    def __init__(self, schema, data):
        self.schema, self.data, self.at = schema, data, 0
        self.values_left = MAX_DEPTH * (len(data) + 1)  # those of no bytes shall not be without end

    def message(self, type_name):
        fields = self.schema.types[type_name]
        self.values_left -= 1
        if self.values_left < 0:
            raise self.early()
        if not fields:
            self.take(1, 1)  # an empty structure has one byte on the wire
        return SimpleNamespace(**{field.name: self.field(field) for field in fields})

    def field(self, field):
        if field.length is None:
            return self.value(field.type_name)
        count = field.length if field.length >= 0 else self.number('uint32')
        if field.type_name in _DTYPES:
            return self.numbers(field.type_name, count)
        if count > len(self.data) - self.at:
            raise self.early()
        return [self.value(field.type_name) for _ in range(count)]

    def value(self, type_name):
        if type_name == 'string':
            return self.text()
        if type_name in _DTYPES:
            return self.number(type_name)
        if type_name == 'wstring':
            raise InvalidData(f'{self.schema.name}: wide texts (wstring) cannot be read')
        return self.message(type_name)

    def number(self, type_name):
        return self.numbers(type_name, 1)[0].item()

    def numbers(self, type_name, count):
        if not count:
            return np.zeros(0, dtype=_DTYPES[type_name])
        size = PRIMITIVES[type_name]
        start = self.take(size, size * count)
        return np.frombuffer(self.data, _DTYPES[type_name], count, start).copy()

    def text(self):
        length = self.number('uint32')
        start = self.take(1, length)
        return _text(self.data[start:start + length])

    def take(self, alignment, size):
        start = -(-self.at // alignment) * alignment
        if start + size > len(self.data):
            raise self.early()
        self.at = start + size
        return start

    def early(self):
        return InvalidData(f'{self.schema.name}: the message ends early, after '
                           f'{len(self.data) + 4} bytes')


def _text(data):
    return bytes(data).rstrip(b'\0').decode('utf-8', errors='replace')


# many messages -------------------------------------------------------------------------------


def decode_columns(schema, buffer, start, end, wanted):
    """Return fields of N messages as arrays, without an object per message.

    buffer: (B,) uint8; start, end: (N,) where each message stands in it, encapsulation header
    included; wanted: names such as `header.stamp.sec`. The result maps each to an array (N,), or
    to Labels where it is a text.

    Raises InvalidData where the schema lacks a field, or bytes end early or are no CDR.
    """
    fields = _flat(schema)
    missing = [name for name in wanted if name not in fields]
    if missing:
        raise InvalidData(f'{schema.name}: wanted the field {missing[0]}, the log has '
                          f'{", ".join(fields)}; it was written with another version of the '
                          'message')
    length = end - start
    sizes = np.unique(length)
    if 0 < sizes.size <= _GROUPS:
        # Messages of one length mostly have one layout: copied into rows they are read quickest.
        groups = [np.flatnonzero(length == size) for size in sizes]
        tables = [_read(schema, fields, _packed(buffer, start[rows], int(size)), wanted, rows)
                  for rows, size in zip(groups, sizes, strict=True)]
        return _merged(tables, groups, wanted)
    return _read(schema, fields, (buffer, start, end), wanted, np.arange(start.size))


def _read(schema, fields, place, wanted, rows):
    """Return the wanted columns of messages; rows: their numbers, for errors."""
    table = _Table(schema.name, *place, rows)
    columns, left = {}, set(wanted)
    for name, field in fields.items():
        if not left:
            break
        column = table.column(field, name in left)
        if name in left:
            columns[name] = column
            left.remove(name)
    return columns


def _packed(buffer, start, size):
    """Return (buffer, start, end) of messages of one size, copied next to each other."""
    at = np.arange(start.size) * size
    return byte_rows(buffer, start, size).reshape(-1), at, at + size


def _merged(tables, groups, wanted):
    """Return the columns of several groups of rows in the order of the rows."""
    if len(tables) == 1:
        return tables[0]
    order = np.argsort(np.concatenate(groups))
    merged = {}
    for name in wanted:
        parts = [table[name] for table in tables]
        merged[name] = (Labels.concatenate(parts).take(order) if isinstance(parts[0], Labels)
                        else np.concatenate(parts)[order])
    return merged


def _flat(schema):
    """Return all fields by dotted name; what cannot be flattened keeps its own name."""
    flat, seen = {}, count()

    def add(prefix, type_name):
        for field in schema.types[type_name]:
            name = prefix + field.name
            if next(seen) > MAX_FIELDS:
                raise InvalidData(f'{schema.name}: has more than {MAX_FIELDS} fields')
            if field.type_name in PRIMITIVES or field.length is not None:
                flat[name] = field
            else:
                add(name + '.', field.type_name)

    add('', schema.name)
    return flat


class _Table:
    """N messages and the place in each up to which they are read.

    The place `at` is one number as long as it is the same in all messages.
    """

    def __init__(self, name, buffer, start, end, rows):
        self.name, self.buffer, self.rows = name, buffer, rows
        size = buffer.size // start.size if start.size else 0
        regular = np.array_equal(start, np.arange(start.size) * size)
        self.packed = buffer.reshape(-1, size) if size and regular else None
        self.end, self.origin, self.at = end, start + 4, 0
        self.require(0)
        plain = (buffer[start] == 0) & (buffer[start + 1] == 1)
        if not plain.all():
            row = int(np.argmin(plain))
            got = bytes(buffer[start[row]:start[row] + 2]).hex(' ')
            raise InvalidData(f'{self.name}: message {self.rows[row] + 1}: wanted little-endian '
                              f'CDR (00 01), got {got}')

    def column(self, field, wanted):
        """Step over one field; return its values where they are wanted."""
        if field.type_name == 'string' and field.length is None:
            return self.texts(wanted)
        if field.type_name not in _DTYPES:
            raise InvalidData(f'{self.name}: {field.name}: sequences of texts or messages cannot '
                              'be read in bulk')
        if wanted and field.length is not None:
            raise InvalidData(f'{self.name}: {field.name}: wanted one value, the log has an array of them')
        count = 1
        if field.length is not None:
            count = field.length if field.length >= 0 else self.numbers('uint32', True).astype(np.int64)
        size = PRIMITIVES[field.type_name]
        if field.length is None:
            return self.numbers(field.type_name, wanted)
        self.align(size, count)
        self.step(size * count)
        return None

    def numbers(self, type_name, wanted):
        size = PRIMITIVES[type_name]
        self.align(size)
        self.require(size)
        values = self.gather(_DTYPES[type_name], size) if wanted else None
        self.at = self.at + size
        return values

    def texts(self, wanted):
        length = self.numbers('uint32', True).astype(np.int64)
        if length.size and (length == length[0]).all():
            length = int(length[0])
        self.require(length)
        labels = self.labels(length) if wanted else None
        self.at = self.at + length
        return labels

    def align(self, size, count=1):
        aligned = (self.at + size - 1) & -size
        self.at = aligned if np.isscalar(count) else np.where(count > 0, aligned, self.at)

    def step(self, size):
        self.require(size)
        self.at = self.at + size

    def require(self, size):
        if self.packed is not None and np.isscalar(self.at + size) \
                and 4 + self.at + size <= self.packed.shape[1]:
            return
        early = self.origin + self.at + size > self.end
        if early.any():
            row = int(np.argmax(early))
            raise InvalidData(f'{self.name}: message {self.rows[row] + 1} ends early, after '
                              f'{int(self.end[row] - self.origin[row]) + 4} bytes')

    def gather(self, dtype, size):
        if self.packed is not None and np.isscalar(self.at):
            rows, stride = self.packed.shape
            return np.ndarray((rows,), dtype, self.buffer, 4 + self.at, (stride,)).copy()
        return every_byte(self.buffer, dtype)[self.origin + self.at]

    def slice(self, size):
        """Return the next bytes of messages that have them at the same place, (N, size)."""
        return self.packed[:, 4 + self.at:4 + self.at + size]

    def labels(self, length):
        """Return the Labels of texts of the given length, or lengths (N,), at this place."""
        if np.isscalar(length) and self.packed is not None and np.isscalar(self.at):
            parts = [(np.arange(len(self.packed)), self.slice(length))]
        else:
            place = np.broadcast_to(self.origin + self.at, self.origin.shape)
            length = np.broadcast_to(length, place.shape)
            groups = [np.flatnonzero(length == size) for size in np.unique(length)]
            parts = [(rows, byte_rows(self.buffer, place[rows], int(length[rows[0]])))
                     for rows in groups]
        known, code = {}, np.zeros(self.origin.size, dtype=np.int64)
        for rows, texts in parts:
            for text, members in _distinct(texts):
                name = _text(text.tobytes())
                code[rows[members]] = known.setdefault(name, len(known))
        return Labels(tuple(known), code)


def _distinct(rows):
    """Yield each different row of (M, size) with the positions that have it."""
    left = np.arange(len(rows))
    if left.size and (rows == rows[0]).all():
        yield rows[0], left
        return
    for _ in range(_PEELED):
        if not left.size:
            return
        same = (rows[left] == rows[left[0]]).all(axis=1)
        yield rows[left[0]], left[same]
        left = left[~same]
    if left.size:
        values, inverse = np.unique(rows[left], axis=0, return_inverse=True)
        order = np.argsort(inverse.ravel(), kind='stable')
        parts = np.split(left[order], np.cumsum(np.bincount(inverse.ravel()))[:-1])
        yield from zip(values, parts, strict=True)


# arrays into messages ------------------------------------------------------------------------


def encode_columns(schema, columns, count):
    """Return `count` messages as bytes, (count, L) uint8: all have the same length.

    columns: by dotted name an array (count,), one number, or one text for all; what is not given
    is zero or empty. Only single values can be written.
    """
    pieces, at = [], 0
    for name, field in _flat(schema).items():
        if field.length is not None:
            raise InvalidData(f'{schema.name}: {name}: sequences cannot be written in bulk')
        if field.type_name == 'string':
            text = str(columns.get(name, '')).encode() + b'\0'
            at = -(-at // 4) * 4
            pieces.append((at, np.frombuffer(struct.pack('<I', len(text)) + text, np.uint8)))
            at += 4 + len(text)
            continue
        size = PRIMITIVES[field.type_name]
        at = -(-at // size) * size
        values = np.broadcast_to(np.asarray(columns.get(name, 0)), count)
        values = np.ascontiguousarray(values, dtype=_DTYPES[field.type_name])
        pieces.append((at, values.view(np.uint8).reshape(count, size)))
        at += size
    out = np.zeros((count, at + 4), dtype=np.uint8)
    out[:, :4] = np.frombuffer(HEADER, np.uint8)
    for place, piece in pieces:
        out[:, 4 + place:4 + place + piece.shape[-1]] = piece
    return out
