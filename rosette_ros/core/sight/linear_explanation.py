# SPDX-License-Identifier: Apache-2.0
"""The one solution of a linear explanation of readings, and its one log Bayes factor against nothing more.

    y = A' a + noise,    a ~ N(0, 1),    noise ~ N(0, 1)
    a | y ~ N((1 + G)^-1 A y, (1 + G)^-1),    G = A A'

The rows of A, (q, N), are what a standard deviation of each amplitude does to the readings, in that of their noise, and
y what is left of the readings. The readings are asked for G and for t = A y only.
"""

from typing import Any

import numpy as np
import scipy  # which loads its parts where they are used
from numpy.typing import NDArray

from rosette_ros.core.run.records import Floats

Numbers = NDArray[Any] | float


class Solution:
    """Solutions for the products G, (..., q, q), of one explanation or of many; log_det: ln det(1 + G), (...,)."""

    def __init__(self, gram: NDArray[Any]) -> None:
        """Decompose 1 + G = L L', the diagonal of G lifted by more than the rounding of products and decomposition.

        Without, G may have negative directions (Higham, Accuracy and Stability of Numerical Algorithms, 2002, 10.7)."""
        size = gram.shape[-1]
        lifted = 1 + np.einsum('...qq->...q', gram) * ((size + 8)**2 * np.finfo(gram.dtype).eps)
        self._root = np.linalg.cholesky(gram + lifted[..., None] * np.eye(size, dtype=gram.dtype))
        self.log_det: Floats = 2 * np.log(np.einsum('...qq->...q', self._root)).sum(axis=-1, dtype=float)

    def halved(self, right: NDArray[Any]) -> Floats:
        """Return L^-1 times vectors (..., q, k)."""
        if self._root.ndim == 2:
            return np.asarray(scipy.linalg.solve_triangular(self._root, right, lower=True, check_finite=False))
        return np.asarray(np.linalg.solve(self._root, right))

    def solved(self, right: NDArray[Any]) -> Floats:
        """Return (1 + G)^-1 times vectors (..., q, k)."""
        half = self.halved(right)
        if self._root.ndim == 2:
            return np.asarray(scipy.linalg.solve_triangular(self._root, half, lower=True, trans=1, check_finite=False))
        return np.asarray(np.linalg.solve(np.swapaxes(self._root, -1, -2), half))

    def fall(self, told: NDArray[Any]) -> Floats:
        """Return t'(1 + G)^-1 t, (...,), by how much the square sum falls; told: t, (..., q)."""
        return np.asarray(np.sum(self.halved(told[..., None])[..., 0]**2, axis=-1))

    def log_bayes_factor(self, told: NDArray[Any], left: Numbers | None = None, dof: int = 0) -> Floats:
        """Return ln BF, (...,); told: t, (..., q); left, dof: as of `log_bayes_factor`."""
        return log_bayes_factor(self.log_det, self.fall(told), left, dof)


def log_bayes_factor(log_det: Numbers, fall: Numbers, left: Numbers | None = None, dof: int = 0) -> Floats:
    """Return ln BF = -1/2 ln det(1 + G) - m/2 ln(1 - fall / left), of any shape and the precision of `fall`.

    left: square sum without the explanation, fall: by how much it falls; dof: m, degrees of freedom of `left`. sigma is
    unknown, p(sigma) ~ 1 / sigma; where it is known left is None, fall is in sigma^2, and the last term is its limit,
    fall / 2."""
    if left is None:
        return np.asarray((fall - log_det) / 2)
    share: NDArray[Any] = np.asarray(fall / left)
    most = 1 - (1e-12 if share.dtype == np.float64 else 1e-7)  # what is more is rounding
    return np.asarray(-0.5 * log_det - 0.5 * dof * np.log1p(-np.minimum(share, share.dtype.type(most))))
