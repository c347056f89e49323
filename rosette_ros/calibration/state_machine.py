# SPDX-License-Identifier: Apache-2.0
"""One calibration as a state machine: what to ask next, what an answer means, when to give up.

Whoever drives it passes the time (steady, s) and carries out the commands that each step returns."""

import math
from array import array
from collections import deque
from collections.abc import Callable, Collection

import numpy as np

from rosette_ros.calibration.calibration_plan import CalibrationPlan
from rosette_ros.calibration.commands import (
    Ask,
    AskNext,
    Command,
    Commands,
    Extended,
    Finish,
    Limits,
    Locate,
    PublishRun,
    PublishState,
    Results,
    Until,
    Verify,
    Warn,
)
from rosette_ros.core.run.axes import refuse_other_axis, refuse_other_sense
from rosette_ros.core.run.errors import InvalidPlan, RosetteError, plain
from rosette_ros.core.run.geometry import Frame, table_frame, wrap
from rosette_ros.core.run.remarks import Remark, RemarkKind, remark
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.io.messages import FRAMES, MACHINE_FRAME, STATUS_OK, TABLE_FRAME, Answer, Phase, Target, short_frame
from rosette_ros.io.reading_checks import remarks_on_answers
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.words.reading_words import remark_words
from rosette_ros.words.settling_words import settled_words, settling_words

PACE_OF, PACE_FROM, TOLD_FROM = 60, 6, 90.0
"""The remaining time follows from the pace of so many answers, at least of so many; a shorter one is not told, s."""
LONGEST_SHARE = 2
"""Waits of a block may last so many times as long as the run has taken."""


def complaint(answer: Answer, target: Target, limits: Limits,
              frames: Collection[str] = FRAMES) -> Remark | None:
    """Return why an answer is no measurement of its target, None where it is one; frames: in which it may be."""
    wanted, got = ((one.table_position, one.ball, one.cmm_position) for one in (target, answer))
    if wanted != got:
        return remark(RemarkKind.OTHER_BALL, wanted=wanted, got=got)
    if answer.status != STATUS_OK:
        return remark(RemarkKind.CMM_FAILED, reason=plain(answer.text))
    if not answer.is_finite:
        return remark(RemarkKind.NOT_FINITE, centre=answer.centre, angle=answer.table_angle,
                      travel=answer.table_travel)
    frame, asked = answer.frame, short_frame(target.frame_id)
    if frame not in frames:
        return remark(RemarkKind.OTHER_FRAME, frames=tuple(frames), got=answer.frame_id)
    if abs(float(wrap(answer.table_angle - target.table_angle))) > limits.angle:
        degrees = abs(float(wrap(np.deg2rad(answer.table_angle) - target.table_angle))) <= limits.angle
        return remark(RemarkKind.OTHER_ANGLE, limit=limits.angle, wanted=target.table_angle, got=answer.table_angle,
                      is_in_degrees=degrees)
    limit = limits.search if target.phase in (Phase.REPEATABILITY, Phase.ALIGNMENT) else limits.distance
    expected = target.centre if frame == asked else target.place
    away = math.dist(answer.centre, expected)
    if away <= limit:
        return None
    millimetres = math.dist([1e-3 * one for one in answer.centre], expected) <= limit
    return remark(RemarkKind.FAR_AWAY, limit=limit, away=away, is_in_millimetres=millimetres)


