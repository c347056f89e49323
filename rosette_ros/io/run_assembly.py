# SPDX-License-Identifier: Apache-2.0
"""Which targets and answers of a run exist, which of them count, and the Run that follows.

The one way from messages to numbers: sequencer, evaluator, recorder, log reader and studio all come through here,
so the same messages give the same numbers, bit for bit."""

import hashlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Frame, fitted_frame, rotate_z, turned_frame
from rosette_ros.core.run.records import Floats, Ints, Run
from rosette_ros.core.run.remarks import ReadingRemark
from rosette_ros.core.run.scheme import Way, joined_travel, nominal_places
from rosette_ros.io import messages
from rosette_ros.io.messages import FRAMES, MACHINE_FRAME, TABLE_FRAME, Answer, Phase, Rows, TableFrame, Target
from rosette_ros.io.reading_checks import remark_on_two_answers, remarks_on_answers, remarks_on_run

MOST_EARLY, MOST_ANSWERS = 10_000, 100  # kept of a run: answers to no target so far, answers to one target
MAX_BALLS = 10_000  # more balls than this are taken for a mistake
MIN_REPEATABILITY = 1e-12  # repeated readings that differ by less, m, show rounding and not repeatability
NO_RUN = 'wanted probe targets of phase RUN, got none; the calibration ended before its run began'
LEAST_TAUGHT, FARTHEST, SAME_PLACE = 6, 1e3, 1e-6
"""The taught pose follows from so many targets of the alignment, less far than this, m, and exact to this, m."""
SAME_OFFSET = 1e-9
"""Angles of table positions are steps of one table if they agree to this, rad."""
SAME_FRAME = 1e-12
"""Frames whose axes (as numbers) and origins (m) differ by no more are one frame that was published twice."""


def _when_asked(target: Target) -> tuple[int, int]:
    """Return by what the last of the targets with one seq is found; in a new session attempts are counted from those
    that the log holds, which may lack some."""
    return target.session, target.attempt


