# SPDX-License-Identifier: Apache-2.0
"""Columns of the candidates: every effect at every setting, freed of the model and made orthonormal once.

With B the q columns of a setting and M the projection on what the model leaves, the orthonormal rows are U = T B M with
T from the eigenvectors of B M B' (directions below DROP are left out). Its gain, the fall of the residual's square sum
when it is added beside members with orthonormal rows A, is y' (1 - U A' A U')^-1 y with y = U r and r the residual
after A. Since M r = r and M A' = A', the products U r = T (B r) ask for raw columns only: those of whole families are
products of few waves and directions, or nearly empty, and B M B' = B B' - (B Q')(B Q')' by the basis Q of the model.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, groupby

import numpy as np
import scipy.sparse

from rosette_ros.core.diagnosis.projection import FEW, SMALL, Projection, Reals
from rosette_ros.core.effects.effect import Effect, Factors, Setting
from rosette_ros.core.records import Bools, Ints, Run

DROP = 0.02
"""Directions of an effect, and effects, with a smaller visible share are left out of the search: to be
seen at all they would have to be as large as no cell has them."""
HIDDEN_SHARE = 0.05
"""Visible share below which an order of measurement hides an effect."""
THREADS = 2  # more would wait for the same memory
CHUNK = 512
"""Columns that are freed of the model at once, fewer of large runs: NUMBERS stay in the caches of a processor."""
NUMBERS = 1_500_000
RIDGE = 1e-3
EMPTY = 0.25
"""Share of numbers that are not zero below which columns are kept as sparse."""
NO_LENGTH = 1e-9
"""Length of a column beside the longest of its effect below which it is none."""
NO_RESIDUAL = 1e-290  # square sum that stands for none, m²


@dataclass(frozen=True, eq=False)
class Dense:
    """Orthonormal rows in white coordinates as they are, (blocks, q, 3 N), float32."""

    rows: Reals

    def products(self, rows: Reals) -> Reals:
        """Return the products with rows (m, 3 N), (blocks, q, m)."""
        b, q, wide = self.rows.shape
        return (self.rows.reshape(b * q, wide) @ rows.T).reshape(b, q, -1)


@dataclass(frozen=True, eq=False)
class Sparse:
    """Raw columns that are mostly zero, (blocks * q, 3 N); moves: (blocks, q) whether they vary."""

    rows: scipy.sparse.csr_array
    q: int
    moves: Bools

    def products(self, rows: Reals) -> Reals:
        """Return the products with rows (m, 3 N), (blocks, q, m)."""
        return np.asarray(self.rows @ rows.T).reshape(-1, self.q, len(rows))


@dataclass(frozen=True, eq=False)
class Waves:
    """Raw columns that are waves (v, m, N) times directions (D, N, 3), float32."""

    waves: Reals
    directions: Reals

    def products(self, rows: Reals) -> Reals:
        """Return the products of every wave and direction with rows (r, 3 N), (v, m, D, r)."""
        v, m, size = self.waves.shape
        weighted = self.directions.transpose(1, 0, 2) @ rows.reshape(len(rows), size, 3).transpose(1, 2, 0)
        product = self.waves.reshape(v * m, size) @ weighted.reshape(size, -1)
        return product.reshape(v, m, len(self.directions), len(rows))


@dataclass(frozen=True, eq=False)
class Family:
    """All settings of one effect that have q columns.

    bank: what holds their columns; places: index of each block's in the products of the bank (None: as they come); mix:
    (blocks, q, q), T of above, None where the bank's rows are orthonormal; ranks: (blocks,) visible directions; shares:
    (blocks,) visible shares; chances: number of settings that count as separate chances in the search.
    """

    effect: Effect
    settings: tuple[Setting, ...]
    q: int
    bank: Dense | Sparse | Waves
    places: tuple[Ints, Ints, Ints] | None
    mix: Reals | None
    ranks: Ints
    shares: Reals
    chances: float

    @property
    def name(self) -> str:
        """The name of the effect."""
        return self.effect.name

    def picked(self, products: Reals) -> Reals:
        """Return U times rows, (blocks, q, m), from the products of the bank with the rows."""
        if self.places is not None:
            products = products[self.places]
        products = products.reshape(len(self.settings), self.q, -1)
        if self.mix is None:
            return products
        return products * self.mix if self.q == 1 else self.mix @ products


def products_of(families: Sequence[Family], rows: Reals, project: Projection) -> Iterator[tuple[Family, Reals]]:
    """Yield (family, U times white rows (m, 3 N)) of families; those of one effect share their bank."""
    raw = np.ascontiguousarray(project.adjoint(rows), dtype=np.float32)
    rows = np.ascontiguousarray(rows, dtype=np.float32)
    for _, sharing in groupby(families, key=lambda family: id(family.bank)):
        first = next(sharing)
        found = first.bank.products(rows if isinstance(first.bank, Dense) else raw)
        yield from ((family, family.picked(found)) for family in (first, *sharing))


def gains(y: Reals, x: Reals | None = None) -> Reals:
    """Return the gain of each block, (blocks, m), from y = U r (blocks, q, m) and x = U A' (blocks, q, k)."""
    gain: Reals = np.sum(y * y, axis=1)
    if x is None or not x.shape[-1]:
        return gain
    across = x.transpose(0, 2, 1)
    if x.shape[1] == 1:
        gain = y[:, 0]**2 / (1 + RIDGE - np.sum(x[:, 0]**2, axis=1))[:, None]
    elif x.shape[2] >= x.shape[1]:
        gram = np.eye(x.shape[1], dtype=x.dtype) * (1 + RIDGE) - x @ across
        gain = np.sum(y * np.linalg.solve(gram, y), axis=1)
    else:
        # (c - x x')^-1 = (1 + x (c - x'x)^-1 x') / c: few members are quicker than many columns
        shared = across @ y
        gram = np.eye(x.shape[2], dtype=x.dtype) * (1 + RIDGE) - across @ x
        found = shared / gram if gram.shape[1] == 1 else np.linalg.solve(gram, shared)
        gain = (gain + np.sum(shared * found, axis=1)) / (1 + RIDGE)
    return gain


