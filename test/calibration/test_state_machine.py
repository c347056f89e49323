# SPDX-License-Identifier: Apache-2.0
"""The sequence as a state machine: orders, late and wrong answers, ends."""

import dataclasses
import re

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from sequences import LIMITS, TRUE, answer_to, last_ask, make_sequence, moved, nominal, results_of, run_through

from rosette_ros.calibration.goal import Job, Request
from rosette_ros.calibration.state_machine import (
    PACE_FROM,
    Ask,
    Finish,
    Locate,
    PublishState,
    Sequence,
    Warn,
    complaint,
)
from rosette_ros.core.run.scheme import ORDERS, plan
from rosette_ros.io.messages import STATUS_REFUSED, Phase
from rosette_ros.words.reading_words import remark_words


@pytest.mark.parametrize('order', ORDERS)
def test_run_is_asked_in_the_order_of_the_scheme(order):
    """The RUN targets are those of the scheme, in its order, and evaluation follows."""
    sequence = make_sequence(4, order)
    asked = [c.target for c in run_through(sequence) if isinstance(c, Ask)]
    scheme = plan(4, order)
    run = [(t.table_position, t.ball) for t in asked if t.phase is Phase.RUN]
    assert run == list(zip(scheme.table_position.tolist(), scheme.ball.tolist(), strict=True))
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == sequence.plan.total


def test_alignment_finds_the_table():
    """After the alignment the targets lie where the table truly is."""
    commands = run_through(make_sequence(6))
    found = [c.frame for c in commands if isinstance(c, Locate)]
    assert len(found) == 1
    assert found[0].origin == pytest.approx(TRUE.origin, abs=1e-12)
    assert found[0].rotation == pytest.approx(TRUE.rotation, abs=1e-12)
    ask = next(c.target for c in commands if isinstance(c, Ask) and c.target.phase is Phase.RUN)
    assert ask.centre == pytest.approx(TRUE.to_outer(nominal(ask)), abs=1e-12)
    assert ask.frame_id == 'machine'
    first = next(c.target for c in commands if isinstance(c, Ask))
    assert first.centre == pytest.approx([0.2, 0.2, 0.0])


def test_cmm_that_knows_the_table_frame_gets_targets_in_it():
    """Answers in the table frame need no transform: nothing is located."""
    commands = run_through(make_sequence(), 'cell1/table')
    assert not any(isinstance(c, Locate) for c in commands)
    ask = next(c.target for c in commands if isinstance(c, Ask) and c.target.phase is Phase.RUN)
    assert ask.frame_id == 'table'
    assert ask.centre == pytest.approx(nominal(ask))


def test_phase_changes_are_published():
    """One state per phase, none in between."""
    sequence = make_sequence()
    commands = run_through(sequence)
    assert sum(isinstance(c, PublishState) for c in commands) == 5
    end = sequence.evaluated(results_of(sequence))
    assert end == (PublishState(), Finish(Phase.DONE, 'error motions are published'))
    assert sequence.evaluated(results_of(sequence)) == ()


def test_late_answer_is_asked_again_and_then_given_up():
    """Silence: attempts 2 and 3 after the timeout each, then FAILED in words."""
    sequence = make_sequence()
    first = last_ask(sequence.begin(10.0))
    assert (first.seq, first.attempt) == (1, 1)
    assert sequence.tick(11.9) == ()
    remark, second = sequence.tick(12.0)
    second = second.target
    assert (second.seq, second.attempt) == (1, 2)
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
    sequence.disturbed.append('2 nodes publish ball_centre')
    assert sequence.tick(4.9) == ()
    end = sequence.tick(5.0)[-1]
    assert end.phase is Phase.FAILED
    assert 'expected error motions from the evaluator within 5 s' in end.text
    assert end.text.endswith('offline; 2 nodes publish ball_centre for a while: it may hold answers of both')


