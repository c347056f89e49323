# SPDX-License-Identifier: Apache-2.0
"""How far measured ball centres are from their expected places once plate and table are taken as they lie."""

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import Floats


def unseated(centre: ArrayLike, expected: ArrayLike, angle: ArrayLike) -> Floats:
    """Return what is left of ball centres less their expected places, (N, 3), m, in the table frame.

    At the table angle theta a plate that is shifted by e (eccentricity, height), turned by w (tilt, azimuth) and larger
    by s than expected has its balls at t + R_z(theta) e + (R_z(theta) w) x t + s t; an axis that is not where it was
    found moves them by a + b x t, a and b across z. These eleven numbers are taken off by least squares, the smallest
    of those that fit where readings are few.

    centre, expected: (N, 3), m; angle: (N,), rad."""
    place, angle = np.asarray(expected, dtype=float).reshape(-1, 3), np.asarray(angle, dtype=float).reshape(-1)
    size = float(np.abs(place).max(initial=0.0)) or 1.0
    turned = [rotate_z(angle, np.tile(axis, (len(angle), 1))) for axis in np.eye(3)]
    across = [np.tile(axis, (len(angle), 1)) for axis in np.eye(3)[:2]]
    columns = [*turned, *across, *(np.cross(axis, place / size) for axis in (*turned, *across)), place / size]
    design = np.stack([column.ravel() for column in columns], axis=1)
    difference = (np.asarray(centre, dtype=float).reshape(-1, 3) - place).ravel()
    left = difference - design @ np.linalg.lstsq(design, difference, rcond=None)[0]
    return np.asarray(left.reshape(-1, 3))
