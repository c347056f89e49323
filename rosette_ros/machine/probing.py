# SPDX-License-Identifier: Apache-2.0
"""Probing a ball: touches on horizontal circles, contact with a real sphere, least-squares centre.

Source: Kniel et al. (2019), section 2.2: 20 points on 5 horizontal circles of 4, the top circle
1 mm below the pole, the lowest 1 mm below the equator, none at the pole.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rosette_ros.core.geometry import TWO_PI

_GAUSS_NEWTON_STEPS = 3
"""From the algebraic start: 2e-17 m are left for up to 2 um of form, 5e-16 m for 10 um."""


@dataclass(frozen=True, eq=False)
class TouchPattern:
    """Where a ball is touched.

    direction: (Q, 3) unit vectors from its centre, in the order of touching, top circle first;
    points_per_circle: evenly spaced from +x; radius: of the ball, tip: of the probe's tip, m.
    """

    direction: np.ndarray
    points_per_circle: int
    radius: float
    tip: float

    @property
    def size(self):
        """Q, the number of touches."""
        return len(self.direction)

    @cached_property
    def centre_factors(self):
        """(3,) sd of the centre's coordinates per sd of a touch along its normal.

        From the linear problem with rows (u, 1) for centre and radius: the touches reach little
        below the equator, so that z follows the radius and is the worst coordinate.
        """
        rows = np.column_stack([self.direction, np.ones(self.size)])
        return np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))[:3]


def build_pattern(settings, ball_radius):
    """Return the TouchPattern of ProbingSettings on a ball of that radius [m]."""
    heights = np.linspace(1 - 1e-3 * settings.below_pole_mm / ball_radius,
                          -1e-3 * settings.below_equator_mm / ball_radius, settings.circles)
    azimuth = TWO_PI * np.arange(settings.points_per_circle) / settings.points_per_circle
    height, azimuth = (grid.ravel() for grid in np.meshgrid(heights, azimuth, indexing='ij'))
    around = np.sqrt(1 - height**2)
    direction = np.stack([around * np.cos(azimuth), around * np.sin(azimuth), height], axis=-1)
    return TouchPattern(direction, settings.points_per_circle, ball_radius,
                        1e-3 * settings.tip_radius_mm)


@dataclass(frozen=True)
class NoiseSizes:
    """Standard deviations, m: of a touch along its normal; of the CMM per axis and ball, (3,)."""

    touch: float
    position: np.ndarray


def noise_sizes(settings, pattern):
    """Return the NoiseSizes that make every coordinate of a ball centre repeat alike.

        repeatability^2 = (factor_axis * touch)^2 + position_axis^2

    The touches take `touch_share` of the worst coordinate, the positioning of the CMM the rest.
    """
    total = 1e-6 * settings.repeatability_um
    touch = settings.touch_share * total / pattern.centre_factors.max()
    left = total**2 - (pattern.centre_factors * touch)**2
    return NoiseSizes(touch, np.sqrt(np.maximum(left, 0.0)))


def contact(aim, direction, centre, reach):
    """Return how far the tip's centre is from the aim when it touches, (N, Q), m.

    The tip comes along the line aim + s * direction and stops at distance `reach` from the ball's
    centre: s^2 - 2 s u.(c - a) + |c - a|^2 = reach^2. aim: (N, 1, 3); direction: (Q, 3); centre:
    (N, Q or 1, 3); reach: radius of ball and tip, scalar or (N, Q), m.
    """
    off = centre - aim
    along = np.vecdot(off, direction)
    return along + np.sqrt(along * along - np.vecdot(off, off) + reach * reach)


def fit_spheres(points):
    """Return the least-squares spheres of touches (N, Q, 3): centres (N, 3) and form (N,), m.

    Minimised is the sum of (|p - c| - r)^2, r being the mean distance: Gauss-Newton from the
    algebraic sphere, with the normal matrix of the touches themselves. `form` is the range of the
    touches' distances from the sphere.
    """
    mean = np.full((1, points.shape[1]), 1.0 / points.shape[1])
    middle = mean @ points
    points = points - middle
    inverse = np.linalg.inv(np.swapaxes(points, 1, 2) @ points)
    # |p|^2 = 2 c.p + (r^2 - |c|^2) is linear in the centre c, and the touches' mean is zero.
    centre = (0.5 * np.vecdot(points, points)[:, None, :]) @ points @ inverse
    for _ in range(_GAUSS_NEWTON_STEPS):
        off = points - centre
        distance = np.sqrt(np.vecdot(off, off))[:, None, :]
        radius = distance @ mean.T
        # The normals are off / distance, their spread about the mean is points / radius.
        centre = centre + ((1.0 - radius / distance) @ off) @ inverse * (radius * radius)
    off = points - centre
    distance = np.sqrt(np.vecdot(off, off))
    return (centre + middle)[:, 0], distance.max(axis=-1) - distance.min(axis=-1)
