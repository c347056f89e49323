# SPDX-License-Identifier: Apache-2.0
"""The recorder's services, and messages that arrive at an unwelcome moment."""

import itertools
import shutil
import time
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node
from recordings import measure, receive, start, stop
from rosette_msgs.msg import (
    BallCentre,
    CalibrationEvent,
    Diagnosis,
    ErrorMotions,
    Model,
    ProbeTarget,
    RunState,
)
from rosette_msgs.srv import Diagnose, Recorded, StartRecording
from rosgraph_msgs.msg import Clock
from service_msgs.msg import ServiceEventInfo
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from rosette_ros.io import bag_metadata, log_writer
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes import recorder as recorder_module
from rosette_ros.nodes.base_node import WAKE_PERIOD
from rosette_ros.nodes.interfaces import decoded
from rosette_ros.nodes.recorder import Recorder

QUESTION = Diagnose.Event(info=ServiceEventInfo(event_type=ServiceEventInfo.REQUEST_RECEIVED))
IDLE = RunState(phase=RunState.PHASE_IDLE)
STAMP = Time(sec=7)


def test_latched_targets_of_an_earlier_run_that_arrive_late(recorder, tmp_path):
    """A recorder that was started anew gets them, on a busy computer when the next log is open: it was of two runs."""
    assert start(recorder, 'second').success
    for run_id in ('first', 'second'):
        receive(recorder, 'probe_target', ProbeTarget(run_id=run_id, seq=1, attempt=1, phase=ProbeTarget.PHASE_RUN))
    assert stop(recorder, 'second').success
    assert [target.run_id for target in read_log(tmp_path / 'second').targets] == ['second']


@pytest.mark.parametrize('other', ['my_row', 'row_2', 'Row', ''])
def test_names_of_runs_are_compared_whole(recorder, tmp_path, other):
    """`row` is in `my_row`."""
    assert start(recorder, 'row').success
    for run_id in (other, 'row'):
        receive(recorder, 'probe_target', ProbeTarget(header=Header(frame_id='row'), run_id=run_id, seq=1, attempt=1))
    assert stop(recorder, 'row').success
    assert [target.run_id for target in read_log(tmp_path / 'row').targets] == ['row']


def status_of(node, message, process='1', level=b'\0', **values):
    """Return the DiagnosticArray of a node's status."""
    values = {'process': f'{node} {process}', **values}
    return DiagnosticArray(status=[DiagnosticStatus(level=level, name=f'rosette/{node}', message=message, values=[
        KeyValue(key=key, value=value) for key, value in values.items()])])


def test_a_status_is_recorded_when_it_changes(recorder, tmp_path):
    """Level, message or process: 30 s of a ball were 360 messages of presence. Every log has the present ones."""
    changes = [status_of('cmm', 'ready'), status_of('evaluator', 'ready'), status_of('cmm', 'measuring'),
               status_of('cmm', 'measuring', '2'), status_of('cmm', 'measuring', '2', b'\1')]
    for run_id in 'run', 'next':
        assert start(recorder, run_id).success
        for message in changes:
            for second in range(60):
                message.header.stamp.sec = second
                receive(recorder, '/diagnostics', message)
        recorder._close()
        found = [decoded(one.data, DiagnosticArray).status[0] for one in iter_log(tmp_path / run_id)
                 if one.topic == '/diagnostics']
        assert [(one.name, one.message, one.level, one.values) for one in found] == [
            (one.name, one.message, one.level, one.values) for message in changes for one in message.status]
    assert {process for *_, process in recorder._statuses.values()} == {'cmm 2', 'evaluator 1'}


