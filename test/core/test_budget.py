# SPDX-License-Identifier: Apache-2.0
"""Plans for a given time: as good as those that were found independently, and never longer than the time."""

from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.core.errors import InvalidPlan
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.planning.budget import propose
from rosette_ros.core.planning.expectation import expect
from rosette_ros.core.scheme import plan
from rosette_ros.core.touches import Pace, sigma_of_touches

PACE = Pace(3.0, 20.0)


def test_a_plan_takes_as_long_as_it_is_proposed_to():
    """By itself and among those for a given time."""
    best = propose(12, 0.1825, 1.0)[0]
    scheme = replace(best.scheme, touches=np.full(best.scheme.ball.size, best.touches))
    assert best.duration == pytest.approx(expect(scheme, 0.1825).duration) and best.duration <= 3600


@pytest.mark.parametrize('hours, error', [(1, 1.41), (2, 1.07), (4, 0.81)])
def test_plans_are_as_good_as_those_found_elsewhere(hours, error):
    """n = 12, 3 s a touch, 20 s a table move, a frame that wanders by 0.1 µm in an hour."""
    found = propose(12, 0.1825, hours, 1e-7, 1e-7, PACE)
    assert round(found[0].error, 2) <= error
    assert all(one.duration <= 3600 * hours for one in found)
    assert [one.error for one in found] == sorted(one.error for one in found)


def test_the_error_is_that_of_simulated_drift():
    """The expected error of a proposal is the scatter of curves fitted to noise and drift that no model describes."""
    best, rng = propose(6, 0.1825, 0.4, 1e-7, 2e-7, PACE)[0], np.random.default_rng(1)
    run = planned_run(best.scheme, 0.1825)
    moves = np.abs(np.diff(run.table_position, prepend=run.table_position[:1])) > 0
    step = np.diff(3.0 * best.touches * np.arange(1, run.size + 1) + 20.0 * np.cumsum(moves), prepend=0.0)
    drift = np.cumsum(rng.standard_normal((400, run.size, 3)) * 2e-7 * np.sqrt(step / 3600)[:, None], axis=1)
    noise = rng.standard_normal((400, run.size, 3)) * sigma_of_touches(best.touches, 1e-7)
    curves = BaseSpace(run, 0.1825).parameters(drift + noise).curves
    assert np.sqrt(np.mean(curves**2, axis=(0, 1))) == pytest.approx(best.u, rel=0.12)


def test_sigma_of_touches():
    """20 touches give sigma; fewer less than by their number, as the positioning of the CMM stays."""
    assert sigma_of_touches(20, 1e-7) == pytest.approx(1e-7)
    assert 1e7 * sigma_of_touches(8, 1e-7)[[0, 2]] == pytest.approx([1.20, 1.08], abs=0.005)
    assert 1e7 * sigma_of_touches(6, 1e-7)[[0, 2]] == pytest.approx([1.285, 1.194], abs=0.005)


def test_expectation_of_a_complete_and_of_a_reduced_run():
    """A complete run is the unit; a reduced one has its penalty, not less than the ideal one."""
    complete, half = expect(plan(12), 0.1825), expect(plan(12, cmm_positions=(1, 2, 4, 6, 9, 10)), 0.1825)
    assert complete.penalty == pytest.approx(1) and complete.rank == complete.full_rank == 131
    assert half.penalty == pytest.approx(1.522, abs=1e-3) and half.ideal == pytest.approx(2**0.5) and half.rank == 113
    assert complete.u[0] == pytest.approx([0.264, 0.264, 0.276, 2.04, 2.04, 1.51], rel=5e-3)


@pytest.mark.parametrize('n, hours, words', [
    (12, 0.1, r'0.1 h are too short for 12 balls: the shortest plan takes 0.30 h; wanted more time'),
    (72, 9, 'wanted at most 36 balls, got 72; choose with --cmm-positions')])
def test_what_cannot_be_proposed(n, hours, words):
    """Too little time and too many balls are told with what to do."""
    with pytest.raises(InvalidPlan, match=words):
        propose(n, 0.1825, hours, pace=PACE)
