# SPDX-License-Identifier: Apache-2.0
"""rosette plan."""

import argparse
import csv
import io
import json
import re
from pathlib import Path

import pytest
from simulated import simulated_run

from rosette_ros.cli.plan import plan_arguments
from rosette_ros.core.run.scheme import FEWEST, places_in_use

GOLDEN = Path(__file__).parents[1] / 'golden'


def test_table_1_of_the_paper_byte_for_byte(rosette):
    """Source: Kniel et al. (2019), Table 1: n = 6, R = 182.5 mm, case 2."""
    answer = rosette('plan', '--balls', 6, '--radius-mm', 182.5, '--order', 'diagonal', '--csv')
    assert answer.code == 0
    assert answer.err == ''
    assert answer.out.encode() == (GOLDEN / 'table1.csv').read_bytes()


@pytest.mark.parametrize('order', ['row', 'diagonal', 'column', 'random'])
@pytest.mark.parametrize('n', [4, 7, 12])
def test_no_coordinate_reads_minus_zero(rosette, n, order):
    """What is zero to two decimals has no sign."""
    out = rosette('plan', '--balls', n, '--radius-mm', 100, '--order', order, '--csv').out
    assert '-0.00' not in out
    assert len(out.splitlines()) == n * n + 1


@pytest.mark.parametrize(('n', 'angle'), [(6, '60'), (16, '22.5'), (7, '51.428571429')])
def test_angles_are_written_as_exactly_as_needed(rosette, n, angle):
    """Whole degrees where exact, else up to nine decimals."""
    out = rosette('plan', '--balls', n, '--radius-mm', 100, '--order', 'row', '--csv').out
    second = next(row for row in csv.DictReader(io.StringIO(out)) if row['table_position'] == '2')
    assert second['table_angle_deg'] == angle


def test_json_is_one_object_in_si(rosette):
    """Every list has n * n entries; the travel of case 1 is one turn less one step."""
    answer = rosette('plan', '--balls', 5, '--radius-mm', 200, '--order', 'row', '--json')
    plan = json.loads(answer.out)
    assert plan['schema'] == 'rosette-plan/1'
    assert plan['radius_m'] == 0.2
    assert {len(plan[key]) for key in ('cmm_position', 'table_position', 'ball', 'centre_m',
                                       'table_angle_rad', 'approach')} == {25}
    assert plan['centre_m'][0] == [0.2, 0.0, 0.0]
    assert plan['travel']['table_rad'] == pytest.approx(2 * 3.141592653589793 * 4 / 5)
    assert plan['travel']['table_moves'] == 4


def test_the_list_for_a_person(rosette):
    """Map, targets, cost in motion."""
    out = rosette('plan', '--balls', 6, '--radius-mm', 182.5, '--order', 'diagonal').out
    assert '36 targets: 6 balls on a circle of R = 182.5 mm' in out
    assert '6.667 turns in 35 moves' in out
    assert '0.9125 m in 5 moves' in out  # five sides of a hexagon
    assert '\x1b' not in out


def test_seed_draws_the_random_order(rosette):
    """Same seed, same order; another seed, another one."""
    words = ('plan', '--balls', 6, '--radius-mm', 100, '--order', 'random', '--csv', '--seed')
    assert rosette(*words, 1).out == rosette(*words, 1).out != rosette(*words, 2).out


