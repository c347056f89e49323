# SPDX-License-Identifier: Apache-2.0
"""The error motions of a table as functions of its angle, to be taken off.

At the angle theta a table that was turned by R_z(theta) stands at c + (1 + [r]x) R_z(theta) p, with the translations
c = (ctx, cty, ctz) and the rotations r = (crx, cry, crz) there. A correction holds c and r as Fourier sums up to the
harmonics that the run determines, so that it equals the curves at the positions that were measured.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import TWO_PI, rotate_z
from rosette_ros.core.run.records import CURVES, ErrorMotions, Floats

LEAST_ANGLES = 5
LEAST_OFF = 0.1
"""Share of a step from which on angles are between the steps."""


@dataclass(frozen=True, eq=False)
class Correction:
    """The errors of a table, to be taken off.

    forward: curves where the table turns to the angle in its positive sense, backward: in the other, the same where
    only one is known; corrected: which curves are taken off; run_id: of the run; simulated: as of Run. Raises
    InvalidData where the angles do not determine harmonics.
    """

    forward: ErrorMotions
    backward: ErrorMotions
    corrected: tuple[str, ...] = CURVES
    run_id: str = ''
    simulated: bool = False

    def __post_init__(self) -> None:
        for motions in (self.forward, self.backward):
            angle = np.sort(motions.angle % TWO_PI)
            gaps = np.diff(angle, append=angle[:1] + TWO_PI)
            if angle.size < LEAST_ANGLES or gaps.max() > 1.5 * TWO_PI / angle.size:
                raise InvalidData(f'correction: expected error motions at {LEAST_ANGLES} equally spaced angles or '
                                  'more, '
                                  f'found {angle.size} with gaps up to {np.rad2deg(gaps.max(initial=0)):.0f} deg')
            if not np.isfinite(motions.values).all():
                raise InvalidData('correction: expected finite error motions, found some that are not known')

    @property
    def harmonics(self) -> int:
        """The highest harmonic of the table angle, in the sense in which fewer are known."""
        return min(self.forward.angle.size, self.backward.angle.size) // 2

    def errors(self, angle: ArrayLike, sense: int = 1) -> Floats:
        """Return the six curves at angles (m,), rad, for the sense of the last move, (m, 6); not corrected ones are 0.

            e(theta) = a_0 + sum_k (a_k cos k theta + b_k sin k theta),  k = 1 .. n/2

        The highest of even many angles has one wave: cos n/2 (theta - theta_1) where they lie between the steps.
        """
        used = [curve in self.corrected for curve in CURVES]
        motions, amplitudes = ((self.backward, self._amplitudes[1]) if sense < 0 else
                               (self.forward, self._amplitudes[0]))
        return np.asarray(_waves(np.atleast_1d(np.asarray(angle, dtype=float)), motions.angle) @ amplitudes * used)

    @property
    def left(self) -> ErrorMotions:
        """What it leaves of the curves where the table turns in its positive sense."""
        made = self.forward
        return ErrorMotions(made.angle, made.values - self.errors(made.angle), made.u, made.rotation)

    def curvature(self) -> Floats:
        """Return bounds of the second derivative of the six curves by the angle, both senses, (6,), m/rad^2, 1/rad."""
        bounds = [np.abs(_orders(len(one))[:, None]**2 * one).sum(axis=0) for one in self._amplitudes]
        return np.asarray(np.max(bounds, axis=0))

    def pose(self, angle: float, sense: int = 1) -> tuple[Floats, Floats]:
        """Return how a table at an angle stands in the frame that was turned by it: shift (3,), m, rotation (3,), rad.

            shift = R_z(-theta) c,  rotation vector = R_z(-theta) r
        """
        error = self.errors(angle, sense)[0]
        return rotate_z(-angle, error[:3]), rotate_z(-angle, error[3:])

    def point(self, angle: float, point: ArrayLike, sense: int = 1) -> Floats:
        """Return where a point (3,) of the table's own frame stands in the machine-fixed table frame, (3,), m."""
        error = self.errors(angle, sense)[0]
        turned = rotate_z(angle, np.asarray(point, dtype=float))
        return np.asarray(turned + np.cross(error[3:], turned) + error[:3])

    @cached_property
    def _amplitudes(self) -> tuple[Floats, Floats]:
        both = (self.forward, self.backward)
        return tuple(np.linalg.lstsq(_waves(one.angle, one.angle), one.values)[0]  # type: ignore[return-value]
                     for one in both)


def _orders(count: int) -> Floats:
    """Return the order of each of the waves that `count` angles determine, (count,)."""
    return np.concatenate([np.arange(count // 2 + 1), np.arange(1, (count + 1) // 2)]).astype(float)


def _waves(angle: Floats, measured: Floats) -> Floats:
    """Return 1, cos and then sin of the multiples of angles (m,) that those measured (n,) determine, (m, n)."""
    count = measured.size
    phase = angle[:, None] * _orders(count)
    cosines = count // 2 + 1
    if count % 2 == 0:
        phase[:, cosines - 1] -= 0.5 * count * _beside_step(measured)
    return np.concatenate([np.cos(phase[:, :cosines]), np.sin(phase[:, cosines:])], axis=1)


def _beside_step(angle: Floats) -> float:
    """Return how far angles in equal steps are beside whole multiples of the step, rad, 0 where it is little."""
    mean = np.mean(np.exp(1j * angle.size * angle))
    off = float(np.angle(mean))
    return off / angle.size if abs(mean) > 0.5 and abs(off) > LEAST_OFF * TWO_PI else 0.0
