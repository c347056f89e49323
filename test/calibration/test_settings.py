# SPDX-License-Identifier: Apache-2.0
"""Settings and options: what is taken, and the words for what is not."""

import math
from dataclasses import replace
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosette_ros.calibration.goal import Request
from rosette_ros.calibration.settings import (
    LIMITS,
    PLANNED,
    Wanted,
    changed_settings,
    format_settings,
    goal_changes,
    limits_of,
    parse_options,
    parse_settings,
    plan_of,
    run_name,
    with_identity,
)
from rosette_ros.calibration.state_machine import Limits
from rosette_ros.core.run.errors import InvalidConfig, RosetteError
from rosette_ros.core.run.scheme import ORDERS, plan
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.messages import Phase
from rosette_ros.io.plan_file import MeasuringPlan, format_plan

DEFAULTS = {wanted.name: wanted.default for wanted in PLANNED + LIMITS}
WHOLE = Wanted('balls', 12, 'number of balls', 3, 1000)
REAL = Wanted('radius', 0.1, 'radius, m', 0.001, 10.0)
WORD = Wanted('order', 'row', 'order', choices=('row', 'column'))
POINT = Wanted('origin', (0.0, 0.0, 0.0), 'origin, m', -1.0, 1.0)
FLAG = Wanted('check', True, 'whether')


@pytest.mark.parametrize(('wanted', 'given', 'taken'), [
    (WHOLE, 5, 5), (WHOLE, 5.0, 5), (REAL, 1, 1.0), (WORD, 'column', 'column'),
    (POINT, [0, 1, -1.0], (0.0, 1.0, -1.0)), (FLAG, False, False)])
def test_sensible_values_are_taken_in_the_right_type(wanted, given, taken):
    """A whole number may stand where a number is wanted, as people write YAML."""
    got = wanted.check(given, 'here')
    assert got == taken
    assert type(got) is type(wanted.default)


@pytest.mark.parametrize(('wanted', 'given', 'words'), [
    (WHOLE, 2, r'here: balls: expected a whole number in 3 \.\. 1000 \(number of balls\), found 2'),
    (WHOLE, 5.5, 'found 5.5'), (WHOLE, '5', "found '5'"), (WHOLE, True, 'found True'),
    (REAL, math.nan, r'expected a number in 0\.001 \.\. 10 \(radius, m\), found nan'),
    (REAL, math.inf, 'found inf'), (REAL, 11.0, 'found 11.0'), (REAL, None, 'found None'),
    (WORD, 'rows', "expected one of row, column .*, found 'rows'"),
    (POINT, [0, 0], r'expected a list of 3 numbers in -1 \.\. 1'), (POINT, '000', "found '000'"),
    (POINT, [0, 0, math.nan], 'nan'), (POINT, 3, 'found 3'),
    (FLAG, 1, 'expected true or false .*, found 1'), (FLAG, 'yes', "found 'yes'")])
def test_other_values_are_refused_in_words(wanted, given, words):
    """The words say where, what was wanted and what came."""
    with pytest.raises(InvalidConfig, match=words):
        wanted.check(given, 'here')


def test_options_change_a_calibration():
    """Options are a YAML mapping of known names."""
    assert parse_options('') == {}
    assert parse_options('{repeats: 5, turning: alternate, limits.attempts: 1}') == {
        'repeats': 5, 'turning': 'alternate', 'limits.attempts': 1}


@pytest.mark.parametrize(('text', 'words'), [
    ('repeat: 5', "options: expected one of turning, .*, found 'repeat'; did you mean 'repeats'"),
    ('repeats: -1', r'options: repeats: expected a whole number in 0 \.\. 10000'),
    ('repeats', 'expected a YAML mapping such as "repeats: 5", found \'repeats\''),
    ('a: [', 'options: expected YAML, found text that is none: line 2'),
    ('!!python/object/apply:os.system [true]', 'text that is none'),
    ('turning: sideways', 'expected one of forward, alternate'),
    ('x' * 10_001, 'expected at most 10000 characters, found 10001'),
    ('&a [*a]', 'options: line 1: expected plain YAML, found an alias'),
])
def test_bad_options_are_refused_in_words(text, words):
    """No name is guessed, no code is run."""
    with pytest.raises(InvalidConfig, match=words):
        parse_options(text)


@given(st.text(max_size=200))
def test_no_options_text_breaks_the_sequencer(text):
    """Any text is taken or refused in one line."""
    try:
        parse_options(text)
    except RosetteError as error:
        assert '\n' not in str(error)


def changes(**fields):
    return goal_changes(fields)


def test_what_a_goal_leaves_out_is_as_configured():
    """An empty order means as configured; a seed alone changes the seed."""
    assert changes() == {}
    assert changes(seed=7) == {'seed': 7}
    assert changes(order='random', seed=7, options='repeats: 2') == {'order': 'random', 'seed': 7, 'repeats': 2}


