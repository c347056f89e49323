# SPDX-License-Identifier: Apache-2.0
"""The sequence as a state machine: orders, late and wrong answers, ends."""

import dataclasses
import re

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from rosette_ros.core.geometry import Frame, rotation_matrix
from rosette_ros.core.scheme import ORDERS, plan
from rosette_ros.nodes.programme import Answer, Phase, make_programme
from rosette_ros.nodes.sequence import (
    Ask,
    Finish,
    Limits,
    Locate,
    Remark,
    Sequence,
    Tell,
    Verdict,
    judge,
)

RUN_ID = 'run_a'
TRUE = Frame(rotation_matrix(np.array([2e-4, -1e-4, 3e-4])), np.array([0.1003, 0.2, -0.0002]))
TAUGHT = Frame(np.eye(3), np.array([0.1, 0.2, 0.0]))
LIMITS = Limits(answer_timeout=2.0, attempts=3, evaluation_timeout=5.0)


def make_sequence(n=3, order='diagonal', limits=LIMITS, repeats=2):
    return Sequence(RUN_ID, make_programme(plan(n, order), 0.1, TAUGHT, repeats), limits)


def answer_to(ask, frame_id='machine', **changes):
    """Answer as a perfect CMM whose table truly is at TRUE."""
    target = ask.target
    centre = target.nominal if frame_id.endswith('table') else TRUE.to_outer(target.nominal)
    right = Answer(RUN_ID, target.seq, target.table_position, target.ball, target.cmm_position,
                   True, '', frame_id, target.table_angle, target.table_angle, centre)
    return dataclasses.replace(right, **changes)


def last_ask(commands):
    asks = [command for command in commands if isinstance(command, Ask)]
    assert len(asks) <= 1
    return asks[0] if asks else None


def run_through(sequence, frame_id='machine'):
    """Answer everything at once; return all commands in order."""
    commands = list(sequence.begin(0.0))
    ask = last_ask(commands)
    while ask:
        step = sequence.answer(answer_to(ask, frame_id), 0.0)
        commands += step
        ask = last_ask(step)
    return commands


@pytest.mark.parametrize('order', ORDERS)
def test_run_is_asked_in_the_order_of_the_scheme(order):
    """The RUN targets are those of the scheme, in its order, and evaluation follows."""
    sequence = make_sequence(4, order)
    asked = [c.target for c in run_through(sequence) if isinstance(c, Ask)]
    scheme = plan(4, order)
    run = [(t.table_position, t.ball) for t in asked if t.phase is Phase.RUN]
    assert run == list(zip(scheme.table_position.tolist(), scheme.ball.tolist(), strict=True))
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == sequence.programme.total


def test_alignment_finds_the_table():
    """After the alignment the targets lie where the table truly is."""
    commands = run_through(make_sequence(6))
    found = [c.frame for c in commands if isinstance(c, Locate)]
    assert len(found) == 1
    assert found[0].origin == pytest.approx(TRUE.origin, abs=1e-12)
    assert found[0].rotation == pytest.approx(TRUE.rotation, abs=1e-12)
    ask = next(c for c in commands if isinstance(c, Ask) and c.target.phase is Phase.RUN)
    assert ask.centre == pytest.approx(TRUE.to_outer(ask.target.nominal), abs=1e-12)
    assert ask.frame_id == 'machine'
    first = next(c for c in commands if isinstance(c, Ask))
    assert first.centre == pytest.approx([0.2, 0.2, 0.0])


def test_cmm_that_knows_the_table_frame_gets_targets_in_it():
    """Answers in the table frame need no transform: nothing is located."""
    commands = run_through(make_sequence(), 'cell1/table')
    assert not any(isinstance(c, Locate) for c in commands)
    ask = next(c for c in commands if isinstance(c, Ask) and c.target.phase is Phase.RUN)
    assert ask.frame_id == 'table'
    assert ask.centre == pytest.approx(ask.target.nominal)


def test_phase_changes_are_told():
    """One Tell per phase, none in between."""
    sequence = make_sequence()
    commands = run_through(sequence)
    assert sum(isinstance(c, Tell) for c in commands) == 5
    end = sequence.evaluated(1.0)
    assert end == (Tell(), Finish(Phase.DONE, 'error motions are published'))
    assert sequence.evaluated(1.0) == ()


def test_late_answer_is_asked_again_and_then_given_up():
    """Silence: attempts 2 and 3 after the timeout each, then FAILED in words."""
    sequence = make_sequence()
    first = last_ask(sequence.begin(10.0))
    assert (first.target.seq, first.attempt) == (1, 1)
    assert sequence.tick(11.9) == ()
    remark, second = sequence.tick(12.0)
    assert (second.target.seq, second.attempt) == (1, 2)
    assert 'no answer within 2 s; asking again' in remark.text
    assert last_ask(sequence.tick(14.0)).attempt == 3
    end = sequence.tick(16.0)[-1]
    assert end.phase is Phase.FAILED
    assert 'target 1 (table position 1, ball 1): asked 3 times, last: no answer within 2 s' \
        in end.text
    assert sequence.tick(100.0) == ()


