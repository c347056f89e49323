# SPDX-License-Identifier: Apache-2.0
"""Cross-validation: the error in readings that the fit did not use.

With M = 1 - H the projection on the residuals and f a block of readings, the error of their prediction from all others
is u_f = M_ff^-1 r_f, and r_f' u_f / (3 size) estimates sigma^2 as the residuals of a fit do: a term that only describes
noise raises it, one that is right brings it down to sigma. Settings of effects and weights stay as they were fitted.
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.model.least_squares import Fit, JointSpace
from rosette_ros.core.run.records import Floats, Ints
from rosette_ros.core.sight.bank import Reals

FOLDS = 8
LARGEST = 100
"""Readings of a block, and coordinates of it that are freed of the model at a time: it bounds the matrices."""
SAFE = 1e-3
"""Smallest diagonal element of a Cholesky factor that is not taken as singular."""


@dataclass(frozen=True, eq=False)
class _Block:
    """One block: its coordinates, M_ff, M_ff^-1 or None where it is singular."""

    index: Ints
    own: Floats
    inverse: Reals | None

    def solve(self, added: Floats, residual: Floats) -> tuple[Reals, int]:
        """Return M_ff^-1 r_f with rows (k, 3 N) added to the model, and how many could be predicted.

        Added rows A take A_f' A_f from M_ff: few of them go by (M - A'A)^-1 = M^-1 + M^-1 A' (1 - A M^-1 A')^-1 A M^-1.
        """
        part, vector = added[:, self.index], residual[self.index]
        if self.inverse is not None and 2 * len(part) <= len(vector):
            error = self.inverse @ vector
            if not len(part):
                return error, len(vector)
            mixed = self.inverse @ part.T
            small = np.eye(len(part)) - part @ mixed
            if _is_sound(small):
                return error + mixed @ np.linalg.solve(small, part @ error), len(vector)
        return _solve(self.own - part.T @ part, vector)


class CrossValidation:
    """Blocks of readings that are left out under a model.

    Every reading is in one of FOLDS random blocks (a sample of each in large runs). A fit is given as its residual
    (3 N,) and the orthonormal rows (k, 3 N) that it adds to the model.
    """

    def __init__(self, space: JointSpace, size: int, seed: int = 0) -> None:
        """Draw the blocks of a run of `size` readings and project them off the model."""
        order = np.random.default_rng(seed).permutation(size)
        folds, self._space = max(2, min(FOLDS, size // 4)), space
        self._blocks = []
        for fold in range(folds):
            readings = np.sort(order[fold::folds][:LARGEST])
            index = (3 * readings[:, None] + np.arange(3)).reshape(-1)
            own = np.concatenate([self._freed(np.eye(index.size)[start:start + LARGEST], index, size)[:, index]
                                  for start in range(0, index.size, LARGEST)])
            self._blocks.append(_Block(index, own, np.linalg.inv(own) if _is_sound(own) else None))

    def _freed(self, values: Reals, index: Ints, size: int) -> Floats:
        """Return rows (m, 3 N) that have values (m, f) in a block and 0 elsewhere, freed of the model."""
        rows = np.zeros((len(values), 3 * size))
        rows[:, index] = values
        return self._space.free(rows.reshape(len(rows), size, 3)).reshape(rows.shape)

    def rms(self, residual: Floats, rows: Floats | None = None) -> float:
        """Return the rms error of prediction without each block, NaN where no block determines the model.

        A reading that only an effect of its own describes cannot be predicted, and does not count.
        """
        rows = np.zeros((0, residual.size)) if rows is None else rows
        total, count = 0.0, 0
        for block in self._blocks:
            error, kept = block.solve(rows, residual)
            total += float(residual[block.index] @ error)
            count += kept
        return float(np.sqrt(total / count)) if count else float('nan')


def cross_validation_rms(fitted: Fit) -> float:
    """Return the error of the cross-validation of a fit at its settings, m."""
    return CrossValidation(fitted.joint, fitted.run.size).rms(fitted.white_residual.reshape(-1))


def _is_sound(matrix: Floats) -> bool:
    """Return whether a symmetric matrix is positive definite, and not nearly singular."""
    try:
        return bool(np.diag(np.linalg.cholesky(matrix)).min() > SAFE)
    except np.linalg.LinAlgError:
        return False


def _solve(matrix: Floats, vector: Floats) -> tuple[Reals, int]:
    """Return the minimum-norm solution and how many coordinates could be predicted at all."""
    if _is_sound(matrix):
        return np.linalg.solve(matrix, vector), len(vector)
    value, basis = np.linalg.eigh(matrix)
    keep = value > 1e-6
    return basis[:, keep] @ ((basis[:, keep].T @ vector) / value[keep]), int(keep.sum())
