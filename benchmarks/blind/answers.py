# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says of a run, read from its result alone, and whether it is true."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.cause import BODIES, PARTS, Names, Variables
from benchmarks.blind.library import COMPOSED, statement
from benchmarks.blind.runs import SIGMA, visible_part
from benchmarks.blind.truth import Truth
from rosette_ros.core.effects.free import variables
from rosette_ros.core.run.records import ErrorMotions, Floats, Run, remove_gauge
from rosette_ros.presentation.json_output import levels_json
from rosette_ros.words.verdict_words import unexplained_words, verdict_text

Record = dict[str, Any]
"""One run and what was said of it, by name, as JSON has it."""
CLASSES = ('right', 'fair name', 'right variable', 'other', 'incomplete', 'nothing', 'wrong name')
"""What an answer can be judged to be.

right: the set of names is what is hidden; fair name: all names are fair for a cause; right variable: no name, but what
it depends on; other: it tells of something else without a name; incomplete: true names, but not all; nothing: all is
well; wrong name: at least one name is not true.
"""
SAID = ('wrong', 'part', 'complete')
"""What level 1 can be judged to be.

complete: its motion and one alternative of its variables are those of what is hidden; part: nothing of that is untrue,
but what is hidden depends on more; wrong: all else.
"""
DISPLACED = {'frame', 'plate'}
"""Bodies that are displaced as a whole."""
ALIKE = 4.0
"""A shape of which less than this norm is left of the cause, in σ, describes it: noise does not show the difference."""
PLACE = frozenset(('table angle', 'ball', 'CMM position'))
"""Any two of these are what all three are: the CMM position is the sum of the other two."""
LITTLE = 0.025
"""Share of the variance of a variable that another one may leave and still determines it."""


def answered(found: Any) -> Record:
    """Return what a Diagnosis says.

    told: for each thing without a name the alternatives of the variables on which it depends; levels: of each thing
    motion, variables, probability (level 1), and law, law_certain (level 2).
    """
    text = unexplained_words(found.verdict)
    told = [[sorted(one) for one in thing.driven_by] for thing in found.unnamed]
    return {
        'claims': [{'effect': one.name, 'setting': {name: value if isinstance(value, str) else float(value)
                                                      for name, value in one.setting.items()},
                    'look_alikes': list(one.look_alikes), 'probability': float(one.is_there)}
                   for one in found.claimed],
        'explanations': [
            {'members': list(one.members), 'noise': ' '.join(one.noise), 'probability': float(one.probability)}
            for one in found.explanations],
        'probability_of_nothing': float(found.probability_of_nothing),
        'probability_of_unnamed': float(found.probability_of_unnamed),
        'levels': levels_json(found),
        'unexplained': bool(found.unexplained), 'told': told, 'text': text, 'outcome': found.verdict.outcome.value,
        'sentence': verdict_text(found.verdict).sentence, 'rms': float(found.final.rms)}


def remaining(found: Any, shift: Floats) -> float:
    """Return the norm of what the claims of a Diagnosis cannot describe of a displacement (N, 3), m, in σ.

    Each claim is taken with the setting that was found and any amplitudes.
    """
    run = found.final.run
    left = visible_part(run, shift).ravel()
    columns = [np.moveaxis(term.effect.columns(run, fitted.setting), -1, 0).astype(float)
               for term, fitted in zip(found.terms, found.final.effects)]
    if columns:
        flat = visible_part(run, np.concatenate(columns)).reshape(-1, left.size).T
        flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
        left = left - flat @ np.linalg.lstsq(flat, left, rcond=1e-9)[0]
    return float(np.linalg.norm(left)) / SIGMA


def truths(claims: Sequence[Record], truth: Truth, left: float) -> list[bool]:
    """Return of each claim whether its own name is true: hidden, or fair for a cause; an outlier at its reading."""
    return [claim['setting'].get('reading') in truth.readings if claim['effect'] == 'outlier'
            else claim['effect'] in _fair(truth, left) for claim in claims]


def _fair(truth: Truth, left: float) -> set[str]:
    """Return the names that are true in a run of which the claims leave so much of what is hidden, in σ.

    Of laws that are put together those that move what moves with what it moves with, where they describe it."""
    composed = [name for name, (body, variables) in COMPOSED.items()
                if not {*body}.isdisjoint(truth.body) and not {*variables}.isdisjoint(truth.variables or ())]
    return {*truth.hidden, *truth.right, *truth.part, *((*truth.family, *composed) if left < ALIKE else ())}


def law_judged(levels: Iterable[Record], truth: Truth, left: float) -> list[bool | None]:
    """Return of each level whether its law is true, as the name of a claim is; None where it has none."""
    return [None if one['law'] is None else bool(truth.readings) if one['law'] == 'outlier'
            else {*one['law'].split(' + ')} <= _fair(truth, left) for one in levels]


