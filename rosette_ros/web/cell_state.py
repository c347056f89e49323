# SPDX-License-Identifier: Apache-2.0
"""What was heard of a running cell, as plain values: progress, ball centres, health, faults. No ROS."""

from collections import deque
from dataclasses import dataclass, field, fields

import numpy as np

from rosette_ros.core.errors import plain
from rosette_ros.core.geometry import Frame
from rosette_ros.core.records import ErrorMotions
from rosette_ros.data.assemble import STATUS_OK, AnswerTable, Phase, TargetTable, assemble_run

FAULTS_KEPT = 30
EARLY_KEPT = 1000
"""So many answers wait for their targets."""
MOST_BALLS = 1000
"""A plate of more balls is not drawn."""
SILENT = 4.0
"""A node that has said nothing about its health for so long is told to be silent, s."""
HEALTHY, WARNING, FAULTY, SILENCE = 'healthy', 'warning', 'fault', 'silent'
LEVELS = (HEALTHY, WARNING, FAULTY, SILENCE)
"""Health by the numbers of diagnostic_msgs/DiagnosticStatus: OK, WARN, ERROR, STALE."""
RUNNING = ('REPEATABILITY', 'ALIGNMENT', 'RUN', 'DRIFT_CHECK', 'EVALUATION')
_TARGET_COLUMNS = tuple(column.name for column in fields(TargetTable))
_ANSWER_COLUMNS = tuple(column.name for column in fields(AnswerTable))


@dataclass(frozen=True)
class Progress:
    """Where a calibration stands; phase: name as in RunState."""

    run_id: str = ''
    phase: str = 'IDLE'
    order: str = ''
    done: int = 0
    total: int = 0
    text: str = ''

    @property
    def is_running(self):
        """Whether a calibration is on."""
        return self.phase in RUNNING


@dataclass(frozen=True)
class NodeHealth:
    """What a node said of itself: one of LEVELS, a sentence, and when it was heard, s."""

    name: str
    level: str
    sentence: str
    heard: float


@dataclass(eq=False)
class _Pieces:
    """Targets and answers of one run, by column."""

    run_id: str = ''
    targets: dict = field(default_factory=lambda: {name: [] for name in _TARGET_COLUMNS})
    answers: dict = field(default_factory=lambda: {name: [] for name in _ANSWER_COLUMNS})
    asked: dict = field(default_factory=dict)
    cells: dict = field(default_factory=dict)
    balls: int = 0


class CellState:
    """Takes what is heard, one message after the other, and keeps the last run.

    motions: ErrorMotions of the evaluator, None before; faults: (clock, words), newest first.
    """

    def __init__(self):
        """Have heard nothing."""
        self.progress = Progress()
        self.motions: ErrorMotions | None = None
        self.faults = deque(maxlen=FAULTS_KEPT)
        self._pieces = _Pieces()
        self._frame: Frame | None = None
        self._early = []
        self._health = {}

    # What is heard

    def hear_target(self, row, centre):
        """Take a target; row: by the columns of TargetTable; centre: where it is expected, (3,) m."""
        if row['run_id'] != self._pieces.run_id:
            self._pieces = _Pieces(row['run_id'])
            self.motions = None
        pieces = self._pieces
        for name in _TARGET_COLUMNS:
            pieces.targets[name].append(row[name])
        pieces.asked[row['seq']] = (row['phase'], np.asarray(centre))
        pieces.balls = row['balls'] if row['balls'] <= MOST_BALLS else 0
        early, self._early = self._early, []
        for answer in early:  # topics keep their own order only: an answer may come before its target
            self._take(answer)

    def hear_answer(self, row, clock):
        """Take an answer; row: by the columns of AnswerTable; clock: wall time in words."""
        if row['status'] != STATUS_OK:
            self.faults.appendleft((clock, f'table position {row["table_position"]}, ball {row["ball"]} '
                                    f'could not be measured: {row["text"]}'))
        self._take(row)

    def _take(self, row):
        pieces = self._pieces
        if row['run_id'] != pieces.run_id or row['seq'] not in pieces.asked:
            self._early = [*self._early[-EARLY_KEPT:], row]
            return
        for name in _ANSWER_COLUMNS:
            pieces.answers[name].append(row[name])
        phase, expected = pieces.asked[row['seq']]
        if phase == Phase.RUN and row['status'] == STATUS_OK:
            distance = float(np.linalg.norm(np.asarray(row['centre']) - expected))
            if min(row['table_position'], row['ball']) > 0:
                pieces.cells[row['table_position'], row['ball']] = distance

    def hear_progress(self, progress, clock):
        """Take the state of the calibration."""
        ended = progress.phase in ('FAILED', 'CANCELLED') and progress != self.progress
        if ended and progress.run_id:
            self.faults.appendleft((clock, f'run {progress.run_id} {progress.phase.lower()}: {progress.text}'))
        self.progress = progress

    def hear_rejection(self, words, clock):
        """Take note that a calibration was refused."""
        self.faults.appendleft((clock, f'calibration refused: {words}'))

    def hear_frame(self, frame):
        """Take where the table stands in the machine."""
        self._frame = frame

    def hear_motions(self, run_id, motions):
        """Take the curves of the evaluator."""
        if run_id == self._pieces.run_id or not self._pieces.run_id:
            self.motions = motions

    def hear_health(self, name, level, sentence, now):
        """Take what a node says of its health; level: 0 to 3; now: steady time, s."""
        self._health[name] = NodeHealth(name, LEVELS[min(level, 3)], sentence, now)

    # What is known

    @property
    def run_id(self):
        """The run that the ball centres belong to."""
        return self._pieces.run_id

    @property
    def balls(self):
        """Number of balls, 0 before the first target."""
        return self._pieces.balls

    @property
    def cells(self):
        """{(table position, ball): distance from the expected place, m} of the run's ball centres."""
        return {cell: distance for cell, distance in self._pieces.cells.items() if max(cell) <= self.balls}

    def health(self, now):
        """Return the NodeHealth of every node that was heard, those not heard for long as silent."""
        shown = (one if now - one.heard < SILENT else
                 NodeHealth(one.name, SILENCE, f'nothing heard for {now - one.heard:.0f} s', one.heard)
                 for one in self._health.values())
        return sorted(shown, key=lambda one: one.name)

    def part_of_run(self):
        """Return the Run of the ball centres so far; raises InvalidData where there are none."""
        pieces = self._pieces
        targets = TargetTable(**{name: list(values) for name, values in pieces.targets.items()})
        answers = AnswerTable(**{name: list(values) for name, values in pieces.answers.items()})
        return assemble_run(targets, answers, self._frame, pieces.run_id, plain(f'run {pieces.run_id}'))