class RunAnswers:
    """The targets and answers of one run, and the table frames; topics may arrive in any order relative to each other.

    A target that was sent again counts as it was sent last. Of several good answers to it the first counts that was
    measured after it was asked for the last time; if none was, the first. One in another frame than most answers is
    none. frames: table frames by any run, shared."""

    def __init__(self, run_id: str, frames: list[TableFrame] | None = None) -> None:
        self.run_id = run_id
        self.frames: list[TableFrame] = [] if frames is None else frames
        self.targets, self.answers = Rows(Target), Rows(Answer)
        self._last, self._by_seq = dict[int, int](), dict[int, tuple[int, ...]]()  # rows of these by seq
        self._answers_in, self._answered_in = dict.fromkeys(FRAMES, 0), {name: set[int]() for name in FRAMES}
        self.dropped, self._early, self._earlier = 0, 0, tuple[TableFrame, ...]()

    def add_target(self, target: Target) -> None:
        """Take a target of this run."""
        if not self.targets:
            self._earlier = tuple(self.frames)
        self.targets.append(target)
        seq, before = target.seq, self.last_target(target.seq)
        self._early -= 0 if before else len(self._by_seq.get(seq, ()))
        if before is None or _when_asked(target) >= _when_asked(before):
            self._last[seq] = len(self.targets) - 1
            for name, answered in self._answered_in.items():
                (answered.add if self._usable(target, (name,)) else answered.discard)(seq)

    def add_answer(self, answer: Answer) -> None:
        """Take an answer of this run."""
        target = self.last_target(answer.seq)
        if self._is_too_many(answer, target):
            self.dropped += 1
            return
        self._early += target is None
        self.answers.append(answer)
        self._by_seq[answer.seq] = (*self._by_seq.get(answer.seq, ()), len(self.answers) - 1)
        if answer.frame in FRAMES and answer.status == messages.STATUS_OK:
            self._answers_in[answer.frame] += 1
            if target is not None and answer.is_usable_for(target):
                self._answered_in[answer.frame].add(answer.seq)

    @property
    def in_frames(self) -> tuple[str, ...]:
        """The frame in which answers count, that of most, the machine's of two alike; both before the first."""
        return (max(FRAMES, key=self._answers_in.__getitem__),) if any(self._answers_in.values()) else FRAMES

    @property
    def _answered(self) -> set[int]:
        return self._answered_in[self.in_frames[0]]

    def _is_too_many(self, answer: Answer, target: Target | None) -> bool:
        """Return whether so many answers are kept that a further one is only if it may come to count."""
        if target is None:
            return self._early >= MOST_EARLY
        known = self._by_seq.get(answer.seq, ())
        if len(known) < MOST_ANSWERS:
            return False
        counts = self.answer_to(answer.seq)
        is_counted = counts is not None and counts.stamp_ns >= target.stamp_ns
        return is_counted or answer.stamp_ns < target.stamp_ns or not answer.is_usable_for(target)

    def keys(self) -> tuple[set[tuple[int, int, int]], set[tuple[int, int]]]:
        """Return (seq, session, attempt) of all targets, (seq, stamp_ns) of all answers."""
        return ({(target.seq, *_when_asked(target)) for target in self.targets},
                {(answer.seq, answer.stamp_ns) for answer in self.answers})

    def lacking_in(self, other: 'RunAnswers') -> tuple[list[Target], list[Answer]]:
        """Return the targets and answers that another record of the same run lacks."""
        asked, known = other.keys()
        return ([one for one in self.targets if (one.seq, *_when_asked(one)) not in asked],
                [one for one in self.answers if (one.seq, one.stamp_ns) not in known])

    def with_centres(self, centres: Mapping[int, tuple[float, float, float]]) -> 'RunAnswers':
        """Return the run with other centres, by seq, of the answers that count."""
        changed, counting = RunAnswers(self.run_id, self.frames), {row for _, row, _ in self._counting()}
        for target in self.targets:
            changed.add_target(target)
        for row, answer in enumerate(self.answers):
            is_changed = row in counting and answer.seq in centres
            changed.add_answer(answer._replace(centre=centres[answer.seq]) if is_changed else answer)
        changed._earlier = self._earlier
        return changed

    def last_target(self, seq: int) -> Target | None:
        """Return a target as it was asked last, None where it was not."""
        return self.targets[self._last[seq]] if seq in self._last else None

    def _asked(self) -> Iterator[Target]:
        """Yield the targets as they were asked last."""
        return (self.targets[row] for row in self._last.values())

    @property
    def session(self) -> int:
        """The last session of the run, 0 before the first target."""
        return max((target.session for target in self._asked()), default=0)

    def _usable(self, target: Target, frames: Collection[str] = ()) -> dict[int, Answer]:
        """Return the answers that may count for a target, by their rows."""
        frames = frames or self.in_frames
        return {row: answer for row in self._by_seq.get(target.seq, ())
                if (answer := self.answers[row]).frame in frames and answer.is_usable_for(target)}

    def _counting(self, some: Iterable[int] | None = None) -> Iterator[tuple[Target, int, Answer]]:
        """Yield targets, as asked last, with the answers that count for them and their rows; some: their seq."""
        for seq in sorted(self._last) if some is None else some:
            target = self.last_target(seq)
            if target is not None and (usable := self._usable(target)):
                row = next((row for row, one in usable.items() if one.stamp_ns >= target.stamp_ns), next(iter(usable)))
                yield target, row, usable[row]

    def answer_to(self, seq: int) -> Answer | None:
        """Return the answer that counts for a target, None where there is none."""
        return next((answer for _, _, answer in self._counting([seq])), None)

    def failed(self) -> list[Target]:
        """Return the targets that were answered, but by no answer that counts, in order of seq."""
        return [self.targets[self._last[seq]] for seq in sorted(self._last)
                if self._by_seq.get(seq) and seq not in self._answered]

    def counting(self) -> list[tuple[Target, Answer]]:
        """Return the pairs that count, in order of seq."""
        return list(self._pairs())

    def _pairs(self) -> Iterator[tuple[Target, Answer]]:
        return ((target, answer) for target, _, answer in self._counting())

    @property
    def answered(self) -> int:
        """Number of targets with an answer that counts."""
        return len(self._answered)

    def counts(self) -> dict[Phase, tuple[int, int]]:
        """Return (asked, answered) targets of each phase that was asked."""
        asked = Counter(target.phase for target in self._asked())
        answered = Counter(self.targets[self._last[seq]].phase for seq in self._answered)
        return {phase: (asked[phase], answered[phase]) for phase in Phase if phase in asked}

    @property
    def readings_hash(self) -> str:
        """SHA-256 of the answers that count and what they answer, hex."""
        found, before = hashlib.sha256(b'['), ''
        for target, answer in self._pairs():
            part = (int(target.phase), target.session, target.balls, float(target.radius), answer._replace(text=''))
            found.update(f'{before}{part}'.encode())
            before = ', '
        found.update(b']')
        return found.hexdigest()

    @property
    def is_complete(self) -> bool:
        """Whether all n² balls of phase RUN are answered."""
        balls = next((target.balls for target in self.targets if target.phase == Phase.RUN), 0)
        return balls > 0 and self.counts().get(Phase.RUN, (0, 0))[1] >= balls**2

    def unused(self) -> dict[str, int]:
        """Return how many answers do not count, by the reason in words."""
        other_frame = f'in another frame than {" or ".join(self.in_frames)}'
        counts = dict.fromkeys(('failed', 'to no target', 'with another ball than asked', 'without finite numbers',
                                other_frame, 'repeated'), 0)
        for answer in self.answers:
            target = self.last_target(answer.seq)
            if answer.status != messages.STATUS_OK:
                counts['failed'] += 1
            elif target is None:
                counts['to no target'] += 1
            elif (answer.table_position, answer.ball) != (target.table_position, target.ball):
                counts['with another ball than asked'] += 1
            else:
                counts['without finite numbers' if not answer.is_finite else
                       'repeated' if answer.frame in self.in_frames else other_frame] += 1
        counts['repeated'] -= self.answered
        return {**counts, **({'too many to be kept': self.dropped} if self.dropped else {})}

    def lacking(self, expected: int) -> str:
        """Return what an evaluation with so many answered targets lacks, '' where nothing."""
        if self.answered < expected or not any(target.phase == Phase.RUN for target in self.targets):
            return (f'wanted {expected} targets with answers, got {len(self._last)} targets and answers to '
                    f'{self.answered} of them')
        begun = {(one.session, one.phase == Phase.RUN): one.stamp_ns for one in reversed(self.targets)}
        if not (self.is_in_table_frame or any(begin <= one.stamp_ns <= begun.get((session, True), 2**63)
                                              for one in self.frames for (session, _), begin in begun.items())):
            return 'wanted the table frame on /tf_static, got none for this run'
        return ''

    def frame(self, source: str = 'run') -> Frame | None:
        """Return the table frame in the machine frame: the last one found before the first target of phase RUN, where
        none was, the first of all; None where there is none.

        Raises InvalidData where frames that differ were published during the alignment of the run."""
        if not self.frames:
            return None
        self._refuse_two_frames(source)
        begin, frames = self.run_begin(2**63), self._own_frames()
        before = [one for one in frames if one.stamp_ns <= begin]
        return max(before, key=lambda one: one.stamp_ns).frame if before else frames[0].frame

    def _own_frames(self) -> list[TableFrame]:
        """Return the frames received after the first target, all where none was: whatever their stamps are."""
        return [one for one in self.frames if not any(one is each for each in self._earlier)] or self.frames

    @property
    def is_in_table_frame(self) -> bool:
        """Whether the CMM has a table frame of its own, in which it answers."""
        return self.in_frames == (TABLE_FRAME,)

    def rotation(self, source: str = 'run') -> Floats | None:
        """Return the rotation of the table frame in the machine frame, as found or taught, None if neither is known.

        A CMM that answers in the table frame was sent to the balls of the alignment by the taught pose."""
        if self.is_in_table_frame:
            asked = [one for one in self._asked()
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
        frame_found = self.frame(source)
        return None if frame_found is None else frame_found.rotation

    def run_begin(self, otherwise: int = 0) -> int:
        """Return when phase RUN began in its first session, ns, `otherwise` where it has not."""
        asked = ((target.session, target.stamp_ns) for target in self.targets if target.phase == Phase.RUN)
        return min(asked, default=(0, otherwise))[1]

    def _refuse_two_frames(self, source: str) -> None:
        """Refuse frames that differ between the begin of the alignment and the first target of phase RUN.

        Where the alignment was repeated after a pause, the session that ended it counts."""
        if self.is_in_table_frame:
            return
        end = self.run_begin(2**63)
        last = max((one.session for one in self.targets
                    if one.phase == Phase.ALIGNMENT and one.stamp_ns <= end), default=0)
        begin, different = min(one.stamp_ns for one in self.targets if last in (0, one.session)), list[Floats]()
        for stamp, frame in self._own_frames():
            numbers = np.append(frame.rotation, frame.origin)
            if begin <= stamp <= end and not any(np.abs(numbers - one).max() <= SAME_FRAME for one in different):
                different.append(numbers)
        if len(different) > 1:
            raise InvalidData(f'{source}: wanted one table frame for run {self.run_id}, got {len(different)} that '
                              'differ; two cells share /tf_static? give each its namespace or domain')

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
        turn = np.eye(3) if self.is_in_table_frame else rotation
        if not every or turn is None:
            return None
        left, _ = turned_frame(offset, np.concatenate(every) @ turn, None)
        with np.errstate(over='ignore', invalid='ignore'):
            x, y, z = np.sqrt(np.sum(left**2, axis=0) / max(len(left) - len(every), 1)).tolist()
        return (x, y, z) if MIN_REPEATABILITY < min(x, y, z) and max(x, y, z) < np.inf else None

    def _repeated(self) -> list[Floats]:
        """Return the readings of phase REPEATABILITY less their mean, (m, 3) of each ball."""
        places: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
        for target, answer in self._pairs():
            if target.phase == Phase.REPEATABILITY:
                places.setdefault((target.table_position, target.ball), []).append(answer.centre)
        with np.errstate(over='ignore', invalid='ignore'):
            return [np.array(places[place]) - np.mean(places[place], axis=0) for place in sorted(places)]

    def to_run(self, source: str = 'run') -> Run:
        """Return the Run of the readings of phase RUN, in the order in which they were measured.

        source: named in errors. Balls without a good answer are missing from the Run. Time counts from the first
        reading; time and travel are as recorded, and go on where a clock was set back, or a table counted from 0
        again, over a pause: the pause is then as long as readings usually are apart.

        Raises InvalidData where no ball centre is left, targets contradict each other, a frame is unknown, or a ball
        centre is nearer to another ball's place than to its own."""
        n, radius = self._plate(source)
        pairs = [pair for pair in self._pairs() if pair[0].phase == Phase.RUN]
        if not pairs:
            unused = ', '.join(f'{count} {reason}' for reason, count in self.unused().items() if count)
            raise InvalidData(f'{source}: wanted ball centres of run {self.run_id!r}, got none that counts'
                              f'{f" ({unused})" * bool(unused)}')
        pairs.sort(key=lambda pair: (pair[0].session, pair[1].stamp_ns, pair[1].seq))
        targets, answers = [target for target, _ in pairs], [answer for _, answer in pairs]
        session, table_position, ball = np.array(
            [(target.session, target.table_position, target.ball) for target in targets], dtype=np.int64).T
        stamp, approach = np.array([(answer.stamp_ns, answer.approach) for answer in answers], dtype=np.int64).T
        angle, travel, temperature = np.array(
            [(answer.table_angle, answer.table_travel, answer.temperature) for answer in answers], dtype=float).T
        offset = self._table_offset(targets, source)
        rotation = self.rotation(source)
        repeated = self._repeatability_axes(rotation, offset)
        centre, rotation = turned_frame(offset, self._in_table_frame(answers, source), rotation)
        angle = angle - offset
        for row in misplaced(n, radius, table_position, ball, centre) if n >= 3 and radius > 0 else ():
            i, j, got = table_position[row], ball[row], ', '.join(f'{1e3 * value:.6g}' for value in centre[row])
            x, y, _ = 1e3 * nominal_places(n, radius, i, j)
            raise InvalidData(f'{source}: ball centre with seq {answers[row].seq}: wanted a place near ({x:.3f}, '
                              f'{y:.3f}, 0) mm in the table frame for table position {i}, ball {j}, got ({got}); was '
                              'another ball measured, or is the table frame wrong?')
        sigma, dof = self.repeatability()
        run = Run(
            n=n, radius=radius, table_position=table_position, ball=ball, centre=centre, table_angle=angle,
            time=_joined_time((stamp - stamp[0]) * 1e-9, session),
            temperature=np.where(np.isfinite(temperature), temperature, np.nan), approach=approach,
            table_travel=joined_travel(travel, angle, approach, session, n), **self._way(targets, rotation),
            repeatability=sigma, repeatability_dof=dof, run_id=self.run_id, session=session, source=source,
            rotation=rotation, repeatability_axes=repeated, table_offset=offset,
            repeats=np.unique((table_position - 1) * n + ball).size < ball.size)
        return run.replace(remarks=self.remarks + remarks_on_run(run))

    def _way(self, targets: Sequence[Target], rotation: Floats | None) -> dict[str, Any]:
        """Return the senses of the CMM at targets from all that it was sent to, answered or not.

        A log of nothing but answered targets was made from a table: it tells no more than that.
        """
        n = targets[0].balls
        if n < 3 or len(targets) >= n**2:
            return {}
        if all(one.phase == Phase.RUN and one.seq in self._answered for one in self._asked()):
            table_position, ball = np.array([(one.table_position, one.ball) for one in targets]).T
            centre = np.zeros((len(targets), 3))
            return {'unrecorded': Run(n, 1.0, table_position, ball, centre, repeats=True).unrecorded}
        went = sorted(self._asked(), key=lambda one: (
            one.session, (self.answer_to(one.seq) or one).stamp_ns, one.seq))
        place = {one.seq: row for row, one in enumerate(went)}
        position, ball, approach = np.array([(one.table_position, one.ball, one.approach) for one in went]).T
        way = Way(position, ball, approach, np.array([place[one.seq] for one in targets]))
        return {'cmm_sense': way.cmm_sense(n, rotation)}

    @property
    def remarks(self) -> tuple[ReadingRemark, ...]:
        """What is wrong with the answers: two to one target that was asked once, mistakes of the CMM."""
        sessions = Counter(seq for seq, _ in {(target.seq, target.session) for target in self.targets})
        several = ((target, [one.centre for one in self._usable(target).values()]) for target in self._asked()
                   if target.attempt == sessions[target.seq] == 1 and len(self._by_seq.get(target.seq, ())) > 1)
        apart = {str(target): float(np.ptp(each, axis=0).max()) for target, each in several if len({*each}) > 1}
        return (*remark_on_two_answers(apart), *remarks_on_answers(self.counting()))

    def _table_offset(self, targets: Sequence[Target], source: str) -> float:
        """Return the table angle of table position 1, rad, on which all targets agree."""
        offsets = np.array([one.table_offset for one in targets])
        if not np.ptp(offsets) < SAME_OFFSET:
            got = ', '.join(f'{np.rad2deg(one.table_angle):.6g} for position {one.table_position}'
                            for one in targets[:5])
            raise InvalidData(f'{source}: run {self.run_id!r}: table_angle: wanted targets at steps of 360 deg / '
                              f'{targets[0].balls}, got {got}')
        return float(offsets.min())

    def _plate(self, source: str) -> tuple[int, float]:
        """Return (n, radius) on which all targets of phase RUN agree."""
        run = [target for target in self.targets if target.phase == Phase.RUN]
        if not run:
            raise InvalidData(f'{source}: {NO_RUN}')
        for name in ('balls', 'radius'):
            values = np.unique([getattr(target, name) for target in run])
            if values.size > 1:
                raise InvalidData(f'{source}: run {self.run_id!r}: {name}: wanted one value in all targets, got '
                                  f'{", ".join(f"{value:g}" for value in values[:5])}')
        n, radius = run[0].balls, float(run[0].radius)
        if n > MAX_BALLS:
            raise InvalidData(f'{source}: run {self.run_id!r}: balls: wanted at most {MAX_BALLS}, got {n}')
        return n, radius

    def _in_table_frame(self, answers: Sequence[Answer], source: str) -> Floats:
        """Return the ball centres in the table frame, (N, 3)."""
        centre = np.array([answer.centre for answer in answers], dtype=float)
        if self.is_in_table_frame:
            return centre
        frame = self.frame(source)
        if frame is None:
            raise InvalidData(f'{source}: wanted a transform from {MACHINE_FRAME} to {TABLE_FRAME} on /tf_static, got '
                              'none; without it the table axis is unknown')
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
