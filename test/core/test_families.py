# SPDX-License-Identifier: Apache-2.0
"""Families of causes from truths written out here: named, or without a name where no family has the shape."""

import numpy as np
import pytest
from synthetic import RADIUS, synthetic_run

from rosette_ros.core.diagnosis.diagnosis import diagnose, find
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.effects.run_functions import COARSE, lagged, last_move, temperature_change, temperature_waves
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.words.verdict_words import unexplained_words, verdict_text

SIGMA = 1e-7


def measured(displacement, order='random', strength=20.0, seed=3, n=12):
    """Return a run that is displaced by a function of it, (N, 3), of a visible norm of `strength` sigma."""
    run, *_ = synthetic_run(n, order, seed, turning='alternate')
    run = run.replace(temperature=20 + 0.1 * np.sin(run.time / 900), repeatability=SIGMA)
    moved = np.asarray(displacement(run), dtype=float)
    visible = np.linalg.norm(BaseSpace(run, RADIUS, BASE_TERMS).residual(moved[None]))
    noise = SIGMA * np.random.default_rng(seed).standard_normal(moved.shape)
    return run.replace(centre=run.centre + strength * SIGMA / visible * moved + noise)


def share(run):
    """Return the time from 0 to 1."""
    return run.time / run.time[-1]


def of_ball(run, ball, course, direction):
    """Return a move of one ball in the frame of the plate."""
    return rotate_z(run.phi, (course * (run.ball == ball))[:, None] * np.array(direction))


def on_a_soft_foot(run, sinks, circle=0.12, above=0.06):
    """Return what the balls, so high above three feet, do where the foot at x of the plate sinks.

    The plate turns about the line of the two others, at x = -circle / 2."""
    turn = sinks / (1.5 * circle)
    x = RADIUS * np.cos(run.beta) + circle / 2
    return rotate_z(run.phi, np.stack([turn * above, 0 * turn, -turn * x], axis=1))


def around(run, course):
    """Return a course of the turning of the table."""
    return course[:, None] * np.stack([-np.sin(run.alpha), np.cos(run.alpha), 0 * run.alpha], axis=1)


def outwards(run, course):
    """Return a course of the size of the plate."""
    return course[:, None] * np.stack([np.cos(run.alpha), np.sin(run.alpha), 0 * run.alpha], axis=1)


def lag(run):
    """Return what follows the temperature late."""
    return lagged(run.time, run.temperature - 20, 1500.0)


Z, X = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
TRUTHS = {
    'frame_drift_onset': lambda run: np.maximum(share(run) - 0.6, 0)[:, None] * X,
    'frame_drift_curved': lambda run: (share(run) - share(run)**2)[:, None] * Z,
    'frame_temperature_lag': lambda run: lag(run)[:, None] * Z,
    'frame_pulse': lambda run: ((share(run) > 0.4) & (share(run) < 0.5))[:, None] * X,
    'frame_recovery': lambda run: ((share(run) > 0.3) * np.exp(-np.maximum(share(run) - 0.3, 0) / 0.1))[:, None] * X,
    'table_zero_step': lambda run: around(run, share(run) > 0.6),
    'axis_tilt_step': lambda run: ((share(run) > 0.4) * np.sin(run.alpha - 1))[:, None] * Z,
    'table_zero_warmup': lambda run: around(run, -np.expm1(-share(run) / 0.2)),
    'axis_tilt_warmup': lambda run: (np.expm1(-share(run) / 0.2) * np.sin(run.alpha - 1))[:, None] * Z,
    'table_zero_temperature': lambda run: around(run, run.temperature - 20),
    'axis_tilt_temperature': lambda run: ((run.temperature - 20) * np.sin(run.alpha - 1))[:, None] * Z,
    'table_zero_lag': lambda run: around(run, lag(run)),
    'axis_tilt_lag': lambda run: (lag(run) * np.sin(run.alpha - 1))[:, None] * Z,
    'cmm_scale_temperature': lambda run: ((run.temperature - 20) * np.cos(run.alpha))[:, None] * X,
    'cmm_scale_lag': lambda run: (lag(run) * np.cos(run.alpha))[:, None] * X,
    'probe_approach': lambda run: np.cos(3 * last_move(run)[0] - 1)[:, None] * Z,
    'table_backlash_angle': lambda run: around(run, run.approach * np.cos(run.phi - 1)),
    'plate_support': lambda run: (np.cos(run.phi - 0.3) * np.cos(3 * run.beta + 1))[:, None] * Z,
    'plate_creep_settling': lambda run: rotate_z(run.phi, -np.expm1(-share(run) / 0.2)[:, None] * [0.8, -0.6, 0]),
    'plate_tilt_step': lambda run: ((share(run) > 0.4) * np.sin(run.beta - 1))[:, None] * Z,
    'plate_tilt_settling': lambda run: on_a_soft_foot(run, -np.expm1(-share(run) / 0.3)),
    'plate_soaking': lambda run: outwards(run, -np.expm1(-share(run) / 0.3)),
    'plate_expansion_lag': lambda run: outwards(run, lag(run)),
    'ball_creep': lambda run: of_ball(run, 5, -np.expm1(-share(run) / 0.25), [1, 0.5, -0.7]),
    'ball_rattle': lambda run: of_ball(run, 7, (share(run) > 0.3) & (share(run) < 0.7), [1, -1, 0.5]),
    'ball_machine_offset': lambda run: (run.ball == 4)[:, None] * np.array([1, -0.4, 0]),
    'cmm_scale_drift': lambda run: (share(run) * np.cos(run.alpha))[:, None] * X,
    'cmm_squareness_drift': lambda run: (share(run) * np.sin(run.alpha))[:, None] * X,
}


