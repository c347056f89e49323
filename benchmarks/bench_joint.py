# SPDX-License-Identifier: Apache-2.0
"""Several runs of one machine as one, each with a hidden effect of its own: how often U contains the true curves, and
how U compares with that of one run."""

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from benchmarks.blind.runs import ORDERS, Plan, noisy, scaled, situation, true_curves
from rosette_ros.analysis import evaluate_jointly, find
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.run.records import CURVES, Floats, Run, remove_gauge
from rosette_ros.simulation.hidden_effect import Draw
from rosette_ros.simulation.hidden_kinds import KINDS as HIDDEN
from rosette_ros.simulation.hidden_kinds import NAMED

STRENGTHS = 8.0, 16.0
"""Smallest and largest visible norm of a hidden effect, σ."""


@dataclass(frozen=True, eq=False)
class Joined:
    """Runs of one machine, alone and as one: kinds that were hidden; ratio, alone: (n, 6) deviations of the curves from
    the true ones over U of all runs, and of each, (runs, n, 6); u_ratio: (n, 6) U over the mean of that of one run."""

    kinds: tuple[str, ...]
    result: JointResult
    ratio: Floats
    alone: Floats
    u_ratio: Floats


def hidden_in(plan: Plan, kind: str, rng: np.random.Generator, strength: float, **given: object) -> Floats | None:
    """Return the displacements (N, 3), m, of a kind of effect with a visible norm in σ, drawn but for what is given;
    None where the order hides it."""
    clean, machine = plan.measure()
    drawn = HIDDEN[kind].draw(Draw(rng, 1.0, situation(clean, machine))).model_copy(update=given)
    return scaled(clean, plan.measure(drawn)[0].centre - clean.centre, strength)[1]


def hidden_run(plan: Plan, shift: Floats | float, noise: str, rng: np.random.Generator) -> tuple[Run, Floats]:
    """Return a run with displacements (N, 3), m, and noise of a kind, and its true curves, (n, 6)."""
    clean = plan.measure()[0]
    return noisy(clean, noise, rng, True, shift)[0], remove_gauge(true_curves(clean))


def drawn_runs(seed: int, n: int, count: int, noise: str, clean: bool = False
               ) -> tuple[tuple[str, ...], list[Run], Floats]:
    """Return the kinds hidden in `count` runs of a machine, the runs, and the true curves."""
    rng = np.random.default_rng([crc32(noise.encode()), n, seed])
    kinds, runs = list[str](), list[Run]()
    while len(runs) < count:
        kind = '' if clean else str(rng.choice([one for one in NAMED if one not in (*kinds, 'outlier')]))
        plan = Plan(n, str(rng.choice(ORDERS)), seed + 1)
        shift = hidden_in(plan, kind, rng, float(rng.uniform(*STRENGTHS))) if kind else 0.0
        if shift is not None:
            run, truth = hidden_run(plan, shift, noise, rng)
            kinds.append(kind)
            runs.append(run.replace(run_id=f'run {len(runs) + 1}'))
    return tuple(kinds), runs, truth


def joined(seed: int, n: int = 12, count: int = 3, noise: str = 'white', clean: bool = False) -> Joined:
    """Return `count` runs of n balls of a machine as one."""
    kinds, runs, truth = drawn_runs(seed, n, count, noise, clean)
    result = evaluate_jointly([Readings.of(run) for run in runs], {'by_sense': False})
    together = result.curves[0][1]
    alone = [find(run).final.error_motions for run in runs]
    u = np.mean([one.u for one in alone], axis=0)
    return Joined(kinds, result, (remove_gauge(together.values) - truth) / (2 * together.u),
                  np.array([(remove_gauge(one.values) - truth) / (2 * one.u) for one in alone]), together.u / u)


def main() -> None:
    """Print coverage and U of three runs with different effects of 40 machines, and with kinds of noise."""
    for noise, cells, clean in (('white', 40, False), ('white', 20, True), ('ar_0.6', 20, True), ('ar_0.6', 20, False)):
        every = [joined(seed, noise=noise, clean=clean) for seed in range(cells)]
        ratio, alone, u = (np.array([getattr(one, name) for one in every]) for name in ('ratio', 'alone', 'u_ratio'))
        inside = np.abs(ratio) <= 1
        print(f'3 runs of 12 balls, {noise} noise, {"no effect" if clean else "different effects"}, {cells} machines: '
              f'U (k = 2) contains {100 * inside.mean():.1f} % of the true points ('
              + ', '.join(f'{curve} {100 * share:.0f}' for curve, share in zip(CURVES, inside.mean(axis=(0, 1))))
              + f'), of one run {100 * np.mean(np.abs(alone) <= 1):.1f} %; U {np.mean(u):.3f} times that of one run')
