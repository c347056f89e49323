# SPDX-License-Identifier: Apache-2.0
"""The base model on a run: table motions, plate deviations, CMM deviations, and what they can describe.

Measurement equation, linear form:

    p = R_z(phi_i) (b_j + P_j) + T_i + Theta_i x R_z(phi_i) b_j + M_k

The 12 n unknowns have rank 12 n - 13 on a complete run. The 13 combinations that no three-rosette run can know are
fixed by this gauge (the paper's, continued to plate and CMM): the means of T and Theta are zero; (ctx, cty) and (crx,
cry) have no once-per-turn part that looks like eccentricity or tilt of the plate; M has zero mean along z, radially and
tangentially, so that plate position, radius and turn stand in P.

With the equations A of z, or of x and y, in white coordinates and F orthonormal combinations of unknowns that no
readings see, the unknowns of readings y are x = (A'A + F F')^-1 A'y. F is known beforehand: one Cholesky factor is
enough, whatever was measured, how often, and with which weights.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from typing import Any

import numpy as np
import scipy  # which loads its parts where they are used
from numpy.typing import NDArray

from rosette_ros.core.model.base_entries import PARTS, ROUNDING, TERM, entries, pairs, unmeasurable
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.model.waves import Waves
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import CURVES, Bools, Floats, Ints, Run

GAUGE = (
    'means of ctx, cty, ctz, crx, cry, crz',
    'once-per-turn part of (ctx, cty) that looks like eccentricity of the plate',
    'once-per-turn part of (crx, cry) that looks like tilt of the plate',
    'common height, radial scale and turn about z of plate and CMM',
    'harmonics of the table error above n/2',
)
"""What no three-rosette run can know, in words for every result."""

DOUBTFUL = 1e-6
"""Condition of normal equations below which their eigenvalues are looked at."""
_MOST_GAUGE = 13
_LARGE = 40  # balls; what runs of smaller plates lack is listed term by term


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Base parameters of m columns: curves (m, n, 6), plate and cmm (m, n, 3), m and rad."""

    curves: Floats
    plate: Floats
    cmm: Floats


class Factor:
    """The Cholesky factor of the normal equations of z, or of x and y; right sides and unknowns are (q, m).

    normal: (q, q), their lower triangle; used: (q,) unknowns that readings see; gauge: as of Places. rank: of the
    readings; wanted: that if they leave nothing open but the gauge; is_open: (q,) what they do.
    """

    def __init__(self, normal: Floats, used: Bools, gauge: tuple[Floats, Floats, Floats]) -> None:
        (self._vectors, self._shift, fixed), diagonal = gauge, normal.diagonal()
        self._scale = scale = float(diagonal[used].mean()) if used.any() else 1.0
        held: Floats = (scale * fixed @ fixed.T).T
        held += normal
        held[np.diag_indices(len(held))] += scale * ~used
        size = scipy.linalg.norm(held, 1, check_finite=False)
        self._root, failed = scipy.linalg.lapack.dpotrf(held, lower=1, overwrite_a=1)
        self.wanted = self.rank = int(used.sum() - fixed.shape[1])
        self.is_open = np.zeros(len(used), dtype=bool)
        if failed or scipy.linalg.lapack.dpocon(self._root, size, uplo='L')[0] < DOUBTFUL:
            value, vector = np.linalg.eigh(normal)
            self.rank = int(np.count_nonzero(value > ROUNDING * max(value[-1], 1.0)))
            null = vector[:, :len(value) - self.rank]
            left, value, _ = np.linalg.svd(null - fixed @ (fixed.T @ null), full_matrices=False)
            share = np.sum(left[:, value > 0.5]**2, axis=1) * used
            self.is_open = share > max(0.5 * share.max(initial=0), 1e-6)

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the normal equations, of what is determined."""
        held = len(self._root) - self.wanted
        return float(2 * np.sum(np.log(self._root.diagonal())) - held * np.log(self._scale))

    def solved(self, right: Floats) -> Floats:
        """Return the solution of the normal equations, in no gauge."""
        return np.asarray(scipy.linalg.cho_solve((self._root, True), right, check_finite=False))

    def halved(self, right: Floats) -> Floats:
        """Return H of right sides: H'H is their products with the solution."""
        return np.asarray(scipy.linalg.solve_triangular(self._root, right, lower=True, check_finite=False))

    def in_gauge(self, unknowns: Floats) -> Floats:
        """Return unknowns in the gauge."""
        return np.asarray(unknowns - self._vectors @ (self._shift @ unknowns))

    def inverse(self) -> Floats:
        """Return the lower triangle of the inverse of the normal equations, (q, q)."""
        return np.asarray(scipy.linalg.lapack.dpotri(self._root, lower=1)[0])

    @cached_property
    def mix(self) -> NDArray[np.float32]:
        """What `halved` multiplies the transposed right sides by, (q, q)."""
        return np.ascontiguousarray(scipy.linalg.lapack.dtrtri(self._root, lower=1)[0].T, dtype=np.float32)

    def seen(self, rows: Floats) -> Floats:
        """Return combinations (k, q) of the unknowns in the gauge as such of the unknowns: times 1 - V S."""
        return np.asarray(rows - (rows @ self._vectors) @ self._shift)

    @cached_property
    def variances(self) -> Floats:
        """The variances of the unknowns in the gauge, (q, 1): the diagonal of (1 - V S) N^-1 (1 - V S)'."""
        mixed = self.solved(self._shift.T)
        more = np.sum(self._vectors * (self._vectors @ (self._shift @ mixed) - 2 * mixed), axis=1)
        return np.asarray((self.inverse().diagonal() + more)[:, None])


