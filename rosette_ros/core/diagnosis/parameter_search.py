# SPDX-License-Identifier: Apache-2.0
"""Finding the searched parameters of the effects that a model already has."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.diagnosis.search import Member, Problem, Selection
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.errors import InvalidModel, NotDeterminable
from rosette_ros.core.model.least_squares import JointSpace, fit, refused_as_hidden
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.records import Floats, Run

RELINEARISED = 4
"""How often a search is made again with the second-order terms of what it found."""


def choose_settings(run: Run, model: Model, noise: Noise | None = None) -> tuple[Setting, ...]:
    """Return a Setting for each effect of a model: the best on this run, jointly, within what is fixed.

    Raises NotDeterminable where an effect cannot be judged on this run or be seen in its order, InvalidModel where a
    fixed choice is none that this run offers.
    """
    if not model.terms:
        return ()
    for term in model.terms:
        reason = term.effect.unavailable(run)
        if reason:
            raise NotDeterminable(f'{run.source}: {term.name} cannot be judged: {reason}')
        _check_choices(run, term)
    start = fit(run, Model(model.base), noise=noise)
    for _ in range(RELINEARISED):
        problems = effect_problems(run, model, start.joint, start.white_residual, start.dof)
        settings = search_settings(run, model, problems)
        beyond = fit(run, model, settings, noise, start.joint.space).beyond if problems else start.beyond
        if np.abs(beyond - start.beyond).max() <= NEGLIGIBLE:
            break
        start = fit(run, start.model, noise=noise, space=start.joint.space, beyond=beyond)
    return settings


def effect_problems(run: Run, model: Model, space: JointSpace, residual: Floats, dof: int) -> tuple[Problem, ...]:
    """Return a Problem of each effect alone, none where all is fixed; residual: white, (N, 3), m; all of the base."""
    if all(parameter.name in term.fixed for term in model.terms for parameter in term.effect.searched):
        return ()
    return tuple(Problem(run, space, residual, dof, (term.effect,), (), fixed=term.fixed) for term in model.terms)


def search_settings(run: Run, model: Model, problems: Sequence[Problem]) -> tuple[Setting, ...]:
    """Return the best Setting of each effect of a model, jointly; problems: of effect_problems."""
    if not problems:
        return tuple(term.fixed for term in model.terms)
    members: list[Member] = []
    for term, problem in zip(model.terms, problems):
        best = _best(problem, problem.select(members))
        if best is None:
            raise refused_as_hidden(run, term)
        members.append(best)
    for _ in range(2 if len(members) > 1 else 0):
        for place, problem in enumerate(problems):
            others = problem.select(members[:place] + members[place + 1:])
            members[place] = _best(problem, others) or members[place]
    return tuple(Setting(member.setting) for member in members)


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


def _best(problem: Problem, others: Selection) -> Member | None:
    """Return the best Member of a problem of one effect beside others, None where it cannot be seen."""
    children = [child for offer in problem.offers([others], allow_repeats=True)[0]
                if (child := problem.child(others, offer)) is not None]
    return max(children, key=lambda child: child.score).members[-1] if children else None
