# SPDX-License-Identifier: Apache-2.0
"""The least squares of a JointModel, with what each run has beside it.

With D the columns of the unknowns, E those of the effects in use and W what makes the noise white, unknowns u and
amplitudes a are the least of |W (y - D u - E a)|^2; both as in core/model/least_squares.py: effects are solved for in
what the unknowns leave, W E - P W E, and tangents of nonlinear parameters enter the uncertainties.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.joint.explained_runs import BesideBase, RunExplained
from rosette_ros.core.joint.joint_model import ZERO, JointModel
from rosette_ros.core.run.geometry import Floats, rotate_z
from rosette_ros.core.sight.linear_explanation import Solution

HIDDEN_PART = 1e-5
"""Part of a hidden direction, as a share of it, that counts."""
MOST_STEPS, SMALLEST_STEP = 8, 1e-13


class JointSolution:
    """The least squares of a JointModel: unknowns (q,), residual (N, 3), rss, rank; hidden: (q, h) directions.

    beside: what the runs have beside the model; rss: in white coordinates; moved: (N, 3), m, by the effects in use;
    amplitude: (k,) of these, then zeros for the tangents of their nonlinear parameters, cofactor: (k, k) of both; gram,
    told: (Q, Q), (Q,), products of all rows of effects, and with the readings, in what the unknowns leave. mix:
    (q, rank), such that mix mix' is the cofactor matrix of the unknowns; hidden_in_curves: how many of the hidden
    directions change curves; curves, mix_of_curves: the part of both that is of curves, without means and once-per-turn
    parts that are known only together, by known_together combinations. covariance: of the readings of each run beside
    their noise of 1, (3 N, 3 N), which they are weighted by.
    """

    def __init__(self, model: JointModel, beside: BesideBase | None = None, covariance: Sequence[Floats] = ()) -> None:
        self.model, self.beside = model, beside or BesideBase.of(RunExplained() for _ in model.runs)
        design = model.design[:, model.free]
        value, vector = scipy.linalg.eigh((design.T @ design).toarray())
        keep = value > ZERO * value[-1]
        self.hidden: Floats = np.zeros((model.free.size, int((~keep).sum())))
        self.hidden[model.free] = vector[:, ~keep]
        mix = np.zeros((model.free.size, int(keep.sum())))
        mix[model.free] = vector[:, keep] / np.sqrt(value[keep])
        transposed = design.T
        self._weight = [Solution(run.white(run.white(one).T)) for run, one in zip(self.beside.runs, covariance)]
        if covariance or not self.beside.is_plain:
            transposed = self._weighted(design.T.toarray())
            normal = mix[model.free].T @ (transposed @ (design @ mix[model.free]))
            mix = scipy.linalg.solve_triangular(np.linalg.cholesky(normal), mix.T, lower=True).T
        self._fixes = list(_gauge(model, self.hidden))
        self.hidden_in_curves = self._fixes[0][1]
        self._normal = mix, transposed
        place = model.groups['curves']
        self._together = _known_together(model, self.hidden[place], self._fixes[0][3].T)
        self.known_together = self._together.shape[1]
        self._rows = self.beside.rows(model.run)
        self._taken = (transposed @ self._rows.T).T @ mix[model.free]
        self.gram: Floats = self._rows @ self._weighted(self._rows).T - self._taken @ self._taken.T
        chosen, columns = self.beside.chosen(self.beside.choice)
        self.unknowns, amplitude = self._solved(chosen[:columns])
        self.moved: Floats = (amplitude @ self._rows).reshape(-1, 3)
        self.residual: Floats = model.centre - self.moved - model.predicted(self.unknowns)
        self.rss = self._square(self.residual)
        root = self.root(chosen)
        self._extended = root.T @ chosen
        self.rank = mix.shape[1] + root.shape[1]
        self.cofactor: Floats = root @ root.T
        self.amplitude: Floats = chosen @ amplitude
        self.told: Floats = self._weighted(self._rows) @ self.residual.ravel() + self.gram @ amplitude
        self.mix = self._in_gauge(mix)
        if len(self._rows):
            self.mix = np.hstack([self.mix, self.bias @ self._extended.T])
        self.curves: Floats = self.in_curves(self.unknowns)
        self.mix_of_curves: Floats = self.in_curves(self.mix)

    @property
    def bias(self) -> Floats:
        """What a unit of each row of effects would do to the unknowns, were it not in the model, less, (q, Q)."""
        return self._in_gauge(-self._normal[0] @ self._taken.T)

    def in_curves(self, unknowns: Floats) -> Floats:
        """Return the curves of unknowns, (q,) or (q, k), without what is known only together."""
        curves = unknowns[self.model.groups['curves']]
        return np.asarray(curves - self._together @ (self._together.T @ curves))

    def root(self, chosen: Floats) -> Floats:
        """Return the root (k, m) of the cofactor matrix of some mixes (k, Q) of rows of effects.

        What the unknowns hide of them has no part in it."""
        full = np.sqrt(np.einsum('kq,qr,kr->k', chosen, self.gram + self._taken @ self._taken.T, chosen))
        scale = np.where(full > 0, full, 1.0)
        value, vector = np.linalg.eigh(chosen @ self.gram @ chosen.T / scale[:, None] / scale)
        keep = value > ZERO
        return np.asarray(vector[:, keep] / np.sqrt(value[keep]) / scale[:, None])

    def shift(self, choice: Sequence[int]) -> Floats:
        """Return the amplitudes (Q,) of rows of effects by a choice of hypotheses, to first order."""
        chosen, columns = self.beside.chosen(choice)
        root = self.root(chosen[:columns])
        return np.asarray(chosen[:columns].T @ (root @ (root.T @ (chosen[:columns] @ self.told))))

    @property
    def base_rank(self) -> int:
        """Rank of the unknowns alone, the first columns of mix."""
        return int(self._normal[0].shape[1])

    def solved(self, centre: Floats) -> Floats:
        """Return the unknowns (q,) of other ball centres (N, 3) of the same readings, without effects."""
        (mix, transposed), model = self._normal, self.model
        unknowns = np.zeros(model.free.size)
        for _ in range(MOST_STEPS):
            step = transposed @ (centre - model.predicted(unknowns)).ravel()
            step = self._in_gauge(unknowns + mix @ (mix[model.free].T @ step)) - unknowns
            unknowns = unknowns + step
            if np.abs(step).max(initial=0) < SMALLEST_STEP:
                break
        return unknowns

    def _solved(self, columns: Floats) -> tuple[Floats, Floats]:
        """Return the unknowns (q,) and amplitudes of rows of effects, (Q,); columns: those in use, (k, Q)."""
        amplitude, unknowns = np.zeros(len(self._rows)), self.solved(self.model.centre)
        if not len(columns):
            return unknowns, amplitude
        root = self.root(columns)
        seen = root.T @ columns @ self._weighted(self._rows)
        for _ in range(MOST_STEPS):
            left = self.model.centre.ravel() - amplitude @ self._rows - self.model.predicted(unknowns).ravel()
            step = columns.T @ (root @ (seen @ left))
            amplitude = amplitude + step
            unknowns = self.solved(self.model.centre - (amplitude @ self._rows).reshape(-1, 3))
            if np.abs(step @ self._rows).max() < SMALLEST_STEP:
                break
        return unknowns, amplitude

    def _weighted(self, rows: Floats) -> Floats:
        """Return rows (k, 3 N) times the inverse of the covariance of the readings."""
        if self.beside.is_plain and not self._weight:
            return rows
        return np.hstack([self._weighted_of(place, rows[:, np.repeat(self.model.run == place, 3)])
                          for place in range(len(self.model.runs))])

    def _weighted_of(self, place: int, rows: Floats) -> Floats:
        """Return the same of one run, (k, 3 n)."""
        return self.beside.runs[place].weighted(rows, self._weight[place] if self._weight else None)

    def _square(self, residual: Floats) -> float:
        """Return the square sum of a residual (N, 3) in white coordinates."""
        if self.beside.is_plain:
            return float(np.sum(residual**2))
        return float(sum(np.sum(run.white(residual[self.model.run == place].reshape(1, -1))**2)
                         for place, run in enumerate(self.beside.runs)))

    def _seen(self, place: int, rows: Floats) -> tuple[Floats, Floats]:
        """Return displacements (k, 3 n) of one run, weighted, and what unknowns and effects take of them, (k, rank)."""
        (mix, transposed), own = self._normal, np.repeat(self.model.run == place, 3)
        taken, weighted = (transposed[:, own] @ rows.T).T @ mix[self.model.free], self._weighted_of(place, rows)
        if len(self._rows):
            across = weighted @ self._rows[:, own].T - taken @ self._taken.T
            taken = np.hstack([taken, across @ self._extended.T])
        return weighted, taken

    def look(self, place: int, offset: float, columns: Floats) -> tuple[Floats, Floats]:
        """Return E E' (b, q, q) and E r (b, q), m^2, of displacements (b, q, N, 3) of one run: E is what unknowns and
        effects leave of them, in white coordinates, r the residual; offset: of the axes of the columns against those of
        the runs, rad."""
        shape = columns.shape[:2]
        rows = rotate_z(offset, columns).reshape(shape[0] * shape[1], -1)
        weighted, taken = self._seen(place, rows)
        told = weighted @ self.residual[self.model.run == place].ravel()
        rows, weighted, taken = (one.reshape(*shape, -1) for one in (rows, weighted, taken))
        return rows @ np.swapaxes(weighted, 1, 2) - taken @ np.swapaxes(taken, 1, 2), told.reshape(shape)

    def share(self, place: int, rows: Floats) -> float:
        """Return which share of displacements (k, 3 n) of one run the unknowns leave, 0 to 1."""
        weighted, taken = self._seen(place, rows)
        full = float(np.sum(rows * weighted))
        return float(np.sqrt(max(1 - np.sum(taken**2) / full, 0.0))) if full else 0.0

    def shifted(self, place: int, columns: Floats) -> Floats:
        """Return what displacements (k, 3 N) of the readings of one run do to `curves`, (k, c)."""
        return np.asarray(self._seen(place, columns)[1] @ self.mix_of_curves.T)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the residual."""
        return 3 * self.model.size - int(self.rank) - self.beside.moments

    def _in_gauge(self, values: Floats) -> Floats:
        """Return unknowns, (q,) or (q, k), brought into the gauge."""
        for place, _, move, measure in self._fixes:
            values = values - move @ (measure @ values[place])
        return values


