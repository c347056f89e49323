# SPDX-License-Identifier: Apache-2.0
"""What explains a run: sets of effects, unnamed motions and kinds of noise, each with its probability."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rosette_ros.core.diagnosis.diagnosis import NOISELESS
from rosette_ros.core.diagnosis.parameter_search import RELINEARISED, choose_settings
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import FREE, TIMES
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.evidence.bank import Bank, CoordinateSpace, families_of
from rosette_ros.core.evidence.hypotheses import Search
from rosette_ros.core.evidence.log_evidence import Cause, Evidence, with_priors
from rosette_ros.core.evidence.noise_hypotheses import choose
from rosette_ros.core.evidence.posterior import ALIKE, CLAIM, Claim, Posterior
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.records import Run

HOPEFUL = 12
"""Sets of variables whose free courses are looked at under other noise: those that explain most in white noise."""


@dataclass(frozen=True)
class Explanation:
    """A hypothesis: its members, names or the variables of what has no name, its kinds of noise, its probability."""

    members: tuple[str, ...]
    noise: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Unnamed:
    """Something that the library has no name for: which body moves along what, and with what.

    alternatives: sets of variables that this run cannot tell apart, the likeliest first; setting: of its free course.
    """

    alternatives: tuple[frozenset[str], ...]
    motion: str
    setting: Setting
    probability: float


@dataclass(frozen=True, eq=False)
class Explained:
    """What explains a run beside a model.

    fit: of the model as given, final: with all that is claimed, under the noise of the best hypothesis; claims, terms:
    names that are likely enough, likeliest first, and their effects; doubtful: names of the best hypothesis that are
    not; unnamed: what has no name; explanations: at least up to 95 % together; posterior: of all hypotheses.
    """

    fit: Fit
    final: Fit
    claims: tuple[Claim, ...]
    terms: tuple[Term, ...]
    doubtful: tuple[Claim, ...]
    unnamed: tuple[Unnamed, ...]
    explanations: tuple[Explanation, ...]
    posterior: Posterior


def explain(run: Run, model: Model | None = None) -> Explained:
    """Return what explains a run beside a model (the base model if none is given).

    The same run gives the same answer. Raises NotDeterminable where the run does not determine the model.
    """
    model = model or Model()
    settings = choose_settings(run, model)
    base = fit(run, model, settings)
    if base.rms < NOISELESS:
        posterior = Posterior({((), ()): 0.0})
        return Explained(base, base, (), (), (), (), (Explanation((), (), 1.0),), posterior)
    bank = Bank(run, with_priors(families_of(run)))
    for _ in range(RELINEARISED):  # with the second-order terms of what is found
        search = Search(_evidence(base, bank))
        named = [one for one in search.best().members if not one.family.is_free]
        beyond = _with(base, named).beyond if named else base.beyond
        if np.abs(beyond - base.beyond).max() <= NEGLIGIBLE:
            break
        base = fit(run, model, settings, beyond=beyond)
    few = cache(lambda: Bank(run, search.hopeful(HOPEFUL)))

    def under(noise: Noise) -> Search:
        return Search(_evidence(fit(run, model, settings, noise, beyond=base.beyond), few()))

    choice = choose(search, base, under)
    best = base if choice.noise.is_white else fit(run, model, settings, choice.noise, beyond=base.beyond)
    members, posterior = choice.state.members, choice.posterior
    claimed = [(one, claim) for claim in posterior.claims for one in members
               if one.name == claim.name and claim.together >= CLAIM and not _has_twin(one, members)]
    claims = tuple(dict.fromkeys(claim for _, claim in claimed))
    return Explained(
        best, _with(best, [one for one, _ in claimed]), claims,
        tuple(Term(one.family.effect, one.setting) for one, _ in claimed),
        tuple(claim for claim in posterior.claims if claim not in claims), _unnamed(posterior, members),
        tuple(Explanation(names, noise, p) for (names, noise), p in posterior.explanations()), posterior)


def _evidence(base: Fit, bank: Bank) -> Evidence:
    solved = BaseSpace(base.run, base.mean_radius, base.model.base, base.joint.whitening)
    space = CoordinateSpace(solved, base.joint.every)
    return Evidence(base.run, bank, space, base.white_residual, 3 * base.run.size - solved.rank - space.rank)


def _with(base: Fit, members: list[Cause]) -> Fit:
    """Return the joint fit of a model with members added, under its noise."""
    model = replace(base.model, terms=(*base.model.terms, *(Term(one.family.effect) for one in members)), repeated=True)
    return fit(base.run, model, (*base.settings, *(one.setting for one in members)), base.noise, base.joint.space)


def _has_twin(named: Cause, members: tuple[Cause, ...]) -> bool:
    """Return whether a free course of the same body and variable stands beside a name: its shape is not right."""
    effect = named.family.effect
    return any(FREE.variables_of(one.setting) & set(effect.variables)
               and effect.body.split(' ')[0] in one.setting.word('along') for one in members if one.family.is_free)


def _unnamed(posterior: Posterior, members: tuple[Cause, ...]) -> tuple[Unnamed, ...]:
    out = []
    for one in members:
        if one.family.is_free:
            instead = {name: p for name, p in posterior.instead(one.name).items() if name not in EFFECTS}
            likely = sorted((name for name, p in instead.items() if p > ALIKE * max(instead.values())),
                            key=lambda name: -instead[name])
            sets = dict.fromkeys(frozenset(name.replace('one ball', 'ball').split(TIMES)) for name in likely)
            out.append(Unnamed(tuple(sets), one.setting.word('along'), one.setting, sum(instead.values())))
    return tuple(out)