def whiten(blocks: Reals, project: Projection) -> tuple[Reals, Ints, Reals]:
    """Return orthonormal rows (b, q, 3 N), ranks (b,), shares (b,) of blocks (b, q, N, 3)."""
    b, q, n = blocks.shape[:3]
    scale, moves = _lengths(blocks.reshape(b * q, 3 * n))
    if not project.whitening.is_plain:  # a share is one of what the noise lets see, at most 1
        varying = project.whitening.apply((blocks - blocks.mean(axis=2, keepdims=True)).reshape(b * q, n, 3))
        length = np.linalg.norm(varying.reshape(b * q, -1), axis=1)
        scale = np.where(moves, np.maximum(length, NO_LENGTH * scale), scale)
    perp = project(blocks.reshape(b * q, n, 3)).reshape(b, q, 3 * n)
    perp = perp / scale.reshape(b, q, 1).astype(perp.dtype)
    gram = perp @ perp.transpose(0, 2, 1)
    mix, ranks, shares = _mix(gram, moves.reshape(b, q))
    return mix.astype(perp.dtype) @ perp, ranks, np.minimum(shares, 1.0)


def _lengths(flat: Reals) -> tuple[Reals, Bools]:
    """Return the length of the variation of columns (r, 3 N), each axis freed of its mean, and whether they vary."""
    n = flat.shape[1] // 3
    sums = flat.reshape(len(flat), n, 3).sum(axis=1) if len(flat) < FEW else flat @ np.tile(np.eye(3), (n, 1))
    return _lengths_of(np.einsum('rs,rs->r', flat, flat), np.sum(sums**2, axis=1) / n)


def _lengths_of(square: Reals, mean: Reals) -> tuple[Reals, Bools]:
    varying = square - mean
    moves = varying > 1e-18 * square
    length = np.sqrt(np.where(moves, varying, np.where(square > 0, square, 1.0)))
    # the sine of half a turn is rounding: it is no column to be made as long as the others
    return np.where(length > NO_LENGTH * length.max(), length, length.max()), moves


