# SPDX-License-Identifier: Apache-2.0
"""Which way of solving the base model a run allows.

Complete runs by FFT (base_model.py), reduced ones frequency by frequency (core/reduced_sets.py), any other by normal
equations (normal_equations.py)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.base_model import BaseLines, BaseParameters, BaseSpace, Basis, CompleteSpace
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.normal_equations import PARTS, Part, orthonormal_rows
from rosette_ros.core.records import CURVES, Floats, Ints, Run
from rosette_ros.core.reduced_sets import Complexes, FrequencyBlocks

_MOST_GAUGE = 13
_LARGE = 40  # balls; what runs of smaller plates lack is listed term by term


@dataclass(frozen=True, eq=False)
class Reduction:
    """Which part of a scheme is measured: by: 'cmm' or 'ball'; members: (d,) from 0; count: readings of each pair."""

    by: str
    members: Ints
    count: int

    @staticmethod
    def of(run: Run) -> 'Reduction | None':
        """Return the Reduction of a run, None where it is not one; a complete run is one of all CMM positions."""
        count = np.bincount(run.cells, minlength=run.n**2)
        most = int(count.max())
        for by, other in (('cmm', run.cmm_position), ('ball', run.ball)):
            members = np.unique(other) - 1
            if run.size == most * run.n * members.size and np.count_nonzero(count) * most == run.size:
                return Reduction(by, members, most)
        return None


class ReducedSpace(BaseSpace):
    """The base model on a reduced run whose noise is white but for z: one small system for each frequency.

    Raises NotDeterminable where the reduction does not determine the curves.
    """

    def __init__(self, run: Run, lever: float, reduction: Reduction, whitening: Whitening | None = None) -> None:
        super().__init__(run, lever, whitening=whitening)
        self.reduction, self._by_ball = reduction, reduction.by == 'ball'
        self._blocks = FrequencyBlocks(run.n, reduction.members)
        if not self._blocks.is_determined:
            raise NotDeterminable(
                f'{run.source}: the {"balls" if self._by_ball else "CMM positions"} '
                f'{", ".join(str(k + 1) for k in reduction.members)} of {run.n} do not determine the curves; measure '
                'more of them, or others (rosette plan)')
        self.rank = self._blocks.rank
        position = run.table_position - 1
        place = np.searchsorted(reduction.members, (run.ball if self._by_ball else run.cmm_position) - 1)
        self._cell = ((-position) % run.n if self._by_ball else position) * reduction.members.size + place
        self._reading = np.argsort(self._cell, kind='stable')
        self._turn = np.exp(2j * np.pi / run.n * np.arange(run.n))[:, None]  # omega^i' of plate axes

    def free(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision."""
        if not len(columns):
            return columns
        z, w = self._spectra(columns)
        half = self.n // 2
        model = np.zeros_like(z)
        model[0], model[1:] = z[0], self._blocks.z.projected(z[1:])
        axial = scipy.fft.irfft(model, n=self.n, axis=0)
        plane = np.empty_like(w)
        stacked = self._blocks.w.projected(_stack(w, half))
        size = self.reduction.members.size
        plane[0], plane[1:half + 1] = w[0], stacked[..., :size]
        plane[:-half - 1:-1] = stacked[..., size:].conj()
        plane = scipy.fft.ifft(plane, axis=0)
        if self._by_ball:
            plane *= self._turn[:, None].conj()
        parts = (plane.real, plane.imag, axial)
        model = np.stack([part.transpose(1, 0, 2).reshape(len(columns), -1)[:, self._cell] for part in parts], axis=-1)
        out: NDArray[Real] = columns - model.astype(columns.dtype, copy=False)
        return out

    def _spectra(self, columns: NDArray[Real]) -> tuple[Complexes, Complexes]:
        """Return the transforms over the table positions of z, (h + 1, m, d), and of x + iy, (n, m, d)."""
        def grid(values: NDArray[Real]) -> NDArray[Real]:
            shape = (len(values), self.n, self.reduction.members.size, self.reduction.count)
            mean: NDArray[Real] = values[:, self._reading].reshape(shape).mean(axis=3)
            return mean.transpose(1, 0, 2)
        w = grid(columns[..., 0]) + 1j * grid(columns[..., 1])
        if self._by_ball:
            w = w * self._turn[:, None].astype(w.dtype)
        return scipy.fft.rfft(grid(columns[..., 2]), axis=0), scipy.fft.fft(w, axis=0)

    def parameters(self, columns: Floats) -> BaseParameters:
        """Return the BaseParameters that describe columns (m, N, 3) best, in the gauge; not measured: NaN."""
        n, m, half = self.n, len(columns), self.n // 2
        members = self.reduction.members
        z, w = self._spectra(columns)
        x, y = self._blocks.z.solved(z[1:]), self._blocks.w.solved(_stack(w, half))

        def series(above: Complexes, below: Complexes, shift: int = 0) -> Complexes:
            """Return (n, m) values of harmonics shift + f and shift - f, f = 1 .. h."""
            spectrum = np.zeros((n, m), dtype=complex)
            f = np.arange(1, half + 1)
            spectrum[(shift - f) % n], spectrum[(shift + f) % n] = below, above
            return np.asarray(scipy.fft.ifft(spectrum, axis=0))

        axial = series(x[..., 0], x[..., 0].conj()).real
        tilt = series(x[..., 1], x[..., 2].conj())
        radial = series(y[..., 0], y[..., 2].conj())
        turn = series(y[..., 4], y[..., 4].conj()).real / self.lever
        moving = np.stack([*_parts(series(y[..., 3].conj(), y[..., 1], 1)), series(x[..., 3].conj(), x[..., 3]).real])
        fixed = np.full((3, n, m), np.nan)
        still = w[0].T / n
        fixed[:, members] = np.stack([still.real, still.imag, z[0].T.real / n])
        if self._by_ball:
            back = (-np.arange(n)) % n  # from i' to i
            axial, tilt, radial, turn = axial[back], tilt[back], radial[back], turn[back]
            tilt, radial = tilt * self._turn.conj(), radial * self._turn
            plate, cmm = fixed, moving
        else:
            angle = np.exp(2j * np.pi / n * np.arange(n))[:, None]
            common = np.mean(still * angle[members].conj(), axis=0) * angle
            shift = np.stack([*_parts(common), np.tile(fixed[2, members].mean(axis=0), (n, 1))])
            plate, cmm = moving + shift, fixed - shift
        curves = np.stack([*_parts(radial), axial, -2 * tilt.imag / self.lever, -2 * tilt.real / self.lever, turn],
                          axis=-1)
        return BaseParameters(curves.swapaxes(0, 1), plate.transpose(2, 1, 0), cmm.transpose(2, 1, 0))

    def curve_cofactor(self) -> Floats:
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""
        turned = 2 * np.angle(self._turn[:, 0]) if self._by_ball else None
        plane, z = self.whitening.sd[[0, 2]]**2
        variance = self._blocks.curve_variance(self.lever, self.reduction.count, turned)
        return np.asarray(variance * np.array([plane, plane, z, z, z, plane]))

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each; not measured: NaN."""
        return NormalSpace(self._run, self.lever, whitening=self.whitening).deviation_cofactors()


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


def base_space(run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
               whitening: Whitening | None = None) -> BaseSpace:
    """Return the space of the base model on a run: by FFT or by frequency where it can be, else by normal equations.

    lever: radius at which rotations act, m; terms: subset of BASE_TERMS; whitening: of the noise, None where it is
    white and equal; what a space makes of columns stands in white coordinates. Raises NotDeterminable, with what cannot
    be determined, for too little data.
    """
    whitening = whitening or Whitening(run.size, np.ones(3))
    if whitening.by_axis and whitening.sd[0] == whitening.sd[1]:
        if run.is_complete:
            return CompleteSpace(run, lever, terms, whitening)
        reduction = Reduction.of(run)
        if reduction and set(terms) == {*BASE_TERMS}:
            return ReducedSpace(run, lever, reduction, whitening)
    return NormalSpace(run, lever, terms, whitening)


def _stack(w: Complexes, half: int) -> Complexes:
    """Return the data of f = 1 .. h beside the conjugate ones of -f, (h, m, 2 d), of transforms (n, m, d)."""
    return np.concatenate([w[1:half + 1], w[:-half - 1:-1].conj()], axis=2)


def _parts(values: Complexes) -> tuple[Floats, Floats]:
    return np.asarray(values.real, dtype=float), np.asarray(values.imag, dtype=float)


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
