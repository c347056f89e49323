# SPDX-License-Identifier: Apache-2.0
"""The explanations of a run as fits, each with its probability: what curves and U are taken over."""

from dataclasses import replace
from functools import lru_cache

from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.records import Run

LIKELY = 0.03
"""Probability of an explanation from which on it is fitted: less likely ones are of effects that an environment has."""


@lru_cache(maxsize=2)
def explained(run: Run, model: Model) -> tuple[tuple[float, Fit], ...]:
    """Return the likely explanations of a run, up to 95 % together, each with its probability and fit, best first.

    Raises as `diagnose`."""
    search, out = search_of(run, model), list[tuple[float, Fit]]()
    base, posterior = search.base, search.posterior
    for key, p in posterior.explanations():
        if p < LIKELY and out:
            break
        places = posterior.places(key)
        of = replace(base.model, repeated=True, terms=(*base.model.terms, *(Term(one.effect) for one, _ in places)))
        try:
            out.append((p, fit(run, of, (*base.settings, *(one for _, one in places)), base.noise, base.joint.space)))
        except NotDeterminable:
            continue
    return tuple(out)
