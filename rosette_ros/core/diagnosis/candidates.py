# SPDX-License-Identifier: Apache-2.0
"""Effects that could be what a model lacks: what each would be worth, beside all that is claimed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rosette_ros.core.diagnosis.base_terms import f_test
from rosette_ros.core.diagnosis.cross_validation import CrossValidation, cross_validation_rms
from rosette_ros.core.diagnosis.log_evidence import Member, State
from rosette_ros.core.model.least_squares import Parameter, fit
from rosette_ros.core.run.errors import NotDeterminable

if TYPE_CHECKING:
    from rosette_ros.core.diagnosis.diagnosis import RunSearch

MOST_OTHERS = 8
"""Effects that are not claimed and are fitted to be shown."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect that could be what the model lacks.

    probability: that the run has it; p: search-wide probability that noise does as well; rms of the fit and of the
    cross-validation before and after adding it, m; delta_bic: before minus after, positive favours it; parameters: of
    the joint fit with all claimed."""

    effect: str
    setting: Mapping[str, float | str]
    probability: float
    p: float
    visible_fraction: float
    rms_before: float
    rms_after: float
    cross_validation_before: float
    cross_validation_after: float
    delta_bic: float
    parameters: tuple[Parameter, ...]
    look_alikes: tuple[str, ...]
    claimed: bool


def candidates_of(search: 'RunSearch') -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """Return the candidates: claimed ones, each beside those before it, then the best others beside all claimed; and
    the names of those that have no fit, with the reason."""
    out = [_base_candidate(search, term) for term in search.absent]
    if search.noiseless:
        return tuple(out), ()
    evidence, blocks = search.evidence, CrossValidation(search.base.joint, search.run.size)
    before = evidence.empty
    for place, ((member, claim), fitted) in enumerate(zip(search.claimed, search.claimed_effects)):
        p = search.p_of_member(search.chosen.members.index(member))
        out.append(_candidate(search, member, before, blocks, claim.probability, p, fitted.parameters, claim.alike))
        before = State(evidence, [one for one, _ in search.claimed[:place + 1]])
    known = {one.name for one, _ in search.claimed}
    offers = [one for one in before.offers(is_open=False) if one.family.name not in known][:MOST_OTHERS]
    refused = []
    for offer in offers:
        member = evidence.member(offer.family, offer.setting, offer.volume)
        if evidence.dof <= len(before.basis) + len(member.rows):
            continue
        try:
            fitted = search.with_members([*(one for one, _ in search.claimed), member]).effects[-1]
            out.append(_candidate(search, member, before, blocks, search.posterior.of(member.name),
                                  search.p(offer.gain), fitted.parameters))
        except NotDeterminable:
            refused.append((offer.family.name, 'its fit to these readings does not converge'))
    return tuple(out), tuple(refused)


def _candidate(search: 'RunSearch', member: Member, state: State, blocks: CrossValidation, probability: float, p: float,
               parameters: tuple[Parameter, ...], alike: Sequence[str] | None = None) -> Candidate:
    """Return the Candidate of a member beside a state; alike: None where it is not claimed."""
    evidence = search.evidence
    scale, size = evidence.scale, 3 * search.run.size
    residual, basis = state.extended(member.rows)
    left, used = float(residual @ residual), len(state.basis) + _searched(state.members)
    more = used + len(basis) - len(state.basis) + _searched([member])
    rms_before, rms_after = (scale * float(np.sqrt(rss / max(evidence.dof - count, 1)))
                             for rss, count in ((state.rss, used), (left, more)))
    share = min(float(np.sqrt(np.sum(member.rows**2) / max(len(member.rows), 1))), 1.0)
    return Candidate(
        member.name, dict(member.setting), probability, p, share, rms_before, rms_after,
        scale * blocks.rms(state.residual, state.basis), scale * blocks.rms(residual, basis),
        float(size * np.log(max(state.rss, 1e-300) / max(left, 1e-300)) - (more - used) * np.log(size)), parameters,
        tuple(alike or ()), alike is not None)


def _searched(members: Sequence[Member]) -> int:
    """Return how many numbers of members are searched; choices do not count."""
    return sum(one.kind != 'choice' for member in members for one in member.family.effect.searched)


def _base_candidate(search: 'RunSearch', term: str) -> Candidate:
    run, after = search.run, search.base
    before = fit(run, after.model.without_effect(term), after.settings, after.noise)
    left, rss = (each.rms**2 * each.dof for each in (after, before))
    error, error_with = cross_validation_rms(before), cross_validation_rms(after)
    size, p = 3 * run.size, min(f_test(before, after) * (2**len(search.absent) - 1), 1.0)
    return Candidate(term, {}, 1 - p, p, 1.0, before.rms, after.rms, error, error_with,
                     float(size * np.log(rss / left) - (after.rank - before.rank) * np.log(size)), (), (), True)
