# SPDX-License-Identifier: Apache-2.0
"""The base model on a run that lacks single readings: that of the complete run, with the missing cells filled.

With H the projection of the complete run on its model and F the missing cells, what is filled in, x, leaves nothing
there: S x = -((1 - H) y)_F with S = (1 - H)_FF; then all else is that of the complete run. Few columns are filled by
conjugate gradients, one FFT pair a step; many by the Cholesky factor of S. The uncertainties come from the normal
equations of table and plate, the CMM eliminated, and the gauge fixed by its known null vectors.
"""

from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import NDArray

from rosette_ros.core.geometry import nominal_angles
from rosette_ros.core.model.base_model import BaseLines, BaseParameters, BaseSpace, CompleteSpace
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.normal_equations import Gauge, designs, gauges
from rosette_ros.core.records import Floats, Run

FEW, MOST = 24, 2000
"""Columns, and missing cells, above which the factor of S pays, and does not."""
SINGULAR = 1e-9
"""Pivot, over the largest, below which the rank may be short."""
STEPS, ROUNDING = 500, {4: 1e-6, 8: 1e-15}
"""Most steps of the conjugate gradients, and what they leave at most, by the bytes of a number."""


class IncompleteSpace(BaseSpace):
    """The base model on a run without repeats whose noise is white but for z.

    Raises LinAlgError where the readings may not determine all unknowns.
    """

    def __init__(self, run: Run, lever: float, whitening: Whitening | None = None) -> None:
        super().__init__(run, lever, whitening=whitening)
        n, self.rank = run.n, 12 * run.n - 13
        position, place = np.divmod(np.arange(n * n), n)
        self._complete = CompleteSpace(
            Run(n, run.radius, position + 1, (place - position) % n + 1, np.zeros((n * n, 3))), lever)
        self._cell = (run.table_position - 1) * n + run.cmm_position - 1
        self._missing = np.setdiff1d(np.arange(n * n), self._cell)
        self._z, self._w = (_Eliminated(design, gauge, axes * n) for design, gauge, axes in zip(
            designs(run), gauges(n), (1, 2)))

    def free(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision."""
        if not len(columns):
            return columns
        return self._complete.free(self._filled(columns))[:, self._cell]

    def parameters(self, columns: Floats) -> BaseParameters:
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge."""
        return self._complete.parameters(self._filled(columns))

    def curve_cofactor(self) -> Floats:
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""
        plane, z = self.whitening.sd[[0, 2]]**2
        axial, tilt_x, tilt_y = z * self._z.curve_variances(self.n)
        x, y, turn = plane * self._w.curve_variances(self.n)
        r = self.lever**2
        return np.stack([x, y, axial, tilt_x / r, tilt_y / r, turn / r], axis=-1)

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each."""
        plane, z = self.whitening.sd[[0, 2]]**2
        axial = z * self._z.variances()[3 * self.n:].reshape(2, self.n)
        flat = plane * self._w.variances()[3 * self.n:].reshape(2, 2, self.n)
        return np.stack([*flat[0], axial[0]], axis=-1), np.stack([*flat[1], axial[1]], axis=-1)

    def _filled(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return columns (m, N, 3) on the complete grid, (m, n n, 3), with what the model says where none is."""
        grid = np.zeros((len(columns), self.n**2, 3), dtype=columns.dtype)
        grid[:, self._cell] = columns
        wanted = -self._complete.free(grid)[:, self._missing]
        solve = self._by_factors if len(columns) > FEW and self._missing.size <= MOST else self._by_steps
        grid[:, self._missing] = solve(wanted)
        return grid

    def _seen(self, cells: NDArray[Real]) -> NDArray[Real]:
        """Return S of values (m, F, 3) in the missing cells."""
        grid = np.zeros((len(cells), self.n**2, 3), dtype=cells.dtype)
        grid[:, self._missing] = cells
        return self._complete.free(grid)[:, self._missing]

    def _by_steps(self, wanted: NDArray[Real]) -> NDArray[Real]:
        found, left = np.zeros_like(wanted), wanted.copy()
        way, size = left, np.sum(left**2, axis=(1, 2))
        least = size * ROUNDING[wanted.itemsize]**2
        for _ in range(STEPS):
            if np.all(size <= least):
                break
            seen = self._seen(way)
            step = size / np.maximum(np.sum(way * seen, axis=(1, 2)), np.finfo(wanted.dtype).tiny)
            found += step[:, None, None] * way
            left -= step[:, None, None] * seen
            before, size = size, np.sum(left**2, axis=(1, 2))
            way = left + (size / np.maximum(before, np.finfo(wanted.dtype).tiny))[:, None, None] * way
        return found

    def _by_factors(self, wanted: NDArray[Real]) -> NDArray[Real]:
        out = np.empty_like(wanted)
        z, w = self._single if wanted.itemsize == 4 else self._factors
        out[..., 2] = scipy.linalg.cho_solve((z, True), wanted[..., 2].T, check_finite=False).T
        plane = wanted[..., :2].reshape(len(wanted), -1).T
        out[..., :2] = scipy.linalg.cho_solve((w, True), plane, check_finite=False).T.reshape(*wanted.shape[:2], 2)
        return out

    @cached_property
    def _factors(self) -> tuple[Floats, Floats]:
        """Cholesky factors of S of z, (F, F), and of x and y, (2 F, 2 F).

        H of z and of w = x + iy depends on the differences of table and CMM positions alone, but for crz: e_t e_t'.
        """
        n, count = self.n, self._missing.size
        lines = BaseLines.of(n)
        i, k = np.divmod(self._missing, n)
        di, dk = (i[:, None] - i) % n, (k[:, None] - k) % n
        z = np.eye(count) - scipy.fft.ifft2(lines.z).real[di, dk]
        kernel = scipy.fft.ifft2(lines.w)[di, dk]
        angle = nominal_angles(n)[k]
        tangential = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        turn = scipy.fft.ifft(lines.crz).real[di] / n
        w = -turn[:, None, :, None] * tangential[:, :, None, None] * tangential
        w[:, 0, :, 0] -= kernel.real
        w[:, 1, :, 1] -= kernel.real
        w[:, 0, :, 1] += kernel.imag
        w[:, 1, :, 0] -= kernel.imag
        w = w.reshape(2 * count, 2 * count) + np.eye(2 * count)
        return np.linalg.cholesky(z), np.linalg.cholesky(w)

    @cached_property
    def _single(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        z, w = self._factors
        return z.astype(np.float32), w.astype(np.float32)


class _Eliminated:
    """Normal equations of z, or of x and y, of a sparse design; the last unknowns, of the CMM, are eliminated.

    Raises LinAlgError where the readings may leave unknowns open.
    """

    def __init__(self, design: Any, gauge: Gauge, last: int) -> None:
        self._kept, self._gauge = design.shape[1] - last, gauge
        normal = design.T @ design
        self._own = normal.diagonal()[self._kept:]
        if not self._own.all():
            raise np.linalg.LinAlgError('a CMM position without readings')
        self._across: Floats = normal[:self._kept, self._kept:].toarray()
        null = np.linalg.qr(gauge[0][:self._kept])[0]
        left = normal[:self._kept, :self._kept].toarray() - (self._across / self._own) @ self._across.T
        self._root = scipy.linalg.cholesky(left + last * null @ null.T, lower=True, check_finite=False)
        pivots = np.diag(self._root)**2
        if pivots.min() < SINGULAR * pivots.max():
            raise np.linalg.LinAlgError('the readings leave unknowns open')

    def curve_variances(self, n: int) -> Floats:
        """Return the variances of the first three unknowns of each of n table positions, in the gauge, (3, n)."""
        rows = self._solved(np.eye(self._kept, 3 * n))
        fixed = self._gauge[1][:, :3 * n]
        fixed = np.linalg.qr(fixed[np.any(fixed, axis=1)].T)[0]
        rows -= (rows @ fixed) @ fixed.T
        return np.asarray(np.sum(rows**2, axis=0).reshape(3, n))

    def variances(self) -> Floats:
        """Return the variances of all unknowns in the gauge, (q,)."""
        vectors, constraints = self._gauge
        shift = np.linalg.solve((constraints @ vectors).T, vectors.T)
        total = np.zeros(len(vectors))
        eliminated = np.eye(self._own.size) / np.sqrt(self._own)
        for rows in (self._solved(np.hstack([np.eye(self._kept), -self._across / self._own])),
                     np.hstack([np.zeros((self._own.size, self._kept)), eliminated])):
            total += np.sum((rows - (rows @ constraints.T) @ shift)**2, axis=0)
        return total

    def _solved(self, rows: Floats) -> Floats:
        solved: Floats = scipy.linalg.solve_triangular(
            self._root, rows, lower=True, overwrite_b=True, check_finite=False)
        return solved
