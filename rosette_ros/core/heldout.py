# SPDX-License-Identifier: Apache-2.0
"""The error in readings that the fit did not use.

With M = 1 - H the projection on the residuals and f a block of left-out readings, the error of their
prediction from all others is u_f = M_ff^-1 r_f, and r_f' u_f / (3 size) estimates sigma^2 as the
residuals of a fit do: a term that only describes noise raises it, one that is right brings it down
to sigma. Nonlinear parameters are searched again without each block.
"""

import numpy as np
import scipy.linalg

FOLDS = 8
LARGEST = 100  # readings in a block: keeps the matrices of large runs small


class HeldOut:
    """Blocks of left-out readings under a model.

    project: maps rows (m, N, 3) to what the model leaves of them; size: N; seed: of the drawing of
    the blocks. Every reading is in one of FOLDS random blocks (a sample of each in large runs).
    """

    def __init__(self, project, size, seed=0):
        """Draw the blocks and project their readings."""
        order = np.random.default_rng(seed).permutation(size)
        folds = max(2, min(FOLDS, size // 4))
        self._blocks = []
        for fold in range(folds):
            readings = np.sort(order[fold::folds][:LARGEST])
            index = (3 * readings[:, None] + np.arange(3)).reshape(-1)
            units = np.zeros((index.size, 3 * size))
            units[np.arange(index.size), index] = 1.0
            rows = project(units.reshape(-1, size, 3)).reshape(index.size, 3 * size)
            self._blocks.append((index, rows))

    @property
    def folds(self):
        """Number of blocks."""
        return len(self._blocks)

    def training_residuals(self, residual, rows):
        """Return residuals of fits without each block, zero in it, (folds, 3 N).

        residual: (3 N,) of the model and of orthonormal rows (k, 3 N) added to it.
        """
        out = []
        for index, projected in self._blocks:
            left = projected - (projected @ rows.T) @ rows
            error, _ = _solve(left[:, index], residual[index])
            out.append(residual - error @ left)
        return np.array(out)

    def imputed(self, residual, fits):
        """Return residuals with the prediction from all others in place of each block, (folds, 3 N).

        residual: (3 N,) of the model; fits: as of `rms`, what predicts the blocks. A search in them
        does without the block: a step of expectation and maximisation.
        """
        out = []
        for (index, projected), (left, rows) in zip(self._blocks, fits, strict=True):
            part = rows[:, index]
            error, _ = _solve(projected[:, index] - part.T @ part, left[index])
            out.append(residual - error @ projected)
        return np.array(out)

    def rms(self, fits):
        """Return the root mean square error of prediction over the blocks.

        fits: for each block the residual (3 N,) and the orthonormal rows (k, 3 N) added to the
        model. NaN where leaving out a block makes the model undeterminable.
        """
        total, count = 0.0, 0
        for (index, projected), (residual, rows) in zip(self._blocks, fits, strict=True):
            part = rows[:, index]
            matrix = projected[:, index] - part.T @ part
            error, kept = _solve(matrix, residual[index])
            total += float(residual[index] @ error)
            count += kept
        return float(np.sqrt(total / count)) if count else float('nan')


def _solve(matrix, vector):
    """Return the minimum-norm solution and how many coordinates could be predicted at all."""
    try:
        factor = scipy.linalg.cho_factor(matrix, check_finite=False)
        if np.diag(factor[0]).min() > 1e-3:
            return scipy.linalg.cho_solve(factor, vector, check_finite=False), len(vector)
    except scipy.linalg.LinAlgError:
        pass  # singular: some of the block cannot be predicted, see below
    value, basis = np.linalg.eigh(matrix)
    keep = value > 1e-6
    return basis[:, keep] @ ((basis[:, keep].T @ vector) / value[keep]), int(keep.sum())
