# SPDX-License-Identifier: Apache-2.0
"""The base model: table motions, plate deviations, CMM deviations, and what they can describe.

Measurement equation, linear form:

    p = R_z(phi_i) (b_j + P_j) + T_i + Theta_i x R_z(phi_i) b_j + M_k

The 12 n unknowns have rank 12 n - 13 on a complete run. The 13 combinations that no three-rosette
run can know are fixed by this gauge (the paper's, continued to plate and CMM): the means of T and
Theta are zero; (ctx, cty) and (crx, cry) have no once-per-turn part that looks like eccentricity or
tilt of the plate; M has zero mean along z, radially and tangentially, so that plate position,
radius and turn stand in P.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from rosette_ros.core.base_parts import BASE_TERMS, base_parts
from rosette_ros.core.errors import InvalidModel, NotDeterminable
from rosette_ros.core.records import CURVES

GAUGE = (
    'means of ctx, cty, ctz, crx, cry, crz',
    'once-per-turn part of (ctx, cty) that looks like eccentricity of the plate',
    'once-per-turn part of (crx, cry) that looks like tilt of the plate',
    'common height, radial scale and turn about z of plate and CMM',
    'harmonics of the table error above n/2',
)
"""What no three-rosette run can know, in words for every result."""
_MOST_GAUGE = 13
_LARGE = 40  # balls; what runs of smaller plates lack is told one by one


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Base parameters of m columns: curves (m, n, 6), plate and cmm (m, n, 3), m and rad."""

    curves: np.ndarray
    plate: np.ndarray
    cmm: np.ndarray