@pytest.mark.parametrize(('words', 'message'), [
    (('--balls', 2), 'number of balls: expected a whole number of at least 3, found 2; with fewer '
                     'the table, plate and CMM cannot be separated'),
    (('--order', 'zigzag'), "Unknown order 'zigzag'. Known: row, diagonal, column, random, interleaved, "
                             'there_and_back, row_there_and_back.'),
    (('--turning', 'left'), "Unknown turning 'left'. Known: forward, alternate, clockwise, counterclockwise."),
    (('--balls', '6.5'), "--balls: expected a whole number of at most 1000, found '6.5'"),
    (('--balls', '100000'), "--balls: expected a whole number of at most 1000, found '100000'"),
    (('--radius-mm', '-1'), "--radius-mm: expected a positive number (mm), found '-1'"),
    (('--radius-mm', 'nan'), "--radius-mm: expected a positive number (mm), found 'nan'"),
    (('--table-offset-deg', '-5'), '--table-offset-deg: expected an angle above 0 and below one step of the table, deg '
                                   "(for 0 leave the option out), found '-5'"),
    (('--format', 'png'), 'plan: --format goes with --figures only; leave it out'),
    (('--seed', '-1'), '--seed: expected a whole number in 0 .. '),
])
def test_what_cannot_be_planned(refused, words, message):
    """Each in one line with what was wanted and what came."""
    given = {'--balls': 6, '--radius-mm': 182.5, '--order': 'row'} | dict([words])
    assert message in refused('plan', *(f'{key}={value}' for key, value in given.items()))


def test_a_list_says_the_sense_of_turning_where_it_changes(rosette):
    """Forward only it is the table of the paper, without a further column."""
    words = ('plan', '--balls', 6, '--radius-mm', 100, '--order', 'row', '--csv')
    assert 'approach' not in rosette(*words).out
    rows = list(csv.DictReader(io.StringIO(rosette(*words, '--turning', 'alternate').out)))
    assert {row['approach'] for row in rows} == {'1', '-1'}


def test_a_missing_option_is_named(refused):
    """A missing option is named."""
    assert 'plan: expected either --order, or plan files' in refused('plan', '--balls', 6, '--radius-mm', 182.5)


def test_what_a_reduced_plan_determines(rosette):
    """Rank, uncertainty and the places in use are said before anything is measured."""
    out = rosette('plan', '--balls', 12, '--radius-mm', 182.5, '--order', 'diagonal', '--cmm-positions', 6).out
    assert '72 targets' in out
    assert '1, 2, 4, 6, 9, 10 of 12 in use; deviations of the others are not measured' in out
    assert ('113 of the 131 combinations of errors that a complete run determines; the curves with 1.52 times its '
            ) in ' '.join(out.split())


def test_the_template_is_a_table_to_be_filled(rosette, refused, tmp_path):
    """Filled in it is a run; rows that stay empty are missing balls, which are named; empty it is none."""
    path = tmp_path / 'mine.csv'
    path.write_text(rosette('plan', '--balls', 4, '--order', 'diagonal', '--radius-mm', 182.5, '--csv-template').out)
    assert 'expected rows of ball centres, found none' in refused('evaluate', path)
    targets = rosette('plan', '--balls', 4, '--order', 'diagonal', '--radius-mm', 182.5, '--csv').out.splitlines()[1:]
    lines = path.read_text().splitlines()
    names = lines[3].split(',')
    for row, target in enumerate(targets):
        cells = dict(zip(names, lines[4 + row].split(','), strict=True))
        cells |= dict(zip(('x_mm', 'y_mm', 'z_mm'), target.split(',')[4:7], strict=True), time_s=str(40 * row))
        if row not in (2, 9):
            lines[4 + row] = ','.join(cells.values())
    path.write_text('\n'.join(lines))
    out = ' '.join(rosette('info', path).out.split())
    assert '2 missing: ball' in out
    assert 'run 14 of 16' in out


def test_the_template_of_repeated_balls_evaluates(rosette, tmp_path):
    """Filled in with the centres of a simulated run in that order."""
    path = tmp_path / 'mine.csv'
    lines = rosette('plan', '--balls', 6, '--radius-mm', 182.5, '--order', 'there_and_back',
                    '--csv-template').out.splitlines()
    heading = [line for line in lines if line.startswith('#')]
    rows = list(csv.DictReader(lines[len(heading):]))
    run = simulated_run(n=6, order='there_and_back')
    for row, centre, time in zip(rows, 1e3 * run.centre, run.time, strict=True):
        row |= dict(zip(('x_mm', 'y_mm', 'z_mm'), map(repr, centre.tolist())), time_s=repr(float(time)))
    path.write_text('\n'.join([*heading, ','.join(rows[0]), *(','.join(row.values()) for row in rows)]))
    answer = rosette('evaluate', path)
    assert (answer.code, answer.err) == (0, '')
    assert '# repeated_balls: yes' in heading


