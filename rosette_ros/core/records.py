# SPDX-License-Identifier: Apache-2.0
"""The records that pass between the rooms: frozen, SI, shapes written once."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import TWO_PI, nominal_angles, wrap
from rosette_ros.core.scheme import cmm_position, travel_sense, unwrap_travel

CURVES = ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')
"""Names of the six error motions after VDI/VDE 2617, in the order of every (n, 6) array."""

ISO_NAMES = {'ctx': 'EXC', 'cty': 'EYC', 'ctz': 'EZC', 'crx': 'EAC', 'cry': 'EBC', 'crz': 'ECC'}
"""The same curves after ISO 230-1 and ISO 230-7."""


def _frozen(array, dtype=float):
    array = np.array(array, dtype=dtype)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Run:
    """Ball centres of one measuring run, N readings in measuring order.

    n: number of balls and of table positions; radius: nominal radius of the circle of ball
    centres, m; table_position, ball: (N,) one-based; centre: (N, 3), m, in the table frame;
    table_angle: (N,) actual angle, rad; time: (N,) s since any origin; temperature: (N,) °C, NaN
    where unknown; approach: (N,) sense of the table's last move, +1, -1, 0 if unknown;
    table_travel: (N,) unwrapped table angle, rad; repeatability: standard deviation of a
    coordinate from repeated measurements, m, or None; repeatability_dof: its degrees of freedom,
    None if it is taken as exactly known; repeats: whether a (table_position, ball) may stand more
    than once; session: (N,) 1 and one more after every pause (a run that was resumed, a CMM that was
    started again), all 1 by default.

    Raises InvalidData where shapes, ranges or values are wrong.
    """

    n: int
    radius: float
    table_position: np.ndarray
    ball: np.ndarray
    centre: np.ndarray
    table_angle: np.ndarray
    time: np.ndarray
    temperature: np.ndarray
    approach: np.ndarray
    table_travel: np.ndarray
    repeatability: float | None = None
    repeatability_dof: float | None = None
    run_id: str = ''
    repeats: bool = False
    session: np.ndarray | None = None
    source: str = field(default='run', compare=False)

    def __post_init__(self):
        """Freeze the arrays and refuse what cannot be a run."""
        if self.session is None:
            object.__setattr__(self, 'session', np.ones(np.size(self.table_position), dtype=np.int64))
        for name in ('table_position', 'ball', 'approach', 'session'):
            object.__setattr__(self, name, _frozen(getattr(self, name), np.int64))
        for name in ('centre', 'table_angle', 'time', 'temperature', 'table_travel'):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        _check_run(self)

    @staticmethod
    def from_readings(n, radius, table_position, ball, centre, table_angle=None, time=None,
                      temperature=None, approach=None, table_travel=None, **rest):
        """Return a Run, deriving what was not recorded.

        Missing angles are nominal, times count readings, temperatures are NaN, approach is 0
        (unknown) and the travel is unwrapped from angles and approach.
        """
        table_position = np.asarray(table_position)
        size = table_position.size
        if table_angle is None:
            table_angle = nominal_angles(n)[table_position - 1]
        approach = np.zeros(size, dtype=int) if approach is None else np.asarray(approach)
        if table_travel is None:
            table_travel = unwrap_travel(table_angle, approach, n)
        return Run(
            n=n, radius=radius, table_position=table_position, ball=ball, centre=centre,
            table_angle=table_angle,
            time=np.arange(size, dtype=float) if time is None else time,
            temperature=np.full(size, np.nan) if temperature is None else temperature,
            approach=approach, table_travel=table_travel, **rest)

    @property
    def size(self):
        """N, the number of readings."""
        return self.table_position.size

    @cached_property
    def cmm_position(self):
        """(N,) one-based CMM position."""
        return cmm_position(self.n, self.table_position, self.ball)

    @cached_property
    def phi(self):
        """(N,) nominal table angle, rad."""
        return nominal_angles(self.n)[self.table_position - 1]

    @cached_property
    def beta(self):
        """(N,) azimuth of the ball on the plate, rad."""
        return nominal_angles(self.n)[self.ball - 1]

    @cached_property
    def alpha(self):
        """(N,) nominal azimuth of the CMM position, phi + beta modulo one turn, rad."""
        return nominal_angles(self.n)[self.cmm_position - 1]

    @cached_property
    def angle_deviation(self):
        """(N,) actual minus nominal table angle, in [-pi, pi), rad."""
        return wrap(self.table_angle - self.phi)

    @cached_property
    def cmm_sense(self):
        """(N, 3) sense of the CMM's last move along x, y, z; 0 before the first one."""
        x, y = np.cos(self.alpha), np.sin(self.alpha)
        senses = [travel_sense(axis, 1e-6) for axis in (x, y)]
        return np.stack([*senses, np.zeros(self.size)], axis=-1)

    @cached_property
    def pauses(self):
        """Positions 0..N-1 of the readings that were the first after a pause."""
        return tuple((np.flatnonzero(np.diff(self.session)) + 1).tolist())

    @cached_property
    def is_complete(self):
        """Whether every (table position, ball) was measured exactly once."""
        return self.size == self.n**2 and self.completeness == 1

    @cached_property
    def completeness(self):
        """Measured share of the n*n pairs of table position and ball."""
        cell = (self.table_position - 1) * self.n + self.ball - 1
        return _different(cell) / self.n**2

    def replace(self, **changes):
        """Return a copy with other values."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return Run(**{**values, **changes})

    def take(self, index):
        """Return the run with only the readings of `index` (mask or positions), same order."""
        names = ('table_position', 'ball', 'centre', 'table_angle', 'time', 'temperature',
                 'approach', 'table_travel', 'session')
        return self.replace(**{name: getattr(self, name)[index] for name in names})


def _check_run(run):
    where = run.source
    if run.n < 3:
        raise InvalidData(f'{where}: wanted at least 3 balls, got n = {run.n}')
    if not (np.isfinite(run.radius) and run.radius > 0):
        raise InvalidData(f'{where}: wanted a positive radius in metres, got {run.radius}')
    size = run.table_position.size
    if size == 0:
        raise InvalidData(f'{where}: wanted ball centres, got none')
    shapes = {'table_position': (size,), 'ball': (size,), 'centre': (size, 3),
              'table_angle': (size,), 'time': (size,), 'temperature': (size,),
              'approach': (size,), 'table_travel': (size,), 'session': (size,)}
    for name, shape in shapes.items():
        got = getattr(run, name).shape
        if got != shape:
            raise InvalidData(f'{where}: {name}: wanted shape {shape}, got {got}')
    for name in ('table_position', 'ball'):
        values = getattr(run, name)
        bad = np.flatnonzero((values < 1) | (values > run.n))
        if bad.size:
            raise InvalidData(f'{where}: reading {bad[0] + 1}: {name}: wanted 1..{run.n}, '
                              f'got {values[bad[0]]}')
    for name in ('centre', 'table_angle', 'time', 'table_travel'):
        values = getattr(run, name).reshape(size, -1)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise InvalidData(f'{where}: reading {bad[0] + 1}: {name}: wanted finite numbers, '
                              f'got {values[bad[0]]}')
    if run.repeatability is not None and not (
            np.isfinite(run.repeatability) and run.repeatability > 0):
        raise InvalidData(f'{where}: repeatability: wanted a positive number of metres, '
                          f'got {run.repeatability}')
    _check_duplicates(run)
    _check_angles(run)


def _different(cells):
    """Return how many cells differ; few of a plate of many balls take no memory for all of them."""
    if cells.max() < 8 * cells.size + 1024:
        return np.count_nonzero(np.bincount(cells))
    return np.unique(cells).size


def _check_duplicates(run):
    if run.repeats:
        return
    cell = (run.table_position - 1) * run.n + run.ball - 1
    if _different(cell) < cell.size:
        order = np.argsort(cell, kind='stable')
        again = np.flatnonzero(np.diff(cell[order]) == 0)
        first, second = order[again[0]] + 1, order[again[0] + 1] + 1
        raise InvalidData(
            f'{run.source}: readings {first} and {second} are both table position '
            f'{run.table_position[first - 1]}, ball {run.ball[first - 1]}; wanted each pair once. '
            'Remove one, or mark planned repeats')


def _check_angles(run):
    deviation = np.abs(wrap(run.table_angle - nominal_angles(run.n)[run.table_position - 1]))
    bad = np.flatnonzero(deviation > np.pi / run.n)
    if not bad.size:
        return
    first = bad[0]
    hint = ''
    in_degrees = np.deg2rad(nominal_angles(run.n)[run.table_position - 1])
    if np.all(np.abs(wrap(run.table_angle - in_degrees)) < 1e-3):
        hint = '; the angles look like radians where degrees were wanted'
    raise InvalidData(
        f'{run.source}: reading {first + 1}: table_angle: wanted about '
        f'{360 * (run.table_position[first] - 1) / run.n:.6g} deg for table position '
        f'{run.table_position[first]} of {run.n}, got '
        f'{np.rad2deg(run.table_angle[first]) % 360:.6g} deg{hint}')


@dataclass(frozen=True, eq=False)
class ErrorMotions:
    """The six error motions with standard uncertainties.

    angle: (n,) rad; values, u: (n, 6) in the order of CURVES, m and rad.
    """

    angle: np.ndarray
    values: np.ndarray
    u: np.ndarray

    def __post_init__(self):
        """Freeze the arrays."""
        for name in ('angle', 'values', 'u'):
            object.__setattr__(self, name, _frozen(getattr(self, name)))

    @staticmethod
    def from_curves(angle, values, u):
        """Return the record of six curves and their six uncertainties, each (n,); raises InvalidData."""
        columns = [np.asarray(one, dtype=float) for one in (angle, *values, *u)]
        if len({one.shape for one in columns}) > 1 or columns[0].ndim != 1:
            raise InvalidData(f'error motions: wanted {len(columns) - 1} curves with a value at each angle, got '
                              f'{", ".join(str(one.size) for one in columns)} values')
        return ErrorMotions(columns[0], *(np.stack(half, axis=-1) for half in (columns[1:7], columns[7:])))

    def __getitem__(self, curve):
        """Return one curve, (n,), by its VDI/VDE 2617 name."""
        return self.values[:, CURVES.index(curve)]

    def uncertainty(self, curve):
        """Return the standard uncertainty of one curve, (n,)."""
        return self.u[:, CURVES.index(curve)]


def remove_gauge(values, angle=None):
    """Return curves (n, 6) without the ten parts that no three-rosette run can know.

    Removed are the means of all six, the once-per-turn part of (ctx, cty) that looks like
    eccentricity of the plate and that of (crx, cry) that looks like its tilt: equations (1)-(16).
    """
    values = np.asarray(values, dtype=float)
    angle = nominal_angles(len(values)) if angle is None else angle
    values = values - values.mean(axis=0)
    turn = np.exp(1j * angle)
    out = values.copy()
    for x, y in ((0, 1), (3, 4)):
        pair = values[:, x] + 1j * values[:, y]
        pair = pair - np.mean(pair * turn.conj()) * turn
        out[:, x], out[:, y] = pair.real, pair.imag
    return out


__all__ = ['CURVES', 'ISO_NAMES', 'TWO_PI', 'ErrorMotions', 'Run', 'remove_gauge']
