# SPDX-License-Identifier: Apache-2.0
"""Causes of real machines that the library of effects does not have, held out for the final judgement."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmarks.blind.cause import CLIMATE, DRIFTS, Cause, Vector, place, said, since, total_turned, turned_share
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.records import Floats, Ints, Run
from rosette_ros.simulation.hidden_effect import UM, Draw, along
from rosette_ros.simulation.motion import Moment


def since_move(moment: Moment) -> Floats:
    """Return the time since the table last came to rest, (N, Q), s."""
    way = np.diff(moment.turned[:, 0], prepend=moment.turned[0, 0])
    return np.maximum(moment.time - moment.time[_moved(way), :1], 0.0)


def _moved(way: Floats) -> Ints:
    """Return the place of the last reading to which the table moved, or the first, (N,); way: (N,) by how much, rad."""
    return np.maximum.accumulate(np.where(way > 1e-6, np.arange(way.size), np.argmax(way > 1e-6)))


@dataclass(frozen=True)
class LogCreep(Cause):
    """The polymer concrete of the bed creeps under the table: d ln(1 + t/τ), τ far shorter than the run."""

    family = DRIFTS
    variables = said('time')
    body = ('frame',)
    shift_um: Vector
    start_h: float
    constant_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, np.log1p(since(moment, self.start_h) / self.constant_h))

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.vector(by.size_um), by.run.start_h, by.run.duration_h * by.between(0.005, 0.05))


@dataclass(frozen=True)
class LevellingWedge(Cause):
    """A levelling wedge gives way again and again in one direction: a staircase in time of uneven steps."""

    part = ('frame_step',)
    family = ('frame_pulse', *DRIFTS)
    variables = said('time')
    body = ('frame',)
    shift_um: Vector
    at_h: tuple[float, ...]
    sizes: tuple[float, ...]

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, sum(size * (moment.hours >= hour) for hour, size in zip(self.at_h, self.sizes)))

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        count = int(by.rng.integers(3, 7))
        hours = by.run.start_h + by.run.duration_h * np.sort(by.rng.uniform(0.08, 0.95, count))
        return cls(by.vector(by.size_um), tuple(hours.tolist()), tuple(by.rng.uniform(0.4, 1.6, count).tolist()))


@dataclass(frozen=True)
class DoorHeat(Cause):
    """A wave of warm air soaks into the column and out again: (s/τ) exp(1 − s/τ), s the time since the door opened."""

    family = ('frame_pulse', 'frame_recovery', *DRIFTS)
    variables = said('time')
    body = ('frame',)
    shift_um: Vector
    at_h: float
    constant_h: float

    def frame_shift(self, moment: Moment) -> Floats:
        ratio = since(moment, self.at_h) / self.constant_h
        return along(self.shift_um, ratio * np.exp(1 - ratio))

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        start = by.run.start_h + by.run.duration_h * by.between(0.05, 0.6)
        return cls(by.vector(by.size_um), start, by.run.duration_h * by.between(0.05, 0.15))


@dataclass(frozen=True)
class AirSprings(Cause):
    """The levelling of the air springs overshoots after a knock: the axis swings, exp(−s/τ) cos(2π s/P)."""

    family = ('axis_tilt_step', 'axis_tilt_warmup')
    variables = said('time', 'time + CMM position')
    body = ('table axis tilting',)
    tilt_urad: Vector
    at_h: float
    period_h: float
    decay: float

    def axis_tilt(self, moment: Moment) -> Floats:
        cycles = since(moment, self.at_h) / self.period_h
        swing = np.exp(-cycles / self.decay) * np.cos(TWO_PI * cycles)
        return along(self.tilt_urad, (moment.hours >= self.at_h) * swing)

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        start = by.run.start_h + by.run.duration_h * by.between(0.1, 0.6)
        return cls(by.vector(by.angle_urad, axes=2), start, by.run.duration_h * by.between(0.08, 0.2),
                   by.between(0.8, 2.5))


@dataclass(frozen=True)
class StickingJoint(Cause):
    """A bolted joint slides only when the expansion overcomes its friction: the frame follows T with a play of ± w."""

    groups = CLIMATE
    family = ('frame_cycle', *DRIFTS)
    variables = said('temperature', 'time')
    body = ('frame',)
    coefficient_um_per_K: Vector
    play_K: float

    def frame_shift(self, moment: Moment) -> Floats:
        warming = moment.warming.mean(axis=1)
        held = warming.copy()
        for at in range(1, held.size):
            held[at] = np.clip(held[at - 1], warming[at] - self.play_K, warming[at] + self.play_K)
        return along(self.coefficient_um_per_K, held[:, None])

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.vector(10 * by.size_um), float(np.ptp(clean.temperature)) * by.between(0.15, 0.3))


@dataclass(frozen=True)
class OilFilm(Cause):
    """The platter floats up on its oil film as it turns and sinks while it rests: −a ln(1 + s/τ) along z."""

    variables = said('time since move')
    body = ('frame', 'plate')
    sink_um: float
    constant_s: float

    def table_shift(self, moment: Moment) -> Floats:
        return along((0.0, 0.0, -self.sink_um), np.log1p(since_move(moment) / self.constant_s))

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.size_um, by.between(10, 60))


@dataclass(frozen=True)
class RingWarms(Cause):
    """The encoder's ring moves off its centre as it warms: γ cos(φ − φ0) (T − T0) about the axis."""

    groups = CLIMATE
    variables = said('temperature + table angle', 'time + table angle')
    body = ('table or plate turning',)
    coefficient_urad_per_K: float
    phase: float

    def table_turn(self, moment: Moment) -> Floats:
        return UM * self.coefficient_urad_per_K * np.cos(moment.angle - self.phase) * moment.warming

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(10 * by.angle_urad, by.between(0, TWO_PI))


