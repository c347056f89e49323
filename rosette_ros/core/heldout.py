# SPDX-License-Identifier: Apache-2.0
"""The error in readings that the fit did not use.

With M = 1 - H the projection on the residuals and f a block of left-out readings, the error of their
prediction from all others is u_f = M_ff^-1 r_f, and r_f' u_f / (3 size) estimates sigma^2 as the
residuals of a fit do: a term that only describes noise raises it, one that is right brings it down
to sigma. Nonlinear parameters are searched again without each block.
"""

from dataclasses import dataclass

import numpy as np

FOLDS = 8
LARGEST = 100  # readings in a block: keeps the matrices of large runs small
SAFE = 1e-3
"""Smallest diagonal element of a Cholesky factor that is not taken as singular."""


class HeldOut:
    """Blocks of left-out readings under a model.

    space: of the model, a JointSpace; size: N; seed: of the drawing of the blocks. Every reading is in
    one of FOLDS random blocks (a sample of each in large runs).
    """

    def __init__(self, space, size, seed=0):
        """Draw the blocks and project their readings."""
        basis = space.basis.rows() if space.basis is not None else None
        order = np.random.default_rng(seed).permutation(size)
        folds = max(2, min(FOLDS, size // 4))
        self._blocks = []
        for fold in range(folds):
            readings = np.sort(order[fold::folds][:LARGEST])
            index = (3 * readings[:, None] + np.arange(3)).reshape(-1)
            units = np.zeros((index.size, 3 * size))
            units[np.arange(index.size), index] = 1.0
            rows = (units - basis[:, index].T @ basis if basis is not None
                    else space.residual(units.reshape(-1, size, 3)).reshape(index.size, 3 * size))
            own = rows[:, index]
            self._blocks.append(_Block(index, rows, np.linalg.inv(own) if _is_sound(own) else None))

    @property
    def folds(self):
        """Number of blocks."""
        return len(self._blocks)

    def training_residuals(self, residual, rows):
        """Return residuals of fits without each block, zero in it, (folds, 3 N).

        residual: (3 N,) of the model and of orthonormal rows (k, 3 N) added to it.
        """
        out = []
        for block in self._blocks:
            left = block.rows - rows[:, block.index].T @ rows
            error, _ = block.solve(rows, residual)
            out.append(residual - error @ left)
        return np.array(out)

    def imputed(self, residual, fits):
        """Return residuals with the prediction from all others in place of each block, (folds, 3 N).

        residual: (3 N,) of the model; fits: as of `rms`, what predicts the blocks. A search in them
        does without the block: a step of expectation and maximisation.
        """
        out = []
        for block, (left, rows) in zip(self._blocks, fits, strict=True):
            error, _ = block.solve(rows, left)
            out.append(residual - error @ block.rows)
        return np.array(out)

    def rms(self, fits):
        """Return the root mean square error of prediction over the blocks.

        fits: for each block the residual (3 N,) and the orthonormal rows (k, 3 N) added to the
        model. NaN where leaving out a block makes the model undeterminable.
        """
        total, count = 0.0, 0
        for block, (residual, rows) in zip(self._blocks, fits, strict=True):
            error, kept = block.solve(rows, residual)
            total += float(residual[block.index] @ error)
            count += kept
        return float(np.sqrt(total / count)) if count else float('nan')


@dataclass(frozen=True, eq=False)
class _Block:
    """One block: its coordinates, their rows freed of the model, M_ff^-1 or None where it is singular."""

    index: np.ndarray
    rows: np.ndarray
    inverse: np.ndarray | None

    def solve(self, added, residual):
        """Return M_ff^-1 r_f with rows (k, 3 N) added to the model, and how many could be predicted.

        Added rows A take A_f' A_f from M_ff: few of them go by (M - A'A)^-1 = M^-1 + M^-1 A' (1 -
        A M^-1 A')^-1 A M^-1.
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
        return _solve(self.rows[:, self.index] - part.T @ part, vector)


def _is_sound(matrix):
    """Return whether a symmetric matrix is positive definite, and not nearly singular."""
    try:
        return bool(np.diag(np.linalg.cholesky(matrix)).min() > SAFE)
    except np.linalg.LinAlgError:
        return False


def _solve(matrix, vector):
    """Return the minimum-norm solution and how many coordinates could be predicted at all."""
    if _is_sound(matrix):
        return np.linalg.solve(matrix, vector), len(vector)
    value, basis = np.linalg.eigh(matrix)
    keep = value > 1e-6
    return basis[:, keep] @ ((basis[:, keep].T @ vector) / value[keep]), int(keep.sum())
