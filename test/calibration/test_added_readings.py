# SPDX-License-Identifier: Apache-2.0
"""A plan that grows until nothing is open: what is asked, when it ends, what a log says of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from sequences import LIMITS, RUN_ID, TAUGHT, answer_to, last_ask, results_of, run_through

from rosette_ros.calibration.calibration_plan import BLOCK, block_of, plan_calibration
from rosette_ros.calibration.goal import Request, make_job
from rosette_ros.calibration.settings import LIMITS as LIMIT_SETTINGS
from rosette_ros.calibration.settings import PLANNED, format_added, format_settings, parse_settings, plan_of, until_of
from rosette_ros.calibration.state_machine import (
    Ask,
    AskNext,
    Extended,
    Finish,
    PublishRun,
    Sequence,
    Until,
    Verify,
    Warn,
)
from rosette_ros.core.run.errors import InvalidConfig, InvalidPlan
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import conversions

SETTINGS = {wanted.name: wanted.default for wanted in PLANNED + LIMIT_SETTINGS}
UNTIL = Until(0.95, 0.0, 5)
BLOCK_1 = block_of(3, {'table_position': [2, 1], 'ball': [3, 1], 'approach': [-1, -1], 'wait': [0.0, 0.0]})
BLOCK_2 = block_of(3, {'table_position': [1, 3, 3], 'ball': [2, 2, 3], 'approach': [1, 1, 1], 'wait': [60.0, 0, 0]})
WHY = 'warm-up or drift, 61 : 39'


def make(until=UNTIL, drift_check=True):
    """Return a Sequence of three balls that measures on."""
    return Sequence(RUN_ID, plan_calibration(plan(3), 0.1, TAUGHT, 2, drift_check), LIMITS, until=until)


def of_kind(commands, *kinds):
    """Return the commands of some kinds."""
    return [one for one in commands if isinstance(one, kinds)]


def measure(sequence, commands):
    """Answer what is asked; return the targets that were asked for and all commands."""
    commands, asked, ask = list(commands), [], last_ask(commands)
    while ask:
        asked.append(ask)
        step = sequence.answer(answer_to(ask), 0.0)
        commands, ask = [*commands, *step], last_ask(step)
    return asked, commands


def asking(sequence):
    """Bring a sequence to where the evaluator is asked; return the command."""
    if sequence.phase is Phase.IDLE:
        run_through(sequence)
    (command,) = of_kind(sequence.evaluated(results_of(sequence)), AskNext)
    return command


def rows(targets):
    """Return table position, ball and approach as asked."""
    return [(one.table_position, one.ball) for one in targets]


def test_readings_come_before_the_drift_check_and_are_numbered_on():
    """Two blocks: their columns, the last session, the touches of the plan; the drift check stays last."""
    made = plan_calibration(plan(3), 0.1, TAUGHT, 2, touches=8)
    assert made.added.ball.size == 0 and format_added(made) == ''
    grown = made.followed_by(BLOCK_1).followed_by(BLOCK_2)
    assert grown.total == made.total + 5
    assert grown.phase.tolist() == sorted(made.phase.tolist() + 5 * [Phase.RUN])
    for name in BLOCK:
        assert getattr(grown.added, name).tolist() == [*getattr(BLOCK_1, name), *getattr(BLOCK_2, name)]
    assert [grown.target(index).seq for index in range(grown.total)] == list(range(1, grown.total + 1))
    assert set(grown.touches.tolist()) == {8} and set(grown.session.tolist()) == {1}
    assert grown.target(grown.total - 1).phase == Phase.DRIFT_CHECK
    run = made.phase == Phase.RUN
    later = replace(made, session=np.where(run & (np.cumsum(run) > 4), 2, 1)).followed_by(BLOCK_1)
    assert later.session[later.run_end - 2:later.run_end].tolist() == [2, 2]


def test_settings_hold_what_was_added():
    """Written, read and planned again: the same targets."""
    values = {**SETTINGS, 'plate.balls': 3, 'until.probability': 0.95}
    grown = plan_of(values).followed_by(BLOCK_1).followed_by(BLOCK_2)
    text = format_settings(values) + format_added(grown)
    again = plan_of(parse_settings(text, 'test'))
    for name in ('phase', 'table_position', 'ball', 'approach', 'touches', 'session', 'wait'):
        assert np.array_equal(getattr(again, name), getattr(grown, name))
    assert until_of(parse_settings(text, 'test')) == Until(0.95, 0.0, 0)


@pytest.mark.parametrize('text', ['4 1 1 0', '1 1 1', '1 1 1 0, 1', '1.5 1 1 0', '1 1 0 0', '1 1 1 nan', '1 1 1 -1',
                                  'a', f'{10**30} 1 1 0'])
def test_settings_of_a_log_that_name_no_readings_are_refused(text):
    """In one line."""
    with pytest.raises(InvalidConfig) as caught:
        plan_of({**SETTINGS, 'plate.balls': 3, 'added': text})
    assert str(caught.value).startswith('added: expected readings that were added to the plan: table position, ball')
    assert str(caught.value).endswith(f'found {text!r:.80}')


@pytest.mark.parametrize('change', [{'ball': [0, 1]}, {'approach': [0, 1]}, {'wait': [-1.0, 0.0]}, {'wait': [1.0]},
                                    {'wait': [np.nan, 0.0]}])
def test_a_block_that_cannot_be_measured_is_refused(change):
    """An evaluator may be foreign."""
    columns = {name: getattr(BLOCK_1, name) for name in BLOCK}
    with pytest.raises(InvalidPlan, match=r'readings that are added: expected table position and ball in 1\.\.3, appr'):
        block_of(3, {**columns, **change})


@pytest.mark.parametrize(('readings', 'wait', 'words'), [
    (6, 0.0, 'expected at most 5, with waits of at most 0 s, 2 times as long as the run has taken, found 6 with waits'),
    (2, 3600.0, 'found 2 with waits of 3600 s')])
def test_a_block_beyond_what_was_asked_for_is_refused(readings, wait, words):
    """Whatever an evaluator says: the cell measured 60 readings where 6 were allowed, and stood still for a day."""
    sequence = make()
    asking(sequence)
    columns = dict.fromkeys(('table_position', 'ball', 'approach'), [1] * readings)
    with pytest.raises(InvalidPlan, match=f'^readings that are added: .*{words}'):
        sequence.refuse_block(block_of(3, {**columns, 'wait': [wait] + [0.0] * (readings - 1)}))
    sequence.refuse_block(block_of(3, {**{name: [1] * 5 for name in columns}, 'wait': [0.0] * 5}))


def test_an_evaluator_that_does_not_answer_leaves_what_it_has_published():
    """It was asked four times, for 120 s each, and the run then failed for want of the results that it had."""
    sequence = make()
    asking(sequence)
    commands = sequence.not_answered('the evaluator did not answer within 360 s')
    assert of_kind(commands, Ask, PublishRun) == []
    (end,) = of_kind(commands, Finish)
    assert end == Finish(Phase.DONE, 'error motions are published; without the drift check, not settled: the evaluator '
                         'did not answer within 360 s')


@pytest.mark.parametrize('is_settling', [True, False])
def test_results_of_the_same_readings_are_kept(is_settling):
    """They were to be evaluated again, after a restart of evaluator or recorder, and the evaluator hangs."""
    sequence = make(drift_check=False)
    sequence.verifies = True
    asking(sequence)
    if is_settling:
        assert of_kind(sequence.not_decided('the evaluator was restarted', 0.0), PublishRun)
    else:
        sequence.decided(None, 'warm-up', 0.0, is_settled=True)
        sequence.hold('the recorder is disconnected', 1.0)
        assert of_kind(sequence.resume_asking(2.0, restarted=True), PublishRun)
    commands = sequence.tick(3.0 + LIMITS.evaluation_timeout)
    assert of_kind(commands, Verify) == [Verify(results_of(sequence))]
    (end,) = of_kind(sequence.verified([]), Finish)
    assert end.phase is Phase.DONE
    assert end.text.endswith('not settled: expected error motions from the evaluator within '
                             f'{LIMITS.evaluation_timeout:g} s, found none' if is_settling else 'settled: warm-up')


def test_a_plate_has_a_largest_size():
    """Said before anything is measured."""
    values = {**SETTINGS, 'plate.balls': 73}
    with pytest.raises(InvalidPlan, match='^until: expected at most 72 balls, found 73: '):
        make_job(Request('calibrate', {'until_probability': 0.95}), values, ())
    make_job(Request('calibrate'), values, ())


def test_fields_of_a_goal_are_bounded():
    """5 MB of one took the sequencer 28 s, 20 MB more than a minute: the event has the begin of each."""
    request = Request('calibrate', {'resume': 'x' * 5_000_000, 'joint_with': ['y' * 100_000] * 200, 'balls': 6})
    assert len(request.fields) < 100_000
    found = yaml.safe_load(request.fields)
    assert found['resume'] == 'x' * 10_000 and len(found['joint_with']) == 100 and found['balls'] == 6


def test_blocks_are_measured_until_nothing_is_open():
    """After the plan the evaluator is asked, and after each block; then the drift check, and the results count."""
    sequence = make()
    sequence.verifies = True
    assert asking(sequence).readings == 5
    assert sequence.done == sequence.plan.total - 1  # without the drift check
    asked, commands = measure(sequence, sequence.decided(BLOCK_1, WHY, 1.0))
    assert [one.text for one in of_kind(commands, Extended)] == [f'settling: {WHY}']
    assert rows(asked) == [(2, 3), (1, 1)] and [one.seq for one in asked] == [18, 19]
    assert {one.phase for one in asked} == {Phase.RUN} and of_kind(commands, PublishRun)
    assert asking(sequence).readings == 3
    settled = sequence.decided(None, 'warm-up', 2.0, is_settled=True)
    asked, commands = measure(sequence, settled)
    assert [one.phase for one in asked] == [Phase.DRIFT_CHECK] and of_kind(commands, PublishRun)
    assert of_kind(sequence.evaluated(results_of(sequence)), Verify, AskNext) == [Verify(results_of(sequence))]
    (end,) = of_kind(sequence.verified([]), Finish)
    assert end == Finish(Phase.DONE, 'error motions are published; settled: warm-up')


def test_without_a_drift_check_the_last_results_count():
    """Nothing more is measured, nor evaluated."""
    sequence = make(drift_check=False)
    asking(sequence)
    commands = sequence.decided(None, 'no reading of this cell separates A from B', 0.0)
    assert of_kind(commands, Extended, Finish) == [
        Extended('not settled: no reading of this cell separates A from B'),
        Finish(Phase.DONE, 'error motions are published; not settled: no reading of this cell separates A from B')]


def test_the_state_says_why_it_goes_on():
    """Where it stands, for a person."""
    sequence = make()
    asking(sequence)
    assert sequence.describe() == 'asking the evaluator which readings settle what is open'
    sequence.decided(BLOCK_1, WHY, 1.0)
    assert sequence.describe() == f'settling: {WHY}; run 10 of 11: table position 2, ball 3'
    measure(sequence, (Ask(sequence._asked),))
    assert sequence.describe() == f'settling: {WHY}; waiting for the error motions'
    sequence.cancel()
    assert sequence.describe() == 'cancelled on request'


@pytest.mark.parametrize('most, readings', [(2, 2), (0, 9)])
def test_no_more_readings_than_are_allowed(most, readings):
    """As many as the goal says, else as many as the plan has."""
    sequence = make(UNTIL._replace(most=most), drift_check=False)
    assert asking(sequence).readings == readings
    block, count = BLOCK_1, 0
    while not sequence.phase.is_end:
        count += 1
        measure(sequence, sequence.decided(block, WHY, 1.0))
        if sequence.phase is Phase.EVALUATION:
            asking(sequence)
    added = sequence.plan.added.ball.size
    assert (added, count) == ((2, 2) if most else (10, 6))
    assert sequence.text == (f'error motions are published; not settled: {WHY}, after as many readings as are to be '
                             f'added ({added})')


def test_an_evaluator_that_does_not_say_is_asked_again():
    """It is given the run again; then the run ends with what it has."""
    sequence = make(drift_check=False)
    asking(sequence)
    for _ in range(LIMITS.attempts):
        commands = sequence.not_decided('the evaluator disconnected before it answered', 1.0)
        assert of_kind(commands, Warn) == [Warn(
            'the next readings are not known: the evaluator disconnected before it answered; asking again')]
        assert of_kind(commands, PublishRun)
        assert of_kind(sequence.evaluated(results_of(sequence)), AskNext)
    (end,) = of_kind(sequence.not_decided('it hangs', 1.0), Finish)
    assert end == Finish(Phase.DONE, 'error motions are published; not settled: it hangs')


def test_an_answer_that_is_late_changes_nothing():
    """While the run is held, once it is over, and a second one."""
    sequence = make()
    asking(sequence)
    sequence.hold('the recorder is disconnected', 1.0)
    assert sequence.decided(BLOCK_1, WHY, 1.0) == sequence.not_decided('late', 1.0) == ()
    assert of_kind(sequence.resume_asking(2.0, restarted=False), PublishRun)
    assert sequence.decided(BLOCK_1, WHY, 2.0) == ()  # the results are published again first
    asking(sequence)
    assert of_kind(sequence.decided(BLOCK_1, WHY, 2.0), Ask)
    assert sequence.decided(BLOCK_1, WHY, 2.0) == ()
    sequence.cancel()
    assert sequence.decided(BLOCK_1, WHY, 2.0) == () and sequence.phase is Phase.CANCELLED


def test_a_wait_before_a_reading():
    """The target is asked for so much later, once; its stamp says when."""
    sequence = make()
    sequence.clock = lambda: 1_000_000_000
    asking(sequence)
    (first,) = of_kind(sequence.decided(BLOCK_2, WHY, 10.0), Ask)
    assert (first.wait, first.target.stamp_ns) == (60.0, 61_000_000_000) and sequence.is_asked(first.target)
    assert sequence.tick(10.0 + 60.0 + 0.9 * LIMITS.answer_timeout) == ()
    (again,) = of_kind(sequence.tick(10.0 + 60.0 + LIMITS.answer_timeout), Ask)
    assert again.wait == 0.0 and not sequence.is_asked(first.target)


def recalled(sequence, settings, targets=None):
    """Return what the recorder says of a log that was broken off."""
    kept = sequence.answers.targets[:targets]
    seqs = {one.seq for one in kept}
    return SimpleNamespace(
        success=True, run_id=RUN_ID, log='run_a', targets=list(map(conversions.target_message, kept)),
        answers=[conversions.answer_message(one) for one in sequence.answers.answers if one.seq in seqs],
        events=[SimpleNamespace(kind=8, settings=settings, text=f'settling: {WHY}')])


VALUES = {**SETTINGS, 'plate.balls': 3, 'plate.radius_m': 0.1, 'order': 'diagonal', 'repeats': 2,
          'until.probability': 0.95, 'table.origin_m': (0.1, 0.2, 0.0)}


@pytest.mark.parametrize('lost', range(5))
def test_a_run_that_is_resumed_measures_the_rest_of_its_block(lost):
    """Wherever it was broken off in a block: the same targets, and the evaluator is asked next."""
    whole = make()
    asking(whole)
    block = replace(BLOCK_2, wait=np.zeros(3))
    measure(whole, whole.decided(block, WHY, 1.0))
    text = format_settings(VALUES) + format_added(whole.plan)
    job = make_job(Request('calibrate', {'resume': 'run_a'}), VALUES, (), recalled(
        whole, text, len(whole.answers.targets) - min(lost, 3)))
    assert job.settings == text and job.sequence.until == Until(0.95, 0.0, 0)
    assert job.sequence.open == f'settling: {WHY}'
    asked, _ = measure(job.sequence, job.sequence.begin(0.0))
    assert [one.seq for one in asked] == [20, 19, 18][:min(lost, 3)][::-1]
    assert asking(job.sequence).readings == 9 - 3


def test_targets_of_a_block_that_no_event_names_are_of_the_plan():
    """The log was broken off between the two messages."""
    whole = make()
    asking(whole)
    measure(whole, whole.decided(BLOCK_1, WHY, 1.0))
    job = make_job(Request('calibrate', {'resume': 'run_a'}), VALUES, (), recalled(whole, format_settings(VALUES)))
    assert job.sequence.plan.added.table_position.tolist() == [2, 1]
    assert job.sequence.plan.added.approach.tolist() == [-1, -1]
    assert not measure(job.sequence, job.sequence.begin(0.0))[0]
    assert asking(job.sequence).readings == 9 - 2


@pytest.mark.parametrize('goal, words', [
    ({'until_probability': 0.5}, 'until.probability: expected a number above 0.5 and below 1, or 0 for none, found '
                                 '0.5'),
    ({'until_probability': 1.0}, 'until.probability: expected a number above 0.5 and below 1, or 0 for none, found 1'),
    ({'until_probability': 95.0}, 'goal: until.probability: expected a number in 0 .. 1'),
    ({'until_probability': float('nan')}, 'goal: until.probability: expected a number in 0 .. 1'),
    ({'until_uncertainty': -1e-6}, 'goal: until.uncertainty_m: expected a number in 0 .. 1'),
    ({'most_readings': 60}, 'goal: most_readings: expected until_probability or until_uncertainty beside it, found '),
])
def test_what_cannot_be_meant_is_refused(goal, words):
    """In one line, before anything is measured."""
    with pytest.raises(InvalidConfig) as caught:
        make_job(Request('calibrate', goal), {**SETTINGS, 'until.most_readings': 0}, ())
    assert words in str(caught.value)
