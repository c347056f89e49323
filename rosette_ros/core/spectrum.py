# SPDX-License-Identifier: Apache-2.0
"""A displacement as waves of table and CMM position: what the base model takes, and what it leaves.

On the grid of table positions i and CMM positions k of a complete run, z and w = x + iy have the
two-dimensional spectra

    Z(p, q) = 1/n^2 sum z_ik exp(-2 pi i (p i + q k)/n)      and W(p, q) likewise.

The base model is a set of whole lines (and half of each point of one line, crz); all else is what
effects are seen by. Noise of sigma has the same expected size at every point that is left.
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.base import BASE_TERMS, CompleteSpace
from rosette_ros.core.errors import NotDeterminable


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Sizes of the waves of a displacement, and which of them the base model describes.

    waves: (n,) p and q alike, in rising order, -n/2 <= p < n/2; axial, plane: (n, n) sizes by
    (p, q) of z and of x + iy, m; axial_base, plane_base: (n, n) share of each point that the base
    model takes, 0, 1/2 or 1.
    """

    waves: np.ndarray
    axial: np.ndarray
    plane: np.ndarray
    axial_base: np.ndarray
    plane_base: np.ndarray

    @property
    def left(self):
        """Sizes where the base model does not take all, (2, n, n), m, zero elsewhere."""
        return np.stack([self.axial * (self.axial_base < 1), self.plane * (self.plane_base < 1)])

    @property
    def seen(self):
        """Share of the square sum that lies where the base model takes nothing, from 0 to 1."""
        total = np.sum(self.axial**2) + np.sum(self.plane**2)
        left = np.sum(self.axial**2 * (1 - self.axial_base)) + np.sum(
            self.plane**2 * (1 - self.plane_base))
        return float(left / total) if total else 0.0


def spectrum(run, displacement, terms=BASE_TERMS):
    """Return the Spectrum of a displacement (N, 3), m, on a complete run.

    The mean of each axis is left out: a constant is no displacement between readings. terms: of the
    base model.

    Raises NotDeterminable where the run is not complete.
    """
    if not run.is_complete:
        raise NotDeterminable(f'{run.source}: a spectrum wants every ball once in every table '
                              f'position, got {run.size} readings for n = {run.n}; use compare')
    n = run.n
    free = displacement - displacement.mean(axis=0)
    grid = np.zeros((n, n, 3))
    grid[run.table_position - 1, run.cmm_position - 1] = free
    axial = np.fft.fft2(grid[..., 2]) / n**2
    plane = np.fft.fft2(grid[..., 0] + 1j * grid[..., 1]) / n**2
    lines = CompleteSpace(run, run.radius, terms).lines
    order = np.argsort(np.fft.fftfreq(n))
    axial, plane, *lines = (part[np.ix_(order, order)] for part in (axial, plane, *lines))
    return Spectrum(np.rint(np.fft.fftfreq(n)[order] * n).astype(int), np.abs(axial), np.abs(plane),
                    *lines)
