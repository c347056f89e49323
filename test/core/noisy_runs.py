# SPDX-License-Identifier: Apache-2.0
"""Runs of 12 balls with noise of many kinds, for tests of what the noise is."""

import numpy as np
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.noise_hypotheses import noise_beside
from rosette_ros.core.model.least_squares import fit

SIGMA = 1e-7


def noisy(offset, seed=0, order='random'):
    """Return a run of 12 balls with an offset (N, 3) in sigma on its readings, whose repeatability is known."""
    run = synthetic_run(12, order, seed, repeatability=SIGMA)[0]
    return run.replace(centre=run.centre + SIGMA * offset)


def moved(run, displacement, size):
    """Return a run moved by a displacement (N, 3) of which the base model leaves a norm of so many SIGMA."""
    visible = np.linalg.norm(fit(run.replace(centre=run.centre + 1e-6 * displacement)).residual - fit(run).residual)
    return run.replace(centre=run.centre + size * SIGMA * 1e-6 / visible * displacement)


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


def noise_of(run):
    """Return the likeliest Noise of a run beside the base model alone."""
    return noise_beside(fit(run)).found()[0].noise
