# SPDX-License-Identifier: Apache-2.0
"""Numbers beside simulated ones: how probable they are, Student's distribution, what a memory makes of noise,
and the repeatability that was measured beside."""

import itertools
from functools import cache

import numpy as np
from scipy import special

from rosette_ros.core.records import Floats, Run

EXACT = 3000.0
"""Degrees of freedom of a repeatability that is known exactly."""


def log_density(energy: Floats, wide: int, dof: float) -> Floats:
    """Return the log density, less a constant, of Student's distribution of so many coordinates of square sum."""
    if not np.isfinite(dof):
        return -0.5 * energy
    out: Floats = (special.gammaln((dof + wide) / 2) - special.gammaln(dof / 2) - wide / 2 * np.log(dof / 2)
                   - (dof + wide) / 2 * np.log1p(energy / dof))
    return out


@cache
def divergence(per: str, dof: float) -> float:
    """Return twice the log likelihood, per coordinate, by which normal noise prefers the normal distribution."""
    wide = 3 if per == 'reading' else 1
    energy = special.gammaincinv(wide / 2, (np.arange(2000) + 0.5) / 2000) * 2
    scale = np.geomspace(0.3, 1.5, 60)[:, None]  # Student's distribution at its best scale
    loss = -0.5 * energy.mean() - np.max(np.mean(log_density(energy / scale, wide, dof), axis=1)
                                         - wide / 2 * np.log(scale[:, 0]))
    return 2 * float(loss) / wide


def one_sided(values: Floats) -> float:
    """Return the probability of values[0] beside simulated values[1:], by a gamma distribution of their moments."""
    drawn = values[1:]
    mean, sd = drawn.mean(), drawn.std()
    skew = min(max(float(np.mean((drawn - mean)**3) / sd**3), 0.1), 2.0)
    k = 4 / skew**2
    return float(special.gammaincc(k, max(k + (values[0] - mean) / sd * np.sqrt(k), 0.0)))


def two_sided_f(ratio: float, first: float, second: float) -> float:
    """Return the probability that two variances of equal noise, of so many degrees of freedom, are as unequal."""
    return float(2 * min(special.fdtr(first, second, ratio), special.fdtrc(first, second, ratio)))


def remembered(values: Floats, phi: float) -> Floats:
    """Return y_t = phi y_(t-1) + x_t of values x (runs, N, axes) along their N readings."""
    out = values.swapaxes(0, 1).copy()
    for before, after in itertools.pairwise(out):
        after += phi * before
    return out.swapaxes(0, 1)


def two_sided(values: Floats) -> float:
    """Return the probability of values[0] beside simulated values[1:], too large or too small, as of normal numbers."""
    return float(2 * special.ndtr(-abs(values[0] - values[1:].mean()) / values[1:].std()))


def check_of(run: Run) -> tuple[float, Floats]:
    """Return the degrees of freedom of the repeatability along each axis, 0 where it is not known by axis, and its
    variances, (3,), of mean 1."""
    if run.repeatability is None or run.repeatability_axes is None:
        return 0.0, np.ones(3)
    square = np.array(run.repeatability_axes)**2
    return (run.repeatability_dof or EXACT) / 3, square / square.mean()
