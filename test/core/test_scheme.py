# SPDX-License-Identifier: Apache-2.0
"""Measuring schemes: Table 1 of the paper, and laws that hold for every order."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosette_ros.calibration.settings import RUN
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.scheme import BACK, COMPLETE_ORDERS, ORDERS, TURNINGS, plan, travel_sense, unwrap_travel
from rosette_ros.io.messages import progress_of
from rosette_ros.io.plan_file import MeasuringPlan, format_plan, parse_plan

# Rows 1-12 of Table 1, Kniel et al. (2019): CMM position, table position, ball.
TABLE_1 = [(1, 1, 1), (1, 2, 6), (1, 3, 5), (1, 4, 4), (1, 5, 3), (1, 6, 2),
           (2, 2, 1), (2, 3, 6), (2, 4, 5), (2, 5, 4), (2, 6, 3), (2, 1, 2)]


def test_diagonal_is_table_1():
    """The diagonal order is the paper's Table 1."""
    scheme = plan(6, 'diagonal')
    rows = list(zip(scheme.cmm_position, scheme.table_position, scheme.ball))
    assert rows[:12] == TABLE_1


@given(n=st.integers(3, 25), order=st.sampled_from(sorted(COMPLETE_ORDERS)), seed=st.integers(0, 99),
       turning=st.sampled_from(TURNINGS))
def test_every_pair_once(n, order, seed, turning):
    """Every ball is measured once in every table position; k follows from i and j."""
    scheme = plan(n, order, seed, turning)
    assert len(set(zip(scheme.table_position, scheme.ball))) == n * n
    assert np.all((scheme.table_position + scheme.ball - scheme.cmm_position - 1) % n == 0)
    assert set(np.unique(scheme.approach)) <= {-1, 1}


@pytest.mark.parametrize('order, outer', [('row', 'table_position'), ('diagonal', 'cmm_position'),
                                          ('column', 'ball')])
def test_outer_loop(order, outer):
    """The outer loop of each order stands still for n readings."""
    values = getattr(plan(7, order), outer).reshape(7, 7)
    assert np.array_equal(values, np.repeat(np.arange(1, 8), 7).reshape(7, 7))


@given(n=st.integers(3, 15), order=st.sampled_from(sorted(COMPLETE_ORDERS)),
       turning=st.sampled_from(TURNINGS))
def test_travel_follows_angles_and_approach(n, order, turning):
    """The unwrapped travel shows the same angles, and each move has the sense of the approach."""
    scheme = plan(n, order, 3, turning)
    travel = unwrap_travel(scheme.table_angle, scheme.approach, n)
    assert np.allclose(np.exp(1j * travel), np.exp(1j * scheme.table_angle), atol=1e-12)
    step = np.diff(travel)
    moved = np.abs(step) > 1e-9
    assert np.all(np.sign(step[moved]) == scheme.approach[1:][moved])
    assert np.all(np.abs(step) < 2 * np.pi)


def test_alternate_turns_back_every_second_loop():
    """Alternate turning goes through every second inner loop backwards."""
    angle = plan(6, 'diagonal', turning='alternate')
    assert list(angle.table_position[:12]) == [1, 2, 3, 4, 5, 6, 1, 6, 5, 4, 3, 2]
    assert list(angle.approach[:12]) == [1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1]


def test_sense_waits_for_the_first_move():
    """An axis has no sense before it moved, and keeps its last one while it stands."""
    assert list(travel_sense(np.array([0.0, 0.0, 1.0, 1.0, 0.5]), 1e-6)) == [0, 0, 1, 1, -1]


@pytest.mark.parametrize('order', ORDERS)
def test_clockwise_is_the_mirror_image(order):
    """Position 1 stays at angle 0 and ball 1 where it is; both count down, and the table turns the other way."""
    forward, clockwise = (plan(6, order, 3, turning) for turning in ('counterclockwise', 'clockwise'))
    if order not in BACK:  # those are at chosen CMM positions
        for name in ('table_position', 'ball'):
            assert np.array_equal(getattr(clockwise, name) - 1, (1 - getattr(forward, name)) % 6)
        assert np.array_equal(clockwise.approach, -forward.approach)
    if order != 'sensitive':
        assert clockwise.approach[0] == -1
    assert np.array_equal(forward.table_position, plan(6, order, 3).table_position)