@pytest.mark.parametrize('is_simulated', [False, True])
def test_the_clock_of_another_program_is_not_recorded(ros, tmp_path, capfd, is_simulated):
    """And makes no run a simulated one: only a cell on simulated time says so."""
    with ros('-r', '__ns:=/rosette', '-p', f'log_dir:={tmp_path}', '-p', f'use_sim_time:={is_simulated}'):
        other, node = Node('gazebo'), Recorder()
        publisher = other.create_publisher(Clock, '/clock', 10)
        deadline = time.monotonic() + 20.0
        while not node.count_publishers('/clock') and time.monotonic() < deadline:
            time.sleep(0.05)
        node._discover()
        assert start(node, 'run').success
        assert ('/clock' in node._subscribed) == is_simulated
        if is_simulated:
            receive(node, 'probe_target', ProbeTarget(run_id='run'))
        node._close()
        other.destroy_publisher(publisher)
        node.destroy_node()
        other.destroy_node()
    assert read_log(tmp_path / 'run').simulated == is_simulated
    assert ('/clock is neither used nor recorded' in capfd.readouterr().err) != is_simulated


def test_a_sequencer_that_is_restarted_while_a_log_is_open(recorder, tmp_path, monkeypatch):
    """Its idle state closes the log after some seconds; the answer to a late request names the reason."""
    now = [100.0]
    monkeypatch.setattr(recorder, 'seconds', lambda: now[0])
    assert start(recorder, 'run').success
    receive(recorder, 'run_state', IDLE)
    now[0] += recorder_module.SETTLED
    recorder.wake()
    response = stop(recorder, 'run')
    assert not response.success
    assert response.message.startswith(
        'close the log of run run: expected that it is open, found no log open; run run: ')
    assert not read_log(tmp_path / 'run').truncated


def test_an_idle_state_of_another_program_closes_no_log(recorder, monkeypatch):
    """The recorder may not know yet that there are two: the run goes on, as the sequencer tells."""
    now = [100.0]
    monkeypatch.setattr(recorder, 'seconds', lambda: now[0])
    assert start(recorder, 'run').success
    for state in (IDLE, RunState(run_id='run', phase=RunState.PHASE_RUN)):
        receive(recorder, 'run_state', state)
        now[0] += recorder_module.SETTLED - 1.0
        recorder.wake()
    now[0] += recorder_module.FORGOTTEN
    recorder.wake()
    assert recorder._session.is_open
    receive(recorder, 'run_state', IDLE)
    for wait, is_open in ((recorder_module.SETTLED - 1.0, True), (1.0, False)):
        now[0] += wait
        recorder.wake()
        assert recorder._session.is_open == is_open


def test_a_run_is_resumed_at_once_after_a_restart_of_the_sequencer(recorder, tmp_path):
    """The log of its first part is closed before it is read."""
    assert start(recorder, 'run').success
    measure(recorder, 1, 2)
    receive(recorder, 'run_state', IDLE)
    response = recorder._on_start(StartRecording.Request(run_id='run', resumes='run'), StartRecording.Response())
    assert response.success, response.message
    recorder._session.flush()
    assert not read_log(tmp_path / 'run').truncated
    assert [target.seq for target in read_log(Path(response.log)).targets] == [1, 2]


def test_events_since_a_run_was_requested_are_in_its_log(recorder, tmp_path, monkeypatch):
    """Also where a CMM takes long to judge the plan; not those of a run before."""
    now = [100.0]
    monkeypatch.setattr(recorder, 'seconds', lambda: now[0])
    for run_id, after in (('a', 30.0), ('b', 30.0), ('b', 1.0), ('', 30.0)):
        for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.ACCEPTED if run_id else CalibrationEvent.REJECTED):
            receive(recorder, 'calibration_event', CalibrationEvent(run_id=run_id, kind=kind))
        now[0] += after
    assert start(recorder, 'b').success
    recorder._close()
    assert [(event.run_id, event.kind) for event in read_log(tmp_path / 'b').events] == [
        (run_id, kind) for run_id, last in (('b', CalibrationEvent.ACCEPTED), ('', CalibrationEvent.REJECTED))
        for kind in (CalibrationEvent.REQUESTED, last)]


