# SPDX-License-Identifier: Apache-2.0
"""What one calibration measures, in order: the scheme and the phases around it. No ROS here."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from rosette_ros.core.geometry import Frame, nominal_angles
from rosette_ros.core.scheme import Scheme, cmm_position


class Phase(IntEnum):
    """Where a calibration stands; the numbers are those of rosette_msgs/msg/RunState."""

    IDLE = 0
    REPEATABILITY = 1
    ALIGNMENT = 2
    RUN = 3
    DRIFT_CHECK = 4
    EVALUATION = 5
    DONE = 6
    CANCELLED = 7
    FAILED = 8

    @property
    def is_end(self):
        """Whether nothing follows this phase."""
        return self in (Phase.DONE, Phase.CANCELLED, Phase.FAILED)


def phase_name(number):
    """Return the name of the phase that a RunState tells, `PHASE_77` for one that does not exist."""
    return Phase(number).name if number in list(Phase) else f'PHASE_{number}'


@dataclass(frozen=True, eq=False)
class Target:
    """One ball to be probed.

    table_position, ball, cmm_position: one-based; table_angle: nominal, in [0, 2 pi), rad;
    approach: sense in which the table turns to get there, 0 where it stays; nominal: (3,) nominal
    ball centre in the table frame, m.
    """

    seq: int
    phase: Phase
    balls: int
    radius: float
    table_position: int
    ball: int
    cmm_position: int
    table_angle: float
    approach: int
    nominal: np.ndarray

    def __str__(self):
        """Name the target for a person."""
        return f'target {self.seq} (table position {self.table_position}, ball {self.ball})'


@dataclass(frozen=True, eq=False)
class Answer:
    """What the CMM says about one target; centre: (3,) in the frame `frame_id`, m; stamp_ns: when measured."""

    run_id: str
    seq: int
    table_position: int
    ball: int
    cmm_position: int
    ok: bool
    text: str
    frame_id: str
    table_angle: float
    table_travel: float
    centre: np.ndarray
    stamp_ns: int = 0


@dataclass(frozen=True, eq=False)
class Programme:
    """All targets of one calibration, N in the order of asking.

    phase, table_position, ball, approach: (N,); taught: the table frame in machine coordinates as
    roughly known before the alignment.
    """

    scheme: Scheme
    radius: float
    taught: Frame
    phase: np.ndarray
    table_position: np.ndarray
    ball: np.ndarray
    approach: np.ndarray

    @property
    def total(self):
        """N, the number of targets over all phases."""
        return self.phase.size

    def target(self, index):
        """Return the target at a position 0..N-1 of the programme; its seq is index + 1."""
        n = self.scheme.n
        position, ball = int(self.table_position[index]), int(self.ball[index])
        k = int(cmm_position(n, position, ball))
        angles = nominal_angles(n)
        nominal = self.radius * np.array([np.cos(angles[k - 1]), np.sin(angles[k - 1]), 0.0])
        return Target(index + 1, Phase(int(self.phase[index])), n, self.radius, position, ball, k,
                      float(angles[position - 1]), int(self.approach[index]), nominal)

    def place_in_phase(self, index):
        """Return (place, size): which target of its phase stands at `index`, and of how many."""
        same = np.flatnonzero(self.phase == self.phase[index])
        return int(np.searchsorted(same, index)) + 1, same.size


def make_programme(scheme, radius, taught, repeats=10, drift_check=True):
    """Return the Programme of one calibration.

    Repeatability check: ball 1 at table position 1, `repeats` times. Alignment: ball 1 at every
    table position (the axis), then every ball at table position 1 (the plane and the x axis). The
    n*n run in the order of `scheme`. Drift check: the first ball of the run once more.
    Source: Kniel et al. (2019), section 2.2, steps (a)-(d).
    """
    every, first = np.arange(1, scheme.n + 1), np.ones(scheme.n, dtype=int)
    last = slice(0, 1 if drift_check else 0)
    parts = [
        (Phase.REPEATABILITY, *(np.ones(repeats, dtype=int),) * 3),
        (Phase.ALIGNMENT, every, first, first),
        (Phase.ALIGNMENT, first, every, first),
        (Phase.RUN, scheme.table_position, scheme.ball, scheme.approach),
        (Phase.DRIFT_CHECK, scheme.table_position[last], scheme.ball[last],
         scheme.approach[last]),
    ]
    phase = np.concatenate([np.full(part[1].size, part[0]) for part in parts])
    position, ball, sense = (np.concatenate([part[c] for part in parts]) for c in (1, 2, 3))
    stays = np.diff(position, prepend=0) == 0
    return Programme(scheme, radius, taught, phase, position, ball, np.where(stays, 0, sense))
