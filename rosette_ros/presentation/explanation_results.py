# SPDX-License-Identifier: Apache-2.0
"""What explains a run, as tables: the causes of a verdict, and sets of effects, unnamed motions and kinds of noise."""

from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.presentation.formatting import before_after
from rosette_ros.presentation.table_format import Column, Table, column, words
from rosette_ros.words.effect_words import MEANINGS, fixed, plain_name, words_of
from rosette_ros.words.motion_words import chance, does_words, laws_words, member_words, moves_words
from rosette_ros.words.verdict_words import kind_words


def causes(verdict: Verdict) -> Table:
    """Return what a verdict says is missing, a row for each cause, the one that explains most first, then what has no
    name."""
    every = (*verdict.missing, *verdict.unnamed)
    looks = [MEANINGS[one.name].look if one.name in MEANINGS else '' for one in every]
    return Table('causes', 'Causes, the one that explains most first', (
        column('probability', 'probability', [one.probability for one in every], chance),
        words('moves', 'moving body, correlated with', map(moves_words, every)),
        column('effect', '', [one.name for one in every]),
        words('cause', 'likely laws', [laws_words(one.cause) if one.cause and one.depth else '' for one in every]),
        words('does', 'size', map(does_words, every)),
        column('rms_before_um', '', [1e6 * one.before for one in every]),
        Column('rms_after_um', 'residual std. dev.', tuple(1e6 * one.after for one in every),
               tuple(before_after(one.before, one.after) for one in every), 'µm'),
        words('check', 'possible origin', looks)))


def explanations(found: Diagnosis) -> Table:
    """Return the likeliest explanations, at least up to 95 % together."""
    every = found.explanations
    probability = tuple(one.probability for one in every)
    members = tuple(' and '.join(map(_words, one.members)) or 'nothing is missing' for one in every)
    noise = tuple(' and '.join(map(kind_words, one.noise)) or 'white and equal' for one in every)
    return Table('explanations', 'Explanations, the likeliest first', (
        Column('probability', 'probability', probability, tuple(f'{fixed(100 * p, places=1)} %' for p in probability)),
        Column('members', 'what is missing', members, members, number=False),
        Column('noise', 'noise', noise, noise, number=False)))


def _words(name: str) -> str:
    return words_of(name) if plain_name(name) else member_words(name)