def test_a_log_is_closed_when_it_holds_the_end(recorder, tmp_path):
    """State and event of the end, of this run, and the request itself; until then it stays open and says so."""
    assert start(recorder, 'run').success
    done = {'run_id': 'run', 'phase': RunState.PHASE_DONE, 'is_recorded': False}
    assert stop(recorder, **done).missing == ['this request', 'the event of the end', 'the state done']
    receive(recorder, 'run_state', RunState(run_id='another', phase=RunState.PHASE_DONE))
    receive(recorder, 'run_state', RunState(run_id='run', phase=RunState.PHASE_DONE))
    response = stop(recorder, 'run', RunState.PHASE_DONE)
    assert (response.success, response.log, response.missing) == (False, '', ['the event of the end'])
    assert response.message == 'the log lacks the event of the end'
    receive(recorder, 'calibration_event', CalibrationEvent(run_id='run', kind=CalibrationEvent.SUCCEEDED))
    response = stop(recorder, 'run', RunState.PHASE_DONE)
    assert (response.success, response.log, response.missing) == (True, str(tmp_path / 'run'), [])
    assert response.messages == len(read_log(tmp_path / 'run').states) + 3


def test_a_log_that_lacks_its_end_is_closed_after_a_bounded_time(recorder, tmp_path, monkeypatch):
    """The answer says what it lacks, and the run does not end in success; it comes after some requests, not after a
    time alone, in which the recorder may have stood still."""
    monkeypatch.setattr(recorder_module, 'LAST_MESSAGES', 3.5 * WAKE_PERIOD)
    monkeypatch.setattr(recorder, 'seconds', itertools.count(step=10.0).__next__)
    assert start(recorder, 'run').success
    assert not any(stop(recorder, 'run', RunState.PHASE_DONE).log for _ in range(3))
    response = stop(recorder, 'run', RunState.PHASE_DONE)
    assert not response.success
    assert response.log == str(tmp_path / 'run')
    assert response.message == 'the log lacks the event of the end, the state done'
    assert not read_log(tmp_path / 'run').truncated


def test_what_is_recorded_of_a_result_is_answered(recorder):
    """Error motions by their stamp, the model by its hash, the diagnosis by its readings."""
    assert start(recorder, 'run').success
    request = Recorded.Request(run_id='run', error_motions=STAMP, model_hash='abc', diagnosis=True,
                               readings_hash=RunAnswers('run').readings_hash)
    missing = recorder._on_recorded(request, Recorded.Response()).missing
    assert missing == ['the table frame', 'the error motions', 'the model', 'the diagnosis']
    receive(recorder, 'error_motions', ErrorMotions(run_id='run', header=Header(stamp=Time(sec=6))))
    receive(recorder, 'model', Model(run_id='run', hash='abc'))
    assert recorder._on_recorded(request, Recorded.Response()).missing[1:] == [
        'the error motions', 'the diagnosis']
    receive(recorder, 'error_motions', ErrorMotions(run_id='run', header=Header(stamp=STAMP)))
    receive(recorder, 'diagnosis', Diagnosis(run_id='run', readings_hash='of an earlier attempt'))
    assert recorder._on_recorded(request, Recorded.Response()).missing[1:] == ['the diagnosis']
    receive(recorder, 'diagnosis', Diagnosis(run_id='run', readings_hash=request.readings_hash))
    assert recorder._on_recorded(request, Recorded.Response()).missing == ['the table frame']


def test_what_the_log_lacks_of_the_run_is_written_as_the_sequencer_has_it(recorder, tmp_path):
    """A recorder that was killed, or did not receive a message: nothing is measured again."""
    assert start(recorder, 'run').success
    measure(recorder, 1, 2, 3)
    answers, whole = recorder._contents.answers, recorder._contents.answers.readings_hash
    run = conversions.run_message(answers, placed(1.0, 5).transforms, STAMP)
    recorder._close()
    assert recorder._on_start(StartRecording.Request(run_id='next'), StartRecording.Response()).success
    receive(recorder, 'run', run)  # is of another log
    recorder._close()
    resumed = recorder._on_start(StartRecording.Request(run_id='run', resumes='run'), StartRecording.Response())
    recorder._contents._answers.__init__('run')
    for is_missing in (True, False):
        request = Recorded.Request(run_id='run', readings_hash=whole)
        assert ('the readings' in recorder._on_recorded(request, Recorded.Response()).missing) == is_missing
        receive(recorder, 'run', run)
    recorder._close()
    log = read_log(Path(resumed.log))
    assert log.runs['run'].readings_hash == whole
    assert read_log(tmp_path / 'next').answers == []