def base_space(run, lever, terms=BASE_TERMS, weight=None):
    """Return the space of the base model on a run: CompleteSpace where it can be, else DenseSpace.

    run: Run; lever: radius at which rotations act, m; terms: subset of BASE_TERMS; weight: (N,)
    positive, inverse relative variances, or None for equal ones.

    Raises NotDeterminable, with what cannot be determined, for too little data.
    """
    unknown = [term for term in terms if term not in BASE_TERMS]
    if unknown:
        raise InvalidModel(f'base: wanted some of {", ".join(BASE_TERMS)}, got {unknown[0]!r}')
    if run.is_complete and (weight is None or np.ptp(weight) == 0):
        return CompleteSpace(run, lever, terms)
    return DenseSpace(run, lever, terms, weight)


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal rows that span a model on a run of N readings.

    axial: (rz, N) along z; plane: (rw, N, 2) along x and y; mixed: (k, N, 3) along all axes.
    """

    axial: np.ndarray
    plane: np.ndarray
    mixed: np.ndarray

    @property
    def rank(self):
        """Number of rows."""
        return len(self.axial) + len(self.plane) + len(self.mixed)

    def residual(self, columns):
        """Return columns (m, N, 3) freed of what the rows span, same shape."""
        flat = columns.reshape(len(columns), self._rows.shape[1])
        return (flat - (flat @ self._rows.T) @ self._rows).reshape(columns.shape)

    @cached_property
    def _rows(self):
        return self.rows()

    def rows(self):
        """Return all rows, (rank, 3 N)."""
        size = self.axial.shape[1]
        out = np.zeros((self.rank, size, 3))
        plane = len(self.axial) + len(self.plane)
        out[:len(self.axial), :, 2] = self.axial
        out[len(self.axial):plane, :, :2] = self.plane
        out[plane:] = self.mixed
        return out.reshape(self.rank, 3 * size)


SMALL = 333
"""Readings up to which a basis that is at hand is quicker than an FFT."""


class CompleteSpace:
    """The base model on a complete, equally weighted run, by its two-dimensional spectrum.

    On the grid (table position i, CMM position k) with frequencies (p, q), z and w = x + iy, the
    base model is a set of lines: q = 0 (T), p = 0 (M), p + q = 0 in z and 1 in w (P), q = +-1 in z
    (crx, cry), and of q = 1 in w the part with c(p) = -conj c(-p) (crz). Projecting on it costs one
    FFT.
    """

    def __init__(self, run, lever, terms=BASE_TERMS):
        """Lay out the lines for a complete run; see base_space."""
        n = self.n = run.n
        self._run = run
        self.lever = lever
        self.terms = tuple(terms)
        cell = (run.table_position - 1) * n + run.cmm_position - 1
        self._cell = cell
        self._reading = np.argsort(cell)
        p, q = np.meshgrid(np.arange(n), np.arange(n), indexing='ij')
        table, plate, cmm = (term in terms for term in BASE_TERMS)
        z = np.zeros((n, n), dtype=bool)
        w = np.zeros((n, n), dtype=bool)
        if table:
            z |= (q == 0) | (q == 1) | (q == n - 1)
            w |= q == 0
        if plate:
            z |= (p + q) % n == 0
            w |= (p + q) % n == 1
        if cmm:
            z |= p == 0
            w |= p == 0
        self._z_lines, self._w_lines = z, w
        # crz takes half of each point of the line q = 1 that no other line takes; other lines
        # meet q = 1 at p = 0 alone, which is its own mirror.
        self._mirror = (-np.arange(n)) % n
        self._crz = ~w[:, 1] & table
        self.rank = int(z.sum() + 2 * w.sum() + self._crz.sum())

    @property
    def lines(self):
        """Share of each point (p, q) of the spectra of z and w that the base model takes, (n, n) twice."""
        plane = self._w_lines.astype(float)
        plane[:, 1] = np.maximum(plane[:, 1], 0.5 * self._crz)
        return self._z_lines.astype(float), plane

    @cached_property
    def basis(self):
        """Orthonormal rows that span the base model, a Basis."""
        return _basis(base_parts(self._run, self.terms, np.ones(self._run.size)))

    def _spectra(self, columns):
        """Return spectra of z (m, n, n) and w (m, n, n) of columns (m, N, 3)."""
        z = scipy.fft.fft2(self._grid(columns[..., 2]), axes=(1, 2))
        return z, self._plane_spectrum(columns)

    def _grid(self, values):
        """Return values (m, N) on the grid of table and CMM positions, (m, n, n)."""
        return values[:, self._reading].reshape(len(values), self.n, self.n)

    def _plane_spectrum(self, columns):
        kind = np.complex64 if columns.dtype == np.float32 else complex
        w = np.empty((len(columns), self.n, self.n), dtype=kind)
        w.real, w.imag = self._grid(columns[..., 0]), self._grid(columns[..., 1])
        return scipy.fft.fft2(w, axes=(1, 2), overwrite_x=True, workers=_workers(columns))

    def residual(self, columns):
        """Return what the base model cannot describe of columns (m, N, 3), same shape and precision."""
        if 'basis' in self.__dict__ and len(self._cell) <= SMALL and columns.dtype == float:
            return self.basis.residual(columns)
        out = np.zeros(columns.shape, dtype=columns.dtype)
        if not len(columns):
            return out
        wide = self.n**2
        if columns[..., 2].any():
            z = scipy.fft.rfft2(self._grid(columns[..., 2]), axes=(1, 2), workers=_workers(columns))
            z[:, self._z_lines[:, :self.n // 2 + 1]] = 0
            z = scipy.fft.irfft2(z, s=(self.n, self.n), axes=(1, 2), overwrite_x=True,
                                 workers=_workers(columns))
            out[..., 2] = z.reshape(-1, wide)[:, self._cell]
        if columns[..., :2].any():
            w = self._plane_spectrum(columns)
            w[:, self._w_lines] = 0
            line = w[:, :, 1]
            kept = 0.5 * (line + line[:, self._mirror].conj())
            w[:, :, 1] = np.where(self._crz, kept, line)
            w = scipy.fft.ifft2(w, axes=(1, 2), overwrite_x=True, workers=_workers(columns))
            out[..., 0] = w.real.reshape(-1, wide)[:, self._cell]
            out[..., 1] = w.imag.reshape(-1, wide)[:, self._cell]
        return out

    def parameters(self, columns):
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge."""
        n = self.n
        z, w = self._spectra(columns)
        z, w = z / n**2, w / n**2
        m = len(columns)
        curves = np.zeros((m, n, 6))
        plate, cmm = np.zeros((m, n, 3)), np.zeros((m, n, 3))
        if 'table_motions' in self.terms:
            curves = self._curves(z, w)
        index = np.arange(n)
        if 'plate_deviations' in self.terms:
            # j = k - i + 1: P_j's harmonic q stands at (p, q) = (-q, q) in z, (1 - q, q) in w
            plate_z = scipy.fft.ifft(z[:, (-index) % n, index], axis=1) * n
            plate_w = scipy.fft.ifft(w[:, (1 - index) % n, index], axis=1) * n
            plate = np.stack([plate_w.real, plate_w.imag, plate_z.real], axis=-1)
        if 'cmm_deviations' in self.terms:
            line_z, line_w = z[:, 0, :].copy(), w[:, 0, :].copy()
            line_z[:, 0] = 0
            line_w[:, 1] = 0
            cmm_z, cmm_w = scipy.fft.ifft(line_z, axis=1) * n, scipy.fft.ifft(line_w, axis=1) * n
            cmm = np.stack([cmm_w.real, cmm_w.imag, cmm_z.real], axis=-1)
        return BaseParameters(curves, plate, cmm)

    def _curves(self, z, w):
        """Return the six curves (m, n, 6) from spectra divided by n*n."""
        n = self.n
        axial, radial = z[:, :, 0].copy(), w[:, :, 0].copy()
        axial[:, 0] = 0
        radial[:, [0, 1]] = 0
        # z of a tilt: R (crx sin alpha - cry cos alpha) = -R/2 tau e^{i alpha} + conjugate with
        # tau = cry + i crx, so the line q = 1 holds the spectrum of -R/2 tau.
        tilt = -2 * z[:, :, 1] / self.lever
        tilt[:, [0, n - 1]] = 0
        turn = w[:, :, 1] / (1j * self.lever)
        turn = 0.5 * (turn + turn[:, self._mirror].conj())
        turn[:, 0] = 0
        axial, radial, tilt, turn = (
            scipy.fft.ifft(part, axis=1) * n for part in (axial, radial, tilt, turn))
        return np.stack([radial.real, radial.imag, axial.real, tilt.imag, tilt.real, turn.real],
                        axis=-1)

    def curve_cofactor(self):
        """Return the variances of the curves for unit variance of a coordinate, (n, 6).

        They follow from counting the points of each line: var ctx = (n - 2)/n^2, var ctz =
        (n - 1)/n^2, var crx = 2 (n - 2)/(n R)^2, var crz = (n - 1)/(n R)^2.
        """
        n, r = self.n, self.lever
        if 'table_motions' not in self.terms:
            return np.zeros((n, 6))
        radial, axial = (n - 2) / n**2, (n - 1) / n**2
        return np.tile([radial, radial, axial, 2 * radial / r**2, 2 * radial / r**2,
                        axial / r**2], (n, 1))


