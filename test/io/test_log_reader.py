# SPDX-License-Identifier: Apache-2.0
"""Logs into arrays: equal to what independent readers decode, and honest about bad logs."""

import dataclasses
import struct

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from split_bag import split

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_writer import LogWriter

ANSWER = 'rosette_msgs/msg/BallCentre'
NUMBERS = ('seq', 'table_position', 'ball', 'status', 'table_angle', 'table_travel', 'approach',
           'form_error', 'temperature')


def columns_of(messages):
    """Return the columns of decoded BallCentres, made one by one."""
    table = {name: np.array([getattr(message, name) for message in messages])
             for name in NUMBERS}
    table['centre'] = np.array([[m.centre.x, m.centre.y, m.centre.z] for m in messages])
    table['stamp_ns'] = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
                                  for m in messages])
    return table


def assert_equal(log, messages):
    """Every number is the same to the last bit, every text the same, run by run in the order of the messages."""
    assert len(log.answers) == len(messages)
    for run_id, run in log.runs.items():
        own = [message for message in messages if message.run_id == run_id]
        for name, values in columns_of(own).items():
            ours = np.array([getattr(answer, name) for answer in run.answers], dtype=values.dtype)
            assert ours.tobytes() == values.tobytes(), name
        assert [(one.frame_id, one.text) for one in run.answers] == [(one.header.frame_id, one.text) for one in own]


def vary(cell):
    """Give the answers texts and ids of all lengths, so that no two layouts are alike."""
    rng = np.random.default_rng(3)
    for row, message in enumerate(cell.answers()):
        object.__setattr__(message, 'text', 'é' * int(rng.integers(0, 9)) + str(row % 5))
        object.__setattr__(message, 'run_id', 'first' + 'x' * (row % 4))
        object.__setattr__(message.header, 'frame_id', 'machine'[:row % 3])
    return cell


@pytest.mark.parametrize('varied', [False, True])
def test_arrays_equal_what_independent_readers_decode(make_cell, tmp_path, varied):
    """mcap-ros2-support and rosbags, message by message, to the last bit."""
    cell = vary(make_cell(n=7)) if varied else make_cell(n=7)
    cell.write(tmp_path / 'log', compression='zstd', chunk_size=3000)
    ours = read_log(tmp_path / 'log')
    with open(tmp_path / 'log' / 'log_0.mcap', 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [entry.decoded_message for entry in
                   reader.iter_decoded_messages(topics=['/rosette/ball_centre'])]
    assert_equal(ours, decoded)
    with AnyReader([tmp_path / 'log']) as reader:
        wanted = [entry for entry in reader.connections if entry.msgtype == ANSWER]
        decoded = [reader.deserialize(data, connection.msgtype)
                   for connection, _, data in reader.messages(wanted)]
    assert_equal(ours, decoded)


@pytest.mark.parametrize('options', [
    {}, {'use_chunking': False}, {'index_types': IndexType.NONE}, {'enable_crcs': False},
    {'compression': CompressionType.LZ4, 'chunk_size': 1000},
    {'compression': CompressionType.NONE, 'index_types': IndexType.CHUNK},
    {'repeat_channels': False, 'repeat_schemas': False, 'use_statistics': False},
])
def test_files_of_the_mcap_library_are_read(make_cell, write_with_mcap, tmp_path, options):
    """With and without chunks, indexes, checksums, summary, compression."""
    cell = make_cell()
    log = read_log(write_with_mcap(tmp_path / 'other.mcap', cell, **options))
    assert_equal(log, cell.answers())
    assert (log.messages, log.truncated, log.problems) == (len(cell.sent), False, ())


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP])
def test_files_of_rosbags_are_read(make_cell, tmp_path, plugin):
    """A log that another rosbag2 writer made, with its own metadata.yaml."""
    cell = make_cell()
    with RosbagsWriter(tmp_path / 'log', version=9, storage_plugin=plugin) as writer:
        topics = {topic: writer.add_connection(topic, kind, typestore=cell.store)
                  for topic, kind in dict.fromkeys((topic, kind) for topic, kind, _ in cell.sent)}
        for time, (topic, kind, message) in enumerate(cell.sent):
            writer.write(topics[topic], time, cell.store.serialize_cdr(message, kind))
    assert_equal(read_log(tmp_path / 'log'), cell.answers())


def test_run_is_what_the_cell_measured(make_cell, tmp_path):
    """Table frame, order, time, travel, repeatability of the 3 readings (1e-6 m apart)."""
    cell = make_cell(n=5)
    run = read_log(cell.write(tmp_path / 'log')).to_run()
    assert (run.n, run.radius, run.run_id, run.size) == (5, 0.18, 'first', 25)
    assert run.is_complete
    np.testing.assert_allclose(run.centre, cell.centre, atol=2e-16)
    np.testing.assert_allclose(run.time, 30.250000001 * np.arange(25), atol=1e-9)
    assert run.table_travel.tolist() == [0.5 * seq for seq in range(5, 30)]
    # Three readings at e_x, e_y, e_z micrometres: the squares of each axis sum to 2/3.
    assert run.repeatability == pytest.approx(1e-6 * np.sqrt(2 / 6), rel=1e-9)
    assert run.repeatability_dof == 6
    assert run.source == str(tmp_path / 'log')