def _gauge(model: JointModel, hidden: Floats) -> Any:
    """Yield place, rank, move (q, k) and measure (k, g) of each group of unknowns that is made least in turn.

    A calibrated plate was put on anywhere, the CMM is nearly right: a turn of both is one of the plate.
    """
    is_known = not model.free[model.groups['plate']].all()
    for place in (model.groups[name] for name in (
            'curves', 'frame', *(('cmm', 'placement') if is_known else ('placement', 'cmm')), 'plate')):
        part = hidden[place]
        left, size, right = np.linalg.svd(part, full_matrices=len(part) < part.shape[1])  # right must be complete
        count = int(np.sum(size > HIDDEN_PART))
        yield place, count, hidden @ (right[:count].T / size[:count]), left[:, :count].T
        hidden = hidden @ right[count:].T


def _known_together(model: JointModel, hidden: Floats, gone: Floats) -> Floats:
    """Return what to take out of curves beside the hidden directions, orthonormal (g, k); gone: these in curves.

    A few readings that join two runs may tell the sum of two means but neither of them: hidden is their difference, and
    the least curves would share out the sum. So a mean or a once-per-turn part goes wholly where a hidden direction
    changes it: where that is the same in several sets, what they have in common, else that of each set.
    """
    parts = np.zeros((10, len(model.sets), len(hidden)))
    sizes = np.zeros((10, len(model.sets), hidden.shape[1]))
    for number, one in enumerate(model.sets):
        c, s = np.cos(one.angle), np.sin(one.angle)
        of_set = np.zeros((10, one.angle.size, 6))
        of_set[range(6), :, range(6)] = 1.0
        for place, axis in ((6, 0), (8, 3)):  # eccentricity and tilt, along x and y of the table
            of_set[place, :, axis], of_set[place, :, axis + 1] = c, s
            of_set[place + 1, :, axis], of_set[place + 1, :, axis + 1] = -s, c
        parts[:, number, one.place] = of_set.reshape(10, -1) / np.sqrt(one.angle.size)
        sizes[:, number] = np.linalg.pinv(parts[:, number, one.place].T) @ hidden[one.place]
    found = []
    for part, size in zip(parts, sizes, strict=True):
        left, value, _ = np.linalg.svd(size, full_matrices=False)
        found.append(part.T @ left[:, value > HIDDEN_PART])
    every = np.concatenate(found, axis=1)
    left, value, _ = np.linalg.svd(every - gone @ (gone.T @ every), full_matrices=False)
    return np.asarray(left[:, value > HIDDEN_PART])
