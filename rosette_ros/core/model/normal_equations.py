# SPDX-License-Identifier: Apache-2.0
"""Least squares of the two independent parts of the base model, z and (x, y), by sparse normal equations.

With the sparse design A in white coordinates and Z the combinations of unknowns that no readings see, the unknowns of
readings y are x = (A'A + Z Z')^-1 A'y. Z is known beforehand: one Cholesky factor is enough, whatever was measured, how
often, and with which weights. The CMM is eliminated where its own block is diagonal; 4 n and 5 n unknowns are left.
"""

from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import NDArray

from rosette_ros.core.geometry import nominal_angles
from rosette_ros.core.model.base_entries import Entries, entries
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Real, Whitening
from rosette_ros.core.records import Bools, Floats, Run

Gauge = tuple[Floats, Floats]
"""Vectors (q, k) that no readings see, and the constraints (k, q) that fix them, of q unknowns."""
SINGULAR, DOUBTFUL = 1e-9, 1e-6
"""Eigenvalue over the largest below which unknowns are open; condition below which eigenvalues are looked at."""
SMALL = 333
"""Readings up to which dense arrays are quicker than sparse ones."""
CHUNK = 64
"""Columns that are whitened at a time where that fills them."""
PARTS = ((2,), (0, 1))
"""Axes that are independent of each other in the model."""


