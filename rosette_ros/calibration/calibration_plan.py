# SPDX-License-Identifier: Apache-2.0
"""What one calibration measures, in order: the scheme and the phases around it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.axes import words
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import Frame, nominal_angles
from rosette_ros.core.run.records import Floats, Ints
from rosette_ros.core.run.scheme import Scheme, cmm_position
from rosette_ros.io.messages import TABLE_FRAME, Phase, Target
from rosette_ros.io.plan_file import LONGEST_WAIT

BLOCK = ('table_position', 'ball', 'approach', 'wait')
"""Columns of readings that are added to a plan."""


def block_of(n: int, columns: Mapping[str, ArrayLike]) -> Scheme:
    """Return readings on n balls by their columns, BLOCK; raises InvalidPlan where they cannot be measured."""
    made = {name: np.asarray(columns[name], dtype=float if name == 'wait' else np.int64) for name in BLOCK}
    table, ball, approach, wait = made.values()
    if not (table.size == ball.size == approach.size == wait.size and np.isin([table, ball], np.arange(1, n + 1)).all()
            and np.isin(approach, (-1, 1)).all() and np.all((wait >= 0) & (wait <= LONGEST_WAIT))):
        raise InvalidPlan(f'readings that are added: expected table position and ball in 1..{n}, approach +1 or -1 '
                          'and a '
                          f'wait of 0 to {LONGEST_WAIT} s of each, found {made!r:.200}')
    return Scheme(n, 'added', 0, table, ball, approach, wait=wait)


@dataclass(frozen=True, eq=False)
class CalibrationPlan:
    """All targets of one calibration, N in the order of asking.

    phase, table_position, ball, approach, touches, session: (N,), approach the sense in which the table gets, or got,
    there, touches 0 for as many as the CMM usually makes, session one more after every pause that is
    planned; wait: (N,) s for which the cell stands still before; taught: the table frame in machine coordinates as
    roughly known before the alignment; scheme: of the run before readings were added."""

    scheme: Scheme
    radius: float
    taught: Frame
    phase: Ints
    table_position: Ints
    ball: Ints
    approach: Ints
    touches: Ints
    session: Ints
    wait: Floats

    def followed_by(self, block: Scheme) -> 'CalibrationPlan':
        """Return the plan with the readings of a block after those of its run, in the last session."""
        end = self.run_end
        added = {'phase': Phase.RUN, 'table_position': block.table_position, 'ball': block.ball,
                 'approach': block.approach, 'touches': np.where(block.touches > 0, block.touches, self.touches[0]),
                 'session': self.session[end - 1], 'wait': block.wait}
        columns: dict[str, Any] = {
            name: np.insert(getattr(self, name), end, np.broadcast_to(values, block.ball.shape))
            for name, values in added.items()}
        return replace(self, **columns)

    @property
    def run_end(self) -> int:
        """Index of the first target after the run, N where none is."""
        return int(np.searchsorted(self.phase, Phase.RUN, 'right'))

    @property
    def added(self) -> Scheme:
        """The readings that were added to the scheme."""
        rows = slice(int(np.searchsorted(self.phase, Phase.RUN)) + self.scheme.ball.size, self.run_end)
        return replace(self.scheme, **{name: getattr(self, name)[rows] for name in (
            'table_position', 'ball', 'approach', 'touches', 'session', 'wait')})

    def placed(self, target: Target, frame: Frame, frame_id: str) -> Target:
        """Return a target in the machine frame, where the table frame is, or in the table frame.

        Its pole, from which the ball is probed, is on the free side of the plate: the table axis, as taught."""
        x, y, z = frame.to_outer(target.place).tolist()
        a, b, c = (np.eye(3) if frame_id == TABLE_FRAME else self.taught.rotation)[:, 2].tolist()
        return target._replace(centre=(x, y, z), frame_id=frame_id, pole=(a, b, c))

    def doubt_of_axis(self, target: Target) -> str:
        """Return what to check where a target is not found though ball 1 was, at table angle 0; '' for that one."""
        if target.phase != Phase.ALIGNMENT or (target.table_position, target.ball) == (1, 1):
            return ''
        return ('; ball 1 is where it was taught at table angle 0: check that the table counts counter-clockwise about '
                f'table.axis, taught as {words(self.taught.rotation[:, 2])}')

    @property
    def total(self) -> int:
        """N, the number of targets over all phases."""
        return self.phase.size

    @property
    def alignments(self) -> int:
        """Number of targets of the alignment."""
        return int(np.count_nonzero(self.phase == Phase.ALIGNMENT))

    def target(self, index: int) -> Target:
        """Return the target at 0..N-1, seq is index + 1, with its nominal centre, before it is asked (attempt 0).

        Its approach is 0 where the table stands as the target before has left it."""
        n, before = self.scheme.n, index - 1
        stays = index > 0 and (self.table_position[before], self.approach[before]) == (
            self.table_position[index], self.approach[index])
        position, ball = int(self.table_position[index]), int(self.ball[index])
        made = Target(
            run_id='', seq=index + 1, attempt=0, session=0, phase=Phase(int(self.phase[index])), balls=n,
            radius=self.radius, table_position=position, ball=ball, cmm_position=int(cmm_position(n, position, ball)),
            table_angle=float(nominal_angles(n)[position - 1] + self.scheme.table_offset),
            approach=0 if stays else int(self.approach[index]), centre=(0.0, 0.0, 0.0), frame_id=TABLE_FRAME,
            stamp_ns=0, touches=int(self.touches[index]))
        x, y, z = made.place.tolist()
        return made._replace(centre=(x, y, z))

    def place_in_phase(self, index: int) -> tuple[int, int]:
        """Return (place, size): the place of a target in its phase, one-based, and the size of the phase."""
        same = np.flatnonzero(self.phase == self.phase[index])
        return int(np.searchsorted(same, index)) + 1, same.size


def plan_calibration(scheme: Scheme, radius: float, taught: Frame, repeats: int = 10,
                     drift_check: bool = True, touches: int = 0, balls: Sequence[int] = ()) -> CalibrationPlan:
    """Return the CalibrationPlan of a scheme.

    Repeatability check: ball 1 at table position 1, `repeats` times. Alignment: ball 1 at every table position (the
    axis), then every ball at table position 1 (the plane and the x axis), the table turning as for the first reading of
    the run, so that position 1 is approached as planned. The run in the order of `scheme`. Drift
    check: the first ball of the run once more. touches: of balls for which the scheme names none; outside of the run as
    many as most of its balls get; balls: those that exist, all if none. Source: Kniel et al. (2019), section 2.2, steps
    (a)-(d)."""
    sense, every = int(scheme.approach[0]), np.arange(1, scheme.n + 1)
    present = np.sort(balls) if balls else every
    around = every if sense > 0 else np.roll(every[::-1], 1)
    checks = ((Phase.REPEATABILITY, np.ones(repeats, dtype=int), np.ones(repeats, dtype=int)),
              (Phase.ALIGNMENT, around, np.ones_like(every)), (Phase.ALIGNMENT, np.ones_like(present), present))
    of_run = np.where(scheme.touches > 0, scheme.touches, touches)
    usual, last = int(np.bincount(of_run).argmax()), slice(0, 1 if drift_check else 0)
    parts = [*((*part, np.full(part[1].size, sense)) for part in checks),
             (Phase.RUN, scheme.table_position, scheme.ball, scheme.approach),
             (Phase.DRIFT_CHECK, scheme.table_position[last], scheme.ball[last], scheme.approach[last])]
    phase = np.concatenate([np.full(part[1].size, part[0]) for part in parts])
    position, ball, approach = (np.concatenate([part[column] for part in parts]) for column in (1, 2, 3))
    in_run = phase == Phase.RUN
    number, session = np.full(phase.size, usual), np.where(phase == Phase.DRIFT_CHECK, scheme.session[-1], 1)
    number[in_run], session[in_run] = of_run, scheme.session
    wait = np.zeros(phase.size)
    wait[in_run] = scheme.wait
    return CalibrationPlan(scheme, radius, taught, phase, position, ball, approach, number, session, wait)
