# SPDX-License-Identifier: Apache-2.0
"""Curves of several runs over what may explain each of them.

A choice is one hypothesis of each run. Its probability is the product of those that the runs give by themselves, times
what its effects are worth with all runs over what they are worth in each alone: an effect that the curves of the other
runs contradict loses.
"""

from dataclasses import replace

import numpy as np

from rosette_ros.core.diagnosis.log_evidence import NEAR
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.joint.explained_runs import BesideBase, log_bf_of
from rosette_ros.core.joint.joint_solution import JointSolution
from rosette_ros.core.model.least_squares import FittedEffect
from rosette_ros.core.run.geometry import Floats

MOST_CHOICES = 300
"""Choices that are looked at, the likeliest by the runs alone."""

Choice = tuple[int, ...]


def choices_of(solution: JointSolution, sigma: float) -> dict[Choice, float]:
    """Return the probability of each choice of hypotheses, best first; sigma: of the noise, m."""
    log: dict[Choice, float] = {(): 0.0}
    for run in solution.beside.runs:
        more = {(*choice, number): before + float(np.log(one.probability)) - one.log_bf(sigma)
                for choice, before in log.items() for number, one in enumerate(run.hypotheses)}
        alone = {choice: _alone(solution.beside, choice) for choice in more}
        log = {choice: more[choice] for choice in sorted(more, key=lambda one: -alone[one])[:MOST_CHOICES]}
    for choice in log:
        chosen, columns = solution.beside.chosen(choice)
        rows = chosen[:columns]
        log[choice] += log_bf_of(rows @ solution.gram @ rows.T, rows @ solution.told, solution.beside.size(choice),
                                 sigma)
    largest = max(log.values())
    best = sorted((one for one, value in log.items() if value > largest - NEAR), key=lambda one: -log[one])
    weight = np.exp([log[one] - largest for one in best])
    return dict(zip(best, (weight / weight.sum()).tolist()))


def _alone(beside: BesideBase, choice: Choice) -> float:
    return float(sum(np.log(run.hypotheses[number].probability) for run, number in zip(beside.runs, choice)))


def by_likeliest(solution: JointSolution, sigma: float) -> BesideBase:
    """Return what runs have beside their model, by the likeliest choice of hypotheses."""
    return replace(solution.beside, choice=next(iter(choices_of(solution, sigma))))


def over_choices(solution: JointSolution, sigma: float) -> tuple[Floats, Floats]:
    """Return the curves over all choices, (c,), m, and their mix, (c, k), whose squares times sigma^2 are variances:
    those within the choices and between them (law of total variance)."""
    every = choices_of(solution, sigma)
    if len(every) == 1:
        return solution.curves, solution.mix_of_curves
    bias, rank = solution.in_curves(solution.bias), solution.base_rank
    now, means, mixes = solution.shift(solution.beside.choice), list[Floats](), [solution.mix_of_curves[:, :rank]]
    for choice, p in every.items():
        means.append(solution.curves + bias @ (solution.shift(choice) - now))
        chosen, _ = solution.beside.chosen(choice)
        mixes.append(p**0.5 * bias @ (chosen.T @ solution.root(chosen)))
    share, curves = np.array([*every.values()]), np.stack(means, axis=1)
    mean = curves @ share
    return mean, np.hstack([*mixes, np.sqrt(share) * (curves - mean[:, None]) / (sigma or 1.0)])


def fitted_effects(solution: JointSolution, sigma: float) -> tuple[tuple[FittedEffect, ...], ...]:
    """Return the effects in use of each run with the parameters that all runs give, none of what has no name; sigma: of
    the noise, m."""
    beside, rows = solution.beside, 0
    chosen, _ = beside.chosen(beside.choice)
    u = sigma * np.sqrt(np.diag(solution.cofactor))
    out = []
    for place, number in enumerate(beside.choice):
        own = list[FittedEffect]()
        for first, one in beside.placed(place, number):
            end, last = rows + len(one.columns), first + len(one.columns)
            tangents = [int(np.flatnonzero(chosen[:, last + k])[0]) for k in range(len(one.tangents))]
            values = [*solution.amplitude[rows:end].tolist(), *(p.value for p in one.fitted.parameters[end - rows:])]
            errors = u[[*range(rows, end), *tangents]].tolist()
            parameters = tuple(replace(old, value=value, u=error) for old, value, error in zip(
                one.fitted.parameters, values, errors, strict=True))
            own.append(replace(
                one.fitted, parameters=parameters if one.name != FREE.name else (),
                displacement=(solution.amplitude[rows:end] @ one.columns).reshape(-1, 3)))
            rows = end
        out.append(tuple(own))
    return tuple(out)
