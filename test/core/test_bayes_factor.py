# SPDX-License-Identifier: Apache-2.0
"""The one log Bayes factor, against the integral over sigma written out."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from rosette_ros.core.sight.bayes_factor import log_bayes_factor


def test_the_log_bayes_factor_is_that_of_normal_readings():
    """Of columns D of sizes s, with sigma unknown, p(sigma) ~ 1 / sigma, and known: covariance 1 + D' s^2 D."""
    rng = np.random.default_rng(0)
    for q, m in ((1, 5), (3, 8)):
        columns, size, y = rng.standard_normal((q, m)), rng.uniform(0.5, 3, q), rng.standard_normal(m)
        gram = size[:, None] * (columns @ columns.T) * size
        told = size * (columns @ y)
        fall, log_det = told @ np.linalg.solve(np.eye(q) + gram, told), np.linalg.slogdet(np.eye(q) + gram)[1]
        wide = np.eye(m) + (columns.T * size**2) @ columns
        known = [multivariate_normal(cov=one).logpdf(y) for one in (wide, np.eye(m))]
        assert log_bayes_factor(log_det, fall) == pytest.approx(known[0] - known[1])
        log_sigma = np.linspace(-6, 8, 4001)
        each = [np.exp(-m * log_sigma - np.linalg.slogdet(one)[1] / 2
                       - np.exp(-2 * log_sigma) * (y @ np.linalg.solve(one, y)) / 2).sum() for one in (wide, np.eye(m))]
        assert log_bayes_factor(log_det, fall, y @ y, m) == pytest.approx(np.log(each[0] / each[1]), abs=1e-4)
        single = log_bayes_factor(np.float32(log_det), np.float32([fall]), np.float32(y @ y), m)
        assert single[0] == pytest.approx(np.log(each[0] / each[1]), abs=1e-3)
    assert np.isfinite(log_bayes_factor(1.0, np.array([2.0, 3.0]), 2.0, 4)).all()
    assert np.isfinite(log_bayes_factor(1.0, np.float32([2.0, 3.0]), np.float32(2.0), 4)).all()
