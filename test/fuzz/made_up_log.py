# SPDX-License-Identifier: Apache-2.0
"""A small real log, its records, and changes to them: lengths, checksums, schemas, messages, order."""

import os
import struct
import sys
import tempfile
import zlib
from copy import copy
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from geometry_msgs.msg import Point
from hypothesis import strategies as st
from made_up import TRICKS, WORDS, dumped, mutated, trees
from rclpy.serialization import serialize_message
from rosette_msgs.msg import BallCentre, CalibrationEvent, ErrorMotions, ProbeTarget, RunState
from std_msgs.msg import Header

from rosette_ros.core.geometry import Frame, nominal_angles, rotation_matrix
from rosette_ros.core.scheme import plan
from rosette_ros.data.bag_metadata import Qos
from rosette_ros.data.log_writer import LogWriter
from rosette_ros.data.schemas import TypeLibrary
from rosette_ros.nodes import convert
from rosette_ros.nodes.programme import Phase, make_programme

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, METADATA = 1, 2, 3, 4, 5, 6, 7, 12
LIBRARY = TypeLibrary(
    [prefix for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix] if prefix]
)
RUN_ID = 'run'
BALLS, RADIUS = 3, 0.1
FRAME = Frame(rotation_matrix(np.array([0.01, -0.02, 0.3])), np.array([0.35, 0.26, -0.3]))
TOPICS = {
    'probe_target': ProbeTarget,
    'ball_centre': BallCentre,
    'run_state': RunState,
    'error_motions': ErrorMotions,
    'calibration_event': CalibrationEvent,
    'tf_static': None,
}
TYPES = {'tf_static': 'tf2_msgs/msg/TFMessage'}
_U4, _U8 = struct.Struct('<I'), struct.Struct('<Q')
_RECORD, _CHUNK_HEAD = struct.Struct('<BQ'), struct.Struct('<QQQI')


