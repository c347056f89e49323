# SPDX-License-Identifier: Apache-2.0
"""The base model: table motions, plate deviations, CMM deviations, and what they can describe.

Measurement equation, linear form:

    p = R_z(phi_i) (b_j + P_j) + T_i + Theta_i x R_z(phi_i) b_j + M_k

The 12 n unknowns have rank 12 n - 13 on a complete run. The 13 combinations that no three-rosette run can know are
fixed by this gauge (the paper's, continued to plate and CMM): the means of T and Theta are zero; (ctx, cty) and (crx,
cry) have no once-per-turn part that looks like eccentricity or tilt of the plate; M has zero mean along z, radially and
tangentially, so that plate position, radius and turn stand in P.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.normal_equations import SMALL, orthonormal_rows
from rosette_ros.core.records import Bools, Floats, Run
from rosette_ros.core.reduced_sets import complete_variance

GAUGE = (
    'means of ctx, cty, ctz, crx, cry, crz',
    'once-per-turn part of (ctx, cty) that looks like eccentricity of the plate',
    'once-per-turn part of (crx, cry) that looks like tilt of the plate',
    'common height, radial scale and turn about z of plate and CMM',
    'harmonics of the table error above n/2',
)
"""What no three-rosette run can know, in words for every result."""

Spectra = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Base parameters of m columns: curves (m, n, 6), plate and cmm (m, n, 3), m and rad."""

    curves: Floats
    plate: Floats
    cmm: Floats


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal rows that span a model on a run of N readings.

    axial: (rz, N) along z; plane: (rw, N, 2) along x and y; mixed: (k, N, 3) along all axes.
    """

    axial: Floats
    plane: Floats
    mixed: Floats

    @staticmethod
    def of_parts(z: Floats, w: Floats) -> 'Basis':
        """Return the basis of rows of z, (rz, N), and of x and y in turn, (rw, 2 N)."""
        z, w = np.ascontiguousarray(z), np.ascontiguousarray(w)
        return Basis(z, w.reshape(len(w), z.shape[1], 2), np.zeros((0, z.shape[1], 3)))

    @property
    def rank(self) -> int:
        """Number of rows."""
        return len(self.axial) + len(self.plane) + len(self.mixed)

    def residual(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return columns (m, N, 3) freed of what the rows span, same shape and precision."""
        rows: NDArray[Any] = self._single if columns.dtype == np.float32 else self.rows
        flat = columns.reshape(len(columns), rows.shape[1])
        left: NDArray[Any] = flat - (flat @ rows.T) @ rows
        return left.reshape(columns.shape)

    @cached_property
    def _single(self) -> NDArray[np.float32]:
        return self.rows.astype(np.float32)

    @cached_property
    def rows(self) -> Floats:
        """All rows, (rank, 3 N)."""
        size = self.axial.shape[1]
        out = np.zeros((self.rank, size, 3))
        plane = len(self.axial) + len(self.plane)
        out[:len(self.axial), :, 2] = self.axial
        out[len(self.axial):plane, :, :2] = self.plane
        out[plane:] = self.mixed
        return out.reshape(self.rank, 3 * size)