def test_late_evaluation_ends_the_run():
    """No error motions in time: FAILED, and the words say that the log has everything."""
    sequence = make_sequence()
    run_through(sequence)
    assert sequence.tick(4.9) == ()
    end = sequence.tick(5.0)[-1]
    assert end.phase is Phase.FAILED
    assert 'wanted error motions from the evaluator within 5 s' in end.text


UNUSABLE = [
    ({'ok': False, 'text': 'collision'}, 'the CMM reports: collision'),
    ({'ok': False}, 'the CMM reports: failed, without a reason'),
    ({'centre': np.array([np.nan, 0, 0])}, 'wanted finite numbers, got centre \\(nan'),
    ({'table_angle': np.inf}, 'table_angle inf'),
    ({'ball': 2}, 'wanted table position, ball, CMM position \\(1, 1, 1\\), got \\(1, 2, 1\\)'),
    ({'table_position': 3}, 'got \\(3, 1, 1\\)'),
    ({'cmm_position': 2}, 'got \\(1, 1, 2\\)'),
    ({'frame_id': 'world'}, "wanted frame_id 'machine' or 'table', got 'world'"),
    ({'table_angle': 0.02}, 'wanted the table within 0.01 rad of 0.000000 rad, got 0.020000'),
    ({'centre': np.array([0.5, 0.2, 0.0])}, 'wanted a ball within 20 mm of the target, got 300'),
]


@pytest.mark.parametrize(('changes', 'words'), UNUSABLE)
def test_unusable_answer_is_asked_again_in_words(changes, words):
    """What is no measurement of this target is refused, and the target is asked again."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    wrong = answer_to(ask, **changes)
    remark, again = sequence.answer(wrong, 0.1)
    assert isinstance(remark, Remark)
    _check(words, remark.text)
    assert (again.target.seq, again.attempt) == (1, 2)
    sequence.answer(wrong, 0.2)
    end = sequence.answer(wrong, 0.3)[-1]
    assert end.phase is Phase.FAILED
    _check(words, end.text)


def _check(words, text):
    assert re.search(words, text), text


@pytest.mark.parametrize(('changes', 'words'), [
    ({'run_id': 'other'}, "answer to run 'other', this is 'run_a'"),
    ({'seq': 7}, 'answer to seq 7, waiting for seq 1'),
])
def test_answer_to_something_else_changes_nothing(changes, words):
    """A stray answer is remarked on and costs no attempt."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    (remark,) = sequence.answer(answer_to(ask, **changes), 0.1)
    assert words in remark.text
    assert last_ask(sequence.answer(answer_to(ask), 0.2)).target.seq == 2


def test_after_the_alignment_the_tolerance_is_smaller():
    """A ball 10 mm off is accepted while searching and refused once the table is known."""
    sequence = make_sequence()
    off = np.array([0.0, 0.0, 0.01])
    ask = last_ask(sequence.begin(0.0))
    while ask.target.phase is not Phase.RUN:
        assert judge(answer_to(ask, centre=answer_to(ask).centre + off), ask, RUN_ID,
                     LIMITS)[0] is Verdict.USE
        ask = last_ask(sequence.answer(answer_to(ask), 0.0))
    verdict, words = judge(answer_to(ask, centre=answer_to(ask).centre + off), ask, RUN_ID, LIMITS)
    assert verdict is Verdict.UNUSABLE
    assert 'within 5 mm of the target, got 10.000 mm' in words


def test_alignment_without_a_circle_fails_in_words():
    """A CMM that always finds the same point cannot be aligned to."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, search=1.0))
    ask = last_ask(sequence.begin(0.0))
    commands = ()
    while ask:
        commands = sequence.answer(answer_to(ask, centre=np.array([0.1, 0.2, 0.0])), 0.0)
        ask = last_ask(commands)
    assert commands[-1].phase is Phase.FAILED
    assert 'alignment: table axis' in commands[-1].text


def test_frames_must_not_change_within_the_alignment():
    """Half of the alignment in another frame is refused."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    while ask:
        frame = 'table' if ask.target.seq % 2 else 'machine'
        commands = sequence.answer(answer_to(ask, frame), 0.0)
        ask = last_ask(commands)
    assert 'wanted all centres in one frame, got machine, table' in commands[-1].text


