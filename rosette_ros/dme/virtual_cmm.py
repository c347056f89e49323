# SPDX-License-Identifier: Apache-2.0
"""The controller of the simulated machine: positions, finite speeds, limits, collisions, the table, single touches.

Metres and radians, machine frame. Where a ball is and what a touch shows is asked of simulation/touch_by_touch.py.
"""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.records import Floats
from rosette_ros.dme.serve_errors import Refused
from rosette_ros.dme.serve_settings import DmeFaults, ServeSettings
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.touch_by_touch import SingleTouch, TouchByTouch

STEM = 0.35
"""Radius of the stem of a ball, in radii of the ball."""
HEIGHT = 4.0
"""Height of the balls' centres over the plate, in radii of a ball."""
RIM = 0.03
"""By which the plate is larger than the circle of its balls, m."""
STEP = 1e-3
"""A move is looked at in steps of this length, m."""
TOGETHER = 1000
"""So many steps are looked at together: a long move takes no more memory than a short one."""
START = 0.2
"""Where the probe stands at first: over the middle of the plate, m."""
GRAZE = 3e-5
"""What comes closer to a body by less is no collision, m: errors of the CMM, noise, steps."""


class MachineClock:
    """The machine's time, s since power-on; factor: faster than real time by this, None: only its moves take time."""

    def __init__(self, factor: float | None) -> None:
        self._factor, self._start, self._spent = factor, time.monotonic(), 0.0

    def now(self) -> float:
        """Return the machine's time, s."""
        return self._spent if self._factor is None else (time.monotonic() - self._start) * self._factor

    async def spend(self, seconds: float) -> None:
        """Let so many seconds of the machine go by."""
        if self._factor is None:
            self._spent += seconds
        await asyncio.sleep(0.0 if self._factor is None else seconds / self._factor)


class MovePace(NamedTuple):
    """Speed, m/s, and acceleration, m/s^2, of a move."""

    speed: float
    accel: float

    def seconds(self, way: float) -> float:
        """Return how long a move of a length takes from rest to rest, s: t = s/v + v/a, 2 sqrt(s/a) for short ones."""
        if way * self.accel < self.speed**2:
            return float(2.0 * np.sqrt(way / self.accel))
        return way / self.speed + self.speed / self.accel


class TouchParameters(NamedTuple):
    """How a point is measured: pace of the search, approach, search and retract, m; retract < 0: to the approach."""

    pace: MovePace
    approach: float
    search: float
    retract: float


@dataclass
class _Motion:
    """A move that is under way: places of the probe and travel of the table before and after; times, s."""

    before: Floats
    after: Floats
    travel: tuple[float, float]
    began: float
    probe_s: float
    table_s: float

    def at(self, time: float) -> tuple[Floats, float]:
        """Return place of the probe and travel of the table at a time."""
        probe, table = (min(max((time - self.began) / max(span, 1e-9), 0.0), 1.0)
                        for span in (self.probe_s, self.table_s))
        return (self.before + probe * (self.after - self.before),
                self.travel[0] + table * (self.travel[1] - self.travel[0]))


