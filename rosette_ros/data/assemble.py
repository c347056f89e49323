# SPDX-License-Identifier: Apache-2.0
"""Targets and answers joined to a Run: the one way from messages to numbers.

The evaluator (from messages on the graph) and the log reader (from a file) both come through here,
so the same messages give the same numbers, bit for bit.
"""

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.records import Run
from rosette_ros.core.scheme import unwrap_travel
from rosette_ros.data.labels import Labels
from rosette_ros.data.places import misplaced, nominal_places

MACHINE_FRAME = 'machine'
TABLE_FRAME = 'table'
STATUS_OK = 0
MAX_BALLS = 10_000
"""More balls than this are taken for a mistake."""
MIN_REPEATABILITY = 1e-12
"""Repeated readings that differ by less, m, tell of rounding and not of repeatability."""


class Phase(IntEnum):
    """Phase of a calibration that a target belongs to, as in ProbeTarget.msg."""

    REPEATABILITY = 1
    ALIGNMENT = 2
    RUN = 3
    DRIFT_CHECK = 4


def _frozen(record, kinds):
    """Turn the columns of a record into frozen arrays of one length."""
    size = len(record.seq)
    for column in fields(record):
        values = getattr(record, column.name)
        if kinds[column.name] is str:
            values = Labels.of(values)
        else:
            values = np.array(values, dtype=kinds[column.name])
            values.setflags(write=False)
        if len(values) != size:
            raise InvalidData(f'{type(record).__name__}: {column.name}: wanted {size} values as '
                              f'in seq, got {len(values)}')
        object.__setattr__(record, column.name, values)


class _Table:
    """What both tables can do."""

    def __len__(self):
        return self.seq.size

    def take(self, rows):
        """Return the table with only some rows (mask or positions)."""
        return type(self)(**{
            column.name: value.take(rows) if isinstance(value, Labels) else value[rows]
            for column in fields(self) for value in [getattr(self, column.name)]})


@dataclass(frozen=True, eq=False)
class TargetTable(_Table):
    """ProbeTargets in order of receipt, one row each.

    run_id: Labels or texts; seq, attempt, phase, balls, table_position, ball: (N,) integers as in
    the message; radius: (N,) m; stamp_ns: (N,) when it was asked, ns; session: (N,) as in the message,
    None or 0 where it is not told: taken as 1.
    """

    run_id: Labels
    seq: np.ndarray
    attempt: np.ndarray
    phase: np.ndarray
    balls: np.ndarray
    radius: np.ndarray
    table_position: np.ndarray
    ball: np.ndarray
    stamp_ns: np.ndarray
    session: np.ndarray | None = None

    def __post_init__(self):
        """Freeze the columns."""
        told = np.zeros(len(self.seq)) if self.session is None else self.session
        object.__setattr__(self, 'session', np.maximum(told, 1))
        integers = dict.fromkeys((column.name for column in fields(self)), np.int64)
        _frozen(self, {**integers, 'run_id': str, 'radius': float})


@dataclass(frozen=True, eq=False)
class AnswerTable(_Table):
    """BallCentres in order of receipt, one row each.

    run_id, frame_id, text: Labels or texts; seq, table_position, ball, status, approach: (N,)
    integers as in the message; stamp_ns: (N,) when it was measured, ns; table_angle, table_travel:
    (N,) rad; centre: (N, 3) m, in frame_id; form_error: (N,) m; temperature: (N,) °C, NaN if
    unknown.
    """

    run_id: Labels
    seq: np.ndarray
    table_position: np.ndarray
    ball: np.ndarray
    status: np.ndarray
    stamp_ns: np.ndarray
    frame_id: Labels
    table_angle: np.ndarray
    table_travel: np.ndarray
    approach: np.ndarray
    centre: np.ndarray
    form_error: np.ndarray
    temperature: np.ndarray
    text: Labels

    def __post_init__(self):
        """Freeze the columns."""
        floats = dict.fromkeys((column.name for column in fields(self)), float)
        integers = dict.fromkeys(('seq', 'table_position', 'ball', 'status', 'stamp_ns',
                                  'approach'), np.int64)
        _frozen(self, {**floats, **integers, **dict.fromkeys(('run_id', 'frame_id', 'text'), str)})
        object.__setattr__(self, 'centre', self.centre.reshape(len(self), 3))

    @property
    def is_finite(self):
        """(N,) whether centre, angle and travel are numbers."""
        return (np.isfinite(self.centre).all(axis=1) & np.isfinite(self.table_angle)
                & np.isfinite(self.table_travel))


@dataclass(frozen=True, eq=False)
class Pairing:
    """Which answer belongs to which target of one run.

    target, answer: (M,) rows of the accepted pairs, in order of seq. The rest counts answers that
    are not used: failed (status), unasked (no such target), contradicting (another table position
    or ball than the target's), not_finite, repeated (a further good answer to the same target).
    """

    target: np.ndarray
    answer: np.ndarray
    failed: int
    unasked: int
    contradicting: int
    not_finite: int
    repeated: int