def test_what_comes_with_the_run_and_by_its_own_topic_is_one_answer(recorder, tmp_path, capfd):
    """The run overtakes the last answer: it was twice in the log, and told as one that was not received."""
    assert start(recorder, 'run').success
    measure(recorder, 1, 2, 3)
    run = conversions.run_message(recorder._contents.answers, placed(1.0, 5).transforms, STAMP)
    recorder._close()
    assert start(recorder, 'again').success
    run.run_id = recorder._session.run_id
    receive(recorder, 'run', run)
    target, *answers = (conversions.answers_of(run).targets[2], *conversions.answers_of(run).answers[1:])
    receive(recorder, 'probe_target', conversions.target_message(target))
    for answer in answers:
        receive(recorder, 'ball_centre', conversions.answer_message(answer))
    receive(recorder, 'ball_centre', conversions.answer_message(answers[0]))  # the CMM answers twice
    recorder._close()
    log = read_log(tmp_path / 'again')
    assert [target.seq for target in log.targets] == [1, 2, 3]
    assert [answer.seq for answer in log.answers] == [1, 2, 3, 2]
    assert 'run again: 3 readings came with it alone' in capfd.readouterr().err


@pytest.mark.parametrize('is_gone', [True, False])
def test_a_log_that_is_gone_is_not_named_where_it_is_closed(recorder, tmp_path, is_gone):
    """It said that what was measured is in a folder that is not there."""
    assert start(recorder, 'run').success
    measure(recorder, 1)
    if is_gone:
        shutil.rmtree(tmp_path)
        tmp_path.write_text('')
    response = stop(recorder, 'run')
    assert (response.success, response.log) == ((False, '') if is_gone else (True, str(tmp_path / 'run')))
    assert response.messages


def test_what_a_restarted_node_says_is_recorded_however_early():
    """Before the recorder is connected to it: an evaluator that is restarted publishes its diagnosis once."""
    latched = {topic.name for topic in recorder_module.TOPICS if topic.profile is qos.RECORD_LATCHED}
    assert latched >= set(names.SIGNED)


def placed(x, sec):
    """Return a table frame at x, m, with a stamp."""
    return TFMessage(transforms=[TransformStamped(
        header=Header(stamp=Time(sec=sec), frame_id='machine'), child_frame_id='table',
        transform=Transform(translation=Vector3(x=x), rotation=Quaternion(w=1.0)))])


def test_a_frame_of_an_earlier_run_is_none_of_a_resumed_one(recorder, tmp_path):
    """Whatever its stamp is: it was there before the first target."""
    receive(recorder, '/tf_static', placed(9.0, 11))
    assert start(recorder, 'run').success
    for seq, phase, sec in ((1, 2, 10), (2, 3, 20)):
        header = Header(stamp=Time(sec=sec), frame_id='machine')
        common = {'run_id': 'run', 'seq': seq, 'table_position': 1, 'ball': 1, 'header': header}
        receive(recorder, 'probe_target', ProbeTarget(attempt=1, session=1, phase=phase, balls=3, radius=0.1, **common))
        receive(recorder, 'ball_centre', BallCentre(**common))
        if phase == 2:
            receive(recorder, '/tf_static', placed(1.0, 12))
    recorder._close()
    for part in 'run_part2', 'run_part3':
        resumed = recorder._on_start(StartRecording.Request(run_id='run', resumes='run'), StartRecording.Response())
        assert resumed.success, resumed.message
        recorder._close()
        assert RunAssembly(read_log(tmp_path / part).runs['run']).frame().origin.tolist() == [1.0, 0.0, 0.0]


