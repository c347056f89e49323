# SPDX-License-Identifier: Apache-2.0
"""The simulated machine moved by hand: its table turned to any angle, its balls touched one by one, at given times.

The physics are those of Machine: what it would have touched in a reading is touched here in single commands, as the
controller of a CMM does it. Touches of one ball are one reading: they share its positioning noise, and the numbers of
its noise are those of that reading of a Machine.
"""

from typing import NamedTuple

import numpy as np

from rosette_ros.core.run.axes import nearest_axis
from rosette_ros.core.run.geometry import TWO_PI, nominal_angles, rotate_z
from rosette_ros.core.run.records import Floats, Ints
from rosette_ros.simulation.machine import Machine
from rosette_ros.simulation.motion import Moment
from rosette_ros.simulation.random_streams import standard_normal


class SingleTouch(NamedTuple):
    """One touch: the ball, one-based; what the CMM shows of the tip's centre, (3,), machine frame, m."""

    ball: int
    tip: Floats


class TouchByTouch:
    """A Machine whose table and probe somebody else moves; travel: unwrapped angle of the table by its encoder, rad."""

    def __init__(self, machine: Machine) -> None:
        self.machine, self.pattern = machine, machine.pattern.towards(machine.rough_frame.rotation[:, 2])
        self.travel = self._turned = 0.0
        self._approach, self._cmm_sense = 0, np.zeros((1, 1, 3), dtype=np.int64)
        self._place: Floats = machine.state.cmm
        self._reading, self._ball, self._touches, self._began, self._last = -1, 0, 0, 0.0, 0.0
        self._every = np.arange(1, machine.n + 1)
        self._seen: Floats | None = None

    @property
    def reach(self) -> float:
        """Distance of the tip's centre from that of a ball that it touches, m."""
        return self.pattern.radius + self.pattern.tip

    def turn(self, travel: float, time: float) -> None:
        """Turn the table to an unwrapped angle, rad, from `time` on, s; it stops off by its positioning error."""
        way = travel - self.travel
        if abs(way) > 1e-9:
            draws = self._draws(self._reading + 1)
            self.travel = travel + 1e-6 * self.machine.config.table.positioning_urad * float(draws[0, -5])
            self._turned += abs(way)
            self._approach = 1 if way > 0 else -1
        self._ball, self._last, self._seen = 0, time, None

    def centres(self, time: float, travel: Floats | None = None) -> Floats:
        """Return the true centres of all balls at a time, (n, 3), or (S, n, 3) at angles of the table (S,), rad; m."""
        self._seen = self.machine.ball_centres(self._moment(time, self._every))[:, 0]
        if travel is None:
            return self._seen
        frame = self.machine.true_frame
        return frame.to_outer(rotate_z((travel - self.travel)[:, None], frame.to_inner(self._seen)))

    def seen_centres(self, time: float) -> Floats:
        """Return where the balls were when it was last asked for, (n, 3), m, or are now if the table has turned."""
        return self.centres(time) if self._seen is None else self._seen

    def touch(self, aim: Floats, direction: Floats, time: float, start: float = np.inf) -> SingleTouch | None:
        """Touch the first ball on the way inwards along aim + s u from s = start on; None where there is none.

        aim: (3,), machine frame, m; direction: u, (3,), unit vector; time: s since power-on, not before the last one.
        """
        off = self.centres(time) - aim
        along = off @ direction
        depth = self.reach**2 - np.vecdot(off, off) + along**2
        contact = along + np.sqrt(np.maximum(depth, 0.0))
        met = (depth > 0) & (contact <= start)
        if not met.any():
            return None
        ball = int(np.argmax(np.where(met, contact, -np.inf))) + 1
        if ball != self._ball or self._touches == self.pattern.size:
            self._begin(ball, aim + off[ball - 1])
        self._last = time
        number, self._touches = self._touches, self._touches + 1
        moment = self._moment(time, np.array([ball]), self.pattern.size)
        draws = self._draws(self._reading)
        # Of a whole reading all touches of which are made like this one, this one is taken.
        lines = np.broadcast_to(direction, (self.pattern.size, 3))
        tip = self.machine.touched(moment, self.machine.ball_centres(moment), aim[None, None, :], lines,
                                   draws[:, :self.pattern.size], self.pattern)[0, number]
        return SingleTouch(ball, tip + self.machine.positioning(moment, draws[:, -3:], self.pattern)[0])

    def temperature(self, time: float) -> float:
        """Return what the thermometer at the plate shows, degree Celsius."""
        climate, noise = self.machine.climate, self._draws(max(self._reading, 0))[0, -4]
        return float(climate.start + climate.warming(np.array(time)) + self.machine.config.climate.sensor_K * noise)

    def _draws(self, reading: int) -> Floats:
        return standard_normal(self.machine.config.seed, [reading], self.pattern.size + 6)

    def _begin(self, ball: int, place: Floats) -> None:
        """Begin a reading of a ball: the sense of the CMM's axes is that of the way to it from the one before."""
        way = place - self._place
        far = np.abs(way) > 1e-3 * self.machine.config.cmm.reversal_deadband_mm
        far[nearest_axis(self.machine.rough_frame.rotation[:, 2])] = False
        self._cmm_sense = np.where(far, np.sign(way).astype(np.int64), self._cmm_sense)
        self._place, self._ball, self._touches = place, ball, 0
        self._reading, self._began = self._reading + 1, self._last

    def _moment(self, time: float, ball: Ints, touches: int = 1) -> Moment:
        n, balls, whole = self.machine.n, ball.size, np.full((ball.size, touches), time)
        return Moment(
            time=whole, began=np.full((balls, 1), self._began), ended=np.full((balls, 1), np.nextafter(time, np.inf)),
            warming=self.machine.climate.warming(whole),
            table_position=np.full((balls, 1), round(self.travel * n / TWO_PI) % n + 1), ball=ball[:, None],
            azimuth=nominal_angles(n)[ball[:, None] - 1], angle=np.full((balls, 1), self.travel),
            travel=np.full((balls, 1), self.travel), turned=np.full((balls, 1), self._turned),
            approach=np.full((balls, 1), self._approach), cmm_sense=np.broadcast_to(self._cmm_sense, (balls, 1, 3)),
            gravity=-self.machine.true_frame.rotation[2])
