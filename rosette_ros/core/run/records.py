# SPDX-License-Identifier: Apache-2.0
"""Records shared by the whole package: frozen, SI units, array shapes stated once."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from rosette_ros.core.run.axes import iso_names
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Bools, Floats, Ints, nominal_angles, rotate_z, turned_frame, wrap
from rosette_ros.core.run.number_limits import is_size
from rosette_ros.core.run.remarks import Remark
from rosette_ros.core.run.scheme import Way, cmm_position, unknown_sense, unwrap_travel

CURVES = ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')
"""Names of the six error motions after VDI/VDE 2617, in the order of every (n, 6) array."""
SI_UNITS = {curve: 'm' if curve.startswith('ct') else 'rad' for curve in CURVES}
"""The unit of each."""

STEPS = tuple(digit * 10.0**power for power in range(-4, -10, -1) for digit in (10, 5, 2))
"""Steps to which coordinates may be rounded, m: 1 mm, 0.5 mm, 0.2 mm ... 0.2 nm."""
FEWEST_DIGITS = 6
"""So many coordinates that are whole numbers of steps are no chance."""
MOST_DIGITS = 8
"""Coordinates of more significant digits are not rounded."""
EXACT = 1e9
"""Degrees of freedom of a standard deviation that is known exactly."""
UNLIKELY = 0.01
"""Probability below which something is no chance, and a stated repeatability not believed: the readings scatter more
than stated, and they, not the repeatability, state the uncertainties.