UNUSABLE = [
    ({'status': 1, 'text': 'collision'}, 'the CMM reports: collision'),
    ({'status': 1}, 'the CMM reports: failed, without a reason'),
    ({'centre': (np.nan, 0.0, 0.0)}, 'expected finite numbers, found centre \\(nan'),
    ({'table_angle': np.inf}, 'table_angle inf'),
    ({'ball': 2}, 'expected table position, ball, CMM position \\(1, 1, 1\\), found \\(1, 2, 1\\)'),
    ({'table_position': 3}, 'found \\(3, 1, 1\\)'),
    ({'cmm_position': 2}, 'found \\(1, 1, 2\\)'),
    ({'frame_id': 'world'}, "expected frame_id 'machine' or 'table', found 'world'"),
    ({'table_angle': 0.02}, 'expected the table within 0.01 rad of 0.000000 rad, found 0.020000'),
    ({'centre': (0.5, 0.2, 0.0)}, 'expected a ball within 20 mm of the target, found 300'),
]


@pytest.mark.parametrize(('changes', 'words'), UNUSABLE)
def test_unusable_answer_is_asked_again_in_words(changes, words):
    """What is no measurement of this target is refused, and the target is asked again."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    wrong = answer_to(ask, **changes)
    remark, again = sequence.answer(wrong, 0.1)
    again = again.target
    assert isinstance(remark, Warn)
    _check(words, remark.text)
    assert (again.seq, again.attempt) == (1, 2)
    sequence.answer(wrong, 0.2)
    end = sequence.answer(wrong, 0.3)[-1]
    assert end.phase is Phase.FAILED
    _check(words, end.text)


def _check(words, text):
    assert re.search(words, text), text


def test_answers_to_something_else_change_nothing():
    """Those to another run are remarked on; those to other targets once, with their number, when the next is asked."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    (remark,) = sequence.answer(answer_to(ask, run_id='other'), 0.1)
    assert "answer to run 'other', this is 'run_a'" in remark.text
    for now, seqs, words in ((0.1, [7], 'answer to seq 7'), (9.0, [7] * 29, '29 answers to seq 7'),
                             (99.0, [7, 5, 9], '3 answers to seq 5 to 9')):
        for seq in seqs:
            assert sequence.answer(answer_to(ask, seq=seq), now) == ()
        remark, *_, asked = sequence.answer(answer_to(ask), now) if ask.seq < 2 else sequence.tick(now)
        assert remark == Warn(f'not used: {words}, waiting for seq {ask.seq}')
        ask = asked.target
    assert (ask.seq, ask.attempt) == (2, 3), 'one was answered, one was late twice'


def test_a_cmm_that_answers_ahead_is_told_that():
    """Its answers to later targets are those of this ball: it was told that its table turns the other way."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    while ask.table_position == 1:
        for ahead in range(1, 30):
            sequence.answer(answer_to(ask, seq=ask.seq + ahead), 0.1)
        ask = last_ask(sequence.answer(answer_to(ask), 0.1))
    for _ in range(LIMITS.attempts):
        end = sequence.answer(answer_to(ask, table_position=1, cmm_position=1), 0.1)[-1]
    assert end.phase is Phase.FAILED
    _check(r'; 87 answers were to targets that had not been asked: the CMM has to answer the target that is asked, '
           'once$', end.text)
    assert 'table counts' not in end.text


def test_after_the_alignment_the_tolerance_is_smaller():
    """A ball 10 mm off is accepted while searching and refused once the table is known."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    while ask.phase is not Phase.RUN:
        assert complaint(moved(answer_to(ask), 0, 0, 0.01), ask, LIMITS) is None
        ask = last_ask(sequence.answer(answer_to(ask), 0.0))
    assert 'within 5 mm of the target, found 10.000 mm' in remark_words(
        complaint(moved(answer_to(ask), 0, 0, 0.01), ask, LIMITS))


