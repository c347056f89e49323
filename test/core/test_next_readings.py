# SPDX-License-Identifier: Apache-2.0
"""The next readings of a run: predictions against dense algebra, blocks against chance and on a simulated machine."""

import functools

import numpy as np
import pytest
from dense_space import DenseSpace, design
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.diagnosis import known_of, search_of
from rosette_ros.core.diagnosis.posterior import Explanation
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.advice import advise
from rosette_ros.core.planning.block_ways import BlockWay, continued, ways, with_block
from rosette_ros.core.planning.next_readings import (
    SettlingStep,
    in_doubt,
    leading,
    next_readings,
    standing,
    steps_of,
)
from rosette_ros.core.planning.predictions import Predictor, best_fit, expected_share, information, share_of_need
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.core.run.touches import USUAL_PACE
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.settling_words import hopeless_words, next_words, open_words

pytestmark = pytest.mark.usefixtures('shared_searches')

SIGMA = 1e-7
DRIFT, WARM_UP = 'frame_drift', 'frame_warmup'


def moved(course, size, n=6, order='sensitive'):
    """Return a run whose frame moves by a course of its times over the duration, of a norm of so many sigma."""
    run = synthetic_run(n, order, 1, noise=SIGMA, repeatability=SIGMA)[0]
    way = course(run.time / run.time[-1])[:, None] * np.array([1.0, 0.5, -0.7])
    way = way - way.mean(axis=0)
    return run.replace(centre=run.centre + size * SIGMA * way / np.linalg.norm(way))


def test_the_temperature_goes_on_and_comes_to_rest():
    """A run that warms by 1 K is expected to warm further, ever more slowly."""
    run = moved(lambda part: part, 12)
    run = run.replace(temperature=20 + run.time / run.time[-1])
    longer = continued(run, next(iter(ways(run))).every(run), USUAL_PACE)
    rise = np.diff(longer.temperature[run.size - 1:]) / np.diff(longer.time[run.size - 1:])
    assert (rise > 0).all() and (np.diff(rise) < 0).all() and longer.temperature[-1] < 22


def warming(size=12, tau=0.4):
    """Return a run in which warm-up and drift along a curve look alike."""
    return moved(lambda part: -np.expm1(-part / tau), size)


@functools.cache
def first_block():
    """Return what six readings settle of this run."""
    return next_readings(warming(), readings=6)


def members(*names, **setting):
    """Return effects as members of an explanation."""
    return [(EFFECTS[name], Setting(setting)) for name in names]


def test_predictions_are_those_of_dense_least_squares():
    """Means but for what is common, and covariances, of a drift and of nothing.

    A prior of the size of the amplitudes, 80 sigma and more, changes them by 1 / 80^2 at most."""
    run = moved(lambda part: part, 200)
    search = search_of(run, Model())
    block = Scheme(6, 'next', 0, np.array([2, 2, 5, 5]), np.array([1, 4, 2, 3]), np.array([1, 1, 1, 1]),
                   wait=np.array([900.0, 0, 0, 0]))
    longer = continued(run, block, USUAL_PACE)
    explanations = [members(DRIFT, axes='xyz'), []]
    got = Predictor(search, explanations, np.array([0.3, 0.7])).predicted(longer)

    base, nominal = design(longer).reshape(3 * longer.size, -1), np.zeros_like(run.centre)
    nominal[:, 0], nominal[:, 1] = run.radius * np.cos(run.alpha), run.radius * np.sin(run.alpha)
    y, old = (run.centre - nominal).ravel() / best_fit(search).sigma, 3 * run.size
    drift = EFFECTS[DRIFT].columns(longer, Setting(axes='xyz')).reshape(3 * longer.size, -1)
    means, spreads = [], []
    for every in (np.column_stack([base, drift / np.linalg.norm(drift, axis=0)]), base):
        inverse = np.linalg.pinv(every[:old], rcond=1e-9)
        means.append(every[old:] @ (inverse @ y))
        spreads.append(every[old:] @ inverse @ inverse.T @ every[old:].T)
    assert not got.mean[1].any()
    assert np.abs(got.mean[0] - (means[0] - means[1])).max() < 1e-3 * np.abs(means[0] - means[1]).max()
    assert np.abs(got.spread - spreads).max() < 1e-3 * np.max(spreads)


