# SPDX-License-Identifier: Apache-2.0
"""The base model: closed form and normal equations are one and the same."""

import itertools
from functools import reduce

import numpy as np
import pytest
from closed_form import closed_form
from dense_space import DenseSpace
from hypothesis import given
from hypothesis import strategies as st
from synthetic import MICROMETRE, synthetic_run

from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import fit, mean_radius, observed
from rosette_ros.core.model.model import BASE_TERMS, Model
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.geometry import clamping
from rosette_ros.core.run.records import Run, remove_gauge
from rosette_ros.core.run.scheme import COMPLETE_ORDERS
from rosette_ros.core.uncertainty.clamped_plate import clamped_plate

ROUNDING = 1e-15  # m and rad: 1 fm, far below any ball centre
SUBSETS = [subset for size in (0, 1, 2, 3) for subset in itertools.combinations(BASE_TERMS, size)]


@pytest.mark.parametrize('order', sorted(COMPLETE_ORDERS))
@pytest.mark.parametrize('n', [3, 4, 6, 7, 12, 24])
def test_least_squares_is_the_closed_form(n, order):
    """On complete runs the fit and equations (1)-(16) agree to rounding."""
    run, *_ = synthetic_run(n, order, seed=n, noise=0.1 * MICROMETRE)
    assert np.abs(fit(run).error_motions.values - closed_form(run)).max() < ROUNDING


@pytest.mark.parametrize('n', [3, 4, 6, 7, 12])
def test_closed_form_recovers_the_truth(n):
    """Without noise the closed form gives the true curves, less what no run can know."""
    run, curves, *_ = synthetic_run(n, seed=n)
    # the lever is the measured mean radius: 10 um in 182.5 mm act on 1 urad
    assert np.abs(closed_form(run) - remove_gauge(curves)).max() < 1e-9
    assert np.abs(closed_form(run) - curves).max() > 1e-7


@pytest.mark.parametrize('n', [3, 6, 7, 12, 25])
def test_rank_is_12n_minus_13(n):
    """A complete run has rank 12 n - 13, by normal equations and by singular values."""
    run, *_ = synthetic_run(n, 'random', seed=1)
    lever = mean_radius(run)
    assert BaseSpace(run, lever).rank == 12 * n - 13
    assert DenseSpace(run, lever).rank == 12 * n - 13


@given(n=st.integers(3, 6), seed=st.integers(0, 99), terms=st.sampled_from(SUBSETS),
       order=st.sampled_from(sorted(COMPLETE_ORDERS)))
def test_normal_equations_equal_the_dense_solution(n, seed, terms, order):
    """Residuals, parameters, rank and cofactors agree with a dense solution."""
    run, *_ = synthetic_run(n, order, seed, noise=MICROMETRE)
    lever = mean_radius(run)
    y = observed(run)[None]
    fast, dense = BaseSpace(run, lever, terms), DenseSpace(run, lever, terms)
    assert fast.rank == dense.rank
    assert np.abs(fast.residual(y) - dense.residual(y)).max() < ROUNDING
    one, other = fast.described(y)[0], dense.parameters(y)
    for name in ('curves', 'plate', 'cmm'):
        assert np.abs(getattr(one, name) - getattr(other, name)).max() < ROUNDING
    if terms == BASE_TERMS:
        for closed, solved in zip((fast.curve_cofactor(), *fast.deviation_cofactors()),
                                  (dense.curve_cofactor(), *dense.deviation_cofactors()), strict=True):
            assert np.allclose(closed, solved, rtol=1e-9)


@given(n=st.integers(3, 6), seed=st.integers(0, 99))
def test_curves_do_not_depend_on_the_order_to_the_last_bit(n, seed):
    """A run that was broken off and gone on with has the same readings, in another order."""
    run, *_ = synthetic_run(n, 'random', seed, noise=MICROMETRE)
    rng = np.random.default_rng(seed)
    angle = run.table_angle + 1e-5 * rng.standard_normal(n)[run.table_position - 1]
    other = rng.permutation(run.size)

    def curves(rows):
        return fit(Run(n, run.radius, run.table_position[rows], run.ball[rows], run.centre[rows],
                       table_angle=angle[rows])).error_motions

    assert curves(np.arange(run.size)).values.tobytes() == curves(other).values.tobytes()
    assert curves(np.arange(run.size)).angle.tobytes() == curves(other).angle.tobytes()