def test_answers_in_the_table_frame_need_no_transform(make_cell, tmp_path):
    """They are taken as they are, to the last bit."""
    cell = make_cell(frame_id='table')
    cell.sent = [entry for entry in cell.sent if entry[0] != '/tf_static']
    assert read_log(cell.write(tmp_path / 'log')).to_run().centre.tobytes() == (
        cell.centre.tobytes())


def test_table_frame_of_the_run_is_taken(make_cell, tmp_path):
    """Neither the one left from an earlier run nor the one of the next."""
    earlier, cell, later = (make_cell(seed=seed, begin_s=begin)
                            for seed, begin in ((1, 100.0), (2, 9000.0), (3, 50_000.0)))
    old, new = ([entry for entry in one.sent if entry[0] == '/tf_static']
                for one in (earlier, later))
    cell.sent = [*old, *cell.sent, *new]
    run = read_log(cell.write(tmp_path / 'log')).to_run()
    np.testing.assert_allclose(run.centre, cell.centre, atol=2e-16)


def other_frame(cell, seed, **changes):
    """Return the entry of another table frame for a log; changes: fields of its header, child_frame_id."""
    topic, kind, message = next(entry for entry in cell.sent if entry[0] == '/tf_static')
    own, [theirs] = message.transforms[0], [
        entry[2].transforms[0] for entry in seed.sent if entry[0] == '/tf_static']
    made = dataclasses.replace(theirs, header=dataclasses.replace(own.header, **changes))
    return topic, kind, dataclasses.replace(message, transforms=[made])


def test_two_table_frames_for_one_run_are_refused(make_cell, tmp_path):
    """One that came before the first target is of an earlier run; its stamp is of a clock that was ahead."""
    cell, other = make_cell(), make_cell(seed=1)
    cell.sent.insert(0, other_frame(cell, other))
    run = read_log(cell.write(tmp_path / 'earlier')).to_run()
    np.testing.assert_allclose(run.centre, cell.centre, atol=2e-16)
    first = next(place for place, entry in enumerate(cell.sent) if entry[0].endswith('probe_target'))
    cell.sent.insert(first + 1, cell.sent.pop(0))
    log = read_log(cell.write(tmp_path / 'log'))
    words = (r'log: expected one table frame for run first, found 2 that differ; two cells share /tf_static\? give '
             r'each '
             'its namespace or domain')
    with pytest.raises(InvalidData, match=words):
        log.to_run()
    with pytest.raises(InvalidData, match=words):
        log.frame_of('first')


def test_the_same_table_frame_twice_is_one(make_cell, tmp_path):
    """A log that was split repeats what is latched."""
    cell = make_cell()
    [frame] = [entry for entry in cell.sent if entry[0] == '/tf_static']
    cell.sent = [frame, *cell.sent, frame]
    np.testing.assert_allclose(read_log(cell.write(tmp_path / 'log')).to_run().centre, cell.centre, atol=2e-16)


def test_frames_of_other_things_are_not_those_of_the_table(make_cell, tmp_path):
    """A table whose parent is not the machine is somebody else's, for the evaluator too."""
    cell = make_cell()
    cell.sent.append(other_frame(cell, make_cell(seed=1), frame_id='world'))
    log = read_log(cell.write(tmp_path / 'log'))
    assert len(log.frames) == 1
    np.testing.assert_allclose(log.to_run().centre, cell.centre, atol=2e-16)


def test_answers_in_the_table_frame_care_for_no_frame(make_cell, tmp_path):
    """Two that differ do no harm to a CMM that knows its table."""
    cell = make_cell(frame_id='table')
    cell.sent.append(other_frame(cell, make_cell(seed=1)))
    assert read_log(cell.write(tmp_path / 'log')).to_run().centre.tobytes() == cell.centre.tobytes()


def test_two_runs_in_one_log_are_told_and_chosen(make_cell, tmp_path):
    """The error names them; run_id chooses, with its own frame and repeatability."""
    first, second = make_cell(run_id='first'), make_cell(run_id='second', seed=5, begin_s=9e4)
    first.sent += second.sent
    log = read_log(first.write(tmp_path / 'log'))
    with pytest.raises(InvalidData, match=r'log: expected one run, found 2: first, second; choose one'):
        log.to_run()
    np.testing.assert_allclose(log.to_run('second').centre, second.centre, atol=2e-16)
    np.testing.assert_allclose(log.to_run('first').centre, first.centre, atol=2e-16)
    assert log.run_ids == ('first', 'second')


