# SPDX-License-Identifier: Apache-2.0
"""How table and CMM move from reading to reading, how long it takes, and what acts on the touches meanwhile."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rosette_ros.core.run.records import Bools, Floats, Ints
from rosette_ros.simulation.setting_types import NotNegative, Positive, Settings

_Number = TypeVar('_Number', bound=np.generic)


class TimingSettings(Settings):
    """Durations of the moves: a ball takes 20 to 60 s."""

    table_speed_deg_per_s: Positive = 10.0
    table_settle_s: NotNegative = 2.0
    cmm_speed_mm_per_s: Positive = 60.0
    cmm_settle_s: NotNegative = 1.0
    touch_s: Positive = 1.2
    jitter_s: NotNegative = Field(0.3, description='sd of the waiting before a ball')


@dataclass(frozen=True, eq=False)
class MachineState:
    """Where the machine stands after its last reading.

    time: s since power-on; steps: unwrapped table angle in table divisions; turned: divisions turned in any sense;
    approach: sense of the last table move, 0 before the first; stop: rad, by which the table stopped off its division;
    cmm: (3,) last aim, m; cmm_sense: (3,) sense of the last CMM moves, 0 before the first; readings: number made.
    """

    time: float
    steps: float
    turned: float
    approach: int
    stop: float
    cmm: Floats
    cmm_sense: Floats
    readings: int


@dataclass(frozen=True, eq=False)
class Moves:
    """The moves to N readings in order: what MachineState holds, after each, (N,), (N, 3); and the times, s.

    began: when the move began; arrived: when probing began; ended: when it was done.
    """

    steps: Floats
    turned: Floats
    approach: Ints
    stop: Floats
    cmm: Floats
    cmm_sense: Floats
    began: Floats
    arrived: Floats
    ended: Floats

    def last_state(self, state: MachineState) -> MachineState:
        """Return the state after all readings, which began at `state`."""
        return MachineState(float(self.ended[-1]), float(self.steps[-1]), float(self.turned[-1]),
                            int(self.approach[-1]), float(self.stop[-1]), self.cmm[-1], self.cmm_sense[-1],
                            state.readings + self.steps.size)


def moves(state: MachineState, timing: TimingSettings, n: int, division: Floats, approach: Ints, aim: Floats,
          wait: Floats, stop: Floats, touches: int, deadband: float, free: int) -> Moves:
    """Return the moves from `state` through N targets.

    division: (N,) where the table shall stand, in table divisions from angle 0; approach: (N,) sense in which it shall
    turn, 0 is taken as +1; where it stands there from the other sense, it comes again, from a division before; aim:
    (N, 3) m; wait: (N,) s before each ball; stop: (N,) rad by which the table would stop off, if it moves; touches: Q
    per ball; deadband: m; free: axis of the CMM, 0..2, along which it comes to every ball from the free side of the
    plate: no sense changes.
    """
    before = np.concatenate([[state.steps], division[:-1]])
    forward = np.round((division - before) % n, 12) % n
    move = np.where((approach < 0) & (forward > 0), forward - n, forward)
    has_turned = (np.cumsum(move != 0) > 0) | (state.approach != 0)
    wanted = np.where(move != 0, np.sign(move), np.sign(approach) * has_turned)
    last = np.maximum.accumulate(np.where(wanted != 0, np.arange(move.size), -1))
    sense = np.concatenate([[state.approach], _held(wanted, last, state.approach)])
    again = (move == 0) & (sense[:-1] * sense[1:] < 0)
    turned = np.where(again, 2.0, np.abs(move))
    way = aim - np.concatenate([state.cmm[None, :], aim[:-1]])
    far = np.abs(way) > deadband

    table_time = turned * (360.0 / n / timing.table_speed_deg_per_s) + timing.table_settle_s * (turned > 0)
    cmm_time = (np.sqrt(np.vecdot(way, way)) * (1e3 / timing.cmm_speed_mm_per_s)
                + timing.cmm_settle_s * far.any(axis=-1))
    # Adding up one by one, in this order, is what single readings do: equal to the last bit.
    spans = np.empty((move.size, 2))
    spans[:, 0] = wait + np.maximum(table_time, cmm_time)
    spans[:, 1] = touches * timing.touch_s
    clock = np.concatenate([[state.time], spans.ravel()]).cumsum()

    # The place of the last move of the table and of each axis so far, -1 before any.
    far[:, free] = False
    moved = np.concatenate([turned[:, None] > 0, far], axis=1)
    held = np.maximum.accumulate(np.where(moved, np.arange(len(moved))[:, None], -1))
    return Moves(
        steps=state.steps + move.cumsum(), turned=state.turned + turned.cumsum(),
        approach=sense[1:].astype(np.int64),
        stop=_held(stop, held[:, 0], state.stop), cmm=aim,
        cmm_sense=_held(np.sign(way), held[:, 1:], state.cmm_sense, np.arange(3)),
        began=clock[:-1:2], arrived=clock[1::2], ended=clock[2::2])


def _held(value: NDArray[_Number], last: Ints, first: Floats | float, *column: Ints) -> NDArray[_Number]:
    """Return the value at the last fresh place, `first` before any, (N,), or (N, 3) by column."""
    return np.where(last >= 0, value[(np.maximum(last, 0), *column)], first)


@dataclass(frozen=True, eq=False)
class Moment:
    """The circumstances of N readings of Q touches each: all that a physical effect can depend on.

    time: (N, Q) of each touch, s since power-on; began, ended: (N, 1) from the first move for a reading to its last
    touch, s; warming: (N, Q) temperature relative to power-on, K; table_position, ball: (N, 1) one-based; azimuth:
    (N, 1) of the ball on the plate, rad; angle: (N, 1) true angle to which the table turned by its encoder, rad;
    travel: (N, 1) unwrapped angle since power-on, rad; turned: (N, 1) sum of all angles turned, whatever the sense,
    rad; approach: (N, 1) sense of the last table move, 0 before the first; cmm_sense: (N, 1, 3) sense of the last CMM
    move per axis, 0 before the first; gravity: (3,) unit vector of its direction in the table frame.
    """

    time: Floats
    began: Floats
    ended: Floats
    warming: Floats
    table_position: Ints
    ball: Ints
    azimuth: Floats
    angle: Floats
    travel: Floats
    turned: Floats
    approach: Ints
    cmm_sense: Floats
    gravity: Floats

    @property
    def hours(self) -> Floats:
        """(N, Q) time since power-on, h."""
        return self.time / 3600.0

    def is_made_at(self, hour: float) -> Bools:
        """Return in which reading a time [h] falls, from its first move to its last touch, (N, 1)."""
        return (self.began <= hour * 3600.0) & (hour * 3600.0 < self.ended)
