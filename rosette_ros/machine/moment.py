# SPDX-License-Identifier: Apache-2.0
"""What the machine does while its touches are made: all that a physical effect can depend on."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import nominal_angles


@dataclass(frozen=True, eq=False)
class Moment:
    """The circumstances of N readings of Q touches each.

    balls: n; radius: of the circle of ball centres, m; time: (N, Q) of each touch, s since
    power-on; began, ended: (N, 1) from the first move for a reading to its last touch, s; warming:
    (N, Q) temperature against that at power-on, K; table_position, ball: (N, 1) one-based; angle:
    (N, 1) true angle to which the table turned by its encoder, rad; travel: (N, 1) unwrapped angle
    since power-on, rad; turned: (N, 1) sum of all angles turned, whatever the sense, rad;
    approach: (N, 1) sense of the last table move, 0 before the first; cmm_sense: (N, 1, 3) sense
    of the last CMM move per axis, 0 before the first.
    """

    balls: int
    radius: float
    time: np.ndarray
    began: np.ndarray
    ended: np.ndarray
    warming: np.ndarray
    table_position: np.ndarray
    ball: np.ndarray
    angle: np.ndarray
    travel: np.ndarray
    turned: np.ndarray
    approach: np.ndarray
    cmm_sense: np.ndarray

    @property
    def azimuth(self):
        """(N, 1) azimuth of the ball on the plate, rad."""
        return nominal_angles(self.balls)[self.ball - 1]

    @property
    def hours(self):
        """(N, Q) time since power-on, h."""
        return self.time / 3600.0
