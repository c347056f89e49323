# SPDX-License-Identifier: Apache-2.0
"""Collecting the messages of a run in any order of arrival between the topics."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_cell import ideal_cell
from rosette_msgs.msg import BallCentre
from std_msgs.msg import Header

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import Frame, rotation_matrix
from rosette_ros.core.scheme import plan
from rosette_ros.io.messages import Answer, Phase, TableFrame, Target, answer_of
from rosette_ros.io.run_assembly import RunAnswers
from rosette_ros.nodes.evaluation import RunCollection
from rosette_ros.simulation import Machine

N = 3
FRAME = Frame(rotation_matrix(np.array([1e-3, 0, 0])), np.array([0.1, 0.2, 0.3]))
FRAME_STAMP = 850


@functools.cache
def messages(frame_id='machine', run_id='a'):
    """Return the four topics of one run, each a list in its own order."""
    machine = Machine(ideal_cell(plate={'balls': N}, table={'translation_um': 1.0}))
    planned = plan_calibration(plan(N), machine.radius, machine.rough_frame, 2)
    targets, answers = [], []
    for index in range(planned.total):
        target = planned.target(index)
        reading = machine.measure(target.table_position, target.ball, target.approach)
        targets.append(Target(
            run_id, target.seq, 1, 1, int(target.phase), N, machine.radius, target.table_position, target.ball,
            target.cmm_position, target.table_angle, target.approach, (0.0, 0.0, 0.0), frame_id, 100 * target.seq))
        centre = FRAME.to_outer(reading.centre) if frame_id == 'machine' else reading.centre
        answers.append(Answer(
            run_id, target.seq, target.table_position, target.ball, target.cmm_position, 0, '', reading.table_angle,
            reading.table_travel, reading.approach, tuple(centre), 0.0, 20.0, frame_id, 100 * target.seq + 50))
    first_run = next(target.seq for target in targets if target.phase == Phase.RUN)
    assert 100 * (first_run - 1) <= FRAME_STAMP <= 100 * first_run
    return {'target': targets, 'answer': answers, 'frame': [(FRAME_STAMP, FRAME)],
            'expect': [(run_id, len(answers))]}


def feed(runs, topic, message, now=0.0):
    if topic == 'target':
        runs.add_target(message, now)
    elif topic == 'answer':
        runs.add_answer(message, now)
    elif topic == 'frame':
        runs.add_frame(TableFrame(*message))
    else:
        runs.expect(*message, now)


@functools.cache
def reference():
    runs = RunCollection()
    for topic, sent in messages().items():
        for message in sent:
            feed(runs, topic, message)
    return runs.to_run('a')


@settings(max_examples=30)
@given(st.randoms(use_true_random=False))
def test_any_order_between_the_topics_gives_the_same_run(rng):
    """It is ready with the last message, not before, and the numbers are the same to the bit."""
    runs = RunCollection()
    queues = {topic: list(sent) for topic, sent in messages().items()}
    left = [topic for topic, sent in queues.items() for _ in sent]
    rng.shuffle(left)
    for topic in left:
        assert runs.ready(0.0, 1.0) == []
        feed(runs, topic, queues[topic].pop(0))
    assert runs.ready(0.0, 1.0) == ['a']
    run, expected = runs.to_run('a'), reference()
    assert run.size == N * N
    assert np.array_equal(run.centre, expected.centre)
    assert run.repeatability == expected.repeatability
    assert runs.ready(0.0, 1.0) == []


def test_answers_in_the_table_frame_need_no_transform():
    """A CMM that knows the table frame is evaluated without /tf_static."""
    runs = RunCollection()
    for topic, sent in messages('cell2/table').items():
        for message in sent if topic != 'frame' else ():
            feed(runs, topic, message)
    assert runs.ready(0.0, 1.0) == ['a']
    assert runs.to_run('a').size == N * N


def test_frame_of_an_earlier_run_is_not_taken():
    """Only a frame found between first target and first RUN target belongs to the run."""
    runs = RunCollection()
    for stamp in (99, 5000):
        runs.add_frame(TableFrame(stamp, Frame.identity()))
    sent = messages()
    for topic in ('target', 'answer', 'expect'):
        for message in sent[topic]:
            feed(runs, topic, message)
    assert runs.ready(0.0, 1.0) == []
    ((run_id, words),) = runs.late(11.0, 10.0)
    assert (run_id, words) == ('a', 'wanted the table frame on /tf_static, got none for this run')
    runs.add_frame(TableFrame(*sent['frame'][0]))
    assert runs.ready(11.0, 1.0) == ['a']


def gathered(frames, frame_id='machine', session=lambda row: 1):
    """Return a RunCollection with a whole run and these frames; session: of a target by its row."""
    runs = RunCollection()
    for topic, sent in messages(frame_id).items():
        for message in sent if topic != 'frame' else ():
            row = message._replace(session=session(message)) if topic == 'target' else message
            feed(runs, topic, row)
    for frame in frames:
        runs.add_frame(TableFrame(*frame))
    return runs


def moved(size):
    """Return FRAME with its origin moved along x, m."""
    return Frame(FRAME.rotation, FRAME.origin + np.array([size, 0, 0]))


TWO_FRAMES = (r'run a: wanted one table frame for run a, got 2 that differ; two cells share /tf_static\? give each '
              'its namespace or domain')


@pytest.mark.parametrize('other', [
    moved(2e-12), moved(0.2), Frame(rotation_matrix(np.array([0, 0, 1e-6])), FRAME.origin)],
    ids=['a little', 'another machine', 'turned'])
@pytest.mark.parametrize('stamp', [100, FRAME_STAMP - 1, FRAME_STAMP, 900])
def test_two_frames_that_differ_are_refused(other, stamp):
    """From the first target (100 ns) to the first of the run (900 ns); no curve comes of either."""
    runs = gathered([(FRAME_STAMP, FRAME), (stamp, other)])
    assert runs.ready(0.0, 1.0) == ['a']
    with pytest.raises(InvalidData, match=TWO_FRAMES):
        runs.to_run('a')
    assert runs.ready(0.0, 1.0) == []


def test_the_same_frame_twice_is_one():
    """A log that is replayed, a latched message that is repeated: equal to 1e-12."""
    runs = gathered([(FRAME_STAMP, FRAME), (FRAME_STAMP, FRAME), (FRAME_STAMP - 100, moved(5e-13))])
    assert np.array_equal(runs.to_run('a').centre, reference().centre)


def test_frames_of_other_runs_do_not_contradict():
    """Before the first target and after the first of the run."""
    runs = gathered([(99, moved(0.2)), (FRAME_STAMP, FRAME), (901, moved(0.1))])
    assert np.array_equal(runs.to_run('a').centre, reference().centre)


def test_answers_in_the_table_frame_care_for_no_frame():
    """Whatever is latched by others."""
    runs = gathered([(FRAME_STAMP, FRAME), (FRAME_STAMP, moved(0.2))], 'table')
    assert runs.to_run('a').size == N * N


def test_a_frame_given_up_over_a_pause_does_not_contradict():
    """The alignment was gone on with in session 2 (from target 6 on), because a part of it had been lost."""
    frames = [(550, moved(1e-7)), (FRAME_STAMP, FRAME)]
    runs = gathered(frames, session=lambda row: 1 + (row.seq >= 6))
    assert np.array_equal(runs.to_run('a').centre, reference().centre)
    with pytest.raises(InvalidData, match='got 2 that differ'):
        gathered(frames).to_run('a')


def test_missing_answers_are_named():
    """A lost message is reported, not evaluated around."""
    runs = RunCollection()
    for topic, sent in messages().items():
        for message in sent if topic != 'answer' else sent[:-1]:
            feed(runs, topic, message)
    assert runs.ready(100.0, 1.0) == []
    ((_, words),) = runs.late(11.0, 10.0)
    assert words == 'wanted 18 targets with answers, got 18 targets and answers to 17 of them'


def test_run_without_states_is_evaluated_when_it_is_complete_and_quiet():
    """Where no sequencer tells states, n*n answers and a silence make the end."""
    runs = RunCollection()
    for topic, sent in messages().items():
        for message in sent if topic != 'expect' else ():
            feed(runs, topic, message, now=5.0)
    assert runs.ready(5.5, 1.0) == []
    assert runs.ready(6.0, 1.0) == ['a']


def test_run_that_is_still_told_about_is_not_evaluated_early():
    """With a sequencer that tells states, only its order counts."""
    runs = RunCollection()
    runs.note_state('a', 0.0)
    for topic, sent in messages().items():
        for message in sent if topic != 'expect' else ():
            feed(runs, topic, message)
    assert runs.ready(100.0, 1.0) == []


def test_what_the_log_holds_is_added_to_what_was_received():
    """The evaluator was restarted in the middle of the run: the first half is in the log alone."""
    sent = messages()
    runs, recorded = RunCollection(), RunAnswers('a', [TableFrame(*one) for one in sent['frame']])
    for target, answer in zip(sent['target'], sent['answer'], strict=True):
        recorded.add_target(target)
        if answer.seq <= 12:
            recorded.add_answer(answer)
        else:
            feed(runs, 'target', target)
            feed(runs, 'answer', answer)
    feed(runs, 'expect', sent['expect'][0])
    assert runs.lacking() == ['a']
    runs.add_recorded(recorded, 1.0)
    assert runs.lacking() == []
    assert np.array_equal(runs.to_run('a').centre, reference().centre)


def test_cancelled_run_is_forgotten():
    """Nothing is evaluated after a cancel, even if all answers are there."""
    runs = RunCollection()
    for topic, sent in messages().items():
        for message in sent:
            feed(runs, topic, message)
    runs.forget('a')
    runs.forget('unknown')
    assert runs.ready(0.0, 1.0) == []


def test_same_run_can_be_evaluated_again():
    """A replay of the same log a second time starts afresh."""
    runs = RunCollection()
    for _ in range(2):
        for topic, sent in messages().items():
            for message in sent:
                feed(runs, topic, message)
        assert runs.ready(0.0, 1.0) == ['a']
        assert runs.to_run('a').size == N * N


def test_only_the_last_runs_are_kept():
    """Memory stays flat over many runs."""
    runs = RunCollection()
    for name in 'abcdefgh':
        feed(runs, 'target', messages(run_id=name)['target'][0])
    with pytest.raises(KeyError):
        runs.to_run('a')


@pytest.mark.parametrize('texts', [1, 1_000_000])
def test_foreign_answers_take_bounded_memory_and_change_nothing(texts):
    """Answers to no target, to one target again and again, with long texts; the run is evaluated as without them."""
    runs, text = RunCollection(), '\x1b[31m' * texts
    foreign = BallCentre(run_id='a', status=BallCentre.STATUS_FAILED, text=text, header=Header(frame_id=text))
    for topic in ('target', 'frame'):
        for message in messages()[topic]:
            feed(runs, topic, message)
    for number in range(30_000 if texts == 1 else 200):
        foreign.seq = number if number % 2 else 1
        feed(runs, 'answer', answer_of(foreign))
    for message in messages()['answer']:
        feed(runs, 'answer', message)
    kept = runs._runs['a'].answers.answers
    assert len(kept) < 11_000
    assert max(len(answer.text) + len(answer.frame_id) for answer in kept) < 1100
    assert not any('\x1b' in answer.text + answer.frame_id for answer in kept)
    runs.expect('a', N * N, 0.0)
    assert runs.ready(0.0, 1.0) == ['a']
    assert runs.to_run('a').size == N * N


def test_an_answer_after_so_many_still_counts():
    """Of too many to one target the one that counts is kept, also when it is asked again."""
    answers = RunAnswers('a')
    target, answer = messages()['target'][0], messages()['answer'][0]
    for attempt in (1, 2):
        asked = target._replace(attempt=attempt, stamp_ns=attempt * 10**12)
        answers.add_target(asked)
        for number in range(300):
            answers.add_answer(answer._replace(stamp_ns=number))
        measured = answer._replace(stamp_ns=asked.stamp_ns + 1)
        answers.add_answer(measured)
        assert answers.answer_to(target.seq) == measured
    assert len(answers.answers) < 110
    assert answers.unused()['too many to be kept'] > 480
