# SPDX-License-Identifier: Apache-2.0
"""Verdicts in words, from facts alone."""

from pathlib import Path

from rosette_ros.core.diagnosis.diagnosis import Unnamed
from rosette_ros.core.diagnosis.verdict import MissingEffect, Outcome, Residual, Verdict
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.stated_environment import Unseen
from rosette_ros.presentation.formatting import glued
from rosette_ros.words.effect_words import between_words
from rosette_ros.words.verdict_words import (
    MOVES,
    NOTHING_TO_DO,
    chance,
    does_words,
    unexplained_words,
    unnamed_words,
    verdict_text,
)

PACKAGE = Path(__file__).parents[2] / 'rosette_ros'
PRIVATE = ('nearly the same', 'only weakly', 'confounded with', 'observable share', 'searched values', 'Judged is',
           'stands twice; remove', 'norm of the part', 'NAMED EFFECT', 'is expected;', 'Bias of the curves per',
           'ct without it', 'p (noise alone)', 'are free of:', 'No three-rosette run can know')
"""Of these each interface says what the reader sees instead."""
BEFORE, AFTER = Residual(3.6e-7, 9.1e-8, 1e-9, 1.0), Residual(1.02e-7, 9.1e-8, 0.2, 1.0)


def unnamed(motion, *alternatives, of='time'):
    """Return something without a name."""
    return Unnamed(tuple(map(frozenset, alternatives)), motion, Setting(of=of, kind='slow', along=motion), 0.97)


def test_what_has_no_name_is_said_by_body_and_variable():
    """Each body has its verb, each variable its words; of several alternatives none is preferred in silence."""
    assert unnamed_words(unnamed('frame along y', ['time since move'])) == (
        'something moves the frame in y with the time since the last table move; the library has no name for it')
    assert unnamed_words(unnamed('plate along its x and y', ['time', 'ball'], of='ball 7 × time')).startswith(
        'something moves ball 7 along its x and y with time;')
    assert unnamed_words(unnamed('plate growing', ['temperature'], ['time'])).startswith(
        'something makes the plate grow or shrink with the temperature (or with time: ')
    one = unnamed('table axis tilting', ['table angle', 'time'])
    verdict = Verdict(Outcome.UNNAMED, BEFORE, AFTER, unnamed=(one,))
    assert verdict_text(verdict).sentence == (
        'Something tilts the table axis with the table angle and time; the library has no name for it '
        '(probability 97 %).')
    assert unexplained_words(verdict) == unnamed_words(one)


def test_a_cause_says_what_it_does_by_how_much_and_when():
    """A step that a run places between two readings is said so; only what is significant is said of its axes."""
    sizes = tuple(Parameter(f'd_{axis}', value, 1e-8, 'm') for axis, value in zip('xyz', (1.9e-6, -1e-9, 4e-7)))
    slip = MissingEffect('ball_slip', Setting(ball=11, t0=2600.0), {'t0': (2244.0, 2982.0)}, 0.996,
                         (('ball_creep', 0.04),), sizes)
    text = verdict_text(Verdict(Outcome.NAMED, BEFORE, AFTER, (slip,), hidden=('table_backlash',)))
    assert text.sentence == ('Missing: slip of one ball. With it the error falls from 0.360 µm to 0.102 µm '
                             '(repeatability 0.0910 µm).')
    assert text.limits == ('This run cannot tell slip of one ball from creep of one ball (4 %).',
                           'This run could not have shown backlash of the table.')
    assert does_words(slip) == 'ball 11 moves by 1.90 µm in x, 0.40 in z between 37.4 and 49.7 min'
    assert between_words(60.0, 61.0) == 'between 1 and 1.017 min'
    assert (chance(0.9999), chance(1e-5)) == ('99 %', '1 %')


def test_every_effect_says_what_it_does():
    """Each motion has its verb."""
    assert {type(one.motion) for one in EFFECTS.values()} == set(MOVES)


def test_numbers_keep_their_units():
    """At the end of a line, too."""
    assert glued('from 0.36 µm to 3 % in 2 min') == 'from 0.36\u00a0µm to 3\u00a0% in 2\u00a0min'
    assert glued('U (k = 2) ± 0.3, 0.2 → 0.1') == 'U (k\u00a0=\u00a02) ±\u00a00.3, 0.2\u00a0→\u00a00.1'


def test_words_that_a_metrologist_would_not_use_are_gone():
    """From all that people read; and no shell command from studio, report and certificate."""
    found = [(path.name, word) for path in PACKAGE.rglob('*') if path.suffix in ('.py', '.j2')
             for word in PRIVATE if word in path.read_text('utf-8')]
    commands = [(path.name, word) for folder in ('words', 'studio', 'presentation')
                for path in (PACKAGE / folder).rglob('*') if path.suffix in ('.py', '.j2')
                for word in ('pip install', '`rosette ', '(--identity') if word in path.read_text('utf-8')]
    assert (found, commands) == ([], [])


def test_a_verdict_says_what_u_lacks_or_has_of_what_the_order_hides():
    """In its first line; and what to do where that is most of U."""
    lacks = verdict_text(Verdict(Outcome.FITS, AFTER, AFTER, unseen=Unseen(
        '', 'ctz', 5.2e-8, 2.04e-7, 'frame_drift', 0.9)))
    assert lacks.sentence.startswith('The model fits, with U of ctz 0.052 µm without what this order cannot show; '
                                     '0.204 µm in a laboratory: the residual of')
    assert lacks.action == 'State the environment of the cell, or measure in the order sensitive.'
    has = verdict_text(Verdict(Outcome.FITS, AFTER, AFTER, unseen=Unseen(
        'workshop', 'crz', 3e-7, 4.4e-6, 'table_zero_drift', 0.97)))
    assert has.sentence.startswith('The model fits, with what this order cannot show in U (environment: workshop): ')
    assert has.sentence.endswith("Most of U of crz is what this order cannot show, first of all drift of the table's "
                                 'angle.')
    assert has.action == 'Measure in the order sensitive.'
    small = verdict_text(Verdict(Outcome.FITS, AFTER, AFTER, unseen=Unseen(
        'laboratory', 'crz', 3e-7, 3.1e-7, 'table_zero_drift', 0.1)))
    assert small.action == NOTHING_TO_DO and 'Most of U' not in small.sentence