@pytest.mark.long
def test_a_family_is_named():
    """A cause of 20 sigma is named alone; what looks the same in this order may be said beside it."""
    wrong = {}
    for name, truth in TRUTHS.items():
        found = find(measured(truth))
        if found.missing != (name,) or found.unexplained:
            wrong[name] = (found.missing, found.verdict.look_alikes, unexplained_words(found.verdict),
                           found.final.noise.kinds)
    assert not wrong, wrong


def test_three_balls_that_creep_are_no_plate_that_tilts():
    """Neighbours that a hand has warmed, each with its own time: a tilt of the plate explains more than one alone."""
    def displacement(run):
        return sum(of_ball(run, ball, -np.expm1(-share(run) / tau), [0.3 * size, 0, size])
                   for ball, size, tau in ((6, 1.0, 0.3), (7, 1.3, 0.15), (8, 0.8, 0.4)))

    found = find(measured(displacement, 'interleaved', 40.0, n=8))
    assert found.missing == ('ball_creep',) and not found.unexplained
    assert {one.number('ball') for one in found.causes} == {6, 7, 8}


@pytest.mark.long
def test_the_direction_of_approach_is_judged_where_positions_are_left_out_by_plan():
    """The CMM went from reading to reading; where one is lost, it came from a ball that the run does not have."""
    run = measured(TRUTHS['probe_approach'], 'there_and_back')
    assert find(run).missing == ('probe_approach',)
    lost = run.take(np.arange(run.size) != 40)
    assert ('probe_approach', EFFECTS['probe_approach'].unavailable(lost)) in diagnose(lost).unavailable
    assert 'where readings are missing' in EFFECTS['probe_approach'].unavailable(lost)


@pytest.mark.long
def test_the_first_move_of_the_probe_makes_no_wrong_reading():
    """The CMM came to the first ball along 130 degrees, which is not recorded: found within 4 u, and no outlier."""
    for order, part in (('column', 'along'), ('random', 'along'), ('random', 'across')):
        def displacement(run, part=part):
            theta, known = last_move(run)
            theta = np.where(known[:, 0], theta, np.deg2rad(130)) + (np.pi / 2 if part == 'across' else 0)
            return np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
        found = find(measured(displacement, order, 40.0))
        assert found.missing == ('probe_approach',), (order, part, verdict_text(found.verdict).sentence)
        claim, = found.final.effects
        theta0 = claim.parameters[-1]
        assert claim.setting['part'] == part and theta0.name == 'theta0' and theta0.u < np.deg2rad(15)
        assert np.angle(np.exp(1j * (theta0.value - np.deg2rad(130)))) == pytest.approx(0, abs=4 * theta0.u)


