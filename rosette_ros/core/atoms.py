# SPDX-License-Identifier: Apache-2.0
"""Every effect at every setting on one run, freed of the model and made orthonormal once.

A block of q columns becomes rows U of shape (q, 3 N) with U U' = 1 (rows of zeros for directions
that the run does not show). Its gain, the fall of the residual's square sum when it is added beside
members with orthonormal rows B, is y' (1 - U B' B U')^-1 y with y = U r and r the residual after B.
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import Effect, Setting

DROP = 0.02
"""Directions of an effect with a smaller visible share are left out of the search."""
CHUNK = 512
RIDGE = 1e-3
SMALL = 1000


class Projection:
    """Rows (m, N, 3) freed of a model; many rows of a small run by one matrix, in single precision.

    Single precision is for atoms and simulated noise: the score of the best is computed anew in
    double precision.
    """

    def __init__(self, residual, size):
        """Keep a function that frees rows (m, N, 3) of the model, for runs of `size` readings."""
        self._residual, self._size = residual, size
        self._matrix = None

    def __call__(self, rows):
        """Return the rows freed of the model, same shape."""
        wide = 3 * self._size
        if len(rows) < 32:
            return self._residual(rows)
        if wide > SMALL:
            return self._residual(rows.astype(np.float32))
        if self._matrix is None:
            self._matrix = self._residual(np.eye(wide).reshape(wide, self._size, 3)).reshape(
                wide, wide).astype(np.float32)
        flat = rows.reshape(len(rows), wide).astype(np.float32)
        return (flat @ self._matrix).reshape(rows.shape)


@dataclass(frozen=True, eq=False)
class Family:
    """All settings of one effect that have q columns.

    atoms: (blocks * q, 3 N), float32; ranks: (blocks,) visible directions; shares: (blocks,) visible
    shares; chances: number of settings that count as separate chances in the search.
    """

    effect: Effect
    settings: tuple[Setting, ...]
    q: int
    atoms: np.ndarray
    ranks: np.ndarray
    shares: np.ndarray
    chances: float

    @property
    def name(self):
        """The name of the effect."""
        return self.effect.name

    def products(self, rows):
        """Return atoms times rows (m, 3 N), shape (blocks, q, m)."""
        product = self.atoms @ np.ascontiguousarray(rows.T, dtype=np.float32)
        return product.reshape(len(self.settings), self.q, -1)


def gains(y, x=None):
    """Return the gain of each block, (blocks, m), from y = U r (blocks, q, m) and x = U B'.

    x: (blocks, q, k), or None for no members.
    """
    if x is None or not x.shape[-1]:
        return np.einsum('bqm,bqm->bm', y, y).astype(float)
    if x.shape[1] == 1:
        return y[:, 0]**2 / (1 + RIDGE - np.sum(x[:, 0]**2, axis=1))[:, None]
    gram = np.eye(x.shape[1], dtype=x.dtype) * (1 + RIDGE) - x @ x.transpose(0, 2, 1)
    return np.sum(y * np.linalg.solve(gram, y), axis=1)


def whiten(blocks, project):
    """Return orthonormal rows (b, q, 3 N), ranks (b,), shares (b,) of blocks (b, q, N, 3).

    project: maps rows (m, N, 3) to what the model leaves of them.
    """
    return _orthonormal(*_visible(blocks, project))


def _visible(blocks, project):
    """Return blocks freed of the model in units of their length, (b, q, 3 N), and which have one.

    The length of a column is that of its variation: each axis is freed of its mean over the run.
    """
    b, q, n = blocks.shape[:3]
    flat = blocks.reshape(b * q, 3 * n)
    axes = np.tile(np.eye(3), (n, 1))
    square = np.einsum('rs,rs->r', flat, flat)
    varying = square - np.sum((flat @ axes)**2, axis=1) / n
    moves = varying > 1e-18 * square
    scale = np.sqrt(np.where(moves, varying, np.where(square > 0, square, 1.0)))
    perp = project(blocks.reshape(b * q, n, 3)).reshape(b * q, 3 * n)
    perp = perp / scale[:, None].astype(perp.dtype)
    return perp.reshape(b, q, 3 * n), moves.reshape(b, q)


def _orthonormal(perp, moves):
    """Return orthonormal rows, ranks and shares of visible parts (b, q, 3 N)."""
    gram = perp @ perp.transpose(0, 2, 1)
    share = np.sqrt(np.trace(gram, axis1=1, axis2=2) / np.maximum(moves.sum(axis=1), 1))
    value, vector = np.linalg.eigh(gram)
    keep = value > DROP**2
    root = np.where(keep, 1 / np.sqrt(np.where(keep, value, 1.0)), 0.0).astype(perp.dtype)
    return (vector * root[:, None, :]).transpose(0, 2, 1) @ perp, keep.sum(axis=1), share


def families(run, effects, project, keep_hidden=False):
    """Return the families of effects on a run, a tuple; effects that cannot be judged are left out.

    keep_hidden: also families of which the run shows nothing.
    """
    out = []
    for effect in effects:
        if effect.unavailable(run):
            continue
        out += _families(run, effect, project)
    return tuple(family for family in out if keep_hidden or family.ranks.any())


def _families(run, effect, project):
    """Return the families of one effect, one for each number of columns.

    Settings that are made of parts (three axes together, all motions) come after their parts, whose
    projections they share.
    """
    by_size = {}
    for setting in effect.settings(run):
        by_size.setdefault(len(effect.amplitudes(run, setting)), []).append(setting)
    chances = effect.independent_settings(run)
    shared = {}
    wanted = {part for settings in by_size.values() for setting in settings
              for part in effect.parts(setting)}
    out = []
    for q, settings in sorted(by_size.items()):
        atoms = np.empty((len(settings) * q, 3 * run.size), dtype=np.float32)
        ranks, shares = np.empty(len(settings), dtype=int), np.empty(len(settings))
        step = max(1, CHUNK // q)
        for start in range(0, len(settings), step):
            some = settings[start:start + step]
            perp, moves = _of_parts(effect, some, shared)
            if perp is None:
                perp, moves = _visible(effect.blocks(run, some), project)
                shared.update({setting: (perp[k], moves[k]) for k, setting in enumerate(some)
                               if setting in wanted})
            part = slice(start, start + len(some))
            rows, ranks[part], shares[part] = _orthonormal(perp, moves)
            atoms[start * q:(start + len(some)) * q] = rows.reshape(-1, 3 * run.size)
        out.append(Family(effect, tuple(settings), q, atoms, ranks, shares, chances))
    return out


def _of_parts(effect, settings, shared):
    """Return visible parts of settings that are made of parts already projected, else None."""
    parts = [effect.parts(setting) for setting in settings]
    if not all(entry and all(part in shared for part in entry) for entry in parts):
        return None, None
    perp = np.stack([np.concatenate([shared[part][0] for part in entry]) for entry in parts])
    return perp, np.stack([np.concatenate([shared[part][1] for part in entry]) for entry in parts])
