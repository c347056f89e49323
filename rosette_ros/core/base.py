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

import numpy as np
import scipy.fft
import scipy.linalg

from rosette_ros.core.errors import InvalidModel, NotDeterminable
from rosette_ros.core.geometry import nominal_angles
from rosette_ros.core.records import CURVES

BASE_TERMS = ('table_motions', 'plate_deviations', 'cmm_deviations')
GAUGE = (
    'means of ctx, cty, ctz, crx, cry, crz',
    'once-per-turn part of (ctx, cty) that looks like eccentricity of the plate',
    'once-per-turn part of (crx, cry) that looks like tilt of the plate',
    'common height, radial scale and turn about z of plate and CMM',
    'harmonics of the table error above n/2',
)
"""What no three-rosette run can know, in words for every result."""


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
        self._root = np.ones(run.size) if weight is None else np.sqrt(weight / np.mean(weight))
        self._parts = (_Part(_z_design(run, terms), self._root, _z_gauge(run.n)),
                       _Part(_w_design(run, terms), np.repeat(self._root, 2), _w_gauge(run.n)))
        self.rank = sum(part.rank for part in self._parts)
        wanted = CompleteSpace(_complete_like(run), lever, terms).rank
        if self.rank < wanted:
            raise NotDeterminable(self._missing(run, wanted))

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
                'Measure the missing balls')

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


class _Part:
    """Least squares of one independent part of the base model (z, or x and y together)."""

    def __init__(self, design, root, gauge):
        self.size = design.shape[1]
        weighted = design * root[:, None]
        normal = weighted.T @ weighted
        value, vector = np.linalg.eigh(normal)
        keep = value > 1e-9 * max(value[-1], 1.0)
        self.rank = int(keep.sum())
        self._null = vector[:, ~keep]
        self._vector, self._value = vector[:, keep], value[keep]
        basis = weighted @ (self._vector / np.sqrt(self._value))
        # One Cholesky step makes the basis orthonormal to rounding.
        root_factor = np.linalg.cholesky(basis.T @ basis)
        self._basis = scipy.linalg.solve_triangular(root_factor, basis.T, lower=True).T
        self._mix = (self._vector / np.sqrt(self._value)) @ np.linalg.inv(root_factor).T
        # x -> x - G (C G)^-1 C x brings any solution into the gauge C x = 0.
        vectors, constraints = gauge
        self._gauge_vectors = vectors
        self._shift = np.eye(self.size) - vectors @ np.linalg.solve(constraints @ vectors,
                                                                    constraints)
        self._mix = self._shift @ self._mix

    def residual(self, rows):
        once = rows - (rows @ self._basis) @ self._basis.T
        return once - (once @ self._basis) @ self._basis.T

    def solve(self, rows):
        return (rows @ self._basis) @ self._mix.T

    def cofactor(self):
        return np.sum(self._mix**2, axis=1)

    def undetermined(self):
        """Return which unknowns the readings leave open beyond the gauge, (size,) bool."""
        gauge = np.linalg.qr(self._gauge_vectors)[0]
        beyond = self._null - gauge @ (gauge.T @ self._null)
        vectors, value, _ = np.linalg.svd(beyond, full_matrices=False)
        share = np.sum(vectors[:, value > 0.5]**2, axis=1)
        return share > max(0.5 * share.max(initial=0), 1e-6)


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


def _one_hot(index, n):
    return (index[:, None] == np.arange(1, n + 1)).astype(float)


def _z_design(run, terms):
    """Return the design of z, (N, 5 n): ctz, R crx, R cry, P_z, M_z."""
    table, plate, cmm = (float(term in terms) for term in BASE_TERMS)
    at, of, on = (_one_hot(index, run.n)
                  for index in (run.table_position, run.ball, run.cmm_position))
    sin, cos = np.sin(run.alpha)[:, None], np.cos(run.alpha)[:, None]
    return np.hstack([table * at, table * sin * at, -table * cos * at, plate * of, cmm * on])


def _w_design(run, terms):
    """Return the design of (x, y) interleaved, (2 N, 7 n): ctx, cty, R crz, P_x, P_y, M_x, M_y."""
    n = run.n
    table, plate, cmm = (float(term in terms) for term in BASE_TERMS)
    at, of, on = (_one_hot(index, n) for index in (run.table_position, run.ball, run.cmm_position))
    zero = np.zeros_like(at)
    sin, cos = np.sin(run.alpha)[:, None], np.cos(run.alpha)[:, None]
    sin_t, cos_t = np.sin(run.phi)[:, None], np.cos(run.phi)[:, None]
    x = np.hstack([table * at, zero, -table * sin * at, plate * cos_t * of, -plate * sin_t * of,
                   cmm * on, zero])
    y = np.hstack([zero, table * at, table * cos * at, plate * sin_t * of, plate * cos_t * of,
                   zero, cmm * on])
    return np.stack([x, y], axis=1).reshape(2 * run.size, 7 * n)


def _z_gauge(n):
    """Return gauge vectors (5 n, 6) of z and the constraints (6, 5 n) that fix them."""
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    vectors = np.stack([
        np.concatenate([one, o, o, o, -one]),       # height of the table against the CMM
        np.concatenate([o, o, o, one, -one]),       # height of the plate against the CMM
        np.concatenate([o, one, o, o, -s]),         # mean tilt about x: z = R sin alpha
        np.concatenate([o, o, one, o, c]),          # mean tilt about y: z = -R cos alpha
        np.concatenate([o, c, s, -s, o]),           # tilt that turns: z = R sin(alpha - phi)
        np.concatenate([o, -s, c, c, o]),           # z = -R cos(alpha - phi)
    ], axis=-1)
    constraints = np.stack([
        np.concatenate([one, o, o, o, o]),
        np.concatenate([o, o, o, o, one]),
        np.concatenate([o, one, o, o, o]),
        np.concatenate([o, o, one, o, o]),
        np.concatenate([o, c, s, o, o]),
        np.concatenate([o, -s, c, o, o]),
    ])
    return vectors, constraints


def _w_gauge(n):
    """Return gauge vectors (7 n, 7) of x, y and the constraints (7, 7 n) that fix them."""
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    vectors = np.stack([
        np.concatenate([one, o, o, o, o, -one, o]),     # mean of ctx against the CMM
        np.concatenate([o, one, o, o, o, o, -one]),     # mean of cty
        np.concatenate([c, s, o, -one, o, o, o]),       # eccentricity of the plate
        np.concatenate([-s, c, o, o, -one, o, o]),
        np.concatenate([o, o, one, s, -c, o, o]),       # mean turn of the table against the plate
        np.concatenate([o, o, o, -s, c, s, -c]),        # turn of the plate against the CMM
        np.concatenate([o, o, o, c, s, -c, -s]),        # radial scale of plate against CMM
    ], axis=-1)
    constraints = np.stack([
        np.concatenate([one, o, o, o, o, o, o]),
        np.concatenate([o, one, o, o, o, o, o]),
        np.concatenate([c, s, o, o, o, o, o]),
        np.concatenate([-s, c, o, o, o, o, o]),
        np.concatenate([o, o, one, o, o, o, o]),
        np.concatenate([o, o, o, o, o, -s, c]),
        np.concatenate([o, o, o, o, o, c, s]),
    ])
    return vectors, constraints


__all__ = ['BASE_TERMS', 'CURVES', 'GAUGE', 'BaseParameters', 'CompleteSpace', 'DenseSpace',
           'base_space']