FOREIGN = {
    'growing ever faster': (lambda run: np.exp(5 * share(run))[:, None] * X, {'time'}, 'frame along x'),
    'a plate that grows by spurts': (
        lambda run: outwards(run, share(run) + 0.3 * np.sin(12 * share(run))), {'time'}, 'plate growing'),
    'a plate that slides to and fro': (
        lambda run: rotate_z(run.phi, np.sin(13 * share(run)**2)[:, None] * X), {'time'}, 'plate along its x and y'),
    'a ball that wanders': (
        lambda run: of_ball(run, 6, np.sin(17 * share(run)**2), [0, 0, 1]), {'ball', 'time'}, 'frame along z'),
    'what does not come again is no cycle': (
        lambda run: np.sin(2 * np.pi * 1.4 * share(run) + 0.5)[:, None] * np.array([0.6, -0.5, 0.6]),
        {'time'}, 'frame along x, y and z'),
    'a plate that swings once': (
        lambda run: rotate_z(run.phi, np.sin(2 * np.pi * 1.1 * share(run) + 0.5)[:, None] * np.array([0.8, -0.6, 0])),
        {'time'}, 'plate along its x and y')}


@pytest.mark.long
def test_a_foreign_shape_has_no_name():
    """No effect is claimed; body, direction and variables are told, those of a ball with its number."""
    wrong = {}
    for kind, (displacement, variables, motion) in FOREIGN.items():
        found = find(measured(displacement, 'diagonal' if kind == 'a plate that swings once' else 'random', 40.0))
        told = {(one.driven_by, one.motion) for one in found.unnamed}
        if (found.missing or len(told) != 1 or found.verdict.outcome != Outcome.UNNAMED
                or not any(frozenset(variables) in sets and along == motion for sets, along in told)
                or (kind == 'a ball that wanders' and not found.unnamed[0].setting['of'].startswith('ball 6 '))):
            wrong[kind] = (found.missing, unexplained_words(found.verdict), found.final.noise.kinds)
    assert not wrong, wrong


@pytest.mark.long
def test_several_cycles_of_one_motion_are_one_cause_of_an_open_law():
    """A cycle that changes its pace is told as what moves with what; cycles of several periods are at most likely."""
    cause, = find(measured(lambda run: np.sin(9 * (1 + share(run))**2)[:, None] * X, 'random', 40.0)).causes
    assert ('frame' in cause.bodies, 'time' in cause.variables[0], cause.law_certain) == (True, True, False)


@pytest.mark.long
def test_a_period_is_searched_from_two_cycles_in_the_run_on():
    """Cycles in time, and orders of the table's motion away from whole numbers, as far as they are refined."""
    for order in ('row', 'diagonal', 'random'):
        run, *_ = synthetic_run(12, order, 3)
        cycle, motion = EFFECTS['frame_cycle'], EFFECTS['asynchronous_motion']
        for setting in cycle.settings(run):
            assert max(setting['period'], *cycle.brackets(run, setting)['period']) <= run.time[-1] / 2 * (1 + 1e-9)
        turns = max(np.ptp(run.table_travel) / (2 * np.pi), 1)
        for setting in motion.settings(run):
            low, high = motion.brackets(run, setting)['nu']
            assert low - 1e-9 <= setting['nu'] <= high + 1e-9
            if high < 1:
                assert turns * low >= 2 - 1e-9 or low >= 0.35
                assert turns * (1 - high) >= 2 - 1e-9 or high <= 0.65
            elif low > 2:
                assert min(low % 1, 1 - high % 1) >= min(1 / turns, 0.3) - 1e-9  # or a synchronous one that changes


@pytest.mark.long
def test_a_step_is_found_at_its_moment():
    """At 40 sigma a step after reading 50 is found between readings 50 and 51, and nothing beside it."""
    found = find(measured(lambda run: (np.arange(run.size) >= 50)[:, None] * Z, strength=40.0))
    assert found.missing == ('frame_step',)
    assert 49 * 40 < found.terms[0].fixed['t0'] < 50 * 40


