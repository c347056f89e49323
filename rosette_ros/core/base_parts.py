# SPDX-License-Identifier: Apache-2.0
"""Least squares of the two independent parts of the base model, z and (x, y), by normal equations."""

import numpy as np
import scipy.linalg

from rosette_ros.core.geometry import nominal_angles

BASE_TERMS = ('table_motions', 'plate_deviations', 'cmm_deviations')


def base_parts(run, terms, root):
    """Return the least squares of z and of x and y."""
    return (Part(_z_design(run, terms), root, _z_gauge(run.n)),
            Part(_w_design(run, terms), np.repeat(root, 2), _w_gauge(run.n)))


class Part:
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
        self.basis = scipy.linalg.solve_triangular(root_factor, basis.T, lower=True).T
        self._mix = (self._vector / np.sqrt(self._value)) @ np.linalg.inv(root_factor).T
        # x -> x - G (C G)^-1 C x brings any solution into the gauge C x = 0.
        vectors, constraints = gauge
        self._gauge_vectors = vectors
        self._shift = np.eye(self.size) - vectors @ np.linalg.solve(constraints @ vectors,
                                                                    constraints)
        self._mix = self._shift @ self._mix

    def residual(self, rows):
        once = rows - (rows @ self.basis) @ self.basis.T
        return once - (once @ self.basis) @ self.basis.T

    def solve(self, rows):
        return (rows @ self.basis) @ self._mix.T

    def cofactor(self):
        return np.sum(self._mix**2, axis=1)

    def undetermined(self):
        """Return which unknowns the readings leave open beyond the gauge, (size,) bool."""
        gauge = np.linalg.qr(self._gauge_vectors)[0]
        beyond = self._null - gauge @ (gauge.T @ self._null)
        vectors, value, _ = np.linalg.svd(beyond, full_matrices=False)
        share = np.sum(vectors[:, value > 0.5]**2, axis=1)
        return share > max(0.5 * share.max(initial=0), 1e-6)


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
