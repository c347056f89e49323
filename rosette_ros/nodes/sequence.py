# SPDX-License-Identifier: Apache-2.0
"""One calibration as a state machine: what to ask next, what an answer means, when to give up.

No ROS and no clock here: whoever drives it passes the time (steady, s) and carries out the
commands that each step returns.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from rosette_ros.core.alignment import table_frame
from rosette_ros.core.errors import RosetteError, plain
from rosette_ros.core.geometry import Frame, wrap
from rosette_ros.data.assemble import MACHINE_FRAME, TABLE_FRAME
from rosette_ros.nodes.programme import Answer, Phase, Programme, Target


@dataclass(frozen=True)
class Limits:
    """When to ask again and when to give up.

    answer_timeout, evaluation_timeout, return_timeout (how long a run waits for a node that has gone): s of
    steady time; attempts: how often a target is asked; skips:
    how many balls of the run may be left out after that, never two in a row; search, distance: how far
    a centre may lie from where it is expected, before and after the alignment, m; angle: how far the
    table may stand from the commanded angle, rad.
    """

    answer_timeout: float = 120.0
    attempts: int = 3
    skips: int = 0
    evaluation_timeout: float = 120.0
    return_timeout: float = 60.0
    search: float = 0.02
    distance: float = 0.005
    angle: float = 0.01


@dataclass(frozen=True, eq=False)
class Ask:
    """Send this target to the CMM; centre: (3,) in the frame `frame_id`, m."""

    target: Target
    attempt: int
    session: int
    centre: np.ndarray
    frame_id: str


@dataclass(frozen=True, eq=False)
class Locate:
    """Make known where the table frame is in the machine frame."""

    frame: Frame


@dataclass(frozen=True)
class Tell:
    """Make the state known: the phase has changed."""


@dataclass(frozen=True)
class Verify:
    """Find out which answers are in the log, and tell `verified`; answers: how many there shall be."""

    answers: int


@dataclass(frozen=True)
class Remark:
    """Write a warning into the log."""

    text: str


@dataclass(frozen=True)
class Finish:
    """The calibration has ended in this phase, for this reason."""

    phase: Phase
    text: str


class Verdict(Enum):
    """What an answer is good for."""

    USE = 'use'
    NOT_ASKED = 'not asked'
    UNUSABLE = 'unusable'


def judge(answer, ask, run_id, limits):
    """Return (Verdict, words) for an answer while `ask` waits for one (None: nothing waits)."""
    if answer.run_id != run_id:
        return Verdict.NOT_ASKED, f'answer to run {answer.run_id!r}, this is {run_id!r}'
    if ask is None or answer.seq != ask.target.seq:
        waiting = 'nothing' if ask is None else f'seq {ask.target.seq}'
        return Verdict.NOT_ASKED, f'answer to seq {answer.seq}, waiting for {waiting}'
    for complaint in (_identity, _failure, _numbers, _place):
        words = complaint(answer, ask, limits)
        if words:
            return Verdict.UNUSABLE, words
    return Verdict.USE, ''


def _identity(answer, ask, limits):
    target = ask.target
    wanted = (target.table_position, target.ball, target.cmm_position)
    got = (answer.table_position, answer.ball, answer.cmm_position)
    if wanted != got:
        return f'wanted table position, ball, CMM position {wanted}, got {got}'
    return ''


def _failure(answer, ask, limits):
    if not answer.ok:
        return f'the CMM reports: {plain(answer.text) or "failed, without a reason"}'
    return ''


def _numbers(answer, ask, limits):
    numbers = (*answer.centre, answer.table_angle, answer.table_travel)
    if not np.isfinite(numbers).all():
        return ('wanted finite numbers, got centre '
                f'{tuple(map(float, answer.centre))}, table_angle {answer.table_angle}, '
                f'table_travel {answer.table_travel}')
    return ''


def _place(answer, ask, limits):
    frame = short_frame(answer.frame_id)
    if frame not in (MACHINE_FRAME, TABLE_FRAME):
        return f'wanted frame_id {MACHINE_FRAME!r} or {TABLE_FRAME!r}, got {answer.frame_id!r}'
    if frame == MACHINE_FRAME and ask.frame_id == TABLE_FRAME:
        return f'wanted frame_id {TABLE_FRAME!r} as in the alignment, got {answer.frame_id!r}'
    turned = float(wrap(answer.table_angle - ask.target.table_angle))
    if abs(turned) > limits.angle:
        return (f'wanted the table within {limits.angle:g} rad of '
                f'{ask.target.table_angle:.6f} rad, got {answer.table_angle:.6f} rad')
    aligned = ask.target.phase not in (Phase.REPEATABILITY, Phase.ALIGNMENT)
    limit = limits.distance if aligned else limits.search
    wanted = ask.centre if frame == short_frame(ask.frame_id) else ask.target.nominal
    away = float(np.linalg.norm(answer.centre - wanted))
    if away > limit:
        return f'wanted a ball within {1e3 * limit:g} mm of the target, got {1e3 * away:.3f} mm'
    return ''


def short_frame(frame_id):
    """Return a frame's name without what stands before it: `cell1/table` is a table frame."""
    return frame_id.rsplit('/', 1)[-1]