def test_a_run_goes_on_as_the_machine_does():
    """Travel and senses of a continued run are those of the simulated machine; times are at usual speeds, which are
    those of the machine to a tenth."""
    machine = Machine(MachineConfig().changed(seed=3, plate={'balls': 6}, probing={'repeatability_um': 0.1}))
    block = Scheme(6, 'next', 0, np.array([3, 3, 1, 2]), np.array([2, 6, 1, 5]), np.array([1, 1, -1, 1]),
                   wait=np.array([600.0, 0, 0, 0]))
    whole = synthetic_run(6, 'diagonal')[0]
    run = machine.run(with_block(whole, block))
    assert run.size == 40 and run.is_gapless
    longer = continued(run.take(range(36)), block, USUAL_PACE)
    assert np.allclose(longer.table_travel, run.table_travel, atol=1e-4)  # to the positioning of the table, rad
    assert np.array_equal(longer.approach, run.approach)
    assert np.array_equal(longer.cmm_sense, run.cmm_sense)
    assert longer.time[-1] - longer.time[35] == pytest.approx(run.time[-1] - run.time[35], rel=0.1)
    assert longer.time[36] - longer.time[35] > 600


def test_readings_of_a_block_beat_chance():
    """Those that are chosen on a way tell more than any of 30 draws of as many on it."""
    run = warming()
    every = BlockWay(np.array([1, 3, 5]), np.ones(3, dtype=int), 3600.0).every(run)
    explanations = [members(DRIFT, axes='xyz'), members(WARM_UP, axes='xyz', tau=600.0)]
    predictor = Predictor(search_of(run, Model()), explanations, np.array([0.5, 0.5]))
    guess = predictor.predicted(continued(run, every, USUAL_PACE))
    some, square = guess.chosen(4)
    gain = float(information(guess.p, square))
    assert gain == pytest.approx(gain_of(guess, some), rel=1e-6)
    rng = np.random.default_rng(1)
    drawn = [gain_of(guess, rng.choice(every.ball.size, 4, replace=False)) for _ in range(30)]
    assert gain > max(drawn)


def gain_of(guess, some):
    """Return the information of some readings of the predictions of two explanations of the same mean covariance."""
    rows = (3 * np.asarray(some)[:, None] + np.arange(3)).ravel()
    apart, spread = guess.mean[0, rows] - guess.mean[1, rows], np.tensordot(guess.p, guess.spread, axes=1)
    square = apart @ np.linalg.solve(spread[np.ix_(rows, rows)] + np.eye(len(rows)), apart)
    return float(information(guess.p, np.array([[0, square], [square, 0]])))


def test_a_wait_parts_warm_up_from_drift():
    """After a warm-up, the frame stands still or drifts on: the later a reading, the more it tells."""
    run = warming()
    explanations = [members(DRIFT, axes='xyz'), members(WARM_UP, axes='xyz', tau=600.0)]
    predictor = Predictor(search_of(run, Model()), explanations, np.array([0.5, 0.5]))
    squares = []
    for wait in (0.0, 3600.0, 36000.0):
        every = BlockWay(np.array([1]), np.ones(1, dtype=int), wait).every(run)
        squares.append(predictor.predicted(continued(run, every, USUAL_PACE)).distances(every.ball.size)[0, 1])
    assert squares[0] < squares[1] / 2 < squares[2] / 4


def test_a_block_settles_warm_up_against_drift_along_a_curve():
    """Blocks on a machine that warms up, one after the other, end with the warm-up; what is said follows from them."""
    rng, tau, run = np.random.default_rng(8), 0.4, warming()
    duration, course = run.time[-1], np.array([1.0, 0.5, -0.7])
    way = -np.expm1(-run.time / (tau * duration))[:, None] * course
    factor = 12 * SIGMA / np.linalg.norm(way - way.mean(axis=0))
    truth = synthetic_run(6, 'sensitive', 1)[0]
    found = next_readings(run, readings=8)
    assert {found.separates.first.members, found.separates.second.members} == {('frame_drift_curved',), (WARM_UP,)}
    assert found.separates.expected > found.separates.now and found.gain > 0
    assert open_words(found).startswith('non-linear probe drift or warm-up of the machine, ')
    assert ' are expected to separate non-linear probe drift from warm-up of the machine: ' in next_words(found)[1]
    for _ in range(8):
        if found.is_settled:
            break
        assert 0 < found.targets.ball.size <= 8
        longer, cells = continued(run, found.targets, USUAL_PACE), truth.cells.tolist()
        more = slice(run.size, None)
        true = truth.centre[[cells.index(cell) for cell in longer.cells[more].tolist()]]
        shift = -np.expm1(-longer.time[more] / (tau * duration))[:, None] * course - way.mean(axis=0)
        centre = true + factor * shift + SIGMA * rng.standard_normal(true.shape)
        run = longer.replace(centre=np.concatenate([run.centre, centre]))
        found = next_readings(run, readings=8)
    assert found.is_settled and found.contenders[0].members == (WARM_UP,)
    assert next_words(found)[1] == 'Nothing more has to be measured.'


