# SPDX-License-Identifier: Apache-2.0
"""Targets, answers and table frames as records, from messages of rclpy or decoded from a log."""

from array import array
from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache
from math import isfinite, nan
from sys import intern
from typing import Any, NamedTuple, TypeVar

import numpy as np

from rosette_ros.core.diagnosis.verdict import Outcome, VerdictText
from rosette_ros.core.run.errors import InvalidData, plain
from rosette_ros.core.run.geometry import TWO_PI, Floats, Frame, rotate_z, wrap
from rosette_ros.core.run.scheme import nominal_places, order_name

FRAMES = MACHINE_FRAME, TABLE_FRAME = 'machine', 'table'
STATUS_OK, STATUS_REFUSED = 0, 2
TOUCH_ARRAYS = ('x', 'y', 'z', 'i', 'j', 'k', 'time')  # of Touches.msg: point, direction, time of each touch
EXTENDED = 8
"""Kind of a CalibrationEvent: readings were added to the plan of a run, or are not any more."""
UNIT_TOLERANCE = 1e-6  # a quaternion whose norm differs from 1 by more is none


class Phase(IntEnum):
    """Phase of a calibration; the numbers are those of RunState.msg and, 1 to 4, of ProbeTarget.msg."""

    IDLE = 0
    REPEATABILITY = 1
    ALIGNMENT = 2
    RUN = 3
    DRIFT_CHECK = 4
    EVALUATION = 5
    DONE = 6
    CANCELLED = 7
    FAILED = 8

    @property
    def is_end(self) -> bool:
        """Whether no phase follows."""
        return self in (Phase.DONE, Phase.CANCELLED, Phase.FAILED)


PHASE_WORDS: dict[int, str] = {
    Phase.IDLE: 'no calibration is running', Phase.REPEATABILITY: 'repeatability check',
    Phase.ALIGNMENT: 'table axis and frame', Phase.RUN: 'run', Phase.DRIFT_CHECK: 'drift check',
    Phase.EVALUATION: 'evaluation', Phase.DONE: 'done', Phase.CANCELLED: 'cancelled', Phase.FAILED: 'failed'}


def phase_name(number: int) -> str:
    """Return the name of the phase in a RunState, `PHASE_77` for one that does not exist."""
    return Phase(number).name if number in list(Phase) else f'PHASE_{number}'


class CalibrationProgress(NamedTuple):
    """Where a calibration stands, as in RunState.msg; phase: of Phase, or a number that it does not know."""

    run_id: str = ''
    phase: int = Phase.IDLE
    order: str = ''
    done: int = 0
    total: int = 0
    text: str = ''

    @property
    def is_running(self) -> bool:
        """Whether a calibration is running."""
        return Phase.IDLE < self.phase < Phase.DONE


class Target(NamedTuple):
    """One ball to be probed, as in ProbeTarget.msg.

    table_angle: rad; centre: where the ball is expected, m, in frame_id; stamp_ns: when it was asked, ns; touches: how
    often it is touched, 0 as the CMM usually does; pole: unit vector to the side from which it is probed, in
    frame_id."""

    run_id: str
    seq: int
    attempt: int
    session: int
    phase: int
    balls: int
    radius: float
    table_position: int
    ball: int
    cmm_position: int
    table_angle: float
    approach: int
    centre: tuple[float, float, float]
    frame_id: str
    stamp_ns: int
    touches: int = 0
    pole: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def table_offset(self) -> float:
        """Table angle of table position 1 by which this one is where it is, to the picoradian; NaN where it is none."""
        if not (isfinite(self.table_angle) and self.balls):
            return nan
        return round(float(wrap(self.table_angle - TWO_PI * (self.table_position - 1) / self.balls)), 12)

    @property
    def place(self) -> Floats:
        """Nominal place of its ball in the table frame, (3,), m."""
        cmm_position = (self.table_position + self.ball - 2) % self.balls + 1
        return _place(self.balls, self.radius, self.table_offset, cmm_position)

    def __str__(self) -> str:
        return f'target {self.seq} (table position {self.table_position}, ball {self.ball})'


@lru_cache(maxsize=1024)
def _place(balls: int, radius: float, offset: float, cmm_position: int) -> Floats:
    """Return the nominal place at a CMM position, (3,), m: a run asks for each of them ball after ball."""
    return rotate_z(offset, nominal_places(balls, radius, 1, cmm_position))


class Answer(NamedTuple):
    """What the CMM answers to one target, as in BallCentre.msg.

    table_angle, table_travel: rad; centre: m, in frame_id; form_error: m; temperature: °C, NaN if unknown; stamp_ns:
    when it was measured, ns."""

    run_id: str
    seq: int
    table_position: int
    ball: int
    cmm_position: int
    status: int
    text: str
    table_angle: float
    table_travel: float
    approach: int
    centre: tuple[float, float, float]
    form_error: float
    temperature: float
    frame_id: str
    stamp_ns: int

    @property
    def frame(self) -> str:
        """Name of its frame without a prefix."""
        return short_frame(self.frame_id)

    @property
    def is_finite(self) -> bool:
        """Whether centre, angle and travel are numbers."""
        return all(map(isfinite, (*self.centre, self.table_angle, self.table_travel)))

    @property
    def is_refused(self) -> bool:
        """Whether its target would be refused again."""
        return self.status == STATUS_REFUSED

    def is_usable_for(self, target: Target) -> bool:
        """Whether it can count as the answer to a target of its seq."""
        return (self.status == STATUS_OK and self.table_position == target.table_position and self.ball == target.ball
                and self.is_finite)


Row = TypeVar('Row', Target, Answer)