def pair(targets, answers, run_id):
    """Return the Pairing of one run.

    A target that was sent again counts once, as sent last. Of several good answers to it the first
    one counts that was measured after it was asked for the last time; if none was, the first.
    """
    rows = np.flatnonzero(targets.run_id.equal(run_id))
    order = np.lexsort((targets.attempt[rows], targets.seq[rows]))
    rows = rows[order]
    rows = rows[np.append(np.diff(targets.seq[rows]) != 0, True)[:rows.size]]

    own = np.flatnonzero(answers.run_id.equal(run_id))
    place = np.searchsorted(targets.seq[rows], answers.seq[own])
    asked = place < rows.size
    asked[asked] = targets.seq[rows[place[asked]]] == answers.seq[own[asked]]
    target = np.full(own.size, -1)
    target[asked] = rows[place[asked]]

    good = answers.status[own] == STATUS_OK
    same = ((targets.table_position[target] == answers.table_position[own])
            & (targets.ball[target] == answers.ball[own])) if rows.size else np.zeros_like(asked)
    finite = answers.is_finite[own]
    usable = np.flatnonzero(good & asked & same & finite)
    late = answers.stamp_ns[own[usable]] < targets.stamp_ns[target[usable]]
    usable = usable[np.lexsort((usable, late, targets.seq[target[usable]]))]
    first = np.append(True, np.diff(targets.seq[target[usable]]) != 0)[:usable.size]
    chosen = usable[first]
    return Pairing(
        target[chosen], own[chosen], failed=int((~good).sum()),
        unasked=int((good & ~asked).sum()), contradicting=int((good & asked & ~same).sum()),
        not_finite=int((good & asked & same & ~finite).sum()),
        repeated=usable.size - chosen.size)


def repeatability(targets, answers, pairing):
    """Return (standard deviation of a coordinate in m, degrees of freedom) of repeated readings.

    From the readings of phase REPEATABILITY, pooled over the balls and the three axes:
    sigma² = sum (p - mean)² / dof, dof = 3 (m - 1) for m readings of one ball. (None, None) where
    no ball was read twice.
    """
    rows = targets.phase[pairing.target] == Phase.REPEATABILITY
    target, answer = pairing.target[rows], pairing.answer[rows]
    place = np.stack([targets.table_position[target], targets.ball[target]], axis=-1)
    squares, dof = 0.0, 0
    for cell in np.unique(place, axis=0):
        centre = answers.centre[answer[(place == cell).all(axis=1)]]
        with np.errstate(over='ignore', invalid='ignore'):  # an infinite sum is refused by Run
            squares += float(np.sum((centre - centre.mean(axis=0)) ** 2))
        dof += 3 * (len(centre) - 1)
    if not dof or np.sqrt(squares / dof) < MIN_REPEATABILITY:
        return None, None
    return float(np.sqrt(squares / dof)), float(dof)


def runs_in(targets):
    """Return the ids of the runs with targets of phase RUN, in order of appearance."""
    code = targets.run_id.code[targets.phase == Phase.RUN]
    seen, first = np.unique(code, return_index=True)
    return tuple(targets.run_id.names[one] for one in seen[np.argsort(first)])


def choose_run(targets, run_id, source):
    """Return the run to take: `run_id`, or the only one there is.

    Raises InvalidData where there is none, another, or more than one without a choice.
    """
    present = runs_in(targets)
    if not present:
        raise InvalidData(f'{source}: wanted probe targets of phase RUN, got none; the '
                          'calibration ended before its run began')
    if run_id is None and len(present) > 1:
        raise InvalidData(f'{source}: wanted one run, got {len(present)}: {", ".join(present)}; '
                          'choose one by its run_id')
    if run_id is not None and run_id not in present:
        raise InvalidData(f'{source}: wanted run {run_id!r}, got {", ".join(present)}')
    return present[0] if run_id is None else run_id


def assemble_run(targets, answers, frame, run_id=None, source='run', repeats=False):
    """Return the Run of the readings of phase RUN, in the order in which they were measured.

    targets: TargetTable; answers: AnswerTable; frame: geometry.Frame of the table in the machine,
    None only if every answer is in the table frame already; run_id: needed where there are
    several; source: named in errors; repeats: whether a ball was planned more than once at a table
    position. Balls without a good answer are missing from the Run. Time counts from the first
    reading; time and travel are as recorded, and go on where a clock was set back, or a table counted anew, over a
    pause: the pause is then as long as readings usually are apart.

    Raises InvalidData where no ball centre is left, targets of a run contradict each other, a
    frame is unknown, or a ball centre is nearer to another ball's place than to its own.
    """
    run_id = choose_run(targets, run_id, source)
    pairing = pair(targets, answers, run_id)
    sigma, dof = repeatability(targets, answers, pairing)
    n, radius = _scheme(targets, run_id, source)
    rows = targets.phase[pairing.target] == Phase.RUN
    target, answer = pairing.target[rows], pairing.answer[rows]
    if not answer.size:
        raise InvalidData(f'{source}: wanted ball centres of run {run_id!r}, got none that counts'
                          f'{_unused(pairing)}')
    session = targets.session[target]
    order = np.lexsort((answers.seq[answer], answers.stamp_ns[answer], session))
    target, answer, session = target[order], answer[order], session[order]
    stamp = answers.stamp_ns[answer]
    temperature = answers.temperature[answer]
    centre = _in_table_frame(answers.take(answer), frame, source)
    _check_places(n, radius, targets.take(target), centre, source)
    return Run(
        n=n, radius=radius, table_position=targets.table_position[target],
        ball=targets.ball[target], centre=centre,
        table_angle=answers.table_angle[answer], time=_joined_time((stamp - stamp[0]) * 1e-9, session),
        temperature=np.where(np.isfinite(temperature), temperature, np.nan),
        approach=answers.approach[answer], table_travel=_joined_travel(answers.take(answer), session, n),
        repeatability=sigma, repeatability_dof=dof, run_id=run_id, repeats=repeats, session=session,
        source=source)


