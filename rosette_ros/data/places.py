# SPDX-License-Identifier: Apache-2.0
"""Where ball centres should be, and which are so far from there that an index or frame is wrong."""

import numpy as np

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.scheme import cmm_position


def nominal_places(n, radius, table_position, ball):
    """Return the nominal ball centres in the table frame, (N, 3), in the unit of the radius."""
    azimuth = TWO_PI * (cmm_position(n, table_position, ball) - 1) / n
    return radius * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)


def misplaced(n, radius, table_position, ball, centre):
    """Return the rows of ball centres (N, 3) that are nearer to another ball's place, (M,)."""
    with np.errstate(over='ignore', invalid='ignore'):
        away = np.linalg.norm(centre - nominal_places(n, radius, table_position, ball), axis=-1)
    return np.flatnonzero(~(away <= radius * np.sin(np.pi / n)))