class VirtualCmm:
    """A machine that can be moved; moved: number of moves that it has made."""

    def __init__(self, config: MachineConfig, settings: ServeSettings, faults: DmeFaults) -> None:
        self.machine = Machine(config)
        self.cell = TouchByTouch(self.machine)
        self.clock = MachineClock(settings.speed)
        self.faults, self.is_homed, self.moved, self.is_stopped = faults, not faults.has('not_homed'), 0, False
        middle, half = self.machine.rough_frame.origin, 0.5e-3 * config.cmm.volume_mm
        self.limits = middle - half, middle + half
        self.home_place = np.array([self.limits[0][0], self.limits[0][1], self.limits[1][2]])
        self.parked = middle + START * self.machine.rough_frame.rotation[:, 2]
        self._under_way: _Motion | None = None
        self._turns = -1.0 if faults.has('turns_other_way') else 1.0
        self._timing = config.timing

    @property
    def place(self) -> Floats:
        """Where the centre of the tip is, (3,), m."""
        return self.parked if self._under_way is None else self._under_way.at(self.clock.now())[0]

    @property
    def angle(self) -> float:
        """Unwrapped angle that the table's encoder shows, counter-clockwise about its axis as it claims, rad."""
        return self._turns * (self.cell.travel if self._under_way is None else self._under_way.at(self.clock.now())[1])

    async def home(self) -> None:
        """Move to the home position, the upper front corner, whatever is in the way."""
        await self._go(self.home_place, self.cell.travel, MovePace(0.1, 0.5), check=False)
        self.is_homed = True

    async def go_to(self, place: Floats, angle: float | None, pace: MovePace, what: str) -> None:
        """Move the probe to a place and the table to an unwrapped angle, rad; raises Refused."""
        self._may_move(what)
        self._inside(place, 1008, what)
        number = 2500 if self.faults.strike('out_of_limits') else 2504 if self.faults.strike('collision') else 0
        if number:
            await self._go(0.5 * (self.place + place), self.cell.travel, pace)
            raise Refused(number, what)
        await self._go(place, self.cell.travel if angle is None else self._turns * angle, pace, what=what)

    async def measure(self, nominal: Floats, outwards: Floats, pace: MovePace, probing: TouchParameters,
                      on_contact: Callable[[SingleTouch], None]) -> None:
        """Measure a point of a surface; outwards: unit vector (3,) out of the material; on_contact: called before the
        retract. Raises Refused."""
        what = 'PtMeas'
        self._may_move(what)
        if self.faults.has('not_qualified'):
            raise Refused(2000, what)
        start = probing.approach + self.cell.pattern.tip
        near = nominal + start * outwards
        self._inside(near, 2500, what)
        await self._go(near, self.cell.travel, pace, what=what)
        # Approach and search are made before the contact is known: it is that of the time when the search began.
        touch = self.cell.touch(nominal, outwards, self.clock.now(), start)
        depth = -np.inf if touch is None else float((touch.tip - nominal) @ outwards)
        missed = not -probing.search <= depth <= start
        if touch is None or missed or self.faults.strike('surface_not_found', touch.ball):
            await self._go(nominal - probing.search * outwards, self.cell.travel, probing.pace,
                           check=touch is None or missed, what=what)
            await self._go(near, self.cell.travel, pace, check=False)
            raise Refused(1006, what)
        await self._go(touch.tip, self.cell.travel, probing.pace, what=what)
        on_contact(touch)
        away = near if probing.retract < 0 else touch.tip + probing.retract * outwards
        await self._go(away, self.cell.travel, pace, what=what)

    def stop(self) -> None:
        """Stop where it is."""
        if self._under_way is not None:
            self._arrive(*self._under_way.at(self.clock.now()))

    def temperature(self) -> float:
        """Return what the thermometer at the plate shows, degree Celsius; -273 where it is defect."""
        return -273.0 if self.faults.has('no_sensor') else self.cell.temperature(self.clock.now())

    def _may_move(self, what: str) -> None:
        if self.faults.strike('emergency_stop'):
            self.is_stopped = True
        if self.is_stopped:
            raise Refused(500, 'HealthCheck')
        if not self.is_homed:
            raise Refused(1005, what)

    def _inside(self, place: Floats, number: int, what: str) -> None:
        if not ((self.limits[0] - 1e-9 <= place) & (place <= self.limits[1] + 1e-9)).all():
            raise Refused(number, what)

    async def _go(self, place: Floats, travel: float, pace: MovePace, check: bool = True, what: str = '') -> None:
        """Make a straight move; raises Refused where it hits something, and stops there."""
        before, turn = self.parked, abs(travel - self.cell.travel)
        way = float(np.linalg.norm(place - before))
        if way == 0.0 and turn == 0.0:
            return
        table_s = np.rad2deg(turn) / self._timing.table_speed_deg_per_s
        move = _Motion(before, place, (self.cell.travel, travel), self.clock.now(), pace.seconds(way), table_s)
        hit = self._hit(move) if check else None
        whole = max(move.probe_s, table_s)
        self._under_way, self.moved = move, self.moved + 1
        try:
            settled = self._timing.table_settle_s if turn and hit is None else 0.0
            await self.clock.spend(whole + settled if hit is None else hit * whole)
            self._arrive(*move.at(move.began + (whole if hit is None else hit * whole)))
        finally:
            self.stop()
        if hit is not None:
            raise Refused(2504, what)

    def _arrive(self, place: Floats, travel: float) -> None:
        self._under_way, self.parked = None, place
        if travel != self.cell.travel:
            self.cell.turn(travel, self.clock.now())

    def _hit(self, move: _Motion) -> float | None:
        """Return the part of its time until a move is about to hit a ball, a stem or the plate; None: it does not."""
        frame, config = self.machine.true_frame, self.machine.config.plate
        radius, tip, axis = 1e-3 * config.ball_radius_mm, self.cell.pattern.tip, frame.rotation[:, 2]
        ends = frame.to_inner(np.array([move.before, move.after]))
        if (ends[:, 2] > 2 * self.cell.reach).all():
            return None
        turn = move.travel[1] - move.travel[0]
        way = max(float(np.linalg.norm(ends[1] - ends[0])), abs(turn) * self.machine.radius)
        share = np.linspace(0.0, 1.0, int(way / STEP) + 2)
        whole = max(move.probe_s, move.table_s)
        now = self.clock.now()
        for first in range(0, share.size, TOGETHER):
            time = share[first:first + TOGETHER] * whole
            probe = np.minimum(time / max(move.probe_s, 1e-9), 1.0)[:, None]
            table = np.minimum(time / max(move.table_s, 1e-9), 1.0)
            point = move.before + probe * (move.after - move.before)
            centre = self.cell.centres(now, move.travel[0] + table * turn) if turn else self.cell.seen_centres(now)
            off = point[:, None, :] - centre
            down = np.clip(-(off @ axis), 0.0, HEIGHT * radius)
            stem = np.sqrt(np.square(off + down[..., None] * axis).sum(-1))
            inside = frame.to_inner(point)
            hits = ((np.sqrt(np.vecdot(off, off)) < radius + tip - GRAZE).any(axis=-1)
                    | (stem < STEM * radius + tip - GRAZE).any(axis=-1)
                    | ((inside[:, 2] < tip - HEIGHT * radius) & (np.hypot(inside[:, 0], inside[:, 1])
                                                                 < self.machine.radius + RIM + tip)))
            if hits.any():
                return float(share[max(first + int(np.argmax(hits)) - 1, 0)])
        return None