class _Plan:
    """What the design depends on: equal for runs of the same places in the same order."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self._key = run.n, run.table_position.tobytes(), run.ball.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Plan) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


class _Places:
    """What one part of the design is before any noise, of readings of the same places in the same order.

    design: (rows, q), dense where that is quicker; order: of its rows by place, so that sums do not depend on when a
    reading was taken; used: (q,) unknowns that readings touch; unseen: (q, k) combinations of them that none sees.
    """

    def __init__(self, plan: _Plan, axes: tuple[int, ...], terms: tuple[str, ...]) -> None:
        run, n, count = plan.run, plan.run.n, len(axes)
        design = _designs(plan, terms)[PARTS.index(axes)]
        self.design: Any = design.toarray() if run.size <= SMALL else design
        self.order = (count * np.lexsort((run.ball, run.table_position))[:, None] + np.arange(count)).ravel()
        touched = np.repeat([np.isin(np.arange(1, n + 1), place) for place in (run.ball, run.cmm_position)], count, 0)
        has = np.concatenate([np.ones(3 * n, dtype=bool), touched.ravel()])
        vectors, constraints = _z_gauge(n) if count == 1 else _w_gauge(n)
        self.gauge = vectors * has[:, None], constraints * has
        absent = np.repeat([term not in terms for term in BASE_TERMS], [3 * n, count * n, count * n])
        self.unseen = self.gauge[0] @ scipy.linalg.null_space(self.gauge[0][absent]) if absent.any() else self.gauge[0]
        self.used = has & ~absent
        self._fixed: dict[int, tuple[Floats, Floats]] = {}

    def fixed(self, kept: int) -> tuple[Floats, Floats]:
        """Return what fixes the first unknowns that are kept, orthonormal, and orthonormal combinations cut to them."""
        if kept not in self._fixed:
            self._fixed[kept] = np.linalg.qr(self.unseen[:kept])[0], np.linalg.qr(self.unseen)[0][:kept]
        return self._fixed[kept]


class Part:
    """Least squares of one independent part of the base model in white coordinates: readings (rows, m).

    axes: one of PARTS; terms: of the base model; rank: of the design; wanted: its rank if readings leave nothing open
    beyond the gauge; null: what they do, (q, some) combinations of the q unknowns.
    """

    def __init__(self, plan: _Plan, axes: tuple[int, ...], terms: tuple[str, ...], whitening: Whitening) -> None:
        self._axes, self._white = axes, None if whitening.is_diagonal else whitening
        places = _places(plan, axes, terms)
        self._design = design = places.design
        if self._white is None and not whitening.is_plain:
            factors = whitening.factors[:, list(axes)].ravel()
            self._design = (factors[:, None] * design if isinstance(design, np.ndarray)
                            else scipy.sparse.diags_array(factors) @ design)
        self._order, self._gauge, used = places.order, places.gauge, places.used
        self._sorted = self._design[self._order]
        normal = self._normal()
        kept = self._kept = normal.shape[0] - (len(axes) * plan.run.n if self._white is None else 0)
        diagonal = normal.diagonal()
        scale = diagonal[used].mean() if used.any() else 1.0
        self.wanted = self.rank = int(used.sum()) - places.unseen.shape[1]
        self.null = np.zeros((len(used), 0))
        fixed, null = places.fixed(kept)
        self._across, self._own = _dense(normal[:kept, kept:]), np.where(used, diagonal, scale)[kept:]
        left = _dense(normal[:kept, :kept]) - (self._across / self._own) @ self._across.T
        left += scale * fixed @ fixed.T
        left[np.diag_indices(kept)] += scale * ~used[:kept]
        scaled = fixed.shape[1] + np.count_nonzero(~used)
        self._of_gauge = -np.linalg.slogdet(null.T @ null)[1] - scaled * np.log(scale)
        norm = float(np.abs(left).sum(axis=0).max(initial=0))
        self._root, failed = scipy.linalg.lapack.dpotrf(left, lower=1, overwrite_a=1)
        if failed or scipy.linalg.lapack.dpocon(self._root, norm, uplo='L')[0] < DOUBTFUL:
            value, vector = np.linalg.eigh(_dense(normal))
            self.rank = int(np.count_nonzero(value > SINGULAR * max(value[-1], 1.0)))
            self.null = vector[:, :len(value) - self.rank]

    def _normal(self) -> Any:
        """Return the normal equations, (q, q), sparse where the design is and whitening keeps it so."""
        if self._white is None:
            return self._sorted.T @ self._sorted
        width = self._design.shape[1]
        return np.hstack([self._back(self._whitened(_dense(self._design[:, start:start + CHUNK])))
                          for start in range(0, width, CHUNK)])

    def _whitened(self, rows: NDArray[Any], adjoint: bool = False) -> NDArray[Any]:
        """Return W, or W', of rows (rows, m), as far as it is not in the design."""
        if self._white is None:
            return rows
        out = np.empty_like(rows)
        for place, axis in enumerate(self._axes):
            made = self._white.along(axis)
            out[place::len(self._axes)] = (made.adjoint if adjoint else made.apply)(rows[place::len(self._axes)].T).T
        return out

    def _back(self, rows: NDArray[Real]) -> NDArray[Real]:
        """Return A' W' of white rows (rows, m): the right sides, (q, m)."""
        design: Any = self._single[0] if rows.dtype == np.float32 else self._design
        found: NDArray[Real] = design.T @ self._whitened(rows, adjoint=True)
        return found

    def free(self, rows: NDArray[Real]) -> NDArray[Real]:
        """Return white rows (rows, m) freed of the design, same precision: in double precision twice."""
        single = rows.dtype == np.float32
        design = self._single[0] if single else self._design
        for _ in range(1 if single else 2):
            rows = rows - self._whitened(design @ self._solved(self._back(rows)))
        left: NDArray[Real] = rows
        return left

    def inside(self, rows: NDArray[Real]) -> NDArray[Real]:
        """Return coordinates (k, m) of what the design describes of white rows (rows, m), same precision.

        They stand in an orthonormal basis: products of columns less those of their coordinates are the products of what
        the design leaves of them, at the cost of 4 n or 5 n unknowns instead of all readings.
        """
        return self._halved(self._back(rows))

    def inside_of(self, waves: Any, directions: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return these coordinates (m, d, k) of waves (m, N), dense or sparse, times white directions (d, N, axes).

        Single precision; no column is written out. Only where the noise of each coordinate is its own."""
        design, count = self._single[0], len(self._axes)
        if isinstance(design, np.ndarray):
            weighted: Any = sum(design[k::count] * directions[..., k, None] for k in range(count))
            mixed = (weighted @ self._mix).transpose(1, 0, 2).reshape(directions.shape[1], -1)
            return np.asarray(waves @ mixed).reshape(waves.shape[0], len(directions), -1)
        weighted = scipy.sparse.hstack([
            sum(scipy.sparse.diags_array(one[:, k]) @ design[k::count] for k in range(count))
            for one in directions], format='csr')
        right: Any = waves @ weighted
        right = np.ascontiguousarray(right if isinstance(right, np.ndarray) else right.toarray())
        return np.asarray((right.reshape(-1, len(self._mix)) @ self._mix).reshape(len(right), len(directions), -1))

    @cached_property
    def _mix(self) -> NDArray[np.float32]:
        """What makes right sides (q,) coordinates (k,), (q, k), single."""
        return np.asarray(self._halved(np.eye(len(self._gauge[0]))).T, dtype=np.float32)

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the normal equations without the combinations that no readings see."""
        return float(2 * np.sum(np.log(np.diag(self._root))) + np.sum(np.log(self._own)) + self._of_gauge)

    @cached_property
    def leverage(self) -> Floats:
        """The share of each white row that the design describes, (rows,)."""
        design = self._design
        if self._white is not None or isinstance(design, np.ndarray):
            return np.asarray(np.sum(self._halved(self._whitened(_dense(design)).T)**2, axis=0))
        half, size = self._halved(np.eye(design.shape[1])), np.diff(design.indptr)
        inverse, out = half.T @ half, np.zeros(len(size))
        for a, b in np.ndindex(size.max(), size.max()):  # a row has few entries: no dense design is needed
            row = np.flatnonzero(size > max(a, b))
            one, other = design.indptr[row] + a, design.indptr[row] + b
            out[row] += design.data[one] * design.data[other] * inverse[design.indices[one], design.indices[other]]
        return out

    def parameters(self, rows: Floats) -> Floats:
        """Return the unknowns (q, m) of white rows (rows, m), in the gauge."""
        if self._white is None:
            rows = rows[self._order]
            found = self._solved(self._sorted.T @ rows)
            found += self._solved(self._sorted.T @ (rows - self._sorted @ found))
        else:
            found = self._solved(self._back(rows))
            found += self._solved(self._back(rows - self._whitened(self._design @ found)))
        vectors, constraints = self._gauge
        return np.asarray(found - vectors @ np.linalg.solve(constraints @ vectors, constraints @ found))

    def orthonormal_rows(self) -> Floats:
        """Return orthonormal rows (rank, rows) that span the design in white coordinates."""
        design = self._design if self._white is None else self._whitened(_dense(self._design))
        value, vector = np.linalg.eigh(_dense(self._normal()))
        keep = slice(len(value) - self.rank, None)
        basis = design @ (vector[:, keep] / np.sqrt(value[keep]))
        # one Cholesky step makes the basis orthonormal to rounding
        return np.asarray(scipy.linalg.solve_triangular(np.linalg.cholesky(basis.T @ basis), basis.T, lower=True))

    @cached_property
    def variances(self) -> Floats:
        """Return the variances of all unknowns in the gauge, (q,)."""
        vectors, constraints = self._gauge
        shift = np.linalg.solve((constraints @ vectors).T, vectors.T)
        rows = self._halved(np.eye(len(vectors)))
        return np.asarray(np.sum((rows - (rows @ constraints.T) @ shift)**2, axis=0))

    def open_unknowns(self) -> Bools:
        """Return which unknowns the readings leave open beyond the gauge, (q,)."""
        gauge = np.linalg.qr(self._gauge[0])[0]
        beyond = self.null - gauge @ (gauge.T @ self.null)
        vectors, value, _ = np.linalg.svd(beyond, full_matrices=False)
        share = np.sum(vectors[:, value > 0.5]**2, axis=1)
        return np.asarray(share > max(0.5 * share.max(initial=0), 1e-6))

    def _solved(self, right: NDArray[Real]) -> NDArray[Real]:
        """Return the solution (q, m) of the normal equations for right sides (q, m)."""
        root, across, own = self._factors(right)
        last = right[self._kept:] / own[:, None]
        solve = scipy.linalg.lapack.spotrs if right.dtype == np.float32 else scipy.linalg.lapack.dpotrs
        first = solve(root, right[:self._kept] - across @ last, lower=1)[0]
        return np.concatenate([first, last - (across.T @ first) / own[:, None]])

    def _halved(self, right: NDArray[Real]) -> NDArray[Real]:
        """Return H (q, m) of right sides (q, m): H'H is the inverse of the normal equations."""
        root, across, own = self._factors(right)
        size = np.sqrt(own)[:, None]
        last = right[self._kept:] / size
        first = scipy.linalg.solve_triangular(root, right[:self._kept] - (across / size.T) @ last, lower=True,
                                              check_finite=False)
        return np.concatenate([first, last])

    def _factors(self, like: NDArray[Any]) -> tuple[Any, ...]:
        """Return root, across and own in the precision of an array."""
        return self._single[1:] if like.dtype == np.float32 else (self._root, self._across, self._own)

    @cached_property
    def _single(self) -> tuple[Any, ...]:
        return tuple(one.astype(np.float32) for one in (self._design, self._root, self._across, self._own))


def parts_of(run: Run, terms: tuple[str, ...], whitening: Whitening) -> tuple[Part, Part]:
    """Return the Parts of z, and of x and y, of a run; in white noise those of another run of the same plan."""
    plan = _Plan(run)
    return _plain(plan, terms) if whitening.is_plain else _parts(plan, terms, whitening)


def _parts(plan: _Plan, terms: tuple[str, ...], whitening: Whitening) -> tuple[Part, Part]:
    axial, plane = (Part(plan, axes, terms, whitening) for axes in PARTS)
    return axial, plane


@lru_cache(maxsize=4)
def _plain(plan: _Plan, terms: tuple[str, ...]) -> tuple[Part, Part]:
    return _parts(plan, terms, Whitening(plan.run.size, np.ones(3)))


def _dense(matrix: Any) -> Floats:
    found: Floats = np.array(matrix) if isinstance(matrix, np.ndarray) else matrix.toarray()
    return found


@lru_cache(maxsize=8)
def _places(plan: _Plan, axes: tuple[int, ...], terms: tuple[str, ...]) -> _Places:
    return _Places(plan, axes, terms)


@lru_cache(maxsize=4)
def _designs(plan: _Plan, terms: tuple[str, ...]) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Return the sparse designs of z, (N, 5 n): ctz, R crx, R cry, P_z, M_z, and of (x, y), (2 N, 7 n).

    The latter has x and y of a reading in turn: ctx, cty, R crz, P_x, P_y, M_x, M_y.
    """
    n, run = plan.run.n, plan.run
    z, x, y = entries(n, run.table_position, run.ball, terms)
    return _sparse(z, 5 * n), _sparse([entry for pair in zip(x, y) for entry in pair], 7 * n, 2)


def _sparse(entries: Entries, width: int, axes: int = 1) -> scipy.sparse.csr_array:
    """Return the matrix of columns' entries (first column, column of each reading, value); axes take turns."""
    size = entries[0][1].size
    row = np.stack([axes * np.arange(size) + place % axes for place in range(len(entries))], axis=1)
    column = np.stack([first + index for first, index, _ in entries], axis=1)
    value = np.stack([values for _, _, values in entries], axis=1)
    return scipy.sparse.csr_array((value.ravel(), (row.ravel(), column.ravel())), shape=(axes * size, width))


@lru_cache(maxsize=8)
def _z_gauge(n: int) -> Gauge:
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    vectors = np.block([
        [one, o, o, o, -one],       # height of the table against the CMM
        [o, o, o, one, -one],       # height of the plate against the CMM
        [o, one, o, o, -s],         # mean tilt about x: z = R sin alpha
        [o, o, one, o, c],          # mean tilt about y: z = -R cos alpha
        [o, c, s, -s, o],           # tilt that turns: z = R sin(alpha - phi)
        [o, -s, c, c, o]])          # z = -R cos(alpha - phi)
    return np.ascontiguousarray(vectors.T), np.block([
        [one, o, o, o, o], [o, o, o, o, one], [o, one, o, o, o], [o, o, one, o, o], [o, c, s, o, o], [o, -s, c, o, o]])


@lru_cache(maxsize=8)
def _w_gauge(n: int) -> Gauge:
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    vectors = np.block([
        [one, o, o, o, o, -one, o],     # mean of ctx against the CMM
        [o, one, o, o, o, o, -one],     # mean of cty
        [c, s, o, -one, o, o, o],       # eccentricity of the plate
        [-s, c, o, o, -one, o, o],
        [o, o, one, s, -c, o, o],       # mean turn of the table against the plate
        [o, o, o, -s, c, s, -c],        # turn of the plate against the CMM
        [o, o, o, c, s, -c, -s]])       # radial scale of plate against CMM
    return np.ascontiguousarray(vectors.T), np.block([
        [one, o, o, o, o, o, o], [o, one, o, o, o, o, o], [c, s, o, o, o, o, o], [-s, c, o, o, o, o, o],
        [o, o, one, o, o, o, o], [o, o, o, o, o, -s, c], [o, o, o, o, o, c, s]])
