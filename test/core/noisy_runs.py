# SPDX-License-Identifier: Apache-2.0
"""Runs of 12 balls with noise of many kinds, for tests of what the noise is."""

import numpy as np
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.noise_search import NoiseProblem, estimate
from rosette_ros.core.model.least_squares import fit

SIGMA = 1e-7
NONE = np.zeros((0, 144, 3))


def noisy(offset, seed=0, order='random'):
    """Return a run of 12 balls with an offset (N, 3) in sigma on its readings, whose repeatability is known."""
    run = synthetic_run(12, order, seed, repeatability=SIGMA)[0]
    return run.replace(centre=run.centre + SIGMA * offset)


def white(seed):
    """Return independent normal numbers for 144 readings, and the generator."""
    rng = np.random.default_rng([seed, 7])
    return rng.standard_normal((144, 3)), rng


def autoregressive(seed, rho):
    """Return noise whose neighbours are correlated."""
    drive, _ = white(seed)
    out = drive.copy()
    for place in range(1, 144):
        out[place] = rho * out[place - 1] + np.sqrt(1 - rho**2) * drive[place]
    return out


def walk(seed, end):
    """Return white noise on a frame that wanders at random."""
    noise, rng = white(seed)
    return noise + end / 12 * np.cumsum(rng.standard_normal((144, 3)), axis=0)


def student(seed, dof):
    """Return noise of heavy tails, the same scale for all axes of a reading."""
    noise, rng = white(seed)
    return noise * np.sqrt((dof - 2) / rng.chisquare(dof, (144, 1)))


def problem(offset, seed=0, order='random'):
    """Return the problem of the noise of a run."""
    run = noisy(offset, seed, order)
    found = fit(run)
    return NoiseProblem(run, found.joint.space.basis, NONE, found.residual, 0)


def estimated(offset, seed=0, order='random'):
    """Return the NoiseFit of a run."""
    return estimate(problem(offset, seed, order))


def covariance(sd, phi, wander):
    """Return the covariance (3 N, 3 N) of a noise, written out."""
    size = len(sd)
    k = np.arange(size)
    kernel = np.minimum(k[:, None], k) + 1.0 if phi == 1 else phi**np.abs(k[:, None] - k)
    out = np.zeros((size, 3, size, 3))
    for axis in range(3):
        out[:, axis, :, axis] = np.diag(sd[:, axis]**2) + wander[axis] * kernel
    return out.reshape(3 * size, 3 * size)