The chi square test (F test where the repeatability has degrees of freedom) gives the probability that noise of the
stated repeatability leaves as much. At 5 % one sound run of twenty would be refused, too many where a cell measures
every day; at 1e-6 a repeatability stated a third too small would pass on a plate of 6 balls. At 1 % a run of 12 balls
(301 degrees of freedom) is refused from 1.10 times the stated repeatability, one of 6 balls (49) from 1.24 times: where
that is chance, U is too large by as much, which does less harm than a U of a repeatability that is refuted.
"""
SAME_READING, SAME_SHARE = 1e-9, 0.9
"""Ball centres that differ by less, m, are one reading; of runs with such a share of the smaller one in common one is
the other once more, and neither counts beside it."""

_INTEGERS = ('table_position', 'ball', 'approach', 'session')
_REALS = ('centre', 'table_angle', 'time', 'temperature', 'table_travel', 'cmm_sense')
_DERIVED: Any = None  # in place of what was not recorded; never in a record that exists


def in_time(unit: str, time: str) -> str:
    """Return an SI unit with another unit of time (as of Run.time_unit) in place of the second: m/s, m/reading."""
    return re.sub(r'\bs\b', time, unit)


def _freeze(record: object, names: tuple[str, ...], dtype: DTypeLike) -> None:
    """Replace attributes of a frozen record by read-only copies."""
    for name in names:
        array = np.array(getattr(record, name), dtype=dtype)
        array.setflags(write=False)
        object.__setattr__(record, name, array)


@dataclass(frozen=True, eq=False)
class Run:
    """Ball centres of one measuring run, N readings in measuring order.

    n: number of balls and of table positions; radius: nominal radius of the circle of ball centres, m;
    table_position, ball: (N,) one-based; centre: (N, 3), m, in the table frame; table_angle: (N,) actual angle, rad;
    time: (N,) s since any origin; temperature: (N,) °C, NaN where unknown; approach: (N,) sense of the table's last
    move, +1, -1, 0 if unknown; table_travel: (N,) unwrapped table angle, rad; cmm_sense: (N, 3) sense of the CMM's
    last move along its own x, y, z, 0 before the first one and along the axis that comes to every ball from one side,
    NaN where it is not known; unrecorded: which of these two are not; repeatability: standard deviation of a coordinate
    from repeated measurements, m, or None; repeatability_dof: its degrees of freedom, None if it is taken as exactly
    known; repeatability_axes: the same along x, y and z by themselves, m, a third of the degrees of freedom each;
    repeats: whether a (table_position, ball) may stand more than once; session: (N,) 1 and one more after every
    pause (a run that was resumed, a CMM that was started again); source: its name in error messages; remarks: what is
    wrong with the readings as a whole; notes: how they were read, in words; simulated:
    whether no real CMM measured it; rotation: (3, 3) of the table frame in the machine frame, its columns are the axes
    of the table, None where it is not known; table_offset: table angle of table position 1, rad. From there table_angle
    counts, and there ball 1 is on the x axis of centre and rotation: a run between the steps of the table looks like
    any other one. begun: when the first reading was taken, s since the epoch, None where it is not said.
    written_steps: (N, 3) steps to which centre is rounded, m, where its digits no longer show them, else None.

    What was not recorded is derived: angles are nominal, times count readings, temperatures are NaN, approach is 0,
    travel and senses follow from angles, approach and places where it is known where table and CMM went, else the
    travel is unwrapped as if nothing were missing and the senses are NaN; the session is 1.

    Runs are equal where all of this is, so that what is calculated of a run is found again when it is read again.
    Raises InvalidData where shapes, ranges or values are wrong.
    """

    n: int
    radius: float
    table_position: Ints
    ball: Ints
    centre: Floats
    table_angle: Floats = _DERIVED
    time: Floats = _DERIVED
    temperature: Floats = _DERIVED
    approach: Ints = _DERIVED
    table_travel: Floats = _DERIVED
    cmm_sense: Floats = _DERIVED
    unrecorded: tuple[str, ...] = _DERIVED
    repeatability: float | None = None
    repeatability_dof: float | None = None
    run_id: str = ''
    repeats: bool = False
    session: Ints = _DERIVED
    source: str = 'run'
    remarks: tuple[Remark, ...] = ()
    notes: tuple[str, ...] = ()
    simulated: bool = False
    rotation: Floats | None = None
    repeatability_axes: tuple[float, float, float] | None = None
    table_offset: float = 0.0
    begun: float | None = None
    written_steps: Floats | None = None

    def __post_init__(self) -> None:
        _freeze(self, _INTEGERS[:2], np.int64)
        _check_rotation(self)
        derived: dict[str, Callable[[], Floats]] = {
            'session': lambda: np.ones(self.size), 'approach': lambda: np.zeros(self.size),
            'table_angle': lambda: self.phi, 'time': lambda: np.arange(self.size, dtype=float),
            'temperature': lambda: np.full(self.size, np.nan),
            'table_travel': self._derived_travel, 'cmm_sense': self._derived_sense}
        missing = [name for name in derived if getattr(self, name) is None]
        for name in missing:
            object.__setattr__(self, name, derived[name]())
        if self.unrecorded is None:
            lost = tuple(name for name in ('table_travel', 'cmm_sense') if name in missing and self._way is None)
            object.__setattr__(self, 'unrecorded', lost)
        _freeze(self, _INTEGERS[2:], np.int64)
        _freeze(self, _REALS, float)
        if self.written_steps is not None:
            _freeze(self, ('written_steps',), float)
        _check_run(self)

    @cached_property
    def steps(self) -> Floats:
        """(N, 3) steps to which the coordinates are rounded, m, 0 where they are not."""
        return steps_of(self.centre) if self.written_steps is None else self.written_steps

    @cached_property
    def rounding(self) -> float:
        """Standard deviation of the errors of rounding, over all coordinates, m: a step / root 12, GUM 4.3.7."""
        return float(np.sqrt(np.mean(self.steps**2) / 12))

    @cached_property
    def scatter(self) -> tuple[float, float | None] | None:
        """The repeatability with the errors of rounding, m, and its degrees of freedom (Welch and Satterthwaite), None
        where it is exactly known; None where no repeatability is."""
        if self.repeatability is None:
            return None
        sd, dof = float(np.hypot(self.repeatability, self.rounding)), self.repeatability_dof
        return sd, None if dof is None else dof * (sd / self.repeatability)**4

    @cached_property
    def _digest(self) -> bytes:
        """Of all fields."""
        values = (getattr(self, field.name) for field in fields(self))
        return sha256(b'|'.join(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
                                for value in values)).digest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Run) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    @property
    def size(self) -> int:
        """N, the number of readings."""
        return self.table_position.size

    @property
    def time_unit(self) -> str:
        """The unit of its times: 's', or 'reading' where they count the readings of a table without times."""
        counted = self.size > 1 and bool(np.all(np.abs(self.time - self.time[0] - np.arange(self.size)) < 1e-6))
        return 'reading' if counted else 's'

    @cached_property
    def balls(self) -> tuple[int, ...]:
        """Numbers of the balls that were measured, ascending."""
        return tuple(np.unique(self.ball).tolist())

    @cached_property
    def cmm_position(self) -> Ints:
        """(N,) one-based CMM position."""
        return cmm_position(self.n, self.table_position, self.ball)

    @cached_property
    def phi(self) -> Floats:
        """(N,) nominal table angle, rad."""
        return nominal_angles(self.n)[self.table_position - 1]

    @cached_property
    def beta(self) -> Floats:
        """(N,) azimuth of the ball on the plate, rad."""
        return nominal_angles(self.n)[self.ball - 1]

    @cached_property
    def alpha(self) -> Floats:
        """(N,) nominal azimuth of the CMM position, phi + beta modulo one turn, rad."""
        return nominal_angles(self.n)[self.cmm_position - 1]

    @cached_property
    def angle_deviation(self) -> Floats:
        """(N,) actual minus nominal table angle, in [-pi, pi), rad."""
        return wrap(self.table_angle - self.phi)

    @cached_property
    def _way(self) -> Way | None:
        """Where table and CMM went, None where it is not known or the readings make no sense."""
        places = (self.table_position, self.ball, np.asarray(self.approach))
        is_sound = self.n >= 3 and {one.shape for one in places} == {(self.size,)} and self.size > 0
        return Way.of(self.n, *places) if is_sound and min(places[0].min(), places[1].min()) > 0 and max(
            places[0].max(), places[1].max()) <= self.n else None

    def _derived_travel(self) -> Floats:
        return (unwrap_travel(self.table_angle, self.approach, self.n) if self._way is None
                else self._way.travel(self.n, np.asarray(self.table_angle, dtype=float)))

    def _derived_sense(self) -> Floats:
        return self._way.cmm_sense(self.n, self.rotation) if self._way else unknown_sense(self.size, self.rotation)

    @cached_property
    def pauses(self) -> tuple[int, ...]:
        """Positions 0..N-1 of the readings that were the first after a pause."""
        return tuple((np.flatnonzero(np.diff(self.session)) + 1).tolist())

    @cached_property
    def is_complete(self) -> bool:
        """Whether every (table position, ball) was measured exactly once."""
        return self.size == self.n**2 and self.completeness == 1

    @property
    def is_gapless(self) -> bool:
        """Whether the CMM went from reading to reading: none is missing but whole balls or CMM positions, by plan.

        What follows when every pair has been measured once goes on from there."""
        way, whole = self._way, _distinct(self.cells)
        return way is not None and way.place.size == way.ball.size and _distinct(self.cells[:whole]) == whole

    @cached_property
    def completeness(self) -> float:
        """Measured share of the n*n pairs of table position and ball."""
        return _distinct(self.cells) / self.n**2

    @property
    def cells(self) -> Ints:
        """(N,) number of the pair of table position and ball, 0..n*n-1."""
        return (self.table_position - 1) * self.n + self.ball - 1

    def from_angle_zero(self) -> tuple[Floats, Floats | None]:
        """Return centres (N, 3) and rotation in the table frame with ball 1 on x at table angle 0."""
        return turned_frame(-self.table_offset, self.centre, self.rotation)

    def replace(self, **changes: Any) -> 'Run':
        """Return a copy with other values of some fields.

        The CMM's senses of other readings are derived anew, the steps of other coordinates found anew."""
        derived_of = {'table_position', 'ball', 'rotation'} & changes.keys()
        anew: dict[str, Any] = {'cmm_sense': None, 'unrecorded': None} if derived_of else {}
        anew |= {'written_steps': None} if 'centre' in changes else {}
        return replace(self, **{**anew, **changes})

    def take(self, index: Bools | Ints | list[int]) -> 'Run':
        """Return the run with only the readings of a mask or of positions, in the same order."""
        steps = self.written_steps
        return replace(self, written_steps=None if steps is None else steps[index],
                       **{name: getattr(self, name)[index] for name in _INTEGERS + _REALS})


