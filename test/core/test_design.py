# SPDX-License-Identifier: Apache-2.0
"""The order `sensitive` and its design: laws, promised shares, judged by dense least squares."""

import numpy as np
import pytest

from benchmarks.design_orders import (
    MODULE,
    anneal,
    design_readings,
    design_sweeps,
    reading_text,
    source,
    sweeps_text,
    swept,
)
from benchmarks.order_cost import Judge, Order, Pace, journey
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.run.interleaved_order import READINGS, SWEEPS, Sweeps, order_from_text, shortest_way
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan

PACE = Pace()
RADIUS = PACE.radius


def order_of(scheme):
    """Return the Order of a Scheme."""
    return Order(scheme.n, scheme.table_position - 1, scheme.ball - 1, scheme.approach)


def run_of(scheme):
    """Return the run of a scheme at the pace of the design, with the temperature it assumes."""
    way = journey(order_of(scheme), PACE)
    t = way.time / way.time[-1]
    return Run(
        scheme.n, RADIUS, scheme.table_position, scheme.ball, scheme.centres(RADIUS),
        time=way.time, approach=scheme.approach, table_travel=way.travel,
        temperature=np.cos(np.pi * t) + 0.5 * np.cos(2 * np.pi * t + 1))


def powers(space, run, effect, **setting):
    """Return the whole and the hidden square sum of an effect's columns, and the columns."""
    columns = np.moveaxis(EFFECTS[effect].columns(run, Setting(setting)), -1, 0)
    columns = columns - columns.mean(axis=1, keepdims=True)
    whole = np.sum(columns**2)
    return whole, whole - np.sum(space.residual(columns)**2)


def visible(scheme, effect, **setting):
    """Return the visible share of an effect in a scheme."""
    run = run_of(scheme)
    whole, hidden = powers(BaseSpace(run, RADIUS), run, effect, **setting)
    return np.sqrt(1 - hidden / whole)


@pytest.mark.parametrize('n', [*range(3, 73), 75, 100])
def test_every_pair_once(n):
    """Every ball is measured once in every table position, for any number of balls."""
    scheme = plan(n, 'sensitive')
    cells = (scheme.table_position - 1) * n + scheme.ball - 1
    assert np.array_equal(np.sort(cells), np.arange(n * n))


@pytest.mark.parametrize('n', [11, 16, 36])
def test_the_gap_between_two_sweeps_is_the_one_that_was_designed(n):
    """From the last reading of one sweep to the first of the next, in the sense of this one."""
    sweeps = Sweeps.from_text(*SWEEPS[n])
    places = sweeps.readings()[0].reshape(n, n)
    assert np.array_equal((places[1:, 0] - places[:-1, -1]) % n, (sweeps.gap * sweeps.sense)[1:] % n)


@pytest.mark.parametrize('n', [5, 12, 40, 90])
def test_it_is_always_the_same(n):
    """Neither seed nor turning changes the order."""
    one, other = plan(n, 'sensitive'), plan(n, 'sensitive', 7, 'alternate')
    for name in ('table_position', 'ball', 'approach'):
        assert np.array_equal(getattr(one, name), getattr(other, name))


# Of the way of the CMM in a random order; designs of a few balls spend more of it on visible shares.
CMM_WAY = {11: 0.76, 13: 0.64, 14: 0.65}


@pytest.mark.parametrize('n', range(4, 73))
def test_less_motion_than_random(n):
    """Table and CMM travel less than in a random order, and the table turns in both senses."""
    mine, drawn = plan(n, 'sensitive'), plan(n, 'random', 1, 'alternate')
    mine_way, drawn_way = mine.travel(RADIUS), drawn.travel(RADIUS)
    assert mine_way.table_angle < 0.8 * drawn_way.table_angle
    assert journey(order_of(mine), PACE).motion < 0.85 * journey(order_of(drawn), PACE).motion
    assert abs(np.mean(mine.approach)) < 0.45
    if n > 10:
        assert mine_way.table_angle < 0.3 * drawn_way.table_angle
        assert mine_way.cmm_way < CMM_WAY.get(n, 0.6) * drawn_way.cmm_way


