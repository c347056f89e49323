# SPDX-License-Identifier: Apache-2.0
"""Effects that the simulated machine hides from physics of its own, and the true parameters of the library's names."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from benchmarks.blind.runs import SIGMA, Plan, machine_config, measure
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.geometry import Frame
from rosette_ros.core.model.base_space import base_space
from rosette_ros.core.model.least_squares import mean_radius
from rosette_ros.core.records import Floats, Run
from rosette_ros.simulation import Machine
from rosette_ros.simulation.hidden import KINDS, Draw, HiddenEffect, Situation

LEAST_SHARE = 0.05
"""Effects of which the order shows less are not observable."""
LEAST_VISIBLE = 1e-7
"""Drawn sizes are 1 µm: a norm of a few nanometres is rounding and second-order smallness, m."""


@dataclass(frozen=True, eq=False)
class Hidden:
    """What was hidden: the run without noise or effect, the table frame, and of each effect share and displacement.

    shares: what of each effect the base model does not absorb; shifts: (N, 3) each, m, of the strength asked for, None
    where the order hides one of them.
    """

    clean: Run
    frame: Frame
    machine: Machine
    shares: tuple[float, ...]
    shifts: tuple[Floats, ...] | None


def visible_part(clean: Run, shift: Floats) -> Floats:
    """Return what the base model does not absorb of a displacement, (N, 3), m."""
    return base_space(clean, mean_radius(clean)).residual(shift[None])[0].reshape(-1, 3)


def scaled(clean: Run, shift: Floats, strength: float, sigma: Sequence[float] = (1, 1, 1)
           ) -> tuple[float, Floats | None]:
    """Return the visible share of a displacement, and it scaled to a visible norm of `strength`; None if not visible.

    sigma: (3,) standard deviation of each axis in SIGMA, by which the norm is weighted.
    """
    shift = shift - shift.mean(axis=0)
    visible = visible_part(clean, shift)
    share = float(np.linalg.norm(visible) / np.linalg.norm(shift)) if shift.any() else 0.0
    if share < LEAST_SHARE or np.linalg.norm(visible) < LEAST_VISIBLE:
        return share, None
    return share, shift * strength * SIGMA / np.linalg.norm(visible / sigma)


def situation(machine: Machine, clean: Run) -> Situation:
    """Return the situation of a run that a machine has just measured."""
    duration = float(np.ptp(clean.time)) / 3600
    return Situation(clean.n, clean.radius, machine.time / 3600 - duration, duration, SIGMA * 1e6)


def displacement(made: Plan, clean: Run, effect: HiddenEffect) -> Floats:
    """Return by how much an effect displaces the readings of a run, alignment included, (N, 3), m."""
    config = machine_config(made.seed, made.n).changed(hidden=[effect.model_dump()])
    return measure(Machine(config), made)[0].centre - clean.centre


def hide(made: Plan, kinds: Sequence[str], strength: float, sigma: Sequence[float] = (1, 1, 1)) -> Hidden:
    """Return a run that hides one effect of each kind, each of a visible norm of `strength` σ."""
    machine = Machine(machine_config(made.seed, made.n))
    clean, frame = measure(machine, made)
    rng = np.random.default_rng([made.seed, made.n, 77])
    drawn = [KINDS[kind].draw(Draw(rng, 1.0, situation(machine, clean))) for kind in kinds]
    found = [scaled(clean, displacement(made, clean, effect), strength, sigma) for effect in drawn]
    shifts = tuple(shift for _, shift in found if shift is not None)
    return Hidden(clean, frame, machine, tuple(share for share, _ in found),
                  shifts if len(shifts) == len(found) else None)


def remaining(run: Run, found: Diagnosis, shift: Floats) -> float:
    """Return the norm of what the claims of a diagnosis cannot describe of a displacement (N, 3), in σ.

    Each claim is taken with the setting that was found and any amplitudes.
    """
    space = base_space(run, mean_radius(run))
    left = space.residual(shift[None]).reshape(-1)
    columns = [np.moveaxis(term.effect.columns(run, fitted.setting), -1, 0).astype(float)
               for term, fitted in zip(found.terms, found.final.effects)]
    if columns:
        flat = space.residual(np.concatenate(columns)).reshape(-1, left.size).T
        flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
        left = left - flat @ np.linalg.lstsq(flat, left, rcond=1e-9)[0]
    return float(np.linalg.norm(left)) / SIGMA


def true_parameters(run: Run, effect: Effect, setting: Setting, shift: Floats) -> dict[str, float]:
    """Return the parameters with which an effect describes a displacement (N, 3) best, by name.

    setting: as it was found; its continuous parameters are searched within their brackets. There is no noise; table,
    plate and CMM take up what they can (where the plate lay when the run began is theirs).
    """
    space = base_space(run, mean_radius(run))
    target = space.residual(shift[None]).reshape(-1)
    continuous = {name: bracket for name, bracket in effect.brackets(run, setting).items()
                  if isinstance(bracket, tuple)}

    def solve(values):
        tried = Setting({**setting, **dict(zip(continuous, values))})
        columns = np.moveaxis(effect.columns(run, tried), -1, 0)
        flat = space.residual(columns.astype(float)).reshape(len(columns), -1).T
        scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)  # a column of which nothing is seen
        amplitude = np.linalg.lstsq(flat / scale, target, rcond=1e-9)[0] / scale
        return amplitude, np.linalg.norm(target - flat @ amplitude)

    values = []
    for low, high in continuous.values():
        best = minimize_scalar(lambda value: solve([value])[1], bounds=(low, high), method='bounded',
                               options={'xatol': 1e-6 * (high - low)})
        values.append(best.x)
    names = [quantity.name for quantity in effect.amplitudes(run, setting)]
    return {**dict(zip(names, solve(values)[0])), **dict(zip(continuous, values))}


def covered(run: Run, found: Diagnosis, kinds: Sequence[str], shifts: Sequence[Floats]) -> list[bool]:
    """Return whether each parameter of each true claim of a diagnosis lies within its expanded uncertainty (k = 2)."""
    out = []
    for fitted, term in zip(found.final.effects, found.terms):
        if fitted.name not in kinds or found.missing.count(fitted.name) > 1:
            continue
        truth = true_parameters(run, term.effect, fitted.setting, shifts[kinds.index(fitted.name)])
        out += [bool(abs(one.value - truth[one.name]) <= 2 * one.u)
                for one in fitted.parameters if one.name in truth and np.isfinite(one.u)]
    return out