def calibration():
    """Return the messages of a small calibration as (topic, message, stamp in ns), in their order."""
    programme = make_programme(plan(BALLS, 'diagonal'), RADIUS, FRAME, repeats=2)
    said = [
        ('run_state', RunState(text='ready'), 0),
        ('calibration_event', CalibrationEvent(run_id=RUN_ID, kind=2, origin='calibrate'), 0),
    ]
    phase, rng = Phase.IDLE, np.random.default_rng(1)
    for index in range(programme.total):
        target, stamp = programme.target(index), 20_000_000_000 * (index + 1)
        if target.phase is Phase.RUN and phase is not Phase.RUN:
            said.append(
                ('tf_static', convert.frame_message(FRAME, 'machine', 'table', convert.time_message(stamp)), stamp)
            )
        if target.phase is not phase:
            phase = target.phase
            said.append(
                (
                    'run_state',
                    convert.state_message(
                        phase, RUN_ID, 'diagonal', index, programme.total, 'on', convert.time_message(stamp)
                    ),
                    stamp,
                )
            )
        centre = FRAME.to_outer(target.nominal + 1e-6 * rng.standard_normal(3))
        said.append(
            (
                'probe_target',
                convert.target_message(target, RUN_ID, 1, 1, centre, 'machine', convert.time_message(stamp)),
                stamp,
            )
        )
        said.append(
            (
                'ball_centre',
                BallCentre(
                    header=Header(stamp=convert.time_message(stamp + 10_000_000_000), frame_id='machine'),
                    run_id=RUN_ID,
                    seq=target.seq,
                    table_position=target.table_position,
                    ball=target.ball,
                    cmm_position=target.cmm_position,
                    table_angle=target.table_angle,
                    table_travel=float(index),
                    approach=target.approach,
                    centre=Point(**dict(zip('xyz', centre.tolist(), strict=True))),
                    temperature=20.0,
                ),
                stamp + 10_000_000_000,
            )
        )
    curves = {f'{u}{name}': [1e-6] * BALLS for u in ('', 'u_') for name in ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')}
    said.append(
        (
            'error_motions',
            ErrorMotions(
                run_id=RUN_ID,
                balls=BALLS,
                radius=RADIUS,
                model_name='base',
                angle=nominal_angles(BALLS).tolist(),
                **curves,
            ),
            stamp,
        )
    )
    said.append(('run_state', RunState(run_id=RUN_ID, phase=6, order='diagonal', text='done'), stamp))
    return said


def write_log(directory, name='log', **options):
    """Write the calibration as a log directory and return its path."""
    with LogWriter(directory, name, custom_data={'rosette.note': 'a', 'b': 'c'}, **options) as writer:
        for topic, kind in TOPICS.items():
            type_name = TYPES.get(topic) or f'rosette_msgs/msg/{kind.__name__}'
            writer.add_topic(f'/{topic}', LIBRARY.definition(type_name), [Qos(durability='transient_local')])
        for topic, message, stamp in calibration():
            writer.write(f'/{topic}', serialize_message(message), stamp, stamp)
    return directory


@dataclass
class Record:
    """A record of a file; length: as it is declared, None: the right one."""

    opcode: int
    content: bytes
    length: int | None = None

    def dump(self):
        """Return its bytes."""
        length = len(self.content) if self.length is None else self.length
        return _RECORD.pack(self.opcode, length) + self.content


@dataclass
class Chunk:
    """A chunk and the records in it; size, crc, packed: as they are declared, None: the right ones."""

    head: tuple
    compression: str
    records: list
    size: int | None = None
    crc: int | None = None
    packed: int | None = None
    length: int | None = None
    opcode: int = CHUNK

    def dump(self):
        """Return its bytes."""
        data = b''.join(record.dump() for record in self.records)
        packed = {'lz4': lz4.frame.compress, 'zstd': zstandard.compress}.get(self.compression, bytes)(data)
        content = _CHUNK_HEAD.pack(
            *self.head,
            len(data) if self.size is None else self.size,
            zlib.crc32(data) if self.crc is None else self.crc,
        )
        content += text(self.compression) + _U8.pack(len(packed) if self.packed is None else self.packed) + packed
        return Record(CHUNK, content, self.length).dump()

    def index(self):
        """Return the bytes of the message indexes that fit its records."""
        found, at = {}, 0
        for record in self.records:
            if isinstance(record, Record) and record.opcode == MESSAGE and len(record.content) >= 22:
                found.setdefault(record.content[:2], []).append(record.content[6:14] + _U8.pack(at))
            at += len(record.dump())
        return b''.join(
            Record(MESSAGE_INDEX, channel + _U4.pack(16 * len(pairs)) + b''.join(pairs)).dump()
            for channel, pairs in found.items()
        )


def text(words):
    """Return a text as MCAP writes it."""
    data = words if isinstance(words, bytes) else words.encode('utf-8', 'surrogatepass')
    return _U4.pack(len(data)) + data


def mapping(pairs):
    """Return a mapping as MCAP writes it."""
    content = b''.join(text(key) + text(value) for key, value in pairs.items())
    return _U4.pack(len(content)) + content


def records_in(data, at=0):
    """Return the records of bytes that are whole."""
    found = []
    while at + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size + length
        found.append(Record(opcode, data[at - length : at]))
    return found


def parsed(data):
    """Return the records and Chunks of a whole file, without its magic bytes."""
    found = []
    for record in records_in(data[: -len(MAGIC)], len(MAGIC)):
        if record.opcode != CHUNK:
            found.append(record)
            continue
        start, end, _, _ = _CHUNK_HEAD.unpack_from(record.content)
        fields = Fields(record.content, _CHUNK_HEAD.size)
        compression, packed = fields.text().decode(), record.content[fields.at + 8 :]
        plain = {'lz4': lz4.frame.decompress, 'zstd': zstandard.decompress}.get(compression, bytes)(packed)
        found.append(Chunk((start, end), compression, records_in(plain)))
    return found


def unparsed(records, reindex=True):
    """Return the bytes of a file; reindex: whether the message indexes fit what is in the chunks."""
    parts = [MAGIC]
    for record in records:
        if isinstance(record, Chunk):
            parts += [record.dump(), record.index() if reindex else b'']
        elif not (reindex and record.opcode == MESSAGE_INDEX):
            parts.append(record.dump())
    return b''.join([*parts, MAGIC])


class Fields:
    """The content of a record, field by field."""

    def __init__(self, content, at=0):
        """Stand at a place."""
        self.content, self.at = content, at

    def number(self, form):
        """Return the next number."""
        (value,) = struct.unpack_from(form, self.content, self.at)
        self.at += struct.calcsize(form)
        return value

    def text(self):
        """Return the next text, bytes."""
        length = self.number('<I')
        self.at += length
        return self.content[self.at - length : self.at]

    def mapping(self):
        """Return the next mapping, bytes to bytes."""
        end, pairs = self.number('<I') + self.at, {}
        while self.at < end:
            key = self.text()
            pairs[key] = self.text()
        return pairs


@cache
def small_log(compression='none', chunk_size=2500):
    """Return the bytes of a small log."""
    with tempfile.TemporaryDirectory() as folder:
        write_log(Path(folder), compression=compression, chunk_size=chunk_size, flush_interval=1e9)
        return Path(folder, 'log_0.mcap').read_bytes()


def loose(records):
    """Return records without chunks: what stood in them stands by itself."""
    return [
        copy(inner)
        for record in records
        if record.opcode != MESSAGE_INDEX
        for inner in (record.records if isinstance(record, Chunk) else [record])
    ]


# Changes -----------------------------------------------------------------------------------------

LENGTHS = st.one_of(
    st.sampled_from([0, 1, 8, 21, 22, 2**31 - 1, 2**31, 2**32, 2**40, 2**60, 2**63 - 1, 2**63, 2**64 - 1]),
    st.integers(0, 300),
    st.integers(0, 2**64 - 1),
)
TEXTS = st.one_of(
    WORDS,
    st.binary(max_size=6),
    st.sampled_from(
        [
            '/ball_centre',
            '/tf_static',
            '/probe_target',
            '/run_state',
            'rosette_msgs/msg/BallCentre',
            'tf2_msgs/msg/TFMessage',
            'rosette_msgs/msg/ProbeTarget',
            'rosette_msgs/msg/RunState',
            'rosette_msgs/msg/ErrorMotions',
            'cdr',
            'ros2msg',
            'ros2idl',
            'json',
            '/',
            'a/b/c/d',
            'x' * 300,
        ]
    ),
)
KINDS = [
    'bool',
    'byte',
    'char',
    'int8',
    'uint8',
    'int16',
    'uint16',
    'int32',
    'uint32',
    'int64',
    'uint64',
    'float32',
    'float64',
    'string',
    'wstring',
    'string<=3',
    'std_msgs/Header',
    'Header',
    'geometry_msgs/Point',
    'X',
    'nowhere/X',
]
LINES = st.one_of(
    WORDS,
    TRICKS,
    st.builds(
        '{}{} {}{}'.format,
        st.sampled_from(KINDS),
        st.sampled_from(
            [
                '',
                '',
                '[]',
                '[3]',
                '[0]',
                '[<=3]',
                '[1000000000]',
                '[' + '9' * 30 + ']',
                '[' + '9' * 5000 + ']',
                '[',
                '[-1]',
            ]
        ),
        st.sampled_from(['x', 'seq', 'run_id', 'header', 'status', '9x', 'x=3', 'x "y"', '']),
        st.sampled_from(['', ' # x', '=1', ' 5']),
    ),
    st.sampled_from(
        [
            '=' * 80,
            '===',
            'MSG: std_msgs/Header',
            'MSG: rosette_msgs/BallCentre',
            'MSG: a/X',
            'X x',
            'X[100] x',
            'MSG: ',
            '=' * 80 + '\nMSG: rosette_msgs/X\nX x',
            '=' * 80 + '\nMSG: rosette_msgs/X\nfloat64[0] x',
        ]
    ),
)
QOS = trees(
    st.sampled_from(
        [
            'history',
            'depth',
            'reliability',
            'durability',
            'deadline',
            'sec',
            'nsec',
            'lifespan',
            'liveliness',
            'liveliness_lease_duration',
            'avoid_ros_namespace_conventions',
        ]
    )
)
BAG = trees(
    st.sampled_from(
        [
            'version',
            'storage_identifier',
            'relative_file_paths',
            'custom_data',
            'message_count',
            'files',
            'rosbag2_bagfile_information',
            'rosette.repeatability_m',
            'rosette.repeated_balls',
        ]
    )
)
YAMLS = st.one_of(
    TRICKS,
    QOS.map(dumped),
    BAG.map(dumped),
    BAG.map(lambda tree: dumped({'custom_data': tree})),
    WORDS,
    st.builds('custom_data: {{rosette.repeatability_m: {!r}}}'.format, WORDS),
    TRICKS.map(lambda trick: f'custom_data:\n {trick}'),
)


@st.composite
def changed_schema(draw, content):
    """Return a schema record with another number, name, encoding or text."""
    fields = Fields(content)
    parts = [fields.number('<H'), fields.text(), fields.text(), fields.text()]
    part = draw(st.sampled_from([0, 1, 2, 3, 3, 3, 3]))
    if part == 0:
        parts[0] = draw(st.integers(0, 8))
    elif part < 3:
        parts[part] = draw(TEXTS)
    else:
        lines = [line for line in parts[3].decode().split('\n') if line.strip() and line[0] != '#'] or ['']
        for _ in range(draw(st.integers(1, 3))):
            at, how = (
                draw(st.integers(0, len(lines) - 1)),
                draw(st.sampled_from(['line', 'kind', 'kind', 'kind', 'drop', 'twice', 'swap', 'end'])),
            )
            words = lines[at].split(' ', 1)
            if how == 'kind' and len(words) == 2:
                lines[at] = (
                    f'{draw(st.sampled_from(KINDS))}{draw(st.sampled_from(["", "", "[]", "[2]", "[0]"]))} {words[1]}'
                )
            elif how == 'drop':
                del lines[at]
            elif how == 'twice':
                lines.insert(draw(st.integers(0, len(lines))), lines[at])
            elif how == 'swap':
                other = draw(st.integers(0, len(lines) - 1))
                lines[at], lines[other] = lines[other], lines[at]
            elif how == 'end':
                lines.append(draw(LINES))
            else:
                lines[at] = draw(LINES)
            lines = lines or ['']
        parts[3] = '\n'.join(lines)
    return struct.pack('<H', parts[0]) + b''.join(map(text, parts[1:]))


@st.composite
def changed_channel(draw, content):
    """Return a channel record with another number, schema, topic, encoding or metadata."""
    fields = Fields(content)
    parts = [fields.number('<H'), fields.number('<H'), fields.text(), fields.text(), fields.mapping()]
    part = draw(st.sampled_from([0, 1, 2, 3, 4, 4]))
    if part < 2:
        parts[part] = draw(st.one_of(st.integers(0, 8), st.just(65535)))
    elif part < 4:
        parts[part] = draw(TEXTS)
    else:
        key = draw(st.one_of(st.sampled_from([b'offered_qos_profiles', b'topic_type_hash']), TEXTS))
        parts[4] = {**parts[4], key: draw(YAMLS)}
    return struct.pack('<HH', *parts[:2]) + text(parts[2]) + text(parts[3]) + mapping(parts[4])


EXTREME = st.one_of(
    st.sampled_from(
        [_U4.pack(0), _U4.pack(1), _U4.pack(2**31), _U4.pack(2**32 - 1), _U4.pack(10_000), _U4.pack(10_001)]
    ),
    st.floats().map(lambda value: struct.pack('<d', value)),
    st.sampled_from([0.0, -0.0, 1e308, -1e308, 5e-324, float('nan'), float('inf'), float('-inf')]).map(
        lambda value: struct.pack('<d', value)
    ),
    st.integers(0, 255).map(lambda value: bytes([value])),
    st.binary(min_size=1, max_size=8),
)


@st.composite
def changed_message(draw, content):
    """Return a message record with another channel, number, time, or other data."""
    part = draw(st.sampled_from(['channel', 'sequence', 'time', 'data', 'data', 'data', 'data', 'cut', 'more']))
    if part == 'channel':
        return struct.pack('<H', draw(st.one_of(st.integers(0, 8), st.just(65535)))) + content[2:]
    if part == 'sequence':
        return content[:2] + _U4.pack(draw(st.integers(0, 2**32 - 1))) + content[6:]
    if part == 'time':
        return content[:6] + _U8.pack(draw(LENGTHS)) + content[14:]
    if part == 'cut':
        return content[: draw(st.integers(0, len(content)))]
    if part == 'more':
        return content + draw(st.binary(max_size=9))
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        new = draw(EXTREME)
        at = 22 + 4 + len(new) * draw(st.integers(0, max((len(content) - 26) // len(new) - 1, 0)))
        at = draw(st.sampled_from([at, 22])) if draw(st.integers(0, 9)) == 0 else at
        changed[at : at + len(new)] = new
    return bytes(changed)


@st.composite
def changed_metadata(draw, content):
    """Return a metadata record with another name or mapping."""
    name = draw(st.sampled_from([b'rosbag2', b'rosbag2', b'rosette.repeated', b'x']))
    if name == b'rosette.repeated':
        return text(name) + mapping({draw(TEXTS): draw(st.one_of(WORDS, st.just('0 1 2'), st.just('9' * 5000)))})
    return text(name) + mapping({draw(st.sampled_from([b'serialized_metadata', b'x'])): draw(YAMLS)})


CHANGES = {SCHEMA: changed_schema, CHANNEL: changed_channel, MESSAGE: changed_message, METADATA: changed_metadata}


def _places(records):
    """Return where every record stands: (list that holds it, position)."""
    return [
        (home, at)
        for record in [None, *records]
        if record is None or isinstance(record, Chunk)
        for home in [records if record is None else record.records]
        for at in range(len(home))
    ]


@st.composite
def changed_records(draw, records, most=3):
    """Return records of which some are changed, doubled, moved, dropped, or tell a wrong length."""
    records = [copy(record) for record in records]
    for record in records:
        if isinstance(record, Chunk):
            record.records = [copy(inner) for inner in record.records]
    for _ in range(draw(st.integers(1, most))):
        places = _places(records)
        wanted = draw(
            st.sampled_from(
                [None, None, SCHEMA, SCHEMA, SCHEMA, CHANNEL, CHANNEL, MESSAGE, MESSAGE, MESSAGE, METADATA, CHUNK]
            )
        )
        some = [place for place in places if wanted in (None, place[0][place[1]].opcode)] or places
        home, at = some[draw(st.integers(0, len(some) - 1))]
        how = draw(st.sampled_from(['content'] * 14 + ['drop', 'twice', 'move', 'length', 'opcode', 'bytes']))
        _change(draw, records, home, at, how)
        if not records:
            break
    return records


def _change(draw, records, home, at, how):
    record = home[at]
    if how == 'drop':
        del home[at]
    elif how == 'twice':
        home.insert(draw(st.integers(0, len(home))), record)
    elif how == 'move':
        home.remove(record)
        others = [records] + [one.records for one in records if isinstance(one, Chunk) and one is not record]
        other = others[draw(st.integers(0, len(others) - 1))]
        other.insert(draw(st.integers(0, len(other))), record)
    elif how == 'length':
        record.length = draw(LENGTHS)
    elif isinstance(record, Chunk):
        what = draw(st.sampled_from(['size', 'crc', 'packed', 'compression']))
        if what == 'compression':
            record.compression = draw(st.one_of(st.sampled_from(['lz4', 'zstd', '', 'bz2']), st.text(max_size=4)))
        else:
            setattr(record, what, draw(st.integers(0, 2**32 - 1)) if what == 'crc' else draw(LENGTHS))
    elif how == 'opcode':
        record.opcode = draw(st.integers(0, 255))
    elif how == 'content' and record.opcode in CHANGES:
        try:
            record.content = draw(CHANGES[record.opcode](record.content))
        except (struct.error, UnicodeDecodeError):
            pass  # a change before has left nothing that can be taken apart
    else:
        record.content = draw(mutated(record.content))


@st.composite
def changed_logs(draw):
    """Return the bytes of a log that was changed: records, their order, and then perhaps bytes."""
    compression = draw(st.sampled_from(['none', 'lz4', 'zstd']))
    records = parsed(small_log(compression, draw(st.sampled_from([700, 2500, 100_000]))))
    if draw(st.integers(0, 4)) == 0:
        records = loose(records)
    how = draw(st.sampled_from(['records'] * 9 + ['bytes', 'both', 'cut']))
    if how != 'bytes':
        records = draw(changed_records(records))
    data = unparsed(records, draw(st.booleans()))
    if how == 'cut':
        return data[: draw(st.integers(0, len(data)))]
    return data if how == 'records' else draw(mutated(data))
