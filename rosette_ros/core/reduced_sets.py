# SPDX-License-Identifier: Apache-2.0
"""Reduced schemes: every table position with all balls at some CMM positions only, or some balls at all of them.

Indices from 0, omega = exp(2 pi i / n), D the CMM positions in use. The readings at CMM position c in D, transformed
over the table positions i, fall into one small system for each frequency f (W for x + iy, Z for z):

    Z_c(f) = T(f) + omega^c U(f) + omega^-c V(f) + omega^-fc P(-f)            f = 1 .. n-1
    W_c(f) = T(f) + omega^c i R C(f) + omega^(1-f)c P(1-f)

with U the transform of -R (cry + i crx)/2, V(f) = conj U(-f) and, as crz is real, C(-f) = conj C(f), which joins the
systems of f and -f. f = 0 holds the CMM deviations alone. What no three-rosette run can know is left out: T(1) of W,
U(-1), V(1). Some balls at all CMM positions are the same equations seen from the plate: i' = -i, j' = k, k' = j,
w' = omega^-i w. Derived for this project; test/core/test_reduced_space.py compares it with a dense solution.
"""

import itertools
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.errors import InvalidPlan
from rosette_ros.core.geometry import Floats, Ints

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


class FrequencyBlocks:
    """The systems of f = 1 .. h, h = n // 2, for n table positions and CMM positions `members` (d,) from 0.

    z: (h, d, 4), columns T, U, V, P; w: (h, 2 d, 5), columns T(f), P, conj T(-f), conj P, C(f), with the data of f
    above the conjugate ones of -f. Left-out unknowns are columns of zeros.
    """

    def __init__(self, n: int, members: Ints) -> None:
        self.n, self.members = n, np.asarray(members)
        f = np.arange(1, n // 2 + 1)[:, None]
        omega = np.exp(2j * np.pi / n * self.members)[None] * np.ones((n // 2, 1))
        one, zero = np.ones_like(omega), np.zeros_like(omega)
        z = np.stack([one, omega, omega.conj(), omega**(-f)], axis=-1)
        above = np.stack([one, omega**(1 - f), zero, zero, 1j * omega], axis=-1)
        below = np.stack([zero, zero, one, omega.conj()**(1 + f), -1j * omega.conj()], axis=-1)
        z[0, :, 2] = above[0, :, 0] = 0
        self.z, self.w = Systems(z), Systems(np.concatenate([above, below], axis=1))
        self.paired = np.where(2 * f[:, 0] == n, 1, 2)

    @property
    def is_determined(self) -> bool:
        """Whether the readings determine all that is not left out."""
        return self.z.is_determined and self.w.is_determined

    @property
    def rank(self) -> int:
        """Rank of the base model."""
        return int(3 * self.members.size + self.paired @ self.z.rank + self.paired @ self.w.rank)

    def curve_variance(self, lever: float, count: int = 1, turned: Floats | None = None) -> Floats:
        """Return the variances of the curves for unit variance of each coordinate of `count` readings a pair, (n, 6).

        lever: m; turned: (n,) twice the angle, rad, between the axes of the systems and those of the curves.
        """
        n, (z, w) = self.n, (self.z.inverse, self.w.inverse)
        size_z, size_w = (np.sum(np.abs(rows)**2, axis=2) for rows in (z, w))  # of each unknown, (h, unknowns)
        swing = np.exp(-1j * (np.zeros(n) if turned is None else turned))
        each, pair = self.paired / (n * count), 1.0 / (n * count)
        axial = each @ size_z[:, 0]
        both = np.where(self.paired == 1, 0.5, 1.0)  # f = n / 2 holds U and V = conj U once
        tilt = pair * (both @ (size_z[:, 1] + size_z[:, 2]))
        mixed = pair * 2 * np.sum(both * np.sum(z[:, 1] * z[:, 2].conj(), axis=1)) * swing
        radial = pair * (both @ (size_w[:, 0] + size_w[:, 2]))
        skew = pair * 2 * np.sum(both * np.sum(w[:, 0] * w[:, 2].conj(), axis=1)) / swing
        turn = 2 * each @ size_w[:, 4] / lever**2
        one = np.ones(n)
        return np.stack([radial + skew.real, radial - skew.real, axial * one, 2 * (tilt - mixed.real) / lever**2,
                         2 * (tilt + mixed.real) / lever**2, turn * one], axis=-1)


class Systems:
    """Systems (h, rows, unknowns), each with an orthonormal basis, its pseudo-inverse and its rank."""

    def __init__(self, design: Complexes) -> None:
        left, value, right = np.linalg.svd(design, full_matrices=False)
        keep = value > TOLERANCE * value[:, :1]
        self.rank: Ints = keep.sum(axis=1)
        self.is_determined = bool(np.all(self.rank == np.count_nonzero(np.abs(design).max(axis=1), axis=1)))
        self.basis: Complexes = left * keep[:, None]
        scaled = right.conj().swapaxes(1, 2) * np.where(keep, 1 / np.where(keep, value, 1), 0)[:, None]
        self.inverse: Complexes = scaled @ left.conj().swapaxes(1, 2)

    def projected(self, data: Complexes) -> Complexes:
        """Return what the systems can describe of data (h, m, rows), same shape and precision."""
        basis = self.basis.astype(data.dtype, copy=False)
        return (data @ basis.conj()) @ basis.swapaxes(1, 2)

    def solved(self, data: Complexes) -> Complexes:
        """Return the unknowns (h, m, unknowns) of data (h, m, rows)."""
        return data @ self.inverse.swapaxes(1, 2)


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
    blocks = FrequencyBlocks(n, np.array(members))
    return relative_uncertainty(blocks.curve_variance(1.0), 1.0) if blocks.is_determined else math.inf


def fewest_members(n: int) -> int:
    """Return how many CMM positions, or balls, n balls need: (d - 1) (n - 1) >= 3 n - 5, and 4 where there are more."""
    return min(n, max(4, -(-(3 * n - 5) // (n - 1)) + 1))


@lru_cache(maxsize=64)
def best_members(n: int, size: int, what: str = 'CMM positions or balls') -> tuple[int, ...]:
    """Return the CMM positions, or balls, from 0, of which `size` determine the curves of n balls best.

    what: they are, in words. Raises InvalidPlan where so few do not determine them.
    """
    if not 1 <= size <= n:
        raise InvalidPlan(f'{what} in use: wanted 1..{n}, got {size}')
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
        raise InvalidPlan(f'{size} of {n} {what} do not determine the curves; wanted at least {fewest_members(n)}')
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
