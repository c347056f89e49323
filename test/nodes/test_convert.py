# SPDX-License-Identifier: Apache-2.0
"""Messages to records and back lose nothing."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosette_msgs.msg import BallCentre, ErrorMotions, Model
from tf2_msgs.msg import TFMessage

from rosette_ros.analysis import RunResult, analyse, result
from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.core.model.model import Model as CoreModel
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.bag_metadata import INFINITE, Qos
from rosette_ros.io.messages import STATUS_OK, Answer, answer_of, nanoseconds, table_frame_of, target_of
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.nodes import conversions
from rosette_ros.simulation import Machine, MachineConfig

STAMP = Time(sec=1_800_000_000, nanosec=123_456_789)
NUMBERS = st.floats(-1e3, 1e3)


def over_the_wire(message):
    """Return the message after CDR and back."""
    return deserialize_message(serialize_message(message), type(message))


def test_target_message_says_what_the_target_says():
    """Every field of the target arrives."""
    planned = plan_calibration(plan(5, 'random', 3), 0.1825, Frame.identity(), 2)
    for index in range(planned.total):
        target = planned.target(index)
        target = target._replace(run_id='run', attempt=2, session=3, centre=(1.0, 2.0, 3.0), frame_id='machine')
        message = over_the_wire(conversions.target_message(target, STAMP))
        assert target_of(message) == target._replace(stamp_ns=nanoseconds(STAMP))


def test_a_run_message_is_the_run():
    """Every target and answer to the bit, and so the hash of the readings; an answer is as the CMM sent it."""
    planned, answers = plan_calibration(plan(5, 'random', 3), 0.1825, Frame.identity(), 2), RunAnswers('run')
    for index in range(planned.total):
        target = planned.target(index)._replace(run_id='run', session=1 + index // 20, frame_id='machine')
        answers.add_target(target)
        answers.add_answer(Answer(
            'run', target.seq, target.table_position, target.ball, target.cmm_position, int(index == 3), 'ü',
            0.1 * index, 1e-17, -1, (0.1, index / 3, -0.0), 1e-9, 20.1, 'machine', 5 + index))
    frame = conversions.frame_message(Frame.identity(), 'machine', 'table', STAMP)
    found = conversions.answers_of(over_the_wire(conversions.run_message(answers, frame.transforms, STAMP)))
    assert (found.targets, found.answers) == (answers.targets, answers.answers)
    assert (found.readings_hash, len(found.frames)) == (answers.readings_hash, 1)
    for answer in answers.answers:
        assert answer_of(over_the_wire(conversions.answer_message(answer))) == answer
    empty = conversions.answers_of(over_the_wire(conversions.run_message(RunAnswers('none'), [], STAMP)))
    assert (empty.run_id, empty.targets) == ('none', [])
    broken = conversions.run_message(answers, [], STAMP)
    broken.answer_seq = broken.answer_seq[1:]
    with pytest.raises(InvalidData, match='run run: expected arrays of one length'):
        conversions.answers_of(broken)


@given(st.lists(NUMBERS, min_size=3, max_size=3), NUMBERS, st.integers(0, 2**31 - 1),
       st.integers(0, 999_999_999))
def test_answer_keeps_every_bit(centre, angle, sec, nanosec):
    """Stamps in ns and coordinates are exact."""
    message = BallCentre(run_id='a', seq=7, table_position=1, ball=2, cmm_position=3,
                         table_angle=angle, table_travel=angle)
    message.centre = conversions.point(centre)
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    message.header.frame_id = 'machine'
    back = over_the_wire(message)
    answer = answer_of(back)
    assert answer.centre == tuple(centre)
    assert (answer.status, answer.table_angle, answer.frame_id) == (STATUS_OK, angle, 'machine')
    assert answer.stamp_ns == sec * 10**9 + nanosec
    assert conversions.time_message(answer.stamp_ns) == message.header.stamp


def test_reading_fills_the_answer():
    """A machine's reading becomes an answer in the machine frame."""
    machine = Machine(MachineConfig())
    reading = machine.measure(2, 3)
    message = BallCentre()
    conversions.fill_answer(message, reading, STAMP, 'machine')
    back = over_the_wire(message)
    assert back.status == BallCentre.STATUS_OK
    assert conversions.point_array(back.centre).tolist() == reading.centre.tolist()
    for name in ('table_angle', 'table_travel', 'approach', 'form_error', 'temperature'):
        assert getattr(back, name) == getattr(reading, name)


def test_frame_survives_the_transform():
    """Quaternion and back: rounding only."""
    frame = Machine(MachineConfig()).true_frame
    message = over_the_wire(conversions.frame_message(frame, 'machine', 'table', STAMP))
    assert isinstance(message, TFMessage)
    transform = message.transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ('machine', 'table')
    back = table_frame_of(transform).frame
    assert back.rotation == pytest.approx(frame.rotation, abs=1e-15)
    assert back.origin.tolist() == frame.origin.tolist()


