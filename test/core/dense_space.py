# SPDX-License-Identifier: Apache-2.0
"""The base model by the singular values of one dense matrix, written out from the measurement equation."""

from functools import cached_property

import numpy as np

from rosette_ros.core.model.base_space import BaseParameters
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Whitening
from rosette_ros.core.run.geometry import nominal_angles, rotate_z

SINGULAR = 3e-5
"""Singular value, over the largest, that counts as 0."""


def design(run):
    """Return the equations p = R_z(phi) P + T + Theta x R_z(phi) b + M for lever 1, (N, 3, 12 n): T, Theta, P, M."""
    out, rows = np.zeros((run.size, 3, 12 * run.n)), np.arange(run.size)
    arm = np.stack([np.cos(run.alpha), np.sin(run.alpha), np.zeros(run.size)], axis=-1)
    for axis, unit in enumerate(np.eye(3)):
        every = np.tile(unit, (run.size, 1))
        for first, each, place, value in ((0, 6, run.table_position, every), (3, 6, run.table_position,
                                                                             np.cross(every, arm)),
                                          (6 * run.n, 3, run.ball, rotate_z(run.phi, every)),
                                          (9 * run.n, 3, run.cmm_position, every)):
            out[rows, :, first + each * (place - 1) + axis] = value
    return out


def constraints(n):
    """Return the gauge, (13, 12 n): means of T and Theta, eccentricity and tilt of the plate, means of M."""
    phi = nominal_angles(n)
    c, s, o = np.cos(phi), np.sin(phi), np.zeros(n)
    curves = [*np.eye(6)[:, None] * np.ones((n, 1))]
    curves += [np.stack(row, axis=-1) for row in ((c, s, o, o, o, o), (-s, c, o, o, o, o),
                                                  (o, o, o, c, s, o), (o, o, o, -s, c, o))]
    cmm = [np.stack(row, axis=-1) for row in ((o, o, o + 1), (c, s, o), (-s, c, o))]
    return np.array([np.concatenate([one.ravel(), np.zeros(6 * n)]) for one in curves]
                    + [np.concatenate([np.zeros(9 * n), one.ravel()]) for one in cmm])


class DenseSpace:
    """What BaseSpace promises."""

    def __init__(self, run, lever, terms=BASE_TERMS, whitening=None):
        self.whitening, self.n, self.lever = whitening or Whitening(run.size, np.ones(3)), run.n, lever
        self._whole = whole = design(run)
        touched = np.any(whole, axis=(0, 1))
        self._in_use = np.repeat([term in terms for term in BASE_TERMS], np.array([6, 3, 3]) * run.n)
        self._missing = ~touched
        white = self.whitening.apply(np.moveaxis(whole, -1, 0)).reshape(12 * run.n, -1).T
        left, value, right = np.linalg.svd(white * self._in_use, full_matrices=False)
        self.rank = int(np.count_nonzero(value > SINGULAR * value[0]))
        self.rows = left.T[:self.rank]
        self._least = (right[:self.rank].T / value[:self.rank]) @ self.rows

    @cached_property
    def _inverse(self):
        """The least squares in the gauge; LinAlgError where the whole model leaves more open than the gauge."""
        touched = ~self._missing
        null = np.zeros((12 * self.n, 13))
        every = np.linalg.svd(self._whole.reshape(-1, 12 * self.n)[:, touched])[2]
        null[touched] = every[len(every) - 13:].T
        fixed = constraints(self.n) * touched
        return self._least - null @ np.linalg.solve(fixed @ null, fixed @ self._least)

    def residual(self, columns):
        """Return what the base model cannot describe of columns."""
        flat = self.whitening.apply(columns).reshape(len(columns), -1)
        for _ in range(2):
            flat = flat - (flat @ self.rows.T) @ self.rows
        return flat.reshape(columns.shape)

    def parameters(self, columns):
        """Return the parameters in the gauge."""
        return BaseParameters(*self._apart(self.whitening.apply(columns).reshape(len(columns), -1) @ self._inverse.T))

    def curve_cofactor(self):
        """Return the variances of the curves."""
        return self._variances()[0]

    def deviation_cofactors(self):
        """Return the variances of the deviations."""
        return self._variances()[1:]

    def _variances(self):
        return [one[0] for one in self._apart(np.sum(self._inverse**2, axis=1)[None], 2)]

    def _apart(self, unknowns, power=1):
        unknowns = np.where(self._missing, np.nan, unknowns * self._in_use)
        curves, plate, cmm = np.split(unknowns, [6 * self.n, 9 * self.n], axis=1)
        turned = np.repeat([1, self.lever**-power], 3)
        return [curves.reshape(-1, self.n, 6) * turned, plate.reshape(-1, self.n, 3), cmm.reshape(-1, self.n, 3)]
