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
CHUNK = 256
RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class Family:
    """All settings of one effect that have q columns: atoms (blocks, q, 3 N), float32.

    ranks: (blocks,) visible directions; shares: (blocks,) visible shares; chances: number of
    settings that count as separate chances in the search.
    """

    effect: Effect
    settings: tuple[Setting, ...]
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
        b, q, size = self.atoms.shape
        return (self.atoms.reshape(b * q, size) @ rows.T.astype(np.float32)).reshape(b, q, -1)


def gains(y, x=None):
    """Return the gain of each block, (blocks, m), from y = U r (blocks, q, m) and x = U B'.

    x: (blocks, q, k), or None for no members.
    """
    if x is None or not x.shape[-1]:
        return np.sum(y.astype(float)**2, axis=1)
    gram = np.eye(x.shape[1]) * (1 + RIDGE) - x @ x.transpose(0, 2, 1)
    return np.sum(y * np.linalg.solve(gram, y), axis=1)


def whiten(blocks, project):
    """Return orthonormal rows (b, q, 3 N), ranks (b,), shares (b,) of blocks (b, q, N, 3).

    project: maps rows (m, N, 3) to what the model leaves of them.
    """
    b, q, n = blocks.shape[:3]
    centred = blocks - blocks.mean(axis=2, keepdims=True)
    full = np.sqrt(np.sum(centred**2, axis=(2, 3)))
    scale = np.where(full > 0, full, 1.0)
    perp = project(blocks.reshape(b * q, n, 3)).reshape(b, q, 3 * n) / scale[..., None]
    share = np.sqrt(np.sum(perp**2, axis=(1, 2)) / np.maximum((full > 0).sum(axis=1), 1))
    value, vector = np.linalg.eigh(perp @ perp.transpose(0, 2, 1))
    keep = value > DROP**2
    root = np.where(keep, 1 / np.sqrt(np.where(keep, value, 1.0)), 0.0)
    return (vector * root[:, None, :]).transpose(0, 2, 1) @ perp, keep.sum(axis=1), share


def families(run, effects, project):
    """Return the families of effects on a run, a tuple; effects that cannot be judged are left out."""
    out = []
    for effect in effects:
        if effect.unavailable(run):
            continue
        by_size = {}
        for setting in effect.settings(run):
            block = np.moveaxis(effect.columns(run, setting), -1, 0)
            by_size.setdefault(len(block), []).append((setting, block))
        chances = effect.independent_settings(run)
        out += [_family(effect, entries, chances, project) for entries in by_size.values()]
    return tuple(family for family in out if family.ranks.any())


def _family(effect, entries, chances, project):
    q, n = entries[0][1].shape[:2]
    atoms = np.empty((len(entries), q, 3 * n), dtype=np.float32)
    ranks, shares = np.empty(len(entries), dtype=int), np.empty(len(entries))
    step = max(1, CHUNK // q)
    for start in range(0, len(entries), step):
        part = slice(start, start + step)
        blocks = np.stack([block for _, block in entries[part]])
        atoms[part], ranks[part], shares[part] = whiten(blocks, project)
    return Family(effect, tuple(setting for setting, _ in entries), atoms, ranks, shares, chances)
