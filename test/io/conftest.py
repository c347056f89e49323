# SPDX-License-Identifier: Apache-2.0
"""A recorded cell for the tests of files: messages serialised by rosbags, not by us."""

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosette_ros.core.run.geometry import Frame, rotation_matrix
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.type_definitions import TypeDefinition, TypeLibrary

MESSAGES = Path(__file__).parents[2] / 'msg_defs' / 'msg'
BEGIN = 1_750_000_000 * 10**9  # ns, when the first message is logged
LATCHED = Qos(durability='transient_local')


@pytest.fixture(scope='session')
def store():
    """Return rosbags' own types of Jazzy with rosette_msgs read from the sources."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for path in sorted(MESSAGES.glob('*.msg')):
        types.update(get_types_from_msg(path.read_text(), f'rosette_msgs/msg/{path.stem}'))
    store.register(types)
    return store


@pytest.fixture(scope='session')
def define(store):
    """Return the maker of definitions: text and hash as rosbags makes them."""
    def define(type_name):
        text, _ = store.generate_msgdef(type_name, ros_version=2)
        return TypeDefinition(type_name, text, store.hash_rihs01(type_name))
    return define


@pytest.fixture(scope='session')
def library():
    """Return the definitions that are installed."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return TypeLibrary([prefix for prefix in [*prefixes, sys.prefix] if prefix])


@dataclass
class Cell:
    """The messages of one calibration in the order of receipt: (topic, type name, message)."""

    store: object
    define: object
    n: int
    run_id: str
    frame: Frame
    centre: np.ndarray  # (n*n, 3) of the run, table frame, as rounded by the machine frame
    sent: list = field(default_factory=list)

    def message(self, type_name, **fields):
        """Return a message of rosbags; nested names by two underscores, the rest zero."""
        return _build(self.store, type_name, fields)

    def answers(self):
        """Return the BallCentres sent."""
        return [message for topic, _, message in self.sent if topic.endswith('ball_centre')]

    def write(self, directory, name='log', log_times=None, writer=None, **options):
        """Write all messages as a log and return its directory."""
        with (writer or LogWriter)(directory, name, **options) as log:
            for topic in dict.fromkeys(topic for topic, _, _ in self.sent):
                type_name = next(kind for name, kind, _ in self.sent if name == topic)
                log.add_topic(topic, self.define(type_name), [LATCHED])
            for row, (topic, type_name, message) in enumerate(self.sent):
                time = BEGIN + 10**7 * row if log_times is None else log_times[row]
                data = bytes(self.store.serialize_cdr(message, type_name))
                log.write(topic, data, time, time - 1000)
        return directory


def _build(store, type_name, fields):
    kind = store.types[type_name]
    values = {}
    for name, description in store.fielddefs[type_name][1]:
        own = {key[len(name) + 2:]: value for key, value in fields.items()
               if key.startswith(name + '__')}
        if name in fields:
            values[name] = fields[name]
        elif description[0].name == 'NAME':
            values[name] = _build(store, description[1], own)
        elif description[0].name == 'BASE':
            values[name] = '' if description[1][0] == 'string' else 0
        else:
            values[name] = np.zeros(0)
    return kind(**values)


@pytest.fixture
def make_cell(store, define):
    """Return the maker of recorded cells.

    A cell asks for three repeated readings, one alignment reading, the n*n run and a drift check,
    answers in the machine frame, and latches the table frame before the run.
    """
    def make(n=4, run_id='first', seed=0, begin_s=1000.0, frame_id='machine'):
        rng = np.random.default_rng(seed)
        frame = Frame(rotation_matrix(0.1 * rng.standard_normal(3)), rng.uniform(0.1, 0.5, 3))
        scheme = plan(n, 'diagonal')
        centre = scheme.centres(0.18) + 1e-5 * rng.standard_normal((n * n, 3))
        cell = Cell(store, define, n, run_id, frame, centre)
        readings = [(1, 1, 1, cell.centre[0] + offset) for offset in 1e-6 * np.eye(3)]
        readings += [(2, 1, 1, cell.centre[0])]
        readings += [(3, int(i), int(j), point) for i, j, point
                     in zip(scheme.table_position, scheme.ball, centre, strict=True)]
        readings += [(4, 1, 1, cell.centre[0])]
        for seq, (phase, i, j, point) in enumerate(readings, 1):
            stamp = begin_s + 30.25 * seq + 1e-9 * seq
            if phase == 3 and readings[seq - 2][0] != 3:
                cell.sent.append(_transform(cell, stamp - 15))
            cell.sent += _reading(cell, seq, phase, i, j, point, stamp, frame_id)
        return cell
    return make


def _stamp(seconds):
    return {'header__stamp__sec': int(seconds),
            'header__stamp__nanosec': round((seconds - int(seconds)) * 1e9)}


def _transform(cell, stamp):
    x, y, z, w = cell.frame.quaternion()
    tx, ty, tz = cell.frame.origin
    transform = cell.message(
        'geometry_msgs/msg/TransformStamped', **_stamp(stamp), header__frame_id='machine',
        child_frame_id='table', transform__rotation__x=x, transform__rotation__y=y,
        transform__rotation__z=z, transform__rotation__w=w, transform__translation__x=tx,
        transform__translation__y=ty, transform__translation__z=tz)
    kind = 'tf2_msgs/msg/TFMessage'
    return '/tf_static', kind, cell.message(kind, transforms=[transform])


def _reading(cell, seq, phase, i, j, point, stamp, frame_id):
    common = {'header__frame_id': frame_id, 'run_id': cell.run_id, 'seq': seq,
              'table_position': i, 'ball': j, 'cmm_position': (i + j - 2) % cell.n + 1,
              'approach': 1}
    x, y, z = cell.frame.to_outer(point) if frame_id == 'machine' else point
    angle = 2 * np.pi * (i - 1) / cell.n
    kind = 'rosette_msgs/msg/ProbeTarget'
    yield '/rosette/probe_target', kind, cell.message(
        kind, **common, **_stamp(stamp - 10), attempt=1, phase=phase, balls=cell.n, radius=0.18,
        table_angle=angle)
    kind = 'rosette_msgs/msg/BallCentre'
    yield '/rosette/ball_centre', kind, cell.message(
        kind, **common, **_stamp(stamp), table_angle=angle + 1e-6, table_travel=0.5 * seq,
        centre__x=x, centre__y=y, centre__z=z, form_error=1e-7, temperature=20.0 + 0.001 * seq)


@pytest.fixture(scope='session')
def write_with_mcap():
    """Return the writer of a cell by the mcap library alone, as other recorders may."""
    return _write_with_mcap


def _write_with_mcap(path, cell, **options):
    """Write a cell by the mcap library alone, as other recorders may."""
    schemas, channels = {}, {}
    with open(path, 'wb') as stream:
        writer = Writer(stream, **options)
        writer.start(profile='ros2')
        for time, (topic, kind, message) in enumerate(cell.sent):
            if kind not in schemas:
                schemas[kind] = writer.register_schema(kind, 'ros2msg',
                                                       cell.define(kind).text.encode())
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, 'cdr', schemas[kind])
            data = bytes(cell.store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path