def test_other_messages_are_kept_for_information(make_cell, tmp_path):
    """Error motions as published, the last state of the run, events, topics with counts."""
    cell = make_cell()
    curves = {name: np.arange(4) * 1e-7 + place for place, name in enumerate(
        ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz'))}
    for share in (0.5, 1.0):
        kind = 'rosette_msgs/msg/ErrorMotions'
        cell.sent.append(('/rosette/error_motions', kind, cell.message(
            kind, run_id='first', balls=4, angle=np.arange(4.0), model_name='base', rank=35,
            residual_rms=1.0, completeness=share, **curves,
            **{f'u_{name}': values / 2 for name, values in curves.items()})))
    for phase in (3, 6):
        kind = 'rosette_msgs/msg/RunState'
        cell.sent.append(('/rosette/run_state', kind, cell.message(
            kind, run_id='first', phase=phase, order='diagonal', done=9, total=9, text='ok')))
    kind = 'rosette_msgs/msg/CalibrationEvent'
    cell.sent.append(('/rosette/calibration_event', kind, cell.message(
        kind, run_id='first', kind=5, origin='calibrate')))
    log = read_log(cell.write(tmp_path / 'log'))
    published = log.latest_error_motions()
    assert (published.completeness, published.model_name) == (1.0, 'base')
    assert published.motions['crz'].tobytes() == curves['crz'].tobytes()
    assert published.motions.uncertainty('ctx').tobytes() == (curves['ctx'] / 2).tobytes()
    assert log.latest_error_motions('other') is None
    assert [(state.run_id, state.phase, state.done) for state in log.states] == [('first', 6, 9)]
    assert [(event.kind, event.origin) for event in log.events] == [(5, 'calibrate')]
    assert {topic.name: topic.messages for topic in log.topics}['/rosette/ball_centre'] == 21
    assert log.topics[0].qos[0].durability == 'transient_local'
    assert log.end_ns - log.start_ns == 10**7 * (len(cell.sent) - 1)


@pytest.mark.parametrize(('said', 'name', 'key', 'wanted'), [
    ({}, 'rosette/cmm', 'simulated_s', True), ({}, 'rosette/cmm', 'measured', False),
    ({}, 'gazebo', 'simulated_s', False), ({}, '', '', False), ({'rosette.simulated': 'yes'}, '', '', True)])
def test_a_run_is_simulated_if_its_cell_says_so(make_cell, tmp_path, said, name, key, wanted):
    """Its recorder, or its CMM by its status; the /clock of another program (Gazebo, ros2 bag play) says nothing."""
    cell = make_cell()
    cell.sent.append(('/clock', 'rosgraph_msgs/msg/Clock', cell.message('rosgraph_msgs/msg/Clock')))
    kind = 'diagnostic_msgs/msg/'
    status = cell.message(f'{kind}DiagnosticStatus', name=name, values=[
        cell.message(f'{kind}KeyValue', key=key, value='1.0')])
    kind = f'{kind}DiagnosticArray'
    cell.sent.append(('/diagnostics', kind, cell.message(kind, status=[status])))
    assert read_log(cell.write(tmp_path / 'log', custom_data=said)).to_run().simulated == wanted


def test_log_of_another_version_of_the_message_is_read_by_its_own_schema(make_cell, tmp_path):
    """A field more in front of the others moves everything; the log says so itself."""
    cell = make_cell()
    define = cell.define

    def with_extra(type_name):
        definition = define(type_name)
        if type_name != ANSWER:
            return definition
        return definition.__class__(type_name, 'float64[] extra\n' + definition.text, 'RIHS01_0')

    class Extended(LogWriter):
        def write(self, topic, data, *times):
            if topic.endswith('ball_centre'):
                extra = struct.pack('<IId', 1, 0, 7.0)  # length, padding, one number
                data = data[:4] + extra + data[4:]
            super().write(topic, data, *times)

    cell.define = with_extra
    log = read_log(cell.write(tmp_path / 'log', writer=Extended))
    assert_equal(log, cell.answers())


def test_messages_are_given_raw_in_order_of_recording(make_cell, tmp_path):
    """For replay: every byte, over all files of a split log."""
    cell = make_cell()
    messages = list(iter_log(split(cell.write(tmp_path / 'whole'), tmp_path / 'log', 3)))
    assert [(one.topic, one.type_name) for one in messages] == [
        (topic, kind) for topic, kind, _ in cell.sent]
    assert all(one.data == bytes(cell.store.serialize_cdr(message, kind))
               for one, (_, kind, message) in zip(messages, cell.sent, strict=True))
    assert all(one.publish_time == one.log_time - 1000 for one in messages)


def test_answers_that_no_target_asked_are_told(make_cell, tmp_path):
    """A node that leaves run_id empty."""
    cell = make_cell()
    for message in cell.answers():
        message.run_id = ''
    log = read_log(cell.write(tmp_path / 'log'))
    assert log.unasked == ("21 answers repeat the run_id '', which no target has",)