def test_the_same_run_gives_the_same_block_and_a_refused_one_never():
    """A replay gives the same blocks; where the CMM refuses one, the next best is given."""
    run, first = warming(), first_block()
    known_of.cache_clear()
    again = next_readings(run, readings=6)
    other = next_readings(run, readings=6, refused=[first.targets])
    assert as_rows(first.targets) == as_rows(again.targets) != as_rows(other.targets)
    assert first.gain == again.gain and other.gain > 0


def as_rows(block):
    """Return the readings of a block."""
    return [getattr(block, name).tolist() for name in ('table_position', 'ball', 'approach', 'wait')]


def test_a_plate_has_a_largest_size():
    """It took 105 s and 7 GB for 120 balls."""
    for ask in (lambda: next_readings(synthetic_run(73, 'row', 1, noise=SIGMA, repeatability=SIGMA)[0]),
                lambda: advise(73)):
        with pytest.raises(InvalidPlan, match=r'^(next readings|advise): expected at most 72 balls, found 73: for '
                                              r'more it '
                           r'takes minutes and memory \(72 balls: 2 GB, 120 balls: 7 GB\); measure a whole plan, and '
                           'diagnose it$'):
            ask()


def test_a_sound_run_is_settled():
    """Where no name has a chance of more than 5 %, nothing more is measured; until U is reached, if one is wanted."""
    run = synthetic_run(6, 'sensitive', 1, noise=SIGMA, repeatability=SIGMA)[0]
    found = next_readings(run)
    assert found.is_settled and found.targets is None and found.contenders[0].members == ()
    wanted = standing(run, uncertainty=0.5 * found.uncertainty)
    assert not wanted.is_settled and wanted.separates is None
    assert open_words(wanted) == f'U is {1e6 * found.uncertainty:.3g} µm'


def test_a_block_for_u_is_where_it_falls_most():
    """A reduced run without doubt: all readings of a block are at one CMM position that was not in use, and U falls as
    the dense algebra says."""
    run = synthetic_run(6, 'diagonal', 1, noise=SIGMA, repeatability=SIGMA)[0]
    run = run.take(np.isin(run.cmm_position, (1, 2, 3, 5)))
    before = standing(run)
    found = next_readings(run, readings=6, uncertainty=0.5 * before.uncertainty)
    assert found.separates is None and np.unique(found.targets.cmm_position).size == 1
    assert found.targets.cmm_position[0] in (4, 6) and np.array_equal(np.sort(found.targets.table_position),
                                                                      np.arange(1, 7))
    sigma = best_fit(search_of(run, Model())).sigma
    variance = DenseSpace(continued(run, found.targets, USUAL_PACE), run.radius).curve_cofactor()
    worst = np.max(variance * np.repeat([1.0, run.radius], 3)**2)
    assert before.uncertainty > found.expected_uncertainty == pytest.approx(2 * sigma * np.sqrt(worst), rel=1e-3)
    assert next_words(found)[1].startswith('6 readings (4 min) are expected to lower U from ')


def test_what_no_reading_tells_apart_is_said_at_once(monkeypatch):
    """Two explanations that predict the same of all readings: a sentence says so; no block but for U, if wanted."""
    run = warming()
    same = members('frame_drift_curved', axes='xyz')
    monkeypatch.setattr('rosette_ros.core.planning.next_readings.members_of', lambda posterior, names: same)
    found = next_readings(run)
    assert found.is_hopeless and found.targets is None
    assert next_words(next_readings(run, uncertainty=0.0))[1].startswith('12 readings (8 min) are expected to lower U')
    assert hopeless_words(found) == ('further readings of this cell cannot distinguish non-linear probe drift from '
                                     'warm-up of the machine')