def _mix(gram: Reals, moves: Bools) -> tuple[Reals, Ints, Reals]:
    """Return T (b, q, q), ranks and shares from B M B' (b, q, q) of columns of unit length."""
    trace = np.trace(gram, axis1=1, axis2=2)
    shares = np.sqrt(np.maximum(trace, 0) / np.maximum(moves.sum(axis=1), 1))
    if gram.shape[1] == 1:
        value, vector = gram[:, 0], np.ones_like(gram)
    elif _all_seen(gram, shares):
        # nothing is left out: the inverse of a Cholesky factor does as well, and is found sooner
        return np.linalg.inv(np.linalg.cholesky(gram)), np.full(len(gram), gram.shape[1]), shares
    else:
        value, vector = np.linalg.eigh(gram)
    keep = (value > DROP**2) & (shares[:, None] > DROP)
    root = np.where(keep, 1 / np.sqrt(np.where(keep, value, 1.0)), 0.0)
    return (vector * root[:, None, :]).transpose(0, 2, 1), keep.sum(axis=1), shares


def _all_seen(gram: Reals, shares: Reals) -> bool:
    """Return whether every direction of every block, and every block, is seen by more than DROP."""
    if shares.min() <= DROP:
        return False
    try:
        np.linalg.cholesky(gram - DROP**2 * np.eye(gram.shape[1], dtype=gram.dtype))
    except np.linalg.LinAlgError:
        return False
    return True


def why_not_judged(effect: Effect, run: Run) -> str:
    """Return why an effect cannot be judged on a run, empty where it can."""
    return effect.unavailable(run) or (
        '' if _settings(effect, run) else 'what it depends on does not change in this run')


@lru_cache(maxsize=64)
def _settings(effect: Effect, run: Run) -> tuple[Setting, ...]:
    return effect.settings(run)


def families(run: Run, effects: Sequence[Effect], project: Projection, keep_hidden: bool = False,
             like: Sequence[Family] = (), fixed: Mapping[str, float | str] | None = None) -> tuple[Family, ...]:
    """Return the families of the effects that a run can judge; keep_hidden: also those of which it shows nothing.

    like: those of the same run under another projection, whose raw columns are used again; fixed: searched parameters
    that are held at a value: settings that become the same are one chance.
    """
    def of_effect(effect: Effect) -> list[Family]:
        settings = _settings(effect, run)
        if fixed:
            settings = tuple(dict.fromkeys(Setting({**setting, **fixed}) for setting in settings))
        most = max(1, min(effect.independent_settings(run), len(settings))) if fixed else np.inf
        chances = [min(one, most) for one in effect.chances(run, settings)]
        if settings and _are_waves(effect.factors(run, settings[:1])):
            each = dict(zip(settings, chances))
            return list(chain(*(_wave_families(effect, each, one, project)
                                for one in effect.factors(run, settings))))
        return _families(run, effect, settings, chances, project, like)

    judged = [effect for effect in effects if not effect.unavailable(run)]
    if 3 * run.size <= SMALL:
        found = list(map(of_effect, judged))
    else:  # most of the time is spent in products of arrays, during which another thread can run
        with ThreadPoolExecutor(THREADS) as threads:
            found = list(threads.map(of_effect, judged))
    return tuple(family for family in chain(*found) if keep_hidden or family.ranks.any())


def _are_waves(factors: Sequence[Factors]) -> bool:
    """Return whether columns are best kept as products: those of a few readings, or mostly zero, are not."""
    return all(one.at is None and (
        3 * one.waves.shape[2] <= SMALL or np.count_nonzero(one.waves) >= EMPTY * one.waves.size)
               for one in factors) and bool(factors)


def _alike(widths: Sequence[int], chances: Sequence[float]) -> list[tuple[int, float, list[int]]]:
    """Return number of columns, chances and places of the settings that share both."""
    places = defaultdict[tuple[int, float], list[int]](list)
    for place, kind in enumerate(zip(widths, chances)):
        places[kind].append(place)
    return [(*kind, places[kind]) for kind in sorted(places)]


