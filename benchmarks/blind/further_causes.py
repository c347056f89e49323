# SPDX-License-Identifier: Apache-2.0
"""Further causes, for what no family was written for; their contract stands in cause.py."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmarks.blind.cause import DRIFTS, Cause, Vector, lagged, said
from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.records import Floats
from rosette_ros.simulation.hidden.hidden_effect import UM, Draw, along
from rosette_ros.simulation.motion import Moment


@dataclass(frozen=True)
class PlateCreepSettles(Cause):
    """The plate slides on the table, fast first, then slower."""

    right = ('plate_creep_settling',)
    family = ('plate_creep', 'plate_slip')
    variables = said('time angle', 'time')
    frame = 'plate'
    shift_um: Vector
    start_h: float
    constant_h: float

    def plate_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, -np.expm1(-np.maximum(moment.hours - self.start_h, 0.0) / self.constant_h))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.size_um, axes=2), by.run.start_h, by.run.duration_h * by.between(0.1, 0.4))


@dataclass(frozen=True)
class TableZeroStep(Cause):
    """The zero of the angle encoder jumps once."""

    right = ('table_zero_step',)
    family = ('plate_slip',)
    variables = said('time', 'time position')
    turn_urad: float
    at_h: float

    def table_turn(self, moment: Moment) -> Floats:
        return self.turn_urad * UM * (moment.hours >= self.at_h)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.sign() * by.angle_urad, by.time())


@dataclass(frozen=True)
class AxisTiltStep(Cause):
    """The bed settles once: the axis tilts at a moment."""

    right = ('axis_tilt_step',)
    variables = said('time position', 'time')
    tilt_urad: Vector
    at_h: float

    def axis_tilt(self, moment: Moment) -> Floats:
        return along(self.tilt_urad, moment.hours >= self.at_h)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.angle_urad, axes=2), by.time())


@dataclass(frozen=True)
class SpringBack(Cause):
    """A knock that goes back by itself: off at once, then exponentially to where it was."""

    right = ('frame_pulse', 'frame_recovery')
    family = ('frame_step', 'outlier', *DRIFTS)
    variables = said('time')
    shift_um: Vector
    at_h: float
    constant_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        since = moment.hours - self.at_h
        return along(self.shift_um, np.exp(-np.maximum(since, 0.0) / self.constant_h) * (since >= 0))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.size_um), by.time(), by.run.duration_h * by.between(0.05, 0.2))


@dataclass(frozen=True)
class UnsteadyCycle(Cause):
    """An air conditioning whose period and size change in the run."""

    right = ('frame_cycle',)
    family = DRIFTS
    variables = said('time')
    size_um: Vector
    start_h: float
    duration_h: float
    turns: float
    change: float

    def frame_shift(self, moment: Moment) -> Floats:
        share = (moment.hours - self.start_h) / self.duration_h
        return along(self.size_um, (1 + self.change * share) * np.sin(
            TWO_PI * self.turns * share * (1 + 0.5 * self.change * share)))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.size_um), by.run.start_h, by.run.duration_h, by.between(2, 6), by.between(0.4, 1))


@dataclass(frozen=True)
class ExpansionLagged(Cause):
    """The plate follows the temperature late: it is thick."""

    right = ('plate_expansion_lag',)
    family = ('plate_expansion',)
    variables = said('temperature', 'time', 'temperature position', 'time position')
    frame = 'plate'
    groups = {'climate': {'cycle_K': 0.1, 'cycle_min': 70.0}}  # noqa: RUF012
    coefficient_ppm_per_K: float
    constant_h: float

    def plate_growth(self, moment: Moment) -> Floats:
        late = lagged(moment.hours.mean(axis=1), moment.warming.mean(axis=1), self.constant_h)
        return UM * self.coefficient_ppm_per_K * np.broadcast_to(late[:, None], moment.hours.shape)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(10 * by.angle_urad, by.run.duration_h * by.between(0.1, 0.4))


@dataclass(frozen=True)
class TwoBallsCreep(Cause):
    """Two balls of one glue batch creep together."""

    right = ('ball_creep',)
    family = ('ball_slip',)
    variables = said('ball time')
    frame = 'plate'
    balls: tuple[int, ...]
    shift_um: tuple[Vector, ...]
    start_h: float
    constant_h: float

    def ball_shift(self, moment: Moment) -> Floats:
        course = -np.expm1(-np.maximum(moment.hours - self.start_h, 0.0) / self.constant_h)
        return sum(along(shift, course * (moment.ball == ball)) for ball, shift in zip(self.balls, self.shift_um))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        balls = by.rng.choice(np.arange(1, by.run.balls + 1), 2, replace=False).tolist()
        return cls(tuple(balls), tuple(by.vector(2 * by.size_um) for _ in balls), by.run.start_h,
                   by.run.duration_h * by.between(0.2, 0.6))
