# SPDX-License-Identifier: Apache-2.0
"""Collects what belongs to a run, in whatever order it arrives, until it can be evaluated. No ROS.

Topics keep their own order, but nothing is known about the order between them: an answer may come
before its target, the table frame after both, and the order to evaluate before all.
"""

from dataclasses import dataclass, field, fields

from rosette_ros.core.geometry import Frame
from rosette_ros.data.assemble import (
    STATUS_OK,
    TABLE_FRAME,
    AnswerTable,
    Phase,
    TargetTable,
    assemble_run,
)
from rosette_ros.data.table_frame import refuse_two_frames
from rosette_ros.nodes.sequence import short_frame

RUNS_KEPT = 4
_TARGET_COLUMNS = tuple(column.name for column in fields(TargetTable))
_ANSWER_COLUMNS = tuple(column.name for column in fields(AnswerTable))


@dataclass(eq=False)
class _Pieces:
    """What has come of one run; the columns are those of TargetTable and AnswerTable."""

    targets: dict = field(default_factory=lambda: {name: [] for name in _TARGET_COLUMNS})
    answers: dict = field(default_factory=lambda: {name: [] for name in _ANSWER_COLUMNS})
    asked: set = field(default_factory=set)
    answered: set = field(default_factory=set)
    cells: set = field(default_factory=set)
    wanted_cells: int = 0
    in_machine: bool = False
    begin: int | None = None
    run_begin: int | None = None
    expected: int | None = None
    has_states: bool = False
    evaluated: bool = False
    is_over: bool = False
    heard: float = 0.0