class Places:
    """The equations of readings at the same places in the same order, before any noise.

    unknown, factor: (N, 3, 5), as of `entries`; parts: the unknowns of each of PARTS; in_use: (12 n,) those of the
    terms; touched: (12 n,) those that readings see, were they in use.
    """

    def __init__(self, n: int, table_position: Ints, ball: Ints, terms: tuple[str, ...]) -> None:
        self.n, size, self._term = n, ball.size, np.repeat(TERM, n)
        self.unknown, self.factor = entries(n, table_position, ball, terms)
        self.parts = [slice(blocks.start * n, blocks.stop * n) for _, blocks in PARTS]
        self.in_use = np.isin(BASE_TERMS, terms)[self._term]
        self.touched = (self._term == 0) | (np.bincount(self.unknown.ravel(), minlength=12 * n) > 0)
        entry = self.factor.ravel(), self.unknown.ravel(), np.arange(0, 15 * size + 1, 5)
        self.design: Any = scipy.sparse.csr_array(entry, (3 * size, 12 * n))
        self.order = np.lexsort((ball, table_position))
        rows = (3 * self.order[:, None] + np.arange(3)).ravel()
        self.adjoint = self.design[rows].T.tocsr()  # in the order of places: sums do not tell when a reading was taken
        self.adjoint.indices = rows.astype(np.int32)[self.adjoint.indices]
        self.gauges = [self._gauge(vectors, part) for vectors, part in zip(unmeasurable(n), self.parts)]

    def _gauge(self, vectors: Floats, part: slice) -> tuple[Floats, Floats, Floats]:
        """Return what no readings see of a part, V (q, k); how much of it is in unknowns, S (k, q); and, orthonormal,
        that of the unknowns in use, F (q, l).

        In the gauge the table's part of each of V is zero, and the CMM's part where the table has none."""
        vectors = vectors * self.touched[part, None]
        table, cmm = (vectors * (self._term[part] == one)[:, None] for one in (0, 2))
        fixed = np.where(table.any(axis=0), table, cmm).T
        own = vectors @ scipy.linalg.null_space(vectors[~self.in_use[part]])
        return vectors, np.linalg.solve(fixed @ vectors, fixed), np.linalg.qr(own)[0]

    def factors(self, white: Whitening) -> tuple[Factor, ...]:
        """Return the Factor of each of PARTS under a noise."""
        return self._plain if white.is_plain else self._factored(white)

    @cached_property
    def _plain(self) -> tuple[Factor, ...]:
        return self._factored(Whitening(len(self.order), np.ones(3)))

    def _factored(self, white: Whitening) -> tuple[Factor, ...]:
        return tuple(Factor(normal, (self.touched & self.in_use)[part], gauge)
                     for normal, part, gauge in zip(self._normal_equations(white), self.parts, self.gauges))

    def _normal_equations(self, white: Whitening) -> Iterator[Floats]:
        """Yield the normal equations of each of PARTS, at least their lower triangles."""
        if white.is_diagonal:
            yield from self.weighed(white.factors**2)
        else:
            yield from (reduce(np.add, (white.along(axis).normal_equations(one) for axis, one in each))
                        for each in self._along)

    def weighed(self, weight: Floats) -> Iterator[Floats]:
        """Yield the same where the coordinates have weights (N, 3)."""
        for (adds, _), (axes, _), part in zip(self.pairs, PARTS, self.parts):
            yield (adds @ weight[self.order, axes].ravel()).reshape((part.stop - part.start,) * 2).T

    @cached_property
    def pairs(self) -> list[tuple[Any, Any]]:
        """Of each of PARTS what a unit of weight of each coordinate, in the order of places, adds to the entries of the
        lower triangle of the normal equations, column by column, (q q, c): 15 products of its equation; transposed."""
        out = []
        for (axes, _), part in zip(PARTS, self.parts):
            size = part.stop - part.start
            entry, product = pairs(size, (self.unknown[self.order, axes] - part.start).astype(np.int32),
                                   self.factor[self.order, axes])
            start = np.arange(0, entry.size + 1, 15, dtype=np.int32)
            adds = scipy.sparse.csc_array((product.ravel(), entry.ravel(), start), (size**2, entry.size // 15))
            out.append((adds, adds.T))
        return out

    def shares(self, factors: Sequence[Factor]) -> Floats:
        """Return of each coordinate what the inverse of the normal equations makes of its equation, (N, 3)."""
        out = np.empty((len(self.order), 3))
        for found, (_, each), (axes, _) in zip(factors, self.pairs, PARTS):
            twice = 2 * found.inverse().T  # the lower triangle stands for both
            twice[np.diag_indices(len(twice))] /= 2
            out[self.order, axes] = (each @ twice.ravel()).reshape(len(out), -1)
        return out

    @cached_property
    def _along(self) -> list[list[tuple[int, Any]]]:
        """The axes of each of PARTS, and the equations along them, (N, q), dense where these are few."""
        every = [[(axis, self.design[axis::3, part]) for axis in range(3)[axes]]
                 for (axes, _), part in zip(PARTS, self.parts)]
        if self.n > _LARGE:
            return every
        return [[(axis, one.toarray()) for axis, one in each] for each in every]

    @cached_property
    def of_block(self) -> Floats:
        """How much of each block of unknowns the coordinates of a reading see, (N + 1, 3, 12), 0 at the end."""
        out = np.zeros((len(self.factor) + 1, 3, 12))
        np.put_along_axis(out[:-1], self.unknown // self.n, self.factor, axis=2)
        return out

    @cached_property
    def labels(self) -> list[tuple[Ints, Ints, Ints]]:
        """Of table position, ball and CMM position: the blocks of unknowns that have them, and as of `Waves.sums`."""
        out = []
        for term in range(3):
            blocks = np.flatnonzero(TERM == term)
            label = (self.unknown % self.n)[self.unknown // self.n == blocks[0]]
            count = np.bincount(label, minlength=self.n)
            members = np.full((self.n, count.max()), len(label))
            members[np.arange(members.shape[1]) < count[:, None]] = np.argsort(label, kind='stable')
            out.append((blocks, label, members))
        return out

    def columns(self, unknowns: Floats, white: Whitening) -> Floats:
        """Return what unknowns (12 n, m) do to the readings, in white coordinates, (m, N, 3)."""
        return white.apply((self.design @ unknowns).T.reshape(unknowns.shape[1], -1, 3))

    def right_sides(self, columns: NDArray[Real], white: Whitening) -> Floats:
        """Return the right sides of the normal equations, (12 n, m), of white columns (m, N, 3)."""
        adjoint = self.adjoint.astype(columns.dtype, copy=False)
        return np.asarray(adjoint @ white.adjoint(columns).reshape(len(columns), -1).T)


@lru_cache(maxsize=4)
def _places(n: int, table_position: bytes, ball: bytes, terms: tuple[str, ...]) -> Places:
    return Places(n, np.frombuffer(table_position, np.int64), np.frombuffer(ball, np.int64), terms)


class BaseSpace:
    """The base model on any run in any noise: what it can describe of columns, and the parameters that do.

    z and the xy part are independent: 5 n and 7 n unknowns, by normal equations.
    lever: radius at which rotations act, m, so that all unknowns are lengths; terms: subset of BASE_TERMS; whitening:
    of the noise, None where it is white and equal; what a space makes of columns stands in white coordinates; rank: of
    the base model; ranks, log_dets: of z, and of x and y, that and the logarithm of the determinant of the normal
    equations, of what is determined; is_even: whether the run is complete and its noise equal but for z. Raises
    NotDeterminable, with what cannot be determined, for too little data.
    """

    def __init__(self, run: Run, lever: float, terms: tuple[str, ...] = BASE_TERMS,
                 whitening: Whitening | None = None) -> None:
        self.whitening = white = whitening or Whitening(run.size, np.ones(3))
        self.n, self.lever, self.terms = run.n, lever, tuple(terms)
        self.is_even = run.is_complete and white.by_axis and bool(white.sd[0] == white.sd[1])
        self._refuse_far_too_few(run)
        self._places = _places(run.n, run.table_position.tobytes(), run.ball.tobytes(), self.terms)
        self._factors = self._places.factors(white)
        self.ranks = [one.rank for one in self._factors]
        self.rank, wanted = sum(self.ranks), sum(one.wanted for one in self._factors)
        if self.rank < wanted:
            missing = self._undetermined() or 'the separation of table, plate and CMM'
            raise _too_few(run, f'give rank {self.rank} where {wanted} is needed', f'; cannot determine {missing}')

    def _refuse_far_too_few(self, run: Run) -> None:
        """Refuse a run of a large plate with fewer readings than unknowns before memory for these is taken."""
        unknowns = run.n * sum({'table_motions': 6}.get(term, 3) for term in self.terms) - _MOST_GAUGE
        if run.n > _LARGE and 3 * run.size < unknowns:
            raise _too_few(run, f'cannot give rank {unknowns}')

    def _undetermined(self) -> str:
        one = self._named(np.concatenate([part.is_open for part in self._factors])[:, None])
        rows = [(f'{curve} at table position', row) for curve, row in zip(CURVES, one.curves[0].T)]
        rows += [('the deviation of ball', one.plate[0, :, 2]),
                 ('the deviation of the CMM at position', one.cmm[0, :, 2])]
        names = [f'{what} {k + 1}' for what, row in rows for k in np.flatnonzero(row > 0)]
        return ', '.join(names[:6]) + (f' and {len(names) - 6} more' if len(names) > 6 else '')

    @property
    def log_dets(self) -> list[float]:
        """The logarithms of the determinants of the normal equations, of what is determined: of z, and of x and y."""
        return [one.log_det for one in self._factors]

    def residual(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return what the base model cannot describe of columns (m, N, 3), in white coordinates, same precision."""
        return self.free(self.whitening.apply(columns))

    def free(self, columns: NDArray[Real], steps: int = 2) -> NDArray[Real]:
        """Return what the base model cannot describe of white columns (m, N, 3), same shape and precision.

        steps: one is enough where little of them can be described."""
        left = columns.astype(float)
        for _ in range(steps * (len(columns) > 0)):
            left -= self._places.columns(self._described(left), self.whitening)
        return left.astype(columns.dtype, copy=False)

    def inside(self, columns: NDArray[Real]) -> NDArray[Real]:
        """Return coordinates (m, k), orthonormal, of what the base model describes of white columns (m, N, 3).

        Products of columns less products of these are the products of what the base model leaves of them."""
        right = self._places.right_sides(columns, self.whitening)
        return self._each('halved', right).T.astype(columns.dtype, copy=False)

    def products(self, columns: Floats) -> list[Floats]:
        """Return the products of what the base model leaves of white columns (m, N, 3), of z and of x and y, (m, m)."""
        inside, out = self.inside(columns), []
        for part, (axes, _) in zip(self._places.parts, PARTS):
            rows = columns[..., axes].reshape(len(columns), -1)
            out.append(rows @ rows.T - inside[:, part] @ inside[:, part].T)
        return out

    def inside_of(self, waves: Waves, directions: NDArray[Any]) -> NDArray[np.float32]:
        """Return these coordinates (m, d, k) of m waves times directions (d, N, 3), single.

        Only in noise that does not wander; no column is written out: readings of a label are summed."""
        places, count = self._places, len(directions)
        white = np.concatenate([directions * self.whitening.factors**2, np.zeros((count, 1, 3))], axis=1)
        weight = (white.swapaxes(0, 1) @ places.of_block).astype(np.float32)  # (N + 1, d, 12)
        sums = [waves.sums(weight[:, :, blocks].reshape(len(weight), -1), label, members).reshape(
            self.n, waves.rows, count, len(blocks)) for blocks, label, members in places.labels]
        out = np.zeros((waves.rows, count, 12 * self.n), np.float32)
        for factor, part, (axes, blocks) in zip(self._factors, places.parts, PARTS):
            moved, right, order = np.flatnonzero(directions[..., axes].any(axis=(1, 2))), [], []
            for (every, _, _), own in zip(places.labels, sums):
                some = slice(*np.searchsorted(every, (blocks.start, blocks.stop)))
                order.append(((every[some] - blocks.start) * self.n + np.arange(self.n)[:, None]).ravel())
                own = own[..., some] if len(moved) == count else own[:, :, moved, some]
                right.append(own.transpose(1, 2, 0, 3).reshape(-1, len(order[-1])))
            made = np.concatenate(right, axis=1) @ factor.mix[np.concatenate(order)]
            out[:, moved, part] = made.reshape(waves.rows, len(moved), made.shape[1])
        return out

    def weighed(self, columns: Floats, weights: Floats) -> Iterator[tuple[Floats, float]]:
        """Yield the products of what the base model leaves of columns (m, N, 3), (m, m), and the logarithm of the
        determinant of the normal equations, for each of weights (D, N, 3) of the coordinates in white noise.

        Raises NotDeterminable where too little counts."""
        places, flat = self._places, columns.reshape(len(columns), -1)
        held = [gauge[2] @ gauge[2].T + np.diag(~known) for gauge, (_, known) in zip(places.gauges, self.systems)]
        for weight in weights:
            moved, log_det = flat * weight.ravel(), 0.0
            right, products = places.adjoint @ moved.T, moved @ flat.T
            for part, hold, normal in zip(places.parts, held, places.weighed(weight)):
                root, failed = scipy.linalg.lapack.dpotrf(normal + hold, lower=1, overwrite_a=1)
                if failed:
                    raise NotDeterminable('the readings that count under these weights do not determine the base model')
                half = scipy.linalg.lapack.dtrtrs(root, right[part], lower=1)[0]
                products -= half.T @ half
                log_det += 2 * float(np.sum(np.log(root.diagonal())))
            yield products, log_det

    @property
    def leverage(self) -> Floats:
        """The share of each coordinate that the base model describes, (N, 3), in noise that does not wander."""
        return self._places.shares(self._factors) * self.whitening.factors**2

    def described(self, columns: Floats) -> tuple[BaseParameters, Floats]:
        """Return the BaseParameters in the gauge that describe columns (m, N, 3) best, NaN where untouched, and
        `residual` of these."""
        left, found = np.array(self.whitening.apply(columns), dtype=float), np.zeros((12 * self.n, len(columns)))
        for _ in range(2):
            more = self._described(left)
            found += more
            left -= self._places.columns(more, self.whitening)
        return self._named(self._each('in_gauge', found)), left

    def continued(self, columns: Floats, table_position: Ints, ball: Ints) -> Floats:
        """Return what the base parameters that describe columns (m, N, 3) best make of other readings, (m, S, 3).

        table_position, ball: (S,) of these; a place that no reading saw has no deviation."""
        found = self._described(self.whitening.apply(columns))
        return np.asarray((self._equations(table_position, ball) @ found).T.reshape(len(columns), -1, 3))

    def cofactor_at(self, table_position: Ints, ball: Ints) -> Floats:
        """Return the covariance of what `continued` returns, (3 S, 3 S), for unit variance of a coordinate."""
        design = self._equations(table_position, ball)
        return np.asarray(design @ self._each('solved', design.T.toarray()))

    def _equations(self, table_position: Ints, ball: Ints) -> Any:
        """Return the equations of readings of what other ones saw, (3 S, 12 n)."""
        unknown, factor = entries(self.n, table_position, ball, self.terms)
        factor = factor * self._places.touched[unknown]
        return scipy.sparse.csr_array((factor.ravel(), unknown.ravel(), np.arange(0, factor.size + 1, 5)),
                                      (3 * ball.size, 12 * self.n))

    def curve_cofactor(self) -> Floats:
        """Return the variances of the curves for unit variance of a coordinate, (n, 6)."""
        return np.asarray(self._variances.curves[0])

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return the variances of plate and CMM for unit variance of a coordinate, (n, 3) each; not touched: NaN."""
        return self._variances.plate[0], self._variances.cmm[0]

    @property
    def systems(self) -> list[tuple[Factor, Bools]]:
        """The Factor of z, and that of x and y, and which of the unknowns (q,) are in the model and were touched."""
        known = self._places.touched & self._places.in_use
        return [(one, known[part]) for one, part in zip(self._factors, self._places.parts)]

    @cached_property
    def _variances(self) -> BaseParameters:
        return self._named(np.concatenate([one.variances for one in self._factors]), 2)

    def _described(self, columns: Floats) -> Floats:
        """Return unknowns (12 n, m) that describe white columns (m, N, 3) best, in no gauge."""
        return self._each('solved', self._places.right_sides(columns, self.whitening))

    def _each(self, what: str, values: Floats) -> Floats:
        """Return what the factors of z and of x and y make of their rows of values (12 n, m)."""
        return np.concatenate([getattr(one, what)(values[part])
                               for one, part in zip(self._factors, self._places.parts)])

    def _named(self, unknowns: Floats, power: int = 1) -> BaseParameters:
        """Return unknowns (12 n, m), lengths to some power, as BaseParameters; of what was not touched NaN."""
        places = self._places
        blocks = np.where(places.touched[:, None], unknowns * places.in_use[:, None], np.nan).reshape(12, self.n, -1).T
        return BaseParameters(blocks[..., [5, 6, 0, 1, 2, 7]] / np.repeat([1.0, self.lever**power], 3),
                              blocks[..., [8, 9, 3]], blocks[..., [10, 11, 4]])


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
