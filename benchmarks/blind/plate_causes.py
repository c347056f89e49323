# SPDX-License-Identifier: Apache-2.0
"""Causes in the plate and its balls."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from benchmarks.blind.cause import Cause, Vector, said
from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.records import Floats
from rosette_ros.simulation.hidden.hidden_effect import UM, Draw, along
from rosette_ros.simulation.motion import Moment


@dataclass(frozen=True)
class PlateOnThreeFeet(Cause):
    """A plate on three feet on a table whose axis is not vertical: gravity's transverse part turns in its frame.

    The response is linear in the load and has the feet's threefold symmetry: z = Re Σ c_m e^{i(mβ + ψ)}, ψ the load's
    direction in the plate's frame, m + 1 a multiple of 3. m = −1 depends on ψ − β alone (a deviation of the CMM);
    m = 2 and −4 bend the plate. With ψ = γ − φ: a cos(2β − φ + γ) + b cos(4β + φ − γ').
    """

    right = ('plate_support',)
    variables = said('angle ball')
    frame = 'plate'
    bend_um: float
    higher_um: float
    phase: float
    higher_phase: float

    def ball_shift(self, moment: Moment) -> Floats:
        load = self.phase - moment.angle  # direction in the plate's frame of a load that is fixed in the machine
        bend = (self.bend_um * np.cos(2 * moment.azimuth + load)
                + self.higher_um * np.cos(4 * moment.azimuth - load + self.higher_phase))
        return along((0.0, 0.0, 1.0), bend)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.size_um, by.size_um * by.between(0.1, 0.4), by.between(0, TWO_PI), by.between(0, TWO_PI))


@dataclass(frozen=True)
class StemsUnderGravity(Cause):
    """Balls on stems of different stiffness on a tilted table: each leans to the low side, fixed in the machine."""

    right = ('ball_machine_offset',)
    variables = said('ball', 'ball machine', 'ball angle')
    lean_um: tuple[Vector, ...]

    def frame_shift(self, moment: Moment) -> Floats:
        return UM * np.asarray(self.lean_um)[moment.ball - 1]

    @classmethod
    def draw(cls, by: Draw) -> Self:
        down = by.vector(by.size_um, axes=2)
        soft = np.exp(0.5 * by.rng.standard_normal(by.run.balls))
        return cls(tuple(tuple((one * np.asarray(down)).tolist()) for one in soft))


@dataclass(frozen=True)
class BallFixedInMachine(Cause):
    """One ball is measured off by an offset that does not turn with the plate: its material, its shade, its stem."""

    right = ('ball_machine_offset',)
    variables = said('ball', 'ball machine', 'ball angle')
    ball: int
    offset_um: Vector

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.offset_um, moment.ball == self.ball)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(by.ball(), by.vector(by.size_um * np.sqrt(by.run.balls), axes=2))


@dataclass(frozen=True)
class BallCreep(Cause):
    """One ball creeps on the plate from a moment on: fast first, then slower, 1 − exp(−(t − t0)/τ)."""

    right = ('ball_creep',)
    family = ('ball_slip',)
    variables = said('ball time')
    frame = 'plate'
    ball: int
    shift_um: Vector
    at_h: float
    constant_h: float

    def ball_shift(self, moment: Moment) -> Floats:
        since = np.maximum(moment.hours - self.at_h, 0.0)
        return along(self.shift_um, -np.expm1(-since / self.constant_h) * (moment.ball == self.ball))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        start = by.run.start_h + by.run.duration_h * by.between(0.0, 0.4)
        return cls(by.ball(), by.vector(by.size_um * np.sqrt(by.run.balls)), start,
                   by.run.duration_h * by.between(0.15, 0.5))


@dataclass(frozen=True)
class BallCreepLinear(BallCreep):
    """One ball creeps steadily on the plate, from that moment on."""

    def ball_shift(self, moment: Moment) -> Floats:
        since = np.maximum(moment.hours - self.at_h, 0.0)
        return along(self.shift_um, since / self.constant_h * (moment.ball == self.ball))


@dataclass(frozen=True)
class BallRattle(Cause):
    """One ball changes between two seats, again and again."""

    right = ('ball_rattle',)
    family = ('ball_slip', 'outlier')
    variables = said('ball time')
    frame = 'plate'
    ball: int
    shift_um: Vector
    changes_h: tuple[float, ...]

    def ball_shift(self, moment: Moment) -> Floats:
        seat = np.searchsorted(self.changes_h, moment.hours) % 2
        return along(self.shift_um, seat * (moment.ball == self.ball))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        times = by.run.start_h + by.run.duration_h * np.sort(by.rng.random(by.rng.integers(5, 10)))
        return cls(by.ball(), by.vector(by.size_um * np.sqrt(by.run.balls)), tuple(times.tolist()))


@dataclass(frozen=True)
class PlateProduct(Cause):
    """An oval table top bends the plate over its three supports: cos 2φ · cos 3β, along z."""

    right = ('plate_support',)
    variables = said('angle ball')
    frame = 'plate'
    direction: ClassVar[str] = 'z'
    size_um: float
    turn_phase: float
    ball_phase: float

    def course(self, moment: Moment) -> Floats:
        """Return the product at the readings, (N, 1), um."""
        return (self.size_um * np.cos(2 * moment.angle - self.turn_phase)
                * np.cos(3 * moment.azimuth - self.ball_phase))

    def ball_shift(self, moment: Moment) -> Floats:
        return along((0.0, 0.0, 1.0), self.course(moment))

    @classmethod
    def draw(cls, by: Draw) -> Self:
        return cls(2 * by.size_um, by.between(0, TWO_PI), by.between(0, TWO_PI))


@dataclass(frozen=True)
class PlateProductRadial(PlateProduct):
    """The same shape, radially on the plate."""

    def ball_shift(self, moment: Moment) -> Floats:
        out = np.stack([np.cos(moment.azimuth), np.sin(moment.azimuth), np.zeros_like(moment.azimuth)], axis=-1)
        return UM * self.course(moment)[..., None] * out
