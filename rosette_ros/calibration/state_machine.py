# SPDX-License-Identifier: Apache-2.0
"""One calibration as a state machine: what to ask next, what an answer means, when to give up.

Whoever drives it passes the time (steady, s) and carries out the commands that each step returns."""

from collections import deque
from collections.abc import Collection, Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rosette_ros.calibration.calibration_plan import CalibrationPlan
from rosette_ros.core.axes import refuse_other_axis, refuse_other_sense
from rosette_ros.core.errors import RosetteError, counted, plain
from rosette_ros.core.geometry import Frame, table_frame, wrap
from rosette_ros.io.messages import MACHINE_FRAME, STATUS_OK, TABLE_FRAME, Answer, Phase, Target, short_frame
from rosette_ros.io.reading_checks import remarks_on_answers
from rosette_ros.io.run_assembly import RunAnswers

VERIFY_REFUSALS = 20  # a recorder that refuses so often to report what is in the log has no log open
PACE_OF, PACE_FROM, TOLD_FROM = 60, 6, 90.0
"""The remaining time follows from the pace of so many answers, at least of so many; a shorter one is not told, s."""
PAUSE = 'the plan has a pause here, resume the run after it'
VERIFY_ROUNDS = 3  # a run fails where so many verifications in a row find answers that the log lacks


@dataclass(frozen=True)
class Limits:
    """When to ask again and when to give up; `settings.LIMITS` describes each field, with its unit."""

    answer_timeout: float = 120.0
    attempts: int = 3
    skips: int = 3
    evaluation_timeout: float = 120.0
    return_timeout: float = 60.0
    search: float = 0.02
    distance: float = 0.005
    angle: float = 0.01


class Results(NamedTuple):
    """What the evaluator has published of a run: the error motions by their stamp, ns, their readings and the model by
    their hashes, and whether a diagnosis."""

    stamp_ns: int
    readings_hash: str
    model_hash: str
    diagnosed: bool


@dataclass(frozen=True)
class Ask:
    """Send this target to the CMM, with the present time as its stamp."""

    target: Target


@dataclass(frozen=True)
class Locate:
    """Publish the table frame in the machine frame."""

    frame: Frame


@dataclass(frozen=True)
class PublishState:
    """Publish the state: the phase has changed."""


@dataclass(frozen=True)
class Verify:
    """Find out whether the log holds answers, (seq, stamp in ns), results and the state of a phase; then `verified`."""

    answers: frozenset[tuple[int, int]]
    results: Results | None = None
    phase: Phase = Phase.IDLE


@dataclass(frozen=True)
class Remark:
    """Log a warning."""

    text: str


@dataclass(frozen=True)
class Finish:
    """The calibration has ended in this phase, for this reason."""

    phase: Phase
    text: str


Command = Ask | Locate | PublishState | Verify | Remark | Finish
Commands = tuple[Command, ...]


def complaint(answer: Answer, target: Target, limits: Limits) -> str:
    """Return why an answer is no measurement of its target, '' where it is one."""
    wanted, got = ((one.table_position, one.ball, one.cmm_position) for one in (target, answer))
    if wanted != got:
        return f'wanted table position, ball, CMM position {wanted}, got {got}'
    if answer.status != STATUS_OK:
        return f'the CMM reports: {plain(answer.text) or "failed, without a reason"}'
    if not answer.is_finite:
        return (f'wanted finite numbers, got centre {answer.centre}, table_angle {answer.table_angle}, table_travel '
                f'{answer.table_travel}')
    frame, asked = answer.frame, short_frame(target.frame_id)
    if frame not in (MACHINE_FRAME, TABLE_FRAME):
        return f'wanted frame_id {MACHINE_FRAME!r} or {TABLE_FRAME!r}, got {answer.frame_id!r}'
    if frame == MACHINE_FRAME and asked == TABLE_FRAME:
        return f'wanted frame_id {TABLE_FRAME!r} as in the alignment, got {answer.frame_id!r}'
    if abs(float(wrap(answer.table_angle - target.table_angle))) > limits.angle:
        degrees = abs(float(wrap(np.deg2rad(answer.table_angle) - target.table_angle))) <= limits.angle
        return (f'wanted the table within {limits.angle:g} rad of {target.table_angle:.6f} rad, got '
                f'{answer.table_angle:.6f} rad{"; that is degrees, give radians" * degrees}')
    limit = limits.search if target.phase in (Phase.REPEATABILITY, Phase.ALIGNMENT) else limits.distance
    expected = target.centre if frame == asked else target.place
    away = float(np.linalg.norm(np.subtract(answer.centre, expected)))
    millimetres = float(np.linalg.norm(np.multiply(answer.centre, 1e-3) - np.asarray(expected))) <= limit
    return (f'wanted a ball within {1e3 * limit:g} mm of the target, got {1e3 * away:.3f} mm'
            f'{"; these are millimetres, give metres" * millimetres}') if away > limit else ''