@dataclass(frozen=True, eq=False)
class BaseLines:
    """What the base model takes of the two-dimensional spectra of a complete run.

    On the grid (table position i, CMM position k) with frequencies (p, q), z and w = x + iy, the base model is a set of
    lines: q = 0 (T), p = 0 (M), p + q = 0 in z and 1 in w (P), q = +-1 in z (crx, cry), and of q = 1 in w the part with
    c(p) = -conj c(-p) (crz). z, w: (n, n) whole points; crz: (n,) half of the point (p, 1) of w. crz takes half of each
    point of its line that no other line takes; other lines meet it at p = 0 alone, which is its own mirror.
    """

    z: Bools
    w: Bools
    crz: Bools

    @staticmethod
    def of(n: int, terms: tuple[str, ...] = BASE_TERMS) -> 'BaseLines':
        """Return the lines of some base terms for n balls."""
        p, q = np.meshgrid(np.arange(n), np.arange(n), indexing='ij')
        table, plate, cmm = (term in terms for term in BASE_TERMS)
        z = table & ((q == 0) | (q == 1) | (q == n - 1)) | plate & ((p + q) % n == 0) | cmm & (p == 0)
        w = table & (q == 0) | plate & ((p + q) % n == 1) | cmm & (p == 0)
        return BaseLines(z, w, ~w[:, 1] & table)

    @property
    def rank(self) -> int:
        """Rank of the base model."""
        return int(self.z.sum() + 2 * self.w.sum() + self.crz.sum())

    @property
    def shares(self) -> tuple[Floats, Floats]:
        """Share of each point (p, q) of the spectra of z and w that the base model takes, (n, n) each: 0, 1/2 or 1."""
        plane = self.w.astype(float)
        plane[:, 1] = np.maximum(plane[:, 1], 0.5 * self.crz)
        return self.z.astype(float), plane


