# SPDX-License-Identifier: Apache-2.0
"""A log of several files, written by a session with the messages of a calibration: whole, killed, repaired."""

import functools
import os
import pickle
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import serialize_message
from rosette_msgs.msg import BallCentre, ErrorMotions, Model, ProbeTarget, RunState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from rosette_ros.analysis import analyse
from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.geometry import Frame, rotation_matrix
from rosette_ros.core.scheme import plan
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_repair import repair_log
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes import conversions, recorder
from rosette_ros.nodes.log_session import LOG, LogSession, Message, Retention

N, RADIUS, RUN_ID = 12, 0.18, 'run'
TOPICS = {'/rosette/probe_target': (ProbeTarget, Retention.NONE), '/rosette/ball_centre': (BallCentre, Retention.NONE),
          '/rosette/run_state': (RunState, Retention.NONE), '/rosette/error_motions': (ErrorMotions, Retention.NONE),
          '/rosette/model': (Model, Retention.LATCHED),
          '/tf_static': (TFMessage, Retention.LATCHED)}
STATE_TOPICS = ('/rosette/run_state', '/rosette/error_motions', '/rosette/model', '/tf_static')
FRAME = Frame(rotation_matrix(np.array([0.0, 0.1, 0.3])), np.array([0.3, 0.2, -0.3]))
BEGIN, STEP = 1_750_000_000, 30
"""When the run begins, and how long a ball takes, s."""


def type_of(message_class):
    return f'{message_class.__module__.split(".")[0]}/msg/{message_class.__name__}'


@functools.cache
def topics():
    """Return (name, definition, memory) of the topics of a cell."""
    library = TypeLibrary.from_environment(os.environ)
    return [(topic, library.definition(type_of(message_class)), memory)
            for topic, (message_class, memory) in TOPICS.items()]


def real_session(settings):
    """Return a LogSession that knows the topics of a cell."""
    session = LogSession(2.0, lambda topic: [Qos()], lambda: settings)
    for topic in topics():
        session.add_topic(*topic)
    return session


def centres():
    """Return the ball centres of the run in the table frame, (N*N, 3)."""
    return plan(N, 'diagonal').centres(RADIUS) + 1e-6 * np.random.default_rng(4).standard_normal((N * N, 3))


def calibration():
    """Yield (topic, message, time in s) of a calibration whose states change as it goes on."""
    scheme = plan(N, 'diagonal')
    yield '/rosette/model', Model(name='base'), 0
    yield '/tf_static', conversions.frame_message(FRAME, 'machine', 'table', Time(sec=BEGIN)), 0
    yield '/tf_static', conversions.frame_message(FRAME, 'world', 'machine', Time(sec=BEGIN)), 0
    for row, point in enumerate(centres()):
        time = STEP * (row + 1)
        stamp = Time(sec=BEGIN + time)
        common = {'header': Header(stamp=stamp, frame_id='machine'), 'run_id': RUN_ID, 'seq': row + 1,
                  'table_position': int(scheme.table_position[row]), 'ball': int(scheme.ball[row])}
        angle = 2 * np.pi * (common['table_position'] - 1) / N
        x, y, z = (float(value) for value in FRAME.to_outer(point))
        common['table_angle'] = angle
        yield '/rosette/probe_target', ProbeTarget(attempt=1, phase=3, balls=N, radius=RADIUS, **common), time
        yield '/rosette/ball_centre', BallCentre(centre=Point(x=x, y=y, z=z), **common), time
        yield '/rosette/run_state', RunState(run_id=RUN_ID, phase=3, order='diagonal', done=row + 1, total=N * N,
                                             header=Header(stamp=stamp)), time
        if row == N * N // 2:
            yield '/rosette/error_motions', ErrorMotions(run_id=RUN_ID), time
    yield '/rosette/run_state', RunState(run_id=RUN_ID, phase=6, order='diagonal', done=N * N, total=N * N,
                                         text='published'), time


@functools.cache
def messages():
    """Return the Messages of the calibration as the recorder hears them; their padding is never the same twice."""
    return [Message(topic, serialize_message(message), 10**9 * (BEGIN + time), 10**9 * (BEGIN + time) - 7, time)
            for topic, message, time in calibration()]


def record(directory, **settings):
    """Record the calibration as a log and return the session."""
    session = real_session(settings)
    session.open(directory, RUN_ID, 0.0, 1)
    for one in messages():
        session.take(one)
    session.close()
    return session


@dataclass(frozen=True)
class Read:
    """A message as the mcap library finds it."""

    topic: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def read_file(path, reader=make_reader):
    """Return the Reads of a file in its order; what is whole of one that ends in the middle."""
    found = []
    with open(path, 'rb') as stream:
        try:
            for _, channel, one in reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                found.append(Read(channel.topic, one.sequence, one.log_time, one.publish_time, one.data))
        except EndOfFile:
            assert reader is NonSeekingReader
    return found


