# SPDX-License-Identifier: Apache-2.0
"""Finding the searched parameters of the effects that a model already has."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.diagnosis.hypotheses import refined
from rosette_ros.core.diagnosis.log_evidence import Evidence, Member, State
from rosette_ros.core.diagnosis.verdict import Interval
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.run_functions import around, beside, seconds
from rosette_ros.core.model.least_squares import Fit, JointSpace, fit, refused_as_hidden
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.run.errors import InvalidModel, NotDeterminable
from rosette_ros.core.run.records import Run
from rosette_ros.core.sight.bank import Bank, CauseFamily, CoordinateSpace

RELINEARISED = 4
"""How often a search is made again with the second-order terms of what it found."""
NEAR = 60
"""So many gaps between readings to either side are asked whether a moment lies there."""
SURELY = 0.95
"""Probability of the interval in which a moment lies."""
IN_TURN = 2
"""How often each of several effects is searched again beside the others."""


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
    for _ in range(IN_TURN if len(members) > 1 else 0):
        for place, term in enumerate(model.terms):
            others = [*members[:place], *members[place + 1:]]
            members[place] = _best(evidence, others, place, term) or members[place]
    return tuple(one.setting for one in members)


def _best(evidence: Evidence, others: Sequence[Member], place: int, term: Term) -> Member | None:
    """Return an effect at its best setting beside others, None where it cannot be seen."""
    state = State(evidence, others)
    offer = next((one for one in state.offers() if one.family.name == str(place)), None)
    if offer is None:
        return None
    member = evidence.member(offer.family, offer.setting, 0.0)
    return refined(evidence, member, lambda one: state.fall(one.rows), term.fixed)


def moments_of(fitted: Fit, place: int) -> dict[str, Interval]:
    """Return where each instant of an effect lies: in the fewest gaps between readings in a row that have 95 %.

        p(gap) ~ exp(f / (2 sigma^2)),    f: fall of the square sum by the effect with the instant in the gap

    place: of the effect in the fit, whose other effects and settings stay as they are."""
    run, effect, own = fitted.run, fitted.model.terms[place].effect, fitted.effects[place]
    ends = np.cumsum([one.effect.width(run, found.setting) for one, found in zip(fitted.model.terms, fitted.effects)])
    others = JointSpace(fitted.joint.space, np.delete(fitted.joint.columns, slice(*np.append(0, ends)[place:place + 2]),
                                                      axis=0), fitted.joint.columns[:0])
    left, out = others.residual((fitted.residual + own.displacement)[None]).reshape(-1), {}
    for name, times in effect.moments(run, own.setting).items():
        middle = beside(0.5 * (times[1:] + times[:-1]), own.setting.number(name), NEAR)
        every = [Setting({**own.setting, name: float(one)}) for one in middle]
        kept = [one for one in every if 't1' not in one or one.number('t0') < one.number('t1')]
        rows = np.asarray(effect.blocks(run, kept))
        rows = others.residual(rows.reshape(-1, run.size, 3)).reshape(*rows.shape[:2], -1)
        shown = rows @ left
        fall = np.einsum('bi,bij,bj->b', shown, np.linalg.pinv(rows @ rows.swapaxes(1, 2), hermitian=True), shown)
        p = np.exp((fall - fall.max()) / (2 * max(fitted.sigma, 1e-15)**2))
        p /= p.sum()
        low = high = int(p.argmax())
        while p[low:high + 1].sum() < SURELY:
            lower = high + 1 == p.size or (low > 0 and p[low - 1] >= p[high + 1])
            low, high = (low - 1, high) if lower else (low, high + 1)
        begin, end = around(times, kept[low].number(name))[0], around(times, kept[high].number(name))[1]
        out[name] = Interval(begin, end, int(np.sum(seconds(run) <= begin)), int(np.sum(seconds(run) < end)) + 1,
                           float(p[low:high + 1].sum()))
    return out


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
            raise InvalidModel(f'{run.source}: effect {term.name}: {name}: wanted one of '
                               f'{", ".join(some) or "nothing"}, got {term.fixed[name]!r}')