def _joined_time(time, session):
    """Return the times, (N,), s: where they fall over a pause, a clock was set back and its length is not known."""
    for first in (np.flatnonzero(np.diff(session)) + 1).tolist():
        step = np.diff(time)
        if step[first - 1] <= 0:
            within = np.delete(step, np.flatnonzero(np.diff(session)))
            usual = np.median(within) if within.size else 1.0
            time = time + np.where(np.arange(time.size) >= first, max(usual, 1e-3) - step[first - 1], 0.0)
    return time


def _joined_travel(answers, session, n):
    """Return the travel, (N,), rad: where it went against the sense of turning over a pause, the table has
    counted anew; then it goes on by the shortest way in that sense."""
    travel = answers.table_travel
    pauses = np.flatnonzero(np.diff(session)) + 1
    if not pauses.size:
        return travel
    told = np.diff(unwrap_travel(answers.table_angle, answers.approach, n))
    travel = travel.copy()
    for first in pauses.tolist():
        step = travel[first] - travel[first - 1]
        if step * (-1 if answers.approach[first] < 0 else 1) < -np.pi / n:
            travel[first:] += told[first - 1] - step
    return travel


def _unused(pairing):
    counts = {'failed': pairing.failed, 'to no target': pairing.unasked,
              'with another ball than asked': pairing.contradicting,
              'without finite numbers': pairing.not_finite}
    told = ', '.join(f'{count} {what}' for what, count in counts.items() if count)
    return f' ({told})' if told else ''


def _scheme(targets, run_id, source):
    """Return (n, radius) on which all targets of the run agree."""
    rows = targets.run_id.equal(run_id) & (targets.phase == Phase.RUN)
    values = []
    for name in ('balls', 'radius'):
        different = np.unique(getattr(targets, name)[rows])
        if different.size != 1:
            raise InvalidData(f'{source}: run {run_id!r}: {name}: wanted one value in all '
                              f'targets, got {", ".join(f"{value:g}" for value in different[:5])}')
        values.append(different[0])
    n, radius = int(values[0]), float(values[1])
    if n > MAX_BALLS:
        raise InvalidData(f'{source}: run {run_id!r}: balls: wanted at most {MAX_BALLS}, got {n}')
    return n, radius


def _in_table_frame(answers, frame, source):
    """Return the ball centres in the table frame, (N, 3)."""
    in_table = answers.frame_id.matching(lambda name: name.split('/')[-1] == TABLE_FRAME)
    in_machine = answers.frame_id.matching(lambda name: name.split('/')[-1] == MACHINE_FRAME)
    unknown = np.flatnonzero(~in_table & ~in_machine)
    if unknown.size:
        row = unknown[0]
        raise InvalidData(f'{source}: ball centre with seq {answers.seq[row]}: frame_id: wanted '
                          f'{MACHINE_FRAME} or {TABLE_FRAME}, got {answers.frame_id[row]!r}; '
                          'the CMM repeats the frame_id of the target')
    if in_table.all():
        return answers.centre
    if frame is None:
        raise InvalidData(f'{source}: wanted a transform from {MACHINE_FRAME} to {TABLE_FRAME} '
                          'on /tf_static, got none; without it the table axis is unknown')
    with np.errstate(over='ignore', invalid='ignore'):  # absurd numbers are refused by their place
        return np.where(in_table[:, None], answers.centre, frame.to_inner(answers.centre))


def _check_places(n, radius, targets, centre, source):
    if n < 3 or not radius > 0:
        return  # Run has words for this
    bad = misplaced(n, radius, targets.table_position, targets.ball, centre)
    if bad.size:
        row = bad[0]
        got = ', '.join(f'{1e3 * value:.6g}' for value in centre[row].tolist())
        i, j = targets.table_position[row], targets.ball[row]
        wanted = 1e3 * nominal_places(n, radius, i, j)
        raise InvalidData(
            f'{source}: ball centre with seq {targets.seq[row]}: wanted a place near '
            f'({wanted[0]:.3f}, {wanted[1]:.3f}, 0) mm in the table frame for table position {i}, '
            f'ball {j}, got ({got}); was another ball measured, or is the table frame wrong?')
