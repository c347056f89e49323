# SPDX-License-Identifier: Apache-2.0
"""Verdicts in words, from facts alone."""

from rosette_ros.core.diagnosis.diagnosis import Unnamed
from rosette_ros.core.diagnosis.verdict import MissingEffect, Outcome, Residual, Verdict
from rosette_ros.core.effects.effect import Setting
from rosette_ros.words.effect_words import between_words, setting_words
from rosette_ros.words.verdict_words import unexplained_words, unnamed_words, verdict_text

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


def test_a_moment_is_an_interval():
    """A step that a run places between two readings is said so, in the sentence and in tables."""
    slip = MissingEffect('ball_slip', Setting(ball=11, t0=2600.0), {'t0': (2244.0, 2982.0)}, 0.99)
    text = verdict_text(Verdict(Outcome.NAMED, BEFORE, AFTER, (slip,)))
    assert text.sentence == (
        'The model lacks ball_slip (slip of one ball; ball 11, between 37.4 and 49.7 min; probability 99 %): with it '
        'the residual falls from 0.360 µm to 0.102 µm.')
    assert setting_words('ball_slip', slip.setting, (), slip.moments) == 'ball 11, t0 between 37.4 and 49.7 min'
    assert between_words(60.0, 61.0) == 'between 1 and 1.0167 min'
