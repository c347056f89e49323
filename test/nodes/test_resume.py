# SPDX-License-Identifier: Apache-2.0
"""Going on with a run: what is taken from its log, what is asked again, what is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_sequence import LIMITS, RUN_ID, TAUGHT, answer_to, last_ask, run_through

from rosette_ros.core.errors import CellError, InvalidConfig, InvalidData
from rosette_ros.core.scheme import plan
from rosette_ros.data.assemble import AnswerTable, TargetTable
from rosette_ros.data.schemas import TypeLibrary
from rosette_ros.nodes.programme import Phase, make_programme
from rosette_ros.nodes.recalling import find_part, next_part, parts_of, recall
from rosette_ros.nodes.resume import check_wishes, earlier_of
from rosette_ros.nodes.sequence import VERIFY_ROUNDS, Ask, Earlier, Finish, Locate, Remark, Sequence, Verify
from rosette_ros.nodes.settings import LIMITS as LIMIT_SETTINGS
from rosette_ros.nodes.settings import PLANNED, format_settings, parse_settings

SETTINGS = {wanted.name: wanted.default for wanted in PLANNED + LIMIT_SETTINGS}
PROGRAMME = make_programme(plan(3, 'diagonal'), 0.1, TAUGHT, 2)


def answers_up_to(count):
    """Return the good answers, by seq, of the first `count` targets of an undisturbed run."""
    asks = [command for command in run_through(Sequence(RUN_ID, PROGRAMME, LIMITS)) if isinstance(command, Ask)]
    return {ask.target.seq: answer_to(ask, stamp_ns=ask.target.seq) for ask in asks[:count]}


def earlier(answers, session=1):
    """Return the Earlier of answers that were given at the first time of asking."""
    return Earlier(answers, dict.fromkeys(answers, 1), session)


@given(count=st.integers(0, PROGRAMME.total))
def test_only_what_is_missing_is_asked(count):
    """Wherever the run was broken off: the rest, in order, in the next session; the frame is found again."""
    whole = [command for command in run_through(Sequence(RUN_ID, PROGRAMME, LIMITS)) if isinstance(command, Ask)]
    sequence = Sequence(RUN_ID, PROGRAMME, LIMITS, earlier(answers_up_to(count)))
    commands = run_through(sequence)
    asks = [command for command in commands if isinstance(command, Ask)]
    assert [ask.target.seq for ask in asks] == [ask.target.seq for ask in whole[count:]]
    assert all(np.array_equal(a.centre, b.centre) for a, b in zip(asks, whole[count:], strict=True))
    assert {ask.session for ask in asks} <= {2}
    assert sum(isinstance(command, Locate) for command in commands) == 1
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == PROGRAMME.total


def test_a_gap_and_an_unusable_answer_are_asked_again():
    """What was left out and what was refused then is asked now, as a further attempt."""
    answers = answers_up_to(PROGRAMME.total)
    del answers[11]
    answers[13] = dataclasses.replace(answers[13], centre=answers[13].centre + 1.0)
    known = Earlier(answers, {**dict.fromkeys(answers, 1), 11: 3}, 4)
    asks = [one for one in run_through(Sequence(RUN_ID, PROGRAMME, LIMITS, known)) if isinstance(one, Ask)]
    assert [(ask.target.seq, ask.attempt, ask.session) for ask in asks] == [(11, 4, 5), (13, 2, 5)]


def test_hold_and_go_on():
    """While a node is away nothing is asked; its answer still counts; then the next target comes."""
    sequence = Sequence(RUN_ID, PROGRAMME, LIMITS)
    ask = last_ask(sequence.begin(0.0))
    commands = sequence.hold('the CMM has gone', 1.0)
    assert commands[0] == Remark('the CMM has gone; the run waits for it')
    assert sequence.describe() == 'the CMM has gone; waiting for it'
    assert last_ask(sequence.answer(answer_to(ask), 2.0)) is None
    assert sequence.done == 1
    following = last_ask(sequence.go_on(3.0, anew=False))
    assert (following.target.seq, following.session, following.attempt) == (2, 1, 1)
    assert sequence.go_on(3.0, anew=False) == ()


def test_after_a_pause_the_target_is_asked_again_in_a_new_session():
    """A CMM that was started anew does not know what it was asked."""
    sequence = Sequence(RUN_ID, PROGRAMME, LIMITS)
    sequence.begin(0.0)
    sequence.hold('the CMM has gone', 1.0)
    again = last_ask(sequence.go_on(2.0, anew=True))
    assert (again.target.seq, again.session, again.attempt) == (1, 2, 2)
    assert last_ask(sequence.answer(answer_to(again), 2.0)).session == 2


def test_who_does_not_come_back_ends_the_run():
    """After the patience, in words that say what to do."""
    sequence = Sequence(RUN_ID, PROGRAMME, LIMITS)
    sequence.begin(0.0)
    sequence.hold('the recorder has gone', 1.0)
    assert sequence.tick(1.0 + LIMITS.return_timeout - 0.1) == ()
    end = sequence.tick(1.0 + LIMITS.return_timeout)[-1]
    assert end == Finish(Phase.FAILED, 'the recorder has gone and did not come back within 60 s; resume the run '
                         'when it is there')


def verifying(lost, rounds=VERIFY_ROUNDS):
    """Answer all; say so often that some answers are not in the log; return (sequence, seqs asked again)."""
    sequence = Sequence(RUN_ID, PROGRAMME, LIMITS, verifies=True)
    commands, asked, told = list(run_through_verified(sequence)), [], 0
    while any(isinstance(command, Verify) for command in commands):
        missing = lost if told < rounds else ()
        told += 1
        stamps = {seq: [stamp] for seq, (stamp, _) in sequence._taken.items() if seq not in missing}
        commands = list(sequence.verified(stamps, 0.0))
        ask = last_ask(commands)
        while ask:
            asked.append((ask.target.seq, ask.attempt))
            step = sequence.answer(answer_to(ask, stamp_ns=1000 * told + ask.target.seq), 0.0)
            commands += step
            ask = last_ask(step)
    return sequence, asked


def run_through_verified(sequence):
    """Answer everything at once, each with a stamp of its own; return the last commands."""
    step = sequence.begin(0.0)
    while ask := last_ask(step):
        step = sequence.answer(answer_to(ask, stamp_ns=ask.target.seq), 0.0)
    return step


def test_what_is_not_in_the_log_is_asked_again():
    """The end of a run is verified: three answers never arrived at the recorder, one of the alignment."""
    sequence, asked = verifying((4, 12, 17), rounds=1)
    assert asked == [(4, 2), (12, 2), (17, 2)]
    assert sequence.phase is Phase.EVALUATION
    assert sequence.done == PROGRAMME.total


def test_a_recorder_that_never_gets_answers_ends_the_run():
    """Asking again and again would not help."""
    sequence, asked = verifying((5,))
    assert len(asked) == VERIFY_ROUNDS - 1
    assert sequence.phase is Phase.FAILED
    assert 'the recorder does not hear the CMM' in sequence.text


def test_a_whole_log_needs_one_look():
    """Nothing is missing, nothing is asked."""
    sequence, asked = verifying(())
    assert asked == []
    assert sequence.phase is Phase.EVALUATION


# What a log tells


def target_table(rows, **columns):
    """Return the TargetTable of targets of the programme; rows: (seq, attempt, session)."""
    targets = [PROGRAMME.target(seq - 1) for seq, _, _ in rows]
    given = {
        'run_id': [RUN_ID] * len(rows), 'seq': [row[0] for row in rows], 'attempt': [row[1] for row in rows],
        'phase': [int(one.phase) for one in targets], 'balls': [3] * len(rows), 'radius': [0.1] * len(rows),
        'table_position': [one.table_position for one in targets], 'ball': [one.ball for one in targets],
        'stamp_ns': [1000 * row[0] for row in rows], 'session': [row[2] for row in rows]}
    return TargetTable(**{**given, **columns})


def answer_table(seqs):
    """Return (AnswerTable, records) of good answers."""
    records = [answers_up_to(PROGRAMME.total)[seq] for seq in seqs]
    size = len(seqs)
    return AnswerTable(
        run_id=[RUN_ID] * size, seq=seqs, table_position=[one.table_position for one in records],
        ball=[one.ball for one in records], status=[0] * size, stamp_ns=[1000 * seq + 1 for seq in seqs],
        frame_id=['machine'] * size, table_angle=[one.table_angle for one in records],
        table_travel=[0.0] * size, approach=[1] * size, centre=np.array([one.centre for one in records]),
        form_error=[0.0] * size, temperature=[20.0] * size, text=[''] * size), records


def test_the_log_tells_answers_attempts_and_session():
    """Of each target the last attempt, of the run the last session."""
    answers, records = answer_table([1, 2])
    found = earlier_of(target_table([(1, 1, 1), (2, 1, 1), (2, 2, 3), (3, 1, 3)]), answers, records, RUN_ID,
                       PROGRAMME)
    assert set(found.answers) == {1, 2}
    assert found.attempts == {1: 1, 2: 2, 3: 1}
    assert found.session == 3


@pytest.mark.parametrize(('changed', 'got'), [
    ({'ball': [3, 3]}, 'target 1: wanted target 1 (table position 1, ball 1) as planned, the log has table '
                       'position 1, ball 3 of 3'),
    ({'balls': [3, 4]}, 'target 2'), ({'radius': [0.1, 0.2]}, 'target 2'), ({'phase': [1, 3]}, 'target 2'),
    ({'seq': [1, 99]}, f'target 99: wanted one of {PROGRAMME.total} targets')])
def test_a_log_of_another_plan_is_refused(changed, got):
    """Its answers would stand at the wrong places."""
    with pytest.raises(CellError) as error:
        earlier_of(target_table([(1, 1, 1), (2, 1, 1)], **changed), *answer_table([1]), RUN_ID, PROGRAMME)
    assert got in str(error.value)
    assert 'the run was planned with other settings' in str(error.value)


def test_settings_survive_the_log():
    """What decides the targets comes back the same; another wish is refused."""
    told = parse_settings(format_settings(SETTINGS), 'here')
    assert told == {wanted.name: SETTINGS[wanted.name] for wanted in PLANNED}
    check_wishes({'order': 'diagonal', 'limits.attempts': 1}, told, 'a')
    with pytest.raises(CellError, match="order: wanted 'diagonal' as the run began, got 'row'; leave it out"):
        check_wishes({'order': 'row'}, told, 'a')


@pytest.mark.parametrize('text', ['', '[1]', 'order: {', 'order: row'])
def test_spoilt_settings_are_refused(text):
    """Half a plan is none."""
    with pytest.raises(InvalidConfig, match='here: '):
        parse_settings(text, 'here')


# Which log is meant


def test_a_run_means_its_last_part(tmp_path):
    """By the run's name or a path in the recorder's folder; the next part is numbered on."""
    for name in ('run', 'run_part2', 'run_part3', 'other'):
        (tmp_path / name).mkdir()
    assert find_part(tmp_path, 'run') == tmp_path / 'run_part3'
    assert find_part(tmp_path, str(tmp_path / 'other')) == tmp_path / 'other'
    assert [path.name for path in parts_of(tmp_path, 'run')] == ['run', 'run_part2', 'run_part3']
    assert next_part(tmp_path, 'run').name == 'run_part4'
    assert next_part(tmp_path, 'other').name == 'other_part2'


@pytest.mark.parametrize(('name', 'words'), [
    ('run_part2', 'run_part2 was gone on from already; resume run_part3'),
    ('nothing', "got none named 'nothing'"), ('run_part9', "got none named 'run_part9'"),
    ('/elsewhere/run', "got '/elsewhere/run'; copy it there"), ('../run', "got '../run'; copy it there")])
def test_what_is_no_log_to_go_on_from_is_refused(tmp_path, name, words):
    """In words; nothing outside the recorder's folder is read."""
    for part in ('run', 'run_part2', 'run_part3'):
        (tmp_path / part).mkdir()
    with pytest.raises(InvalidData) as error:
        find_part(tmp_path, name)
    assert words in str(error.value)


def test_a_log_of_other_messages_is_not_gone_on_with(tmp_path, monkeypatch):
    """Its bytes mean something else; it can still be evaluated."""
    import os

    from rosette_ros.core.records import Run
    from rosette_ros.data.run_log import write_log

    library = TypeLibrary.from_environment(os.environ)
    run = Run.from_readings(3, 0.1, [1, 1, 1], [1, 2, 3], np.zeros((3, 3)))
    write_log(run.replace(run_id='a'), tmp_path / 'a', library)
    response = recall(tmp_path / 'a', library)
    assert (response.run_id, len(response.targets), len(response.answers)) == ('a', 3, 3)

    class Younger:
        def definition(self, name):
            return dataclasses.replace(library.definition(name), hash='RIHS01_' + 64 * '0')

    with pytest.raises(InvalidData, match='was written with another version of rosette_msgs/msg/ProbeTarget'):
        recall(tmp_path / 'a', Younger())
