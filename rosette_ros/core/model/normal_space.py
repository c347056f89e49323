# SPDX-License-Identifier: Apache-2.0
"""The base model on any run: missing or repeated balls, reduced plans with gaps, weights, noise that wanders."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.base_model import BaseLines, BaseParameters, BaseSpace, Basis
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.normal_equations import PARTS, Part, orthonormal_rows
from rosette_ros.core.records import CURVES, Floats, Run

_MOST_GAUGE = 13
_LARGE = 40  # balls; what runs of smaller plates lack is listed term by term


class NormalSpace(BaseSpace):
    """The base model on any run in any noise, by normal equations; memory is linear in the readings.

    z and the xy part are independent: 5 n and 7 n unknowns. Rotations are scaled by the lever so that all unknowns are
    lengths. Raises NotDeterminable, with what cannot be determined, for too little data.
    """

    def __init__(self, run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
                 whitening: Whitening | None = None) -> None:
        super().__init__(run, lever, terms, whitening)
        self._refuse_far_too_few(run)
        self._parts = [Part(run, axes, self.terms, self.whitening) for axes in PARTS]
        self.rank = sum(part.rank for part in self._parts)
        self._left_out = [np.setdiff1d(np.arange(1, run.n + 1), used) - 1 for used in (run.ball, run.cmm_position)]
        wanted = BaseLines.of(run.n, self.terms).rank - 3 * sum(
            unused.size for term, unused in zip(BASE_TERMS[1:], self._left_out) if term in self.terms)
        if self.rank < wanted:
            missing = self._undetermined() or 'the separation of table, plate and CMM'
            raise _too_few(run, f'give rank {self.rank} where {wanted} is needed', f'; cannot determine {missing}')

    @cached_property
    def basis(self) -> Basis:
        """Orthonormal rows that span the base model in white coordinates."""
        return Basis.of_parts(*orthonormal_rows(self._run, self.terms, self.whitening))

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

    def free(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision."""
        out = np.empty_like(columns)
        if not len(columns):
            return out
        for part, axes, rows in zip(self._parts, PARTS, _split(columns)):
            out[..., axes] = part.free(rows).T.reshape(*columns.shape[:2], len(axes))
        return out

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
        z, w = (part.curve_variances(self.n) for part in self._parts)
        r = self.lever**2
        return np.stack([w[0], w[1], z[0], z[1] / r, z[2] / r, w[2] / r], axis=-1)

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each; not touched: NaN."""
        z, w = (part.variances().reshape(-1, self.n) for part in self._parts)
        plate, cmm = ((term in self.terms) * np.stack([*w[3 + 2 * place:5 + 2 * place], z[3 + place]], axis=-1)
                      for place, term in enumerate(BASE_TERMS[1:]))
        plate[self._left_out[0]] = cmm[self._left_out[1]] = np.nan
        return plate, cmm


def _split(columns: NDArray[Real]) -> tuple[NDArray[Real], NDArray[Real]]:
    """Return the rows of z, (N, m), and of x and y in turn, (2 N, m), of columns (m, N, 3)."""
    return columns[..., 2].T, columns[..., :2].reshape(len(columns), 2 * columns.shape[1]).T


def _too_few(run: Run, rank: str, missing: str = '') -> NotDeterminable:
    touched = np.unique(run.ball).size + np.unique(run.cmm_position).size
    least = 3 * run.n + touched - 6
    empty = np.setdiff1d(np.arange(1, run.n + 1), run.table_position)
    what = (f'too few ball centres: {run.size} of {run.n**2} {rank}'
            f'{f" (at least {least} well spread ball centres)" * (run.size < least)}{missing}')
    if run.size >= least and empty.size:
        what = f'no ball centre at table position {", ".join(map(str, empty))}: the errors there cannot be determined'
    return NotDeterminable(f'{run.source}: {what}. Measure the missing balls; where RUN is a log: rosette calibrate '
                           '--resume RUN')