def test_alignment_without_a_circle_fails_in_words():
    """A CMM that always finds the same point cannot be aligned to."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, search=1.0))
    ask = last_ask(sequence.begin(0.0))
    commands = ()
    while ask:
        commands = sequence.answer(answer_to(ask, centre=(0.1, 0.2, 0.0)), 0.0)
        ask = last_ask(commands)
    assert commands[-1].phase is Phase.FAILED
    assert 'alignment: table axis' in commands[-1].text


def test_a_cmm_whose_frames_change_with_the_targets_ends_the_run():
    """Half of the alignment is in another frame, also when it is asked again; the next part of the run heals that."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    while ask:
        commands = sequence.answer(answer_to(ask, 'table' if ask.seq % 2 else 'machine'), 0.0)
        ask = last_ask(commands)
    assert re.search("expected all centres in '(machine|table)' as most, found others before", commands[-1].text)
    again = Sequence(sequence.run_id, sequence.plan, sequence.limits, sequence.answers)
    run_through(again)
    assert again.phase is Phase.EVALUATION


@pytest.mark.parametrize('frame', ['machine', 'table'])
@pytest.mark.parametrize('wrong', [{1}, {2}, {1, 2}, {3}, {5}, {8}, {9}, {1, 5, 12}])
def test_an_answer_in_another_frame_is_asked_again(wrong, frame):
    """Wherever it is, the first one of all as well: the run goes on in the frame of most, with the numbers of a run
    without it."""
    other, sequence, right = {'machine': 'table', 'table': 'machine'}[frame], make_sequence(), make_sequence()
    run_through(right, frame)
    commands, asked = sequence.begin(0.0), []
    while ask := last_ask(commands):
        asked.append(ask.seq)
        commands = sequence.answer(answer_to(ask, other if ask.seq in wrong and ask.attempt == 1 else frame), 0.0)
    assert sequence.phase is Phase.EVALUATION
    assert {seq for seq in asked if asked.count(seq) > 1} >= wrong
    assert len(asked) <= sequence.plan.total + 2 * len(wrong)
    assert sequence.done == sequence.answers.answered == sequence.plan.total
    assert [one.centre for _, one in sequence.answers.counting()] == [one.centre for _, one in right.answers.counting()]
    assert sequence.answers.is_in_table_frame == (frame == 'table')


def test_cancel_ends_at_once_and_only_once():
    """A cancelled sequence asks no more and takes no answer."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    assert sequence.cancel() == (PublishState(), Finish(Phase.CANCELLED, 'cancelled on request'))
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
        seq, attempt, done = ask.seq, ask.attempt, sequence.done
        assert seq == done + 1
        assert attempt == faults + 1
        if event == 'late':
            now += 2.0
            step = sequence.tick(now)
        elif event in ('twice', 'other run', 'old'):
            stray = {'twice': old or answer_to(ask, seq=seq + 1), 'old': answer_to(ask, seq=0),
                     'other run': answer_to(ask, run_id='b')}[event]
            step = sequence.answer(stray, now)
            assert [type(command) for command in step] == [Warn] * (event == 'other run')
            continue
        else:
            wrong = {'nan': {'centre': (np.nan,) * 3}, 'failed': {'status': 1},
                     'wrong ball': {'ball': ask.ball % n + 1}, 'right': {}}[event]
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
        assert sequence.done == sequence.plan.total
    else:
        assert not sequence.phase.is_end


def test_a_refused_target_is_not_asked_again():
    """It would be refused again: the run ends at once in the alignment, and leaves it out later."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    end = sequence.answer(answer_to(ask, status=STATUS_REFUSED, text='too near to ball 2'), 0.1)[-1]
    assert end.phase is Phase.FAILED
    assert 'asked once, last: the CMM reports: too near to ball 2' in end.text
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=1))
    ask = until_run(sequence)
    commands = sequence.answer(answer_to(ask, status=STATUS_REFUSED, text='too near'), 0.2)
    assert last_ask(commands).seq == ask.seq + 1
    assert [one.seq for one in sequence.skipped] == [ask.seq]


def missed(sequence, ask, now=0.0):
    """Let the CMM fail a target as often as it is asked; return the last commands."""
    commands = ()
    while ask is not None and (last_ask(commands) or ask).seq == ask.seq:
        commands = sequence.answer(answer_to(last_ask(commands) or ask, status=1, text='dirty'), now)
        if last_ask(commands) is None:
            break
    return commands