class Gathering:
    """The pieces of the last runs and the table frames that were latched."""

    def __init__(self):
        """Start empty."""
        self._runs = {}
        self._frames = []

    def add_target(self, row, now):
        """Take a target; row: mapping by the columns of TargetTable; now: steady time, s."""
        pieces = self._pieces(row['run_id'], now, anew=True)
        for name in _TARGET_COLUMNS:
            pieces.targets[name].append(row[name])
        pieces.asked.add(row['seq'])
        if pieces.begin is None:
            pieces.begin = row['stamp_ns']
        if row['phase'] == Phase.RUN:
            pieces.wanted_cells = row['balls'] ** 2
            pieces.cells.add(row['seq'])
            if pieces.run_begin is None:
                pieces.run_begin = row['stamp_ns']

    def add_answer(self, row, now):
        """Take an answer; row: mapping by the columns of AnswerTable; now: steady time, s."""
        pieces = self._pieces(row['run_id'], now, anew=True)
        for name in _ANSWER_COLUMNS:
            pieces.answers[name].append(row[name])
        if row['status'] == STATUS_OK:
            pieces.answered.add(row['seq'])
            pieces.in_machine |= short_frame(row['frame_id']) != TABLE_FRAME

    def add_frame(self, stamp_ns, frame: Frame):
        """Take a table frame in the machine frame."""
        self._frames.append((stamp_ns, frame))
        del self._frames[:-2 * RUNS_KEPT]

    def expect(self, run_id, answers, now):
        """Take the order to evaluate a run as soon as so many targets are answered."""
        known = self._runs.get(run_id)
        if known is not None and known.is_over:
            del self._runs[run_id]  # it was gone on with after its end
        pieces = self._pieces(run_id, now)
        pieces.has_states, pieces.expected = True, answers

    def note_state(self, run_id, now, is_over=False):
        """Take note that someone tells the states of a run: its end will be ordered.

        is_over: the run has its error motions already; nobody waits for those of this node.
        """
        pieces = self._pieces(run_id, now)
        pieces.has_states, pieces.is_over = True, pieces.is_over or is_over

    def end_all(self):
        """Take note that nothing is on any more: who asked for it was started anew."""
        for pieces in self._runs.values():
            pieces.is_over = True

    def recall(self, run_id, targets, answers, frames, now):
        """Take what is recorded of a run; what was heard besides stays.

        targets, answers: rows; frames: (stamp in ns, Frame) each; now: steady time, s.
        """
        pieces = self._runs.get(run_id)
        if pieces is None or pieces.evaluated:
            return
        asked = {(row['seq'], row['attempt']) for row in targets}
        heard = {(row['seq'], row['stamp_ns']) for row in answers}
        old_targets, old_answers = _rows(pieces.targets), _rows(pieces.answers)
        for name in _TARGET_COLUMNS:
            pieces.targets[name].clear()
        for name in _ANSWER_COLUMNS:
            pieces.answers[name].clear()
        pieces.begin = pieces.run_begin = None
        for row in (*targets, *(row for row in old_targets if (row['seq'], row['attempt']) not in asked)):
            self.add_target(row, now)
        for row in (*answers, *(row for row in old_answers if (row['seq'], row['stamp_ns']) not in heard)):
            self.add_answer(row, now)
        known = {stamp for stamp, _ in self._frames}
        self._frames += [frame for frame in frames if frame[0] not in known]

    def forget(self, run_id):
        """Drop a run that was cancelled or has failed."""
        self._runs.pop(run_id, None)

    def ready(self, now, quiet):
        """Return the run_ids that can be evaluated now.

        Those that were ordered and are complete; without any state from a sequencer, those whose
        n*n targets are answered when nothing has come for `quiet` s.
        """
        return [run_id for run_id, pieces in self._runs.items()
                if not pieces.evaluated and self._is_ready(pieces, now, quiet)]

    def late(self, now, patience):
        """Return (run_id, words) for runs that were ordered but lack pieces for too long."""
        return [(run_id, self._lacks(pieces)) for run_id, pieces in self._runs.items()
                if pieces.expected is not None and not (pieces.evaluated or pieces.is_over)
                and now - pieces.heard > patience]

    def lacking(self):
        """Return the ids of the runs that were ordered and cannot be evaluated for want of pieces."""
        return [run_id for run_id, pieces in self._runs.items()
                if pieces.expected is not None and not (pieces.evaluated or pieces.is_over)
                and self._lacks(pieces)]

    def to_run(self, run_id):
        """Return the Run; raises InvalidData where the pieces do not make one."""
        pieces = self._runs[run_id]
        pieces.evaluated = True
        targets, answers = TargetTable(**pieces.targets), AnswerTable(**pieces.answers)
        refuse_two_frames(self._frames, targets, answers, run_id, f'run {run_id}')
        return assemble_run(targets, answers, self._frame(pieces), run_id, f'run {run_id}')

    def _pieces(self, run_id, now, anew=False):
        """Return the pieces of a run; after its evaluation new readings start it afresh."""
        pieces = self._runs.get(run_id)
        if pieces is None or (anew and pieces.evaluated):
            self._runs.pop(run_id, None)
            pieces = self._runs[run_id] = _Pieces()
            while len(self._runs) > RUNS_KEPT:
                del self._runs[next(iter(self._runs))]
        pieces.heard = now
        return pieces

    def _is_ready(self, pieces, now, quiet):
        if pieces.expected is None:
            if pieces.has_states or now - pieces.heard < quiet or not pieces.wanted_cells:
                return False
            if len(pieces.cells & pieces.answered) < pieces.wanted_cells:
                return False
        return not self._lacks(pieces)

    def _lacks(self, pieces):
        """Say what is missing; empty: nothing."""
        answered = len(pieces.answered & pieces.asked)
        expected = pieces.expected or 0
        if answered < expected or pieces.run_begin is None:
            return (f'wanted {expected} targets with answers, got {len(pieces.asked)} targets and '
                    f'answers to {answered} of them')
        if pieces.in_machine and self._frame(pieces) is None:
            return 'wanted the table frame on /tf_static, got none for this run'
        return ''

    def _frame(self, pieces):
        """Return the last frame found between the first target and the first of the run."""
        found = [entry for entry in self._frames
                 if pieces.begin <= entry[0] <= pieces.run_begin]
        return max(found, key=lambda entry: entry[0])[1] if found else None


def _rows(columns):
    """Return the rows of a mapping of columns, a mapping each."""
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