@pytest.mark.long
def test_a_ball_that_is_off_at_its_first_or_last_reading_is_an_outlier():
    """The simpler story is told first, the other one as what would look the same."""
    run, *_ = synthetic_run(12, 'random', 3, turning='alternate')
    told = {}
    for place in (0, -1):
        reading = np.flatnonzero(run.ball == 8)[place]
        found = find(measured(lambda run, at=reading: (np.arange(run.size) == at)[:, None] * np.array([1, 1, -1])))
        assert found.missing == ('outlier',) and found.terms[0].fixed['reading'] == reading + 1
        told[place] = found.verdict.look_alikes
    assert all('ball_slip' in alike for alike in told.values()), told


def test_a_coarse_temperature_is_taken_as_smooth():
    """A ramp that is recorded in steps of 0.1 K is a ramp again; a record of different values stays as it is."""
    run, *_ = synthetic_run(8)
    ramp = 20 + 0.5 * share(run)
    coarse = run.replace(temperature=np.round(ramp, 1))
    assert np.ptp(np.diff(temperature_change(coarse))[COARSE:-COARSE]) < 0.1 * 0.1
    fine = run.replace(temperature=ramp)
    assert np.array_equal(temperature_change(fine), fine.temperature - fine.temperature[0])


@pytest.mark.long
def test_a_gap_of_the_temperatures_leaves_it_open():
    """Two waves in the gap, zero outside of it; what follows the temperature is named although a third is unknown."""
    run = measured(TRUTHS['frame_temperature_lag'], strength=40.0)
    gap = (share(run) > 0.4) & (share(run) < 0.7)
    partial = run.replace(temperature=np.where(gap, np.nan, run.temperature))
    waves = temperature_waves(partial)
    assert len(waves) == 3 and not waves[1:, ~gap].any()
    assert np.allclose(waves[0, ~gap], (run.temperature - run.temperature[0])[~gap])
    assert 'no temperatures' in EFFECTS['frame_temperature'].unavailable(run.replace(temperature=np.full(144, np.nan)))
    found = find(partial)
    assert 'frame_temperature_lag' in (*found.missing, *found.verdict.look_alikes)


@pytest.mark.long
def test_a_load_that_turns_in_the_plate_needs_two_amplitudes():
    """A plate on three feet on a tilted table: a wave against the table's sense, and none beside it."""
    found = find(measured(lambda run: np.cos(2 * run.beta - run.phi + 0.5)[:, None] * Z))
    assert [term.name for term in found.terms] == ['plate_support']
    assert found.terms[0].fixed == {'part': 'z', 'p': 1, 'm': 2, 'wave': 'against'}
    assert found.final.effects[0].parameters[0].value != 0 and len(found.final.effects[0].parameters) == 2


@pytest.mark.long
def test_the_recovered_shape_beside_a_true_claim_is_that_of_the_claim():
    """Within U at nine of ten points, and larger than U."""
    for order in ('random', 'sensitive'):
        beside, = diagnose(measured(TRUTHS['frame_drift_curved'], order, strength=40.0)).recovered
        assert beside.claim == 'frame_drift_curved'
        z = next(one for one in beside.curves if one.axis.endswith('z'))
        assert np.mean(np.abs(z.value - z.claimed) <= 2 * z.u) > 0.9
        assert np.abs(z.claimed).max() > 5 * z.u.max()


@pytest.mark.long
def test_what_has_one_size_is_drawn_by_its_two_sides():
    """Backlash of one size: a flat line at 0 without a band stood beside its claim."""
    found = diagnose(measured(lambda run: around(run, run.approach), strength=40.0))
    shape, = found.recovered
    curve, = shape.curves
    assert found.missing == ('table_backlash',) and shape.variable == 'table sense'
    assert np.array_equal(np.sign(curve.value), shape.values) and (curve.u > 0).all()
    assert np.abs(curve.value - curve.claimed).max() < 2 * curve.u.max()


def test_what_lags_follows_a_step_exponentially():
    """tau y' = x - y: after a ramp of one reading, y goes to the driver as exp(-t/tau)."""
    time = np.linspace(0, 10, 101)
    y = lagged(time, (time > 0.05).astype(float), 2.0)
    assert np.allclose(y[1:], 1 - (1 - y[1]) * np.exp(-(time[1:] - time[1]) / 2), atol=1e-12)
    assert 0 < y[1] < 0.05