class Sequence:
    """The state of one calibration; every step takes the steady time `now`, s, and returns the commands that follow.

    Good answers of an earlier part of the run are taken, and only the rest is asked. `answers` holds what was asked,
    and of each target the answer that was taken."""

    def __init__(self, run_id: str, plan: CalibrationPlan, limits: Limits, earlier: RunAnswers | None = None,
                 session: int = 0, verifies: bool = False) -> None:
        """Prepare; nothing is asked before begin().

        earlier: what the log of an earlier part holds; session: at least the last; verifies: whether a log is there."""
        self.run_id, self.plan, self.limits, self.verifies = run_id, plan, limits, verifies
        self.answers = RunAnswers(run_id)
        self.phase, self.text = Phase.IDLE, 'ready'
        self.skipped: list[Target] = []
        self.earlier = earlier or RunAnswers(run_id)
        self.session = max(self.earlier.session, session) + 1
        self._asked: Target | None = None
        self._asked_again, self._alignment = list[int](), list[Answer]()
        self._next_index = self._tries = self._losses = self._refusals = self._planned_session = self._left_by = 0
        self._is_received = self._is_whole = False  # the log: has received since the last pause; holds all answers
        self._results: Results | None = None
        self._held, self._is_gone, self.disturbed = '', True, list[str]()
        self._in_doubt, self._skipped_last = frozenset[tuple[int, int]](), True
        self._deadline: float | None = None
        self._frame, self._frame_id = plan.taught, MACHINE_FRAME
        self._pace = deque[float](maxlen=PACE_OF)  # when the last answers were taken, since the last pause

    @property
    def done(self) -> int:
        """Number of targets with an answer that was taken."""
        return self.answers.answered

    @property
    def left(self) -> float | None:
        """Time until all targets are answered at the pace of the last answers, s; None where that is not known."""
        pace = self._pace
        if len(pace) < PACE_FROM:
            return None
        return (self.plan.total - self.done) * (pace[-1] - pace[0]) / (len(pace) - 1)

    @property
    def is_held(self) -> bool:
        """Whether nothing more is asked until resume_asking."""
        return bool(self._held)

    def describe(self) -> str:
        """Return one sentence for a person about what happens now."""
        if self._held and not self.phase.is_end:
            return f'{self._held}; waiting for {"it" if self._is_gone else "the end of one"}'
        target = self._asked
        if target is None:
            return self.text
        place, size = self.plan.place_in_phase(target.seq - 1)
        again = '' if target.attempt == 1 else f', attempt {target.attempt}'
        left = f', about {left / 60:.0f} min left' if (left := self.left or 0) > TOLD_FROM else ''
        return (f'{Phase(target.phase).name.lower().replace("_", " ")} {place} of {size}: table position '
                f'{target.table_position}, ball {target.ball}{again}{left}')

    def begin(self, now: float) -> Commands:
        """Ask for the first target."""
        return self._next(now)

    def answer(self, answer: Answer, now: float) -> Commands:
        """Take an answer of the CMM."""
        target = self._asked
        if answer.run_id != self.run_id:
            return (Remark(f'not used: answer to run {answer.run_id!r}, this is {self.run_id!r}; an answer repeats '
                           'run_id and seq of its target'),)
        if target is None or answer.seq != target.seq:
            waiting = 'nothing' if target is None else f'seq {target.seq}'
            return (Remark(f'not used: answer to seq {answer.seq}, waiting for {waiting}'),)
        if words := complaint(answer, target, self.limits):
            return self._again(words, now, answer.is_refused)
        self._asked, self._left_by = None, target.seq
        commands = self._take(target, answer)
        self._pace.append(now)
        if self.phase.is_end or self._held:
            return commands
        if self.verifies and not self._is_received:  # one that does not hear the CMM is noticed at once
            return (*commands, *self._verify())
        return (*commands, *self._next(now))

    def hold(self, words: str, now: float, verify: bool = False, is_gone: bool = True) -> Commands:
        """Ask for nothing more until resume_asking; answers are still taken.

        words: why, for a person; verify: whether to verify the log, as after the end of a CMM: an answer that is not in
        it is sent by nobody; is_gone: whether something has to come back, and not to go."""
        if self.phase.is_end or self.phase is Phase.EVALUATION:
            return ()
        self._held, self._is_gone = words, is_gone
        if not is_gone and words not in self.disturbed:
            self.disturbed.append(words)
        self._deadline = now + self.limits.return_timeout
        if verify and self.verifies:
            self._in_doubt = self._taken()
        remark = Remark(f'{words}; the run waits for {"it" if is_gone else "the end of one"}')
        return remark, PublishState(), *(Verify(self._in_doubt),) * bool(self._in_doubt)

    def resume_asking(self, now: float, restarted: bool) -> Commands:
        """Continue after hold; restarted: a pause lies between, the present target is asked again."""
        if not self._held or self.phase.is_end:
            return ()
        self._held, self._in_doubt = '', frozenset()
        self._pace.clear()
        self.session += restarted
        self._is_received, self._left_by = self._is_received and not restarted, 0 if restarted else self._left_by
        remark = Remark('the run continues' + (f' in session {self.session}' if restarted else ''))
        if self._asked is None:
            return (remark, *self._next(now))
        if not restarted:
            self._deadline = now + self.limits.answer_timeout
            return remark, PublishState()
        return remark, PublishState(), self._ask(self._asked, now)

    def evaluated(self, results: Results, now: float) -> Commands:
        """Take the results of this run that the evaluator has published: the log has to hold them."""
        if self.phase is not Phase.EVALUATION or self._results is not None:
            return ()
        self._results = results
        if not self.verifies:
            return (*self._done(), Finish(self.phase, self.text))
        self.text, self._deadline = 'verifying that the log holds the results', None
        return (Verify(self._taken(), results),)

    def verified(self, recorded: Set[tuple[int, int]], missing: Collection[str], now: float) -> Commands:
        """Take what is in the log: (seq, stamp in ns) of its answers, and what else is missing, in words.

        Answers that are not there are asked again; results or a last state that are not there end the run."""
        if self.phase in (Phase.CANCELLED, Phase.FAILED):
            return ()
        if self._held:
            lost, self._in_doubt = sorted(seq for seq, _ in self._in_doubt - recorded), frozenset()
            return self._drop(lost) if lost else ()
        if self._asked is not None:
            return ()  # the run has continued: the log is verified at its end
        if self._results is not None:
            if missing:
                return self._finish(Phase.FAILED, f'the log lacks {", ".join(missing)}; {self._offline("it")}')
            if self.phase is Phase.DONE:
                return (Finish(self.phase, self.text),)
            return (*self._done(), Verify(self._taken(), self._results, self.phase))
        lost = sorted(seq for seq, _ in self._taken() - recorded)
        if not lost:
            self._losses, self._is_received, self._is_whole = 0, True, True
            return self._next(now)
        self._losses += 1
        if self._losses >= VERIFY_ROUNDS:
            return self._finish(Phase.FAILED, f'{counted(len(lost), "reading is", "readings are")} not in the log, '
                                f'target and answer, after asking again {counted(self._losses - 1, "time")}: the '
                                'recorder does not receive all messages; check its network and namespace')
        return (*self._drop(lost), *self._next(now))

    def not_verified(self, words: str, now: float) -> Commands:
        """Take note that the log could not be verified: the recorder may be about to be found disconnected."""
        self._in_doubt = frozenset()
        if self._held or self._asked is not None or self.phase in (Phase.CANCELLED, Phase.FAILED):
            return ()  # it is verified when the run has continued
        self._refusals += 1
        is_final = self._results is not None or self._refusals >= VERIFY_REFUSALS
        return (self._finish(Phase.FAILED, f'the log cannot be verified: {words}') if is_final else
                self.hold(f'the log cannot be verified yet: {words}', now))

    def tick(self, now: float) -> Commands:
        """Ask again or give up if an answer is late."""
        if self._deadline is None or now < self._deadline or self._in_doubt:
            return ()
        if self._held:
            limit = f'{self.limits.return_timeout:g} s'
            words = (f'and did not come back within {limit}; resume the run when it is connected' if self._is_gone else
                     f'for {limit}; end one of them and resume the run')
            return self._finish(Phase.FAILED, f'{self._held} {words}')
        if self.phase is Phase.EVALUATION:
            return self._finish(Phase.FAILED, 'wanted error motions from the evaluator within '
                                f'{self.limits.evaluation_timeout:g} s, got none; {self._offline("the log")}')
        return self._again(f'no answer within {self.limits.answer_timeout:g} s', now)

    def _offline(self, log: str) -> str:
        return f'all ball centres are in {log}: evaluate it offline' + ''.join(
            f'; {words} for a while: it may hold answers of both' for words in self.disturbed)

    def cancel(self, text: str = 'cancelled on request') -> Commands:
        """End early."""
        return () if self.phase.is_end else self._finish(Phase.CANCELLED, text)

    def fail(self, text: str) -> Commands:
        """End because something outside has failed."""
        return () if self.phase.is_end else self._finish(Phase.FAILED, text)

    def _next(self, now: float) -> Commands:
        """Ask for the next target that has no good answer yet; at their end verify, then wait for the evaluation."""
        published, commands = self.phase, list[Command]()
        while self._next_index < self.plan.total:
            target = self.plan.target(self._next_index)
            self._next_index += 1
            self.phase = Phase(target.phase)
            known, before = self.earlier.answer_to(target.seq), self.earlier.last_target(target.seq)
            if known is None or before is None or complaint(known, self._placed(target, 1), self.limits):
                planned, now_planned = self._planned_session, int(self.plan.session[target.seq - 1])
                if 0 < planned < now_planned:
                    return (*commands, *self._finish(Phase.CANCELLED, f'session {planned} of '
                                                     f'{self.plan.session[-1]} of the plan is measured; {PAUSE}'))
                self._tries, self._planned_session = 1, now_planned
                commands += [PublishState()] if published is not self.phase else []
                return (*commands, self._ask(target, now))
            self.answers.add_target(before)
            commands += self._take(target, known)
            if self.phase.is_end:
                return tuple(commands)
        return (*commands, *self._after_last(now))

    def _after_last(self, now: float) -> Commands:
        """Ask for the next target whose answer is not in the log, verify the log, or wait for the evaluation."""
        if self._asked_again:
            target = self.plan.target(self._asked_again.pop(0) - 1)
            self.phase, self._tries = Phase(target.phase), 1
            return (self._ask(target, now),)
        if self.verifies and not self._is_whole:
            return self._verify()
        self.phase, self.text = Phase.EVALUATION, 'waiting for the error motions'
        self._deadline = now + self.limits.evaluation_timeout
        return (PublishState(),)

    def _taken(self) -> frozenset[tuple[int, int]]:
        return frozenset((target.seq, answer.stamp_ns) for target, answer in self.answers.counting())

    def _verify(self) -> Commands:
        self.text, self._deadline = 'verifying the log', None
        return (Verify(self._taken()),)

    def _drop(self, lost: Collection[int]) -> Commands:
        """Let answers that the log lacks, by seq, not count, and ask for them again after the last target."""
        self._asked_again += lost
        for seq in lost:
            self.answers.drop_answers(seq)
        what = counted(len(lost), 'reading is', 'readings are')
        return Remark(f'{what} not in the log, target and answer; asking again'), PublishState()

    def _done(self) -> Commands:
        """Publish the last state; the run ends when that is in the log, too."""
        self.phase, self._deadline = Phase.DONE, None
        balls = ', '.join(f'table position {one.table_position} ball {one.ball}' for one in self.skipped)
        self.text = f'error motions are published{f"; {len(self.skipped)} left out: {balls}" * bool(balls)}'
        self.text += ''.join(f'; {words} for a while: what they published then is not used' for words in self.disturbed)
        return (PublishState(),)

    def _take(self, target: Target, answer: Answer) -> Commands:
        """Take a good answer to a target; with the last one of the alignment the table frame is found."""
        self.answers.add_answer(answer)
        self._skipped_last = self._is_whole = False
        if target.phase == Phase.ALIGNMENT and len(self._alignment) < self.plan.alignments:  # else asked again
            self._alignment.append(answer)
            if len(self._alignment) == self.plan.alignments:
                return self._align()
        return ()

    def _placed(self, target: Target, attempt: int) -> Target:
        """Return a target as it is asked now; where the one before has not just left the table there, with approach."""
        approach = target.approach if self._left_by == target.seq - 1 else int(self.plan.approach[target.seq - 1])
        return self.plan.placed(target, self._frame, self._frame_id)._replace(
            run_id=self.run_id, attempt=attempt, session=self.session, approach=approach)

    def _ask(self, target: Target, now: float) -> Command:
        before = self.answers.last_target(target.seq) or self.earlier.last_target(target.seq)
        self._asked = self._placed(target, 1 + (before.attempt if before else 0))
        self.answers.add_target(self._asked)
        self._deadline = now + self.limits.answer_timeout
        return Ask(self._asked)

    def _again(self, words: str, now: float, is_refused: bool = False) -> Commands:
        """Ask the present target again, unless it was refused, leave it out, or end the run; words: why."""
        target = self._asked
        if target is None:
            return ()
        if self._held:
            return (Remark(f'{target}, attempt {target.attempt}: {words}'),)
        if self._tries < self.limits.attempts and not is_refused:
            self._tries += 1
            return Remark(f'{target}, attempt {target.attempt}: {words}; asking again'), self._ask(target, now)
        times = 'once' if self._tries == 1 else f'{self._tries} times'
        words = f'{target}: asked {times}, last: {words}{self.plan.doubt_of_axis(target) if self._alignment else ""}'
        reason = self._why_not_skipped(target)
        if reason is not None:
            return self._finish(Phase.FAILED, f'{words}; {reason}'
                                f'{"what was measured is in the log" if self.done else "nothing was measured"}')
        self.skipped.append(target)
        self._asked, self._skipped_last = None, True
        return (Remark(f'{words}; left out, {len(self.skipped)} of at most {self.limits.skips}'), *self._next(now))

    def _why_not_skipped(self, target: Target) -> str | None:
        """Return why a target may not be left out, None where it may; empty: it is never done."""
        if not self.limits.skips or target.phase != Phase.RUN:
            return ''
        if self._skipped_last:
            return 'the ball before it was left out too: the CMM seems to be disconnected; '
        if len(self.skipped) >= self.limits.skips:
            return f'as many balls as allowed ({len(self.skipped)}) were left out already; '
        return None

    def _align(self) -> Commands:
        """Find the table frame from the alignment's centres; a CMM may know it already."""
        n = self.plan.scheme.n
        self._alignment[:n] = sorted(self._alignment[:n], key=lambda answer: answer.table_position)
        centres, frames = np.array([one.centre for one in self._alignment]), {one.frame for one in self._alignment}
        remarks = tuple(map(Remark, remarks_on_answers(self.answers.counting())))
        if frames == {TABLE_FRAME}:
            self._frame, self._frame_id = Frame.identity(), TABLE_FRAME
            return remarks
        if frames != {MACHINE_FRAME}:
            return self._finish(Phase.FAILED, f'alignment: wanted all centres in one frame, got '
                                f'{", ".join(sorted(frames))}')
        try:
            # Ball 1 was seen at the first table position; x is where it is at table angle 0.
            self._frame = table_frame(centres[:n], centres[n:]).turned(-self.plan.scheme.table_offset)
            refuse_other_axis(self._frame, self.plan.taught)
            refuse_other_sense(self._frame, centres[:n], centres[n:])
        except RosetteError as error:
            return self._finish(Phase.FAILED, f'alignment: {error}')
        return Locate(self._frame), *remarks

    def _finish(self, phase: Phase, text: str) -> Commands:
        self.phase, self.text = phase, text
        self._asked = self._deadline = None
        self._held = ''
        return PublishState(), Finish(phase, text)
