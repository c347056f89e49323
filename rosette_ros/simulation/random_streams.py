# SPDX-License-Identifier: Apache-2.0
"""Random numbers that depend on (seed, reading, draw) alone: one reading or a million agree.

Source: SplitMix64, Steele, Lea and Flood, "Fast splittable pseudorandom number generators" (2014):
the d-th number of a stream is a mixed counter, hence no state and no order of calling.
"""

import numpy as np
import scipy  # which loads its parts where they are used
from numpy.typing import ArrayLike, NDArray

from rosette_ros.core.run.records import Floats

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


def standard_normal(seed: int, reading: ArrayLike, draws: int) -> Floats:
    """Return standard normal numbers (N, draws) of streams by seed, below 2**63, and number of the reading, (N,)."""
    start = _mixed(np.array([seed], dtype=np.uint64) + _GAMMA)
    key = _mixed(start + (np.asarray(reading, dtype=np.uint64) + np.uint64(1)) * _GAMMA)
    count = np.arange(1, draws + 1, dtype=np.uint64)
    bits = _mixed(key[:, None] + count * _GAMMA)
    # 53 bits, shifted by half a step: never 0 or 1, where the normal quantile is infinite.
    uniform = ((bits >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53
    return scipy.special.ndtri(uniform)


def part_generator(seed: int, part: str) -> np.random.Generator:
    """Return the generator of one part of the machine, by its name: a change in one leaves the others."""
    return np.random.default_rng([seed, *part.encode()])


def _mixed(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
    bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
    return bits ^ (bits >> np.uint64(31))
