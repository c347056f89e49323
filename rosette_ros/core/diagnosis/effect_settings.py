# SPDX-License-Identifier: Apache-2.0
"""Finding the searched parameters of the effects that a model already has."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.diagnosis.hypotheses import refined
from rosette_ros.core.diagnosis.log_evidence import ENOUGH, Evidence, Member, State
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.least_squares import Fit, fit, refused_as_hidden
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.run.errors import InvalidModel, NotDeterminable
from rosette_ros.core.run.records import Run
from rosette_ros.core.sight.bank import Bank, CauseFamily, CoordinateSpace

RELINEARISED = 4
"""How often a search is made again with the second-order terms of what it found."""


def choose_settings(run: Run, model: Model, noise: Noise | None = None) -> tuple[Setting, ...]:
    """Return a Setting for each effect of a model: the best on this run, jointly, within what is fixed.

    Raises NotDeterminable where an effect cannot be judged on this run or be seen in its order, InvalidModel where a
    fixed choice is none that this run offers.
    """
    for term in model.terms:
        reason = term.effect.unavailable(run)
        if reason:
            raise NotDeterminable(f'{run.source}: {term.name} cannot be judged: {reason}')
        _check_choices(run, term)
    settings = tuple(term.fixed for term in model.terms)
    if not is_searched(model):
        return settings
    start = fit(run, Model(model.base), noise=noise)
    evidence = evidence_of(start, Bank(run, families_of_terms(run, model)))
    for _ in range(RELINEARISED):
        settings = searched(evidence.on(start.white_residual), model)
        beyond = fit(run, model, settings, noise, start.joint.space).beyond
        if np.abs(beyond - start.beyond).max() <= NEGLIGIBLE:
            break
        start = fit(run, start.model, noise=noise, space=start.joint.space, beyond=beyond)
    return settings


def is_searched(model: Model) -> bool:
    """Return whether anything of the effects of a model is left to the search."""
    return any(parameter.name not in term.fixed for term in model.terms for parameter in term.effect.searched)


def evidence_of(fitted: Fit, bank: Bank) -> Evidence:
    """Return the Evidence of a fit under its noise."""
    space = CoordinateSpace(fitted.joint.space, fitted.joint.every)
    return Evidence(fitted.run, bank, space, fitted.white_residual, 3 * fitted.run.size - space.space.rank - space.rank)


def families_of_terms(run: Run, model: Model) -> list[CauseFamily]:
    """Return the family of each effect of a model, within what is fixed; its name is its place."""
    out = []
    for place, term in enumerate(model.terms):
        every = term.effect.settings(run) or (Setting(),)
        settings = tuple(dict.fromkeys(Setting({**setting, **term.fixed}) for setting in every))
        out.append(CauseFamily(term.effect, str(place), settings))
    return out


def searched(evidence: Evidence, model: Model) -> tuple[Setting, ...]:
    """Return the best Setting of each effect of a model, jointly; the bank of the evidence: of `families_of_terms`."""
    members: list[Member] = []
    for place, term in enumerate(model.terms):
        best = _best(evidence, members, place, term)
        if best is None:
            raise refused_as_hidden(evidence.run, term)
        members.append(best)
    before, left = np.inf, _left_by(evidence, members)
    while len(members) > 1 and evidence.dof / 2 * np.log(before / left) > ENOUGH:  # each once more beside the others
        for place, term in enumerate(model.terms):
            others = [*members[:place], *members[place + 1:]]
            members[place] = _best(evidence, others, place, term) or members[place]
        before, left = left, _left_by(evidence, members)
    return tuple(one.setting for one in members)


def _left_by(evidence: Evidence, members: Sequence[Member]) -> float:
    """Return the square sum that a fit of members leaves, no less than that of the noise that no readings lack."""
    return max(State(evidence, members).rss, evidence.least)


def _best(evidence: Evidence, others: Sequence[Member], place: int, term: Term) -> Member | None:
    """Return an effect at its best setting beside others, None where it cannot be seen."""
    state = State(evidence, others)
    offer = next((one for one in state.offers() if one.family.name == str(place)), None)
    if offer is None:
        return None
    return refined(offer, lambda one: state.fall(one.rows), term.fixed)


def _check_choices(run: Run, term: Term) -> None:
    for parameter in term.effect.searched:
        name = parameter.name
        if parameter.kind != 'choice' or name not in term.fixed:
            continue
        known = sorted({setting[name] for setting in term.effect.settings(run)})
        if term.fixed[name] not in known:
            if name == 'ball' and term.fixed[name] in range(1, run.n + 1):
                raise NotDeterminable(f'{run.source}: {term.name} cannot be judged: ball {term.fixed[name]} was not '
                                      'measured')
            some = [str(value) for value in known]
            if len(some) > 8:
                some = [*some[:3], '...', some[-1]]
            raise InvalidModel(f'{run.source}: effect {term.name}: {name}: expected one of '
                               f'{", ".join(some) or "nothing"}, found {term.fixed[name]!r}')
