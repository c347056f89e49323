# SPDX-License-Identifier: Apache-2.0
"""The bank of candidates: every effect and free course at every setting, and what a model leaves of it.

With B the q columns of a setting, each axis freed of its mean, T makes T B orthonormal (of a free course: of the sizes
of its process). The bank keeps T and the products of what the model leaves, T B M B' T', and gives the products of T B
with any vectors that the model leaves. Columns are waves (functions of the readings) times directions, so that neither
has to be written out: B v' is a product of waves with directions times v.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.effects.composed import laws_of
from rosette_ros.core.effects.effect import Effect, Factors, Setting
from rosette_ros.core.effects.free import FREE, motions
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import JointSpace
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.waves import Waves
from rosette_ros.core.run.records import Floats, Ints, Run

Reals = NDArray[np.floating[Any]]
Key = tuple[int, bool]
"""Number of columns of the blocks of a group, and whether they are free courses."""
DEPENDENT = 1e-6
"""Eigenvalue of columns of unit length below which a direction is one of the others: rounding in single precision."""
WIDTHS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 28, 36, 48, 72, 96, 144, 192, 288, 576, 1152])
"""Numbers of columns of blocks that are looked at together; blocks of fewer are filled with zeros."""
CHUNK = 4_000_000
"""Numbers of columns that are written out at once."""


class CoordinateSpace(JointSpace):
    """Base model and columns of a model, solved by normal equations: coordinates of what they describe of others."""

    def __init__(self, space: BaseSpace, columns: Floats) -> None:
        super().__init__(space, columns, np.zeros((0, *columns.shape[1:])))

    def inside(self, rows: NDArray[Real]) -> NDArray[Real]:
        """Return coordinates (m, k) of what base model and effects describe of white rows (m, N, 3), orthonormal."""
        own: NDArray[Real] = rows.reshape(len(rows), -1) @ self._mixed.astype(rows.dtype).T
        return np.concatenate([self.space.inside(rows), own], axis=1)

    def inside_of(self, waves: Waves, directions: NDArray[Any]) -> NDArray[np.float32]:
        """Return these coordinates (m, d, k) of m waves times directions (d, N, 3) in diagonal noise, single."""
        white, count = directions * self.whitening.factors, len(self._mixed)
        mixed = np.einsum('dnc,knc->ndk', white, self._mixed.reshape(count, *white.shape[1:])).astype(np.float32)
        own = waves.times(mixed.reshape(len(mixed), len(white) * count)).reshape(waves.rows, len(white), count)
        return np.concatenate([self.space.inside_of(waves, directions), own], axis=2)


@dataclass(eq=False)
class CauseFamily:
    """All settings of an effect, or of a free course of some variables; log_prior: that a run has it; learnt: what
    experience of the cell has added to that."""

    effect: Effect
    name: str
    settings: tuple[Setting, ...]
    log_prior: float = 0.0
    learnt: float = 0.0

    @property
    def is_free(self) -> bool:
        """Whether it has no name."""
        return self.effect is FREE

    def log_prior_beside(self, same: int) -> float:
        """Return the log prior of one more beside so many of the same, of which any may be the first.

        What experience of a cell has added says that it is there, not how often."""
        return self.log_prior - self.learnt * (same > 0) - math.log(1 + same)

    @property
    def is_coarse(self) -> bool:
        """Whether several continuous parameters are searched, on a coarse grid."""
        return sum(one.kind != 'choice' for one in self.effect.searched) > 1


@dataclass(frozen=True, eq=False)
class Piece:
    """Blocks of a part along as many directions each: (b,) their waves, rising; (b, d) their directions.

    key, place: of the group, and where in it."""

    key: Key
    place: slice
    wave: Ints
    which: Ints

    def within(self, waves: slice) -> tuple[slice, Ints, Ints]:
        """Return the blocks of some waves, and their waves, from the first of these, and directions."""
        own = slice(*np.searchsorted(self.wave, (waves.start, waves.stop)).tolist())
        return own, self.wave[own] - waves.start, self.which[own]


class ColumnSet:
    """Columns that share directions: waves (v, m, N) times directions (d, N, 3), column (v, m, d).

    Waves that are zero beside few readings are kept at these.
    """

    def __init__(self, factors: Sequence[Factors]) -> None:
        self.directions, self.m = factors[0].directions.astype(np.float32), factors[0].waves.shape[1]
        self.settings = [setting for one in factors for setting in one.settings]
        first = np.cumsum([0, *(len(one.waves) for one in factors)])
        of_setting = [(wave + start, which) for one, start in zip(factors, first.tolist())
                      for wave, which in one.of_setting]
        self._wave, self._which = np.array([wave for wave, _ in of_setting]), [which for _, which in of_setting]
        self.v, size, longest = int(first[-1]), self.directions.shape[1], max(one.waves.shape[2] for one in factors)
        waves = np.zeros((self.v, self.m, longest), dtype=np.float32)
        at = np.zeros((self.v, longest), dtype=np.int32)
        for one, start in zip(factors, first.tolist()):
            own = slice(start, start + len(one.waves))
            waves[own, :, :one.waves.shape[2]] = one.waves
            if one.at is not None:
                at[own, :len(one.at)] = one.at
        self.waves = Waves(waves, None if factors[0].at is None else at)
        self.size = self.v * self.m * len(self.directions)
        self._pairs(size)

    def _pairs(self, size: int) -> None:
        """Find the directions, (p, 2), whose products are needed, and the place of each two among these, (d, d)."""
        near = np.abs(self.directions).reshape(-1, 3 * size)
        used = np.zeros((len(near), len(near)), dtype=bool)
        for which in set(self._which):
            used[np.ix_(which, which)] = True
        self.pairs = np.argwhere(np.triu(used & (near @ near.T > 0)))
        self.pair = np.full(used.shape, len(self.pairs))  # where there is nothing in common: the last, which is zero
        self.pair[self.pairs[:, 0], self.pairs[:, 1]] = self.pair[self.pairs[:, 1], self.pairs[:, 0]] = np.arange(
            len(self.pairs))

    def blocks(self) -> Iterator[tuple[list[int], Ints, Ints]]:
        """Yield the settings with as many directions each by their numbers, their waves, rising, and directions."""
        order, widths = np.argsort(self._wave, kind='stable'), np.array([len(which) for which in self._which])
        for width in np.unique(widths):
            some = order[widths[order] == width]
            yield some.tolist(), self._wave[some], np.array([self._which[k] for k in some])

    def chunks(self, numbers: int) -> Iterator[slice]:
        """Yield waves by slices of which all columns together have CHUNK numbers; numbers: of one column."""
        step = max(1, CHUNK // (self.m * len(self.directions) * numbers))
        yield from (slice(start, min(start + step, self.v)) for start in range(0, self.v, step))

    def dots(self, weight: Floats) -> Floats:
        """Return the products of the pairs of directions at each reading, weighted by (N, 3), and zero, (N, p + 1)."""
        first, second = self.directions[self.pairs.T]
        return np.column_stack([np.einsum('pnc,pnc,nc->np', first, second, weight), np.zeros(len(weight))])

    def squares(self, waves: slice, dots: Reals) -> Reals:
        """Return the products of some waves with each other and the products of directions, (v, m, m, p + 1)."""
        some = self.waves.within(waves)
        values = some.values.astype(dots.dtype, copy=False)
        out = np.empty((len(values), self.m, self.m, dots.shape[1]), dots.dtype)
        for k in range(self.m):
            made = Waves(values[:, k:k + 1] * values[:, k:], some.at).times(dots)
            out[:, k, k:] = out[:, k:, k] = made.reshape(len(values), self.m - k, -1)
        return out

    def gram(self, squares: Reals, wave: Ints, which: Ints) -> Reals:
        """Return the products of columns, (b, q, q), of blocks from those of `squares`."""
        made = squares[wave[:, None, None], :, :, self.pair[which[:, :, None], which[:, None]]]
        q = self.m * which.shape[1]
        return np.asarray(made.transpose(0, 3, 1, 4, 2).reshape(-1, q, q))

    def dense(self, waves: slice) -> Reals:
        """Return all columns of some waves, written out, (columns, N, 3)."""
        some, rows = self.waves.within(waves), self.waves.values[waves]
        if some.at is not None:
            rows = np.zeros((*rows.shape[:2], self.directions.shape[1]), rows.dtype)
            for reading, value in zip(some.at.T, some.values.transpose(2, 0, 1)):
                rows[np.arange(len(reading)), :, reading] += value
        return np.asarray((rows[:, :, None, :, None] * self.directions).reshape(-1, *self.directions.shape[1:]))

    def rows_of(self, of: Reals, wave: Ints, which: Ints) -> Reals:
        """Return the rows of blocks, (b, q, k), among those of all columns of some waves, (columns, k)."""
        every = of.reshape(-1, self.m, len(self.directions), of.shape[-1])
        made = every[wave[:, None], :, which].transpose(0, 2, 1, 3)
        return np.asarray(made.reshape(len(wave), -1, of.shape[-1]))

    def products(self, rows: Reals) -> Reals:
        """Return the products of all columns with raw rows (k, N, 3), (columns, k)."""
        weighted = np.matmul(self.directions.transpose(1, 0, 2), rows.transpose(1, 2, 0))  # (N, d, k)
        return np.asarray(self.waves.times(weighted.reshape(len(weighted), -1)).reshape(self.size, len(rows)))


@dataclass(eq=False)
class BlockGroup:
    """Blocks of as many columns, or fewer: family, setting: (b,) their numbers; column: (b, q) of the bank.

    number: (b,) of the settings among those of all families; most: (b,) largest norm of a displacement that physics
    allows, m; mix: T, (b, q, q), of free courses its diagonal, (b, q);
    0 where there are fewer columns.
    """

    family: Ints
    setting: Ints
    number: Ints
    column: Ints
    mix: Reals
    most: Floats

    @cached_property
    def rank(self) -> Ints:
        """The rank of each block, (b,)."""
        return np.asarray(np.count_nonzero(self.mix if self.mix.ndim == 2 else np.abs(self.mix).max(axis=2), axis=1))

    def mixed(self, rows: Reals, place: slice = slice(None)) -> Reals:
        """Return T of products (b, q, k) of the columns of some blocks, q as many as they have."""
        mix, q = self.mix[place], rows.shape[1]
        return mix[:, :q, None] * rows if mix.ndim == 2 else mix[:, :q, :q] @ rows


class Bank:
    """The candidates of a run; groups: by the number of columns, and whether they are free courses."""

    def __init__(self, run: Run, families: Sequence[CauseFamily], wider: 'Bank | None' = None) -> None:
        """Take families, those that have names first; wider: a bank of the same named ones, whose blocks are shared."""
        self.run, self.families, self._parts = run, tuple(families), list[tuple[ColumnSet, list[Piece]]]()
        self._parts_of, self.groups = dict[str, slice](), dict[Key, BlockGroup]()
        if wider:
            self._parts += [one for one in wider._parts if not one[1][0].key[1]]
            self._parts_of |= wider._parts_of
            self.groups |= {key: group for key, group in wider.groups.items() if not key[1]}
        made, free, shared = dict[Key, list[tuple[Ints, ...]]](), list[Setting](), len(self._parts)
        places = {id(setting): (number, k) for number, family in enumerate(families)
                  for k, setting in enumerate(family.settings)}
        for family in families:
            first = len(self._parts)
            if family.is_free:
                free += family.settings
            elif not wider:
                self._add(places, family.effect.factors(run, family.settings), False, made)
                self._parts_of[family.name] = slice(first, len(self._parts))
        self._add(places, _shared(run, free), True, made)
        self.ends = np.cumsum([0, *(len(family.settings) for family in families)]).tolist()
        self.range_of = {one.name: ends for one, ends in zip(families, zip(self.ends, self.ends[1:]))}
        for key, found in sorted(made.items()):
            of, setting, column = (np.concatenate([one[k] for one in found]) for k in range(3))
            mix = np.zeros((*column.shape, key[0])[:3 - key[1]], np.float32)
            self.groups[key] = BlockGroup(of, setting, np.array(self.ends)[of] + setting, column, mix,
                                          np.full(len(of), np.inf))
        for part, pieces in self._parts[shared:]:
            self._orthonormalise(part, pieces)

    def _add(self, places: Mapping[int, tuple[int, int]], factors: Iterable[Factors], is_free: bool,
             made: dict[Key, list[tuple[Ints, ...]]]) -> None:
        """Add the columns of factors; places: numbers of family and setting, by the identity of the setting, which is
        sooner known than its value; made: columns of groups."""
        alike: dict[tuple[int, int, bool], list[Factors]] = {}
        for one in factors:
            alike.setdefault((id(one.directions), one.waves.shape[1], one.at is None), []).append(one)
        for some in alike.values():
            part, start, pieces = ColumnSet(some), sum(each.size for each, _ in self._parts), []
            number = np.arange(start, start + part.size)[:, None]
            for numbers, wave, which in part.blocks():
                width = int(WIDTHS[np.searchsorted(WIDTHS, part.m * which.shape[1])])
                group = made.setdefault((width, is_free), [])
                begin = sum(len(each[0]) for each in group)
                pieces.append(Piece((width, is_free), slice(begin, begin + len(wave)), wave, which))
                column = part.rows_of(number, wave, which)[..., 0]
                family, setting = np.array([places[id(part.settings[k])] for k in numbers]).T
                group.append((family, setting, np.pad(column, ((0, 0), (0, width - column.shape[1])))))
            self._parts.append((part, pieces))

    def _orthonormalise(self, part: ColumnSet, pieces: Sequence[Piece]) -> None:
        """Fill in T of the blocks of a part."""
        size, flat = self.run.size, part.directions.astype(float).transpose(1, 0, 2)
        dots = part.dots(np.ones((size, 3)))
        for waves in part.chunks(12 * self.run.n):
            some = part.waves.within(waves)
            mean = some.times(flat.reshape(size, -1)).reshape(-1, 3) / np.sqrt(size)
            if pieces[0].key[1]:
                square = Waves(some.values.astype(float)**2, some.at).times(np.sum(flat**2, axis=2)).reshape(-1, 1)
                square -= np.sum(mean**2, axis=1, keepdims=True)
            else:
                squares = part.squares(waves, dots)
            for piece in pieces:
                own, wave, which = piece.within(waves)
                group, begin = self.groups[piece.key], piece.place.start
                place = slice(begin + own.start, begin + own.stop)
                q = part.m * which.shape[1]
                if piece.key[1]:
                    pairs = zip(wave.tolist(), group.family[place].tolist(), group.setting[place].tolist())
                    one_of = {course: (k, j) for course, k, j in pairs}  # all of a course have its variances
                    variances = {course: self.families[k].effect.variances(self.run, self.families[k].settings[j])
                                 for course, (k, j) in one_of.items()}
                    sums = part.rows_of(square, wave, which)[..., 0]
                    group.mix[place, :q] = scaled(sums, np.array([variances[course] for course in wave.tolist()]))
                else:
                    over = part.rows_of(mean, wave, which)
                    gram = np.asarray(part.gram(squares, wave, which) - over @ over.transpose(0, 2, 1), dtype=float)
                    group.mix[place, :q, :q] = self._mixed(gram, group.family[place], group.setting[place])
                    longest = np.sqrt(np.maximum(np.einsum('bqq->bq', gram).max(axis=1), 1e-300))
                    for number in np.unique(group.family[place]):
                        one = self.families[number]
                        if one.effect.is_limited:
                            at = np.flatnonzero(group.family[place] == number)
                            group.most[place.start + at] = longest[at] * [
                                one.effect.most(one.settings[j]) for j in group.setting[place][at]]

    def _mixed(self, gram: Floats, family: Ints, setting: Ints) -> Reals:
        """Return T (b, q, q) of products (b, q, q) of columns of named effects."""
        mix = orthonormal(gram)
        for number in np.unique(family):
            one = self.families[number]
            if np.ptp(one.effect.variances(self.run, one.settings[0])):
                own = np.flatnonzero(family == number)
                mix[own] = [sized(gram[k], one.effect.variances(self.run, one.settings[setting[k]])) for k in own]
        return mix

    def left(self, space: CoordinateSpace, of_free: bool = False) -> dict[Key, Reals]:
        """Return what a model leaves of the blocks of each group, T B M B' T', (b, q, q), by its key.

        of_free: of the free courses, else of what has a name."""
        out = {key: np.zeros((*group.column.shape, key[0]), np.float32) for key, group in self.groups.items()
               if key[1] == of_free}
        whitening, size = space.whitening, self.run.size
        for part, pieces in self._kept(of_free):
            dots = part.dots(whitening.factors**2).astype(np.float32) if whitening.is_diagonal else None
            for waves in part.chunks(3 * size if dots is None else 12 * self.run.n):
                if dots is None:
                    white = whitening.apply(part.dense(waves))
                    inside, white = space.inside(white), white.reshape(len(white), -1)
                else:
                    squares = part.squares(waves, dots)
                    inside = space.inside_of(part.waves.within(waves), part.directions)
                for piece in pieces:
                    own, wave, which = piece.within(waves)
                    group, begin = self.groups[piece.key], piece.place.start
                    place = slice(begin + own.start, begin + own.stop)
                    rows = part.rows_of(inside, wave, which)
                    of = part.rows_of(white, wave, which) if dots is None else None
                    gram = part.gram(squares, wave, which) if of is None else of @ of.transpose(0, 2, 1)
                    half = group.mixed(gram - rows @ rows.transpose(0, 2, 1), place)
                    q = part.m * which.shape[1]
                    out[piece.key][place, :q, :q] = group.mixed(half.transpose(0, 2, 1), place)
        return out

    def _kept(self, of_free: bool) -> Iterator[tuple[ColumnSet, list[Piece]]]:
        """Yield the parts of free courses, or of what has a name."""
        return ((part, pieces) for part, pieces in self._parts if pieces[0].key[1] == of_free)

    def squares_left(self, space: CoordinateSpace) -> dict[Key, Reals]:
        """Return the square sums of what a model leaves of the columns of each free course, (b, q), by its key.

        They are the diagonals of `left`, in noise that does not wander, for a part of the work."""
        out = {key: np.zeros(group.column.shape, np.float32) for key, group in self.groups.items() if key[1]}
        weight = space.whitening.factors**2
        for part, pieces in self._kept(True):
            square = np.sum(part.directions**2 * weight, axis=2).T.astype(np.float32)  # (N, d)
            for waves in part.chunks(12 * self.run.n):
                some = part.waves.within(waves)
                left = Waves(some.values**2, some.at).times(square).reshape(-1, 1) - np.sum(
                    space.inside_of(some, part.directions)**2, axis=2).reshape(-1, 1)
                for piece in pieces:
                    own, wave, which = piece.within(waves)
                    group, begin = self.groups[piece.key], piece.place.start
                    place, q = slice(begin + own.start, begin + own.stop), part.m * which.shape[1]
                    mix = group.mix[place, :q]
                    out[piece.key][place, :q] = mix * part.rows_of(left, wave, which)[..., 0] * mix  # mix**2 may be inf
        return out

    def products(self, rows: Floats, whitening: Whitening, is_open: bool = True) -> dict[Key, Reals]:
        """Return the products T B v' of the blocks of each group with white rows (k, 3 N) that the model leaves.

        (b, q, k) by its key; is_open: of free courses, too."""
        raw = whitening.adjoint(rows.reshape(len(rows), self.run.size, 3)).astype(np.float32)
        flat = np.concatenate([np.zeros((0, len(rows)), np.float32), *(
            part.products(raw) for part, pieces in self._parts if is_open or not pieces[0].key[1])])
        return {key: group.mixed(flat[group.column]) for key, group in self.groups.items() if is_open or not key[1]}

    def products_of(self, family: CauseFamily, rows: Floats,
                    whitening: Whitening) -> Iterator[tuple[Key, slice, Reals]]:
        """Yield the same products of the blocks of one named family, with the key of their group and place in it."""
        raw = whitening.adjoint(rows.reshape(len(rows), self.run.size, 3)).astype(np.float32)
        for part, pieces in self._parts[self._parts_of[family.name]]:
            flat = part.products(raw)
            for piece in pieces:
                group = self.groups[piece.key]
                made = group.mixed(part.rows_of(flat, piece.wave, piece.which), piece.place)
                yield piece.key, piece.place, np.pad(made, ((0, 0), (0, piece.key[0] - made.shape[1]), (0, 0)))

    def seen(self, left: Mapping[Key, Reals]) -> dict[Key, Floats]:
        """Return the sensitivity to each block of groups, (b,); left: of `left`."""
        return {key: np.sqrt(np.maximum(np.trace(each, axis1=1, axis2=2), 0) / np.maximum(self.groups[key].rank, 1))
                for key, each in left.items()}

    def shares(self, left: Mapping[Key, Reals]) -> list[Floats]:
        """Return the sensitivity to each setting of each family; left: of `left`."""
        out = [np.zeros(len(family.settings)) for family in self.families]
        for key, seen in self.seen(left).items():
            group = self.groups[key]
            for number in np.unique(group.family):
                mine = group.family == number
                out[number][group.setting[mine]] = seen[mine]
        return out


def sensitivity(left: Floats) -> float:
    """Return the share that an order shows of columns of unit size, by what a model leaves of them, (q, ...): the root
    of their mean square sum, 0 of none."""
    return float(np.sqrt(np.sum(left**2) / max(len(left), 1)))


def why_not_judged(effect: Effect, run: Run) -> str:
    """Return why an effect cannot be judged on a run, empty where it can."""
    return effect.unavailable(run) or (
        '' if effect.settings(run) else 'what it depends on does not change in this run')


def families_of(run: Run) -> list[CauseFamily]:
    """Return the families of all effects that a run can judge, and of all free courses."""
    named = [CauseFamily(effect, effect.name, settings) for effect in laws_of(run).values()
             if not effect.unavailable(run) and (settings := effect.settings(run))]
    return named + [CauseFamily(FREE, name, settings) for name, settings in FREE.families(run)]


def columns_of(family: CauseFamily, run: Run, setting: Setting) -> Floats:
    """Return the columns of a family at any setting that are orthonormal in the readings, (q, N, 3).

    Of a free course: of the sizes of its process. What depends on the others is left out."""
    one, = family.effect.factors(run, [setting])
    wave, which = one.of_setting[0]
    columns = np.zeros((one.waves.shape[1], len(which), run.size, 3))
    at = slice(None) if one.at is None else one.at
    columns[:, :, at] = one.waves[wave][:, None, :, None] * one.directions[list(which)][None][:, :, at]
    flat = columns.reshape(-1, run.size, 3)
    centred = (flat - flat.mean(axis=1, keepdims=True)).reshape(len(flat), -1)
    gram, variance = centred @ centred.T, family.effect.variances(run, setting)
    mix = sized(gram, variance) if family.is_free or np.ptp(variance) else orthonormal(gram[None])[0]
    return np.asarray(np.tensordot(mix[np.abs(mix).max(axis=1) > 0], flat, axes=1))


def _shared(run: Run, settings: Iterable[Setting]) -> Iterator[Factors]:
    """Yield the Factors of free courses: those of one course share its functions, those that move alike directions."""
    every: dict[tuple[str, str], list[Setting]] = {}
    for setting in settings:
        every.setdefault((setting.word('of'), setting.word('kind')), []).append(setting)
    made: dict[tuple[str, ...], tuple[Floats, list[tuple[int, ...]]]] = {}
    for some in every.values():
        along = tuple(one.word('along') for one in some)
        if along not in made:
            number: dict[bytes, int] = {}
            moved = [motions(run)[name] for name in along]
            which = [tuple(number.setdefault(one.tobytes(), len(number)) for one in each) for each in moved]
            made[along] = np.array([np.frombuffer(one).reshape(-1, 3) for one in number]), which
        functions = FREE.course(run, some[0])[0]
        at = np.flatnonzero(functions.any(axis=0))
        is_sparse = 2 * at.size < run.size
        yield Factors(some, functions[None, :, at] if is_sparse else functions[None], made[along][0],
                      tuple((0, each) for each in made[along][1]), at if is_sparse else None)


def orthonormal(gram: Floats) -> Floats:
    """Return T (b, q, q) with T G T' = 1 for products G of columns, 0 in directions that depend on the others."""
    size = np.sqrt(np.maximum(np.einsum('bqq->bq', gram), 0))
    size = np.where(size > 1e-9 * size.max(axis=1, keepdims=True), size, np.inf)
    unit = np.where(np.isfinite(size), 1 / size, 0)
    value, vector = np.linalg.eigh(gram * unit[:, :, None] * unit[:, None])
    root = np.where(value > DEPENDENT, 1 / np.sqrt(np.maximum(value, DEPENDENT)), 0)
    return np.asarray((vector * root[:, None]).transpose(0, 2, 1) * unit[:, None])


def sized(gram: Floats, variance: Floats) -> Floats:
    """Return T (q, q) that gives columns of products (q, q) their prior variances (q,)."""
    return np.diag(scaled(np.diag(gram)[None], variance[None])[0])


def scaled(square: Reals, variance: Floats) -> Floats:
    """Return the diagonal of T (b, q) that gives columns of square sums (b, q) the prior variances (b, q)."""
    size = np.sqrt(np.maximum(square, 0))
    kept = size > 1e-6 * size.max(axis=1, keepdims=True)
    return np.asarray(np.divide(np.sqrt(variance), size, out=np.zeros_like(size), where=kept))