@dataclass(frozen=True)
class WormWears(Cause):
    """A worm loses its preload: the table's backlash grows from nothing in the run, ½ b s · share of the travel."""

    part = ('table_backlash',)
    turning = 'alternate'
    variables = said('table sense + time', 'table sense + travel')
    body = ('table or plate turning',)
    width_urad: float
    total: float

    def table_turn(self, moment: Moment) -> Floats:
        return 0.5 * UM * self.width_urad * moment.approach * turned_share(moment, self.total)

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.sign() * by.angle_urad, total_turned(clean))


@dataclass(frozen=True)
class LostCounts(Cause):
    """A scratch on the scale costs the counter some counts, more or fewer, whenever it passes: the zero walks."""

    part = ('table_zero_step',)
    family = ('table_zero_drift', 'table_zero_warmup')
    variables = said('travel', 'travel + CMM position', 'time', 'time + CMM position')
    body = ('table or plate turning',)
    scratch: float
    jumps_urad: tuple[float, ...]

    def table_turn(self, moment: Moment) -> Floats:
        passes = np.floor((moment.travel - self.scratch) / TWO_PI).astype(int)
        return UM * np.cumsum(self.jumps_urad)[passes % len(self.jumps_urad)]

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        turns = int(np.ptp(clean.table_travel) / TWO_PI) + 3
        return cls(float(clean.table_travel.min()) + by.between(0, TWO_PI),
                   tuple((by.angle_urad * by.rng.standard_normal(turns)).tolist()))


@dataclass(frozen=True)
class SoftStem(Cause):
    """One ball's stem is cracked: the ball stays leaning to where the stylus last pushed it, by axis of the CMM."""

    variables = said('ball + cmm sense', 'ball + cmm direction')
    body = ('frame',)
    ball: int
    lean_um: Vector

    def probe_shift(self, moment: Moment) -> Floats:
        return along(self.lean_um, moment.ball == self.ball) * moment.cmm_sense

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.ball(), by.vector(3 * by.size_um, axes=2))


@dataclass(frozen=True)
class PlateBimetal(Cause):
    """A coated plate bends like a saddle with the temperature: z cos 2(β − β0) (T − T0)."""

    groups = CLIMATE
    family = ('plate_warp',)
    variables = said('ball + temperature', 'ball + time')
    body = ('plate', 'frame')
    coefficient_um_per_K: float
    phase: float

    def ball_shift(self, moment: Moment) -> Floats:
        bend = np.cos(2 * (moment.azimuth - self.phase)) * moment.warming
        return along((0.0, 0.0, self.coefficient_um_per_K), bend)

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(10 * by.size_um, by.between(0, TWO_PI))