def _workers(columns):
    """Return how many threads pay for a transform."""
    return 2 if columns.size > 200_000 else 1


class DenseSpace:
    """The base model on any run: missing or repeated balls, weights; by normal equations.

    z and the xy part are independent: 5 n and 7 n unknowns. Rotations are scaled by the lever so
    that all unknowns are lengths.
    """

    def __init__(self, run, lever, terms=BASE_TERMS, weight=None):
        """Build and decompose the normal equations; see base_space."""
        self.n = run.n
        self.lever = lever
        self.terms = tuple(terms)
        _refuse_far_too_few(run, terms)
        self._root = np.ones(run.size) if weight is None else np.sqrt(weight / np.mean(weight))
        self._parts = base_parts(run, terms, self._root)
        self.rank = sum(part.rank for part in self._parts)
        wanted = CompleteSpace(_complete_like(run), lever, terms).rank
        if self.rank < wanted:
            raise NotDeterminable(self._missing(run, wanted))

    @cached_property
    def basis(self):
        """Orthonormal rows that span the base model, a Basis; None where readings have weights."""
        return _basis(self._parts) if np.ptp(self._root) == 0 else None

    def _missing(self, run, wanted):
        z, w = self._parts
        names = [f'{curve} at table position {i + 1}'
                 for curve, part, row in (('ctx', w, 0), ('cty', w, 1), ('ctz', z, 0),
                                          ('crx', z, 1), ('cry', z, 2), ('crz', w, 2))
                 for i in np.flatnonzero(part.undetermined()[row * run.n:(row + 1) * run.n])]
        names += [f'the deviation of ball {j + 1}'
                  for j in np.flatnonzero(z.undetermined()[3 * run.n:4 * run.n])]
        names += [f'the deviation of the CMM at position {k + 1}'
                  for k in np.flatnonzero(z.undetermined()[4 * run.n:])]
        what = ', '.join(names[:6]) + (f' and {len(names) - 6} more' if len(names) > 6 else '')
        return (f'{run.source}: too few ball centres: {run.size} of {run.n**2} give rank '
                f'{self.rank} where {wanted} is needed (at least {5 * run.n - 6} well spread ball '
                f'centres); cannot determine {what or "the separation of table, plate and CMM"}. '
                'Measure the missing balls: rosette calibrate --resume RUN')

    def _split(self, columns):
        m = len(columns)
        plane = (columns[..., :2] * self._root[:, None]).reshape(m, 2 * self._root.size)
        return columns[..., 2] * self._root, plane

    def residual(self, columns):
        """Return what the base model cannot describe of columns (m, N, 3), same shape.

        Rows are weighted by the root of their weight, as least squares sees them.
        """
        m = len(columns)
        z, w = (part.residual(rows) for part, rows in zip(self._parts, self._split(columns)))
        return np.concatenate([w.reshape(m, z.shape[1], 2), z[..., None]], axis=-1)

    def parameters(self, columns):
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge."""
        n, m = self.n, len(columns)
        z, w = (part.solve(rows) for part, rows in zip(self._parts, self._split(columns)))
        z, w = z.reshape(m, 5, n), w.reshape(m, 7, n)
        curves = np.stack([w[:, 0], w[:, 1], z[:, 0], z[:, 1] / self.lever, z[:, 2] / self.lever,
                           w[:, 2] / self.lever], axis=-1)
        plate = np.stack([w[:, 3], w[:, 4], z[:, 3]], axis=-1)
        cmm = np.stack([w[:, 5], w[:, 6], z[:, 4]], axis=-1)
        table, with_plate, with_cmm = (term in self.terms for term in BASE_TERMS)
        return BaseParameters(curves * table, plate * with_plate, cmm * with_cmm)

    def curve_cofactor(self):
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""
        n, r = self.n, self.lever
        if 'table_motions' not in self.terms:
            return np.zeros((n, 6))
        z, w = (part.cofactor() for part in self._parts)
        z, w = z.reshape(5, n), w.reshape(7, n)
        return np.stack([w[0], w[1], z[0], z[1] / r**2, z[2] / r**2, w[2] / r**2], axis=-1)


def _refuse_far_too_few(run, terms):
    """Refuse a run of a large plate whose readings are fewer than its unknowns before anything is made for these."""
    unknowns = run.n * sum({'table_motions': 6}.get(term, 3) for term in terms) - _MOST_GAUGE
    if run.n > _LARGE and 3 * run.size < unknowns:
        raise NotDeterminable(
            f'{run.source}: too few ball centres: {run.size} of {run.n**2} cannot give rank {unknowns} '
            f'(wanted at least {5 * run.n - 6} well spread ball centres). Measure the missing '
            'balls: rosette calibrate --resume RUN')


def _basis(parts):
    z, w = (np.ascontiguousarray(part.basis.T) for part in parts)
    return Basis(z, w.reshape(len(w), -1, 2), np.zeros((0, z.shape[1], 3)))


def _complete_like(run):
    """Return indices of a complete run as far as CompleteSpace needs them."""
    n = run.n
    i, j = np.divmod(np.arange(n * n), n)
    return _Indices(n, i + 1, (i + j) % n + 1)


@dataclass(frozen=True, eq=False)
class _Indices:
    n: int
    table_position: np.ndarray
    cmm_position: np.ndarray


__all__ = ['BASE_TERMS', 'CURVES', 'GAUGE', 'BaseParameters', 'Basis', 'CompleteSpace', 'DenseSpace',
           'base_space']