@dataclass(frozen=True)
class Earlier:
    """What an earlier part of a run has left: answers by seq, of each target the last attempt by seq, the
    last session."""

    answers: dict
    attempts: dict
    session: int


NOTHING_EARLIER = Earlier({}, {}, 0)
VERIFY_REFUSALS = 20
"""A recorder that refuses to be asked so often has no log open, and is the one that is known."""
VERIFY_ROUNDS = 3
"""So often the log is verified at the end of a run, and what it lacks asked for again."""


class Sequence:
    """The state of one calibration.

    Every step takes the steady time `now` in s and returns the commands (Ask, Locate, Tell, Verify,
    Remark, Finish) that follow from it, in order. Where an earlier part of the run has good answers, these
    are taken and only the rest is asked.
    """

    def __init__(self, run_id: str, programme: Programme, limits: Limits, earlier: Earlier = NOTHING_EARLIER,
                 verifies=False):
        """Prepare; nothing is asked before begin(). verifies: whether there is a log to be verified."""
        self.run_id = run_id
        self.programme = programme
        self.limits = limits
        self.phase = Phase.IDLE
        self.done = 0
        self.skipped = []
        self.text = 'ready'
        self.session = earlier.session + 1
        self.verifies = verifies
        self._earlier = earlier
        self._taken = {}
        self._again_wanted = []
        self._rounds = self._refusals = 0
        self._at = 0
        self._tries = self._ask_seq = self._last_attempt = 0
        self._missed_last = True
        self._ask = None
        self._held = ''
        self._deadline = None
        self._frame = programme.taught
        self._frame_id = MACHINE_FRAME
        self._alignment = []

    def begin(self, now):
        """Ask for the first target."""
        return self._next(now)

    def answer(self, answer: Answer, now):
        """Take an answer of the CMM."""
        verdict, words = judge(answer, self._ask, self.run_id, self.limits)
        if verdict is Verdict.NOT_ASKED:
            return (Remark(f'not used: {words}'),)
        if verdict is Verdict.UNUSABLE:
            return self._again(words, now)
        target, self._ask = self._ask.target, None
        commands = self._take(target, answer)
        return commands if self.phase.is_end or self._held else (*commands, *self._next(now))

    def hold(self, words, now):
        """Ask for nothing more until go_on; answers are still taken. words: why, for a person."""
        if self.phase.is_end or self.phase is Phase.EVALUATION:
            return ()
        self._held = words
        self._deadline = now + self.limits.return_timeout
        return Remark(f'{words}; the run waits for it'), Tell()

    @property
    def is_held(self):
        """Whether nothing more is asked until go_on."""
        return bool(self._held)

    def go_on(self, now, anew):
        """Go on after hold; anew: a pause lies between, what is on is asked again."""
        if not self._held or self.phase.is_end:
            return ()
        self._held = ''
        self.session += anew
        words = Remark('the run goes on' + (f' in session {self.session}' if anew else ''))
        if self._ask is None:
            return (words, *self._next(now))
        if not anew:
            self._deadline = now + self.limits.answer_timeout
            return words, Tell()
        return words, Tell(), self._put(self._ask.target, self._ask.attempt + 1, now)

    def evaluated(self, now):
        """Take note that the error motions of this run are published."""
        if self.phase is not Phase.EVALUATION:
            return ()
        return self._finish(Phase.DONE, f'error motions are published{self._left_out()}')

    def tick(self, now):
        """Look at the time: ask again or give up if an answer is late."""
        if self._deadline is None or now < self._deadline:
            return ()
        if self._held:
            return self._finish(Phase.FAILED, f'{self._held} and did not come back within '
                                f'{self.limits.return_timeout:g} s; resume the run when it is there')
        if self.phase is Phase.EVALUATION:
            return self._finish(Phase.FAILED, (
                f'wanted error motions from the evaluator within '
                f'{self.limits.evaluation_timeout:g} s, got none; all ball centres are in the '
                'log: evaluate it offline'))
        return self._again(f'no answer within {self.limits.answer_timeout:g} s', now)

    def cancel(self, text='cancelled on request'):
        """End early."""
        return () if self.phase.is_end else self._finish(Phase.CANCELLED, text)

    def fail(self, text):
        """End because something outside has failed."""
        return () if self.phase.is_end else self._finish(Phase.FAILED, text)

    def describe(self):
        """Return one sentence for a person about what happens now."""
        if self._held and not self.phase.is_end:
            return f'{self._held}; waiting for it'
        if self._ask is None:
            return self.text
        target = self._ask.target
        place, size = self.programme.place_in_phase(target.seq - 1)
        again = '' if self._ask.attempt == 1 else f', attempt {self._ask.attempt}'
        return (f'{target.phase.name.lower().replace("_", " ")} {place} of {size}: table position '
                f'{target.table_position}, ball {target.ball}{again}')

    def _next(self, now):
        """Ask for the next target that has no good answer yet."""
        told, commands = self.phase, []
        while self._at < self.programme.total:
            target = self.programme.target(self._at)
            self._at += 1
            self.phase = target.phase
            known = self._earlier.answers.get(target.seq)
            if known is None or not self._is_good(known, target):
                self._tries = 1
                ask = self._put(target, self._earlier.attempts.get(target.seq, 0) + 1, now)
                return (*commands, *((Tell(),) if told is not target.phase else ()), ask)
            commands += self._take(target, known)
            if self.phase.is_end:
                return tuple(commands)
        return (*commands, *self._next_again(now))

    def _next_again(self, now):
        """Ask for the next target whose answer is not in the log; at their end, verify, then evaluate."""
        if self._again_wanted:
            target = self.programme.target(self._again_wanted.pop(0) - 1)
            self.done -= 1
            self.phase, self._tries = target.phase, 1
            attempts = self._taken.pop(target.seq)[1]
            return (self._put(target, attempts + 1, now),)
        if self.verifies and self._rounds < VERIFY_ROUNDS:
            self.text, self._deadline = 'verifying the log', None
            return (Verify(len(self._taken)),)
        self.phase, self.text = Phase.EVALUATION, 'waiting for the error motions'
        self._deadline = now + self.limits.evaluation_timeout
        return (Tell(),)

    def not_verified(self, words, now):
        """Take note that the log could not be verified: the recorder may be about to be missed."""
        self._refusals += 1
        if self._refusals >= VERIFY_REFUSALS:
            return self.fail(f'the log cannot be verified: {words}')
        return self.hold(f'the log cannot be verified yet: {words}', now)

    def verified(self, stamps, now):
        """Take note of what is in the log, seq to the stamps of its answers, ns; ask again for the rest."""
        if self.phase.is_end:
            return ()
        self._rounds += 1
        lost = [seq for seq, (stamp, _) in self._taken.items() if stamp not in stamps.get(seq, ())]
        if not lost:
            self._rounds = VERIFY_ROUNDS
            return self._next(now)
        words = f'{len(lost)} answers are not in the log'
        if self._rounds >= VERIFY_ROUNDS:
            return self._finish(Phase.FAILED, f'{words}, after asking for them {self._rounds - 1} times: the '
                                'recorder does not hear the CMM; look at its network and namespace')
        self._again_wanted = sorted(lost)
        return (Remark(f'{words}; asking for them again'), *self._next(now))

    def _take(self, target, answer):
        """Take a good answer to a target; the last one of the alignment tells the table frame."""
        self.done += 1
        self._taken[target.seq] = answer.stamp_ns, self._attempt_of(target)
        self._missed_last = False
        if target.phase is Phase.ALIGNMENT:
            if len(self._alignment) == 2 * target.balls:
                return ()  # asked again for the log alone
            self._alignment.append((answer.centre, short_frame(answer.frame_id)))
            if len(self._alignment) == 2 * target.balls:
                return self._align()
        return ()

    def _attempt_of(self, target):
        """Return the attempt at which a target that has just been answered was asked last."""
        return self._last_attempt if self._ask_seq == target.seq else self._earlier.attempts.get(target.seq, 0)

    def _is_good(self, answer, target):
        """Whether an answer of an earlier part of the run would be used now."""
        return judge(answer, self._asked(target, 1), self.run_id, self.limits)[0] is Verdict.USE

    def _asked(self, target, attempt):
        return Ask(target, attempt, self.session, self._frame.to_outer(target.nominal), self._frame_id)

    def _put(self, target, attempt, now):
        self._ask = self._asked(target, attempt)
        self._ask_seq, self._last_attempt = target.seq, attempt
        self._deadline = now + self.limits.answer_timeout
        return self._ask

    def _again(self, words, now):
        target, attempt = self._ask.target, self._ask.attempt
        if self._held:
            return (Remark(f'{target}, attempt {attempt}: {words}'),)
        if self._tries >= self.limits.attempts:
            times = 'once' if self._tries == 1 else f'{self._tries} times'
            words = f'{target}: asked {times}, last: {words}'
            reason = self._why_not_skipped(target)
            if reason is not None:
                return self._finish(Phase.FAILED, f'{words}; {reason}what was measured is in the log')
            self.skipped.append(target)
            self._ask, self._missed_last = None, True
            return (Remark(f'{words}; left out, {len(self.skipped)} of at most {self.limits.skips}'),
                    *self._next(now))
        self._tries += 1
        return (Remark(f'{target}, attempt {attempt}: {words}; asking again'),
                self._put(target, attempt + 1, now))

    def _why_not_skipped(self, target):
        """Return why a target may not be left out, None where it may; empty: it is never done."""
        if not self.limits.skips or target.phase is not Phase.RUN:
            return ''
        if self._missed_last:
            return 'the ball before it was left out too: the CMM seems to be gone; '
        if len(self.skipped) >= self.limits.skips:
            return f'as many balls as allowed ({len(self.skipped)}) were left out already; '
        return None

    def _left_out(self):
        """Say which balls were left out."""
        if not self.skipped:
            return ''
        balls = ', '.join(f'table position {one.table_position} ball {one.ball}' for one in self.skipped)
        return f'; {len(self.skipped)} left out: {balls}'

    def _align(self):
        """Find the table frame from the alignment's centres; a CMM may know it already."""
        n = self.programme.scheme.n
        centres = np.array([centre for centre, _ in self._alignment])
        frames = {frame for _, frame in self._alignment}
        if frames == {TABLE_FRAME}:
            self._frame, self._frame_id = Frame.identity(), TABLE_FRAME
            return ()
        if frames != {MACHINE_FRAME}:
            return self._finish(Phase.FAILED, f'alignment: wanted all centres in one frame, got '
                                f'{", ".join(sorted(frames))}')
        try:
            self._frame = table_frame(centres[:n], centres[n:])
        except RosetteError as error:
            return self._finish(Phase.FAILED, f'alignment: {error}')
        return (Locate(self._frame),)

    def _finish(self, phase, text):
        self.phase, self.text = phase, text
        self._ask = self._deadline = None
        self._held = ''
        return Tell(), Finish(phase, text)