@dataclass(frozen=True)
class ChipOnGuide(Cause):
    """From one moment on a chip lies on the guideway, where the CMM measures one of its positions."""

    variables = said('CMM position + time')
    body = ('frame',)
    position: int
    shift_um: Vector
    at_h: float
    n: int

    def probe_shift(self, moment: Moment) -> Floats:
        here = (moment.table_position + moment.ball - 2) % self.n + 1 == self.position
        return along(self.shift_um, here & (moment.hours >= self.at_h))

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.ball(), by.vector(3 * by.size_um), by.time(), by.run.balls)


@dataclass(frozen=True)
class PortalBreathes(Cause):
    """The portal leans over and back with the air conditioning: x grows with y sin(2π t/P), about a far point."""

    part = ('frame_cycle',)
    variables = said('time + CMM position')
    body = ('scales and squareness of the CMM',)
    lean_urad: float
    period_h: float
    fixed_m: float
    radius: float

    def probe_shift(self, moment: Moment) -> Floats:
        way = place(moment, self.radius)[..., 1] - self.fixed_m
        return along((self.lean_urad, 0.0, 0.0), way * np.sin(TWO_PI * moment.hours / self.period_h))

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.angle_urad, by.run.duration_h / by.between(2, 6), by.run.radius * by.between(-1, 1),
                   by.run.radius)


@dataclass(frozen=True)
class BeltLoosens(Cause):
    """The belts of the CMM loosen as it works: its reversal errors grow from nothing, ½ r s · share of the run."""

    part = ('cmm_reversal',)
    variables = said('cmm sense + time', 'cmm sense + touches')
    body = ('frame',)
    value_um: Vector
    start_h: float
    duration_h: float

    def probe_shift(self, moment: Moment) -> Floats:
        done = since(moment, self.start_h) / self.duration_h
        return along(self.value_um, 0.5 * done) * moment.cmm_sense

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.vector(by.size_um, axes=2), by.run.start_h, by.run.duration_h)


@dataclass(frozen=True)
class QuillSwings(Cause):
    """The quill still swings after a long way: the centre is off along one direction by the distance of the move."""

    variables = said('cmm distance')
    body = ('frame',)
    shift_um: Vector

    def probe_shift(self, moment: Moment) -> Floats:
        at = place(moment, 1.0)[:, 0]
        way = np.linalg.norm(np.diff(at, axis=0, prepend=at[:1]), axis=1)
        last = np.maximum.accumulate(np.where(way > 1e-3, np.arange(way.size), np.argmax(way > 1e-3)))
        return along(self.shift_um, way[last][:, None])

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        return cls(by.vector(by.size_um))


@dataclass(frozen=True)
class AirPressure(Cause):
    """The interferometers' compensation of air pressure is renewed now and then only: the scale of x and y jumps."""

    family = ('plate_expansion', 'plate_soaking', 'cmm_scale_drift', 'cmm_scale_temperature', 'cmm_scale_lag')
    variables = said('time + CMM position', 'time')
    body = ('scales and squareness of the CMM', 'plate growing')
    jumps_ppm: tuple[float, ...]
    at_h: tuple[float, ...]
    radius: float

    def probe_shift(self, moment: Moment) -> Floats:
        scale = (moment.hours[..., None] >= self.at_h) @ np.array(self.jumps_ppm)
        way = np.concatenate([place(moment, self.radius), np.zeros_like(moment.azimuth)[..., None]], axis=-1)
        return UM * scale[..., None] * way

    @classmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        count = int(by.rng.integers(2, 5))
        hours = by.run.start_h + by.run.duration_h * np.sort(by.rng.uniform(0.1, 0.9, count))
        jumps = by.angle_urad * by.rng.standard_normal(count)
        return cls(tuple(jumps.tolist()), tuple(hours.tolist()), by.run.radius)


CAUSES: dict[str, type[Cause]] = {
    'log_creep': LogCreep,
    'levelling_wedge': LevellingWedge,
    'door_heat': DoorHeat,
    'air_springs': AirSprings,
    'sticking_joint': StickingJoint,
    'oil_film': OilFilm,
    'ring_warms': RingWarms,
    'worm_wears': WormWears,
    'lost_counts': LostCounts,
    'soft_stem': SoftStem,
    'plate_bimetal': PlateBimetal,
    'chip_on_guide': ChipOnGuide,
    'portal_breathes': PortalBreathes,
    'belt_loosens': BeltLoosens,
    'quill_swings': QuillSwings,
    'air_pressure': AirPressure,
}
