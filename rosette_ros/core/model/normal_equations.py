# SPDX-License-Identifier: Apache-2.0
"""Least squares of the two independent parts of the base model, z and (x, y), by normal equations."""

import numpy as np
import scipy.linalg
import scipy.sparse

from rosette_ros.core.geometry import nominal_angles
from rosette_ros.core.model.base_entries import Entries, entries
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Whitening
from rosette_ros.core.records import Bools, Floats, Run

Gauge = tuple[Floats, Floats]
"""Vectors (q, k) that no readings see, and the constraints (k, q) that fix them, of q unknowns."""


def base_parts(run: Run, terms: tuple[str, ...], whitening: Whitening | None = None) -> 'tuple[Part, Part]':
    """Return the least squares of z and of x and y in white coordinates."""
    z, w = (design.toarray() for design in designs(run, terms))
    if whitening is not None and not whitening.is_plain:
        z = whitening.along(2, z.T).T
        for axis in (0, 1):
            w[axis::2] = whitening.along(axis, w[axis::2].T).T
    touched = [np.isin(np.arange(1, run.n + 1), used) for used in (run.ball, run.cmm_position)]
    in_plane = np.repeat(touched, 2, axis=0).ravel()
    return Part(z, _z_gauge(run.n), np.concatenate(touched)), Part(w, _w_gauge(run.n), in_plane)


class Part:
    """Least squares of one independent part of the base model (z, or x and y together).

    rank; basis: (rows, rank) orthonormal columns that span the design; touched: (k,) which of the last unknowns (of
    balls and CMM positions) readings have.
    """

    def __init__(self, design: Floats, gauge: Gauge, touched: Bools) -> None:
        value, vector = np.linalg.eigh(design.T @ design)
        keep = value > 1e-9 * max(value[-1], 1.0)
        self.rank = int(keep.sum())
        self._null = vector[:, ~keep]
        scaled = vector[:, keep] / np.sqrt(value[keep])
        basis = design @ scaled
        # One Cholesky step makes the basis orthonormal to rounding.
        root_factor = np.linalg.cholesky(basis.T @ basis)
        self.basis: Floats = scipy.linalg.solve_triangular(root_factor, basis.T, lower=True).T
        # x -> x - G (C G)^-1 C x brings any solution into the gauge C x = 0.
        used = np.ones(design.shape[1])
        used[-touched.size:] = touched
        self._gauge_vectors, constraints = gauge[0] * used[:, None], gauge[1] * used
        shift = np.eye(design.shape[1]) - self._gauge_vectors @ np.linalg.solve(
            constraints @ self._gauge_vectors, constraints)
        self._mix: Floats = shift @ (scaled @ np.linalg.inv(root_factor).T)

    def residual(self, rows: Floats) -> Floats:
        """Return rows (m, rows) freed of the basis, twice for rounding's sake."""
        for _ in range(2):
            rows = rows - (rows @ self.basis) @ self.basis.T
        return rows

    def solve(self, rows: Floats) -> Floats:
        """Return the unknowns (m, q) of rows (m, rows), in the gauge."""
        return (rows @ self.basis) @ self._mix.T

    def cofactor(self) -> Floats:
        """Return the variances of the unknowns for unit variance of a coordinate, (q,)."""
        return np.asarray(np.sum(self._mix**2, axis=1))

    def undetermined(self) -> Bools:
        """Return which unknowns the readings leave open beyond the gauge, (q,)."""
        gauge = np.linalg.qr(self._gauge_vectors)[0]
        beyond = self._null - gauge @ (gauge.T @ self._null)
        vectors, value, _ = np.linalg.svd(beyond, full_matrices=False)
        share = np.sum(vectors[:, value > 0.5]**2, axis=1)
        return np.asarray(share > max(0.5 * share.max(initial=0), 1e-6))


def designs(run: Run, terms: tuple[str, ...] = BASE_TERMS) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Return the sparse designs of z, (N, 5 n): ctz, R crx, R cry, P_z, M_z, and of (x, y), (2 N, 7 n).

    The latter has x and y of a reading in turn: ctx, cty, R crz, P_x, P_y, M_x, M_y.
    """
    n = run.n
    z, x, y = entries(n, run.table_position, run.ball, terms)
    return _sparse(z, 5 * n), _sparse([entry for pair in zip(x, y) for entry in pair], 7 * n, 2)


def _sparse(entries: Entries, width: int, axes: int = 1) -> scipy.sparse.csr_array:
    """Return the matrix of columns' entries (first column, column of each reading, value); axes take turns."""
    size = entries[0][1].size
    row = np.stack([axes * np.arange(size) + place % axes for place in range(len(entries))], axis=1)
    column = np.stack([first + index for first, index, _ in entries], axis=1)
    value = np.stack([values for _, _, values in entries], axis=1)
    return scipy.sparse.csr_array((value.ravel(), (row.ravel(), column.ravel())), shape=(axes * size, width))


def gauges(n: int) -> tuple[Gauge, Gauge]:
    """Return the Gauge of z and of x and y."""
    return _z_gauge(n), _w_gauge(n)


def _rows(*rows: list[Floats]) -> Floats:
    """Return rows of n-vectors end to end, (k, q)."""
    return np.array([np.concatenate(row) for row in rows])


def _z_gauge(n: int) -> Gauge:
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    vectors = _rows(
        [one, o, o, o, -one],       # height of the table against the CMM
        [o, o, o, one, -one],       # height of the plate against the CMM
        [o, one, o, o, -s],         # mean tilt about x: z = R sin alpha
        [o, o, one, o, c],          # mean tilt about y: z = -R cos alpha
        [o, c, s, -s, o],           # tilt that turns: z = R sin(alpha - phi)
        [o, -s, c, c, o])           # z = -R cos(alpha - phi)
    return np.ascontiguousarray(vectors.T), _rows(
        [one, o, o, o, o], [o, o, o, o, one], [o, one, o, o, o], [o, o, one, o, o], [o, c, s, o, o], [o, -s, c, o, o])


def _w_gauge(n: int) -> Gauge:
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    vectors = _rows(
        [one, o, o, o, o, -one, o],     # mean of ctx against the CMM
        [o, one, o, o, o, o, -one],     # mean of cty
        [c, s, o, -one, o, o, o],       # eccentricity of the plate
        [-s, c, o, o, -one, o, o],
        [o, o, one, s, -c, o, o],       # mean turn of the table against the plate
        [o, o, o, -s, c, s, -c],        # turn of the plate against the CMM
        [o, o, o, c, s, -c, -s])        # radial scale of plate against CMM
    return np.ascontiguousarray(vectors.T), _rows(
        [one, o, o, o, o, o, o], [o, one, o, o, o, o, o], [c, s, o, o, o, o, o], [-s, c, o, o, o, o, o],
        [o, o, one, o, o, o, o], [o, o, o, o, o, -s, c], [o, o, o, o, o, c, s])
