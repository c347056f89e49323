# SPDX-License-Identifier: Apache-2.0
"""The Run that follows from the answers of a run that count.

The one way from messages to numbers: evaluator, log reader and studio come through here, so the same messages give the
same numbers, bit for bit."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Frame, fitted_frame, rotate_z, rotation_matrix, turned_frame
from rosette_ros.core.run.records import Floats, Ints, Run, steps_of, turned_steps
from rosette_ros.core.run.remarks import Remark
from rosette_ros.core.run.scheme import Way, joined_travel, nominal_places
from rosette_ros.io import messages
from rosette_ros.io.messages import MACHINE_FRAME, TABLE_FRAME, Answer, Phase, Target
from rosette_ros.io.reading_checks import remark_on_two_answers, remarks_on_answers, remarks_on_run
from rosette_ros.io.run_answers import RunAnswers

MAX_BALLS = 10_000  # more balls than this are taken for a mistake
MIN_REPEATABILITY = 1e-12  # repeated readings that differ by less, m, show rounding and not repeatability
NO_RUN = 'expected probe targets of phase RUN, found none; the calibration ended before its run began'
LEAST_TAUGHT, FARTHEST, SAME_PLACE = 6, 1e3, 1e-6
"""The taught pose follows from so many targets of the alignment, less far than this, m, and exact to this, m."""
SAME_OFFSET = 1e-9
"""Angles of table positions are steps of one table if they agree to this, rad."""
SAME_FRAME = 1e-12
"""Frames whose axes (as numbers) and origins (m) differ by no more are one frame that was published twice."""


@dataclass(frozen=True)
class RunAssembly:
    """Assembles the answers of a run: table frame, repeatability, remarks, the Run; source: named in errors; stated:
    repeatability of a coordinate, m, where it is known but was not measured here."""

    answers: RunAnswers
    source: str = 'run'
    stated: float | None = None

    @property
    def _where(self) -> str:
        return f'{self.source}: run {self.answers.run_id!r}'

    def frame(self) -> Frame | None:
        """Return the table frame in the machine frame: the last one found before the first target of phase RUN, where
        none was, the first of all; None where there is none.

        Raises InvalidData where frames that differ were published during the alignment of the run."""
        if not self.answers.frames:
            return None
        self._refuse_two_frames()
        begin, frames = self.answers.run_begin(2**63), self.answers.own_frames()
        before = [one for one in frames if one.stamp_ns <= begin]
        return max(before, key=lambda one: one.stamp_ns).frame if before else frames[0].frame

    def rotation(self) -> Floats | None:
        """Return the rotation of the table frame in the machine frame, as found or taught, None if neither is known.

        A CMM that answers in the table frame was sent to the balls of the alignment by the taught pose."""
        if self.answers.is_in_table_frame:
            asked = [one for one in self.answers.asked()
                     if one.phase == Phase.ALIGNMENT and messages.short_frame(one.frame_id) == MACHINE_FRAME]
            if len(asked) >= LEAST_TAUGHT and asked[0].balls >= 3:
                n, radius = asked[0].balls, asked[0].radius
                position, ball = np.array([(one.table_position, one.ball) for one in asked]).T
                places, centres = nominal_places(n, radius, position, ball), np.array([one.centre for one in asked])
                with np.errstate(over='ignore', invalid='ignore'):  # absurd numbers are no pose
                    places = rotate_z(asked[0].table_offset, places)
                if np.abs(places).max() < FARTHEST and np.abs(centres).max() < FARTHEST:
                    frame = fitted_frame(centres, places)
                    if np.abs(frame.to_outer(places) - centres).max() < SAME_PLACE:
                        return frame.rotation
        frame_found = self.frame()
        return None if frame_found is None else frame_found.rotation

    def _refuse_two_frames(self) -> None:
        """Refuse frames that differ between the begin of the alignment and the first target of phase RUN.

        Where the alignment was repeated after a pause, the session that ended it counts."""
        if self.answers.is_in_table_frame:
            return
        end = self.answers.run_begin(2**63)
        last = max((one.session for one in self.answers.targets
                    if one.phase == Phase.ALIGNMENT and one.stamp_ns <= end), default=0)
        begin, different = min(one.stamp_ns for one in self.answers.targets if last in (0, one.session)), list[Floats]()
        for stamp, frame in self.answers.own_frames():
            numbers = np.append(frame.rotation, frame.origin)
            if begin <= stamp <= end and not any(np.abs(numbers - one).max() <= SAME_FRAME for one in different):
                different.append(numbers)
        if len(different) > 1:
            raise InvalidData(f'{self.source}: expected one table frame for run {self.answers.run_id}, found '
                              f'{len(different)} that differ; two cells share /tf_static? give each its namespace '
                              'or domain')

    def repeatability(self) -> tuple[float, float] | tuple[None, None]:
        """Return (standard deviation of a coordinate in m, degrees of freedom) of the readings of phase REPEATABILITY.

        Pooled over the balls and the three axes: sigma² = sum (p - mean)² / dof, dof = 3 (m - 1) for m readings of one
        ball. (None, None) where no ball was read twice."""
        squares, dof = 0.0, 0
        for left in self._repeated():
            with np.errstate(over='ignore', invalid='ignore'):  # an infinite sum is refused by Run
                squares += float(np.sum(left**2))
            dof += 3 * (len(left) - 1)
        if not dof or np.sqrt(squares / dof) < MIN_REPEATABILITY:
            return None, None
        return float(np.sqrt(squares / dof)), float(dof)

    def _repeatability_axes(self, rotation: Floats | None,
                            offset: float = 0.0) -> tuple[float, float, float] | None:
        """Return the same along x, y and z of the table frame, turned by the table's offset, rad; None where it is not
        known how that stands."""
        every = self._repeated()
        turn = np.eye(3) if self.answers.is_in_table_frame else rotation
        if not every or turn is None:
            return None
        left, _ = turned_frame(offset, np.concatenate(every) @ turn, None)
        with np.errstate(over='ignore', invalid='ignore'):
            x, y, z = np.sqrt(np.sum(left**2, axis=0) / max(len(left) - len(every), 1)).tolist()
        return (x, y, z) if MIN_REPEATABILITY < min(x, y, z) and max(x, y, z) < np.inf else None

    def _repeated(self) -> list[Floats]:
        """Return the readings of phase REPEATABILITY less their mean, (m, 3) of each ball."""
        places: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
        for target, answer in self.answers.counting():
            if target.phase == Phase.REPEATABILITY:
                places.setdefault((target.table_position, target.ball), []).append(answer.centre)
        with np.errstate(over='ignore', invalid='ignore'):
            return [np.array(places[place]) - np.mean(places[place], axis=0) for place in sorted(places)]

    def run(self) -> Run:
        """Return the Run of the readings of phase RUN, in the order in which they were measured.

        Balls without a good answer are missing from the Run. Time counts from the first
        reading; time and travel are as recorded, and go on where a clock was set back, or a table counted from 0
        again, over a pause: the pause is then as long as readings usually are apart.

        Raises InvalidData where no ball centre is left, targets contradict each other, a frame is unknown, or a ball
        centre is nearer to another ball's place than to its own."""
        n, radius = self._plate()
        pairs = [pair for pair in self.answers.counting() if pair[0].phase == Phase.RUN]
        if not pairs:
            unused = ', '.join(f'{count} {reason}' for reason, count in self.answers.unused().items() if count)
            raise InvalidData(f'{self.source}: expected ball centres of run {self.answers.run_id!r}, found none that '
                              'counts'
                              f'{f" ({unused})" * bool(unused)}')
        pairs.sort(key=lambda pair: (pair[0].session, pair[1].stamp_ns, pair[1].seq))
        targets, answers = [target for target, _ in pairs], [answer for _, answer in pairs]
        session, table_position, ball = np.array(
            [(target.session, target.table_position, target.ball) for target in targets], dtype=np.int64).T
        stamp, approach = np.array([(answer.stamp_ns, answer.approach) for answer in answers], dtype=np.int64).T
        angle, travel, temperature = np.array(
            [(answer.table_angle, answer.table_travel, answer.temperature) for answer in answers], dtype=float).T
        offset = self._table_offset(targets)
        rotation = self.rotation()
        repeated = self._repeatability_axes(rotation, offset)
        centre, rotation = turned_frame(offset, self._in_table_frame(answers), rotation)
        angle = angle - offset
        for row in misplaced(n, radius, table_position, ball, centre) if n >= 3 and radius > 0 else ():
            i, j, got = table_position[row], ball[row], ', '.join(f'{1e3 * value:.6g}' for value in centre[row])
            x, y, _ = 1e3 * nominal_places(n, radius, i, j)
            raise InvalidData(f'{self.source}: ball centre with seq {answers[row].seq}: expected a place near '
                              f'({x:.3f}, '
                              f'{y:.3f}, 0) mm in the table frame for table position {i}, ball {j}, found ({got}); was '
                              'another ball measured, or is the table frame wrong?')
        sigma, dof = self.repeatability()
        written = steps_of([answer.centre for answer in answers])
        turn = rotation_matrix([0.0, 0.0, offset]) if self.answers.is_in_table_frame else rotation
        run = Run(
            n=n, radius=radius, table_position=table_position, ball=ball, centre=centre, table_angle=angle,
            time=_joined_time((stamp - stamp[0]) * 1e-9, session),
            temperature=np.where(np.isfinite(temperature), temperature, np.nan), approach=approach,
            table_travel=joined_travel(travel, angle, approach, session, n), **self._way(targets, rotation),
            repeatability=sigma, repeatability_dof=dof, run_id=self.answers.run_id, session=session, source=self.source,
            rotation=rotation, repeatability_axes=repeated, table_offset=offset,
            repeats=np.unique((table_position - 1) * n + ball).size < ball.size)
        steps = written if turn is None else turned_steps(written, turn)
        return run.replace(remarks=self.remarks + remarks_on_run(run),
                           written_steps=None if np.array_equal(steps, run.steps) else steps)

    def _way(self, targets: Sequence[Target], rotation: Floats | None) -> dict[str, Any]:
        """Return the senses of the CMM at targets from all that it was sent to, answered or not.

        A log of nothing but answered targets was made from a table: it tells no more than that.
        """
        n = targets[0].balls
        if n < 3 or len(targets) >= n**2:
            return {}
        asked = list(self.answers.asked())
        if self.answers.answered == len(asked) and all(one.phase == Phase.RUN for one in asked):
            table_position, ball = np.array([(one.table_position, one.ball) for one in targets]).T
            centre = np.zeros((len(targets), 3))
            return {'unrecorded': Run(n, 1.0, table_position, ball, centre, repeats=True).unrecorded}
        went = sorted(asked, key=lambda one: (
            one.session, (self.answers.answer_to(one.seq) or one).stamp_ns, one.seq))
        place = {one.seq: row for row, one in enumerate(went)}
        position, ball, approach = np.array([(one.table_position, one.ball, one.approach) for one in went]).T
        way = Way(position, ball, approach, np.array([place[one.seq] for one in targets]))
        return {'cmm_sense': way.cmm_sense(n, rotation)}

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What is wrong with the answers: two to one target that was asked once, mistakes of the CMM."""
        sessions = Counter(seq for seq, _ in {(target.seq, target.session) for target in self.answers.targets})
        several = ((target, [one.centre for one in self.answers.usable(target).values()])
                   for target in self.answers.asked()
                   if target.attempt == sessions[target.seq] == 1 and self.answers.count_to(target.seq) > 1)
        apart = {str(target): float(np.ptp(each, axis=0).max()) for target, each in several if len({*each}) > 1}
        return (*remark_on_two_answers(apart), *remarks_on_answers(self.answers.counting(), self.stated))

    def _table_offset(self, targets: Sequence[Target]) -> float:
        """Return the table angle of table position 1, rad, on which all targets agree."""
        offsets = np.array([one.table_offset for one in targets])
        if not np.ptp(offsets) < SAME_OFFSET:
            got = ', '.join(f'{np.rad2deg(one.table_angle):.6g} for position {one.table_position}'
                            for one in targets[:5])
            raise InvalidData(f'{self._where}: table_angle: expected targets at steps of 360 deg / {targets[0].balls}, '
                              f'found {got}')
        return float(offsets.min())

    def _plate(self) -> tuple[int, float]:
        """Return (n, radius) on which all targets of phase RUN agree."""
        run = [target for target in self.answers.targets if target.phase == Phase.RUN]
        if not run:
            raise InvalidData(f'{self.source}: {NO_RUN}')
        for name in ('balls', 'radius'):
            values = np.unique([getattr(target, name) for target in run])
            if values.size > 1:
                raise InvalidData(f'{self._where}: {name}: expected one value in all targets, found '
                                  f'{", ".join(f"{value:g}" for value in values[:5])}')
        n, radius = run[0].balls, float(run[0].radius)
        if n > MAX_BALLS:
            raise InvalidData(f'{self._where}: balls: expected at most {MAX_BALLS}, found {n}')
        return n, radius

    def _in_table_frame(self, answers: Sequence[Answer]) -> Floats:
        """Return the ball centres in the table frame, (N, 3)."""
        centre = np.array([answer.centre for answer in answers], dtype=float)
        if self.answers.is_in_table_frame:
            return centre
        frame = self.frame()
        if frame is None:
            raise InvalidData(f'{self.source}: expected a transform from {MACHINE_FRAME} to {TABLE_FRAME} on '
                              '/tf_static, '
                              'found none; without it the table axis is unknown')
        with np.errstate(over='ignore', invalid='ignore'):  # absurd numbers are refused by their place
            return frame.to_inner(centre)


def misplaced(n: int, radius: float, table_position: Ints, ball: Ints, centre: Floats) -> Ints:
    """Return the rows of ball centres (N, 3) that are nearer to another ball's place, (M,)."""
    with np.errstate(over='ignore', invalid='ignore'):
        away = np.linalg.norm(centre - nominal_places(n, radius, table_position, ball), axis=-1)
    return np.flatnonzero(~(away <= radius * np.sin(np.pi / n)))


def _joined_time(time: Floats, session: Ints) -> Floats:
    """Return the times, (N,), s: where they fall over a pause, a clock was set back and its length is not known."""
    for first in (np.flatnonzero(np.diff(session)) + 1).tolist():
        step = np.diff(time)
        if step[first - 1] <= 0:
            within = np.delete(step, np.flatnonzero(np.diff(session)))
            usual = np.median(within) if within.size else 1.0
            time = time + np.where(np.arange(time.size) >= first, max(usual, 1e-3) - step[first - 1], 0.0)
    return time