# Visible shares that users of the order rely on; the bound of what grows with time times a shape of
# the base model is one half, sqrt(var t / mean t^2).
PROMISED = [
    ('frame_drift', {'axes': 'z'}, {6: 0.6, 12: 0.95, 24: 0.96, 72: 0.98}),
    ('table_zero_drift', {}, {6: 0.4, 12: 0.48, 24: 0.485, 72: 0.49}),
    ('axis_tilt_drift', {}, {6: 0.29, 12: 0.45, 24: 0.47, 72: 0.48}),
    ('plate_creep', {}, {6: 0.33, 12: 0.48, 24: 0.485, 72: 0.49}),
    ('plate_expansion', {'driver': 'time'}, {6: 0.4, 12: 0.48, 24: 0.485, 72: 0.49}),
    ('plate_warp', {'order': 2}, {6: 0.25, 12: 0.4, 24: 0.46, 72: 0.47}),
    ('table_backlash', {}, {6: 0.6, 12: 0.88, 24: 0.95, 72: 0.97}),
    ('cmm_reversal', {}, {6: 0.45, 12: 0.78, 24: 0.88, 72: 0.94}),
    ('asynchronous_motion', {'motion': 'radial', 'nu': 0.43}, {6: 0.55, 12: 0.83, 24: 0.92, 72: 0.96}),
]


@pytest.mark.parametrize('effect, setting, shares', PROMISED)
def test_promised_shares(effect, setting, shares):
    """The order shows what it was designed for."""
    for n, promised in shares.items():
        assert visible(plan(n, 'sensitive'), effect, **setting) > promised, n


@pytest.mark.parametrize('n', [5, 6, 8, 12, 18])
def test_worst_effect_beats_random(n):
    """The worst effect of the library shows better than in random orders."""
    judge = Judge(n)
    mine = min(judge(order_of(plan(n, 'sensitive'))).shares.values())
    drawn = [min(judge(order_of(plan(n, 'random', seed, 'alternate'))).shares.values())
             for seed in range(5)]
    assert mine > np.mean(drawn) + 0.05


@pytest.mark.parametrize('effect, settings, of', [
    ('frame_drift', [{'axes': 'z'}, {'axes': 'xyz'}], 'frame_drift'),
    ('frame_temperature', [{'axes': 'z'}, {'axes': 'xyz'}], 'frame_temperature'),
    ('table_zero_drift', [{}], 'table_zero_drift'),
    ('axis_tilt_drift', [{}], 'axis_tilt_drift'),
    ('table_backlash', [{}], 'table_backlash'),
    ('plate_creep', [{}], 'plate_creep'),
    ('plate_expansion', [{'driver': 'time'}], 'plate_expansion'),
    ('plate_warp', [{'order': 2}, {'order': 3}], 'plate_warp'),
    ('asynchronous_motion', [{'motion': 'radial', 'nu': 0.23}, {'motion': 'axial', 'nu': 0.23}],
     'asynchronous_motion'),
    ('asynchronous_motion', [{'motion': 'tilt', 'nu': 0.23}], 'asynchronous_motion, tilt'),
])
def test_judge_agrees_with_dense_least_squares(effect, settings, of):
    """What one FFT says is hidden is what dense least squares on the effect's columns leave."""
    scheme = plan(7, 'random', 3, 'alternate')
    run, order = run_of(scheme), order_of(scheme)
    judged = Judge(7)(order).hidden[of]
    space = BaseSpace(run, RADIUS)
    # Times a shape of the base model, the mean of t is hidden in any order and does not count, and
    # the mean of a sense or of a wave is hidden and does count; elsewhere the mean is gauge.
    grows = {'table_zero_drift', 'axis_tilt_drift', 'plate_creep', 'plate_expansion', 'plate_warp'}
    t = run.time
    for place, setting in enumerate(settings):
        whole, hidden = powers(space, run, effect, **setting)
        shown = whole - hidden
        raw = np.sum(EFFECTS[effect].columns(run, Setting(setting))**2)
        if effect in grows:
            whole = raw * np.var(t) / np.mean(t**2)
        elif effect == 'table_backlash' or setting.get('motion') == 'tilt':
            whole = raw
        assert shown / whole == pytest.approx(1 - judged[place], abs=1e-9), setting