def _check_rotation(record: Any) -> None:
    """Freeze the rotation of a record; raises InvalidData where it is none."""
    if record.rotation is None:
        return
    _freeze(record, ('rotation',), float)
    if record.rotation.shape != (3, 3) or not np.abs(record.rotation @ record.rotation.T - np.eye(3)).max() < 1e-6 or (
            np.linalg.det(record.rotation) < 0):
        raise InvalidData(f'{getattr(record, "source", "error motions")}: rotation: expected a rotation matrix of the '
                          f'table frame in the machine frame, found {record.rotation.tolist()!r:.120}')


def _check_run(run: Run) -> None:
    where = run.source
    if run.n < 3:
        raise InvalidData(f'{where}: expected at least 3 balls, found n = {run.n}')
    if not (np.isfinite(run.radius) and run.radius > 0):
        raise InvalidData(f'{where}: expected a positive radius in metres, found {run.radius}')
    size = run.table_position.size
    if size == 0:
        raise InvalidData(f'{where}: expected ball centres, found none')
    for name in _INTEGERS + _REALS:
        shape = (size, 3) if name in ('centre', 'cmm_sense') else (size,)
        got = getattr(run, name).shape
        if got != shape:
            raise InvalidData(f'{where}: {name}: expected shape {shape}, found {got}')
    if run.written_steps is not None and (run.written_steps.shape != (size, 3) or not np.all(run.written_steps >= 0)):
        raise InvalidData(f'{where}: written_steps: expected steps of {size} readings along 3 axes, found '
                          f'{run.written_steps.tolist()!r:.120}')
    for name in ('table_position', 'ball'):
        values = getattr(run, name)
        bad = np.flatnonzero((values < 1) | (values > run.n))
        if bad.size:
            raise InvalidData(f'{where}: reading {bad[0] + 1}: {name}: expected 1..{run.n}, found {values[bad[0]]}')
    for name in ('centre', 'table_angle', 'time', 'table_travel'):
        values = getattr(run, name).reshape(size, -1)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise InvalidData(f'{where}: reading {bad[0] + 1}: {name}: expected finite numbers, found {values[bad[0]]}')
    if not np.isfinite(run.table_offset):
        raise InvalidData(f'{where}: table_offset: expected a finite angle, found {run.table_offset}')
    if run.repeatability is not None and not is_size(run.repeatability):
        raise InvalidData(f'{where}: repeatability: expected a positive number of metres, found {run.repeatability}')
    by_axis = run.repeatability_axes
    if by_axis is not None and not (len(by_axis) == 3 and all(map(is_size, by_axis))):
        raise InvalidData(f'{where}: repeatability_axes: expected 3 positive numbers of metres, found {by_axis}')
    _check_duplicates(run)
    _check_angles(run)


