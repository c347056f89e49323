# SPDX-License-Identifier: Apache-2.0
"""Causes in the table's drive and encoder, the probe head and the axes of the CMM."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from benchmarks.blind.cause import DRIFTS, Cause, said
from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.records import Floats
from rosette_ros.simulation.hidden.hidden_effect import UM, Draw, along
from rosette_ros.simulation.motion import Moment


@dataclass(frozen=True)
class BacklashByAngle(Cause):
    """The backlash of the table is larger on one side of its worm wheel: ½ b (1 + share cos(φ − φ0)) by sense."""

    right = ('table_backlash_angle',)
    part = ('table_backlash',)
    variables = said('table_sense', 'table_sense angle')
    turning = 'alternate'
    width_urad: float
    share: float
    phase: float

    def table_turn(self, moment: Moment) -> Floats:
        width = self.width_urad * (1 + self.share * np.cos(moment.angle - self.phase))
        return 0.5 * UM * width * moment.approach

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.sign() * by.angle_urad, by.between(0.7, 1.5), by.between(0, TWO_PI))


def move_direction(moment: Moment) -> Floats:
    """Return the direction of the CMM's last move in its x-y plane, (N, 1, 2), zero before the first move."""
    place = np.stack([np.cos(moment.angle + moment.azimuth), np.sin(moment.angle + moment.azimuth)], axis=-1)[:, 0]
    way = np.diff(place, axis=0, prepend=place[:1])
    length = np.sqrt(np.vecdot(way, way))
    last = np.maximum.accumulate(np.where(length > 1e-3, np.arange(len(way)), -1))
    unit = way / np.maximum(length, 1e-3)[:, None]
    return np.where(last[:, None] >= 0, unit[np.maximum(last, 0)], 0.0)[:, None, :]


@dataclass(frozen=True)
class ProbeDirection(Cause):
    """The head comes to rest behind its last move: the centre is shifted along the direction of approach."""

    right = ('probe_approach',)
    part = ('cmm_reversal',)
    family = ('cmm_reversal_position',)
    variables = said('cmm_sense', 'direction')
    lag_um: float

    def probe_shift(self, moment: Moment) -> Floats:
        return UM * self.lag_um * np.concatenate([move_direction(moment), np.zeros((len(moment.ball), 1, 1))], axis=-1)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.sign() * by.size_um)


@dataclass(frozen=True)
class ProbeLobes(Cause):
    """The rest position of the head has three lobes by the direction of approach: it shifts the centre in z."""

    right = ('probe_approach',)
    family = ('cmm_reversal', 'cmm_reversal_position')
    variables = said('cmm_sense', 'direction')
    lobe_um: float
    phase: float

    def probe_shift(self, moment: Moment) -> Floats:
        way = move_direction(moment)
        at = np.arctan2(way[..., 1], way[..., 0])
        return along((0.0, 0.0, self.lobe_um), np.cos(3 * at - self.phase) * way.any(axis=-1))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.size_um, by.between(0, TWO_PI))


def radius_vector(moment: Moment, radius: float) -> Floats:
    """Return where the ball stands about the table's axis, x and y, (N, 1, 2), m."""
    at = moment.angle + moment.azimuth
    return radius * np.stack([np.cos(at), np.sin(at)], axis=-1)


@dataclass(frozen=True)
class ScaleDrift(Cause):
    """The scale of one horizontal axis of the CMM grows steadily, from a fixed point near the table."""

    right = ('cmm_scale_drift',)
    part = ('frame_drift',)
    family = ('plate_expansion', *DRIFTS)
    variables = said('time position', 'time position machine')
    axis: int
    rate_ppm_per_h: float
    fixed_m: float
    radius: float

    def probe_shift(self, moment: Moment) -> Floats:
        way = radius_vector(moment, self.radius)[..., self.axis] - self.fixed_m
        return self.rate_ppm_per_h * UM * (moment.hours * way)[..., None] * np.eye(3)[self.axis]

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(int(by.rng.integers(2)), by.angle_urad / by.run.duration_h,
                   by.run.radius * by.between(-1, 1), by.run.radius)


@dataclass(frozen=True)
class SquarenessDrift(Cause):
    """The y axis of the CMM leans over towards x, steadily: x grows with t · y."""

    right = ('cmm_squareness_drift',)
    part = ('frame_drift',)
    family = ('table_zero_drift', *DRIFTS)
    variables = said('time position', 'time position machine')
    rate_urad_per_h: float
    fixed_m: float
    radius: float

    def probe_shift(self, moment: Moment) -> Floats:
        way = radius_vector(moment, self.radius)[..., 1] - self.fixed_m
        return self.rate_urad_per_h * UM * (moment.hours * way)[..., None] * np.eye(3)[0]

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.angle_urad / by.run.duration_h, by.run.radius * by.between(-1, 1), by.run.radius)


@dataclass(frozen=True)
class EncoderInterpolation(Cause):
    """The encoder interpolates its lines unevenly: a short-period error where the table stops, which is not nominal."""

    right = ('encoder_interpolation',)
    variables = said('line', 'angle line')
    groups: ClassVar[dict[str, Any]] = {'table': {'positioning_urad': 60.0}}
    lines: ClassVar[int] = 36000
    first_urad: float
    second_urad: float
    phase: float
    second_phase: float

    def table_turn(self, moment: Moment) -> Floats:
        at = self.lines * moment.angle
        return UM * (self.first_urad * np.cos(at + self.phase) + self.second_urad * np.cos(2 * at + self.second_phase))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.angle_urad, by.angle_urad * by.between(0, 0.5), by.between(0, TWO_PI), by.between(0, TWO_PI))


@dataclass(frozen=True)
class EncoderHarmonics(Cause):
    """Waves of the table's scale above n/2 per turn, at nominal stops: they alias into crz, and nothing is left."""

    variables = said('angle')
    orders: tuple[int, ...]
    size_urad: float
    phase: float

    def table_turn(self, moment: Moment) -> Floats:
        return UM * self.size_urad * sum(np.cos(order * moment.angle + self.phase) for order in self.orders)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        half = by.run.balls // 2
        return cls(tuple(by.rng.choice(np.arange(half + 1, 4 * half), 2, replace=False).tolist()), by.angle_urad,
                   by.between(0, TWO_PI))