def short_way(angle: float, now: float) -> float:
    """Return the unwrapped angle that is reached from `now` to `angle` by at most half a turn, rad."""
    way = (angle - now) % TWO_PI
    return now + (way if way <= np.pi + 1e-12 else way - TWO_PI)


def client_settings(config: MachineConfig, settings: ServeSettings, port: int) -> dict[str, object]:
    """Return the settings file of a client (rosette-dme/1) that fits a machine and its server, as a mapping."""
    place, plate, tip = config.placement, config.plate, config.probing.tip_radius_mm
    half = plate.circle_radius_mm + 100.0
    low, high = ([value + sign * half for value in place.origin_mm] for sign in (-1.0, 1.0))
    return {
        'schema': 'rosette-dme/1', 'simulated': True, 'server': {'host': '127.0.0.1', 'port': port},
        'tool': {'name': settings.tool, 'tip_radius_mm': tip},
        'ball': {'radius_mm': plate.ball_radius_mm, 'shaft_radius_mm': STEM * plate.ball_radius_mm,
                 'shaft_length_mm': HEIGHT * plate.ball_radius_mm, 'below_pole_mm': config.probing.below_pole_mm,
                 'below_equator_mm': config.probing.below_equator_mm},
        'path': {'box_low_mm': low, 'box_high_mm': high,
                 'clearance_mm': max(60.0, plate.ball_radius_mm + tip + 30.0)},
        'table': {'origin_mm': list(place.origin_mm), 'axis': list(place.axis), 'azimuth_deg': place.azimuth_deg,
                  'radius_mm': plate.circle_radius_mm, 'balls': plate.balls, 'sign': settings.sign,
                  'reading': 'cumulative' if settings.cumulative else 'modulo'}}
