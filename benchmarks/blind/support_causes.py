# SPDX-License-Identifier: Apache-2.0
"""Causes of a plate that was just put on the table: its feet, its temperature, its clamping."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from benchmarks.blind.cause import Cause, said
from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.records import Floats
from rosette_ros.simulation.hidden.hidden_effect import UM, Draw
from rosette_ros.simulation.motion import Moment

HEIGHTS = (0.02, 0.1)
"""Least and greatest height of the balls above the feet, m."""


def settling(moment: Moment, start_h: float, constant_h: float) -> Floats:
    """Return 1 − exp(−(t − t0)/τ), zero before t0, (N, Q)."""
    return -np.expm1(-np.maximum(moment.hours - start_h, 0.0) / constant_h)


@dataclass(frozen=True)
class FootDrops(Cause):
    """One of three feet drops by s; about the line through the others the plate turns by θ = s / (1.5 r_f).

    A ball at R (cos β, sin β), h above the feet, moves by θ h along the direction of that foot and by
    −θ (R cos(β − foot) + r_f / 2) along z; foot: azimuth of the foot on the plate, rad; height h, radius R: m.
    """

    right = ('plate_tilt_step',)
    family = ('plate_slip', 'frame_step', 'axis_tilt_step')
    variables = said('ball time', 'ball angle time')
    frame = 'plate'
    feet_radius: ClassVar[float] = 0.12
    sink_um: float
    foot: float
    height: float
    radius: float
    at_h: float

    def course(self, moment: Moment) -> Floats:
        """Return the share of s by which the foot is down, broadcasts to (N, Q)."""
        return moment.hours >= self.at_h

    def ball_shift(self, moment: Moment) -> Floats:
        tilt = UM * self.sink_um / (1.5 * self.feet_radius) * self.course(moment)
        lean = np.broadcast_to(self.height, moment.azimuth.shape)
        down = self.radius * np.cos(moment.azimuth - self.foot) + self.feet_radius / 2
        return tilt[..., None] * np.stack([lean * np.cos(self.foot), lean * np.sin(self.foot), -down], axis=-1)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.size_um, by.between(0, TWO_PI), by.between(*HEIGHTS), by.run.radius, by.time())


@dataclass(frozen=True)
class FootSettles(FootDrops):
    """One of three feet sinks from the first reading on, fast first, then slower: s (1 − exp(−t/τ))."""

    right = ('plate_tilt_settling',)
    family = ('plate_warp', 'plate_creep', 'frame_warmup')
    constant_h: float

    def course(self, moment: Moment) -> Floats:
        return settling(moment, self.at_h, self.constant_h)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.size_um, by.between(0, TWO_PI), by.between(*HEIGHTS), by.run.radius, by.run.start_h,
                   by.run.duration_h * by.between(0.2, 0.6))


@dataclass(frozen=True)
class PlateSoaks(Cause):
    """A plate from another room takes the temperature of the cell: it grows by e (1 − exp(−t/τ)), or shrinks."""

    right = ('plate_soaking',)
    family = ('plate_expansion',)
    variables = said('time', 'time position')
    frame = 'plate'
    growth_ppm: float
    start_h: float
    constant_h: float

    def plate_growth(self, moment: Moment) -> Floats:
        return UM * self.growth_ppm * settling(moment, self.start_h, self.constant_h)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.sign() * by.angle_urad, by.run.start_h, by.run.duration_h * by.between(0.1, 0.5))


@dataclass(frozen=True)
class PlateTurnsSettling(Cause):
    """A plate clamped at its centre turns on the table and comes to rest: by g (1 − exp(−t/τ)) about the axis."""

    right = ('table_zero_warmup',)
    family = ('table_zero_drift', 'plate_slip')
    variables = said('time', 'time position')
    frame = 'plate'
    turn_urad: float
    start_h: float
    constant_h: float

    def plate_turn(self, moment: Moment) -> Floats:
        return UM * self.turn_urad * settling(moment, self.start_h, self.constant_h)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.sign() * by.angle_urad, by.run.start_h, by.run.duration_h * by.between(0.1, 0.4))
