# SPDX-License-Identifier: Apache-2.0
"""The one log Bayes factor of a linear explanation of readings against nothing more."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.run.records import Floats

Numbers = NDArray[Any] | float


def log_bayes_factor(log_det: Numbers, fall: Numbers, left: Numbers | None = None, dof: int = 0) -> Floats:
    """Return ln BF = -1/2 ln det(1 + S G S) - m/2 ln(1 - fall / left), of any shape and the precision of `fall`.

    G: products of the columns, S: their sizes, both over sigma; log_det: ln det(1 + S G S); left: square sum without
    them, fall: by how much it falls, p'S (1 + S G S)^-1 S p; dof: m, degrees of freedom of `left`. sigma is unknown,
    p(sigma) ~ 1 / sigma; where it is known left is None, fall is in sigma^2, and the last term is its limit fall / 2.
    """
    if left is None:
        return np.asarray((fall - log_det) / 2)
    share: NDArray[Any] = np.asarray(fall / left)
    most = 1 - (1e-12 if share.dtype == np.float64 else 1e-7)  # what is more is rounding
    return np.asarray(-0.5 * log_det - 0.5 * dof * np.log1p(-np.minimum(share, share.dtype.type(most))))