def files_of(directory):
    return sorted(directory.glob('*.mcap'), key=lambda path: int(path.stem.rpartition('_')[2]))


SPLITS = {'by time': {'max_file_s': 20 * STEP}, 'by size': {'max_file_mb': 0.03}}
"""The size is a whole number where the recorder takes it as a parameter."""


@pytest.mark.parametrize('split', SPLITS)
@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_a_split_log_is_the_same_run(tmp_path, split, compression):
    """By the mcap library and by our reader: nothing lost, nothing counted twice, the same numbers."""
    session = record(tmp_path / 'split', compression=compression, **SPLITS[split])
    record(tmp_path / 'whole')
    files, sent = files_of(tmp_path / 'split'), messages()
    assert len(files) > 3
    found = [one for path in files for one in read_file(path)]
    once = {(one.topic, one.sequence): one for one in reversed(found)}
    assert len(once) == len(sent) == session.messages
    assert Counter((one.topic, one.data, one.publish_time) for one in once.values()) == Counter(
        (one.topic, one.data, one.publish_time) for one in sent)
    assert [(one.topic, one.data, one.log_time, one.publish_time) for one in iter_log(tmp_path / 'split')] == [
        (one.topic, one.data, one.log_time, one.publish_time) for one in sent]

    log, whole = read_log(tmp_path / 'split'), read_log(tmp_path / 'whole')
    assert log.problems == ()
    assert (log.messages, log.states, len(log.error_motions)) == (whole.messages, whole.states, 1)
    assert {topic.name: topic.messages for topic in log.topics} == Counter(one.topic for one in sent)
    run = log.to_run()
    assert np.abs(run.centre - centres()).max() < 1e-15  # rounding, there and back
    for name in ('centre', 'table_angle', 'time', 'table_position', 'ball'):
        assert getattr(run, name).tobytes() == getattr(whole.to_run(), name).tobytes()
    assert analyse(run).error_motions.values.tobytes() == analyse(whole.to_run()).error_motions.values.tobytes()


