# SPDX-License-Identifier: Apache-2.0
"""Explanations as fits: of all that is claimed, of each likely hypothesis, and the curves over them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rosette_ros.core.diagnosis.base_terms import f_test
from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.moments import moments_of
from rosette_ros.core.diagnosis.run_search import RunSearch, with_places
from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.sight.limits import LISTED
from rosette_ros.core.uncertainty.mixture import total

Explained = tuple[tuple[float, Fit], ...]
"""Fits of explanations, each with its probability."""


def explained_fits(search: RunSearch) -> Explained:
    """Return the likely explanations, up to 95 % together, each with its probability and fit, best first."""
    posterior, out = search.posterior, list[tuple[float, Fit]]()
    for one in posterior.explanations():
        if one.probability < LISTED and out:
            break
        try:
            out.append((one.probability, with_places(search.base, posterior.places((one.members, one.noise)))))
        except NotDeterminable:
            continue
    return tuple(out)


def over_all(final: Fit, explained: Explained) -> Fit:
    """Return a fit with the curves over all explanations: mean and variance of the mixture."""
    if not explained:
        return final
    p, fits = zip(*explained)
    values, u = (np.stack([getattr(one.error_motions, name) for one in fits]) for name in ('values', 'u'))
    values, u = total(np.array(p) / sum(p), values, u)
    return replace(final, error_motions=replace(final.error_motions, values=values, u=u), explanations=explained)


def fitted_effects(search: RunSearch, final: Fit, claimed: Sequence[MissingEffect]) -> tuple[MissingEffect, ...]:
    """Return what a model lacks as it is fitted: base terms, then effects, the one that explains most first.

    final: the fit with all that is claimed; claimed: effects that it has beyond the model as given, in its order."""
    start, absent = search.start, search.absent
    if not (absent or claimed):
        return ()
    known = len(start.effects)
    errors = [start.rms] * bool(absent) + nested_rms(final, known)
    errors[0], errors[-1] = start.rms, final.rms

    p = min(f_test(start, search.base) * (2**len(absent) - 1), 1.0)
    out = [MissingEffect(name, before=errors[0], after=errors[1], p=p, is_there=1 - p) for name in absent]
    for place, one in enumerate(claimed):
        fitted, step = final.effects[known + place], place + bool(absent)
        out.append(replace(one, parameters=fitted.parameters, moments=moments_of(final, known + place),
                           before=errors[step], after=errors[step + 1], time_unit=final.run.time_unit))
    return tuple(out)


def nested_rms(final: Fit, known: int) -> list[float]:
    """Return the rms of the residual with the first `known` effects of a model, with one more, ... with all, m."""
    joint, run = final.joint, final.run
    size = 3 * run.size
    moved = sum((one.displacement for one in final.effects), np.zeros_like(final.residual))
    left = joint.space.residual((final.residual + moved)[None]).reshape(size)

    pairs = [(term.effect, one.setting) for term, one in zip(final.model.terms, final.effects)]
    widths = [len(effect.amplitudes(run, setting)) for effect, setting in pairs]
    searched = [sum(one.kind != 'choice' for one in effect.searched) for effect, _ in pairs]
    columns, used = (np.cumsum([0, *counts]) for counts in (widths, np.add(widths, searched)))

    basis = np.linalg.qr(joint.space.residual(joint.columns).reshape(-1, size).T).Q
    falls = np.concatenate([[0.0], np.cumsum((left @ basis)**2)])
    rss, dof = np.maximum(left @ left - falls[columns], 0.0), final.dof + used[-1] - used
    return [float(one) for one in np.sqrt(rss / dof)[known:]]


def not_needed(start: Fit) -> tuple[str, ...]:
    """Return the effects of a model without which the residual rises by no more than chance."""
    out, terms = [], start.model.terms
    for place, term in enumerate(terms):
        rest = (*terms[:place], *terms[place + 1:])
        settings = (*start.settings[:place], *start.settings[place + 1:])
        without = fit(start.run, replace(start.model, terms=rest, repeated=True), settings, start.noise,
                      start.joint.space)
        if f_test(without, start) > LISTED:
            out.append(str(term))
    return tuple(out)
