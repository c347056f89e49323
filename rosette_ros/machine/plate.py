# SPDX-License-Identifier: Apache-2.0
"""The ball plate as it was made and as it was clamped on the table."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import TWO_PI, nominal_angles, rotate_z, rotation_matrix
from rosette_ros.machine.streams import part_generator


def nominal_balls(n, radius):
    """Return the nominal ball centres b_j at table angle 0, (n, 3), m."""
    beta = nominal_angles(n)
    return radius * np.stack([np.cos(beta), np.sin(beta), np.zeros(n)], axis=-1)


@dataclass(frozen=True, eq=False)
class Plate:
    """A rigid plate on the table.

    balls: (n, 3) ball centres in the plate's own frame, in the order in which the operator counts
    them, m; turn: (3, 3) clamped attitude; shift: (3,) m, of the plate's centre on the table.
    """

    balls: np.ndarray
    turn: np.ndarray
    shift: np.ndarray

    def on_table(self, ball, growth=0.0):
        """Return the centres of balls (N, 1), one-based, in the table's turning frame, m.

        growth: relative growth of the plate in its plane, scalar or (N, Q). Shape (N, 1 or Q, 3).
        """
        centre = self.balls[ball - 1]
        if np.ndim(growth):
            centre = centre + growth[..., None] * (centre * np.array([1.0, 1.0, 0.0]))
        return centre @ self.turn.T + self.shift


def build_plate(settings, clamping, seed):
    """Return the Plate of PlateSettings as ClampingSettings put it on the table."""
    n = settings.balls
    own = 1e-6 * settings.deviation_um * part_generator(seed, 'plate').standard_normal((n, 3))
    # The plate was put on turned by whole pitches: its ball m is now counted as ball m + pitches.
    pitches = round(clamping.plate_turn_deg * n / 360)
    deviation = rotate_z(TWO_PI * pitches / n, np.roll(own, pitches, axis=0))
    # Clamped anew, it lies elsewhere by the same amounts.
    rng = part_generator(seed, f'clamping {pitches % n}')
    aside, tilted = rng.uniform(0, TWO_PI, 2)
    tilt = 1e-3 * clamping.tilt_mrad * np.array([np.cos(tilted), np.sin(tilted), 0.0])
    turn = rotation_matrix(tilt) @ rotation_matrix([0.0, 0.0, 1e-3 * clamping.turn_mrad])
    shift = 1e-3 * np.array([clamping.eccentricity_mm * np.cos(aside),
                             clamping.eccentricity_mm * np.sin(aside), clamping.height_mm])
    return Plate(nominal_balls(n, settings.circle_radius_mm * 1e-3) + deviation, turn, shift)
