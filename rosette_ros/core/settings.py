# SPDX-License-Identifier: Apache-2.0
"""Finding the searched parameters of the effects that a model already has."""

from rosette_ros.core.effects.contract import Setting
from rosette_ros.core.effects.pinned import Pinned
from rosette_ros.core.errors import InvalidModel, NotDeterminable
from rosette_ros.core.fit import fit
from rosette_ros.core.model import Model
from rosette_ros.core.search import Problem


def choose_settings(run, model):
    """Return a Setting for each effect of a model: the best on this run, jointly, within what is fixed.

    Raises NotDeterminable where an effect cannot be judged on this run or not be seen in its order,
    InvalidModel where a fixed choice is none that this run offers.
    """
    if not model.terms:
        return ()
    for term in model.terms:
        reason = term.effect.unavailable(run)
        if reason:
            raise NotDeterminable(f'{run.source}: {term.name} cannot be judged: {reason}')
        _check_choices(run, term)
    start = fit(run, Model(model.base))
    return settings_for(run, model, start.joint, start.residual, start.dof)


def settings_for(run, model, space, residual, dof):
    """Return a Setting for each effect of a model that explains a residual (N, 3) best, jointly.

    space: JointSpace of the base model; dof: of the residual.
    """
    return search_settings(run, model, effect_problems(run, model, space, residual, dof))


def effect_problems(run, model, space, residual, dof):
    """Return a Problem of each effect of a model alone; arguments as of `settings_for`."""
    if all(_is_fixed(term) for term in model.terms):
        return ()
    effects = [Pinned.of(term.effect, term.fixed) for term in model.terms]
    return tuple(Problem(run, space, residual, dof, (effect,), ()) for effect in effects)


def search_settings(run, model, problems):
    """Return the best Setting of each effect of a model, jointly; problems: of effect_problems."""
    if not problems:
        return tuple(term.fixed for term in model.terms)
    members = []
    for term, problem in zip(model.terms, problems):
        best = _best(problem, problem.select(members))
        if best is None:
            raise NotDeterminable(
                f'{run.source}: {term} cannot be seen in this order of measurement: the base model '
                'takes it up whole. Remove it, or measure in another order (rosette advise)')
        members.append(best)
    for _ in range(2 if len(members) > 1 else 0):
        for place, problem in enumerate(problems):
            others = problem.select(members[:place] + members[place + 1:])
            members[place] = _best(problem, others) or members[place]
    return tuple(Setting(member.setting) for member in members)


def _check_choices(run, term):
    for parameter in term.effect.searched:
        name = parameter.name
        if parameter.kind != 'choice' or name not in term.fixed:
            continue
        known = sorted({setting[name] for setting in term.effect.settings(run)})
        if term.fixed[name] not in known:
            some = [str(value) for value in known]
            if len(some) > 8:
                some = [*some[:3], '...', some[-1]]
            raise InvalidModel(f'{run.source}: effect {term.name}: {name}: wanted one of '
                               f'{", ".join(some) or "nothing"}, got {term.fixed[name]!r}')


def _is_fixed(term):
    return all(parameter.name in term.fixed for parameter in term.effect.searched)


def _best(problem, others):
    """Return the best Member of a problem of one effect beside others, or None."""
    offers = problem.offers([others], allow_repeats=True)[0]
    if not offers:
        return None
    best = None
    for _, family, block in offers:
        member = problem.member(family.effect, family.settings[block], family.chances)
        if member is not None:
            member = problem.refine(member, others, family.chances)
            tried = problem.select((*others.members, member))
            if best is None or tried.score > best[0]:
                best = (tried.score, member)
    return best[1] if best else None