def test_cancel_ends_at_once_and_only_once():
    """A cancelled sequence asks no more and takes no answer."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    assert sequence.cancel() == (Tell(), Finish(Phase.CANCELLED, 'cancelled on request'))
    assert sequence.cancel() == ()
    assert sequence.fail('x') == ()
    assert last_ask(sequence.answer(answer_to(ask), 1.0)) is None
    assert sequence.tick(1e9) == ()
    assert sequence.phase is Phase.CANCELLED


def test_text_names_what_is_measured():
    """One sentence for a person, with the place in the phase."""
    sequence = make_sequence()
    assert sequence.describe() == 'ready'
    sequence.begin(0.0)
    assert sequence.describe() == 'repeatability 1 of 2: table position 1, ball 1'
    sequence.tick(2.0)
    assert sequence.describe().endswith('ball 1, attempt 2')


EVENTS = st.sampled_from(['late', 'twice', 'other run', 'old', 'nan', 'failed', 'wrong ball',
                          'right', 'right', 'right'])


@hypothesis.given(n=st.integers(3, 5), order=st.sampled_from(sorted(ORDERS)),
       events=st.lists(EVENTS, max_size=120), attempts=st.integers(1, 4))
def test_whatever_comes_every_ball_is_taken_once_and_in_order(n, order, events, attempts):
    """Random faults: each accepted seq follows the last, no target beyond its attempts."""
    sequence = make_sequence(n, order, dataclasses.replace(LIMITS, attempts=attempts))
    now, old = 0.0, None
    ask = last_ask(sequence.begin(now))
    faults = 0
    for event in events:
        seq, attempt, done = ask.target.seq, ask.attempt, sequence.done
        assert seq == done + 1
        assert attempt == faults + 1
        if event == 'late':
            now += 2.0
            step = sequence.tick(now)
        elif event in ('twice', 'other run', 'old'):
            stray = {'twice': old or answer_to(ask, seq=seq + 1), 'old': answer_to(ask, seq=0),
                     'other run': answer_to(ask, run_id='b')}[event]
            step = sequence.answer(stray, now)
            assert [type(command) for command in step] == [Remark]
            continue
        else:
            wrong = {'nan': {'centre': np.full(3, np.nan)}, 'failed': {'ok': False},
                     'wrong ball': {'ball': ask.target.ball % n + 1}, 'right': {}}[event]
            given = answer_to(ask, **wrong)
            step = sequence.answer(given, now)
            old = given if event == 'right' else old
        faults = 0 if event == 'right' else faults + 1
        assert sequence.done == done + (event == 'right')
        ask = last_ask(step)
        if ask is None:
            break
    if faults == attempts:
        assert sequence.phase is Phase.FAILED
    elif ask is None:
        assert sequence.phase is Phase.EVALUATION
        assert sequence.done == sequence.programme.total
    else:
        assert not sequence.phase.is_end


def missed(sequence, ask, now=0.0):
    """Let the CMM fail a target as often as it is asked; return the last commands."""
    commands = ()
    while ask is not None and (last_ask(commands) or ask).target.seq == ask.target.seq:
        commands = sequence.answer(answer_to(last_ask(commands) or ask, ok=False, text='dirty'), now)
        if last_ask(commands) is None:
            break
    return commands


def until_run(sequence):
    """Answer everything before the n*n run; return its first ask."""
    ask = last_ask(sequence.begin(0.0))
    while ask.target.phase is not Phase.RUN:
        ask = last_ask(sequence.answer(answer_to(ask), 0.0))
    return ask


def test_a_ball_that_cannot_be_measured_is_left_out_and_told():
    """After its attempts the next ball is asked; the end says what is missing."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=1))
    ask = until_run(sequence)
    commands = missed(sequence, ask)
    assert re.search('asked 3 times, last: the CMM reports: dirty; left out, 1 of at most 1',
                     commands[0].text)
    following = last_ask(commands)
    assert following.target.seq == ask.target.seq + 1
    while following:
        following = last_ask(sequence.answer(answer_to(following), 0.0))
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == sequence.programme.total - 1
    end = sequence.evaluated(0.0)[-1]
    assert end.phase is Phase.DONE
    assert end.text == 'error motions are published; 1 left out: table position 1 ball 1'


def test_two_balls_in_a_row_or_too_many_end_the_run():
    """A CMM that is gone is not asked for every ball; the number is bounded."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=5))
    end = missed(sequence, last_ask(missed(sequence, until_run(sequence))))[-1]
    assert end.phase is Phase.FAILED
    assert 'the ball before it was left out too: the CMM seems to be gone' in end.text
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=1))
    ask = last_ask(missed(sequence, until_run(sequence)))
    ask = last_ask(sequence.answer(answer_to(ask), 0.0))
    end = missed(sequence, ask)[-1]
    assert end.phase is Phase.FAILED
    assert 'as many balls as allowed (1) were left out already; what was measured' in end.text


def test_nothing_is_left_out_of_the_alignment():
    """Without it the axis is not known."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=5), repeats=0)
    end = missed(sequence, last_ask(sequence.begin(0.0)))[-1]
    assert end.phase is Phase.FAILED
    assert 'dirty; what was measured is in the log' in end.text