def test_what_is_in_doubt():
    """The name whose probability is nearest to a half, and the likeliest explanation that differs in it."""
    some = [Explanation(names, p) for names, p in ((('a', 'b'), 0.5), (('a',), 0.3), (('a', 'c'), 0.15), ((), 0.05))]
    pair = in_doubt(some, 0.9)
    assert (pair.first, pair.second) == (some[0], some[1]) and pair.now == 0.625
    assert in_doubt([Explanation(('a',), 0.97), Explanation((), 0.03)], 0.95) is None


def test_expected_odds():
    """No distance, no change; a large one, certainty; between, the mean over 10^5 draws of the log odds."""
    z = np.random.default_rng(1).standard_normal(100_000)
    drawn = np.mean(1 / (1 + np.exp(-(np.log(0.6 / 0.4) + 2.0 + 2.0 * z))))
    assert expected_share(0.6, 0.0) == pytest.approx(0.6)
    assert expected_share(0.6, 4.0) == pytest.approx(drawn, abs=3e-3)
    assert expected_share(0.6, 400.0) == pytest.approx(1.0)


def test_the_share_of_what_is_needed():
    """One over the expected number of blocks: growth over need where a block only starts, never above 1, and between
    them the rest after one block over the growth, as 10^5 draws have it."""
    need, z = 3.0, np.random.default_rng(1).standard_normal(100_000)
    square = np.array([0.0, 1e-4, 400.0])
    assert share_of_need(square, 2 * square, np.full(3, need)) == pytest.approx([0, 5e-5 / need, 1], rel=0.02)
    for square in (1.0, 6.0, 12.0):
        left = np.maximum(need - square / 2 - np.sqrt(square) * z, 0).mean()
        assert share_of_need(square, 2 * square, need) == pytest.approx(1 / (1 + 2 * left / square), rel=0.01)
    faster, never = share_of_need(np.array([0.1, 0.1]), np.array([0.8, 0.1]), np.full(2, need))
    assert faster == pytest.approx((0.05 / need)**(1 / 3), rel=0.1) and never < 1e-6  # growth by n cubed; by nothing


def test_a_wait_only_where_no_short_block_settles():
    """A block that tells enough in four minutes wins over an hour that tells more, an hour over a start in a minute."""
    short, hour, start = (float(share_of_need(square, 2 * square, 3.0)) for square in (12.0, 60.0, 0.05))
    assert short / 4 > hour / 60 > start / 1
    found = first_block()
    assert found.targets.wait.sum() == 0 and found.separates.expected > 0.9


def test_ways_see_what_the_run_saw():
    """A plate with balls at some places only, or some CMM positions: no way asks for others, or leaves gaps."""
    run = synthetic_run(12, 'sensitive')[0]
    assert all(4 not in way.every(some).ball for some in [run.take(run.ball != 4)] for way in ways(some))
    some = run.take(np.isin(run.cmm_position, (1, 2, 5, 9)))
    for way, one in ((way, way.every(some)) for way in ways(some)):
        assert set(way.position) == set(one.table_position) and {*one.cmm_position} <= {1, 2, 5, 9}
        assert some.is_gapless and continued(some, one, USUAL_PACE).is_gapless
    begun = run.take(np.arange(20))  # a sweep that was not ended: from there the CMM goes where the block sends it
    assert all(np.isfinite(continued(begun, way.every(begun), USUAL_PACE).cmm_sense).all() for way in ways(begun))


def test_the_leading_explanations_of_a_run():
    """Those that were the likeliest at any step, each with its probability at every one."""
    steps = [SettlingStep(36, (Explanation(('a',), 0.6), Explanation(('b',), 0.3), Explanation(('c',), 0.05)), 1e-7),
             SettlingStep(48, (Explanation(('b',), 0.9), Explanation(('a',), 0.1)), 9e-8)]
    assert leading(steps, 2) == {('b',): [0.3, 0.9], ('a',): [0.6, 0.1]}


def test_steps_are_what_was_known_then():
    """The first readings of a run by themselves."""
    run = synthetic_run(6, 'diagonal', 1, noise=SIGMA, repeatability=SIGMA)[0]
    first, second = steps_of(run, None, (30, 36))
    assert (first.readings, second.readings) == (30, 36) and first.uncertainty > second.uncertainty
    assert second.contenders[0].members == ()
