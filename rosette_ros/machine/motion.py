# SPDX-License-Identifier: Apache-2.0
"""How table and CMM travel from reading to reading, and how long it takes."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import TWO_PI

_AXES = np.arange(3)


@dataclass(frozen=True, eq=False)
class State:
    """Where the machine stands after its last reading.

    time: s since power-on; steps: unwrapped table position in table divisions; turned: divisions
    turned in any sense; approach: sense of the last table move, 0 before the first; stop: rad, by
    which the table stopped off its division; cmm: (3,) last aim, m; cmm_sense: (3,) sense of the
    last CMM moves, 0 before the first; readings: how many were made.
    """

    time: float
    steps: int
    turned: int
    approach: int
    stop: float
    cmm: np.ndarray
    cmm_sense: np.ndarray
    readings: int


@dataclass(frozen=True, eq=False)
class Journey:
    """N readings in order: what State holds, after each move, (N,), (N, 3); and the times, s.

    began: when the move began; arrived: when probing began; ended: when it was done.
    """

    steps: np.ndarray
    turned: np.ndarray
    approach: np.ndarray
    stop: np.ndarray
    cmm: np.ndarray
    cmm_sense: np.ndarray
    began: np.ndarray
    arrived: np.ndarray
    ended: np.ndarray

    def last_state(self, state):
        """Return the State after all readings, which began at `state`."""
        return State(float(self.ended[-1]), int(self.steps[-1]), int(self.turned[-1]),
                     int(self.approach[-1]), float(self.stop[-1]), self.cmm[-1],
                     self.cmm_sense[-1], state.readings + self.steps.size)


def travel(state, timing, n, table_position, approach, aim, wait, stop, touches, deadband):
    """Return the Journey from `state` through N targets.

    timing: TimingSettings; table_position: (N,) one-based; approach: (N,) sense in which the table
    shall turn, 0 is taken as +1; aim: (N, 3) m; wait: (N,) s before each ball; stop: (N,) rad by
    which the table would stop off, if it moves; touches: Q; deadband: m.
    """
    before = np.concatenate([[state.steps % n + 1], table_position[:-1]])
    forward = (table_position - before) % n
    move = np.where((approach < 0) & (forward > 0), forward - n, forward)
    turned = np.abs(move)
    way = aim - np.concatenate([state.cmm[None, :], aim[:-1]])
    far = np.abs(way) > deadband

    table_time = (turned * (360.0 / n / timing.table_speed_deg_per_s)
                  + timing.table_settle_s * (turned > 0))
    cmm_time = (np.sqrt(np.vecdot(way, way)) * (1e3 / timing.cmm_speed_mm_per_s)
                + timing.cmm_settle_s * far.any(axis=-1))
    # Adding up one by one, in this order, is what single readings do: equal to the last bit.
    spans = np.empty((move.size, 2))
    spans[:, 0] = wait + np.maximum(table_time, cmm_time)
    spans[:, 1] = touches * timing.touch_s
    clock = np.concatenate([[state.time], spans.ravel()]).cumsum()

    held = _last(np.concatenate([turned[:, None] > 0, far], axis=1))
    return Journey(
        steps=state.steps + move.cumsum(), turned=state.turned + turned.cumsum(),
        approach=_held(np.sign(move), held[:, 0], state.approach),
        stop=_held(stop, held[:, 0], state.stop), cmm=aim,
        cmm_sense=_held(np.sign(way), held[:, 1:], state.cmm_sense, _AXES),
        began=clock[:-1:2], arrived=clock[1::2], ended=clock[2::2])


def _last(fresh):
    """Return the place of the last true in each column so far, -1 before any, (N, c)."""
    return np.maximum.accumulate(np.where(fresh, np.arange(len(fresh))[:, None], -1))


def _held(value, last, first, *column):
    """Return the value at the last fresh place, `first` before any, (N,), or (N, 3) by column."""
    return np.where(last >= 0, value[(np.maximum(last, 0), *column)], first)


def travel_angle(steps, n, stop):
    """Return the unwrapped angle of table divisions `steps` (N,) stopped off by `stop`, rad."""
    return steps * (TWO_PI / n) + stop
