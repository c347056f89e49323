# SPDX-License-Identifier: Apache-2.0
"""The base model on a run: table motions, plate deviations, CMM deviations, and what they can describe.

Measurement equation, linear form:

    p = R_z(phi_i) (b_j + P_j) + T_i + Theta_i x R_z(phi_i) b_j + M_k

The 12 n unknowns have rank 12 n - 13 on a complete run. The 13 combinations that no three-rosette run can know are
fixed by this gauge (the paper's, continued to plate and CMM): the means of T and Theta are zero; (ctx, cty) and (crx,
cry) have no once-per-turn part that looks like eccentricity or tilt of the plate; M has zero mean along z, radially and
tangentially, so that plate position, radius and turn stand in P.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.normal_equations import PARTS, parts_of
from rosette_ros.core.records import CURVES, Floats, Run

GAUGE = (
    'means of ctx, cty, ctz, crx, cry, crz',
    'once-per-turn part of (ctx, cty) that looks like eccentricity of the plate',
    'once-per-turn part of (crx, cry) that looks like tilt of the plate',
    'common height, radial scale and turn about z of plate and CMM',
    'harmonics of the table error above n/2',
)
"""What no three-rosette run can know, in words for every result."""

_MOST_GAUGE = 13
_LARGE = 40  # balls; what runs of smaller plates lack is listed term by term


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


class BaseSpace:
    """The base model on any run in any noise: what it can describe of columns, and the parameters that do.

    z and the xy part are independent: 5 n and 7 n unknowns, by normal equations whose memory is linear in the readings.
    lever: radius at which rotations act, m, so that all unknowns are lengths; terms: subset of BASE_TERMS; whitening:
    of the noise, None where it is white and equal; what a space makes of columns stands in white coordinates; rank: of
    the base model; is_even: whether the run is complete and its noise equal but for z. Raises NotDeterminable, with
    what cannot be determined, for too little data.
    """

    def __init__(self, run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
                 whitening: Whitening | None = None) -> None:
        self.whitening = white = whitening or Whitening(run.size, np.ones(3))
        self.n, self.lever, self.terms = run.n, lever, tuple(terms)
        self.is_even = run.is_complete and white.by_axis and bool(white.sd[0] == white.sd[1])
        self._refuse_far_too_few(run)
        self._left_out = [np.flatnonzero(np.bincount(used, minlength=run.n + 1)[1:] == 0)
                          for used in (run.ball, run.cmm_position)]
        self._parts = parts_of(run, self.terms, white)
        self.rank, wanted = sum(self.ranks), sum(part.wanted for part in self._parts)
        if self.rank < wanted:
            missing = self._undetermined() or 'the separation of table, plate and CMM'
            raise _too_few(run, f'give rank {self.rank} where {wanted} is needed', f'; cannot determine {missing}')

    @cached_property
    def basis(self) -> Basis:
        """Orthonormal rows that span the base model in white coordinates."""
        z, w = (np.ascontiguousarray(part.orthonormal_rows()) for part in self._parts)
        return Basis(z, w.reshape(len(w), z.shape[1], 2), np.zeros((0, z.shape[1], 3)))

    def _refuse_far_too_few(self, run: Run) -> None:
        """Refuse a run of a large plate with fewer readings than unknowns before memory for these is taken."""
        unknowns = run.n * sum({'table_motions': 6}.get(term, 3) for term in self.terms) - _MOST_GAUGE
        if run.n > _LARGE and 3 * run.size < unknowns:
            raise _too_few(run, f'cannot give rank {unknowns}')

    def _undetermined(self) -> str:
        z, w = (part.open_unknowns().reshape(-1, self.n) for part in self._parts)
        rows = [(f'{curve} at table position', row) for curve, row in zip(CURVES, (w[0], w[1], z[0], z[1], z[2], w[2]))]
        for row, unused in zip(z[3:], self._left_out):
            row[unused] = False
        rows += [('the deviation of ball', z[3]), ('the deviation of the CMM at position', z[4])]
        names = [f'{what} {k + 1}' for what, row in rows for k in np.flatnonzero(row)]
        return ', '.join(names[:6]) + (f' and {len(names) - 6} more' if len(names) > 6 else '')

    def residual(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of columns (m, N, 3), in white coordinates, same precision."""
        return self.free(self.whitening.apply(columns))

    def free(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision."""
        out = np.empty_like(columns)
        if not len(columns):
            return out
        for part, axes, rows in zip(self._parts, PARTS, _split(columns)):
            out[..., axes] = part.free(rows).T.reshape(*columns.shape[:2], len(axes))
        return out

    def inside(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return coordinates (m, k), orthonormal, of what the base model describes of white columns (m, N, 3).

        Products of columns less products of these are the products of what the base model leaves of them."""
        return np.concatenate([part.inside(rows) for part, rows in zip(self._parts, _split(columns))]).T

    def inside_of(self, waves: Any, directions: NDArray[Any]) -> NDArray[np.float32]:
        """Return these coordinates (m, d, k) of waves (m, N) times directions (d, N, 3) in diagonal noise, single."""
        white = (directions * self.whitening.factors).astype(np.float32)
        return np.concatenate([part.inside_of(waves, white[..., list(axes)])
                               for part, axes in zip(self._parts, PARTS)], 2)

    @property
    def log_dets(self) -> tuple[float, float]:
        """The logarithms of the determinants of the normal equations, of what is determined: of z, and of x and y."""
        return self._parts[0].log_det, self._parts[1].log_det

    @property
    def ranks(self) -> tuple[int, int]:
        """The ranks of z, and of x and y."""
        return self._parts[0].rank, self._parts[1].rank

    @property
    def leverage(self) -> Floats:
        """The share of each white coordinate that the base model describes, (N, 3)."""
        z, w = (part.leverage for part in self._parts)
        return np.column_stack([w.reshape(-1, 2), z])

    def parameters(self, columns: Floats) -> BaseParameters:
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge; of what was not touched NaN."""
        z, w = (part.parameters(rows).T.reshape(len(columns), -1, self.n)
                for part, rows in zip(self._parts, _split(self.whitening.apply(columns))))
        lever = self.lever
        curves = np.stack([w[:, 0], w[:, 1], z[:, 0], z[:, 1] / lever, z[:, 2] / lever, w[:, 2] / lever], axis=-1)
        plate = np.stack([w[:, 3], w[:, 4], z[:, 3]], axis=-1)
        cmm = np.stack([w[:, 5], w[:, 6], z[:, 4]], axis=-1)
        curves, plate, cmm = (part * (term in self.terms) for term, part in zip(BASE_TERMS, (curves, plate, cmm)))
        plate[:, self._left_out[0]] = cmm[:, self._left_out[1]] = np.nan
        return BaseParameters(curves, plate, cmm)

    def curve_cofactor(self) -> Floats:
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""
        if 'table_motions' not in self.terms:
            return np.zeros((self.n, 6))
        z, w = (part.variances.reshape(-1, self.n) for part in self._parts)
        r = self.lever**2
        return np.stack([w[0], w[1], z[0], z[1] / r, z[2] / r, w[2] / r], axis=-1)

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each; not touched: NaN."""
        z, w = (part.variances.reshape(-1, self.n) for part in self._parts)
        plate, cmm = ((term in self.terms) * np.stack([*w[3 + 2 * place:5 + 2 * place], z[3 + place]], axis=-1)
                      for place, term in enumerate(BASE_TERMS[1:]))
        plate[self._left_out[0]] = cmm[self._left_out[1]] = np.nan
        return plate, cmm


def _split(columns: NDArray[Real]) -> tuple[NDArray[Real], NDArray[Real]]:
    """Return the rows of z, (N, m), and of x and y in turn, (2 N, m), of columns (m, N, 3)."""
    return columns[..., 2].T, columns[..., :2].reshape(len(columns), 2 * columns.shape[1]).T


def _too_few(run: Run, rank: str, missing: str = '') -> NotDeterminable:
    balls, positions = np.unique(run.ball), np.unique(run.cmm_position)
    for name, members in (('balls', balls), ('CMM positions', positions)):
        if members.size < run.n and np.unique(run.cells).size == run.n * members.size:
            return NotDeterminable(f'{run.source}: the {name} {", ".join(map(str, members))} of {run.n} do not '
                                   'determine the curves; measure more of them, or others (rosette plan)')
    least = 3 * run.n + balls.size + positions.size - 6
    empty = np.setdiff1d(np.arange(1, run.n + 1), run.table_position)
    what = (f'too few ball centres: {run.size} of {run.n**2} {rank}'
            f'{f" (at least {least} well spread ball centres)" * (run.size < least)}{missing}')
    if run.size >= least and empty.size:
        what = f'no ball centre at table position {", ".join(map(str, empty))}: the errors there cannot be determined'
    return NotDeterminable(f'{run.source}: {what}. Measure the missing balls; where RUN is a log: rosette calibrate '
                           '--resume RUN')