class BaseSpace(ABC):
    """The base model on a run: what it can describe of columns, and the parameters that do.

    lever: radius at which rotations act, m; terms: those of the base model; whitening: of the noise, None where it is
    white and equal; rank: of the base model.
    """

    rank: int

    def __init__(self, run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
                 whitening: Whitening | None = None) -> None:
        self.whitening = whitening or Whitening(run.size, np.ones(3))
        self.n, self.lever, self.terms = run.n, lever, tuple(terms)
        self._run = run

    @cached_property
    def basis(self) -> Basis:
        """Orthonormal rows that span the base model in white coordinates."""
        return Basis.of_parts(*orthonormal_rows(self._run, self.terms))

    def residual(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of columns (m, N, 3), in white coordinates, same precision."""
        return self.free(self.whitening.apply(columns))

    @abstractmethod
    def free(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision."""

    @abstractmethod
    def parameters(self, columns: Floats) -> BaseParameters:
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge; not measured: NaN."""

    @abstractmethod
    def curve_cofactor(self) -> Floats:
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""

    @abstractmethod
    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each; not measured: NaN."""


class CompleteSpace(BaseSpace):
    """The base model on a complete run whose noise is equal but for z: projecting on its lines costs one FFT."""

    def __init__(self, run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
                 whitening: Whitening | None = None) -> None:
        super().__init__(run, lever, terms, whitening)
        self._cell = (run.table_position - 1) * run.n + run.cmm_position - 1
        self._reading = np.argsort(self._cell)
        self._mirror = (-np.arange(run.n)) % run.n
        self._lines = BaseLines.of(run.n, self.terms)
        self.rank = self._lines.rank

    def _grid(self, values: NDArray[Real]) -> NDArray[Real]:
        """Return values (m, N) on the grid of table and CMM positions, (m, n, n)."""
        return values[:, self._reading].reshape(len(values), self.n, self.n)

    def _plane_spectrum(self, columns: NDArray[Real]) -> Spectra:
        kind = np.complex64 if columns.dtype == np.float32 else complex
        w = np.empty((len(columns), self.n, self.n), dtype=kind)
        w.real, w.imag = self._grid(columns[..., 0]), self._grid(columns[..., 1])
        return scipy.fft.fft2(w, axes=(1, 2), overwrite_x=True, workers=_workers(columns))

    def free(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision."""
        out = np.zeros(columns.shape, dtype=columns.dtype)
        if not len(columns):
            return out
        if 'basis' in self.__dict__ and len(self._cell) <= SMALL and columns.dtype == float:
            return self.basis.residual(columns)
        wide = self.n**2
        if columns[..., 2].any():
            z = scipy.fft.rfft2(self._grid(columns[..., 2]), axes=(1, 2), workers=_workers(columns))
            z[:, self._lines.z[:, :self.n // 2 + 1]] = 0
            z = scipy.fft.irfft2(z, s=(self.n, self.n), axes=(1, 2), overwrite_x=True, workers=_workers(columns))
            out[..., 2] = z.reshape(-1, wide)[:, self._cell]
        if columns[..., :2].any():
            w = self._plane_spectrum(columns)
            w[:, self._lines.w] = 0
            line = w[:, :, 1]
            kept = 0.5 * (line + line[:, self._mirror].conj())
            w[:, :, 1] = np.where(self._lines.crz, kept, line)
            w = scipy.fft.ifft2(w, axes=(1, 2), overwrite_x=True, workers=_workers(columns))
            out[..., 0] = w.real.reshape(-1, wide)[:, self._cell]
            out[..., 1] = w.imag.reshape(-1, wide)[:, self._cell]
        return out

    def parameters(self, columns: Floats) -> BaseParameters:
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge."""
        n, m = self.n, len(columns)
        z = scipy.fft.fft2(self._grid(columns[..., 2]), axes=(1, 2)) / n**2
        w = self._plane_spectrum(columns) / n**2
        curves, plate, cmm = np.zeros((m, n, 6)), np.zeros((m, n, 3)), np.zeros((m, n, 3))
        if 'table_motions' in self.terms:
            curves = self._curves(z, w)
        index = np.arange(n)
        if 'plate_deviations' in self.terms:
            # j = k - i + 1: P_j's harmonic q stands at (p, q) = (-q, q) in z, (1 - q, q) in w
            plate = _points(w[:, (1 - index) % n, index], z[:, (-index) % n, index])
        if 'cmm_deviations' in self.terms:
            line_z, line_w = z[:, 0, :].copy(), w[:, 0, :].copy()
            line_z[:, 0] = 0
            line_w[:, 1] = 0
            cmm = _points(line_w, line_z)
        return BaseParameters(curves, plate, cmm)

    def _curves(self, z: Spectra, w: Spectra) -> Floats:
        """Return the six curves (m, n, 6) from spectra divided by n*n."""
        n = self.n
        axial, radial = z[:, :, 0].copy(), w[:, :, 0].copy()
        axial[:, 0] = 0
        radial[:, [0, 1]] = 0
        # z of a tilt: R (crx sin alpha - cry cos alpha) = -R/2 tau e^{i alpha} + conjugate with
        # tau = cry + i crx, so the line q = 1 holds the spectrum of -R/2 tau.
        tilt = -2 * z[:, :, 1] / self.lever
        tilt[:, [0, n - 1]] = 0
        turn: Spectra = w[:, :, 1] / (1j * self.lever)
        turn = 0.5 * (turn + turn[:, self._mirror].conj())
        turn[:, 0] = 0
        ctz, xy, tilts, crz = (scipy.fft.ifft(part, axis=1) * n for part in (axial, radial, tilt, turn))
        return np.stack([xy.real, xy.imag, ctz.real, tilts.imag, tilts.real, crz.real], axis=-1)

    def curve_cofactor(self) -> Floats:
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""
        plane, z = self.whitening.sd[[0, 2]]**2 * ('table_motions' in self.terms)
        return np.tile(complete_variance(self.n, self.lever) * [plane, plane, z, z, z, plane], (self.n, 1))

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each: 1/n, (n - 1)/n^2."""
        n, each = self.n, self.whitening.sd**2
        plate, cmm = (term in self.terms for term in BASE_TERMS[1:])
        return np.tile(plate * each / n, (n, 1)), np.tile(cmm * each * (n - 1) / n**2, (n, 1))


def _points(w: Spectra, z: Spectra) -> Floats:
    """Return x, y, z, (m, n, 3), of harmonics (m, n) of x + iy and of z."""
    z, w = (scipy.fft.ifft(part, axis=1) * w.shape[1] for part in (z, w))
    return np.stack([w.real, w.imag, z.real], axis=-1)


def _workers(columns: NDArray[Real]) -> int:
    return 2 if columns.size > 200_000 else 1
