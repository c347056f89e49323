# SPDX-License-Identifier: Apache-2.0
"""A small real log, and its records: taken apart and put together again."""

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
from rclpy.serialization import serialize_message
from rosette_msgs.msg import BallCentre, CalibrationEvent, ErrorMotions, ProbeTarget, RunState, Touches
from std_msgs.msg import Header

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.core.run.geometry import Frame, nominal_angles, rotation_matrix
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.run.touches import touch_directions
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.messages import Phase
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes import conversions

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, METADATA = 1, 2, 3, 4, 5, 6, 7, 12
LIBRARY = TypeLibrary(
    [prefix for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix] if prefix]
)
RUN_ID = 'run'
BALLS, RADIUS = 3, 0.1
FRAME = Frame(rotation_matrix(np.array([0.01, -0.02, 0.3])), np.array([0.35, 0.26, -0.3]))
TOPICS = {
    'probe_target': ProbeTarget, 'ball_centre': BallCentre, 'touches': Touches, 'run_state': RunState,
    'error_motions': ErrorMotions, 'calibration_event': CalibrationEvent, 'tf_static': None,
}
TYPES = {'tf_static': 'tf2_msgs/msg/TFMessage'}
U4, U8 = struct.Struct('<I'), struct.Struct('<Q')
_RECORD, _CHUNK_HEAD = struct.Struct('<BQ'), struct.Struct('<QQQI')


def calibration():
    """Return the messages of a small calibration as (topic, message, stamp in ns), in their order."""
    planned = plan_calibration(plan(BALLS, 'diagonal'), RADIUS, FRAME, repeats=2)
    said = [
        ('run_state', RunState(text='ready'), 0),
        ('calibration_event', CalibrationEvent(run_id=RUN_ID, kind=2, origin='calibrate'), 0),
    ]
    phase, rng = Phase.IDLE, np.random.default_rng(1)
    for index in range(planned.total):
        target, stamp = planned.target(index), 20_000_000_000 * (index + 1)
        if target.phase is Phase.RUN and phase is not Phase.RUN:
            said.append(
                ('tf_static',
                 conversions.frame_message(FRAME, 'machine', 'table', conversions.time_message(stamp)), stamp)
            )
        if target.phase is not phase:
            phase = target.phase
            said.append(
                (
                    'run_state',
                    RunState(
                        header=Header(stamp=conversions.time_message(stamp)), run_id=RUN_ID, phase=int(phase),
                        order='diagonal', done=index, total=planned.total, text='on',
                    ),
                    stamp,
                )
            )
        centre = FRAME.to_outer(target.centre + 1e-6 * rng.standard_normal(3))
        common = {name: getattr(target, name) for name in (
            'seq', 'table_position', 'ball', 'cmm_position', 'table_angle')}
        i, j, k = touch_directions(2, 3, 0.8, -0.1).T
        said.append(
            ('touches',
             Touches(
                 header=Header(stamp=conversions.time_message(stamp + 10_000_000_000), frame_id='machine'),
                 run_id=RUN_ID, tip_radius=1e-3, x=centre[0] + 1e-2 * i, y=centre[1] + 1e-2 * j,
                 z=centre[2] + 1e-2 * k, i=i, j=j, k=k, time=np.arange(6.0), **common),
             stamp + 10_000_000_000)
        )
        said.append(
            (
                'probe_target',
                conversions.target_message(
                    target._replace(run_id=RUN_ID, attempt=1, session=1, centre=centre, frame_id='machine'),
                    conversions.time_message(stamp),
                ),
                stamp,
            )
        )
        said.append(
            (
                'ball_centre',
                BallCentre(
                    header=Header(stamp=conversions.time_message(stamp + 10_000_000_000), frame_id='machine'),
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
        content += text(self.compression) + U8.pack(len(packed) if self.packed is None else self.packed) + packed
        return Record(CHUNK, content, self.length).dump()

    def index(self):
        """Return the bytes of the message indexes that fit its records."""
        found, at = {}, 0
        for record in self.records:
            if isinstance(record, Record) and record.opcode == MESSAGE and len(record.content) >= 22:
                found.setdefault(record.content[:2], []).append(record.content[6:14] + U8.pack(at))
            at += len(record.dump())
        return b''.join(
            Record(MESSAGE_INDEX, channel + U4.pack(16 * len(pairs)) + b''.join(pairs)).dump()
            for channel, pairs in found.items()
        )


def text(words):
    """Return a text as MCAP writes it."""
    data = words if isinstance(words, bytes) else words.encode('utf-8', 'surrogatepass')
    return U4.pack(len(data)) + data


def mapping(pairs):
    """Return a mapping as MCAP writes it."""
    content = b''.join(text(key) + text(value) for key, value in pairs.items())
    return U4.pack(len(content)) + content


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