def judged(answer: Record, truth: Truth, left: float) -> str:
    """Return the class of an answer, one of CLASSES; left: as of `remaining`."""
    claims = [claim for claim in answer['claims'] if not _is_stray(claim, truth)]
    true = truths(claims, truth, left)
    if truth.variables is not None:
        if claims:
            is_fair = all(own or _fair(truth, left) & {*claim['look_alikes']} for claim, own in zip(claims, true))
            return 'fair name' if is_fair else 'wrong name'
        if not answer['unexplained']:
            return 'nothing'
        return 'right variable' if is_told(answer['told'], truth.variables) else 'other'
    if _is_set(claims, true, truth.hidden):
        return 'right'
    return 'wrong name' if not all(true) else 'incomplete' if claims else 'nothing'


def _is_stray(claim: Record, truth: Truth) -> bool:
    """Return whether a claim is an outlier of the noise."""
    return claim['effect'] == 'outlier' and claim['setting'].get('reading') in truth.stray


def _is_set(claims: Sequence[Record], true: Sequence[bool], hidden: Sequence[str]) -> bool:
    """Return whether the claims are the hidden effects, each once, itself or as a look-alike."""
    return len(claims) == len(hidden) and any(
        all((claim['effect'] == kind and own) or kind in claim['look_alikes']
            for claim, own, kind in zip(claims, true, order)) for order in itertools.permutations(hidden))


def is_told(told: Iterable[Iterable[Iterable[str]]], variables: Variables) -> bool:
    """Return whether of all that is told an alternative is true, and one tells all that the cause depends on."""
    known = frozenset().union(*variables, *(PLACE for one in variables if len(one & PLACE) > 1))
    things = [[_whole(one) for one in alternatives if _whole(one) <= known] for alternatives in told]
    return bool(things) and all(things) and any(one <= whole for thing in things for whole in thing
                                                for one in variables)


def level_judged(levels: Iterable[Record], truth: Truth,
                 same: Mapping[str, frozenset[str]] | None = None) -> list[str]:
    """Return of each level 1 one of SAID.

    A wrong reading moves nothing; it is complete where one is hidden. same: what each variable determines in this run.
    """
    hidden = [statement(name) for name in truth.hidden] if truth.variables is None else [(truth.body, truth.variables)]
    return [SAID[2 * bool(truth.readings)] if one['law'] == 'outlier' else
            SAID[max((_agreement(one, *what, same or {}) for what in hidden), default=0)] for one in levels]


def determined(run: Run) -> dict[str, frozenset[str]]:
    """Return which variables each one determines in a run: along it they change by little from one value to the next.

    By the mean square of successive differences over twice the variance (von Neumann's ratio) below LITTLE; among equal
    values, all of them are compared.
    """
    known = {one.name: one for one in variables(run)}
    courses = {name: np.stack([np.cos(one.values), np.sin(one.values)]) if name in PLACE else one.values[None]
               for name, one in known.items()}
    out = {}
    for name in courses:
        order = np.lexsort((np.random.default_rng(1).random(run.size), known[name].values))
        out[name] = frozenset(other for other, values in courses.items() if other != name and np.sum(
            np.diff(values[:, order])**2) < LITTLE * 2 * run.size * np.sum(np.var(values, axis=1)))
    return out


def _closure(some: Iterable[str], same: Mapping[str, frozenset[str]]) -> frozenset[str]:
    """Return all variables that some determine, two places among them all three."""
    found = _whole(some)
    while (more := _whole(found.union(*(same.get(one, frozenset()) for one in found)))) != found:
        found = more
    return found


def _agreement(level: Record, body: Names, hidden: Variables, same: Mapping[str, frozenset[str]]) -> int:
    """Return the place in SAID of a level that states a body and its variables, or the same as a displacement.

    A ball that moves is a displacement that depends on the ball; a tilt, turn or growth one of frame or plate that
    depends on a place, too. Variables are those that are hidden where either set determines the other in the run."""
    told = [frozenset(one) | ({'ball'} if 'ball' in level else set()) for one in level['variables']]
    bodies = {one.partition(' along ')[0] for one in level.get('motions', [level['motion']])}
    bodies = bodies - PARTS | ({'scales and squareness of the CMM'} if bodies & PARTS else set())
    found = [(_closure(one, same), _closure(own, same)) for one in told for own in hidden]
    if 'ball' in level or not bodies.isdisjoint(body):
        return 2 if any(one == own for one, own in found) else int(any(one <= own for one, own in found))
    if bodies <= DISPLACED:
        return 2 * any(one == _closure(own | {place}, same) for one, own in found for part in body
                       for place in BODIES[part])
    if not DISPLACED.issuperset(body):
        return 0
    return 2 * any(_whole(one | {place}) == _whole(own) for one in told for own in hidden  # not what runs like it here
                   for part in bodies - DISPLACED for place in BODIES[part])


def _whole(variables: Iterable[str]) -> frozenset[str]:
    """Return variables, with the place where two of it are among them."""
    told = frozenset(variables)
    return told | PLACE if len(told & PLACE) > 1 else told


def within(found: ErrorMotions, truth: Floats) -> list[float]:
    """Return the share of the points of each curve that lie within U (k = 2) of the truth, (n, 6), gauge removed."""
    error = remove_gauge(found.values, found.angle) - remove_gauge(truth)
    inside: list[float] = (np.abs(error) <= 2 * found.u).mean(axis=0).tolist()
    return inside
