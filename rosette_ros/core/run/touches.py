# SPDX-License-Identifier: Apache-2.0
"""Where a ball is touched, how well that determines its centre, and the sphere that fits the touches best."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rosette_ros.core.run.geometry import TWO_PI, Floats

TOUCHES = (6, 8, 9, 12, 16, 20)
"""Numbers of touches of a ball that a plan may have: circles of three (6, 9) or four."""
LEAST_TOUCHES = 4
"""Touches that determine a sphere, which has four unknowns."""
USUAL = 20
"""Touches of a ball of which the expected uncertainties and times are told."""
CIRCLES_AT = (0.867, -0.133)
"""Heights of the highest and the lowest circle, in radii: of a ball of 15 mm touched 1 mm below pole and equator."""
TABLE_SPEED = 0.1
"""Usual speed of a table, rad/s."""
CMM_SPEED = 0.05
"""Usual speed of a CMM, m/s."""
TOUCH_SHARE = 0.8
"""Part of the worst coordinate of a centre that the touches take, the positioning of the CMM, which stays, the rest."""


@dataclass(frozen=True)
class Pace:
    """How long a cell takes: for a touch, and for a move of the table, the CMM's included, s.

    table_move: None for the time that table and CMM need at usual speeds, whichever takes longer.
    """

    touch: float = 1.5
    table_move: float | None = None

    def times(self, touches: Floats, turn: Floats, move: Floats) -> Floats:
        """Return when each of N readings ends, (N,), s; turn: rad, and move: m, before each."""
        moving = np.maximum(turn / TABLE_SPEED, move / CMM_SPEED) if self.table_move is None else (
            self.table_move * (turn > 0))
        return np.asarray(np.cumsum(self.touch * touches + moving))


USUAL_PACE = Pace()


def touch_directions(circles: int, points: int, top: float, lowest: float) -> Floats:
    """Return unit vectors from the centre of a ball, (circles * points, 3), top circle first, each from +x.

    top, lowest: heights of the circles over the centre, in radii of the ball. Source: Kniel et al. (2019), section 2.2.
    """
    height, azimuth = (grid.ravel() for grid in np.meshgrid(
        np.linspace(top, lowest, circles), TWO_PI * np.arange(points) / points, indexing='ij'))
    around = np.sqrt(1 - height**2)
    return np.stack([around * np.cos(azimuth), around * np.sin(azimuth), height], axis=-1)


def circles_of(touches: int) -> tuple[int, int]:
    """Return (circles, points of each) of a number of touches that is one of TOUCHES."""
    points = 3 if touches % 4 else 4
    return touches // points, points


def usual_directions(touches: int = USUAL) -> Floats:
    """Return the directions of touches of a ball as a plan has them, (Q, 3)."""
    return touch_directions(*circles_of(touches), *CIRCLES_AT)


def sphere_factors(direction: Floats) -> Floats:
    """Return the standard deviations of centre and radius per one of a touch along its normal, (4,).

    From the linear problem with rows (u, 1) for centre and radius: z follows the radius and is the worst.
    """
    rows = np.column_stack([direction, np.ones(len(direction))])
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))))


def centre_factors(direction: Floats) -> Floats:
    """Return the standard deviations of the centre's coordinates per one of a touch along its normal, (3,)."""
    return sphere_factors(direction)[:3]


def sigma_of_touches(touches: int, sigma: float) -> Floats:
    """Return the standard deviations (3,), m, of a ball centre along x, y, z by `touches`, where USUAL give `sigma`."""
    usual, factors = centre_factors(usual_directions()), centre_factors(usual_directions(touches))
    touch = TOUCH_SHARE * sigma / usual.max()
    return np.asarray(np.sqrt((factors * touch)**2 + (sigma**2 - (usual * touch)**2)))


class Spheres(NamedTuple):
    """Spheres through the touches of N balls: centre (N, 3); radius (N,); distance of each touch from it, (N, Q); m."""

    centre: Floats
    radius: Floats
    distance: Floats

    @property
    def residual(self) -> Floats:
        """Of each touch, outwards positive, (N, Q), m."""
        return np.asarray(self.distance - self.radius[:, None])

    @property
    def form(self) -> Floats:
        """Range of the touches' distances from the sphere, (N,), m."""
        return np.asarray(self.distance.max(axis=-1) - self.distance.min(axis=-1))


def fit_spheres(points: Floats, steps: int = 3) -> Spheres:
    """Return the least-squares spheres of touches (N, Q, 3), m.

    Minimised is the sum of (|p - c| - r)^2, r being the mean distance: Gauss-Newton from the algebraic sphere, with the
    normal matrix of the touches themselves. After 3 steps 2e-17 m are left for up to 2 um of form, 5e-16 m for 10 um;
    each step leaves about form / radius of what the one before left.
    """
    mean = np.full((1, points.shape[1]), 1.0 / points.shape[1])
    middle = mean @ points
    points = points - middle
    inverse = np.linalg.inv(np.swapaxes(points, 1, 2) @ points)
    # |p|^2 = 2 c.p + (r^2 - |c|^2) is linear in the centre c, and the touches' mean is zero.
    centre = (0.5 * np.vecdot(points, points)[:, None, :]) @ points @ inverse
    for _ in range(steps):
        off = points - centre
        distance = np.sqrt(np.vecdot(off, off))[:, None, :]
        radius = distance @ mean.T
        # The normals are off / distance, their spread about the mean is points / radius.
        centre = centre + ((1.0 - radius / distance) @ off) @ inverse * (radius * radius)
    off = points - centre
    distance = np.sqrt(np.vecdot(off, off))
    return Spheres((centre + middle)[:, 0], distance @ mean[0], distance)
