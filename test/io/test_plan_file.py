# SPDX-License-Identifier: Apache-2.0
"""Plan files: what is written is read again, in each form; what cannot be measured is refused in one line."""

from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.scheme import ORDERS, plan
from rosette_ros.io.plan_file import MeasuringPlan, format_plan, parse_plan

COLUMNS = ('table_position', 'ball', 'cmm_position', 'approach', 'touches', 'session', 'wait')
YAML = 'schema: rosette-plan/1\nballs: 6\nradius_mm: 182.5\n'
HEAD = '# schema: rosette-plan/1\n# balls: 6\n# radius_mm: 182.5\n'


def same(one, other):
    """Return whether two schemes are measured in the same way."""
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in COLUMNS)


@pytest.mark.parametrize('order', ORDERS)
def test_what_is_written_is_read_again(order):
    """Every order, touches, pauses and waits included; a plan without waits has no column of them."""
    scheme = plan(7, order, seed=2)
    size = scheme.ball.size
    made = MeasuringPlan(replace(scheme, touches=np.full(size, 8), session=1 + np.arange(size) // 20), 0.1825)
    assert 'wait_s' not in format_plan(made)
    made = replace(made, scheme=replace(made.scheme, wait=np.where(np.arange(size) == 9, 62.5, 0)))
    again = parse_plan(format_plan(made).encode(), 'plan')
    assert same(again.scheme, made.scheme) and (again.scheme.order, again.radius) == (order, 0.1825)


def test_an_order_in_words():
    """A YAML file without readings names an order and the places in use."""
    text = (b'schema: rosette-plan/1\nballs: 12\nradius_mm: 100\norder: there_and_back\n'
            b'cmm_positions: [1, 2, 4, 5, 7, 10]\ntouches: 8\n')
    made = parse_plan(text, 'plan.yaml')
    assert same(made.scheme, replace(plan(12, 'there_and_back', cmm_positions=(1, 2, 4, 5, 7, 10)),
                                     touches=np.full(144, 8)))


def test_position_and_ball_are_enough():
    """The sense of turning is that of the shortest way; a spreadsheet pads lines with commas."""
    scheme = plan(6, 'diagonal', turning='alternate')
    rows = '\n'.join(f'{i},{j}' for i, j in zip(scheme.table_position, scheme.ball))
    head = HEAD.replace('\n', ',\n').replace('# schema', '"# schema').replace('plan/1', 'plan/1"')
    made = parse_plan(f'{head}table_position,ball\n{rows}\n'.encode(), 'plan.csv')
    assert np.array_equal(made.scheme.ball, scheme.ball) and np.array_equal(made.scheme.approach, scheme.approach)
    assert made.scheme.order == 'plan'


def rows_of(scheme, change=lambda rows: rows, head='table_position,ball'):
    """Return a plan file of a scheme after a change of its rows."""
    rows = change([list(map(int, pair)) for pair in zip(scheme.table_position, scheme.ball)])
    return HEAD + '\n'.join([head, *(','.join(map(str, row)) for row in rows)])


def with_third(values):
    """Return a change that adds a column."""
    return lambda rows: [[*row, value] for row, value in zip(rows, [*values, *[values[-1]] * len(rows)])]


SIX = plan(6)


@pytest.mark.parametrize(('text', 'words'), [
    ('schema: rosette-plate/1', 'expected a plan file with "schema: rosette-plan/1", found'),
    ('[1, 2]', 'expected a plan file with "schema: rosette-plan/1", found'),
    (rows_of(SIX).replace('balls: 6', 'balls: six'), "balls: expected a whole number in 3..1000, found 'six'"),
    (rows_of(SIX).replace('182.5', '-3'), 'radius_mm: expected a number in 1..10000, found -3'),
    (rows_of(SIX).replace('# radius_mm: 182.5\n', ''), 'radius_mm: expected a number, but it is missing'),
    (YAML, 'expected an order, or a table of readings with the columns table_position and ball, found neither'),
    (YAML + 'order: row\nball: [1]', 'key: expected one of schema, balls, radius_mm, order, table_offset_deg, seed'),
    (HEAD, 'expected rows below the columns table_position, ball, approach, session, touches, found none'),
    (HEAD + 'table_position,ball\n', 'expected rows below the columns table_position, ball, '),
    (HEAD + '# order: row\n# order: column\n', "expected the key order once, found it again: 'column'; remove one of "
                                               "them"),
    (HEAD + '# order: row\n# table_offset: 15\n', "expected the key table_offset_deg, found 'table_offset'; correct "
                                                  "it"),
    (YAML + 'order: zigzag\n', "Unknown order 'zigzag'"),
    (YAML + 'order: row\ncmm_positions: 3\n', '3 of 6 CMM positions or balls do not determine the curves'),
    (rows_of(SIX, lambda rows: [[1, 7], *rows]), 'row 1: ball: expected a whole number in 1..6, found 7'),
    (rows_of(SIX, lambda rows: [*rows, [1.5, 1]]), 'row 37: table_position: expected a whole number in 1..6, found '
                                                   '1.5'),
    (rows_of(SIX, lambda rows: [*rows, [1]]), 'row 37: expected 2 cells, table_position, ball, found 1'),
    (rows_of(SIX, head='table_position,bal'), "column: expected one of table_position, ball, "),
    (YAML + 'order: row\ntouches: 7\n', 'mine.csv: touches: expected one of 6, 8, 9, 12, 16, 20, or 0 for'),
    (rows_of(SIX, head='ball,ball'), 'expected each column once, found ball, ball'),
    (HEAD + 'ball\n1\n', 'expected the columns table_position and ball, found none named table_position'),
    (rows_of(SIX, with_third([2]), 'table_position,ball,approach'), 'row 1: approach: expected a whole number in '
                                                                    '-1..1'),
    (rows_of(SIX, with_third([1, 3]), 'table_position,ball,session'),
     'row 2: session: expected 1 in the first row and one more after each pause, found 3'),
    (rows_of(SIX, with_third([0, 7]), 'table_position,ball,touches'),
     'row 2: touches: expected one of 6, 8, 9, 12, 16, 20, or 0 for as many as the CMM usually makes, found 7'),
    (rows_of(SIX, with_third([0, -1]), 'table_position,ball,wait_s'),
     'row 2: wait_s: expected a number of seconds in 0..86400, found -1'),
    (rows_of(SIX, with_third([0, 'long']), 'table_position,ball,wait_s'),
     "row 2: wait_s: expected a number of seconds in 0..86400, found 'long'"),
    (HEAD + '# order: Über\n' + rows_of(SIX)[len(HEAD):], "order: expected a name of at most 40 small letters"),
    (rows_of(SIX, lambda rows: 5556 * rows), 'too large: expected at most 200000 readings, found 200016'),
    (rows_of(SIX, lambda rows: [row for row in rows if row[0] != 4]),
     'does not determine the curves: expected at least 3 different balls at each of the table positions 1 .. 6, found '
     '0 '
     'balls at table position 4; add readings there'),
    (rows_of(SIX, lambda rows: [[1, 1], [1, 2], [2, 3]]),
     'found 2 balls at table position 1, 1 ball at table position 2, 0 balls at table position 3, '),
    (rows_of(SIX, lambda rows: [row for row in rows if sum(row) % 6 in (1, 2, 4)]),
     'does not determine the curves: expected at least 21 different pairs of table position and ball for 6 balls and 3 '
     'CMM positions in use, found 18; add readings'),
    (rows_of(plan(12), lambda rows: [row for row in rows if sum(row) % 3 == 2]).replace('balls: 6', 'balls: 12'),
     'does not determine the curves: its 48 pairs of table position and ball have rank 95 where 107 is needed; '
     'expected '
     'CMM positions or balls that are not equally spaced'),
])
def test_what_cannot_be_measured_is_refused(text, words):
    """One line: where, what was wanted, what came."""
    with pytest.raises(InvalidPlan) as caught:
        parse_plan(text.encode(), 'mine.csv')
    assert str(caught.value).startswith('mine.csv: ') and words in str(caught.value) and '\n' not in str(caught.value)


def test_a_cell_that_is_too_long_is_refused():
    """By file and line, also where the module csv has a limit of its own."""
    head = 'table_position,ball\n1,1\n'
    with pytest.raises(InvalidPlan, match=r'p.csv: line 6: expected cells with closed quotes, of at most 131072 '
                                          r'charac'):
        parse_plan(f'{HEAD}{head}1,"{"1" * 140_000}"'.encode(), 'p.csv')
    with pytest.raises(InvalidPlan, match='p.csv: line 6: expected cells with closed quotes'):
        parse_plan(f'{HEAD}{head}1,"2'.encode(), 'p.csv')