def test_every_field_of_a_goal_changes_its_setting():
    """Where 0 means as configured, none at all has a number of its own."""
    assert changes(balls=6, radius=0.2, turning='alternate', repeats=4, drift_check=1, attempts=2, skips=5,
                   resume='run_a') == {
        'plate.balls': 6, 'plate.radius_m': 0.2, 'turning': 'alternate', 'repeats': 4, 'drift_check': True,
        'limits.attempts': 2, 'limits.skips': 5, 'resume': 'run_a'}
    assert changes(repeats=-1, drift_check=-1, skips=-1) == {'repeats': 0, 'drift_check': False, 'limits.skips': 0}


@pytest.mark.parametrize(('fields', 'words'), [
    ({'order': 'circle'}, r"goal: order: expected one of row.*found 'circle'"),
    ({'balls': 2}, r'goal: plate.balls: expected a whole number in 3 \.\. 1000'),
    ({'radius': -0.1}, 'goal: plate.radius_m: expected a number'), ({'repeats': -2}, 'goal: repeats: .*found -2'),
    ({'drift_check': 3}, 'goal: drift_check: expected true or false'),
    ({'skips': 1, 'options': 'limits.skips: 2'}, 'options: limits.skips: expected it once, found it in the fields'),
])
def test_bad_fields_are_refused_in_words(fields, words):
    """Each by the name of its setting."""
    with pytest.raises(InvalidConfig, match=words):
        changes(**fields)


def test_a_request_records_the_fields_that_are_set():
    """Besides those that the event has itself."""
    request = Request('calibrate', {'order': 'row', 'balls': 6, 'drift_check': -1})
    assert request.fields == 'balls: 6\ndrift_check: -1\n'
    assert Request('calibrate', {'order': 'row', 'seed': 3, 'options': 'repeats: 1'}).fields == ''


def test_plan_and_limits_come_from_the_settings():
    """All settings arrive where they belong."""
    values = {**DEFAULTS, 'plate.balls': 6, 'table.azimuth_deg': 90.0, 'repeats': 2,
              'drift_check': False, 'limits.attempts': 7}
    planned = plan_of(values)
    assert planned.total == 2 + 12 + 36
    x_axis = planned.taught.rotation[:, 0]
    assert x_axis == pytest.approx([0, 1, 0], abs=1e-15)
    assert limits_of(values).attempts == 7
    assert limits_of(DEFAULTS) == Limits()


def test_run_names_are_unique():
    """Two runs within a second get different names."""
    when = datetime(2026, 4, 12, 8, 30, 0, tzinfo=UTC)
    first = run_name(when, 'row', set())
    assert first == 'rosette_20260412_083000_row'
    second = run_name(when, 'row', {first})
    assert second == 'rosette_20260412_083000_row_2'
    assert run_name(when, 'row', {first, second}).endswith('_3')


PLACES_GIVEN = {'none': {}, 'cmm_positions': {'cmm_positions': '1, 2, 4, 5, 7, 10'}, 'balls_of': {'balls_in_use': '8'},
                'share': {'cmm_positions': '50 %'}, 'shortest': {'cmm_positions': 'fewest'},
                'balls': {'balls_in_use': '1, 2, 4, 6, 9, 10'}}


@pytest.mark.parametrize('order', ORDERS)
@pytest.mark.parametrize('given', PLACES_GIVEN.values(), ids=PLACES_GIVEN)
def test_recorded_settings_give_the_same_plan(order, given):
    """What a log has of the settings makes the plan of the run again, target by target, so that it can be resumed."""
    values = {**DEFAULTS, 'order': order, 'seed': 3, **given}
    planned, recorded = plan_of(values), parse_settings(format_settings(values), 'log')
    again = plan_of({**values, **recorded})
    assert [again.target(k) for k in range(again.total)] == [planned.target(k) for k in range(planned.total)]
    assert parse_settings(format_settings(recorded), 'log') == recorded