def test_judge_tells_a_hidden_effect():
    """The row order hides drift, and turning in one sense hides backlash, to rounding."""
    verdict = Judge(6)(order_of(plan(6, 'row')))
    assert verdict.hidden['frame_step'].max() == pytest.approx(1, abs=1e-12)
    assert verdict.shares['table_backlash'] == pytest.approx(0, abs=1e-6)


def test_journey_by_hand():
    """Moves take the longer of table and CMM: 90 deg at 10 deg/s and 2 s to settle, or the CMM."""
    order = Order(4, np.array([0, 1, 0, 0]), np.array([0, 3, 0, 2]), np.array([1, 1, -1, -1]))
    way = journey(order, PACE)
    # third move: the table stands, the CMM goes 365 mm across at 60 mm/s and settles 1 s
    assert np.diff(way.time) == pytest.approx([11 + 24, 11 + 24, 365 / 60 + 1 + 24], abs=1e-9)
    assert way.travel == pytest.approx([0, np.pi / 2, 0, 0])
    assert way.motion == pytest.approx(23 + 365 / 60)


def test_the_long_way_takes_longer():
    """A table that must come from the other side turns the long way."""
    order = Order(4, np.array([0, 1]), np.array([0, 3]), np.array([1, -1]))
    assert journey(order, PACE).travel == pytest.approx([0, -1.5 * np.pi])


def test_texts_come_back():
    """Sweeps and readings are what their texts say."""
    rng = np.random.default_rng(5)
    sweeps = Sweeps(rng.permutation(72), 1 - 2 * rng.integers(0, 2, 72), rng.integers(0, 36, 72),
                    rng.integers(0, 72, 72))
    again = Sweeps.from_text(*sweeps_text(sweeps))
    for name in ('ball', 'sense', 'gap', 'shift'):
        assert np.array_equal(getattr(again, name), getattr(sweeps, name))
    readings = np.array([0, 9, 3]), np.array([8, 0, 1]), np.array([1, -1, 1])
    assert all(np.array_equal(*pair) for pair in
               zip(order_from_text(reading_text(*readings)), readings, strict=True))


def test_the_module_is_as_its_design_writes_it():
    """Written again, the tables of the module come out as they stand; one more order is one more entry."""
    text = MODULE.read_text(encoding='utf-8')
    assert source({'READINGS': READINGS, 'SWEEPS': SWEEPS}, text) == text
    more = source({'SWEEPS': {**SWEEPS, 17: sweeps_text(Sweeps.by_rule(17))}}, text)
    assert len(more.splitlines()) == len(text.splitlines()) + 1


def test_shortest_way():
    """The table goes the shortest way, and a table that stands keeps its last sense."""
    assert list(shortest_way(6, np.array([0, 5, 5, 0, 2]))) == [1, -1, -1, 1, 1]


def test_annealing_finds_a_valley():
    """Annealing walks over a hill to the lowest point."""
    def height(x):
        return 0.02 * (x - 40)**2 / 40 + np.cos(0.5 * x)

    assert height(19) < min(height(14), height(24))  # a valley between start and goal
    cost, x = anneal(7, lambda x, rng: x + rng.integers(-2, 3), height, 3000, 4.0,
                     np.random.default_rng(0))
    best = min(range(80), key=height)
    assert (cost, x) == (height(best), best)


def test_design_is_repeatable_and_improves():
    """A design is fixed by its seed, is complete, and beats where it began."""
    cost, sweeps = design_sweeps(9, seed=2, steps=60)
    again, _ = design_sweeps(9, seed=2, steps=60)
    begin, _ = design_sweeps(9, seed=2, steps=0)
    assert cost == again < begin
    order = swept(sweeps)
    finer, readings = design_readings(order, seed=1, steps=60)
    assert finer <= cost == pytest.approx(Judge(9)(order).cost())
    assert np.unique(readings.position * 9 + readings.ball).size == 81
    assert Judge(9)(readings).cost() == pytest.approx(finer)
