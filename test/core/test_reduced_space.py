# SPDX-License-Identifier: Apache-2.0
"""Reduced runs: the normal equations give what a dense solution gives, with the planned uncertainty."""

import numpy as np
import pytest
from dense_space import DenseSpace
from hypothesis import given
from hypothesis import strategies as st
from synthetic import RADIUS, synthetic_run

from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.errors import InvalidPlan, NotDeterminable
from rosette_ros.core.run.records import Run, remove_gauge
from rosette_ros.core.run.reduced_sets import best_members, fewest_members, penalty, relative_uncertainty
from rosette_ros.core.run.scheme import plan

# n, size, penalty: published with the derivation of reduced schemes, found by an independent dense computation
PENALTIES = [(12, 8, 1.26), (12, 6, 1.52), (12, 4, 2.27), (24, 12, 1.45), (24, 6, 2.23), (36, 12, 1.79), (36, 9, 2.12)]


def reduced_run(n, by, members, times=1):
    """Return a run with all table positions at some CMM positions or of some balls, each measured some times."""
    scheme = plan(n, 'random', n, **{by: members})
    position, ball = (np.tile(one, times) for one in (scheme.table_position, scheme.ball))
    return Run(n, RADIUS, position, ball, np.tile(scheme.centres(RADIUS), (times, 1)), repeats=times > 1)


@given(n=st.integers(6, 13), by=st.sampled_from(['cmm_positions', 'balls']), times=st.integers(1, 2), data=st.data())
def test_reduced_runs_equal_the_dense_solution(n, by, times, data):
    """Residuals, parameters, rank and cofactors agree to rounding wherever the run is determined."""
    size = data.draw(st.integers(fewest_members(n), n))
    members = data.draw(st.lists(st.integers(1, n), min_size=size, max_size=size, unique=True))
    if penalty(n, tuple(one - 1 for one in members)) > 10:
        return
    run = reduced_run(n, by, members, times)
    fast, dense = BaseSpace(run, RADIUS), DenseSpace(run, RADIUS)
    y = np.random.default_rng(n).standard_normal((2, run.size, 3))
    assert fast.rank == dense.rank == 12 * n - 13 - 3 * (n - size)
    assert np.abs(fast.residual(y) - dense.residual(y)).max() < 1e-12
    for got, wanted in zip(vars(fast.described(y)[0]).values(), vars(dense.parameters(y)).values()):
        assert np.array_equal(np.isnan(got), np.isnan(wanted))
        assert np.nanmax(np.abs(got - wanted)) < 1e-11
    assert np.abs(fast.curve_cofactor() / dense.curve_cofactor() - 1).max() < 1e-11
    for got, wanted in zip(fast.deviation_cofactors(), dense.deviation_cofactors(), strict=True):
        assert np.array_equal(np.isnan(got), np.isnan(wanted))
        assert np.nanmax(np.abs(got / wanted - 1)) < 1e-10


@given(n=st.integers(4, 13), data=st.data())
def test_the_penalty_is_that_of_a_run(n, data):
    """How well a set determines the curves is known before a run, and whether it does."""
    size = data.draw(st.integers(3, n))
    members = data.draw(st.lists(st.integers(1, n), min_size=size, max_size=size, unique=True))
    run = synthetic_run(n)[0]
    run = run.take(np.isin(run.cmm_position, members))
    wanted = penalty(n, tuple(one - 1 for one in members))
    try:
        variance = BaseSpace(run, RADIUS).curve_cofactor()
    except NotDeterminable:
        assert wanted > 1e3
        return
    assert relative_uncertainty(variance, RADIUS) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize('n, size, wanted', PENALTIES)
def test_uncertainty_of_good_sets(n, size, wanted):
    """The uncertainty of the curves relative to a complete run, within one per cent."""
    assert penalty(n, best_members(n, size)) == pytest.approx(wanted, rel=0.01)


def test_arcs_are_bad_and_equal_steps_are_not_determined():
    """Neighbouring positions cost twice as much as good ones; equally spaced ones determine nothing."""
    assert penalty(12, tuple(range(6))) == pytest.approx(3.06, rel=0.01)
    assert penalty(12, (0, 3, 6, 9)) == np.inf


@pytest.mark.parametrize('n', [4, 5, 6, 7, 9, 15])
def test_searched_sets_determine_the_curves(n):
    """The fewest members that can determine the curves do, and one less is refused."""
    assert penalty(n, best_members(n, fewest_members(n))) < 3
    with pytest.raises(InvalidPlan, match='do not determine the curves; expected at least'):
        best_members(n, fewest_members(n) - 1)


def test_reduced_run_recovers_the_truth():
    """Without noise a run at four of twelve CMM positions gives the true curves; what was not touched is unknown."""
    run, curves, *_ = synthetic_run(12)
    used = np.isin(run.cmm_position, [1, 5, 7, 10])
    found = fit(run.take(used))
    assert np.abs(found.error_motions.values - remove_gauge(curves)).max() < 1e-9
    assert list(np.flatnonzero(np.isnan(found.cmm[:, 0]))) == [1, 2, 3, 5, 7, 8, 10, 11]
    assert np.all(np.isfinite(found.plate))


def test_a_set_that_determines_nothing_is_refused():
    """Equally spaced CMM positions are refused with what to do."""
    run, *_ = synthetic_run(12)
    with pytest.raises(NotDeterminable, match='CMM positions 1, 4, 7, 10 of 12 do not determine the curves; measure '
                                              'more of them, or others'):
        fit(run.take(np.isin(run.cmm_position, [1, 4, 7, 10])))