def test_each_file_of_a_split_log_begins_with_the_last_states(tmp_path):
    """Frames of all names, model, error motions, run state; no target: it would move a machine."""
    record(tmp_path / 'log', max_file_s=20 * STEP)
    files = files_of(tmp_path / 'log')
    last = {}
    for number, path in enumerate(files):
        with open(path, 'rb') as stream:
            decoded = [(channel.topic, one.publish_time, message) for _, channel, one, message in make_reader(
                stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(log_time_order=False)]
        keys = [_state(topic, message) for topic, _, message in decoded]
        head = dict(zip(keys[:len(last)], decoded, strict=False))
        if number:
            assert {key: (entry[1], repr(entry[2])) for key, entry in head.items()} == last
            assert keys[len(last)][0] == '/rosette/probe_target'
        last |= {key: (time, repr(message)) for key, (topic, time, message) in zip(keys, decoded, strict=True)
                 if topic in STATE_TOPICS}
        alone = read_log(path)
        assert np.allclose(alone.to_run().centre, centres()[[answer.seq - 1 for answer in alone.answers]], atol=1e-15)
    assert len(last) == 5


def _state(topic, message):
    return topic, message.transforms[0].child_frame_id if topic == '/tf_static' else ''


SCRIPT = '''
import pickle, sys, time
from pathlib import Path
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.nodes.log_session import LogSession
topics, messages = pickle.load(sys.stdin.buffer)
session = LogSession(2.0, lambda topic: [Qos()], lambda: {'max_file_s': 150, 'compression': sys.argv[2]})
for topic in topics:
    session.add_topic(*topic)
session.open(Path(sys.argv[1]), 'run', 0.0, 1)
for number, one in enumerate(messages):
    session.take(one)
    print(number + 1, flush=True)
    time.sleep(0.02)
'''


@pytest.fixture(scope='module', params=['none', 'zstd'])
def killed(request, tmp_path_factory):
    """Return a log of a recorder that was killed in its middle, and how many messages it must hold.

    85 were written; at 0.02 s each no more than 50 belong to the last second, which may be lost.
    """
    directory = tmp_path_factory.mktemp('killed') / 'log'
    child = subprocess.Popen([sys.executable, '-c', SCRIPT, str(directory), request.param],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    pickle.dump((topics(), messages()), child.stdin)
    child.stdin.flush()
    while int(child.stdout.readline()) < 85:
        pass
    child.send_signal(signal.SIGKILL)
    child.communicate()
    return directory, 85 - 50


def test_killed_in_a_split_log_the_files_before_are_whole(killed):
    """Only the last file has no end; the mcap library's stream reader and ours find the same in it."""
    directory, safe = killed
    files = files_of(directory)
    assert len(files) > 3
    with pytest.raises(McapError):
        read_file(files[-1])
    found = [one for path in files[:-1] for one in read_file(path)] + read_file(files[-1], NonSeekingReader)
    once = {(one.topic, one.sequence): one for one in reversed(found)}
    log = read_log(directory)
    assert log.truncated
    assert [problem.split(': ')[0] for problem in log.problems] == [str(files[-1])]
    assert log.messages == len(once) >= safe
    sent = messages()[:log.messages]
    assert {(one.topic, one.data) for one in once.values()} == {(one.topic, one.data) for one in sent}
    assert [(one.topic, one.data) for one in iter_log(directory)] == [(one.topic, one.data) for one in sent]


def test_a_killed_split_log_is_repaired_as_one(killed, tmp_path):
    """Every message once, in order, and whole by the mcap library."""
    directory, _ = killed
    before = read_log(directory)
    done = repair_log(directory, tmp_path / 'repaired')
    assert done.messages == before.messages
    after = read_log(done.directory)
    assert after.problems == ()
    assert [(one.topic, one.data) for one in iter_log(done.directory)] == [
        (one.topic, one.data) for one in messages()[:before.messages]]
    path, = files_of(done.directory)
    numbers = {}
    for one in read_file(path):
        numbers.setdefault(one.topic, []).append(one.sequence)
    for found in numbers.values():
        assert all(after == before + 1 for before, after in pairwise(found))
    assert after.to_run().centre.tobytes() == before.to_run().centre.tobytes()


def test_lost_metadata_of_a_split_log(tmp_path):
    """Files are read in the order of their numbers, the tenth after the ninth."""
    record(tmp_path / 'log', max_file_s=12 * STEP)
    assert len(files_of(tmp_path / 'log')) > 10
    (tmp_path / 'log' / 'metadata.yaml').unlink()
    assert [one.data for one in iter_log(tmp_path / 'log')] == [one.data for one in messages()]
    done = repair_log(tmp_path / 'log')
    assert [one.data for one in iter_log(done.directory)] == [one.data for one in messages()]


def test_frames_that_cannot_be_read_are_kept(tmp_path):
    """Whatever somebody latches, the recorder goes on, and a further file has it."""
    session = real_session({'max_file_s': 1})
    session.open(tmp_path / 'log', 'log', 0.0, 1)
    session.take(Message('/tf_static', b'\0\1\0\0\xff\xff\xff\xff', 1, 1, 0.0))
    session.take(Message('/rosette/model', serialize_message(Model()), 3 * 10**9, 1, 0.0))
    assert session.failure == ''
    session.close()
    assert session.messages == 2
    assert [one.topic for one in read_file(tmp_path / 'log' / 'log_1.mcap')] == ['/tf_static', '/rosette/model']


def test_settings_hold_from_the_next_log_on(tmp_path):
    """They are asked for when a log is opened; without any, a log is one file without compression."""
    settings = {}
    session = real_session(settings)
    for name, values in (('a', {}), ('b', {'max_file_s': 10 * STEP, 'compression': 'lz4'})):
        settings.update(values)
        session.open(tmp_path / name, name, 0.0, 1)
        for one in messages():
            session.take(one)
        session.close()
    assert len(files_of(tmp_path / 'a')) == 1
    assert len(files_of(tmp_path / 'b')) > 10
    for name, compression in (('a', ''), ('b', 'lz4')):
        with open(files_of(tmp_path / name)[0], 'rb') as stream:
            indexes = make_reader(stream).get_summary().chunk_indexes
        assert {index.compression for index in indexes} == {compression}


@pytest.mark.parametrize(('name', 'value', 'words'), [
    ('compression', 'zip', "compression: wanted one of none, lz4, zstd .* got 'zip'"),
    ('max_file_mb', 0.5, r'max_file_mb: wanted a whole number in 0 \.\. .* got 0\.5'),
    ('max_file_s', -1, r'max_file_s: wanted a whole number in 0 \.\. .* got -1'),
])
def test_the_recorder_has_the_parameters_of_a_log(name, value, words):
    """And refuses what cannot be."""
    wanted = {one.name: one for one in recorder.WANTED}
    assert {one.name for one in LOG} == {'compression', 'max_file_mb', 'max_file_s'} <= set(wanted)
    with pytest.raises(InvalidConfig, match=words):
        wanted[name].check(value, 'recorder')


def test_a_whole_cell_with_a_split_log(cell_of, client):
    """What was published comes out of the log again, bit for bit; its files are many."""
    with cell_of(3, params={'recorder': {'max_file_s': 200, 'compression': 'zstd'}}) as cell:
        outcome = client.calibrate(check=cell.check)
    assert outcome.success, outcome.message
    assert len(files_of(outcome.log)) > 2
    log = read_log(outcome.log)
    assert log.problems == ()
    assert len(log.error_motions) == 1
    assert np.array_equal(analyse(log.to_run()).error_motions.values, outcome.error_motions.values)
    numbers = Counter((one.topic, one.sequence) for path in files_of(outcome.log) for one in read_file(path))
    assert len(numbers) == log.messages
    assert max(numbers.values()) > 1
