# SPDX-License-Identifier: Apache-2.0
"""The one solution of a linear explanation, against the normal distribution and the integral over sigma written out."""

import numpy as np
import pytest
import scipy  # which loads its parts where they are used

from rosette_ros.core.sight.linear_explanation import Solution, log_bayes_factor


def test_the_log_bayes_factor_is_that_of_normal_readings():
    """Of columns D of sizes s, with sigma unknown, p(sigma) ~ 1 / sigma, and known: covariance 1 + D' s^2 D."""
    rng = np.random.default_rng(0)
    for q, m in ((1, 5), (3, 8)):
        rows, y = rng.uniform(0.5, 3, (q, 1)) * rng.standard_normal((q, m)), rng.standard_normal(m)
        solution, told = Solution(rows @ rows.T), rows @ y
        wide = np.eye(m) + rows.T @ rows
        known = [scipy.stats.multivariate_normal(cov=one).logpdf(y) for one in (wide, np.eye(m))]
        assert solution.log_bayes_factor(told) == pytest.approx(known[0] - known[1])
        log_sigma = np.linspace(-6, 8, 4001)
        each = [np.exp(-m * log_sigma - np.linalg.slogdet(one)[1] / 2
                       - np.exp(-2 * log_sigma) * (y @ np.linalg.solve(one, y)) / 2).sum() for one in (wide, np.eye(m))]
        assert solution.log_bayes_factor(told, y @ y, m) == pytest.approx(np.log(each[0] / each[1]), abs=1e-4)
        single = Solution((rows @ rows.T).astype(np.float32)).log_bayes_factor(told.astype(np.float32),
                                                                               np.float32(y @ y), m)
        assert single == pytest.approx(np.log(each[0] / each[1]), abs=1e-3)
    assert np.isfinite(log_bayes_factor(1.0, np.array([2.0, 3.0]), 2.0, 4)).all()
    assert np.isfinite(log_bayes_factor(1.0, np.float32([2.0, 3.0]), np.float32(2.0), 4)).all()


@pytest.mark.parametrize('many', [(), (4,)])
def test_amplitudes_are_those_of_normal_readings(many):
    """Mean and covariance of amplitudes given readings, by the joint normal distribution of both; one and many."""
    rng = np.random.default_rng(1)
    rows, y = rng.standard_normal((*many, 3, 9)), rng.standard_normal((*many, 9, 1))
    across = np.swapaxes(rows, -1, -2)
    gain = rows @ np.linalg.inv(np.eye(9) + across @ rows)  # cov(a, y) cov(y, y)^-1
    solution = Solution(rows @ across)
    assert solution.solved(rows @ y) == pytest.approx(gain @ y)
    half = solution.halved(np.broadcast_to(np.eye(3), (*many, 3, 3)))
    assert np.swapaxes(half, -1, -2) @ half == pytest.approx(np.eye(3) - gain @ across)


def test_what_depends_on_others_and_what_is_not_there_is_solved():
    """Where columns are the same and large, rounding makes square sums of directions negative; none tell nothing."""
    rng = np.random.default_rng(2)
    some = 1e6 * rng.standard_normal((4, 300))
    rows = np.concatenate([some, some, 1e-6 * some])
    solution, y = Solution(rows @ rows.T), rng.standard_normal(300)
    basis = np.linalg.qr(some.T)[0]
    assert solution.fall(rows @ y) == pytest.approx(np.sum((basis.T @ y)**2), rel=1e-6)
    assert float(Solution(np.zeros((0, 0))).log_bayes_factor(np.zeros(0))) == 0
    assert not Solution(np.zeros((5, 0, 0))).log_bayes_factor(np.zeros((5, 0))).any()
