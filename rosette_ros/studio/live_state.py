# SPDX-License-Identifier: Apache-2.0
"""What is received of a running cell, as plain values: progress, ball centres, curves, health, warnings. No ROS."""

from collections import deque
from collections.abc import Iterable
from enum import StrEnum
from math import hypot
from typing import NamedTuple

from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.run.errors import plain
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.seating import unseated
from rosette_ros.io.log_run import PublishedMotions
from rosette_ros.io.messages import Answer, CalibrationProgress, Phase, TableFrame, Target
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly

MOST_RUNS = 3
"""The answers of so many runs are kept: an answer may be received before the first target of its run."""
MOST_BALLS = 1000
"""A plate of more balls is not drawn."""
SILENT_AFTER = 4.0
"""A node whose health was not received for so long is shown as silent, s."""


class Health(StrEnum):
    """Health of a node, in the order of the levels of diagnostic_msgs/DiagnosticStatus: OK, WARN, ERROR, STALE."""

    HEALTHY = 'healthy'
    WARNING = 'warning'
    FAULT = 'fault'
    SILENT = 'silent'


class NodeHealth(NamedTuple):
    """Health of a node: level, sentence, and when it was received, s."""

    name: str
    level: Health
    sentence: str
    received: float


class Fault(NamedTuple):
    """What a node warns of, or what went wrong: wall time, words and level."""

    clock: str
    words: str
    level: Health = Health.FAULT


class ReadingPlace(NamedTuple):
    """Which reading of a run, each 1..n."""

    table_position: int
    ball: int
    cmm_position: int


class CellView(NamedTuple):
    """A cell as it is seen from above: the last target, whether it is waited for, what was measured and what failed."""

    balls: int
    target: Target | None
    is_waiting: bool
    done: frozenset[ReadingPlace]
    failed: frozenset[ReadingPlace]


def _places(targets: Iterable[Target]) -> frozenset[ReadingPlace]:
    return frozenset(ReadingPlace(one.table_position, one.ball, one.cmm_position) for one in targets
                     if one.phase == Phase.RUN)


class CellState:
    """Takes one message after the other and keeps the last run; clock: wall time in words; faults: newest first."""

    def __init__(self) -> None:
        self.progress = CalibrationProgress()
        self.motions: PublishedMotions | None = None
        self.verdict: VerdictText | None = None
        self.faults: deque[Fault] = deque(maxlen=30)
        self.frames: list[TableFrame] = []
        self._run = RunAnswers('', self.frames)
        self._runs: dict[str, RunAnswers] = {}
        self._health: dict[str, NodeHealth] = {}

    # What is received

    def add_target(self, target: Target) -> None:
        """Take a target; with the first target of another run that run is shown."""
        if target.run_id != self.run_id:
            self._run, self.motions, self.verdict = self._answers_of(target.run_id), None, None
        self._run.add_target(target)

    def add_answer(self, answer: Answer) -> None:
        """Take an answer."""
        self._answers_of(answer.run_id).add_answer(answer)

    def _answers_of(self, run_id: str) -> RunAnswers:
        run = self._runs.setdefault(run_id, RunAnswers(run_id, self.frames))
        if len(self._runs) > MOST_RUNS:
            del self._runs[next(one for one in self._runs if one not in (run_id, self.run_id))]
        return run

    def add_fault(self, clock: str, words: str, level: Health = Health.FAULT) -> None:
        """Take something that went wrong, or that a node warns of."""
        self.faults.appendleft(Fault(clock, words, level))

    def add_frame(self, frame: TableFrame) -> None:
        """Take the table frame in the machine frame."""
        self.frames.append(frame)
        del self.frames[:-100]

    def set_motions(self, published: PublishedMotions) -> None:
        """Take the curves of the evaluator."""
        if published.run_id == self.run_id or not self.run_id:
            self.motions = published

    def set_verdict(self, run_id: str, verdict: VerdictText | None) -> None:
        """Take the verdict of the evaluator."""
        if run_id == self.run_id or not self.run_id:
            self.verdict = verdict

    def set_health(self, name: str, level: int, sentence: str, now: float) -> None:
        """Take the health of a node; level: 0 to 3; now: steady time, s."""
        self._health[name] = NodeHealth(name, list(Health)[min(level, 3)], sentence, now)

    # What is known

    @property
    def run_id(self) -> str:
        """The run that the ball centres belong to, '' before the first target."""
        return self._run.run_id

    @property
    def balls(self) -> int:
        """Number of balls, 0 before the first target and where there are too many to draw."""
        balls = self._run.targets[-1].balls if self._run.targets else 0
        return balls if balls <= MOST_BALLS else 0

    @property
    def cells(self) -> dict[tuple[int, int], float]:
        """{(table position, ball): distance, m, from where the plate as it lies has the ball} of the answers that count
        in phase RUN."""
        numbers = range(1, self.balls + 1)
        shown = [(target, answer) for target, answer in self._run.counting()
                 if target.phase == Phase.RUN and target.table_position in numbers and target.ball in numbers]
        if not shown:
            return {}
        left = unseated([answer.centre for _, answer in shown], [target.centre for target, _ in shown],
                        [target.table_angle for target, _ in shown])
        return {(target.table_position, target.ball): hypot(*one) for (target, _), one in zip(shown, left, strict=True)}

    def view(self) -> CellView:
        """Return what a plan view shows; the last target is the current one until it is answered."""
        last = self._run.targets[-1] if self._run.targets else None
        counting = [target for target, _ in self._run.counting()]
        waiting = last is not None and all(target.seq != last.seq for target in counting)
        return CellView(self.balls, last, waiting, _places(counting), _places(self._run.failed()))

    def health(self, now: float) -> list[NodeHealth]:
        """Return the health of every node, silent where it was not received for long; now: steady time, s."""
        return sorted(one if now - one.received < SILENT_AFTER else one._replace(
            level=Health.SILENT, sentence=f'nothing received for {now - one.received:.0f} s')
            for one in self._health.values())

    def part_of_run(self) -> Run:
        """Return the Run of the ball centres so far; raises InvalidData where there are none."""
        return RunAssembly(self._run, plain(f'run {self.run_id}')).run()
