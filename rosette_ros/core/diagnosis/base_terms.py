# SPDX-License-Identifier: Apache-2.0
"""Which terms of the base model a model lacks."""

import itertools
from dataclasses import replace

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.run.records import UNLIKELY, Run


def f_test(before: Fit, after: Fit) -> float:
    """Return the probability that noise makes the square sum fall as much from one fit to one with more parameters."""
    extra, left = after.rank - before.rank, max(after.rms**2 * after.dof, 1e-300)
    if extra <= 0:
        return 1.0
    noise = max(left, after.run.rounding**2 * after.dof) / after.dof
    return float(scipy.special.fdtrc(extra, after.dof, max(before.rms**2 * before.dof - left, 0.0) / extra / noise))


def missing_base(run: Run, start: Fit) -> tuple[str, ...]:
    """Return the base terms that a model lacks and the run asks for, in order.

    Every cell has plate and CMM deviations, so an absent term needs less than an effect does: an F-test over all sets
    of absent terms, and of those that pass the best by Akaike's criterion.
    """
    model = start.model
    absent = [term for term in BASE_TERMS if term not in model.base]
    sets = [chosen for size in range(1, len(absent) + 1) for chosen in itertools.combinations(absent, size)]
    best: tuple[str, ...] = ()
    best_score, rss = 0.0, start.rms**2 * start.dof

    for chosen in sets:
        tried = fit(run, replace(model, base=(*model.base, *chosen)), start.settings, start.noise)
        score = start.dof * np.log(rss / max(tried.rms**2 * tried.dof, 1e-300)) - 2 * (tried.rank - start.rank)
        if f_test(start, tried) * len(sets) < UNLIKELY and score > best_score:
            best, best_score = chosen, score
    return best