def test_the_log_is_not_read_again_and_again(recorder, monkeypatch):
    """While something is missing that is asked for five times a second; metadata.yaml is not written meanwhile."""
    sums, described = [], []
    read, describe = log_writer._sum, bag_metadata.write_bag_metadata
    monkeypatch.setattr(log_writer, '_sum', lambda path: (sums.append(path), read(path))[1])
    monkeypatch.setattr(bag_metadata, 'write_bag_metadata', lambda *about: (described.append(about), describe(*about)))
    assert start(recorder, 'run').success
    measure(recorder, 1)
    for _ in range(20):
        recorder._on_recorded(Recorded.Request(run_id='run', model_hash='abc'), Recorded.Response())
    assert (len(sums), len(described)) == (1, 1)
    measure(recorder, 2)
    recorder._on_recorded(Recorded.Request(run_id='run', model_hash='abc'), Recorded.Response())
    assert (len(sums), len(described)) == (2, 1)
    recorder._close()
    assert (len(sums), len(described)) == (3, 2)


def test_a_log_whose_run_is_over_does_not_refuse_the_next_run(recorder, monkeypatch):
    """Its request to close was not answered in time; every later run was refused, and the log grew."""
    now = [100.0]
    monkeypatch.setattr(recorder, 'seconds', lambda: now[0])
    assert start(recorder, 'a').success
    receive(recorder, 'run_state', RunState(run_id='a', phase=RunState.PHASE_RUN))
    now[0] += 1000.0
    assert 'the log of run a is open' in start(recorder, 'b').message
    receive(recorder, 'run_state', RunState(run_id='a', phase=RunState.PHASE_FAILED))
    now[0] += recorder_module.SETTLED + 0.1
    receive(recorder, 'run_state', RunState(run_id='b', phase=RunState.PHASE_REPEATABILITY))  # before its log is open
    assert start(recorder, 'b').success
    receive(recorder, 'run_state', RunState(run_id='b', phase=RunState.PHASE_FAILED))
    now[0] += recorder_module.FORGOTTEN - 1.0
    recorder.wake()
    assert recorder._session.is_open
    now[0] += 2.0
    recorder.wake()
    assert not recorder._session.is_open


def test_a_log_stays_open_where_nothing_tells_that_its_run_is_over(recorder, monkeypatch):
    """A program of one's own calls the service, or the states of a run are not used while two nodes publish them."""
    now = [100.0]
    monkeypatch.setattr(recorder, 'seconds', lambda: now[0])
    receive(recorder, 'run_state', RunState(run_id='a', phase=RunState.PHASE_DONE))
    assert start(recorder, 'b').success
    now[0] += 3600.0
    recorder.wake()
    assert recorder._session.is_open and 'the log of run b is open' in start(recorder, 'c').message


def test_the_log_of_a_run_that_failed_before_it_was_open_is_closed(recorder, monkeypatch):
    """The recorder stood still meanwhile; the log of a run that is resumed stays open."""
    now = [100.0]
    monkeypatch.setattr(recorder, 'seconds', lambda: now[0])
    for run_id, is_resumed in (('a', True), ('b', False)):
        receive(recorder, 'run_state', RunState(run_id=run_id, phase=RunState.PHASE_FAILED))
        assert start(recorder, run_id).success
        if is_resumed:
            receive(recorder, 'run_state', RunState(run_id=run_id, phase=RunState.PHASE_RUN))
        now[0] += recorder_module.FORGOTTEN + 1.0
        recorder.wake()
        assert recorder._session.is_open == is_resumed
        stop(recorder, run_id)
        if recorder._session.is_open:
            recorder._close()


def test_a_folder_that_cannot_be_looked_at_is_told(ros, tmp_path):
    """The name is longer than file systems allow: the recorder ended with a traceback."""
    with ros('-r', '__ns:=/rosette', '-p', f'log_dir:={tmp_path / ("a" * 300)}'):
        recorder = Recorder()
        answer = start(recorder, 'a')
        recorder.destroy_node()
    assert not answer.success and 'expected a folder for the log, found: File name too long' in answer.message