def words_of(answer):
    """Return what was printed as one line."""
    return ' '.join(answer.out.split())


def test_a_plan_is_written_and_read_again(rosette, refused, tmp_path):
    """What it determines is told of the file as of the order; a file is not overwritten."""
    order = ('--balls', 12, '--radius-mm', 182.5, '--order', 'there_and_back', '--touches', 8)
    path = tmp_path / 'mine.csv'
    written, text = words_of(rosette('plan', *order, '-o', path)), path.read_text()
    assert f'calibrate --plan {path}' in written
    assert text.startswith('# schema: rosette-plan/1\n# balls: 12\n# radius_mm: 182.5\n# order: there_and_back\n')
    assert 'exists already' in refused('plan', *order, '-o', path)
    read = words_of(rosette('plan', path))
    assert read == written.partition(' Written to')[0]
    for words in ('113 of the 131 combinations', 'curves with 1.22 times its', 'deviations of the CMM at positions '
                  '3, 5, 7, 8, 11, 12: not measured', 'table_backlash 100 %', 'ctx 0.067 µm', 'Time 0.71 h'):
        assert words in read


def test_plans_side_by_side(rosette, tmp_path):
    """Files and orders: what each determines, what is better where; as text, JSON and CSV."""
    path = tmp_path / 'mine.yaml'
    path.write_text('{schema: rosette-plan/1, balls: 8, radius_mm: 182.5, order: there_and_back, cmm_positions: 5}')
    plans = ('plan', 'diagonal', 'diagonal:75%', path, '--touch-s', 3, '--table-move-s', 20)
    text = words_of(rosette(*plans))
    for words in ('Uncertainty of the curves, relative to a complete run: best is mine.yaml (0.98); diagonal 1.00',
                  'Time: best is diagonal:75% (1.04 h); diagonal 1.40 h; mine.yaml 1.75 h.', 'Only mine.yaml shows',
                  'mine.yaml does not measure the deviations of 3 CMM positions.'):
        assert words in text
    table = list(csv.DictReader(io.StringIO(rosette(*plans, '--csv').out)))
    assert [(row['plan'], row['readings']) for row in table] == [
        ('diagonal', '64'), ('diagonal:75%', '48'), ('mine.yaml', '80')]
    told = json.loads(rosette(*plans, '--json').out)
    assert told['schema'] == 'rosette-plans/1' and told['better'][1] in text
    assert float(table[2]['relative_uncertainty']) == told['plans'][2]['relative_uncertainty']
    assert told['plans'][2]['effects']['table_backlash']['typical_visible_fraction'] > 0.9


def test_effects_of_many_balls_are_not_judged(rosette):
    """It is said, of one plan and of several."""
    for plans in (['row'], ['row', 'diagonal']):
        assert 'judged up to 36 balls' in words_of(rosette('plan', *plans, '--balls', 40, '--radius-mm', 100))


def test_an_axis_without_direction_is_named(refused):
    """By its option."""
    assert '--axis: expected 3 finite numbers that are not all 0, found 0 0 0' in refused('demo', '--axis', 0, 0, 0)


def test_pictures_of_plans(rosette, tmp_path):
    """Pairs of each plan, uncertainty, effects side by side."""
    rosette('plan', 'row', 'there_and_back', '--balls', 6, '--radius-mm', 100, '--figures', tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'pairs_1.svg', 'pairs_2.svg', 'shares.svg', 'uncertainty.svg']
    assert 'ideal: √(n²/N)' in (tmp_path / 'uncertainty.svg').read_text()
    assert 'there_and_back: 48 readings' in (tmp_path / 'pairs_2.svg').read_text()


