# SPDX-License-Identifier: Apache-2.0
"""Runs whose truth is known: a machine that measures without noise, displacements of its readings, noise of a kind."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from benchmarks.blind.noise_kinds import Generator, Noise, Readings, draw_noise
from rosette_ros.core.run.geometry import nominal_angles, radial, rotate_z
from rosette_ros.core.run.records import Floats, Ints, Run
from rosette_ros.core.run.scheme import COMPLETE_ORDERS, Scheme, nominal_places, plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.hidden_effect import Situation, acting

SIGMA = 1e-7
"""Standard deviation of a ball-centre coordinate, m: the unit of all that is hidden."""
CHECK = 15
"""Readings of the repeatability check."""
ORDERS = COMPLETE_ORDERS
"""Orders of which one is drawn."""
CROSSED = (*COMPLETE_ORDERS, 'there_and_back')
"""Orders in all of which the same is hidden."""
LEAST_SHARE = 0.1
"""An order that shows less of a displacement hides it."""
FEWEST = 6
"""A cause of which fewer readings than about these show anything looks like wrong readings, and is not asked for."""
LEAST_VISIBLE = 1e-7
"""Drawn sizes are 1 µm: a norm of a few nanometres is rounding and second-order smallness, m."""


@dataclass(frozen=True)
class Plan:
    """What a run is made of: number of balls, order, sense of turning, seed of the machine, settings of its groups."""

    n: int
    order: str
    seed: int
    turning: str = 'forward'
    groups: tuple[tuple[str, Any], ...] = ()

    def measure(self, *effects: Any) -> tuple[Run, Machine]:
        """Return what a machine that repeats exactly measures after its alignment, and the machine.

        effects: have methods named in HOOKS, and act on it.
        """
        machine = self.machine(*effects)
        return machine.run(self.scheme), machine

    def machine(self, *effects: Any) -> Machine:
        """Return the machine before it measures; arguments as of `measure`."""
        machine = Machine(MachineConfig().changed(
            seed=self.seed, plate={'balls': self.n}, probing={'repeatability_um': 0.0}, **dict(self.groups)))
        machine._acting = acting(effects)
        return machine

    @property
    def scheme(self) -> Scheme:
        """The order in which it measures."""
        return plan(self.n, self.order, self.seed, self.turning)


def situation(clean: Run, machine: Machine) -> Situation:
    """Return the situation of a run that a machine has just measured."""
    duration = float(np.ptp(clean.time)) / 3600
    return Situation(clean.n, clean.radius, machine.time / 3600 - duration, duration, SIGMA * 1e6)


@cache
def _base(n: int, cells: bytes) -> tuple[Floats, Floats]:
    """Return what table, plate and CMM can do in the N cells of a plate of radius 1 m, given in ascending order.

    p = T_i + Θ_i × r + R_z(φ_i) P_j + M_k. An orthonormal basis (N, 3, rank) and the pseudo-inverse that gives the
    unknowns T, Θ, (2, n, 3), of displacements (N, 3): (6 n, 3 N). Cells are numbered as Run.cells.
    """
    i, j = np.divmod(np.frombuffer(cells, dtype=np.int64), n)
    unit, angle, cell = np.eye(3), nominal_angles(n), np.arange(i.size)
    out = np.zeros((i.size, 3, 4, n, 3))
    for axis in range(3):
        out[cell, :, 0, i, axis] = unit[axis]
        out[cell, :, 1, i, axis] = np.cross(unit[axis], radial(angle[i] + angle[j]))
        out[cell, :, 2, j, axis] = rotate_z(angle[i], np.broadcast_to(unit[axis], (i.size, 3)))
        out[cell, :, 3, (i + j) % n, axis] = unit[axis]
    left, size, right = np.linalg.svd(out.reshape(3 * i.size, -1), full_matrices=False)
    rank = int(np.count_nonzero(size > 1e-9 * size[0]))
    inverse = (right[:rank, :6 * n].T / size[:rank]) @ left[:, :rank].T
    return left[:, :rank].reshape(i.size, 3, rank), inverse


def _base_of(run: Run) -> tuple[Ints, Floats, Floats]:
    """Return the readings of a run in the order of their cells, (N,), and what `_base` returns of these cells."""
    order = np.argsort(run.cells, kind='stable')
    return order, *_base(run.n, run.cells[order].astype(np.int64).tobytes())


def visible_part(run: Run, shift: Floats) -> Floats:
    """Return what table, plate and CMM do not absorb of displacements (..., N, 3) of a run, same shape."""
    order, basis, _ = _base_of(run)
    basis = basis[np.argsort(order)].reshape(3 * run.size, -1)
    flat = shift.reshape(-1, basis.shape[0])
    return (flat - flat @ basis @ basis.T).reshape(shift.shape)


def true_curves(clean: Run) -> Floats:
    """Return the six curves of a run without noise, (n, 6), m and rad, in one of the gauges that it leaves."""
    order, _, inverse = _base_of(clean)
    off = clean.centre - nominal_places(clean.n, clean.radius, clean.table_position, clean.ball)
    shift, turn = (inverse @ off[order].ravel()).reshape(2, clean.n, 3)
    return np.concatenate([shift, turn / clean.radius], axis=1)


def scaled(clean: Run, shift: Floats, strength: float, fewest: int = 0) -> tuple[float, Floats | None]:
    """Return the visible share of a displacement, and it scaled to a visible norm in σ; None where the order hides it.

    shift: (N, 3), m; fewest: readings that have to show it, (Σ v²)² / Σ v⁴ of the visible lengths v.
    """
    shift = shift - shift.mean(axis=0)
    square = (visible_part(clean, shift)**2).sum(axis=1)
    visible = float(np.sqrt(square.sum()))
    share = visible / float(np.linalg.norm(shift)) if shift.any() else 0.0
    if share < LEAST_SHARE or visible < LEAST_VISIBLE or square.sum()**2 < fewest * (square**2).sum():
        return share, None
    return share, shift * strength * SIGMA / visible


def noisy(clean: Run, kind: str, rng: Generator, stated: bool, shift: Floats | float = 0.0) -> tuple[Run, Noise]:
    """Return a run of displaced readings with noise of a kind, and the noise.

    shift: (N, 3), m; stated: whether a repeatability check of CHECK readings of ball 1 before the run is stated with
    it. Readings of a kind that has a resolution are rounded, those of the check too.
    """
    pace = np.ptp(clean.time) / (clean.size - 1)
    one = np.ones(CHECK, dtype=int)
    at = Readings(clean.n, CHECK, np.concatenate([clean.time[0] - pace * np.arange(CHECK, 0, -1), clean.time]),
                  np.concatenate([one, clean.ball]), np.concatenate([one, clean.table_position]))
    noise = draw_noise(kind, at, rng)
    first = clean.centre[(clean.ball == 1) & (clean.table_position == 1)][:1]
    centre = np.concatenate([np.broadcast_to(first, (CHECK, 3)), clean.centre + shift]) + SIGMA * noise.offset
    if noise.resolution:
        step = noise.resolution * SIGMA
        centre = step * np.round(centre / step)
    run = clean.replace(centre=centre[CHECK:], repeatability=None, repeatability_dof=None)
    return (state_repeatability(run, centre[:CHECK]) if stated else run), noise


def state_repeatability(run: Run, check: Floats) -> Run:
    """Return the run with the repeatability of a check, (M, 3), m, stated; as it is where the check shows none."""
    if not np.ptp(check, axis=0).any():
        return run  # rounded to more than they scatter: nobody could state that as a repeatability
    square = np.sum((check - check.mean(axis=0))**2, axis=0)
    dof = 3 * (len(check) - 1)
    by_axis = np.sqrt(3 * square / dof).tolist()
    return run.replace(repeatability=float(np.sqrt(square.sum() / dof)), repeatability_dof=dof,
                       repeatability_axes=tuple(by_axis) if min(by_axis) > 0 else None)
