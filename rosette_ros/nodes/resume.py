# SPDX-License-Identifier: Apache-2.0
"""Going on with a run from its log: what is there already, and whether it fits."""

from dataclasses import fields, replace

import numpy as np

from rosette_ros.core.errors import CellError
from rosette_ros.data.assemble import AnswerTable, Phase, TargetTable, pair
from rosette_ros.nodes import convert
from rosette_ros.nodes.sequence import Earlier
from rosette_ros.nodes.settings import RUN


def earlier_in(recalled, programme, session=0):
    """Return the Earlier of what the recorder has recalled, a Recall.Response; session: that was on at least."""
    targets = TargetTable(**_columns(recalled.targets, convert.target_row, TargetTable))
    answers = AnswerTable(**_columns(recalled.answers, convert.answer_row, AnswerTable))
    records = [convert.answer_record(message) for message in recalled.answers]
    earlier = earlier_of(targets, answers, records, recalled.run_id, programme)
    return replace(earlier, session=max(earlier.session, session))


def latest_stamp(recalled):
    """Return the latest time in what was recalled, ns, 0 where there is none."""
    messages = (*recalled.targets, *recalled.answers)
    return max((convert.nanoseconds(message.header.stamp) for message in messages), default=0)


def run_begin(recalled):
    """Return when the first target of phase RUN was asked, ns, 0 where none was."""
    return min((convert.nanoseconds(message.header.stamp) for message in recalled.targets
                if message.phase == Phase.RUN), default=0)


def _columns(messages, row_of, table):
    rows = [row_of(message) for message in messages]
    return {column.name: [row[column.name] for row in rows] for column in fields(table)}


def earlier_of(targets, answers, records, run_id, programme):
    """Return the Earlier of a run.

    targets, answers: TargetTable and AnswerTable of its log; records: the answers as programme.Answer, row by
    row; programme: what the run was planned to measure. Raises CellError where log and plan contradict.
    """
    own = np.flatnonzero(targets.run_id.equal(run_id))
    _check_targets(targets.take(own), run_id, programme)
    pairing = pair(targets, answers, run_id)
    attempts = {}
    for seq, attempt in zip(targets.seq[own].tolist(), targets.attempt[own].tolist(), strict=True):
        attempts[seq] = max(attempt, attempts.get(seq, 0))
    seqs = targets.seq[pairing.target].tolist()
    return Earlier(
        {seq: records[row] for seq, row in zip(seqs, pairing.answer.tolist(), strict=True)}, attempts,
        int(targets.session[own].max()) if own.size else 0)


def _check_targets(targets, run_id, programme):
    """Refuse targets that are not those of the programme."""
    at = targets.seq - 1
    inside = (at >= 0) & (at < programme.total)
    where = np.clip(at, 0, programme.total - 1)
    same = (inside & (targets.balls == programme.scheme.n) & (targets.radius == programme.radius)
            & (targets.phase == programme.phase[where])
            & (targets.table_position == programme.table_position[where])
            & (targets.ball == programme.ball[where]))
    bad = np.flatnonzero(~same)
    if bad.size:
        row = bad[0]
        got = (f'table position {targets.table_position[row]}, ball {targets.ball[row]} of '
               f'{targets.balls[row]}, phase {targets.phase[row]}')
        wanted = str(programme.target(int(at[row]))) if inside[row] else f'one of {programme.total} targets'
        raise CellError(f'resume: run {run_id}: target {targets.seq[row]}: wanted {wanted} as planned, the '
                        f'log has {got}; the run was planned with other settings')


def check_wishes(changes, settings, run_id):
    """Refuse a goal that wants another plan than that of the run it resumes.

    changes: what the goal changes; settings: those of the run; name to value.
    """
    for wanted in RUN:
        if wanted.name in changes and changes[wanted.name] != settings[wanted.name]:
            raise CellError(f'resume: run {run_id}: {wanted.name}: wanted {settings[wanted.name]!r} as the run '
                            f'began, got {changes[wanted.name]!r}; leave it out')
