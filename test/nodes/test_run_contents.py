# SPDX-License-Identifier: Apache-2.0
"""What a log holds of its run, and what of that is missing when its end is asked for."""

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rosette_msgs.msg import BallCentre, CalibrationEvent, Diagnosis, ErrorMotions, Model, ProbeTarget, RunState
from rosette_msgs.srv import Recorded, StopRecording
from service_msgs.msg import ServiceEventInfo
from std_msgs.msg import Header

from rosette_ros.core.run.geometry import Frame
from rosette_ros.nodes import conversions
from rosette_ros.nodes.log_session import RunContents


def stamped(second, frame_id='machine'):
    return Header(stamp=Time(sec=second), frame_id=frame_id)


TARGET = ProbeTarget(
    header=stamped(5), run_id='r', seq=1, attempt=1, phase=3, balls=3, radius=0.1, table_position=1, ball=1)
MESSAGES = {
    'the target': TARGET,
    'the answer': BallCentre(header=stamped(6), run_id='r', seq=1, table_position=1, ball=1),
    'the table frame': conversions.frame_message(Frame.identity(), 'machine', 'table', Time(sec=5)),
    'the model': Model(run_id='r', hash='abc'),
    'the error motions': ErrorMotions(header=stamped(9), run_id='r'),
}


def holding(messages):
    contents = RunContents('r')
    for message in messages:
        contents.add(message)
    return contents


READINGS = holding(MESSAGES.values()).answers.readings_hash
MESSAGES['the diagnosis'] = Diagnosis(run_id='r', readings_hash=READINGS)
WANTED = Recorded.Request(
    run_id='r', error_motions=Time(sec=9), model_hash='abc', diagnosis=True, readings_hash=READINGS)


@pytest.mark.parametrize('lacking', MESSAGES)
def test_what_is_missing_is_named(lacking):
    """One message did not arrive: it is said which; a target or its answer by the hash."""
    contents = holding(message for name, message in MESSAGES.items() if name != lacking)
    readings = lacking in ('the target', 'the answer')
    assert contents.missing(WANTED)[-1] == ('the readings' if readings else lacking)


def test_a_whole_log_lacks_nothing():
    assert holding(MESSAGES.values()).missing(WANTED) == []


@pytest.mark.parametrize('change', [
    {'table_angle': 1e-16}, {'header': stamped(7)}, {'centre': Point(x=1e-5)}, {'temperature': 20.0}])
def test_error_motions_of_other_readings_are_not_those_of_the_log(change):
    """The smallest difference in one answer; two answers of which the same one counts are no difference."""
    other = BallCentre(run_id='r', seq=1, table_position=1, ball=1, **{'header': stamped(6), **change})
    sound = [one for name, one in MESSAGES.items() if name != 'the answer']
    assert holding([*sound, other]).missing(WANTED) == ['the readings']
    assert holding([*MESSAGES.values(), other]).missing(WANTED) == []


def test_messages_of_another_run_do_not_count():
    """Nor a model with another hash, nor earlier error motions, nor a diagnosis of other readings."""
    other = [ErrorMotions(header=stamped(9), run_id='s'), ErrorMotions(header=stamped(8), run_id='r'),
             Model(run_id='r', hash='abd'), Diagnosis(run_id='r', readings_hash='of others'),
             RunState(run_id='s', phase=RunState.PHASE_DONE)]
    assert holding([TARGET, MESSAGES['the table frame'], *other]).missing(WANTED) == [
        'the readings', 'the error motions', 'the model', 'the diagnosis']


def test_a_log_is_closed_with_the_answers_the_request_the_state_and_the_event_of_the_end():
    """Each is named where it is missing."""
    wanted = StopRecording.Request(run_id='r', answers=1, phase=RunState.PHASE_CANCELLED)
    asked = StopRecording.Event(request=[wanted])
    asked.info.event_type = ServiceEventInfo.REQUEST_RECEIVED
    assert holding(()).missing(wanted) == ['1 answers', 'this request', 'the event of the end',
                                            'the state cancelled']
    end = [RunState(run_id='r', phase=RunState.PHASE_CANCELLED),
           CalibrationEvent(run_id='r', kind=CalibrationEvent.CANCELLED)]
    assert holding([asked, *end, TARGET, MESSAGES['the answer']]).missing(wanted) == []