def _families(run: Run, effect: Effect, settings: Sequence[Setting], each: Sequence[float], project: Projection,
              like: Sequence[Family]) -> list[Family]:
    banks = {(one.q, one.chances): one.bank for one in like if one.effect == effect and isinstance(one.bank, Sparse)}
    out = []
    for q, chances, places in _alike([effect.width(run, setting) for setting in settings], each):
        some = tuple(settings[place] for place in places)
        if (q, chances) in banks:
            out.append(_sparse_family(effect, some, chances, banks[q, chances], project))
            continue
        step = _chunk(run.size, q)
        blocks = (effect.blocks(run, some[start:start + step]) for start in range(0, len(some), step))
        first = next(blocks)
        if np.count_nonzero(first) < EMPTY * first.size:
            raw, moves = (list(each) for each in zip(*(_sparse(part) for part in chain([first], blocks))))
            bank = Sparse(scipy.sparse.vstack(raw, format='csr'), q, np.concatenate(moves))
            out.append(_sparse_family(effect, some, chances, bank, project))
            continue
        rows, ranks, shares = (np.concatenate(each) for each in zip(*(
            _dense(part, project) for part in chain([first], blocks))))
        out.append(Family(effect, some, q, Dense(rows), None, None, ranks, shares, chances))
    return out


