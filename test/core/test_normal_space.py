# SPDX-License-Identifier: Apache-2.0
"""Runs that lack or repeat readings, in any noise: what a dense solution gives, without its memory."""

import tracemalloc

import numpy as np
import pytest
from dense_space import DenseSpace
from hypothesis import example, given
from hypothesis import strategies as st
from synthetic import MICROMETRE, RADIUS, synthetic_run

from rosette_ros.analysis import analyse
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Whitening
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.reduced_sets import best_members

SAME = 1e-12  # of columns of size 1
SUBSETS = (*[BASE_TERMS] * 4, BASE_TERMS[:2], BASE_TERMS[::2], BASE_TERMS[1:], BASE_TERMS[:1])
NOISES = ('white', 'z noisier', 'weights', 'wander')


def part(n, share, seed, **rest):
    """Return a run of which a share is lost, and its true curves."""
    run, curves, *_ = synthetic_run(n, 'random', seed, **rest)
    lost = np.random.default_rng(seed).permutation(run.size)[:round(share * run.size)]
    return run.take(np.setdiff1d(np.arange(run.size), lost)), curves


def whitening_of(noise, size, rng):
    """Return the whitening of readings of a noise, weights from 0.1 to 10."""
    if noise in ('white', 'z noisier'):
        return Whitening(size, np.array([1.0, 1.0, 1.0 + (noise == 'z noisier')]))
    sd = np.exp(np.log(10) * rng.uniform(-1, 1, (size, 3)))
    return Whitening(size, sd, 0.9, (noise == 'wander') * np.array([0.5, 1.0, 2.0]))


@given(n=st.integers(5, 13), share=st.floats(0.0, 0.3), repeats=st.integers(0, 20), reduced=st.booleans(),
       noise=st.sampled_from(NOISES), terms=st.sampled_from(SUBSETS), seed=st.integers(0, 999))
@example(n=5, share=0.25, repeats=0, reduced=False, noise='white', terms=BASE_TERMS[:2], seed=2)
def test_normal_equations_equal_the_dense_solution(n, share, repeats, reduced, noise, terms, seed):
    """Residuals, parameters, rank and cofactors of gaps, repeats, reduced plans with both, weights and wander."""
    run, rng = part(n, share, seed)[0], np.random.default_rng(seed)
    if reduced and n > 7:
        run = run.take(np.flatnonzero(np.isin(run.cmm_position - 1, best_members(n, n - 3))))
    run = run.replace(repeats=True).take(np.concatenate([np.arange(run.size), rng.integers(0, run.size, repeats)]))
    white = whitening_of(noise, run.size, rng)
    whole = DenseSpace(run, RADIUS)
    is_open = whole.rank < 12 * n - 13 - 3 * (2 * n - len({*run.ball}) - len({*run.cmm_position}))
    try:
        found = BaseSpace(run, RADIUS, terms, white)
    except NotDeterminable:
        assert is_open
        return
    dense = DenseSpace(run, RADIUS, terms, white)
    if not is_open and whole.curve_cofactor().max() * RADIUS**2 > 50:
        return  # hardly determined: what is left of rounding is larger
    rows = rng.standard_normal((3, run.size, 3))
    assert found.rank == dense.rank
    size = np.abs(white.apply(rows)).max()
    assert np.abs(found.residual(rows) - dense.residual(rows)).max() < SAME * size
    assert np.abs(found.residual(rows.astype(np.float32)) - dense.residual(rows)).max() < 1e-4 * size
    if is_open:
        return  # the reference takes its gauge from the whole model, which has more open than that
    for got, wanted in zip(vars(found.described(rows)[0]).values(), vars(dense.parameters(rows)).values()):
        assert np.array_equal(np.isnan(got), np.isnan(wanted))
        assert np.nanmax(np.abs(got - wanted)) < SAME * size / RADIUS * 10
    for got, wanted in zip((found.curve_cofactor(), *found.deviation_cofactors()) if terms == BASE_TERMS else (),
                           (dense.curve_cofactor(), *dense.deviation_cofactors())):
        assert np.nanmax(np.abs(got / wanted - 1)) < 1e-10


def test_the_share_of_each_reading_needs_no_dense_design():
    """20 balls, a tenth lost, weights from 0.1 to 10: shares that the base model describes, by the dense solution."""
    run = part(20, 0.1, 3)[0]
    white = whitening_of('weights', run.size, np.random.default_rng(3))
    wanted = np.sum(DenseSpace(run, RADIUS, whitening=white).rows**2, axis=0).reshape(-1, 3)
    assert np.abs(BaseSpace(run, RADIUS, whitening=white).leverage - wanted).max() < SAME * 100


def test_a_large_plate_needs_no_dense_basis():
    """A tenth of 100 balls lost: the curves are true within their uncertainty, in less than 60 MB."""
    run, curves = part(100, 0.1, 1, noise=0.1 * MICROMETRE)
    tracemalloc.start()
    found = fit(run)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60e6  # an orthonormal basis has 230 MB
    error = (found.error_motions.values - remove_gauge(curves)) / found.error_motions.u
    assert 0.9 < np.sqrt(np.mean(error**2)) < 1.1


@pytest.mark.parametrize('share', [0, 0.1])
def test_a_large_plate_with_noisier_z_stays_quick(share):
    """z twice as noisy is found by its residuals, and needs no dense solution."""
    run, _ = part(40, share, 2, noise=0.1 * MICROMETRE)
    more = np.sqrt(3) * 0.1 * MICROMETRE * np.random.default_rng(2).standard_normal(run.size)
    found = analyse(run.replace(centre=run.centre + more[:, None] * [0, 0, 1]))
    assert found.noise.axes[2] / found.noise.axes[0] == pytest.approx(2, rel=0.1)
    assert analyse(run).noise.is_white
    assert found.joint.space.is_even == (not share)


def test_runs_that_determine_too_little_are_refused():
    """A ball that was never read drops out; one table position with one ball leaves its motions open, and is named."""
    run, *_ = synthetic_run(20, 'diagonal')
    never = BaseSpace(run.take(np.flatnonzero(run.ball != 7)[1:]), RADIUS)
    assert never.rank == 12 * 20 - 13 - 3
    gone = run.take(np.flatnonzero((run.table_position > 1) | (run.ball == 1)))
    with pytest.raises(NotDeterminable, match='too few ball centres.*needed; cannot determine cty at table position 1'):
        BaseSpace(gone, RADIUS)
    with pytest.raises(NotDeterminable, match=': no ball centre at table position 1, 5: the errors there cannot'):
        BaseSpace(run.take(np.flatnonzero((run.table_position != 1) & (run.table_position != 5))), RADIUS)
