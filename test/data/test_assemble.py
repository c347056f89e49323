# SPDX-License-Identifier: Apache-2.0
"""Which answer counts for which target, and what the Run takes from it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import Frame
from rosette_ros.data.assemble import (
    AnswerTable,
    Phase,
    TargetTable,
    assemble_run,
    pair,
    repeatability,
    runs_in,
)
from rosette_ros.data.labels import Labels

N = 3
RADIUS = 0.1


def targets(rows, **columns):
    """Return a TargetTable of (seq, phase, table position, ball)."""
    seq, phase, i, j = np.array(rows).T
    given = {'run_id': ['r'] * len(rows), 'seq': seq, 'attempt': np.ones(len(rows)),
             'phase': phase, 'balls': [N] * len(rows), 'radius': [RADIUS] * len(rows),
             'table_position': i, 'ball': j, 'stamp_ns': 10**9 * seq}
    return TargetTable(**{**given, **columns})


def answers(rows, **columns):
    """Return an AnswerTable of (seq, table position, ball), measured 0.5 s after the asking."""
    seq, i, j = np.array(rows).T
    size = len(rows)
    azimuth = 2 * np.pi * ((i + j - 2) % N) / N
    given = {
        'run_id': ['r'] * size, 'seq': seq, 'table_position': i, 'ball': j,
        'status': np.zeros(size), 'stamp_ns': 10**9 * seq + 5 * 10**8,
        'frame_id': ['table'] * size, 'table_angle': 2 * np.pi * (i - 1) / N,
        'table_travel': np.arange(size), 'approach': np.ones(size),
        'centre': RADIUS * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1),
        'form_error': np.zeros(size), 'temperature': np.full(size, 20.0), 'text': [''] * size}
    return AnswerTable(**{**given, **columns})


CELLS = [(i, j) for i in range(1, N + 1) for j in range(1, N + 1)]
ASKED = [(seq, Phase.RUN, i, j) for seq, (i, j) in enumerate(CELLS, 1)]
GIVEN = [(seq, i, j) for seq, (i, j) in enumerate(CELLS, 1)]


def test_run_holds_what_was_measured():
    """Everything in order of measuring, the time from the first reading."""
    run = assemble_run(targets(ASKED), answers(GIVEN), None, source='here')
    assert (run.n, run.radius, run.run_id, run.source) == (N, RADIUS, 'r', 'here')
    assert run.is_complete
    assert run.time.tolist() == list(range(9))
    assert run.table_travel.tolist() == list(range(9))
    assert run.repeatability is None


def test_missing_balls_make_an_incomplete_run():
    """Failed, never answered, asked without answer: no error, but fewer readings."""
    given = answers(GIVEN[:7], status=[0, 1, 0, 0, 0, 0, 0])
    run = assemble_run(targets(ASKED), given, None)
    assert run.size == 6
    assert not run.is_complete


def test_answers_are_sorted_by_when_they_were_measured():
    """A ball that was put off stands where it was measured, not where it was asked."""
    late = answers(GIVEN, stamp_ns=[10**9 * second for second in (1, 20, 3, 4, 5, 6, 7, 8, 9)])
    run = assemble_run(targets(ASKED), late, None)
    assert run.time.tolist() == [0, 2, 3, 4, 5, 6, 7, 8, 19]
    assert (run.table_position[-1], run.ball[-1]) == (1, 2)


def test_of_two_good_answers_the_first_after_the_last_asking_counts():
    """The answer to a repeated target counts, not the late one to the first time of asking."""
    asked = targets([*ASKED, (2, Phase.RUN, 1, 2)], attempt=[1] * 9 + [2],
                    stamp_ns=[10**9 * second for second in [*range(1, 10), 12]])
    given = answers([*GIVEN, (2, 1, 2), (2, 1, 2)],
                    stamp_ns=[10**9 * second for second in [*range(1, 10), 13, 14]])
    pairing = pair(asked, given, 'r')
    chosen = dict(zip(given.seq[pairing.answer].tolist(), pairing.answer.tolist(), strict=True))
    assert chosen[2] == 9
    assert pairing.repeated == 2
    assert asked.attempt[pairing.target[given.seq[pairing.answer] == 2]].tolist() == [2]


def test_without_an_answer_after_the_last_asking_the_first_counts():
    """A late answer is better than none; nothing is asked of a clock that lags."""
    asked = targets([*ASKED, (2, Phase.RUN, 1, 2)], attempt=[1] * 9 + [2],
                    stamp_ns=[10**9 * second for second in [*range(1, 10), 99]])
    assert pair(asked, answers(GIVEN), 'r').answer.tolist() == list(range(9))


def test_a_later_duplicate_changes_nothing():
    """What the evaluator saw stays what the log says."""
    once = assemble_run(targets(ASKED), answers(GIVEN), None)
    twice = assemble_run(targets(ASKED), answers([*GIVEN, (4, 2, 1)]), None)
    assert twice.centre.tobytes() == once.centre.tobytes()
    assert twice.time.tobytes() == once.time.tobytes()


def test_answers_that_do_not_fit_are_counted_and_not_used():
    """Failed, to no target, with another ball than asked, not finite: each has its count."""
    given = answers([*GIVEN[:5], (77, 1, 1), (6, 3, 3), (7, 3, 1)],
                    status=[1, 0, 0, 0, 0, 0, 0, 0],
                    table_angle=[*answers(GIVEN[:5]).table_angle, 0, 0, np.nan])
    pairing = pair(targets(ASKED), given, 'r')
    assert (pairing.failed, pairing.unasked, pairing.contradicting, pairing.not_finite) == (
        1, 1, 1, 1)
    assert pairing.answer.tolist() == [1, 2, 3, 4]
    with pytest.raises(InvalidData, match=r"here: wanted ball centres of run 'r', got none that "
                       r'counts \(1 failed, 1 to no target, 1 with another ball than asked, '
                       r'1 without finite numbers\)'):
        assemble_run(targets(ASKED), given.take([0, 5, 6, 7]), None, source='here')


@settings(max_examples=60, deadline=None)
@given(st.permutations(range(9)), st.lists(st.integers(0, 8), max_size=6),
       st.sets(st.integers(0, 8), max_size=4))
def test_order_of_receipt_and_duplicates_do_not_matter(order, again, failed):
    """Any order on the way, any duplicates behind it: the same Run, bit for bit."""
    status = [int(row in failed) for row in range(9)]
    plain = answers(GIVEN, status=status)
    mixed = answers(GIVEN, status=status).take([*order, *again])
    if len(failed) == 9:
        return
    one = assemble_run(targets(ASKED), plain, None)
    other = assemble_run(targets(ASKED).take(order), mixed, None)
    for name in ('table_position', 'ball', 'centre', 'time', 'table_travel', 'temperature'):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_repeatability_is_pooled_over_balls_and_axes():
    """Against a calculation by hand: squares 2 + 0.5 over 3 (3-1) + 3 (2-1) = 9 degrees."""
    asked = targets([(1, 1, 1, 1), (2, 1, 1, 1), (3, 1, 1, 1), (4, 1, 1, 2), (5, 1, 1, 2),
                     (6, 2, 1, 1)])
    centre = np.array([[1, 5, 5], [-1, 5, 5], [0, 5, 5], [7, 0.5, 0], [7, -0.5, 0], [9, 9, 9.0]])
    given = answers([(1, 1, 1), (2, 1, 1), (3, 1, 1), (4, 1, 2), (5, 1, 2), (6, 1, 1)],
                    centre=1e-6 * centre)
    sigma, dof = repeatability(asked, given, pair(asked, given, 'r'))
    assert dof == 9
    assert sigma == pytest.approx(1e-6 * np.sqrt(2.5 / 9), rel=1e-12)


def test_repeatability_needs_repeats_that_differ():
    """One reading tells nothing; readings equal to rounding neither."""
    asked = targets([(1, 1, 1, 1), (2, 1, 1, 1)])
    same = answers([(1, 1, 1), (2, 1, 1)])
    assert repeatability(asked, same, pair(asked, same, 'r')) == (None, None)
    single = same.take([0])
    assert repeatability(asked, single, pair(asked, single, 'r')) == (None, None)


def test_machine_frame_is_turned_into_the_table_frame():
    """p_table = R^T (p_machine - o); what is in the table frame stays as it is."""
    frame = Frame(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))
    table = answers(GIVEN)
    x, y, z = table.centre.T
    machine = np.stack([1 - y, 2 + x, 3 + z], axis=-1)  # R p + o by hand
    centre = np.where(np.arange(9)[:, None] == 4, table.centre, machine)
    frames = ['cell1/table' if row == 4 else 'cell1/machine' for row in range(9)]
    run = assemble_run(targets(ASKED), answers(GIVEN, centre=centre, frame_id=frames), frame)
    np.testing.assert_allclose(run.centre, table.centre, atol=1e-15)
    assert run.centre[4].tobytes() == table.centre[4].tobytes()


@pytest.mark.parametrize(('asked', 'given', 'options', 'words'), [
    ({}, {'frame_id': ['machine'] * 8 + ['tool']}, {},
     "here: ball centre with seq 9: frame_id: wanted machine or table, got 'tool'"),
    ({}, {'frame_id': ['machine'] * 9}, {},
     'here: wanted a transform from machine to table on /tf_static, got none'),
    ({'balls': [3] * 8 + [4]}, {}, {},
     "here: run 'r': balls: wanted one value in all targets, got 3, 4"),
    ({'radius': [0.1] * 8 + [0.2]}, {}, {}, 'radius: wanted one value in all targets'),
    ({'balls': [10**9] * 9}, {}, {}, 'balls: wanted at most 10000, got 1000000000'),
    ({'phase': [2] * 9}, {}, {}, 'here: wanted probe targets of phase RUN, got none'),
    ({}, {}, {'run_id': 'other'}, "here: wanted run 'other', got r$"),
    ({'run_id': ['r'] * 5 + ['s'] * 4}, {}, {},
     'here: wanted one run, got 2: r, s; choose one by its run_id'),
    ({'run_id': ['s'] * 9}, {}, {}, "here: wanted ball centres of run 's', got none"),
    ({}, {'centre': -answers(GIVEN).centre}, {}, 'here: ball centre with seq 1: wanted a place near '
     r'\(100.000, 0.000, 0\) mm in the table frame for table position 1, ball 1, got \(-100, -0, -0'
     r'\); was another ball measured, or is the table frame wrong'),
    ({}, {'centre': np.full((9, 3), 1e300)}, {}, 'here: ball centre with seq 1: wanted a place'),
])
def test_what_is_no_run_is_refused_with_words(asked, given, options, words):
    """Each says where, what was wanted, what came."""
    with pytest.raises(InvalidData, match=words):
        assemble_run(targets(ASKED, **asked), answers(GIVEN, **given), None, source='here',
                     **options)


def test_infinite_temperature_is_unknown():
    """A broken sensor does not spoil the ball centre."""
    given = answers(GIVEN, temperature=[np.inf, np.nan] + [20.0] * 7)
    assert np.isnan(assemble_run(targets(ASKED), given, None).temperature[:2]).all()


def test_tables_refuse_columns_of_other_length():
    """The record names the column."""
    with pytest.raises(InvalidData, match='TargetTable: attempt: wanted 9 values as in seq, got 2'):
        targets(ASKED, attempt=[1, 2])


def test_runs_are_told_in_order_of_appearance():
    """Only runs that got as far as their run phase count."""
    table = targets(ASKED, run_id=['b'] * 4 + ['a'] * 5, phase=[3] * 8 + [2])
    assert runs_in(table) == ('b', 'a')


def test_labels_join_and_compare():
    """The same text has one name, whichever part it came from."""
    joined = Labels.concatenate([Labels.of(['x', 'y']), Labels.of(['y', 'z', 'x'])])
    assert [joined[row] for row in range(5)] == ['x', 'y', 'y', 'z', 'x']
    assert joined.names == ('x', 'y', 'z')
    assert joined.equal('y').tolist() == [False, True, True, False, False]
    assert not Labels.of([]).equal('y').size


def test_a_pause_is_marked_and_the_order_is_that_of_the_sessions():
    """Clocks may disagree over a pause; what was measured after it comes after it."""
    session = np.repeat([1, 2], [4, 5])
    early = 10**9 * np.where(session == 2, np.arange(1, 10) - 100, np.arange(1, 10)) + 200 * 10**9
    run = assemble_run(targets(ASKED, session=session), answers(GIVEN, stamp_ns=early), None)
    assert run.session.tolist() == session.tolist()
    assert run.pauses == (4,)
    assert run.ball.tolist() == [j for _, j in CELLS]
    assert run.take(np.arange(2, 9)).pauses == (2,)


def test_targets_that_tell_no_session_have_one():
    """Logs of before, and other sequencers."""
    assert targets(ASKED).session.tolist() == [1] * 9
    assert targets(ASKED, session=np.zeros(9)).session.tolist() == [1] * 9


TURNED = 2 * np.pi * np.arange(9) / 3


@pytest.mark.parametrize(('after', 'wanted'), [
    (TURNED[5:] - TURNED[5] + 0.1, TURNED[5:]),  # the table counts anew
    (TURNED[5:] + 2 * np.pi, TURNED[5:] + 2 * np.pi),  # it went on, and turned once more during the pause
])
def test_the_travel_goes_on_where_the_table_counted_anew(after, wanted):
    """A restarted controller counts from 0: the run's travel goes on by the shortest way in its sense."""
    row = [(seq, Phase.RUN, (seq - 1) % 3 + 1, (seq - 1) // 3 + 1) for seq in range(1, 10)]
    given = [(seq, i, j) for seq, _, i, j in row]
    travel = np.concatenate([TURNED[:5], after])
    run = assemble_run(targets(row, session=np.repeat([1, 2], [5, 4])), answers(given, table_travel=travel), None)
    assert run.table_travel == pytest.approx(np.concatenate([TURNED[:5], wanted]), abs=1e-12)


def test_times_do_not_fall_over_a_pause():
    """A clock that was set back, or a simulated one that began anew: the pause is as long as readings are apart."""
    session = np.repeat([1, 2], [4, 5])
    stamp = 10**9 * (np.arange(1, 10) - np.where(session == 2, 5000, 0) + 10_000)
    run = assemble_run(targets(ASKED, session=session), answers(GIVEN, stamp_ns=stamp), None)
    assert run.time.tolist() == list(range(9))
    later = 10**9 * (np.arange(1, 10) + np.where(session == 2, 5000, 0))
    run = assemble_run(targets(ASKED, session=session), answers(GIVEN, stamp_ns=later), None)
    assert run.time[4] - run.time[3] == 5001