def _distinct(cells: Ints) -> int:
    """Return the number of distinct cells; few readings of a plate of many balls need no memory for all n*n."""
    if cells.max() < 8 * cells.size + 1024:
        return int(np.count_nonzero(np.bincount(cells)))
    return np.unique(cells).size


def _check_duplicates(run: Run) -> None:
    if not run.repeats and _distinct(run.cells) < run.size:
        order = np.argsort(run.cells, kind='stable')
        again = np.flatnonzero(np.diff(run.cells[order]) == 0)
        first, second = order[again[0]] + 1, order[again[0] + 1] + 1
        raise InvalidData(
            f'{run.source}: readings {first} and {second} are both table position {run.table_position[first - 1]}, '
            f'ball {run.ball[first - 1]}; expected each pair once. Remove one, or mark planned repeats')


def _check_angles(run: Run) -> None:
    bad = np.flatnonzero(np.abs(run.angle_deviation) > np.pi / run.n)
    if not bad.size:
        return
    first = bad[0]
    as_radians = np.all(np.abs(wrap(run.table_angle - np.deg2rad(run.phi))) < 1e-3)
    hint = '; the angles look like radians where degrees were wanted' if as_radians else ''
    position = run.table_position[first]
    raise InvalidData(
        f'{run.source}: reading {first + 1}: table_angle: expected about {360 * (position - 1) / run.n:.6g} deg for '
        f'table position {position} of {run.n}, found {np.rad2deg(run.table_angle[first]) % 360:.6g} deg{hint}')


