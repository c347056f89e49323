# SPDX-License-Identifier: Apache-2.0
"""What explains a run, as tables and JSON: sets of effects, unnamed motions and kinds of noise with probabilities."""

from typing import Any

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.evidence.explanation import Explained
from rosette_ros.presentation.formatting import fixed
from rosette_ros.presentation.json_output import fit_json, plain
from rosette_ros.presentation.table_format import Column, Table
from rosette_ros.words.verdict_words import chance, unnamed_words

SCHEMA = 'rosette-explanation/1'


def explanation_json(found: Explained) -> dict[str, Any]:
    """Return what explains a run, schema rosette-explanation/1."""
    return dict(plain({
        'schema': SCHEMA, 'run_id': found.fit.run.run_id, 'model': found.fit.model.names, 'fit': fit_json(found.fit),
        'missing': [{'effect': one.name, 'probability': one.probability, 'with_look_alikes': one.together,
                     'look_alikes': one.alike} for one in found.claims],
        'doubtful': [{'effect': one.name, 'probability': one.probability, 'look_alikes': one.alike}
                     for one in found.doubtful],
        'unnamed': [{'variables': [sorted(each) for each in one.alternatives], 'motion': one.motion,
                     'probability': one.probability} for one in found.unnamed],
        'explanations': [{'members': one.members, 'noise': one.noise, 'probability': one.probability}
                         for one in found.explanations],
        'probability_of_nothing': found.posterior.nothing, 'probability_of_unnamed': found.posterior.unnamed,
        'final': fit_json(found.final)}))


def explanations(found: Explained) -> Table:
    """Return the likeliest explanations, at least up to 95 % together."""
    every = found.explanations
    probability = tuple(one.probability for one in every)
    members = tuple(' and '.join(map(_words, one.members)) or 'nothing is missing' for one in every)
    noise = tuple(' and '.join(map(_noise_words, one.noise)) or 'white and equal' for one in every)
    return Table('explanations', 'Explanations, the likeliest first', (
        Column('probability', 'probability', probability, tuple(fixed(100 * p, places=1) for p in probability), '%'),
        Column('members', 'what is missing', members, members, number=False),
        Column('noise', 'noise', noise, noise, number=False)))


def sentences(found: Explained) -> tuple[str, ...]:
    """Return what is claimed, doubtful or without a name, a sentence each."""
    out = []
    for claim in found.claims:
        alike = f'; this run cannot tell it from {" or ".join(map(_words, claim.alike))}' if claim.alike else ''
        out.append(f'{chance(claim.together)}: {_words(claim.name)}{alike}.')
    for claim in found.doubtful:
        rest = f' or {_words(claim.alike[0])}' if claim.alike else ''
        out.append(f'{chance(claim.probability)}: perhaps {_words(claim.name)}{rest}.')
    out += [f'{chance(one.probability)}: {unnamed_words(one)}.' for one in found.unnamed]
    return tuple(out) or (f'{chance(found.posterior.nothing)}: nothing is missing.',)


def _words(name: str) -> str:
    return f'{EFFECTS[name].plain} ({name})' if name in EFFECTS else f'a motion with {name}, without a name'


def _noise_words(kind: str) -> str:
    return {'z': 'z repeats unequally', 'axis': 'the axes repeat unequally', 'wander': 'the frame wanders',
            'reading': 'heavy tails of readings', 'coordinate': 'heavy tails of coordinates'}.get(
        kind, f'scatter differs by {kind}')
