# SPDX-License-Identifier: Apache-2.0
"""Runs that lack readings: filling the missing cells gives what a dense solution gives, without its memory."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import MICROMETRE, RADIUS, synthetic_run

from rosette_ros.analysis import analyse
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.base_model import CompleteSpace, DenseSpace
from rosette_ros.core.model.base_space import base_space
from rosette_ros.core.model.incomplete_space import IncompleteSpace
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.noise import Whitening
from rosette_ros.core.records import remove_gauge

FILLED = 1e-12  # of columns of size 1


def part(n, share, seed, **rest):
    """Return a run of which a share is lost, and its true curves."""
    run, curves, *_ = synthetic_run(n, 'random', seed, **rest)
    lost = np.random.default_rng(seed).permutation(run.size)[:round(share * run.size)]
    return run.take(np.setdiff1d(np.arange(run.size), lost)), curves


@given(n=st.integers(5, 13), share=st.floats(0.05, 0.35), seed=st.integers(0, 999), columns=st.sampled_from([1, 30]))
@settings(max_examples=40)
def test_filling_equals_the_dense_solution(n, share, seed, columns):
    """By steps and by factors: residuals, parameters, rank and cofactors, with z noisier than x and y."""
    run, _ = part(n, share, seed)
    white = Whitening(run.size, np.array([1.0, 1.0, 2.0]))
    try:
        dense = DenseSpace(run, RADIUS, whitening=white)
    except NotDeterminable:
        with pytest.raises(np.linalg.LinAlgError):
            IncompleteSpace(run, RADIUS, white)
        return
    if dense.curve_cofactor().max() * RADIUS**2 > 50:
        return  # hardly determined: what is left of rounding is larger
    filled = IncompleteSpace(run, RADIUS, white)
    rows = np.random.default_rng(seed).standard_normal((columns, run.size, 3))
    assert filled.rank == dense.rank
    assert np.abs(filled.residual(rows) - dense.residual(rows)).max() < FILLED
    assert np.abs(filled.residual(rows.astype(np.float32)) - dense.residual(rows)).max() < 1e-4
    for got, wanted in zip(vars(filled.parameters(rows)).values(), vars(dense.parameters(rows)).values()):
        assert np.abs(got - wanted).max() < FILLED / RADIUS * 10
    for got, wanted in zip((filled.curve_cofactor(), *filled.deviation_cofactors()),
                           (dense.curve_cofactor(), *dense.deviation_cofactors()), strict=True):
        assert np.abs(got / wanted - 1).max() < 1e-10


def test_a_large_plate_needs_no_dense_basis():
    """A tenth of 100 balls lost: the curves are true within their uncertainty, in less than 60 MB."""
    run, curves = part(100, 0.1, 1, noise=0.1 * MICROMETRE)
    tracemalloc.start()
    found = fit(run)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert type(found.joint.space) is IncompleteSpace
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
    assert type(found.joint.space) is (IncompleteSpace if share else CompleteSpace)


def test_what_filling_cannot_tell_is_told_by_the_dense_solution():
    """A ball that was never read, one table position with one ball, and noise by reading go another way."""
    run, *_ = synthetic_run(20, 'diagonal')
    assert type(base_space(run.take(np.flatnonzero(run.ball != 7)[1:]), RADIUS)) is DenseSpace
    gone = run.take(np.flatnonzero((run.table_position > 1) | (run.ball == 1)))
    with pytest.raises(NotDeterminable, match='too few ball centres.*cannot determine cty at table position 1, '):
        base_space(gone, RADIUS)
    part_of = run.take(np.arange(run.size - 3))
    assert type(base_space(part_of, RADIUS)) is IncompleteSpace
    by_reading = Whitening(part_of.size, np.ones((part_of.size, 3)))
    assert type(base_space(part_of, RADIUS, whitening=by_reading)) is DenseSpace