@pytest.mark.parametrize('arguments, words', [
    ((2, 'row'), 'number of balls: expected a whole number of at least 3, found 2'),
    ((4.5, 'row'), 'number of balls: expected a whole number of at least 3, found 4.5'),
    ((6, 'spiral'), "Unknown order 'spiral'. Known: row, diagonal, column, random, interleaved, there_and_back, "
                     'row_there_and_back.'),
    ((6, 'row', 0, 'both'), "Unknown turning 'both'. Known: forward, alternate, clockwise, counterclockwise."),
])
def test_bad_plans_are_refused(arguments, words):
    """A plan that cannot be measured is refused with what was wanted and what came."""
    with pytest.raises(InvalidPlan, match=words):
        plan(*arguments)


@pytest.mark.parametrize('n', range(3, 14))
def test_there_and_back_is_its_own_mirror(n):
    """The second half measures the same balls in the opposite sequence, with the table turned the other way."""
    scheme = plan(n, 'there_and_back')
    half = scheme.ball.size // 2
    assert np.array_equal(scheme.table_position, scheme.table_position[::-1])
    assert np.array_equal(scheme.ball, scheme.ball[::-1])
    assert np.all(scheme.approach[:half] == 1) and np.all(scheme.approach[half + 1:] == -1)
    assert scheme.repeats and np.unique(scheme.cmm_position).size == half // n


@pytest.mark.parametrize('order', COMPLETE_ORDERS)
def test_places_that_are_left_out_are_not_measured(order):
    """A reduced scheme is the complete one without the pairs that are left out."""
    complete, reduced = plan(12, order), plan(12, order, cmm_positions=(1, 5, 7, 10))
    kept = np.isin(complete.cmm_position, (1, 5, 7, 10))
    for name in ('table_position', 'ball', 'approach'):
        assert np.array_equal(getattr(reduced, name), getattr(complete, name)[kept])
    assert set(plan(12, order, balls=(2, 3, 5, 8)).ball) == {2, 3, 5, 8}


@pytest.mark.parametrize('arguments, words', [
    ({'cmm_positions': (1, 13)}, r'CMM positions in use: expected different ones of 1..12, found 1, 13'),
    ({'balls': (2, 2, 5)}, r'balls in use: expected different ones of 1..12, found 2, 2, 5'),
    ({'cmm_positions': (1, 4, 7, 10)}, 'CMM positions in use: 1, 4, 7, 10 of 12 do not determine the curves; expected '
                                       'others, such as 1, 5, 7, 10'),
    ({'balls': (1, 4, 6, 9)}, '1, 4, 6, 9 of 12 do not determine the curves; expected others, such as 1, 5, 7, 10'),
    ({'balls': (2, 3)}, '2, 3 of 12 do not determine the curves; expected others, such as 1, 5, 7, 10'),
    ({'balls': (1, 5, 7, 10), 'cmm_positions': (1, 5, 7, 10)}, 'expected CMM positions or balls in use, found both')])
def test_places_that_do_not_exist_are_refused(arguments, words):
    """Places in use are different ones that exist, and of one kind."""
    with pytest.raises(InvalidPlan, match=words):
        plan(12, **arguments)


def test_the_order_interleaved_is_known_by_its_earlier_name():
    """In a plan, a parameter, a plan file and a log that were made before; what is made now has the name of today."""
    made, known = plan(6, 'interleaved'), plan(6, 'sensitive')
    assert made.order == known.order == 'interleaved' and np.array_equal(made.table_position, known.table_position)
    wanted = next(one for one in RUN if one.name == 'order')
    assert wanted.check('sensitive', 'x') == wanted.check('interleaved', 'x') == wanted.default == 'interleaved'
    for text in (b'schema: rosette-plan/1\nballs: 6\nradius_mm: 182.5\norder: sensitive\n',
                 format_plan(MeasuringPlan(made, 0.1825)).replace('interleaved', 'sensitive').encode()):
        scheme = parse_plan(text, 'plan').scheme
        assert scheme.order == 'interleaved' and np.array_equal(scheme.ball, made.ball)
    state = SimpleNamespace(run_id='r', phase=3, order='sensitive', done=0, total=36, text='')
    assert progress_of(state).order == 'interleaved'
    with pytest.raises(InvalidPlan, match='Unknown order'):
        plan(6, 'sensitiv')
