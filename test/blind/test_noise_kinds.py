# SPDX-License-Identifier: Apache-2.0
"""Each kind of noise has the statistics that it claims."""

import itertools

import numpy as np
import pytest
import scipy  # which loads its parts where they are used

from benchmarks.blind.noise_kinds import KINDS, Readings, draw_noise
from benchmarks.blind.runs import CHECK, SIGMA, Plan, noisy


def readings(size=20000, n=12, check=0):
    """Return readings of a run in random order, one every 40 s."""
    rng = np.random.default_rng(3)
    return Readings(n, check, 40.0 * np.arange(size), rng.integers(1, n + 1, size), rng.integers(1, n + 1, size))


def drawn(kind, seed=1, **sizes):
    """Return the offset of a kind, (N, 3)."""
    return draw_noise(kind, readings(**sizes), np.random.default_rng(seed)).offset


@pytest.mark.parametrize(('kind', 'factors'), [('z_1.5', (1, 1, 1.5)), ('z_3', (1, 1, 3)), ('x_3_y_2', (3, 2, 1))])
def test_axes_scatter_as_stated(kind, factors):
    """The standard deviation of each axis is its factor, the axes are independent and white."""
    offset = drawn(kind)
    assert offset.std(axis=0) == pytest.approx(factors, rel=0.02)
    assert np.abs(np.corrcoef(offset.T) - np.eye(3)).max() < 0.03
    assert np.abs(scipy.stats.kurtosis(offset, axis=0)).max() < 0.1


@pytest.mark.parametrize(('kind', 'dof', 'is_shared'), [
    ('t3_coordinate', 3, False), ('t3_reading', 3, True), ('t4_coordinate', 4, False), ('t4_reading', 4, True)])
def test_student_has_its_tails_and_unit_variance(kind, dof, is_shared):
    """The distribution is Student's t scaled to variance 1; coordinates of a reading share their size or do not."""
    offset = drawn(kind)
    unit = scipy.stats.t(dof, scale=np.sqrt((dof - 2) / dof))
    assert scipy.stats.kstest(offset[:, 1], unit.cdf).pvalue > 0.01
    assert scipy.stats.kstest(offset[:, 1], scipy.stats.norm.cdf).pvalue < 1e-6
    size = scipy.stats.rankdata(np.abs(offset), axis=0)
    shared = np.corrcoef(size.T)[0, 1]
    assert (shared > 0.1) if is_shared else abs(shared) < 0.03


def test_laplace_and_contaminated_have_their_kurtosis():
    """Laplace: excess 3, variance 1; 5 % of threefold size: 3 (0.95 + 0.05 · 81) / 1.4² − 3."""
    assert scipy.stats.kurtosis(drawn('laplace'), axis=None) == pytest.approx(3, abs=0.3)
    assert drawn('laplace').var() == pytest.approx(1, abs=0.03)
    assert scipy.stats.kurtosis(drawn('contaminated'), axis=None) == pytest.approx(3 * 5.0 / 1.96 - 3, abs=0.6)


@pytest.mark.parametrize('count', [1, 2, 3])
def test_outliers_are_ten_sigma_off_at_their_readings(count):
    """Off by 10 σ are exactly the readings that are listed, counted from 1 in the run."""
    at, rng = readings(159, check=15), np.random.default_rng(2)
    noise = draw_noise(f'outliers_{count}', at, rng)
    plain = KINDS['white'](at, np.random.default_rng(2))
    far = np.linalg.norm(noise.offset - plain, axis=1)
    assert np.flatnonzero(far[15:] > 1e-9).tolist() == [place - 1 for place in noise.outliers]
    assert np.sort(far)[-count:] == pytest.approx(10) and not far[:15].any()


@pytest.mark.parametrize(('kind', 'group'), [
    ('sigma_by_ball', 'ball'), ('sigma_by_table_position', 'table_position')])
def test_sigma_differs_by_group(kind, group):
    """Each ball (table position) has a σ of its own between 0.5 and 2."""
    at = readings(40000)
    offset = draw_noise(kind, at, np.random.default_rng(4)).offset
    sigma = np.array([offset[getattr(at, group) == one].std() for one in range(1, 13)])
    assert sigma.min() > 0.48 and sigma.max() < 2.1 and sigma.max() > 1.6 * sigma.min()


def test_radial_noise_is_twice_the_tangential():
    """Along the radius σ is 2, across it 1."""
    at = readings()
    offset = draw_noise('radial_2', at, np.random.default_rng(1)).offset
    turned = (offset[:, 0] + 1j * offset[:, 1]) * np.exp(-1j * at.azimuth)
    assert (turned.real.std(), turned.imag.std()) == pytest.approx((2, 1), rel=0.03)


