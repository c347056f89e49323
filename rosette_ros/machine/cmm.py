# SPDX-License-Identifier: Apache-2.0
"""The coordinate measuring machine: volumetric errors of three linear axes."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.machine.streams import part_generator


@dataclass(frozen=True, eq=False)
class VolumetricErrors:
    """What the CMM shows beside the true coordinates.

        e(p) = linear d + bow q(u) + wave sin(pi u + phase),  d = p - centre,  u = d / half

    taken per coordinate of u, with q(u) = u^2 - 1/3: `linear` (3, 3) holds scale on its diagonal
    and squareness above it; `bow` and `wave` (3, 3) [m] hold straightness off their diagonals
    (row: direction of the error, column: moving axis) and uneven scales on them.
    """

    centre: np.ndarray
    half: float
    linear: np.ndarray
    bow: np.ndarray
    wave: np.ndarray
    phase: np.ndarray

    def error(self, point):
        """Return the error at true points (..., 3) in the machine frame, (..., 3), m."""
        off = point - self.centre
        unit = off / self.half
        return (off @ self.linear.T + (unit * unit - 1 / 3) @ self.bow.T
                + np.sin(np.pi * unit + self.phase) @ self.wave.T)


def build_cmm(settings, origin, seed):
    """Return the VolumetricErrors of CmmSettings around the table's origin (3,), m."""
    rng = part_generator(seed, 'cmm')
    share = settings.residual_share if settings.correction else 1.0
    drawn = rng.uniform(0.5, 1.0, (3, 3, 3)) * rng.choice([-1.0, 1.0], (3, 3, 3))
    linear = 1e-6 * (np.diag(settings.scale_ppm * np.diag(drawn[0]))
                     + np.triu(settings.squareness_urad * drawn[0], 1))
    straight = 1e-6 * settings.straightness_um * drawn[1:]
    return VolumetricErrors(origin, 0.5e-3 * settings.volume_mm, share * linear,
                            share * straight[0], share * 0.5 * straight[1],
                            rng.uniform(0, TWO_PI, 3))