@given(n=st.integers(3, 6), seed=st.integers(0, 99))
def test_residual_is_a_projection(n, seed):
    """Projecting twice changes nothing, and what the base model describes leaves nothing."""
    run, *_ = synthetic_run(n, 'random', seed)
    space = BaseSpace(run, mean_radius(run))
    rows = np.random.default_rng(seed).standard_normal((2, run.size, 3))
    once = space.residual(rows)
    assert np.allclose(space.residual(once), once, atol=1e-13)
    assert np.abs(np.sum(once * (rows - once))) < 1e-9
    # the lever differs from the nominal radius by the plate's deviations only
    assert np.abs(space.residual(observed(run)[None])).max() < 1e-9


def test_plate_and_cmm_are_recovered(make_run):
    """Plate and CMM deviations come out too, up to the gauge."""
    run, _, plate, cmm = make_run(12, seed=4)
    result = fit(run)
    phi = 2 * np.pi * np.arange(12) / 12
    assert np.abs(np.diff(result.plate[:, 2] - plate[:, 2], n=2)).max() < 2 * MICROMETRE
    residual_cmm = (result.cmm - cmm)
    # what is left may only be a constant, a tilt, a radial scale and a turn
    design = np.zeros((36, 8))
    for k in range(12):
        design[3 * k:3 * k + 3, :3] = np.eye(3)
        design[3 * k, 3:5] = np.cos(phi[k]), -np.sin(phi[k])
        design[3 * k + 1, 3:5] = np.sin(phi[k]), np.cos(phi[k])
        design[3 * k + 2, 5:7] = np.cos(phi[k]), np.sin(phi[k])
    left = residual_cmm.reshape(-1)
    left = left - design @ np.linalg.lstsq(design, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-10


def test_uncertainties_are_those_of_the_page():
    """Noise transfer of a full run, n = 12, per um: 0.264, 0.264, 0.276 um, 2.04, 2.04, 1.51 urad."""
    run, *_ = synthetic_run(12)
    root = np.sqrt(BaseSpace(run, 0.1825).curve_cofactor()[0])
    assert np.round(root[:3], 3).tolist() == [0.264, 0.264, 0.276]
    assert np.round(root[3:], 2).tolist() == [2.04, 2.04, 1.51]


@pytest.mark.parametrize('effects', [(), ('frame_drift',)])
@pytest.mark.parametrize('left_out', [0, 3])
def test_uncertainties_of_plate_and_cmm_are_those_of_the_readings(left_out, effects):
    """Each coordinate moved by a small step moves the results: the squares of these moves add up to their variances.

    So they do for the plate freed of its clamping, which is surer, and for the clamping itself."""
    n, step = 5, 1e-9
    run = synthetic_run(n, 'random', seed=2)[0]
    run, model = run.take(slice(left_out, run.size)), reduce(Model.with_effect, effects, Model())
    chosen = choose_settings(run, model)
    base, moved, lies = fit(run, model, chosen), [], []
    plate = clamped_plate(base)
    for move in step * np.eye(3 * run.size).reshape(-1, run.size, 3):
        other = fit(run.replace(centre=run.centre + move), model, chosen)
        shift, turn, freed = clamping(other.plate, run.radius)
        moved.append(np.concatenate([other.plate - base.plate, other.cmm - base.cmm, freed - plate.freed]))
        lies.append(np.concatenate([shift - plate.shift, turn - plate.turn]))
    exact, exact_lie = (np.sqrt(np.sum(np.square(every), axis=0)) / step for every in (moved, lies))
    assert np.concatenate([*base.deviation_u, plate.u_freed]) / base.sigma == pytest.approx(exact, rel=1e-4)
    assert plate.u / base.sigma == pytest.approx(exact_lie, rel=1e-4)
    assert np.sum(plate.u_freed**2) < np.sum(base.deviation_u[0]**2)


def test_errors_are_covered_by_the_uncertainties():
    """Over many runs the normalised errors have rms 1 and 95 % lie within k = 2."""
    normalised = []
    for seed in range(60):
        run, curves, *_ = synthetic_run(6, seed=seed, noise=0.1 * MICROMETRE)
        result = fit(run).error_motions
        normalised.append((result.values - remove_gauge(curves)) / result.u)
    normalised = np.concatenate(normalised)
    # 60 runs of 23 independent table parameters: rms within 3 of its standard errors
    assert abs(np.sqrt(np.mean(normalised**2)) - 1) < 3 / np.sqrt(2 * 60 * 23)
    assert 0.93 < np.mean(np.abs(normalised) < 2) < 0.97


@pytest.mark.parametrize('missing', [1, 10, 40])
def test_missing_balls_lose_nothing_else(missing):
    """Without noise an incomplete run still gives the true curves."""
    run, curves, *_ = synthetic_run(12, seed=3)
    keep = np.ones(144, dtype=bool)
    keep[np.random.default_rng(missing).permutation(144)[:missing]] = False
    result = fit(run.take(keep))
    assert np.abs(result.error_motions.values - remove_gauge(curves)).max() < 1e-9
    assert np.all(result.error_motions.u >= 0)


def test_missing_balls_raise_the_uncertainty():
    """Fewer readings can only make the curves less certain."""
    run, *_ = synthetic_run(12, noise=1e-7, repeatability=1e-7)
    full = fit(run).error_motions.u
    less = fit(run.take(np.arange(144) % 5 != 0)).error_motions.u
    assert np.all(less > full) and np.all(less < 1.6 * full)


def test_repeated_balls_are_averaged():
    """A run measured twice has curves as the mean of both and uncertainties less by root 2."""
    first, *_ = synthetic_run(6, seed=1, noise=1e-7, repeatability=1e-7)
    second, *_ = synthetic_run(6, seed=1, noise=1e-7, repeatability=1e-7)
    noise = 1e-7 * np.random.default_rng(9).standard_normal(second.centre.shape)
    twice = {name: np.concatenate([getattr(first, name), getattr(second, name)])
             for name in ('table_position', 'ball', 'table_angle', 'time', 'temperature',
                          'approach', 'table_travel')}
    both = first.replace(centre=np.concatenate([first.centre, second.centre + noise]),
                         repeats=True, session=None, **twice)
    mean = first.replace(centre=first.centre + 0.5 * noise)
    assert np.abs(fit(both).error_motions.values - fit(mean).error_motions.values).max() < 1e-14
    assert np.allclose(fit(both).error_motions.u * np.sqrt(2), fit(mean).error_motions.u, rtol=1e-6)


def test_weights_count():
    """A reading of tiny weight cannot pull the curves."""
    run, curves, *_ = synthetic_run(6, seed=2)
    centre = run.centre.copy()
    centre[7] += 1e-3
    weight = np.ones((36, 3))
    weight[7] = 1e-12
    result = fit(run.replace(centre=centre), noise=Noise(weight=weight))
    assert np.abs(result.error_motions.values - remove_gauge(curves)).max() < 1e-8


def test_actual_angles_are_used():
    """A table that stops elsewhere, and says so, shows no false angular error."""
    run, curves, *_ = synthetic_run(12, seed=5)
    delta = 1e-4 * np.random.default_rng(2).standard_normal(144)
    c, s = np.cos(delta), np.sin(delta)
    x, y, z = run.centre.T
    turned = np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
    moved = run.replace(centre=turned, table_angle=run.table_angle + delta)
    # the machine's own part does not turn with the table: 1 um times 1e-4 is left
    assert np.abs(fit(moved).error_motions.values - remove_gauge(curves)).max() < 2e-9


@pytest.mark.parametrize('drop, words', [
    (lambda run: run.table_position != 3,
     'run: no ball centre at table position 3: the errors there cannot be determined. Measure the missing balls'),
    (lambda run: (run.table_position != 3) | (run.ball == 1),
     r'133 of 144 give rank \d+ where 131 is needed; cannot determine ctx at table position 3, ctz at table'),
    (lambda run: np.arange(run.size) < 40, r'40 of 144 .*at least 46 well spread'),
])
def test_too_little_data_names_what_is_lost(drop, words):
    """Too few readings are an error that names what cannot be determined."""
    run, *_ = synthetic_run(12)
    with pytest.raises(NotDeterminable, match=words):
        fit(run.take(drop(run)))


def test_closed_form_refuses_gaps():
    """The closed form needs every reading."""
    run, *_ = synthetic_run(6)
    with pytest.raises(NotDeterminable, match='36 ball centres; found 35. Use the least-squares fit'):
        closed_form(run.take(np.arange(35)))