@dataclass(frozen=True, eq=False)
class ErrorMotions:
    """The six error motions with standard uncertainties.

    angle: (n,) rad; values, u: (n, 6) in the order of CURVES, m and rad; rotation: as of Run.
    """

    angle: Floats
    values: Floats
    u: Floats
    rotation: Floats | None = None

    def __post_init__(self) -> None:
        _freeze(self, ('angle', 'values', 'u'), float)
        _check_rotation(self)

    @property
    def iso_names(self) -> dict[str, str]:
        """The names of the curves after ISO 230-1, by those in CURVES."""
        return iso_names(self.rotation)

    @staticmethod
    def from_curves(angle: ArrayLike, curves: Sequence[ArrayLike], spread: Sequence[ArrayLike],
                    rotation: Floats | None = None) -> 'ErrorMotions':
        """Return the record of six curves and their six uncertainties, each (n,); raises InvalidData."""
        columns = [np.asarray(one, dtype=float) for one in (angle, *curves, *spread)]
        if len({one.shape for one in columns}) > 1 or columns[0].ndim != 1:
            raise InvalidData(f'error motions: expected {len(columns) - 1} curves with a value at each angle, found '
                              f'{", ".join(str(one.size) for one in columns)} values')
        values, u = (np.stack(half, axis=-1) for half in (columns[1:7], columns[7:]))
        return ErrorMotions(columns[0], values, u, rotation)

    def turned_back(self, angle: float) -> 'ErrorMotions':
        """Return the curves along x and y turned by -angle, rad: for a table offset those of angle 0; u unrelated."""
        if angle == 0:
            return self
        turned = rotate_z(angle, self.values.reshape(-1, 2, 3)).reshape(-1, 6)
        cosine, sine = np.cos(angle)**2, np.sin(angle)**2
        (x, y), squares = ([0, 3], [1, 4]), self.u**2
        squares[:, x], squares[:, y] = (cosine * self.u[:, one]**2 + sine * self.u[:, other]**2
                                        for one, other in ((x, y), (y, x)))
        rotation = turned_frame(-angle, np.zeros((0, 3)), self.rotation)[1]
        return ErrorMotions(self.angle, turned, np.sqrt(squares), rotation)

    def __getitem__(self, curve: str) -> Floats:
        """Return one curve, (n,), by its VDI/VDE 2617 name."""
        return self.values[:, CURVES.index(curve)]

    def uncertainty(self, curve: str) -> Floats:
        """Return the standard uncertainty of one curve, (n,)."""
        return self.u[:, CURVES.index(curve)]


def resolution_of(coordinates: ArrayLike) -> float:
    """Return the step of which all coordinates, m, are whole numbers, found from their digits; 0 where there is none.

    Where they have the same few significant digits instead, their steps differ; then it is the largest, see steps_of.
    """
    return float(np.max(steps_of(coordinates), initial=0.0))


def steps_of(coordinates: ArrayLike) -> Floats:
    """Return the step to which each coordinate, m, is rounded, as an array of their shape, 0 where it is not.

    It is the same for all, or a unit of the last of the same few significant digits, which the size of a number
    decides. Zeros, which every step divides, tell nothing.
    """
    every = np.asarray(coordinates, dtype=float)
    sizes = np.abs(every[every != 0])
    steps = np.zeros(every.shape)
    units = 10.0**np.floor(np.log10(sizes) + 1e-12)
    last = (units * 10.0**(1 - digits) for digits in range(1, MOST_DIGITS + 1))
    if step := next((step for step in STEPS if _are_whole(sizes, step, 1e-4)), 0.0):
        steps[...] = step
    elif (found := next((one for one in last if _are_whole(sizes, one, 1e-6)), None)) is not None:
        steps[every != 0] = found
    return steps if steps.any() and np.unique(sizes).size >= FEWEST_DIGITS else np.zeros(every.shape)


def turned_steps(steps: Floats, rotation: Floats) -> Floats:
    """Return steps (N, 3) along the axes of a frame, the columns of its rotation, whose errors have the same variance.
    """
    return np.asarray(np.sqrt(steps**2 @ rotation**2))


def _are_whole(values: Floats, step: float | Floats, tolerance: float) -> bool:
    """Return whether values are whole numbers of a step, the first few of them first: most are not."""
    for some in (slice(FEWEST_DIGITS), slice(None)):
        count = values[some] / (step[some] if isinstance(step, np.ndarray) else step)
        if not np.all(np.abs(count - np.rint(count)) < tolerance):
            return False
    return True


def remove_gauge(values: ArrayLike, angle: Floats | None = None) -> Floats:
    """Return curves (n, 6) without the ten parts that no three-rosette run can know.

    Removed are the means of all six, the once-per-turn part of (ctx, cty) that looks like
    eccentricity of the plate and that of (crx, cry) that looks like its tilt: equations (1)-(16).
    """
    curves: Floats = np.asarray(values, dtype=float)
    curves = curves - curves.mean(axis=0)
    turn = np.exp(1j * (nominal_angles(len(curves)) if angle is None else angle))
    out = curves.copy()
    for x, y in ((0, 1), (3, 4)):
        pair = curves[:, x] + 1j * curves[:, y]
        pair = pair - np.mean(pair * turn.conj()) * turn
        out[:, x], out[:, y] = pair.real, pair.imag
    return out


__all__ = ['CURVES', 'Bools', 'ErrorMotions', 'Floats', 'Ints', 'Run', 'remove_gauge', 'resolution_of', 'steps_of',
           'turned_steps']
