# SPDX-License-Identifier: Apache-2.0
"""Mixes of columns that do not depend on each other."""

import numpy as np

from rosette_ros.core.run.records import Floats


def independent(gram: Floats, least: float) -> Floats:
    """Return T (k, q) with T G T' = 1 for the products G (q, q) of columns, without directions of square sums up to
    `least`: these depend on the others, or are rounding."""
    value, vector = np.linalg.eigh(gram)
    keep = value > least
    return np.asarray((vector[:, keep] / np.sqrt(value[keep])).T)