class Sequence:
    """The state of one calibration; every step takes the steady time `now`, s, and returns the commands that follow.

    Good answers of an earlier part of the run are taken, and only the rest is asked. `answers` holds all that was asked
    and received, as the log does; is_paused: whether the run has ended where its plan has a pause, to be resumed."""

    def __init__(self, run_id: str, plan: CalibrationPlan, limits: Limits, earlier: RunAnswers | None = None,
                 verifies: bool = False, until: Until | None = None) -> None:
        """Prepare; nothing is asked before begin().

        earlier: what the log of an earlier part holds; verifies: whether a log is there; until: when no more readings
        are added to the plan, None: none are."""
        self.run_id, self.plan, self.limits, self.verifies = run_id, plan, limits, verifies
        self.until, self.is_settling, self.open = until, until is not None, ''
        self.answers = earlier or RunAnswers(run_id)
        self.phase, self.text, self.is_paused = Phase.IDLE, 'ready', False
        self.skipped: list[Target] = []
        self.session = self.answers.session + 1
        self._asked: Target | None = None
        self.clock: Callable[[], int] = lambda: 0  # the ROS time, ns
        self._latest = max((*(one.stamp_ns for one in self.answers.targets),
                            *(one.stamp_ns for one in self.answers.answers)), default=0)
        self._taken, self._alignment = set[int](), list[Answer]()
        self._next_index = self._tries = self._planned_session = self._left_by = 0
        self._results: Results | None = None
        self._kept: Results | None = None  # the last ones, which may be asked for again
        self._held, self._is_gone, self.disturbed = '', True, list[str]()
        self._skipped_last, self._is_aligned_again = True, False
        self._deadline: float | None = None
        self._frame, self._frame_id = plan.taught, MACHINE_FRAME
        self._unused = array('q')  # seq of the answers that came while another was waited for
        self._early = 0  # answers to targets that had not been asked
        self._pace = deque[float](maxlen=PACE_OF)  # when the last answers were taken, since the last pause

    @property
    def done(self) -> int:
        """Number of targets with an answer that was taken."""
        return len(self._taken)

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
        why = f'{self.open}; ' if self.open and self.is_settling and not self.phase.is_end else ''
        if target is None:
            return f'{why}{self.text}'
        place, size = self.plan.place_in_phase(target.seq - 1)
        again = '' if target.attempt == 1 else f', attempt {target.attempt}'
        left = f', about {left / 60:.0f} min left' if (left := self.left or 0) > TOLD_FROM else ''
        return (f'{why}{Phase(target.phase).name.lower().replace("_", " ")} {place} of {size}: table position '
                f'{target.table_position}, ball {target.ball}{again}{left}')

    def begin(self, now: float) -> Commands:
        """Ask for the first target."""
        return self._next(now)

    def answer(self, answer: Answer, now: float) -> Commands:
        """Take an answer of the CMM."""
        target = self._asked
        if answer.run_id == self.run_id:
            self.answers.add_answer(answer)
        else:
            return (Warn(f'not used: answer to run {answer.run_id!r}, this is {self.run_id!r}; an answer repeats '
                           'run_id and seq of its target'),)
        if target is None or answer.seq != target.seq:
            self._unused.append(answer.seq)
            self._early += answer.seq > self._next_index
            return ()
        if doubt := complaint(answer, target, self.limits, self.answers.in_frames):
            return (*self._not_used(), *self._again(remark_words(doubt), now, answer.is_refused))
        commands = self._not_used()
        self._asked, self._left_by = None, target.seq
        commands += self._take(target, answer)
        self._pace.append(now)
        if self.phase.is_end or self._held:
            return commands
        return (*commands, *self._next(now))

    def _not_used(self) -> Commands:
        """Return what became of the answers to others than the target that was waited for, in one remark."""
        seqs, self._unused = self._unused, array('q')
        if not seqs:
            return ()
        several, low, high = len(seqs), min(seqs), max(seqs)
        what = f'{several} answers' if several > 1 else 'answer'
        waiting = f'seq {self._asked.seq}' if self._asked else 'nothing'
        return (Warn(f'not used: {what} to seq {low}{f" to {high}" * (high > low)}, waiting for {waiting}'),)

    def hold(self, words: str, now: float, is_gone: bool = True) -> Commands:
        """Ask for nothing more until resume_asking; answers are still taken.

        words: why, for a person; is_gone: whether something has to come back, and not to go."""
        if self.phase.is_end:
            return ()
        self._held, self._is_gone = words, is_gone
        if not is_gone and words not in self.disturbed:
            self.disturbed.append(words)
        self._deadline = now + self.limits.return_timeout
        return Warn(f'{words}; the run waits for {"it" if is_gone else "the end of one"}'), PublishState()

    def resume_asking(self, now: float, restarted: bool) -> Commands:
        """Continue after hold; restarted: a pause lies between, the present target is asked again."""
        if not self._held or self.phase.is_end:
            return ()
        self._held = ''
        self._pace.clear()
        self.session += restarted
        self._left_by = 0 if restarted else self._left_by
        remark = Warn('the run continues' + (f' in session {self.session}' if restarted else ''))
        if self.phase is Phase.EVALUATION:
            return (remark, *self._evaluate(now))
        if self._asked is None:
            return (remark, *self._next(now))
        if not restarted:
            self._deadline = now + self.limits.answer_timeout
            return remark, PublishState()
        return remark, PublishState(), self._ask(self._asked, now)

    def begin_session(self) -> Commands:
        """Take note that another CMM measures from now on: a pause lies between."""
        self.session, self._left_by = self.session + 1, 0
        self._pace.clear()
        return (Warn(f'the CMM was restarted; the run continues in session {self.session}'),)

    def evaluated(self, results: Results) -> Commands:
        """Take the results of these readings that the evaluator has published: the log has to hold them.

        Those of other readings, of an earlier attempt, are passed over."""
        if (self.phase is not Phase.EVALUATION or self._results is not None or self._held
                or results.readings_hash != self.answers.readings_hash):
            return ()
        self._results = self._kept = results
        if not self.is_settling or self.until is None:
            return self._check(results)
        self.text, self._deadline = 'asking the evaluator which readings settle what is open', None
        return AskNext(results, max(self._left_to_add, 1)), PublishState()

    @property
    def _left_to_add(self) -> int:
        """How many readings may still be added to the plan."""
        most = self.until.most if self.until else 0
        return (most or self.plan.scheme.ball.size) - self.plan.added.ball.size

    def refuse_block(self, block: Scheme) -> None:
        """Raise InvalidPlan where a block has more readings than may be added, or waits longer than a run needs.

        Its waits decide between effects in time, for which a part of the time that the run has taken is enough."""
        stamps, most = [one.stamp_ns for one in self.answers.answers], max(self._left_to_add, 1)
        longest = LONGEST_SHARE * 1e-9 * (max(stamps, default=0) - min(stamps, default=0))
        if block.ball.size > most or block.wait.sum() > longest:
            raise InvalidPlan(f'readings that are added: expected at most {most}, with waits of at most {longest:.0f} '
                              's, '
                              f'{LONGEST_SHARE} times as long as the run has taken, found {block.ball.size} with waits '
                              f'of {block.wait.sum():.0f} s')

    def decided(self, block: Scheme | None, text: str, now: float, is_settled: bool = False) -> Commands:
        """Take the readings that follow, None where none do; text: what is settled or open."""
        if self.phase is not Phase.EVALUATION or self._results is None or self._held or not self.is_settling:
            return ()
        if block is not None and self._left_to_add > 0:
            self.plan, self.open = self.plan.followed_by(block), settling_words(text)
            return Extended(self.open), *self._next(now)
        self.is_settling = False
        self.open = settled_words(text, is_settled, self.plan.added.ball.size if block is not None else 0)
        more = self._next(now) if self._next_index < self.plan.total else self._check(self._results)
        return Extended(self.open), *more

    def not_answered(self, words: str) -> Commands:
        """Take note that the evaluator does not answer: the run ends with the results that it has published.

        What is still planned would have to be evaluated, too, and is left out."""
        if self.phase is not Phase.EVALUATION or self._results is None or self._held or not self.is_settling:
            return ()
        left = 'without the drift check, ' * (self._next_index < self.plan.total)
        self.is_settling, self.open = False, f'{left}{settled_words(words, False)}'
        return Extended(self.open), *self._check(self._results)

    def not_decided(self, words: str, now: float) -> Commands:
        """Take note that the evaluator has not said what follows: it is given the run again, not for ever."""
        if self.phase is not Phase.EVALUATION or self._results is None or self._held or not self.is_settling:
            return ()
        self._tries += 1
        if self._tries > self.limits.attempts:
            return self.decided(None, words, now)
        return Warn(f'the next readings are not known: {words}; asking again'), *self._evaluate(now)

    def _check(self, results: Results) -> Commands:
        if not self.verifies:
            return self._done()
        self.text, self._deadline = 'verifying that the log holds the results', None
        return (Verify(results),)

    def verified(self, missing: Collection[str]) -> Commands:
        """Take what is missing from the log, in words: then the run has failed."""
        if self.phase is not Phase.EVALUATION or self._held:
            return ()
        if missing:
            return self._finish(Phase.FAILED, f'the log lacks {", ".join(missing)}; '
                                f'{self._disturbed("evaluate it offline, or resume the run")}')
        return self._done()

    def not_verified(self, words: str, now: float) -> Commands:
        """Take note that the recorder has not said what the log holds: the run waits for it, not for ever."""
        if self.phase is not Phase.EVALUATION or self._held:
            return ()
        words, self._tries = f'the log cannot be verified: {words}', self._tries + 1
        return self._finish(Phase.FAILED, words) if self._tries > self.limits.attempts else self.hold(words, now)

    def tick(self, now: float) -> Commands:
        """Ask again or give up if an answer is late."""
        if self._deadline is None or now < self._deadline:
            return ()
        if self._held:
            limit = f'{self.limits.return_timeout:g} s'
            words = (f'and did not come back within {limit}; resume the run when it is connected' if self._is_gone else
                     f'for {limit}; end one of them and resume the run')
            return self._finish(Phase.FAILED, f'{self._held} {words}')
        if self.phase is Phase.EVALUATION:
            words = f'expected error motions from the evaluator within {self.limits.evaluation_timeout:g} s, found none'
            if self._kept and self._kept.readings_hash == self.answers.readings_hash:  # it was to evaluate them again
                self._results = self._kept
                return self.not_answered(words) if self.is_settling else self._check(self._kept)
            return self._finish(Phase.FAILED, f'{words}; '
                                + self._disturbed('all ball centres are in the log: evaluate it offline'))
        return (*self._not_used(), *self._again(f'no answer within {self.limits.answer_timeout:g} s', now))

    def _disturbed(self, advice: str) -> str:
        return advice + ''.join(f'; {words} for a while: it may hold answers of both' for words in self.disturbed)

    def cancel(self, text: str = 'cancelled on request') -> Commands:
        """End early."""
        return () if self.phase.is_end else self._finish(Phase.CANCELLED, text)

    def fail(self, text: str) -> Commands:
        """End because something outside has failed."""
        return () if self.phase.is_end else self._finish(Phase.FAILED, text)

    def _next(self, now: float) -> Commands:
        """Ask for the next target that has no good answer yet; at their end wait for the evaluation."""
        published, commands = self.phase, list[Command]()
        while self._next_index < self.plan.total:
            target = self.plan.target(self._next_index)
            if self.is_settling and target.phase == Phase.DRIFT_CHECK:
                break
            self._next_index += 1
            self.phase = Phase(target.phase)
            known, before = self.answers.answer_to(target.seq), self.answers.last_target(target.seq)
            if known is None or before is None or complaint(known, self._placed(target, 1), self.limits):
                planned, now_planned = self._planned_session, int(self.plan.session[target.seq - 1])
                if 0 < planned < now_planned:
                    self.is_paused = True
                    return (*commands, *self._finish(
                        Phase.CANCELLED, f'session {planned} of {self.plan.session[-1]} of the plan is measured; the '
                        'plan has a pause here, resume the run after it'))
                self._tries, self._planned_session = 1, now_planned
                commands += [PublishState()] if published is not self.phase else []
                return (*commands, self._ask(target, now))
            commands += self._take(target, known)
            if self.phase.is_end:
                return tuple(commands)
        self.phase, self._tries = Phase.EVALUATION, 0
        return (*commands, *self._evaluate(now))

    def _evaluate(self, now: float) -> Commands:
        self.text, self._results = 'waiting for the error motions', None
        self._deadline = now + self.limits.evaluation_timeout
        return PublishRun(), PublishState()

    def _done(self) -> Commands:
        """Publish the last state and end."""
        self.phase, self._deadline = Phase.DONE, None
        balls = ', '.join(f'table position {one.table_position} ball {one.ball}' for one in self.skipped)
        self.text = f'error motions are published{f"; {len(self.skipped)} left out: {balls}" * bool(balls)}'
        self.text += f'; {self.open}' if self.open else ''
        self.text += ''.join(f'; {words} for a while: what they published then is not used' for words in self.disturbed)
        return *self._not_used(), PublishState(), Finish(self.phase, self.text)

    def _take(self, target: Target, answer: Answer) -> Commands:
        """Take a good answer to a target; with the last one of the alignment the table frame is found."""
        self._taken.add(target.seq)
        self._latest, self._skipped_last = max(self._latest, answer.stamp_ns), False
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
        before = self.answers.last_target(target.seq)
        wait = 0.0 if before else float(self.plan.wait[target.seq - 1])
        self._asked = self._placed(target, 1 + (before.attempt if before else 0))._replace(stamp_ns=self._stamp(wait))
        self.answers.add_target(self._asked)
        self._deadline = now + wait + self.limits.answer_timeout
        return Ask(self._asked, wait)

    def is_asked(self, target: Target) -> bool:
        """Return whether this is the target that is waited for."""
        return self._asked is target and not self._held

    def _stamp(self, wait: float = 0.0) -> int:
        """Return the ROS time after a wait, s, in ns, in a run never less than before, nor than that of an answer that
        was taken."""
        self._latest = max(self._latest, self.clock()) + round(1e9 * wait)
        return self._latest

    def _again(self, words: str, now: float, is_refused: bool = False) -> Commands:
        """Ask the present target again, unless it was refused, leave it out, or end the run; words: why."""
        target = self._asked
        if target is None:
            return ()
        if self._held:
            return (Warn(f'{target}, attempt {target.attempt}: {words}'),)
        if self._tries < self.limits.attempts and not is_refused:
            self._tries += 1
            return Warn(f'{target}, attempt {target.attempt}: {words}; asking again'), self._ask(target, now)
        times = 'once' if self._tries == 1 else f'{self._tries} times'
        doubt = self._doubt or (self.plan.doubt_of_axis(target) if self._alignment else '')
        words = f'{target}: asked {times}, last: {words}{doubt}'
        reason = self._why_not_skipped(target)
        if reason is not None:
            return self._finish(Phase.FAILED, '; '.join(filter(None, (words, reason))))
        self.skipped.append(target)
        self._asked, self._skipped_last = None, True
        return (Warn(f'{words}; left out, {len(self.skipped)} of at most {self.limits.skips}'), *self._next(now))

    @property
    def _doubt(self) -> str:
        """That the CMM answers ahead, by which an answer may be taken for that of another target, in words."""
        return (f'; {self._early} answers were to targets that had not been asked: the CMM has to answer the target '
                'that is asked, once') if self._early else ''

    def _why_not_skipped(self, target: Target) -> str | None:
        """Return why a target may not be left out, None where it may; empty: it is never done."""
        if not self.limits.skips or target.phase != Phase.RUN:
            return ''
        if self._skipped_last:
            return 'the ball before it was left out too: the CMM seems to be disconnected'
        if len(self.skipped) >= self.limits.skips:
            return f'as many balls as allowed ({len(self.skipped)}) were left out already'
        return None

    def _align(self) -> Commands:
        """Find the table frame from the alignment's centres; a CMM may know it already."""
        n = self.plan.scheme.n
        self._alignment[:n] = sorted(self._alignment[:n], key=lambda answer: answer.table_position)
        known = [self.answers.answer_to(seq) for seq in self._taken]
        if None in known or {one.frame for one in self._alignment} != {*self.answers.in_frames}:
            words = f'alignment: expected all centres in {self.answers.in_frames[0]!r} as most, found others before'
            if self._is_aligned_again:
                return self._finish(Phase.FAILED, words)
            self._alignment, self._taken, self._next_index, self._is_aligned_again = [], set(), 0, True
            return (Warn(f'{words}; asking again'),)
        centres = np.array([one.centre for one in self._alignment])
        remarks = tuple(Warn(remark_words(one)) for one in remarks_on_answers(self.answers.counting()))
        if self.answers.is_in_table_frame:
            self._frame, self._frame_id = Frame.identity(), TABLE_FRAME
            return remarks
        try:
            # Ball 1 was seen at the first table position; x is where it is at table angle 0.
            self._frame = table_frame(centres[:n], centres[n:]).turned(-self.plan.scheme.table_offset)
            refuse_other_axis(self._frame, self.plan.taught)
            refuse_other_sense(self._frame, centres[:n], centres[n:])
        except RosetteError as error:
            return self._finish(Phase.FAILED, f'alignment: {self._doubt.removeprefix("; ") or error}')
        return Locate(self._frame, self._stamp()), *remarks

    def _finish(self, phase: Phase, text: str) -> Commands:
        remarks, self.phase, self.text = self._not_used(), phase, text
        self._asked = self._deadline = None
        self._held = ''
        return *remarks, PublishState(), Finish(phase, text)