def test_options_may_stand_between_plans(rosette):
    """As people type them."""
    apart = rosette('plan', 'row', '--balls', 6, '--radius-mm', 100, 'diagonal')
    assert apart.out == rosette('plan', 'row', 'diagonal', '--balls', 6, '--radius-mm', 100).out != ''


def test_what_a_plan_shows_depends_on_the_axis(rosette, refused):
    """Balls sag about a horizontal axis only."""
    plan = ('plan', 'there_and_back', '--balls', 6, '--radius-mm', 100)
    upright, lying = (json.loads(rosette(*plan, *axis, '--json').out)['expected']['effects']
                      for axis in ((), ('--axis', 0, 1, 0)))
    assert 'ball_sag' not in upright
    assert lying['ball_sag']['typical_visible_fraction'] > 0.3
    assert '(0, 1, 0)' in rosette(*plan, '--axis', 0, 1, 0).out
    assert '--axis: expected 3 numbers that are not all 0, found [0.0' in refused(*plan, '--axis', 0, 0, 0)


def test_the_places_of_the_help_can_be_measured(rosette):
    """The order that the help names determines the curves of the usual plate."""
    parser = argparse.ArgumentParser()
    plan_arguments(parser)
    order, = re.findall(r'row:[\d,]+', parser.format_help())
    got = json.loads(rosette('plan', order, '--balls', 12, '--radius-mm', 182.5, '--json').out)
    assert len(got['ball']) == 48


def test_a_plate_of_fewer_balls_than_positions_is_called_so(rosette, tmp_path):
    """Balls, places and table positions are told apart."""
    plate = tmp_path / 'plate.yaml'
    plate.write_text('schema: rosette-plate/1\nazimuth_deg: [0, 20, 60, 80, 140, 200, 300]\nradius_mm: 100\n')
    out = rosette('plan', '--plate', plate, '--balls', 18, '--order', 'diagonal').out
    assert '126 targets: 7 balls on a circle of R = 100 mm, 18 table positions' in out
    assert 'Ball places' in out and '1, 2, 4, 5, 8, 11, 16 of 18 in use' in out


@pytest.mark.parametrize(('words', 'message'), [
    (('row', 'diagonal'), 'plan: expected --balls and --radius-mm with an order, or a plan file'),
    (('rows', '--balls', 6, '--radius-mm', 100), "Unknown order 'rows'. Did you mean row?"),
    (('nothing.csv',), 'nothing.csv: expected a plan file, or one of row, diagonal'),
    (('row:3', '--balls', 12, '--radius-mm', 100), '3 of 12 CMM positions do not determine the curves'),
    (('row', '--balls', 12, '--radius-mm', 100, '--balls-of', 1), '1 of 12 balls do not determine the curves'),
    (('row', '--balls', 12, '--radius-mm', 100, '--share', 1.5),
     "--share: expected a part of the CMM positions, above 0 and at most 1, found '1.5'"),
    (('row', '--order', 'row'), 'plan: expected either --order, or plan files and orders to compare'),
    (('row', '--balls', 6, '--radius-mm', 100, '-o', 'plan.txt'), '--output: expected a name that ends in .csv, found'),
    (('row', 'column', '--balls', 6, '--radius-mm', 100, '-o', 'plan.csv'), 'expected one plan to write, found '
                                                                            'several'),
    (13 * ('row',), 'plan: expected at most 12 plans, found 13')])
def test_what_cannot_be_compared(refused, words, message):
    """One line each."""
    assert message in refused('plan', *words)


def test_the_shortest_plan(rosette, refused):
    """Four CMM positions determine the curves of 12 balls; it chooses them itself, in a cell likewise."""
    words = ('plan', '--balls', 12, '--radius-mm', 182.5, '--order', 'sensitive', '--shortest')
    got = json.loads(rosette(*words, '--json').out)
    assert (len(got['ball']), got['expected']['rank']) == (48, 107)
    assert 'not allowed with argument' in refused(*words, '--cmm-positions', 6)
    assert places_in_use(FEWEST, 12) == tuple(sorted(set(got['cmm_position'])))
