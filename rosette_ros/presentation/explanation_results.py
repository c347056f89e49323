# SPDX-License-Identifier: Apache-2.0
"""What explains a run, as a table: sets of effects, unnamed motions and kinds of noise with probabilities."""

from rosette_ros.core.diagnosis.diagnosis import Finding
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.presentation.formatting import fixed
from rosette_ros.presentation.table_format import Column, Table


def explanations(found: Finding) -> Table:
    """Return the likeliest explanations, at least up to 95 % together."""
    every = found.explanations
    probability = tuple(one.probability for one in every)
    members = tuple(' and '.join(map(_words, one.members)) or 'nothing is missing' for one in every)
    noise = tuple(' and '.join(map(_noise_words, one.noise)) or 'white and equal' for one in every)
    return Table('explanations', 'Explanations, the likeliest first', (
        Column('probability', 'probability', probability, tuple(fixed(100 * p, places=1) for p in probability), '%'),
        Column('members', 'what is missing', members, members, number=False),
        Column('noise', 'noise', noise, noise, number=False)))


def _words(name: str) -> str:
    return f'{EFFECTS[name].plain} ({name})' if name in EFFECTS else f'a motion with {name}, without a name'


def _noise_words(kind: str) -> str:
    return {'z': 'z repeats unequally', 'axis': 'the axes repeat unequally', 'wander': 'the frame wanders',
            'reading': 'heavy tails of readings', 'coordinate': 'heavy tails of coordinates'}.get(
        kind, f'scatter differs by {kind}')
