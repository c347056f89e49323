# SPDX-License-Identifier: Apache-2.0
"""Which targets, answers and table frames of a run exist, and which of the answers count.

Sequencer, evaluator, recorder, log reader and studio all keep them here: the same messages are the same readings."""

import hashlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping

from rosette_ros.io import messages
from rosette_ros.io.messages import FRAMES, TABLE_FRAME, Answer, Phase, Rows, TableFrame, Target

MOST_EARLY, MOST_ANSWERS = 10_000, 100  # kept of a run: answers to no target so far, answers to one target


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
                (answered.add if self.usable(target, (name,)) else answered.discard)(seq)

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

    def asked(self) -> Iterator[Target]:
        """Yield the targets as they were asked last."""
        return (self.targets[row] for row in self._last.values())

    @property
    def session(self) -> int:
        """The last session of the run, 0 before the first target."""
        return max((target.session for target in self.asked()), default=0)

    def usable(self, target: Target, frames: Collection[str] = ()) -> dict[int, Answer]:
        """Return the answers that may count for a target, by their rows."""
        frames = frames or self.in_frames
        return {row: answer for row in self._by_seq.get(target.seq, ())
                if (answer := self.answers[row]).frame in frames and answer.is_usable_for(target)}

    def _counting(self, some: Iterable[int] | None = None) -> Iterator[tuple[Target, int, Answer]]:
        """Yield targets, as asked last, with the answers that count for them and their rows; some: their seq."""
        for seq in sorted(self._last) if some is None else some:
            target = self.last_target(seq)
            if target is not None and (usable := self.usable(target)):
                row = next((row for row, one in usable.items() if one.stamp_ns >= target.stamp_ns), next(iter(usable)))
                yield target, row, usable[row]

    def count_to(self, seq: int) -> int:
        """Return how many answers there are to a target, whether they count or not."""
        return len(self._by_seq.get(seq, ()))

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
        asked = Counter(target.phase for target in self.asked())
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
            return (f'expected {expected} targets with answers, found {len(self._last)} targets and answers to '
                    f'{self.answered} of them')
        begun = {(one.session, one.phase == Phase.RUN): one.stamp_ns for one in reversed(self.targets)}
        if not (self.is_in_table_frame or any(begin <= one.stamp_ns <= begun.get((session, True), 2**63)
                                              for one in self.frames for (session, _), begin in begun.items())):
            return 'expected the table frame on /tf_static, found none for this run'
        return ''

    def own_frames(self) -> list[TableFrame]:
        """Return the table frames received after the first target, all where none was: whatever their stamps are."""
        return [one for one in self.frames if not any(one is each for each in self._earlier)] or self.frames

    @property
    def is_in_table_frame(self) -> bool:
        """Whether the CMM has a table frame of its own, in which it answers."""
        return self.in_frames == (TABLE_FRAME,)

    def run_begin(self, otherwise: int = 0) -> int:
        """Return when phase RUN began in its first session, ns, `otherwise` where it has not."""
        asked = ((target.session, target.stamp_ns) for target in self.targets if target.phase == Phase.RUN)
        return min(asked, default=(0, otherwise))[1]