def own_plan(size=30, sessions=1):
    """Return a plan of readings that no order has, with touches and pauses."""
    scheme = plan(6, 'random', 4)
    chosen = replace(scheme, order='mine', touches=np.where(np.arange(36) % 5, 8, 20),
                     session=1 + np.arange(36) * sessions // 36)
    return MeasuringPlan(replace(chosen, **{name: getattr(chosen, name)[:size] for name in (
        'table_position', 'ball', 'approach', 'touches', 'session')}), 0.15)


@pytest.mark.parametrize('by_path', [False, True])
def test_a_plan_file_decides_what_is_measured(tmp_path, by_path):
    """By its path or by its text; the record makes the same targets again, without the file."""
    made, path = own_plan(), tmp_path / 'mine.csv'
    path.write_text(format_plan(made))
    own = {'plan': str(path) if by_path else path.read_text()}
    values = changed_settings({**DEFAULTS, **own}, changes(repeats=3))
    path.unlink()
    planned, recorded = plan_of(values), parse_settings(format_settings(values), 'log')
    again = plan_of({**values, **recorded})
    assert [again.target(k) for k in range(again.total)] == [planned.target(k) for k in range(planned.total)]
    run = [target for target in map(planned.target, range(planned.total)) if target.phase == Phase.RUN]
    assert [target.ball for target in run] == made.scheme.ball.tolist()
    assert [target.touches for target in run] == made.scheme.touches.tolist()
    assert {(target.balls, target.radius) for target in run} == {(6, 0.15)} and planned.scheme.order == 'mine'
    assert planned.target(0).touches == 8


def test_an_order_takes_the_place_of_a_configured_plan():
    """Touches, repeats and limits do not."""
    configured = changed_settings(DEFAULTS, {'plan': format_plan(own_plan())})
    assert plan_of(changed_settings(configured, changes(repeats=2))).scheme.order == 'mine'
    assert plan_of(changed_settings(configured, changes(order='row'))).scheme.order == 'row'


@pytest.mark.parametrize(('goal', 'words'), [
    ({'order': 'row'}, 'goal: order: the plan decides it; leave out one of the two'),
    ({'options': 'turning: alternate'}, 'goal: turning: the plan decides it'),
    ({'balls': 6}, 'goal: plate.balls: the plan decides it')])
def test_a_plan_and_an_order_contradict_each_other(goal, words):
    """A goal has one of the two."""
    with pytest.raises(InvalidConfig, match=words):
        changes(plan=format_plan(own_plan()), **goal)


MOVED = [0, 30, 60, 90, 130, *range(150, 360, 30)]
PLATE = f'schema: rosette-plate/1\nazimuth_deg: {MOVED}\nradius_mm: 182.5\n'


@pytest.mark.parametrize('by_path', [True, False])
def test_a_plate_file_decides_radius_and_balls(tmp_path, by_path):
    """Its balls are places of a plate with as many as the table has positions; only they are asked for; resumable."""
    path = tmp_path / 'plate.yaml'
    path.write_text(PLATE)
    own = {'plate.file': str(path) if by_path else PLATE}
    values = changed_settings({**DEFAULTS, **own}, changes(balls=36, repeats=3))
    planned, recorded = plan_of(values), parse_settings(format_settings(values), 'log')
    again = plan_of({**DEFAULTS, **recorded})
    targets = [planned.target(k) for k in range(planned.total)]
    assert [again.target(k) for k in range(again.total)] == targets
    assert planned.alignments == 36 + 12
    assert {target.ball for target in targets} == {angle // 10 + 1 for angle in MOVED}
    assert len([one for one in targets if one.phase == Phase.RUN]) == 36 * 12
    assert not values['plan'] and values['plate.radius_m'] == 0.1825


@pytest.mark.parametrize(('goal', 'words'), [
    ({'plate': PLATE, 'balls': 12}, 'ball 5: expected it within 1 mm of a multiple of 30 deg, the step of 12 table '),
    ({'plate': PLATE.replace('[0, 30', '[10, 30'), 'balls': 36}, 'expected a ball at azimuth 0, from which balls are'),
    ({'plate': PLATE, 'balls': 36, 'cmm_positions': '8'}, 'cmm_positions: expected none beside a plate file'),
    ({'plate': PLATE.replace('130', '120'), 'balls': 36}, '1, 4, 7, 10, 13, .* of 36 do not determine the curves'),
    ({'plate': 'no-such.yaml', 'balls': 36}, 'goal: plate.file: expected the lines of a file, found .no-such')])
def test_plates_that_cannot_be_measured_are_refused(goal, words):
    """In one line."""
    with pytest.raises(RosetteError, match=words):
        plan_of(changed_settings(DEFAULTS, changes(**goal)))


def test_a_goal_for_another_plate_leaves_the_configured_file_out():
    """Radius or balls of a goal, or a plan, take the place of the plate file."""
    configured = changed_settings(DEFAULTS, changes(plate=PLATE, balls=36))
    values = changed_settings(configured, changes(radius=0.1, balls=8) | {'balls_in_use': ''})
    assert (values['plate.file'], plan_of(values).alignments) == ('', 16)
    assert changed_settings(configured, changes(plan=format_plan(own_plan())))['plate.file'] == ''


def test_who_what_and_where_travel_in_the_settings_of_the_log(tmp_path):
    """The file as it is when the run begins; what the log says stays when the run is resumed; no plan changes by it."""
    path = tmp_path / 'identity.yaml'
    path.write_text('schema: rosette-identity/1\ntable: {serial: "T-1"}  # of the customer\n')
    values = with_identity({**DEFAULTS, 'identity': str(path)})
    log = LogRun(tmp_path, ())
    log.events = [SimpleNamespace(run_id='a', settings=format_settings({**DEFAULTS, 'identity': ''})),
                  SimpleNamespace(run_id='a', settings=format_settings(values)),
                  SimpleNamespace(run_id='b', settings='identity: [')]
    assert log.identity('a')['table.serial'] == 'T-1'
    assert log.identity('b') == log.identity('c') == Identity()
    path.write_text('schema: rosette-identity/1\ntable: {serial: "T-2"}\n')
    resumed = with_identity({**DEFAULTS, 'identity': str(path)} | parse_settings(format_settings(values), 'log'))
    assert resumed == values
    with pytest.raises(RosetteError, match=r'no.yaml: expected an identity file that can be read'):
        with_identity({**DEFAULTS, 'identity': str(tmp_path / 'no.yaml')})
