# SPDX-License-Identifier: Apache-2.0
"""Measuring schemes: in which order the n*n pairs of table position and ball are measured, with which motion.

Indices are one-based as on the shop floor. Table position i, ball j and CMM position k are tied by
k = (i + j - 2) mod n + 1. Source: Kniel et al. (2019), section 2.2 and Table 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.axes import ALIGNED, cmm_axes, moving_axes
from rosette_ros.core.run.errors import InvalidPlan, unknown_name
from rosette_ros.core.run.geometry import TWO_PI, Floats, Ints, nominal_angles, radial, rotate_z, wrap
from rosette_ros.core.run.interleaved_order import sensitive
from rosette_ros.core.run.reduced_sets import best_members, fewest_members, penalty

FEWEST = 'fewest'
"""Stands for as few CMM positions or balls as determine the curves."""
TURNINGS = ('forward', 'alternate', 'clockwise', 'counterclockwise')
_DERIVED: Any = None  # in place of what is as usual; never in a scheme that exists


@dataclass(frozen=True)
class Travel:
    """Motion of one run from its first target to its last: angle turned in all, rad; straight CMM way, m."""

    table_angle: float
    table_moves: int
    cmm_way: float
    cmm_moves: int

    @property
    def table_turns(self) -> float:
        """Revolutions of the table, both senses counted."""
        return self.table_angle / TWO_PI


@dataclass(frozen=True, eq=False)
class Scheme:
    """The order of one run, N rows in the order of measuring.

    n: number of balls and of table positions; order: its name; seed: of a drawn order; table_position, ball: (N,)
    one-based; approach: (N,) +1 or -1, sense in which the table turns (last turned) to get there; touches: (N,) of each
    ball, 0 as the CMM usually does; session: (N,) 1 and one more after every pause that is planned; table_offset: table
    angle of table position 1, rad, below one step of the table; wait: (N,) s for which the cell stands still before
    each reading. Raises InvalidPlan for another one.
    """

    n: int
    order: str
    seed: int
    table_position: Ints
    ball: Ints
    approach: Ints
    touches: Ints = _DERIVED
    session: Ints = _DERIVED
    table_offset: float = 0.0
    wait: Floats = _DERIVED

    def __post_init__(self) -> None:
        step = 360 / self.n
        if not 0 <= self.table_offset < np.deg2rad(step) * (1 - 1e-9):
            raise InvalidPlan(f'table offset: expected 0 to below {step:.6g} deg, the step of {self.n} table '
                              'positions, '
                              f'found {np.rad2deg(self.table_offset):.6g} deg')
        for name, usual in (('touches', 0), ('session', 1), ('wait', 0.0)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(self.ball.size, usual))

    def shifted(self, degrees: float) -> 'Scheme':
        """Return the same readings with table position 1 at an angle in degrees; raises InvalidPlan as Scheme does."""
        return replace(self, table_offset=float(np.deg2rad(degrees))) if degrees else self

    @property
    def cmm_position(self) -> Ints:
        """(N,) one-based CMM position k."""
        return cmm_position(self.n, self.table_position, self.ball)

    @property
    def repeats(self) -> bool:
        """Whether a ball is measured more than once at a table position."""
        return np.unique((self.table_position - 1) * self.n + self.ball).size < self.table_position.size

    @property
    def table_angle(self) -> Floats:
        """(N,) nominal table angle in [0, 2 pi), rad."""
        return nominal_angles(self.n)[self.table_position - 1] + self.table_offset

    def centres(self, radius: float) -> Floats:
        """Return the nominal ball centres in the table frame for a circle radius [m], (N, 3), m."""
        return rotate_z(self.table_offset, nominal_places(self.n, radius, self.table_position, self.ball))

    def travel(self, radius: float) -> Travel:
        """Return the motion that the scheme takes for a circle radius [m]."""
        table = np.abs(np.diff(unwrap_travel(self.table_angle, self.approach, self.n)))
        cmm = np.linalg.norm(np.diff(self.centres(radius), axis=0), axis=1)
        moved = cmm > 1e-9 * radius
        return Travel(float(table.sum()), int(np.count_nonzero(table > 1e-9)),
                      float(cmm[moved].sum()), int(np.count_nonzero(moved)))


def cmm_position(n: int, table_position: ArrayLike, ball: ArrayLike) -> Ints:
    """Return k = (i + j - 2) mod n + 1, one-based, for one-based i and j of any shape."""
    position: Ints = (np.asarray(table_position) + np.asarray(ball) - 2) % n + 1
    return position


def nominal_places(n: int, radius: float, table_position: ArrayLike, ball: ArrayLike) -> Floats:
    """Return the nominal ball centres in the table frame, (..., 3), in the unit of the radius."""
    return radius * radial(TWO_PI * (cmm_position(n, table_position, ball) - 1) / n)


def unwrap_travel(angle: ArrayLike, approach: ArrayLike, n: int) -> Floats:
    """Return the cumulative (unwrapped) table angle of readings in measuring order, (N,), rad.

    angle: (N,) rad, in any turn; approach: (N,) sense of the last table move, 0 if unknown (taken
    as +1, the sense in which the paper's schemes turn). The travel starts at angle[0]. A step
    smaller than half a table division is followed as it is: the table stood, or was corrected.
    """
    angle = np.asarray(angle, dtype=float)
    if angle.size == 0 or np.ptp(angle) > TWO_PI * (1 + 0.5 / n):
        return angle.copy()  # empty, or given unwrapped
    step = wrap(np.diff(angle))
    sense = np.where(np.asarray(approach)[1:] < 0, -1, 1)
    against = (np.sign(step) == -sense) & (np.abs(step) > np.pi / n)
    step = np.where(against, step + sense * TWO_PI, step)
    # wrap() sends half a turn to -pi, which the sense above has already put right.
    return np.asarray(angle[0] + np.concatenate([[0.0], np.cumsum(step)]))


def joined_travel(travel: Floats, angle: Floats, approach: Ints, session: Ints, n: int) -> Floats:
    """Return the travel of readings, (N,), rad: where it falls against the sense of turning over a pause, the table
    has counted from 0 again; then it goes on by the shortest way in that sense."""
    pauses = np.flatnonzero(np.diff(session)) + 1
    if not pauses.size:
        return travel
    shortest = np.diff(unwrap_travel(angle, approach, n))
    travel = travel.copy()
    for first in pauses.tolist():
        step = travel[first] - travel[first - 1]
        if step * (-1 if approach[first] < 0 else 1) < -np.pi / n:
            travel[first:] += shortest[first - 1] - step
    return travel


def travel_sense(coordinate: Floats, tolerance: float) -> Floats:
    """Return the sense (+1, -1) of the last move of one axis before each reading, (N,).

    coordinate: (N,) positions in measuring order, m. 0 until the axis has moved once by more than `tolerance`, m.
    """
    step = np.diff(coordinate, prepend=coordinate[:1])
    moved = np.abs(step) > tolerance
    last = np.maximum.accumulate(np.where(moved, np.arange(step.size), -1))
    return np.where(last >= 0, np.sign(step[np.maximum(last, 0)]), 0.0)


def unknown_sense(size: int, rotation: Floats | None = None) -> Floats:
    """Return the senses (size, 3) of the CMM where it is not known how it went."""
    out = np.zeros((size, 3))
    out[:, list(moving_axes(rotation))] = np.nan
    return out


@dataclass(frozen=True, eq=False)
class Way:
    """Where table and CMM went one after the other, one-based, whether a reading is known of it or not.

    table_position, ball, approach: (V,); place: (N,) of the readings in it.
    """

    table_position: Ints
    ball: Ints
    approach: Ints
    place: Ints

    @staticmethod
    def of(n: int, table_position: Ints, ball: Ints, approach: Ints) -> 'Way | None':
        """Return the Way of readings in measuring order, (N,) each, None where it is not known.

        It is known where nothing is missing, or whole balls or CMM positions are, by plan, and where the readings
        follow an order that is not random, so that what is missing between them is known.
        """
        size, position = table_position.size, cmm_position(n, table_position, ball)
        cells = (table_position - 1) * n + ball - 1
        used = np.unique(cells).size
        if used in (n * np.unique(position).size, n * np.unique(ball).size):
            return Way(table_position, ball, approach, np.arange(size))
        for order in ('row', 'diagonal', 'column', 'interleaved') if n * n < 8 * size + 1024 else ():
            for turning in TURNINGS:
                made = plan(n, order, turning=turning)
                place = np.argsort((made.table_position - 1) * n + made.ball - 1)[cells]
                if np.all(np.diff(place) > 0) and not np.any(approach * made.approach[place] < 0):
                    return Way(made.table_position, made.ball, made.approach, place)
        return None

    def cmm_sense(self, n: int, rotation: Floats | None = None) -> Floats:
        """Return the sense of the CMM's last move along its own x, y, z before each reading, (N, 3).

        0 before the first move of an axis, and along the axis that comes to every ball from one side. rotation: of the
        table frame in the machine frame. Moves that are nil where ball 1 is exactly at a half or whole pitch from an
        axis of the CMM are nil if it is there to within ALIGNED.
        """
        azimuth = nominal_angles(n)[cmm_position(n, self.table_position, self.ball) - 1]
        out, axes, half_pitch = np.zeros((self.place.size, 3)), cmm_axes(rotation), np.pi / (2 * n)
        for axis in moving_axes(rotation):
            at = np.arctan2(axes[axis, 1], axes[axis, 0])
            near = half_pitch * np.round(at / half_pitch)
            out[:, axis] = travel_sense(np.cos(azimuth - (near if abs(at - near) <= ALIGNED else at)), 1e-6)[self.place]
        return out

    def travel(self, n: int, table_angle: Floats) -> Floats:
        """Return the unwrapped angles of readings from their angles in any turn, (N,), rad."""
        if np.ptp(table_angle) > TWO_PI * (1 + 0.5 / n):
            return table_angle.copy()  # given unwrapped
        angle = nominal_angles(n)[self.table_position - 1]
        angle[self.place] = table_angle
        travel = unwrap_travel(angle, self.approach, n)[self.place]
        return np.asarray(travel - travel[0] + table_angle[0])


COMPLETE_ORDERS = ('row', 'diagonal', 'column', 'random', 'interleaved')
"""Orders in which every ball is measured once at every table position."""
BACK = {'there_and_back': 'diagonal', 'row_there_and_back': 'row'}
"""Orders that measure the places in use in another order and then backwards."""
ORDERS = (*COMPLETE_ORDERS, *BACK)
ALIASES = {'sensitive': 'interleaved'}
"""Names that orders had before, and still are given by: ISO 230-7 uses the old one for something else."""


def order_name(given: str) -> str:
    """Return the name of an order that is given by it or by an earlier one."""
    return ALIASES.get(given, given)


def _pairs(n: int, order: str, turning: str, seed: int) -> tuple[Ints, Ints]:
    """Return table positions and balls in measuring order, zero-based, each (N,)."""
    if order == 'interleaved':
        return sensitive(n)[:2]
    if order == 'random':
        return np.divmod(np.random.default_rng(seed).permutation(n * n), n)
    outer, inner = np.divmod(np.arange(n * n), n)
    if order == 'row':
        return outer, (inner - outer) % n
    if turning == 'alternate':
        inner = np.where(outer % 2 == 1, n - 1 - inner, inner)
    return {'column': (inner, outer), 'diagonal': ((outer + inner) % n, -inner % n)}[order]


def plan(n: int, order: str = 'diagonal', seed: int = 0, turning: str = 'forward',
         cmm_positions: Sequence[int] = (), balls: Sequence[int] = ()) -> Scheme:
    """Return the Scheme of one run.

    order: one of ORDERS. `row`: table outer, CMM and plate inner (the paper's case 1); `diagonal`: CMM outer (case 2,
    Table 1); `column`: ball outer (case 3); `random`: a shuffle drawn from `seed`; `interleaved`: small steps of the
    table in which every effect of the library shows (docs/measuring.md); `there_and_back`, `row_there_and_back`:
    `diagonal` or `row` at half the CMM positions, then the same backwards. turning: `forward`, or `counterclockwise`,
    turns the table counter-clockwise always; `alternate` turns it backwards in every second inner loop (every second
    move in `random`), so that backlash shows; `interleaved` and those there and back have senses of their own then;
    `clockwise` is the mirror image of `forward`: it begins at position 1 and ball 1, too, and both count down.
    cmm_positions, balls: those in use, from 1, one of the two; all if none (half of the CMM positions there and back).

    Raises InvalidPlan for fewer than three balls, an unknown order or turning, places that do not exist or do not
    determine the curves.
    """
    if isinstance(n, bool) or int(n) != n or n < 3:
        raise InvalidPlan(f'number of balls: expected a whole number of at least 3, found {n}; '
                          'with fewer the table, plate and CMM cannot be separated')
    n = int(n)
    order = order_name(order)
    if order not in ORDERS:
        raise InvalidPlan(unknown_name('order', order, ORDERS))
    if turning not in TURNINGS:
        raise InvalidPlan(unknown_name('turning', turning, TURNINGS))
    cmm_positions, balls = chosen_places(n, order, cmm_positions, balls)
    back = order in BACK
    sense = -1 if turning == 'clockwise' else 1
    turning = 'alternate' if turning == 'alternate' and not back else 'forward'
    i, j = _pairs(n, BACK.get(order, order), turning, seed)
    approach = sense * _approach(n, order, turning, i)
    i, j = (sense * one % n for one in (i, j))
    if cmm_positions or balls:
        used = np.isin((i + j) % n + 1, cmm_positions) if cmm_positions else np.isin(j + 1, balls)
        i, j, approach = i[used], j[used], approach[used]
    if back:
        i, j = (np.concatenate([one, one[::-1]]) for one in (i, j))
        approach = np.where(np.arange(i.size) <= i.size // 2, sense, -sense)
    return Scheme(n, order, int(seed), i + 1, j + 1, approach)


def chosen_places(n: int, order: str, cmm_positions: Sequence[int] = (),
                  balls: Sequence[int] = ()) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the CMM positions and the balls that a plan in an order has, from 1; () where all are in use.

    There and back without a choice has half of the CMM positions. Arguments and errors as of `plan`.
    """
    for name, places in (('CMM positions', cmm_positions), ('balls', balls)):
        if any(place not in range(1, n + 1) for place in places) or len({*places}) < len(places):
            raise InvalidPlan(f'{name} in use: expected different ones of 1..{n}, found {", ".join(map(str, places))}')
        if places and not np.isfinite(penalty(n, tuple(place - 1 for place in places))):
            best = best_members(n, max(len(places), fewest_members(n)))
            raise InvalidPlan(f'{name} in use: {", ".join(map(str, places))} of {n} do not determine the curves; '
                              f'expected others, such as {", ".join(str(k + 1) for k in best)}')
    if cmm_positions and balls:
        raise InvalidPlan('expected CMM positions or balls in use, found both; leave out one')
    if order in BACK and not cmm_positions and not balls:
        cmm_positions = tuple(k + 1 for k in best_members(n, max((n + 1) // 2, fewest_members(n))))
    return tuple(cmm_positions), tuple(balls)


def places_in_use(text: str, n: int, what: str = 'CMM positions or balls') -> tuple[int, ...]:
    """Return the CMM positions or balls, from 1, that a text names.

    '' all, () ; '6' the six that determine the curves best; '50 %' the best half; FEWEST as few as determine them;
    '1, 5, 7, 10' these.

    what: they are, in words. Raises InvalidPlan for another text.
    """
    parts = text.split(',')
    try:
        if len(parts) > 1:
            return tuple(map(int, parts))
        if not text.strip():
            return ()
        count = round(float(text.strip(' %')) * n / 100) if '%' in text else (
            fewest_members(n) if text.strip() == FEWEST else int(text))
    except (ValueError, OverflowError):
        raise InvalidPlan(f'{what} in use: expected how many (6), a share (50 %), {FEWEST} or which (1, 5, 7, 10), '
                          f'found {text!r:.80}') from None
    return tuple(k + 1 for k in best_members(n, count, what))


def _approach(n: int, order: str, turning: str, i: Ints) -> Ints:
    """Return the sense of the last table move for positions i (zero-based) in measuring order."""
    if order == 'interleaved':
        return sensitive(n)[2]
    if turning == 'forward':
        return np.ones(i.size, dtype=int)
    step = wrap(nominal_angles(n)[i] - nominal_angles(n)[np.roll(i, 1)])
    step[0] = 1.0
    moved = np.abs(step) > 1e-9
    shortest = np.where(step < 0, -1, 1)
    reading = np.arange(i.size)
    if order in ('diagonal', 'column'):
        # The first move of a loop goes the shortest way, the others in the sense of the loop.
        sense = np.where((reading // n) % 2 == 1, -1, 1)
        sense = np.where(reading % n == 0, shortest, sense)
    else:
        sense = np.where(np.cumsum(moved) % 2 == 1, 1, -1)
    last = np.maximum.accumulate(np.where(moved, reading, 0))
    return sense[last]
