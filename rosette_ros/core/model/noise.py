# SPDX-License-Identifier: Apache-2.0
"""The noise of the readings: unequal axes, places, tails and digits, a frame that wanders; how it is made white.

A reading r along axis a has the noise s e + u: s = axis factor x factor of its place / root of its Student weight x
what its digits make of it, e white; u wanders with the readings, u_r = phi u_(r-1) + white. The variance of u is
`wander` (phi = 1: per reading). In relative units: a check of CHECK readings in a row would find the variance 1 on
average. White noise of equal size is all ones.

With D the operator x_r - phi x_(r-1), D (s e + u) has a covariance of three diagonals, G G': W = G^-1 D makes the noise
white, in O(N) operations whatever s is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy  # which loads its parts where they are used
from numpy.typing import NDArray

from rosette_ros.core.run.records import Floats, Ints, Run

AXES = ('x', 'y', 'z')
CHECK = 10
SECTIONS = 12
BLOCK = 24
"""Readings of a block."""
SAME = 0.99
"""Share of readings in which two places agree that cannot be distinguished."""
FEWEST = 0.1
"""Share of its degrees of freedom that a repeatability keeps, at least, under heavy tails: (dof - 4) / (dof - 1)."""
Real = TypeVar('Real', bound=np.floating[Any])
"""Single or double precision; what is made of columns keeps that of them."""


class Group(NamedTuple):
    """Readings that share something: by what, the number of their group, from 1, and how many there are."""

    by: str
    number: int
    groups: int


@dataclass(frozen=True, eq=False)
class Noise:
    """What the noise of a run is like, relative to its size.

    axes: (3,) standard deviation of the unwandering part along x, y, z; by: what the size differs by (as `places`), ''
    nothing; factors: (groups,) size of each; tail: '' normal, `coordinate` or `reading` for Student's distribution of
    tail_dof degrees of freedom of each; weight: (N, 3) Student weights in this run; phi, wander: (3,) as above;
    digits: (N, 3) standard deviation, rounding included, where the coordinates of the run are rounded to steps that
    differ; None where rounding has no step, or the same for all, which makes white noise larger, and no more.
    """

    axes: Floats = field(default_factory=lambda: np.ones(3))
    by: str = ''
    factors: Floats = field(default_factory=lambda: np.ones(1))
    tail: str = ''
    tail_dof: float = float('inf')
    weight: Floats | None = None
    phi: float = 0.0
    wander: Floats = field(default_factory=lambda: np.zeros(3))
    digits: Floats | None = None

    @property
    def is_white(self) -> bool:
        """Whether the noise is white and equal in all."""
        return self.is_alike and not self.wander.any() and bool(np.all(self.axes == 1))

    @property
    def is_alike(self) -> bool:
        """Whether it is the same for all readings."""
        return self.weight is None and self.digits is None and not self.by

    @property
    def kinds(self) -> tuple[str, ...]:
        """In what it is other than white and equal."""
        return tuple(kind for kind, has in (
            ('axes', np.ptp(self.axes) > 0 and not self.wander.any()), ('by ' + self.by, self.by),
            ('tail ' + self.tail, self.tail), ('wander', self.wander.any())) if has)

    @property
    def quietest(self) -> float:
        """The size, relative to the run's, that the noise of a check made at one place and time has at least.

        A check was made before the run: where the size changes with time, less by as much as neighbouring parts differ.
        """
        least = float(self.factors.min())
        return least * float(np.exp(-np.std(np.diff(np.log(self.factors))))) if self.by == 'time' else least

    @property
    def share_of_dof(self) -> float:
        """The share of its degrees of freedom that a repeatability keeps: heavy tails make its variance uncertain."""
        return max(1 - 3 / max(self.tail_dof - 1, 1.0), FEWEST)

    def loss(self, share: float) -> float:
        """Return the variance of what is fitted over that which the weights say: Student's are estimated themselves.

        (dof + p + 2)/(dof + p) K^2, p = 3 coordinates with a common weight, else 1: Fisher's information of Student's
        distribution, and K = 1 + share Var(psi')/(E psi')^2 as readings, a share of which are parameters, choose their
        own weights (Huber 1973). psi' is proportional to (1 - B)(1 - 2 B/p), B has a beta distribution (p/2, dof/2).
        """
        if not self.tail:
            return 1.0
        p = 3 if self.tail == 'reading' else 1
        k = np.arange(4)
        moments = np.cumprod([1.0, *((p / 2 + k) / ((p + self.tail_dof) / 2 + k))])
        slope = np.array([1, -1 - 2 / p, 2 / p])
        spread = np.convolve(slope, slope) @ moments / (slope @ moments[:3])**2 - 1
        return float((1 + 2 / (self.tail_dof + p)) * (1 + share * spread)**2)

    def whitening(self, run: Run) -> 'Whitening':
        """Return what makes the noise of a run white."""
        if self.is_alike:
            return Whitening(run.size, self.axes, self.phi, self.wander)
        sd = np.tile(self.axes, (run.size, 1)) if self.digits is None else self.axes * self.digits
        if self.by:
            sd = sd * self.factors[place_of(run, self.by)][:, None]
        if self.weight is not None:
            sd = sd / np.sqrt(self.weight)
        return Whitening(run.size, sd, self.phi, self.wander)

    def of_readings(self, run: Run, index: Ints) -> 'Noise':
        """Return the noise of some readings of a run, each with the size that it has among all of them."""
        if self.is_alike:
            return self
        weight = np.ones((run.size, 3)) if self.weight is None else self.weight
        if self.by:
            weight = weight / self.factors[place_of(run, self.by)][:, None]**2
        return replace(self, by='', factors=np.ones(1), weight=weight[index],
                       digits=None if self.digits is None else self.digits[index])

    def noisiest(self, run: Run) -> list[Group]:
        """Return the group whose factor is the largest, and what else its readings share in this order."""
        members = place_of(run, self.by) == self.factors.argmax()
        out: list[Group] = []
        for label, index, names in places(run):
            group = int(np.bincount(index[members]).argmax())
            if label != 'sequence' and np.mean((index == group) == members) > SAME:
                out.insert(0 if label == self.by else len(out), Group(label, group + 1, len(names)))
        return out

    def scaled(self) -> 'Noise':
        """Return the same noise with a variance of 1 within CHECK readings in a row; Student weights keep it."""
        apart = np.arange(1, CHECK)
        grown = apart if self.phi == 1 else 1 - self.phi**apart
        within = 2 * np.sum((CHECK - apart) * grown) / (CHECK * (CHECK - 1))
        total = float(np.mean(self.axes**2) + np.mean(self.wander) * within)
        return replace(self, axes=self.axes / np.sqrt(total), wander=self.wander / total)


def places(run: Run) -> Iterator[tuple[str, Ints, list[str]]]:
    """Yield what readings can be grouped by: its name, the group of each reading, (N,) from 0, and names of groups."""
    every = [str(k + 1) for k in range(run.n)]
    yield 'table position', run.table_position - 1, every
    yield 'ball', run.ball - 1, every
    yield 'CMM position', run.cmm_position - 1, every
    sections = min(SECTIONS, run.size // 3)
    time = run.time - run.time[0]
    edge = np.linspace(0, time[-1] or 1.0, sections + 1)
    section = np.clip(np.searchsorted(edge, time, side='right') - 1, 0, sections - 1)
    factor, unit = (1 / 60, 'min') if run.time_unit == 's' else (1.0, 'readings')
    yield 'time', section, [f'{factor * a:.0f}-{factor * b:.0f} {unit}' for a, b in pairwise(edge)]
    order = np.arange(run.size) * sections // run.size
    yield 'sequence', order, [f'{np.flatnonzero(order == s)[0] + 1}-{np.flatnonzero(order == s)[-1] + 1}'
                              for s in range(sections)]


def place_of(run: Run, by: str) -> Ints:
    """Return the group of each reading, (N,) from 0."""
    return next(index for label, index, _ in places(run) if label == by)


class Whitening:
    """W with W C W' = 1 for the covariance C of a run's noise; x, y and z are independent.

    sd: (3,) or (N, 3) standard deviation of the unwandering part; phi, wander: (3,) as of Noise.
    """

    def __init__(self, size: int, sd: Floats, phi: float = 0.0, wander: Floats | None = None) -> None:
        self.by_axis = sd.ndim == 1 and (wander is None or not wander.any())
        self.size, self.sd = size, sd
        wander = np.zeros(3) if wander is None else wander
        self._phi, self._wander = phi, wander
        self._made: dict[tuple[float, float] | int, AxisFilter] = {}
        self.is_plain = self.by_axis and bool(np.all(self.sd == 1))
        self.is_diagonal = not wander.any()

    def scale_of(self, axes: Sequence[int]) -> float:
        """Return the factor by which W multiplies rows along some axes, 0 where it does more than that."""
        sizes = {float(self.sd[axis]) for axis in axes} if self.by_axis else set()
        return 1 / sizes.pop() if len(sizes) == 1 else 0.0

    def along(self, axis: int) -> 'AxisFilter':
        """Return W of one axis, where the noise wanders."""
        key = (float(self.sd[axis]), float(self._wander[axis])) if self.sd.ndim == 1 else axis
        if key not in self._made:
            sd = np.broadcast_to(self.sd, (self.size, 3))[:, axis]
            self._made[key] = AxisFilter(sd, self._phi, float(self._wander[axis]))
        return self._made[key]

    def log_det_of(self, axes: Sequence[int]) -> float:
        """Return the logarithm of det C of some axes."""
        if self.is_diagonal:
            return -2 * float(np.sum(np.log(self.factors[:, list(axes)])))
        return float(sum(self.along(axis).log_det for axis in axes))

    @cached_property
    def factors(self) -> Floats:
        """The diagonal of W where it is diagonal, (N, 3)."""
        factors: Floats = 1 / np.broadcast_to(self.sd, (self.size, 3))
        return factors

    def apply(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return W of columns (m, N, 3), same shape and precision."""
        return self._each('apply', columns)

    def adjoint(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return W' of columns (m, N, 3), same shape and precision."""
        return self._each('adjoint', columns)

    def inverse(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return W^-1 of columns (m, N, 3), same shape and precision: what white noise becomes."""
        return self._each('inverse', columns)

    def _each(self, what: str, columns: NDArray[Real]) -> NDArray[Real]:
        if self.is_plain:
            return columns
        if self.is_diagonal:
            factors = self.factors.astype(columns.dtype)
            scaled: NDArray[Real] = np.divide(columns, factors) if what == 'inverse' else np.multiply(columns, factors)
            return scaled
        out = np.zeros_like(columns)
        for axis in range(3):
            busy = columns[..., axis].any(axis=-1)
            if busy.any():
                out[busy, :, axis] = getattr(self.along(axis), what)(columns[busy, :, axis].T).T
        return out


class AxisFilter:
    """W of one axis, columns (N, m) to columns (N, m); log_det: the logarithm of det C of the axis.

    Its readings stand in blocks of BLOCK: W of a block is that of its readings, and the first column of G^-1 times what
    the block before hands on, one number for each column."""

    def __init__(self, sd: Floats, phi: float, wander: float) -> None:
        self._phi = phi = phi if wander else 0.0
        self._first = np.sqrt(1 - phi**2) if phi < 1 else 1.0
        scale = np.full(sd.size, 1.0)
        scale[0] = self._first
        drive = wander * (1 - phi**2) if phi < 1 else wander
        variance = sd**2
        band = np.zeros((2, sd.size))
        band[0] = drive + (scale * sd)**2
        band[0, 1:] += phi**2 * variance[:-1]
        band[1, :-1] = -phi * variance[:-1] * scale[:-1]
        self._band: Floats = scipy.linalg.cholesky_banded(band, lower=True, check_finite=False)
        self.log_det = 2 * float(np.sum(np.log(self._band[0])) - np.log(self._first))

    @cached_property
    def _in_blocks(self) -> tuple[Floats, Floats]:
        """G^-1 D in blocks of BLOCK readings, (b, B, B), and the first columns of G^-1 in each, (b, B)."""
        size, count = len(self._band[0]), -(-len(self._band[0]) // BLOCK)
        every = np.zeros((4, count * BLOCK))  # diagonals of G and D, and those below
        every[0], every[2] = 1.0, 1.0
        every[0, :size], every[1, 1:size] = self._band[0], self._band[1, :-1]
        every[2, 0], every[3, 1:size] = self._first, -self._phi
        parts = every.reshape(4, count, BLOCK)
        both, place = np.zeros((2, count, BLOCK, BLOCK)), np.arange(BLOCK)
        both[:, :, place, place], both[:, :, place[1:], place[:-1]] = parts[::2], parts[1::2, :, 1:]
        inverse = np.linalg.inv(both[0])
        return np.asarray(inverse @ both[1]), inverse[:, :, 0]

    def _blocks(self, dtype: Any) -> list[tuple[slice, NDArray[Any], NDArray[Any]]]:
        """Return of each block its readings and its parts of `_in_blocks`."""
        size, (inside, first) = len(self._band[0]), (one.astype(dtype, copy=False) for one in self._in_blocks)
        parts = [slice(start, min(start + BLOCK, size)) for start in range(0, size, BLOCK)]
        width = [part.stop - part.start for part in parts]
        return [(part, own[:w, :w], one[:w]) for part, own, one, w in zip(parts, inside, first, width)]

    def normal_equations(self, columns: Any) -> Floats:
        """Return (W A)' W A, (q, q), of columns A (N, q), dense where these are few, or sparse.

        Of sparse ones no product is written out: what a block hands on follows from its rows and what it was handed."""
        if isinstance(columns, np.ndarray):
            own = self.apply(columns)
            return np.asarray(own.T @ own)
        size, (inside, first) = columns.shape[0], self._in_blocks
        count, start = len(first), np.minimum(np.arange(len(first) + 1) * BLOCK, size)
        below = np.append(self._band[1, start[1:-1] - 1], 0.0)
        ends = -below[:, None] * inside[:, -1]
        ends[:, -1] -= self._phi
        each = np.stack([ends, np.einsum('bij,bi->bj', inside, first)]).reshape(2, -1)[:, :size].ravel()
        sums = scipy.sparse.csr_array((each, np.tile(np.arange(size), 2), np.append(start, size + start[1:]))) @ columns
        handed, met = np.split(sums.toarray(), 2)  # over each block, (b, q)
        handed, kept = np.roll(handed, 1, axis=0), np.roll(-below * first[:, -1], 1)
        handed[0] = 0.0
        for block in range(1, count):
            handed[block] += kept[block] * handed[block - 1]
        both = (met + 0.5 * np.sum(first**2, axis=1)[:, None] * handed).T @ handed
        pairs = scipy.sparse.bsr_array((inside.swapaxes(1, 2) @ inside, np.arange(count), np.arange(count + 1)))
        return np.asarray((columns.T @ (pairs.tocsr()[:size, :size] @ columns)).toarray() + both + both.T)

    def apply(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Return W of columns."""
        out = np.empty(columns.shape, columns.dtype)
        for part, inside, first in self._blocks(columns.dtype):
            np.matmul(inside, columns[part], out=out[part])
            if last := part.start:
                before = -self._phi * columns[last - 1] - float(self._band[1, last - 1]) * out[last - 1]
                out[part] += first[:, None] * before
        return out

    def adjoint(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Return W' of columns: what a block was handed goes back to the block before."""
        out, given = np.empty(columns.shape, columns.dtype), columns.copy()
        handed = np.zeros(columns.shape[1], columns.dtype)
        for part, inside, first in reversed(self._blocks(columns.dtype)):
            np.matmul(inside.T, given[part], out=out[part])
            out[part.stop - 1] -= self._phi * handed
            if last := part.start:
                handed = first @ given[part]
                given[last - 1] -= float(self._band[1, last - 1]) * handed
        return out

    def inverse(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Return W^-1 = D^-1 G of columns."""
        moved = self._band[0].astype(columns.dtype)[:, None] * columns
        moved[1:] += self._band[1, :-1].astype(columns.dtype)[:, None] * columns[:-1]
        difference = np.ones((2, len(columns)), columns.dtype)
        difference[0, 0], difference[1] = self._first, -self._phi
        return np.asarray(scipy.linalg.solve_banded((1, 0), difference, moved, check_finite=False))