@pytest.mark.parametrize(('kind', 'rho'), [('white', 0), ('ar_0.3', 0.3), ('ar_0.6', 0.6), ('ar_0.8', 0.8)])
def test_neighbours_are_correlated_as_stated(kind, rho):
    """AR(1): variance 1 and autocorrelation ρ, ρ² at lags 1 and 2."""
    offset = drawn(kind)
    assert offset.var() == pytest.approx(1, abs=0.05)
    for lag in (1, 2):
        assert np.mean(offset[lag:] * offset[:-lag]) == pytest.approx(rho**lag, abs=0.04)


def test_only_z_is_correlated_in_ar_z():
    """Lag 1 of x, y and z: 0, 0 and 0.6."""
    offset = drawn('ar_0.6_z')
    assert np.mean(offset[1:] * offset[:-1], axis=0) == pytest.approx([0, 0, 0.6], abs=0.03)


@pytest.mark.parametrize('seed', range(4))
def test_slow_variance_changes_by_two_to_three(seed):
    """Between its least and its largest σ lies a factor of 2 to 3, and the mean square is 1."""
    offset = drawn('slow_variance', seed, size=60000)
    sigma = offset.reshape(60, -1).std(axis=1)
    assert 1.9 < sigma.max() / sigma.min() < 3.2
    assert np.mean(offset**2) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(('kind', 'step'), [('rounded_1', 1), ('rounded_5', 5)])
def test_rounded_readings_are_multiples_of_the_step(kind, step):
    """Every coordinate is a multiple of the resolution; a check that shows no scatter states no repeatability."""
    clean = Plan(12, 'random', 1).measure()[0]
    run = noisy(clean, kind, np.random.default_rng(1), stated=True)[0]
    steps = run.centre / (step * SIGMA)
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert (run.centre - clean.centre).std() == pytest.approx(SIGMA * np.sqrt(1 + step**2 / 12), rel=0.1)
    stated = [noisy(clean, kind, np.random.default_rng(seed), stated=True)[0].repeatability for seed in range(40)]
    assert (None in stated) == (step == 5) and all(one is None or one > 0.1 * SIGMA for one in stated)


def test_flicker_falls_with_frequency():
    """The power spectrum is ∝ 1/f, σ is 1 over the run; white noise of 1 σ is beside it unless it is alone."""
    alone = drawn('flicker_alone', size=8192)
    assert alone.std(axis=0) == pytest.approx([1, 1, 1])
    frequency, power = periodogram(alone)
    slope = np.polyfit(np.log(frequency), np.log(power), 1)[0]
    assert slope == pytest.approx(-1, abs=0.15)
    assert drawn('flicker_1', size=8192).std() == pytest.approx(np.sqrt(2), rel=0.03)


def periodogram(offset):
    """Return frequencies, and the power averaged over the axes and over bands of equal ratio."""
    power = (np.abs(np.fft.rfft(offset, axis=0))**2).mean(axis=1)
    edges = np.unique(np.geomspace(1, len(power) - 1, 16).astype(int))
    bands = list(itertools.pairwise(edges))
    return ([np.mean(np.arange(low, high)) for low, high in bands], [power[low:high].mean() for low, high in bands])


@pytest.mark.parametrize(('kind', 'end', 'axes'), [
    ('walk_3', 3, (1, 1, 1)), ('walk_10', 10, (1, 1, 1)), ('walk_5_z', 5, (0, 0, 1))])
def test_the_frame_walks_as_far_as_stated(kind, end, axes):
    """The frame has gone `end` σ at the end, half the variance at half of the time, beside white noise of 1 σ."""
    offset = np.array([drawn(kind, seed, size=159, check=15) for seed in range(1500)])
    last, middle = offset[:, -1].var(axis=0), offset[:, 15 + 72].var(axis=0)
    assert last == pytest.approx(1 + end**2 * np.array(axes), rel=0.15)
    assert middle == pytest.approx(1 + end**2 * np.array(axes) / 2, rel=0.15)


def test_a_check_states_sigma_and_its_degrees_of_freedom():
    """Fifteen readings of white noise state 0.1 µm with 42 degrees of freedom; they are not those of the run."""
    clean = Plan(12, 'random', 1).measure()[0]
    runs = [noisy(clean, 'white', np.random.default_rng(seed), stated=True)[0] for seed in range(30)]
    assert {run.repeatability_dof for run in runs} == {3 * (CHECK - 1)}
    assert np.sqrt(np.mean([run.repeatability**2 for run in runs])) == pytest.approx(SIGMA, rel=0.05)
    unknown = noisy(clean, 'white', np.random.default_rng(0), stated=False)[0]
    assert unknown.repeatability is None and np.array_equal(unknown.centre, runs[0].centre)


def test_noise_is_drawn_again_from_its_seed():
    """The same seed draws the same of every kind, another seed does not."""
    for kind in KINDS:
        first, second, other = (drawn(kind, seed, size=159, check=15) for seed in (1, 1, 2))
        assert np.array_equal(first, second) and not np.array_equal(first, other) and first.shape == (159, 3)
