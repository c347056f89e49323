# SPDX-License-Identifier: Apache-2.0
"""U in an environment: what an order hides counts as it is stated, what it shows as the readings say."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import RADIUS

from rosette_ros.core.effects.effect import Motion, Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.experience import Experience, KnownCause
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.plan_comparison import outlook
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.uncertainty.hidden_effects import (
    CLAIMED,
    MATTERS,
    at_ball,
    kind_of,
    size_per_rms,
    source_of,
    surrounded,
    unseen,
)
from rosette_ros.core.uncertainty.stated_environment import CLASSES, KINDS, LABORATORY, Environment, Size

NOISE = 1e-7


def only(name, size):
    """Return an environment of one effect, m at a ball."""
    return Environment(effects={name: Size(size, 'test')})


@pytest.mark.parametrize('n', [6, 12])
def test_a_hidden_drift_by_hand(make_run, n):
    """The example of docs/uncertainty.md: the angle of the table drifts by S in a run in the order row.

    Position i has the mean time i n + (n - 1) / 2 in units of the time between readings; the mean of the curve is free,
    so that u grows by S n (i - (n - 1) / 2) / (n^2 - 1). Nothing of it is in the residuals: it is there or not as
    before, and its variance that from run to run."""
    one = fit(make_run(n, 'row', noise=NOISE)[0])
    drift = 1e-6
    made = surrounded(one, only('table_zero_drift', drift * RADIUS))
    share = n * (np.arange(n) - (n - 1) / 2) / (n**2 - 1)
    added = np.sqrt(made.error_motions.u[:, 5]**2 - one.error_motions.u[:, 5]**2)
    np.testing.assert_allclose(added, np.abs(drift * share), rtol=1e-4)  # mean radius: 1e-5
    np.testing.assert_allclose(made.error_motions.u[:, :5], one.error_motions.u[:, :5], rtol=1e-6)
    np.testing.assert_allclose(made.error_motions.values, one.error_motions.values, atol=1e-6 * NOISE)
    if n == 12:
        assert added[0] == pytest.approx(0.4615e-6, rel=1e-3)


def taught(name, rate, size=float('nan'), runs=40, spread=0.0):
    """Return the experience of one effect in so many runs; size: m rms; spread: of its logarithm."""
    return Experience((KnownCause(name, rate, 1.0, rate * runs, runs, size, spread),), runs=runs)


def test_experience_gives_rate_and_size_of_an_effect_that_is_hidden(make_run):
    """In all of many runs, and large: U is larger; in none of them: smaller. Its variance is rate x size^2."""
    run, name = make_run(8, 'row', noise=NOISE)[0], 'table_zero_drift'
    one, workshop = fit(run), CLASSES['workshop']
    stated = surrounded(one, workshop).error_motions.u
    never = surrounded(one, replace(workshop, experience=taught(name, 1 / 42))).error_motions.u
    always = surrounded(one, replace(workshop, experience=taught(name, 41 / 42, 3e-6))).error_motions.u
    assert np.all(never[:, 5] < stated[:, 5]) and np.all(always[:, 5] > 2 * stated[:, 5])
    assert always[:, 3] == pytest.approx(stated[:, 3], rel=0.1)
    expected = 3e-6 * (41 / 42)**0.5 * size_per_rms(run)[name]
    alone = surrounded(one, Environment(experience=taught(name, 41 / 42, 3e-6)))
    np.testing.assert_allclose(alone.error_motions.u, surrounded(one, only(name, expected)).error_motions.u, rtol=1e-4)
    unsure = Environment(experience=taught(name, 41 / 42, 3e-6, spread=0.4))
    assert at_ball(unsure, run)[name] == pytest.approx(np.exp(0.4**2) * expected)
    assert source_of(alone.environment, name) == 'in 39 of 40 earlier runs of the cell'


def test_without_experience_of_an_effect_nothing_changes(make_run):
    """Bit for bit, also beside an experience that knows of nothing."""
    run = make_run(6, 'row', noise=NOISE)[0]
    one = fit(run)
    alone, empty = (surrounded(one, replace(LABORATORY, experience=known)) for known in (None, Experience(())))
    assert np.array_equal(alone.error_motions.u, surrounded(one, LABORATORY).error_motions.u)
    assert np.array_equal(alone.error_motions.u, empty.error_motions.u)


def test_a_plan_is_judged_by_what_the_cell_has():
    """A drift of the table that comes in every run makes the order that hides it worse, the one that shows it as good.
    """
    known = taught('table_zero_drift', 41 / 42, 3e-6)
    before, after = ({order: outlook(order, plan(6, order), RADIUS, environment=within).u[:, 5].mean()
                      for order in ('row', 'random')} for within in (LABORATORY, replace(LABORATORY, experience=known)))
    assert after['row'] > 3 * before['row'] and after['row'] > after['random']


def test_what_the_readings_exclude_does_not_count(make_run):
    """Each effect of a workshop, in an order that shows it and a run that has none of it: U hardly grows."""
    one = fit(make_run(8, 'random', noise=NOISE)[0])
    made = surrounded(one, CLASSES['workshop'])
    assert np.median(made.growth) < 1.05
    assert np.abs(made.error_motions.values - one.error_motions.values).max(axis=0)[:3] == pytest.approx(
        0, abs=0.5 * NOISE)
    assert unseen(one) is None


def test_what_is_there_moves_the_curves_back(make_run):
    """A slip that the order shows in part is taken off without being named, and its probability is near 1."""
    run = make_run(8, 'row', noise=NOISE)[0]
    slip = EFFECTS['plate_slip'].columns(run, Setting(t0=float(run.time[30] - 20))) @ np.array([2e-6, -1e-6, 0.0])
    moved = run.replace(centre=run.centre + slip)
    one, made = fit(moved), surrounded(fit(moved), only('plate_slip', 1e-6))
    wrong, left = (np.sqrt(np.mean((each.error_motions.values - fit(run).error_motions.values)[:, :3]**2))
                   for each in (one, made))
    assert made.there['plate_slip'] > 0.999
    assert left < 0.2 * wrong


def test_a_slip_between_table_positions_counts(make_run):
    """In the order row a slip while the table moves is wholly in the curves, one between two balls of a position shows.

    Of 118 moments some are of the first kind, up to 11: with w = pi / (1 - pi) / 118 of each, pi = 2 / 3 of a single
    effect, they have p = w / (1 + 11 w) and S^2 / pi, a third of it along each axis of the plate, and shift the curves
    from there on, less what no run knows."""
    one = fit(make_run(12, 'row', noise=NOISE)[0])
    made = surrounded(one, only('plate_slip', 1e-6))
    added = np.sqrt(np.mean((made.error_motions.u**2 - one.error_motions.u**2)[:, :2]))
    angle, square = one.error_motions.angle, 0.0
    for moment in range(1, 12):
        curves = np.zeros((12, 6))
        curves[moment:, 0], curves[moment:, 1] = np.cos(angle[moment:]), np.sin(angle[moment:])
        square += 2 * np.mean(remove_gauge(curves)[:, :2]**2)  # along the other axis of the plate as much
    w = 2 / 118
    assert added == pytest.approx(1e-6 * np.sqrt(square * 1.5 / 3 * w / (1 + 11 * w)), rel=0.15)  # 9 to 11 moments


def test_claims_leave_the_environment_and_have_a_prior(make_run):
    """A claim that the order hardly shows has an uncertainty without a prior that no cell has."""
    run = make_run(8, 'row', noise=NOISE)[0]
    one = fit(run, Model().with_effect('frame_warmup'), [Setting(axes='xyz', tau=10 * float(run.time[-1]))])
    made = surrounded(one, CLASSES['laboratory'])
    assert 'frame_warmup' not in made.there
    assert 'frame_warmup' in surrounded(fit(run), CLASSES['laboratory']).there
    assert one.error_motions.u[:, :2].max() > 100 * NOISE > 4 * made.error_motions.u[:, :2].max()
    assert np.max(made.parts[CLAIMED]) > 0


def test_parts_add_up(make_run):
    """What base model, claims and hidden effects add to the variance of each point is all of it."""
    run = make_run(8, 'row', noise=NOISE)[0]
    model = Model().with_effect('ball_slip')
    one = fit(run, model, [Setting(ball=3, t0=1000.0)])
    made = surrounded(one, CLASSES['workshop'])
    base = one.weighted_sigma**2 * one.joint.space.curve_cofactor()
    np.testing.assert_allclose(base + sum(made.parts.values()), made.error_motions.u**2, rtol=1e-9)
    high, low = [0] * 6, [4] * 6
    product = np.sum((made.moved[:, 0] - made.moved[:, 4]) * (made.carried[:, 0] - made.carried[:, 4]), axis=0)
    np.testing.assert_allclose(sum(made.difference_parts(high, low).values()), product, rtol=1e-9)
    largest = list(made.shares.values())
    assert largest[0].max() == max(one.max() for one in largest)


def test_effects_have_equal_parts_of_a_number(make_run):
    """Of each number, but for those that are stated by themselves; angles act at the radius."""
    run = make_run(6, 'random', noise=NOISE)[0]
    sizes = at_ball(CLASSES['workshop'], run)
    for kind, stated in CLASSES['workshop'].sizes.items():
        square = sum(size**2 for name, size in sizes.items() if kind_of(EFFECTS[name]) == kind)
        lever = RADIUS if KINDS[kind].unit == 'urad' else 1.0
        assert np.sqrt(square) == pytest.approx(lever * stated.value)
    finer = Environment('', CLASSES['workshop'].sizes, {'frame_drift': Size(1e-8, 'test')})
    assert at_ball(finer, run)['frame_drift'] == 1e-8
    assert at_ball(finer, run)['frame_step'] > sizes['frame_step']
    assert at_ball(Environment(sizes={'plate': Size(0.0, 'glued')}), run) == {}


def test_every_effect_belongs_to_a_number():
    """None is forgotten: a motion that names no number is refused where it is written."""
    assert {kind_of(one) for one in EFFECTS.values()} == {*KINDS}
    with pytest.raises(TypeError, match='motion Lost: expected stated, the number of an environment by which it moves'):
        type('Lost', (Motion,), {'body': 'plate'})


def test_a_table_that_turns_one_way_has_no_backlash(make_run):
    """Its curves are those of the side from which it comes."""
    one_way, both = (at_ball(LABORATORY, make_run(6, 'random', turning=turning)[0])
                     for turning in ('forward', 'alternate'))
    assert 'table_backlash_angle' not in one_way and 'table_backlash_angle' in both


def test_what_u_lacks_is_told_where_it_matters(make_run):
    """In the order row without an environment; always where one is stated."""
    one = fit(make_run(8, 'row', noise=NOISE)[0])
    alone, stated = unseen(one), unseen(one, CLASSES['workshop'])
    assert alone.environment == '' and alone.whole > MATTERS * alone.alone
    assert stated.environment == 'workshop' and stated.whole > 3 * alone.whole
    assert stated.largest in EFFECTS and 0 < stated.share <= 1
    assert unseen(fit(make_run(8, 'random', noise=NOISE)[0]), CLASSES['workshop']) is not None


def test_a_run_without_noise_has_an_environment(make_run):
    """Nothing is divided by zero."""
    made = surrounded(fit(make_run(6, 'row')[0]), LABORATORY)
    assert np.all(np.isfinite(made.error_motions.u)) and np.all(made.growth >= 1)