class Rows(Sequence[Row]):
    """Targets or answers in columns, as 129 600 of each of 360 balls take 150 MB as objects.

    A text is held once and by its number, a point by three numbers."""

    def __init__(self, kind: type[Row]) -> None:
        self._kind: type[Row] = kind
        self._texts, self._numbers = list[str](), dict[str, int]()
        self._columns: list[tuple[array[Any], bool, bool]] = [
            (array({int: 'q', str: 'l'}.get(held, 'd')), held is str, held not in (int, str, float))
            for held in kind.__annotations__.values()]

    def append(self, row: Row) -> None:
        """Add a row."""
        values: tuple[Any, ...] = row
        for (column, is_text, is_point), value in zip(self._columns, values, strict=True):
            if is_point:
                column.extend(value)
            elif is_text:
                if value not in self._numbers:
                    self._numbers[value] = len(self._texts)
                    self._texts.append(value)
                column.append(self._numbers[value])
            else:
                column.append(value)

    def __len__(self) -> int:
        return len(self._columns[0][0])

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return [self[one] for one in range(len(self))[place]]
        row = range(len(self))[place]
        return self._kind._make([
            self._texts[column[row]] if is_text else tuple(column[3 * row:3 * row + 3]) if is_point else column[row]
            for column, is_text, is_point in self._columns])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    def column(self, name: str) -> list[Any]:
        """Return one of its fields of all rows, of a point the three numbers one after the other."""
        column, is_text, _ = self._columns[self._kind._fields.index(name)]
        return [self._texts[one] for one in column] if is_text else column.tolist()


class TableFrame(NamedTuple):
    """The table frame in the machine frame; stamp_ns: of its transform, ns."""

    stamp_ns: int
    frame: Frame


def nanoseconds(stamp: Any) -> int:
    """Return a message's time in ns since the epoch."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def progress_of(message: Any) -> CalibrationProgress:
    """Return the CalibrationProgress of a RunState."""
    return CalibrationProgress(plain(message.run_id), message.phase, order_name(plain(message.order)), message.done,
                               message.total, plain(message.text, most=4000))


def verdict_of(message: Any) -> VerdictText | None:
    """Return the verdict in a Diagnosis or ErrorMotions; None where there is none that this version knows."""
    outcome = getattr(message, 'outcome', '')  # older logs have none
    if outcome not in list(Outcome):
        return None
    return VerdictText(Outcome(outcome), plain(message.verdict, 2000), plain(message.action, 2000))


def target_of(message: Any) -> Target:
    """Return the Target of a ProbeTarget, of rclpy or decoded from a log; older ones have no session, taken as 1."""
    header, centre = message.header, message.centre
    pole = getattr(message, 'pole', None)  # the first logs have none, nor touches
    radius, axis = _shared(message.radius, (pole.x, pole.y, pole.z) if pole else (0.0, 0.0, 1.0))
    return Target(
        intern(plain(message.run_id)), message.seq, message.attempt, max(getattr(message, 'session', 1), 1),
        message.phase, message.balls, radius, message.table_position, message.ball, message.cmm_position,
        message.table_angle, message.approach, (centre.x, centre.y, centre.z), intern(plain(header.frame_id)),
        nanoseconds(header.stamp), getattr(message, 'touches', 0), axis)


@lru_cache(maxsize=64)
def _shared(*values: Any) -> tuple[Any, ...]:
    """Return equal values as the same objects: a run has 259 200 records of 360 balls."""
    return values


def answer_of(message: Any) -> Answer:
    """Return the Answer of a BallCentre, of rclpy or decoded from a log."""
    header, centre = message.header, message.centre
    return Answer(
        intern(plain(message.run_id)), message.seq, message.table_position, message.ball, message.cmm_position,
        message.status, plain(message.text), message.table_angle, message.table_travel, message.approach,
        (centre.x, centre.y, centre.z), message.form_error, message.temperature, intern(plain(header.frame_id)),
        nanoseconds(header.stamp))


def short_frame(frame_id: str) -> str:
    """Return a frame's name without its prefix: `cell1/table` is a table frame."""
    return frame_id.rsplit('/', 1)[-1]


def table_frame_of(message: Any) -> TableFrame | None:
    """Return the TableFrame of a TransformStamped, None where it is a transform between other frames.

    Raises InvalidData where the rotation is no unit quaternion, or the translation is not finite."""
    if short_frame(message.header.frame_id) != MACHINE_FRAME or short_frame(message.child_frame_id) != TABLE_FRAME:
        return None
    translation = message.transform.translation
    origin = (translation.x, translation.y, translation.z)
    if not np.isfinite(origin).all():
        raise InvalidData(f'table frame: translation: expected finite numbers, found {origin}')
    quaternion = unit_quaternion(message.transform.rotation, 'table frame: rotation')
    return TableFrame(nanoseconds(message.header.stamp), Frame.from_quaternion(quaternion, origin))


def unit_quaternion(message: Any, where: str) -> Floats:
    """Return a Quaternion message as (x, y, z, w); raises InvalidData where its size is not 1."""
    quaternion = np.array([message.x, message.y, message.z, message.w], dtype=float)
    with np.errstate(over='ignore', invalid='ignore'):
        size = float(np.sqrt(np.sum(np.square(quaternion))))
    if not abs(size - 1) < UNIT_TOLERANCE:
        raise InvalidData(f'{where}: expected a unit quaternion, found the size {size}')
    return quaternion


def rotation_of_motions(message: Any) -> Floats | None:
    """Return the rotation of the table frame in an ErrorMotions message, None where it is not known."""
    found = getattr(message, 'orientation', None)  # the first logs have none
    if found is None or not any((found.x, found.y, found.z, found.w)):
        return None
    return Frame.from_quaternion(unit_quaternion(found, 'error motions: orientation'), np.zeros(3)).rotation
