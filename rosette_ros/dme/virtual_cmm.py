# SPDX-License-Identifier: Apache-2.0
"""The controller of the simulated machine: positions, finite speeds, limits, balls in the way, table, touches.

Metres and radians, machine frame. Where a ball is and what a touch shows is asked of simulation/touch_by_touch.py."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.run.records import Floats
from rosette_ros.dme.wire import DmeError
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.touch_by_touch import SingleTouch, TouchByTouch

LIMITS = {'GoToPar.Speed': (1.0, 500.0), 'GoToPar.Accel': (10.0, 3000.0), 'PtMeasPar.Speed': (0.1, 20.0),
          'PtMeasPar.Accel': (10.0, 1000.0), 'PtMeasPar.Approach': (0.5, 20.0), 'PtMeasPar.Search': (0.5, 20.0),
          'PtMeasPar.Retract': (-1.0, 20.0)}
"""Least and most of each parameter of the tool, mm, mm/s, mm/s^2; Retract < 0: back to the approach."""
ERRORS = {
    6: (2, 'Transaction aborted (Use ClearAllErrors To Continue)'), 8: (3, 'Protocol error'),
    501: (3, 'Unsupported command'), 502: (3, 'Incorrect arguments'), 504: (1, 'Argument out of range'),
    505: (3, 'Argument not recognized'), 509: (3, 'Bad argument'), 510: (3, 'Bad property'),
    511: (3, 'Error processing method'), 514: (2, 'Use ClearAllErrors to continue'), 1005: (3, 'Error during home'),
    1006: (2, 'Surface not found'), 1008: (3, 'Target position out of machine volume'),
    1010: (2, 'Vector has no norm'), 1502: (3, 'Tool not found'), 2504: (3, 'Collision'), 2505: (2, 'Bad angle')}
"""Number: (severity, words). Source: I++ DME 1.4.3, section 8."""
STEP, START = 1e-3, 0.2  # steps in which a move is looked at; where the tip stands over the plate at first, m
GRAZE = 3e-5  # what comes closer to a ball by less is no collision: errors of the CMM, noise, steps; m


class Refused(Exception):  # noqa: N818
    """A command that the server refuses or cannot finish, with the error that it answers."""

    def __init__(self, number: int, method: str) -> None:
        severity, words = ERRORS[number]
        self.error = DmeError(severity, number, method, words)
        super().__init__(str(self.error))


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


@dataclass
class _Motion:
    """A move that is under way: places of the tip and travel of the table before and after; times, s."""

    before: Floats
    after: Floats
    travel: tuple[float, float]
    began: float
    tip_s: float
    table_s: float

    def at(self, time: Floats) -> tuple[Floats, Floats]:
        """Return places of the tip (..., 3) and travel of the table (...) at times."""
        tip, table = (np.clip((time - self.began) / max(span, 1e-9), 0.0, 1.0) for span in (self.tip_s, self.table_s))
        return (self.before + tip[..., None] * (self.after - self.before),
                self.travel[0] + table * (self.travel[1] - self.travel[0]))


class VirtualCmm:
    """A machine that can be moved; parameters: of the tool, by LIMITS; moved: number of moves that it has made."""

    def __init__(self, config: MachineConfig, speed: float | None = None) -> None:
        self.machine, self.clock = Machine(config), MachineClock(speed)
        self.cell = TouchByTouch(self.machine)
        self.usual = dict(zip(LIMITS, (config.timing.cmm_speed_mm_per_s, 1500.0, 5.0, 100.0, 3.0, 5.0, 3.0)))
        self.parameters, self.is_homed, self.moved = dict(self.usual), True, 0
        middle, half = self.machine.rough_frame.origin, 0.5e-3 * config.cmm.volume_mm
        self.limits = middle - half, middle + half
        self.parked = middle + START * self.machine.rough_frame.rotation[:, 2]
        self._under_way: _Motion | None = None
        self._timing = config.timing

    @property
    def place(self) -> Floats:
        """Where the centre of the tip is, (3,), m."""
        return self.now()[0]

    def now(self) -> tuple[Floats, float]:
        """Return the place of the tip, m, and the unwrapped angle of the table by its encoder, rad."""
        if self._under_way is None:
            return self.parked, self.cell.travel
        place, travel = self._under_way.at(np.array(self.clock.now()))
        return place, float(travel)

    async def go_to(self, place: Floats, angle: float | None, what: str) -> None:
        """Move the tip to a place and the table to an unwrapped angle, rad; raises Refused."""
        self._may_move(place, what)
        await self._go(place, what, travel=angle)

    async def measure(self, nominal: Floats, outwards: Floats, on_contact: Callable[[SingleTouch], None]) -> None:
        """Measure a point of a surface; outwards: unit vector (3,) out of the material; on_contact: called before the
        retract. Raises Refused."""
        what = 'PtMeas'
        approach, search, retract = (1e-3 * self.parameters[f'PtMeasPar.{name}']
                                     for name in ('Approach', 'Search', 'Retract'))
        start = approach + self.cell.pattern.tip
        near = nominal + start * outwards
        self._may_move(near, what)
        await self._go(near, what)
        # Approach and search are made before the contact is known: it is that of the time when the search began.
        touch = self.cell.touch(nominal, outwards, self.clock.now(), start)
        if touch is None or not -search <= (touch.tip - nominal) @ outwards <= start:
            await self._go(nominal - search * outwards, what, 'PtMeasPar')
            await self._go(near, what)
            raise Refused(1006, what)
        await self._go(touch.tip, what, 'PtMeasPar')
        on_contact(touch)
        await self._go(near if retract < 0 else touch.tip + retract * outwards, what)

    def stop(self) -> None:
        """Stop where it is."""
        if self._under_way is not None:
            self._arrive(*self.now())

    def _may_move(self, place: Floats, what: str) -> None:
        if not self.is_homed:
            raise Refused(1005, what)
        if not ((self.limits[0] - 1e-9 <= place) & (place <= self.limits[1] + 1e-9)).all():
            raise Refused(1008, what)

    async def _go(self, place: Floats, what: str, block: str = 'GoToPar', travel: float | None = None) -> None:
        """Make a straight move; raises Refused where it hits a ball, and stops there."""
        travel = self.cell.travel if travel is None else travel
        way, turn = float(np.linalg.norm(place - self.parked)), abs(travel - self.cell.travel)
        if way == turn == 0.0:
            return
        speed, accel = (1e-3 * self.parameters[f'{block}.{name}'] for name in ('Speed', 'Accel'))
        seconds = 2.0 * np.sqrt(way / accel) if way * accel < speed**2 else way / speed + speed / accel
        move = _Motion(self.parked, place, (self.cell.travel, travel), self.clock.now(), float(seconds),
                       float(np.rad2deg(turn)) / self._timing.table_speed_deg_per_s)
        hit = self._hit(move)
        self._under_way, self.moved = move, self.moved + 1
        try:
            whole = max(move.tip_s, move.table_s) + (self._timing.table_settle_s if turn else 0.0)
            await self.clock.spend(whole if hit is None else hit)
            after, turned = move.at(np.array(move.began + (whole if hit is None else hit)))
            self._arrive(after, float(turned))
        finally:
            self.stop()
        if hit is not None:
            raise Refused(2504, what)

    def _arrive(self, place: Floats, travel: float) -> None:
        self._under_way, self.parked = None, place
        if travel != self.cell.travel:
            self.cell.turn(travel, self.clock.now())

    def _hit(self, move: _Motion) -> float | None:
        """Return after what time a move is about to hit a ball, s; None: it does not."""
        ends = self.machine.true_frame.to_inner(np.array([move.before, move.after]))
        if (ends[:, 2] > 2 * self.cell.reach).all():
            return None
        turn = move.travel[1] - move.travel[0]
        way = max(float(np.linalg.norm(ends[1] - ends[0])), abs(turn) * self.machine.radius)
        time = np.linspace(0.0, max(move.tip_s, move.table_s), int(way / STEP) + 2)
        point, travel = move.at(move.began + time)
        centre = self.cell.centres(move.began, travel) if turn else self.cell.seen_centres(move.began)
        hits = (np.linalg.norm(point[:, None, :] - centre, axis=-1) < self.cell.reach - GRAZE).any(axis=-1)
        return float(time[max(int(np.argmax(hits)) - 1, 0)]) if hits.any() else None