@pytest.fixture(scope='module')
def fit():
    """Return the fit of a small run."""
    return analyse(Machine(MachineConfig().changed(plate={'balls': 4})).run(plan(4), run_id='r1'))


@pytest.fixture(scope='module')
def hidden():
    """Return the result of a run whose machine drifts, which the model lacks."""
    machine = Machine(MachineConfig().changed(plate={'balls': 6}, hidden=[
        {'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}]))
    return result(machine.run(plan(6, 'random', 1), run_id='r2'))


def test_error_motions_survive_bit_for_bit(fit):
    """The published curves are the calculated ones."""
    message = over_the_wire(conversions.error_motions_message(RunResult(fit), STAMP, 'table'))
    assert isinstance(message, ErrorMotions)
    published = conversions.published_motions(message)
    back = published.motions
    assert (message.diagnosed, message.outcome, published.which, published.judged) == (False, '', 'as modelled', None)
    assert np.array_equal(published.modelled.values, back.values)
    assert np.array_equal(back.values, fit.error_motions.values)
    assert np.array_equal(back.u, fit.error_motions.u)
    assert np.array_equal(back.angle, fit.error_motions.angle)
    assert list(message.crz) == fit.error_motions['crz'].tolist()
    assert len(CURVES) == back.values.shape[1]
    assert (message.run_id, message.balls, message.rank) == ('r1', 4, fit.rank)
    assert message.sigma == fit.sigma
    assert message.model_hash == fit.model.hash
    assert message.completeness == 1.0


def test_the_result_is_published_and_the_fit_as_modelled_beside_it(hidden):
    """Bit for bit; ranges with U are those of the result, and what the fit is said to be is that of the model."""
    message = over_the_wire(conversions.error_motions_message(hidden, STAMP, 'table'))
    published = conversions.published_motions(message)
    assert (message.diagnosed, message.which, message.outcome) == (
        True, 'all explanations averaged', hidden.verdict.outcome)
    for got, of, wanted in ((published.judged, message, hidden.curves),
                            (published.modelled, message.modelled, hidden.beside)):
        assert np.array_equal(got.values, wanted.motions.values) and np.array_equal(got.u, wanted.motions.u)
        lines = wanted.lines()
        assert list(of.range) == [line.range for line in lines]
        assert list(of.expanded_range) == [line.expanded for line in lines]
    assert not np.array_equal(published.modelled.values, published.judged.values)
    assert (message.residual_rms, message.model_hash) == (hidden.fit.rms, hidden.fit.model.hash)


def test_model_message_before_and_after_a_fit(fit):
    """Before the first run there are no numbers; after it there are."""
    before = over_the_wire(conversions.model_message(CoreModel(), STAMP))
    assert isinstance(before, Model)
    assert (before.run_id, before.name) == ('', str(CoreModel()))
    assert math.isnan(before.residual_rms)
    assert math.isnan(before.reduced_chi_square)
    after = over_the_wire(conversions.model_message(fit.model, STAMP, fit))
    assert after.run_id == 'r1'
    assert after.residual_rms == fit.rms
    assert after.reduced_chi_square == fit.reduced_chi_square
    assert list(after.base) == list(fit.model.base)


def test_fitted_effects_are_named_with_their_parameters():
    """An effect in the model arrives with values, uncertainties and units."""
    model = CoreModel().with_effect('frame_drift')
    run = Machine(MachineConfig().changed(plate={'balls': 5})).run(plan(5, 'column'), run_id='r2')
    fitted = analyse(run, model)
    message = conversions.model_message(model, STAMP, fitted)
    assert [effect.name for effect in message.effects] == ['frame_drift']
    sent, parameters = message.effects[0], fitted.effects[0].parameters
    assert len(parameters) > 0
    assert [(name, value, u, unit) for name, value, u, unit in zip(
        sent.parameter, sent.value, sent.u, sent.unit, strict=True)] == [
            (one.name, one.value, one.u, one.unit) for one in parameters]
    assert [e.name for e in conversions.model_message(model, STAMP).effects] == ['frame_drift']




def test_qos_becomes_the_words_of_a_bag():
    """Known policies are kept; unknown history and depth become keep last 10."""
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL, deadline=Duration(seconds=2),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC)
    assert conversions.qos_record(profile) == Qos(
        history='keep_all', depth=10, reliability='best_effort', durability='transient_local',
        deadline=2 * 10**9, lifespan=0, liveliness='manual_by_topic', liveliness_lease_duration=0)
    assert INFINITE == 2**63 - 1