def until_run(sequence):
    """Answer everything before the n*n run; return its first ask."""
    ask = last_ask(sequence.begin(0.0))
    while ask.phase is not Phase.RUN:
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
    assert following.seq == ask.seq + 1
    while following:
        following = last_ask(sequence.answer(answer_to(following), 0.0))
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == sequence.plan.total - 1
    end = sequence.evaluated(results_of(sequence))[-1]
    assert end.phase is Phase.DONE
    assert end.text == 'error motions are published; 1 left out: table position 1 ball 1'


def test_two_balls_in_a_row_or_too_many_end_the_run():
    """A CMM that is disconnected is not asked for every ball; the number is bounded."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=5))
    end = missed(sequence, last_ask(missed(sequence, until_run(sequence))))[-1]
    assert end.phase is Phase.FAILED
    assert 'the ball before it was left out too: the CMM seems to be disconnected' in end.text
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=1))
    ask = last_ask(missed(sequence, until_run(sequence)))
    ask = last_ask(sequence.answer(answer_to(ask), 0.0))
    end = missed(sequence, ask)[-1]
    assert end.phase is Phase.FAILED
    assert 'as many balls as allowed (1) were left out already' in end.text


def test_nothing_is_left_out_of_the_alignment():
    """Without it the axis is not known."""
    sequence = make_sequence(limits=dataclasses.replace(LIMITS, skips=5), repeats=0)
    end = missed(sequence, last_ask(sequence.begin(0.0)))[-1]
    assert end.phase is Phase.FAILED
    assert end.text.endswith('dirty')


def test_mistakes_of_the_cmm_are_told_after_the_alignment():
    """A node that never fills header.stamp, and whose travel starts again at every turn, no noise: before the run."""
    commands = run_through(make_sequence(6))
    texts = [command.text for command in commands if isinstance(command, Warn)]
    assert len(texts) == 3
    assert texts[0].startswith('header.stamp is 0 in 14 of 14 answers')
    assert texts[1].startswith('table_travel is not cumulative')
    assert texts[2].startswith('the 2 readings of the repeatability check are all the same')
    located = next(place for place, command in enumerate(commands) if isinstance(command, Locate))
    assert all(isinstance(command, Warn) for command in commands[located + 1:located + 4])


def test_units_that_are_taken_for_others_are_named():
    """Degrees for radians, millimetres for metres."""
    sequence = make_sequence(6)
    ask = last_ask(sequence.begin(0.0))
    while ask.table_position < 2:
        ask = last_ask(sequence.answer(answer_to(ask), 0.0))
    right = answer_to(ask)
    for wrong, advice in (({'table_angle': 60.0}, 'that is degrees, give radians'),
                          ({'centre': tuple(1e3 * x for x in right.centre)}, 'these are millimetres, give metres')):
        assert remark_words(complaint(right._replace(**wrong), ask, LIMITS)).endswith(f'; {advice}')


def test_a_long_run_tells_how_long_it_goes_on():
    """A ball takes 30 s: of 51 targets 41 are left after ten of them, for 20.5 min; a pause is no part of the pace."""
    sequence = make_sequence(6)
    ask = last_ask(sequence.begin(0.0))
    for count in range(1, 11):
        assert (sequence.left is None) == (count <= PACE_FROM)
        ask = last_ask(sequence.answer(answer_to(ask), 30.0 * count))
    assert sequence.plan.total == 51
    assert sequence.left == 1230.0
    assert sequence.describe() == 'alignment 9 of 12: table position 1, ball 3, about 20 min left'
    assert Job(sequence, Request('test'), 'diagonal').progress == 'alignment, 10 of 51 balls'
    sequence.hold('the CMM is disconnected', 310.0)
    sequence.resume_asking(4000.0, restarted=True)
    assert sequence.left is None


def test_an_answer_without_run_id_is_told_what_to_repeat():
    """In the words that the cell shows."""
    sequence = make_sequence()
    ask = last_ask(sequence.begin(0.0))
    [remark] = sequence.answer(answer_to(ask)._replace(run_id=''), 0.0)
    assert remark.text == ("not used: answer to run '', this is 'run_a'; "
                           'an answer repeats run_id and seq of its target')
