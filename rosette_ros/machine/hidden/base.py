# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002 (a hook that does nothing needs no arguments)
"""The contract of a hidden effect: what it moves, turns or deforms, at each touch.

An effect writes only its own physics, by overriding the hooks it needs; the machine calls every
hook of every effect and composes the rigid bodies exactly. A hook returns 0 where it does nothing,
else an array that broadcasts to (N, Q) or, for vectors, (N, Q, 3).
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from rosette_ros.machine.settings import Settings

UM = 1e-6
"""One micrometre or one microradian."""

BallNumber = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class Situation:
    """The run that effects are drawn for, as it is expected.

    balls: n; radius: m; start_h: when it begins after power-on; duration_h: how long it takes;
    sigma_um: repeatability.
    """

    balls: int
    radius: float
    start_h: float
    duration_h: float
    sigma_um: float


class HiddenEffect(Settings):
    """One physical effect that the machine does not tell of."""

    def frame_shift(self, moment):
        """Return by how much the table stands off against the probe, machine frame, m."""
        return 0.0

    def axis_tilt(self, moment):
        """Return the tilt of the table's axis, rotation vector in the table frame, rad."""
        return 0.0

    def table_shift(self, moment):
        """Return the shift of the turning part, in the table frame, m."""
        return 0.0

    def table_tilt(self, moment):
        """Return the tilt of the turning part, rotation vector in the table frame, rad."""
        return 0.0

    def table_turn(self, moment):
        """Return the angle by which the turning part is ahead of its encoder, rad."""
        return 0.0

    def plate_shift(self, moment):
        """Return the shift of the plate on the table, in the turning frame, m."""
        return 0.0

    def plate_turn(self, moment):
        """Return the turn of the plate on the table about the axis, rad."""
        return 0.0

    def plate_growth(self, moment):
        """Return the relative growth of the plate in its plane."""
        return 0.0

    def ball_shift(self, moment):
        """Return the shift of the measured ball on the plate, in the turning frame, m."""
        return 0.0

    def surface(self, moment, direction, touches):
        """Return how much the ball stands out at its touch points, m.

        direction: (N, Q, 3) unit vectors from the ball's centre to the touch points, machine
        frame; touches: the TouchPattern.
        """
        return 0.0

    def probe_shift(self, moment):
        """Return what the CMM adds to each coordinate it shows, machine frame, m."""
        return 0.0

    def noise_factor(self, moment):
        """Return the factor on the noise of a reading, broadcasts to (N, 1)."""
        return 1.0


def drawn_time(rng, situation):
    """Return a time in the middle of the run, h since power-on."""
    return situation.start_h + situation.duration_h * float(rng.uniform(0.3, 0.8))


_HOOKS = tuple(name for name in vars(HiddenEffect)
               if not name.startswith(('_', 'model_')) and callable(vars(HiddenEffect)[name]))


def acting(effects):
    """Return, for each hook's name, the hooks of those effects that override it, tuples."""
    return {hook: tuple(getattr(effect, hook) for effect in effects
                        if getattr(type(effect), hook) is not getattr(HiddenEffect, hook))
            for hook in _HOOKS}


def along(vector, course):
    """Return a fixed vector (3,) [um or urad] times a course (N, Q), as (N, Q, 3) in SI."""
    return np.asarray(vector) * UM * np.asarray(course)[..., None]


def drawn_vector(rng, size, axes=3):
    """Return a vector of length `size` in a drawn direction, a tuple of three numbers.

    axes: 3, or 2 for a vector in the x-y plane.
    """
    direction = rng.standard_normal(3)
    direction[axes:] = 0.0
    return tuple(float(x) for x in size * direction / np.linalg.norm(direction))


def drawn_sign(rng):
    """Return +1.0 or -1.0."""
    return float(rng.choice([-1.0, 1.0]))
