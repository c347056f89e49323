# SPDX-License-Identifier: Apache-2.0
"""Causes that move the table relative to the probe: temperature, drifts, pulses."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from benchmarks.blind.cause import DRIFTS, Cause, Vector, lagged, said
from rosette_ros.core.records import Floats, Run
from rosette_ros.simulation.hidden.hidden_effect import Draw, along
from rosette_ros.simulation.motion import Moment


@dataclass(frozen=True)
class TemperatureLagged(Cause):
    """The frame follows the temperature with a time constant: τ y' + y = T."""

    right = ('frame_temperature_lag',)
    part = ('frame_temperature',)
    family = DRIFTS
    variables = said('temperature', 'time')
    groups: ClassVar[dict[str, Any]] = {'climate': {'cycle_K': 0.1, 'cycle_min': 70.0}}
    lag: ClassVar[tuple[float, float]] = (0.1, 0.4)
    coefficient_um_per_K: Vector
    constant_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.coefficient_um_per_K, lagged(moment.hours.mean(axis=1), moment.warming.mean(axis=1),
                                                      self.constant_h)[:, None])

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.size_um / 0.1), by.run.duration_h * by.between(*cls.lag))


@dataclass(frozen=True)
class TemperatureCoarse(TemperatureLagged):
    """The temperature is recorded in steps of a large part of its range; the frame follows the true one with a lag."""

    lag = (0.02, 0.1)

    def recorded(self, run: Run) -> Run:
        # a share between 0.25 and 0.7 of the range, by the drawn time constant
        step = np.ptp(run.temperature) * (0.25 + 0.45 * (1e3 * self.constant_h % 1))
        return run.replace(temperature=step * np.round(run.temperature / step))


@dataclass(frozen=True)
class TemperatureMissing(TemperatureLagged):
    """There is no record of the temperature that the frame follows: what it does in time is all that is to be seen."""

    family = (*DRIFTS, 'frame_cycle')
    lag = (0.02, 0.1)

    def recorded(self, run: Run) -> Run:
        return run.replace(temperature=np.full(run.size, np.nan))


@dataclass(frozen=True)
class TemperatureGap(TemperatureLagged):
    """The record of the temperature lacks the middle third of the run."""

    lag = (0.02, 0.1)

    def recorded(self, run: Run) -> Run:
        third = np.arange(run.size) * 3 // run.size
        return run.replace(temperature=np.where(third == 1, np.nan, run.temperature))


@dataclass(frozen=True)
class DriftFrom(Cause):
    """A drift of the frame that begins at a moment: somebody opened a door."""

    right = ('frame_drift_onset',)
    family = DRIFTS
    variables = said('time')
    end_um: Vector
    at_h: float
    until_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.end_um, np.maximum(moment.hours - self.at_h, 0.0) / (self.until_h - self.at_h))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.size_um), by.time(), by.run.start_h + by.run.duration_h)


@dataclass(frozen=True)
class DriftQuadratic(Cause):
    """A drift of the frame that grows faster and faster."""

    right = ('frame_drift_curved',)
    family = DRIFTS
    variables = said('time')
    end_um: Vector
    start_h: float
    duration_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.end_um, ((moment.hours - self.start_h) / self.duration_h)**2)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.vector(by.size_um), by.run.start_h, by.run.duration_h)


@dataclass(frozen=True)
class FramePulse(Cause):
    """The frame is off for a while and comes back: somebody leaned on the granite."""

    right = ('frame_pulse',)
    family = ('frame_step', 'outlier')
    variables = said('time')
    shift_um: Vector
    at_h: float
    until_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, (self.at_h <= moment.hours) & (moment.hours < self.until_h))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        start = by.run.start_h + by.run.duration_h * by.between(0.1, 0.75)
        return cls(by.vector(2 * by.size_um), start, start + by.run.duration_h * by.between(0.03, 0.15))
