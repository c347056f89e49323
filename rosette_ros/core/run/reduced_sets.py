# SPDX-License-Identifier: Apache-2.0
"""Reduced schemes: every table position with all balls at some CMM positions only, or some balls at all of them.

Indices from 0, omega = exp(2 pi i / n), D the CMM positions in use. The readings at CMM position c in D, transformed
over the table positions i, fall into one small system for each frequency f (W for x + iy, Z for z):

    Z_c(f) = T(f) + omega^c U(f) + omega^-c V(f) + omega^-fc P(-f)            f = 1 .. n-1
    W_c(f) = T(f) + omega^c i R C(f) + omega^(1-f)c P(1-f)

with U the transform of -R (cry + i crx)/2, V(f) = conj U(-f) and, as crz is real, C(-f) = conj C(f), which joins the
systems of f and -f. f = 0 holds the CMM deviations alone. What no three-rosette run can know is left out: T(1) of W,
U(-1), V(1). Some balls at all CMM positions are the same equations seen from the plate: i' = -i, j' = k, k' = j,
w' = omega^-i w. Their inverses tell in a millisecond how well a set determines the curves, before it is chosen; runs
are solved by core/model/base_space.py.
"""

import itertools
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import Floats

Complexes = NDArray[np.complexfloating[Any, Any]]
TOLERANCE = 1e-9
"""Singular values below this share of the largest count as 0."""
_EXHAUSTIVE = 500
"""Sets of which all are tried; of more, one is improved by exchanges."""
_TRIALS = 12_000  # over n
_KNOWN = {(12, 4): (0, 4, 6, 9), (12, 6): (0, 1, 3, 5, 8, 9), (12, 8): (0, 1, 3, 4, 6, 7, 9, 10),
          (24, 6): (0, 2, 9, 10, 16, 19), (24, 8): (0, 1, 6, 8, 11, 15, 17, 20),
          (24, 12): (0, 1, 2, 5, 7, 9, 11, 12, 16, 17, 18, 21), (36, 9): (0, 1, 7, 10, 15, 17, 23, 27, 28),
          (36, 12): (0, 6, 8, 9, 14, 18, 19, 22, 25, 29, 32, 34),
          (36, 18): (0, 1, 5, 6, 8, 10, 12, 15, 16, 17, 20, 23, 25, 26, 28, 29, 33, 35)}
"""Good sets for usual numbers of balls, from 0, by (balls, size)."""


def complete_variance(n: int, lever: float) -> Floats:
    """Return the variances of the curves of a complete run for unit variance of each coordinate, (6,); lever: R, m.

    They follow from counting the points of each line of its spectrum: var ctx = (n - 2)/n^2, var ctz = (n - 1)/n^2,
    var crx = 2 (n - 2)/(n R)^2, var crz = (n - 1)/(n R)^2.
    """
    plane, axial, square = (n - 2) / n**2, (n - 1) / n**2, lever**2
    return np.array([plane, plane, axial, 2 * plane / square, 2 * plane / square, axial / square])


def relative_uncertainty(variance: Floats, lever: float) -> float:
    """Return the uncertainty of the curves beside that of a complete run, rms over the curves; variance: (n, 6)."""
    return float(np.sqrt(np.mean(variance / complete_variance(len(variance), lever))))


def penalty(n: int, members: tuple[int, ...]) -> float:
    """Return the uncertainty of the curves relative to a complete run, rms over the six, for the same sigma.

    members: CMM positions, or balls, in use, from 0; infinite where they do not determine the curves.
    """
    f = np.arange(1, n // 2 + 1)[:, None]
    omega = np.exp(2j * np.pi / n * np.array(members))[None] * np.ones((n // 2, 1))
    one, zero = np.ones_like(omega), np.zeros_like(omega)
    axial: Complexes = np.stack([one, omega, omega.conj(), omega**(-f)], axis=-1)
    above = np.stack([one, omega**(1 - f), zero, zero, 1j * omega], axis=-1)
    below = np.stack([zero, zero, one, omega.conj()**(1 + f), -1j * omega.conj()], axis=-1)
    axial[0, :, 2] = above[0, :, 0] = 0
    sizes_z, sizes_w = _sizes(axial), _sizes(np.concatenate([above, below], axis=1))
    if sizes_z is None or sizes_w is None:
        return math.inf
    paired = np.where(2 * f[:, 0] == n, 1, 2) / n  # f = n / 2 is its own mirror
    (t, u, v, _), (w, _, mirrored, _, c) = paired @ sizes_z, paired @ sizes_w
    plane, tilt = (w + mirrored) / 2, u + v
    return relative_uncertainty(np.tile([plane, plane, t, tilt, tilt, 2 * c], (n, 1)), 1.0)


def _sizes(design: Complexes) -> Floats | None:
    """Return the variances (h, unknowns) of the unknowns of systems (h, rows, unknowns), None where some are open."""
    value, right = np.linalg.svd(design, full_matrices=False)[1:]
    keep = value > TOLERANCE * value[:, :1]
    if np.any(keep.sum(axis=1) < np.count_nonzero(np.abs(design).max(axis=1), axis=1)):
        return None
    weight = np.where(keep, 1 / np.where(keep, value, 1), 0)**2
    return np.asarray(np.einsum('hku,hk->hu', np.abs(right)**2, weight))


def fewest_members(n: int) -> int:
    """Return how many CMM positions, or balls, n balls need: (d - 1) (n - 1) >= 3 n - 5, and 4 where there are more."""
    return min(n, max(4, -(-(3 * n - 5) // (n - 1)) + 1))


@lru_cache(maxsize=64)
def best_members(n: int, size: int, what: str = 'CMM positions or balls') -> tuple[int, ...]:
    """Return the CMM positions, or balls, from 0, of which `size` determine the curves of n balls best.

    what: they are, in words. Raises InvalidPlan where so few do not determine them.
    """
    if not 1 <= size <= n:
        raise InvalidPlan(f'{what} in use: expected 1..{n}, found {size}')
    if size == n:
        return tuple(range(n))
    if (n, size) in _KNOWN:
        return _KNOWN[n, size]
    if math.comb(n - 1, size - 1) <= _EXHAUSTIVE:
        every = ((0, *rest) for rest in itertools.combinations(range(1, n), size - 1))
        best = min((round(penalty(n, one), 9), one) for one in every)
    else:
        best = _exchanged(n, size)
    if not math.isfinite(best[0]):
        raise InvalidPlan(f'{size} of {n} {what} do not determine the curves; expected at least {fewest_members(n)}')
    return best[1]


def _exchanged(n: int, size: int) -> tuple[float, tuple[int, ...]]:
    """Return (penalty, members) of a drawn set after drawn exchanges of one member, each kept where it helps."""
    random = np.random.default_rng(n)
    best = (math.inf, (0, *random.choice(np.arange(1, n), size - 1, replace=False).tolist()))
    for _ in range(_TRIALS // n):
        out, new = random.choice(best[1][1:]), random.choice(np.setdiff1d(np.arange(n), best[1]))
        members = tuple(sorted({*best[1]} - {int(out)} | {int(new)}))
        best = min(best, (round(penalty(n, members), 9), members))
    return best
