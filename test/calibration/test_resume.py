# SPDX-License-Identifier: Apache-2.0
"""Going on with a run: what is taken from its log, what is asked again, what is refused."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sequences import LIMITS, RUN_ID, TAUGHT, answer_to, last_ask, moved, run_through

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.calibration.goal import Request, earlier_answers, make_job, refuse_other_plan
from rosette_ros.calibration.settings import LIMITS as LIMIT_SETTINGS
from rosette_ros.calibration.settings import PLANNED, format_settings, parse_settings
from rosette_ros.calibration.state_machine import Ask, Finish, Locate, Sequence, Warn
from rosette_ros.core.run.errors import CellError, InvalidConfig
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import Phase
from rosette_ros.io.plan_file import MeasuringPlan, format_plan
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.nodes import conversions

SETTINGS = {wanted.name: wanted.default for wanted in PLANNED + LIMIT_SETTINGS}
OWN = format_plan(MeasuringPlan(plan(3), 0.1))
PLAN = plan_calibration(plan(3, 'diagonal'), 0.1, TAUGHT, 2)


def asked(sequence):
    """Return the targets that a run asks for where all are answered."""
    return [command.target for command in run_through(sequence) if isinstance(command, Ask)]


def earlier(count, session=1):
    """Return the RunAnswers of the first `count` targets of an undisturbed run."""
    known = RunAnswers(RUN_ID)
    for target in asked(Sequence(RUN_ID, PLAN, LIMITS))[:count]:
        known.add_target(target._replace(session=session))
        known.add_answer(answer_to(target, stamp_ns=target.seq))
    return known


@given(count=st.integers(0, PLAN.total))
def test_only_what_is_missing_is_asked(count):
    """Wherever the run was broken off: the rest, in order, in the next session; the frame is found again."""
    whole = asked(Sequence(RUN_ID, PLAN, LIMITS))
    sequence = Sequence(RUN_ID, PLAN, LIMITS, earlier(count))
    commands = run_through(sequence)
    asks = [command.target for command in commands if isinstance(command, Ask)]
    assert [ask.seq for ask in asks] == [ask.seq for ask in whole[count:]]
    assert all(np.array_equal(a.centre, b.centre) for a, b in zip(asks, whole[count:], strict=True))
    assert {ask.session for ask in asks} <= {2 if count else 1}
    assert sum(isinstance(command, Locate) for command in commands) == 1
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == PLAN.total


def test_a_gap_and_an_unusable_answer_are_asked_again():
    """What was left out and what was refused then is asked now, as a further attempt."""
    known, whole = RunAnswers(RUN_ID), earlier(PLAN.total, session=4)
    for target in whole.targets:
        known.add_target(target)
        if target.seq == 11:
            known.add_target(target._replace(attempt=3))
    for answer in whole.answers:
        if answer.seq != 11:
            known.add_answer(moved(answer, 1.0, 1.0, 1.0) if answer.seq == 13 else answer)
    asks = asked(Sequence(RUN_ID, PLAN, LIMITS, known))
    assert [(ask.seq, ask.attempt, ask.session) for ask in asks] == [(11, 4, 5), (13, 2, 5)]


def test_what_the_disk_refused_and_the_sequencer_has_is_not_asked_again():
    """A log on a full disk lacks the last answers; those of another run do not count."""
    whole = earlier(PLAN.total)
    recalled = SimpleNamespace(
        success=True, run_id=RUN_ID, log='run_a', targets=list(map(conversions.target_message, whole.targets[:14])),
        answers=list(map(conversions.answer_message, whole.answers[:12])),
        events=[SimpleNamespace(kind=2, settings=format_settings(
            {**SETTINGS, 'plate.balls': 3, 'plate.radius_m': 0.1, 'order': 'diagonal', 'repeats': 2}))])
    for run_id, taken in ((RUN_ID, PLAN.total), ('another', 12)):
        whole.run_id = run_id
        job = make_job(Request('calibrate', {'resume': RUN_ID}), SETTINGS, set(), recalled, whole)
        assert [answer.seq for answer in job.sequence.answers.answers] == [*range(1, taken + 1)]
        assert job.sequence.answers.answered == taken


def test_hold_and_resume():
    """While a node is away nothing is asked; its answer still counts; then the next target comes."""
    sequence = Sequence(RUN_ID, PLAN, LIMITS)
    ask = last_ask(sequence.begin(0.0))
    commands = sequence.hold('the CMM is disconnected', 1.0)
    assert commands[0] == Warn('the CMM is disconnected; the run waits for it')
    assert sequence.describe() == 'the CMM is disconnected; waiting for it'
    assert last_ask(sequence.answer(answer_to(ask), 2.0)) is None
    assert sequence.done == 1
    following = last_ask(sequence.resume_asking(3.0, restarted=False))
    assert (following.seq, following.session, following.attempt) == (2, 1, 1)
    assert sequence.resume_asking(3.0, restarted=False) == ()


def test_after_a_pause_the_target_is_asked_again_in_a_new_session():
    """A CMM that was started anew does not know what it was asked."""
    sequence = Sequence(RUN_ID, PLAN, LIMITS)
    sequence.begin(0.0)
    sequence.hold('the CMM is disconnected', 1.0)
    again = last_ask(sequence.resume_asking(2.0, restarted=True))
    assert (again.seq, again.session, again.attempt) == (1, 2, 2)
    assert last_ask(sequence.answer(answer_to(again), 2.0)).session == 2


def test_after_a_pause_the_approach_is_stated():
    """Nobody knows how the table then stands, so that "no move" would be no approach."""
    sequence = Sequence(RUN_ID, PLAN, LIMITS)
    second = last_ask(sequence.answer(answer_to(last_ask(sequence.begin(0.0))), 0.0))
    assert second.approach == 0
    sequence.hold('the CMM is disconnected', 1.0)
    assert last_ask(sequence.resume_asking(2.0, restarted=True)).approach == 1
    asks = asked(Sequence(RUN_ID, PLAN, LIMITS, earlier(1)))
    assert [ask.approach for ask in asks[:2]] == [1, 0]


def test_who_does_not_come_back_ends_the_run():
    """After the patience, in words that say what to do."""
    sequence = Sequence(RUN_ID, PLAN, LIMITS)
    sequence.begin(0.0)
    sequence.hold('the recorder is disconnected', 1.0)
    assert sequence.tick(1.0 + LIMITS.return_timeout - 0.1) == ()
    end = sequence.tick(1.0 + LIMITS.return_timeout)[-1]
    assert end == Finish(Phase.FAILED, 'the recorder is disconnected and did not come back within 60 s; resume the '
                         'run when it is connected')


def test_all_that_was_received_is_kept_as_the_log_has_it():
    """Late, repeated, unusable: evaluator and recorder then find the same readings as any reader of the log."""
    sequence = Sequence(RUN_ID, PLAN, LIMITS)
    ask = last_ask(sequence.begin(0.0))
    away = moved(answer_to(ask, stamp_ns=1), 1.0, 1.0, 1.0)
    again = last_ask(sequence.answer(away, 1.0))
    for stamp_ns in 2, 3:
        sequence.answer(answer_to(again, stamp_ns=stamp_ns), 1.0)
    assert [answer.stamp_ns for answer in sequence.answers.answers] == [1, 2, 3]
    assert [target.attempt for target in sequence.answers.targets] == [1, 2, 1]
    assert sequence.done == 1


def test_no_target_is_asked_before_the_answer_that_was_taken():
    """By its stamp, where the clock of the CMM is ahead or was set back; an answer that is not taken does not count."""
    sequence = Sequence(RUN_ID, PLAN, LIMITS)
    sequence.clock = iter((5, 6, 3, 90)).__next__
    ask = last_ask(sequence.begin(0.0))
    again = last_ask(sequence.answer(moved(answer_to(ask, stamp_ns=99), 1.0, 1.0, 1.0), 1.0))
    following = last_ask(sequence.answer(answer_to(again, stamp_ns=20), 1.0))
    last = last_ask(sequence.answer(answer_to(following, stamp_ns=30), 1.0))
    assert [one.stamp_ns for one in (ask, again, following, last)] == [5, 6, 20, 90]
    assert last_ask(Sequence(RUN_ID, PLAN, LIMITS, sequence.answers).begin(0.0)).stamp_ns == 99


# What a log tells


def recalled(rows, answered, **changes):
    """Return a Recall.Response without ROS; rows: (seq, attempt, session) of its targets; answered: seqs."""
    whole = earlier(PLAN.total)
    targets = []
    for row, (seq, attempt, session) in enumerate(rows):
        target = whole.last_target(min(seq, PLAN.total))._replace(seq=seq, attempt=attempt, session=session)
        targets.append(message(target._replace(**{name: values[row] for name, values in changes.items()})))
    return SimpleNamespace(run_id=RUN_ID, targets=targets, answers=[message(whole.answer_to(seq)) for seq in answered])


def message(record):
    """Return a record in the shape of its message."""
    stamp = SimpleNamespace(sec=record.stamp_ns // 10**9, nanosec=record.stamp_ns % 10**9)
    points = {name: SimpleNamespace(**dict(zip('xyz', getattr(record, name)))) for name in ('centre', 'pole')
              if hasattr(record, name)}
    return SimpleNamespace(**{**record._asdict(), **points,
                              'header': SimpleNamespace(frame_id=record.frame_id, stamp=stamp)})


def test_answers_attempts_and_session_are_found_in_the_log():
    """Of each target the last attempt, of the run the last session."""
    found = earlier_answers(recalled([(1, 1, 1), (2, 1, 1), (2, 2, 3), (3, 1, 3)], [1, 2]), PLAN)
    assert [target.seq for target, _ in found.counting()] == [1, 2]
    assert [found.last_target(seq).attempt for seq in (1, 2, 3)] == [1, 2, 1]
    assert found.session == 3


@pytest.mark.parametrize(('changed', 'got'), [
    ({'ball': [3, 3]}, 'target 1: expected target 1 (table position 1, ball 1) as planned, the log has table '
                       'position 1, ball 3 of 3'),
    ({'balls': [3, 4]}, 'target 2'), ({'radius': [0.1, 0.2]}, 'target 2'), ({'phase': [1, 3]}, 'target 2'),
    ({'seq': [1, 99]}, f'target 99: expected one of {PLAN.total} targets')])
def test_a_log_of_another_plan_is_refused(changed, got):
    """Its answers would stand at the wrong places."""
    with pytest.raises(CellError) as error:
        earlier_answers(recalled([(1, 1, 1), (2, 1, 1)], [1], **changed), PLAN)
    assert got in str(error.value)
    assert 'the run was planned with other settings' in str(error.value)


def test_settings_survive_the_log():
    """What decides the targets comes back the same; another wish is refused."""
    found = parse_settings(format_settings(SETTINGS), 'here')
    assert found == {wanted.name: SETTINGS[wanted.name] for wanted in PLANNED}
    refuse_other_plan({'order': 'interleaved', 'limits.attempts': 1}, found, 'a')
    with pytest.raises(CellError, match="order: expected 'interleaved' as the run began, found 'row'; leave it out"):
        refuse_other_plan({'order': 'row'}, found, 'a')


@pytest.mark.parametrize('text', ['', '[1]', 'order: {', 'order: row'])
def test_spoilt_settings_are_refused(text):
    """Half a plan is none."""
    with pytest.raises(InvalidConfig, match='here: '):
        parse_settings(text, 'here')


def test_a_pause_that_is_planned_ends_the_run_until_it_is_resumed():
    """After the last reading of a session nothing is asked; resumed, the rest is asked in the next session."""
    scheme = plan(3, 'diagonal')
    whole = plan_calibration(replace(scheme, session=1 + np.arange(9) // 5), 0.1, TAUGHT, 2)
    first = Sequence(RUN_ID, whole, LIMITS)
    asks = asked(first)
    assert (first.phase, len(asks), {ask.session for ask in asks}) == (Phase.CANCELLED, 2 + 6 + 5, {1})
    assert first.is_paused and first.text == (
        'session 1 of 2 of the plan is measured; the plan has a pause here, resume the run after it')
    known = RunAnswers(RUN_ID)
    for target in asks:
        known.add_target(target)
        known.add_answer(answer_to(target, stamp_ns=target.seq))
    second = Sequence(RUN_ID, whole, LIMITS, known)
    assert {ask.session for ask in asked(second)} == {2} and second.done == whole.total and not second.is_paused


def test_a_run_of_a_plan_is_resumed_with_that_plan_alone():
    """Another plan, or an order, is refused in one short line."""
    planned = parse_settings(f'{format_settings(SETTINGS)}plan: {json.dumps(OWN)}\n', 'log')
    refuse_other_plan({'plan': OWN}, planned, RUN_ID)
    with pytest.raises(CellError, match='run run_a: plan: expected the one as the run began, found another; leave it '
                                        'out'):
        refuse_other_plan({'plan': OWN.replace('radius_mm: 100', 'radius_mm: 101')}, planned, RUN_ID)
