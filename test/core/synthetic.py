# SPDX-License-Identifier: Apache-2.0
"""Runs for the tests of the core, made from the measurement equation alone."""

import numpy as np

from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan

RADIUS = 0.1825
MICROMETRE = 1e-6


def synthetic_run(n, order='diagonal', seed=0, noise=0.0, curves=None, turning='forward', **rest):
    """Return a run and its true curves (n, 6), plate (n, 3), cmm (n, 3), written out by hand."""
    rng = np.random.default_rng(seed)
    scheme = plan(n, order, seed, turning)
    curves = 1e-6 * rng.standard_normal((n, 6)) if curves is None else curves
    plate, cmm = 1e-5 * rng.standard_normal((n, 3)), 1e-6 * rng.standard_normal((n, 3))
    centre = np.empty((scheme.ball.size, 3))
    for row, (i, j, k) in enumerate(zip(scheme.table_position, scheme.ball, scheme.cmm_position)):
        phi, beta = 2 * np.pi * (i - 1) / n, 2 * np.pi * (j - 1) / n
        ball = RADIUS * np.array([np.cos(beta), np.sin(beta), 0.0])
        turned = rotate_z(phi, ball)
        centre[row] = (turned + rotate_z(phi, plate[j - 1]) + curves[i - 1, :3]
                       + np.cross(curves[i - 1, 3:], turned) + cmm[k - 1])
    centre += noise * rng.standard_normal(centre.shape)
    run = Run(n, RADIUS, scheme.table_position, scheme.ball, centre, time=40.0 * np.arange(scheme.ball.size),
              approach=scheme.approach, repeats=scheme.repeats, **rest)
    return run, curves, plate, cmm