def _chunk(size: int, q: int) -> int:
    """Return how many blocks of q columns of `size` readings are looked at at once."""
    return max(1, min(CHUNK, NUMBERS // (3 * size)) // q)


def _dense(blocks: Reals, project: Projection) -> tuple[Reals, Ints, Reals]:
    rows, ranks, shares = whiten(blocks, project)
    return rows.astype(np.float32), ranks, shares


def _sparse(blocks: Reals) -> tuple[scipy.sparse.csr_array, Bools]:
    """Return columns as sparse rows of unit length and whether they vary, (b, q)."""
    b, q, n = blocks.shape[:3]
    rows = _compressed(blocks.reshape(b * q, 3 * n))
    square = np.asarray(rows.multiply(rows).sum(axis=1)).reshape(-1)
    sums = rows @ np.tile(np.eye(3), (n, 1))
    scale, moves = _lengths_of(square, np.sum(sums**2, axis=1) / n)
    rows.data = rows.data / np.repeat(scale, np.diff(rows.indptr))
    return rows.astype(np.float32), moves.reshape(b, q)


def _sparse_family(effect: Effect, settings: tuple[Setting, ...], chances: float, bank: Sparse,
                   project: Projection) -> Family:
    step, parts = _chunk(project.size, bank.q), []
    for start in range(0, len(settings), step):
        moves = bank.moves[start:start + step]
        rows = bank.rows[bank.q * start:bank.q * (start + step)]
        inside = (rows @ project.columns).reshape(*moves.shape, -1)
        parts.append(_mix(_within(rows, project, len(moves)) - inside @ inside.transpose(0, 2, 1), moves))
    mix, ranks, shares = (np.concatenate(each) for each in zip(*parts))
    return Family(effect, settings, bank.q, bank, None, mix.astype(np.float32), ranks, shares, chances)


def _within(rows: scipy.sparse.csr_array, project: Projection, b: int) -> Reals:
    """Return the products of the whitened columns within each of b blocks, (b, q, q)."""
    if project.whitening.is_diagonal:
        rows = rows.copy()
        if not project.whitening.is_plain:
            rows.data = rows.data * project.whitening.factors.reshape(-1)[rows.indices].astype(rows.dtype)
        whole: Reals = (rows @ rows.T).toarray().reshape(b, -1, b, rows.shape[0] // b)
        return whole[np.arange(b), :, np.arange(b)]
    out: Reals = np.zeros((b, rows.shape[0] // b, rows.shape[0] // b))
    for axis in range(3):
        part = rows[:, axis::3]
        used = np.diff(part.indptr) > 0
        if used.any():
            white: Reals = np.zeros(part.shape, dtype=np.float32)
            white[used] = project.whitening.along(axis).apply(part[used].toarray())
            blocks = white.reshape(b, -1, white.shape[1])
            out += blocks @ blocks.transpose(0, 2, 1)
    return out


def _compressed(flat: Reals) -> scipy.sparse.csr_array:
    """Return a matrix as a sparse one; much faster than numpy's search for numbers that are not zero."""
    values = flat.reshape(-1)
    places = np.flatnonzero(values != 0)
    row, column = np.divmod(places, flat.shape[1])
    start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(flat)))])
    return scipy.sparse.csr_array((values[places], column, start), shape=flat.shape)


def _wave_families(effect: Effect, each: Mapping[Setting, float], factors: Factors,
                   project: Projection) -> list[Family]:
    """Return the families of some settings; each: the chances of a setting."""
    m = factors.waves.shape[1]
    scale, moves = _wave_lengths(factors)
    waves = np.empty(factors.waves.shape, np.float32)
    are_inside = np.abs(project(factors.directions)).max() < 1e-9 * np.abs(factors.directions).max()
    for start in range(0, len(waves), CHUNK):
        part = factors.waves[start:start + CHUNK]
        # a constant is the model's: no lost digits
        waves[start:start + CHUNK] = part - part.mean(axis=2, keepdims=True) if are_inside else part
    bank = Waves(waves, factors.directions.astype(np.float32))
    gram = _wave_gram(bank, project) / (scale[:, :, None] * scale[:, None])
    d = len(factors.directions)
    out = []
    widths, settings = [m * len(which) for _, which in factors.of_setting], factors.settings
    for q, chances, places in _alike(widths, [each[setting] for setting in settings]):
        wave = np.array([factors.of_setting[place][0] for place in places])
        which = np.array([factors.of_setting[place][1] for place in places])
        column = (np.arange(m)[None, :, None] * d + which[:, None]).reshape(len(places), q)
        mix, ranks, shares = _mix(gram[wave[:, None, None], column[:, :, None], column[:, None]],
                                  moves[wave[:, None], column])
        mix = (mix / scale[wave[:, None], column][:, None]).astype(np.float32)
        where = (wave[:, None, None], np.arange(m)[None, :, None], which[:, None])
        out.append(Family(effect, tuple(settings[k] for k in places), q, bank, where, mix, ranks, shares, chances))
    return out


def _wave_lengths(factors: Factors) -> tuple[Reals, Bools]:
    """Return lengths of all columns by their variation and whether they vary, (v, m D)."""
    waves, directions = factors.waves, factors.directions
    v, m, n = waves.shape
    flat = waves.reshape(v * m, n)
    size = np.sum(directions**2, axis=2).T
    square = np.concatenate([flat[start:start + CHUNK]**2 @ size for start in range(0, v * m, CHUNK)])
    means = flat @ np.moveaxis(directions, 0, 1).reshape(n, -1)
    mean = np.sum(means.reshape(v * m, -1, 3)**2, axis=2) / n
    scale, moves = _lengths_of(square, mean)
    return scale.reshape(v, -1), moves.reshape(v, -1)


def _wave_gram(bank: Waves, project: Projection) -> Reals:
    """Return B M B' of all columns of each wave, (v, m D, m D), by B B' - (B Q')(B Q')'."""
    v, m, n = bank.waves.shape
    d = len(bank.directions)
    along = [project.along(direction) for direction in bank.directions]
    white = project.whitening
    scaled = bank.directions if white.is_plain or not white.is_diagonal else bank.directions * white.factors
    both = np.einsum('anc,bnc->nab', scaled, scaled).reshape(n, d * d)
    out = np.empty((v, m * d, m * d))
    for start in range(0, v, CHUNK):
        waves = bank.waves[start:start + CHUNK]
        taken = np.zeros((len(waves), m, d, project.basis.rank), dtype=np.float32)
        for k, (part, places) in enumerate(along):
            taken[:, :, k, places] = (waves.reshape(-1, n) @ part).reshape(len(waves), m, -1)
        inside = taken.reshape(len(waves), m * d, -1)
        if white.is_diagonal:
            pairs = (waves[:, :, None] * waves[:, None]).reshape(-1, n) @ both
            whole = pairs.reshape(-1, m, m, d, d).transpose(0, 1, 3, 2, 4).reshape(-1, m * d, m * d)
        else:
            across = np.zeros((len(waves), m, d, m, d))
            for axis in range(3):
                used = np.flatnonzero(bank.directions[..., axis].any(axis=1))
                if used.size:
                    moved = (waves[:, :, None] * bank.directions[used, :, axis]).reshape(-1, n)
                    every = white.along(axis).apply(moved).astype(np.float32).reshape(len(waves), m * used.size, n)
                    found = (every @ every.transpose(0, 2, 1)).reshape(len(waves), m, used.size, m, used.size)
                    across[:, :, used[:, None], :, used] += found.transpose(2, 4, 0, 1, 3)
            whole = across.reshape(len(waves), m * d, m * d)
        out[start:start + CHUNK] = whole - inside @ inside.transpose(0, 2, 1)
    return out
