# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG003 (every effect is drawn alike)
"""Effects that no library of named effects holds: a diagnosis must not give them a wrong name."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.machine.hidden.base import HiddenEffect, along, drawn_vector
from rosette_ros.machine.settings import NotNegative, Number, Vector


class BedRipple(HiddenEffect):
    """The bed swells in ripples around the table: z grows with t * cos(order * alpha)."""

    kind: Literal['bed_ripple'] = 'bed_ripple'
    rate_um_per_h: Number
    order: Annotated[int, Field(ge=2, le=12)] = 3

    def frame_shift(self, moment):
        """Return the lift at the azimuth where the ball stands."""
        shape = np.cos(self.order * (moment.angle + moment.azimuth))
        return along((0.0, 0.0, self.rate_um_per_h), shape * moment.hours)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that lifts by up to `size_um` during the run."""
        return cls(rate_um_per_h=size_um / situation.duration_h)


class FrameAcceleration(HiddenEffect):
    """The table drifts faster and faster against the probe: acceleration * t^2."""

    kind: Literal['frame_acceleration'] = 'frame_acceleration'
    acceleration_um_per_h2: Vector

    def frame_shift(self, moment):
        """Return acceleration * t^2."""
        return along(self.acceleration_um_per_h2, moment.hours**2)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that moves by about `size_um` during the run."""
        return cls(acceleration_um_per_h2=drawn_vector(rng, size_um / situation.duration_h**2))


class UnevenNoise(HiddenEffect):
    """The readings scatter more at some CMM positions: 1 + excess * (1 + cos(alpha - at)) / 2."""

    kind: Literal['uneven_noise'] = 'uneven_noise'
    excess: NotNegative
    at_deg: Number = 0.0

    def noise_factor(self, moment):
        """Return the factor where the ball stands."""
        alpha = (moment.angle + moment.azimuth) % TWO_PI
        return 1.0 + 0.5 * self.excess * (1.0 + np.cos(alpha - np.deg2rad(self.at_deg)))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one whose excess is the size in units of the repeatability, at most threefold."""
        sigma = situation.sigma_um if situation.sigma_um > 0 else 0.1
        return cls(excess=min(size_um / sigma, 3.0), at_deg=float(rng.uniform(0, 360)))
