# SPDX-License-Identifier: Apache-2.0
"""Verdicts in words, from facts alone."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from rosette_ros.core.diagnosis.cause import Cause, Interval, MissingEffect
from rosette_ros.core.diagnosis.noise_facts import NoiseFacts
from rosette_ros.core.diagnosis.verdict import Outcome, Residual, Verdict
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import moving_bodies
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.model.noise import Group
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.uncertainty.stated_environment import Unseen
from rosette_ros.presentation.formatting import glued
from rosette_ros.words.effect_words import minutes_words
from rosette_ros.words.motion_words import MOVES, VERBS, chance, does_words, laws_words, missing_words, unnamed_words
from rosette_ros.words.verdict_words import HEADLINES, NOTHING_TO_DO, unexplained_words, verdict_text

PACKAGE = Path(__file__).parents[2] / 'rosette_ros'
PRIVATE = ('nearly the same', 'only weakly', 'confounded with', 'searched values', 'Judged is',
           'stands twice; remove', 'norm of the part', 'NAMED EFFECT', 'is expected;', 'Bias of the curves per',
           'ct without it', 'p (noise alone)', 'are free of:', 'No three-rosette run can know',
           'probability that it is noise', 'in the cell, or add', 'error falls', 'error rises',
           'cross-validation error', 'six errors', 'once per turn', 'peak to valley', 'U of a point', 'U of each angle',
           'deviations of the CMM', 'deviations of the plate', 'observable share', 'observable part', 'visible part',
           'visible share', 'hardly shows', 'can hardly show', 'find the cause', 'look at |', 'Where to look',
           'Place, days', 'What was calibrated', 'What is not known', 'an auditor asks', 'pages are for reading',
           'a bound, not an estimate', 'if left out', "'in rms'", 'envelope is shut', 'What was hidden',
           "'time, sequence'", 'consecutive readings are', 'takes them off', 'takes it off', 'the table does wrong',
           'most like ', 'follows the temperature', 'behind the temperature', 'between two seats',
           'until it has soaked', 'growth of the table', 'sudden shift', 'offset of a ball', 'KeyError:', 'TypeError:',
           'doubts about the readings', 'is none of a plate', 'were taken so', 'times the uncertainty of one',
           '% of its distribution, k', 'cannot tell which', 'no law of the library', 'has no name for it',
           'look at the residual maps, and check', 'not even as many again', 'in the order interleaved',
           'what moves, with what', 'drifts to and fro', 'drifts at random',
           'where σ is', ' : {100 -', 'Physical names mean')
"""Of these each interface, and the documentation, says what a metrologist says instead."""
ALIKE = (('time', 'temperature', 'touches', 'travel'),)
RUN = 'temperature, table travel and one more run alike'
BEFORE, AFTER = Residual(3.6e-7, 9.1e-8, 1e-9, 1.0), Residual(1.02e-7, 9.1e-8, 0.2, 1.0)


def unnamed(motion, *alternatives):
    """Return something without a name."""
    first, *others = map(tuple, alternatives)
    found = Cause((), (motion.partition(' along ')[0],), tuple((one,) for one in first), 0.97, or_with=tuple(others))
    return MissingEffect('free', Setting(of='time', kind='slow', along=motion), cause=found, together=0.97)


def ball(number, motion):
    """Return a ball that moves with time without a name."""
    found = Cause((), (f'ball {number}',), (('ball',), ('time',)), 0.97)
    return replace(unnamed(motion, ['time']), cause=found)


def test_what_has_no_name_is_said_by_body_and_variable():
    """Each body has its verb, each variable its words; of several alternatives none is preferred in silence."""
    assert unnamed_words(unnamed('frame along y', ['time since move'])) == (
        'the probe moves in y with the time since the last table move (97 %); its law is not in the library')
    assert unnamed_words(ball(7, 'plate along its x and y')) == (
        'ball 7 moves along its x and y with time (97 %); its law is not in the library')
    assert unnamed_words(ball(7, 'plate along its x, y and z')).startswith('ball 7 moves with time (97 %); ')
    assert unnamed_words(unnamed('plate growing', ['temperature'], ['time'])).startswith(
        'the plate grows or shrinks with the temperature, or with time (97 %); ')
    one = unnamed('table axis tilting', ['table angle', 'time'])
    verdict = Verdict(Outcome.UNNAMED, BEFORE, AFTER, unnamed=(one,))
    assert verdict_text(verdict).sentence == (
        'The table axis tilts with the table angle and time (97 %); its law is not in the library. With it the '
        'residual standard deviation falls from 0.360 to 0.102 µm (repeatability 0.0910 µm).')
    assert unexplained_words(verdict) == unnamed_words(one)


def test_what_this_run_cannot_distinguish_is_said_once():
    """What is correlated with a variable stands in one bracket; of many other sets two are said."""
    one = replace(unnamed('table axis tilting', ['time'], ['table sense'], ['encoder'], ['move size'], ['travel']))
    one = replace(one, cause=replace(one.cause, variables=(('time', 'travel', 'touches'),)))
    assert unnamed_words(one) == (
        'the table axis tilts with time (table travel and number of readings run alike), or with the sense of '
        'rotation, or with the line of the encoder, or with one of 2 more (97 %); its law is not in the library')
    text = verdict_text(Verdict(Outcome.UNNAMED, BEFORE, AFTER, unnamed=(one,), is_open=True))
    assert text.action == ('Check the cell for what changes with time, the sense of rotation, the line of the encoder '
                           'or one of 3 more; consider further readings (advise --readings).')


def test_several_motions_say_once_what_they_share():
    """What runs alike, which body is the same here, and that no law is known, once for all; and what one body does."""
    alike = ('time', 'travel', 'touches', 'temperature', 'table angle', 'cmm memory')
    bodies = ('frame', 'plate', 'plate tilting', 'table axis tilting', 'scales and squareness of the CMM')
    same = frozenset(bodies[1:])
    probe = replace(unnamed('frame along x and y', ['time']), cause=Cause((), bodies, (alike,), alike=same),
                    together=0.98)
    again = replace(unnamed('frame along z', ['table sense', 'time']),
                    cause=Cause((), bodies, (('table sense', 'move size'), alike), alike=same), together=0.94)
    turn = replace(unnamed('table or plate turning', ['time']), together=0.91,
                   cause=Cause((), ('table or plate turning', bodies[-1]), (('temperature', 'time'),), alike=same))
    sentence = verdict_text(Verdict(Outcome.UNNAMED, BEFORE, AFTER, unnamed=(probe, again, turn))).sentence
    assert sentence.startswith(
        'The probe moves (the same here: plate, plate tilting or one of 2 more) in x and y with time (temperature, '
        'table travel and 3 more run alike; 98 %), and in z with the sense of rotation (size of the last '
        'table move runs alike) and time (94 %); the table or the plate turns (the same here: CMM scales and '
        'squareness) with the temperature (91 %); their laws are not in the library. With them ')


def test_a_body_that_may_move_as_well_is_an_alternative():
    """It is not the same here; what is follows it."""
    one = replace(unnamed('frame along z', ['time']), cause=Cause(
        (), ('frame', 'plate tilting', 'table axis tilting'), (('time',),), alike=frozenset(['table axis tilting'])))
    assert moves_of(one).startswith('The probe moves (or plate tilting; the same here: table axis tilting) in z with ')


def test_a_second_statement_of_a_body_has_its_alternatives_in_its_bracket():
    """It does not begin with one."""
    probe = replace(unnamed('frame along z', ['time']), cause=Cause((), ('frame',), (('time',),)))
    again = replace(unnamed('frame along z', ['temperature']), cause=Cause((), ('frame', 'plate'), (('temperature',),)))
    said = verdict_text(Verdict(Outcome.UNNAMED, BEFORE, AFTER, unnamed=(probe, again))).sentence
    assert ', and in z with the temperature (or plate; ' in said


def moves_of(one):
    """Return the sentence of a motion without a name."""
    return verdict_text(Verdict(Outcome.UNNAMED, BEFORE, AFTER, unnamed=(one,))).sentence


def test_laws_of_one_body_and_variable_are_one_statement():
    """A second law is another one; a cause of several effects is said once, no law that is unlikely."""
    drift = MissingEffect('frame_drift', Setting(), cause=cause('frame', ALIKE, 0.99, {'frame_drift': 0.9}))
    step = MissingEffect('frame_step', Setting(), cause=cause('frame', ALIKE, 0.96, {
        'frame_step': 0.85, 'frame_cycle': 0.09, 'frame_warmup': 0.02}))
    assert verdict_text(Verdict(Outcome.NAMED, BEFORE, AFTER, (drift, drift, step))).sentence.startswith(
        f'The probe moves with time (99 %), most likely linear probe drift (90 %), and by another law ({RUN}; 96 %), '
        'most likely step in the machine coordinate system (85 %). With them the residual ')


def test_a_residual_that_stays_too_large_is_said_once():
    """How many times the repeatability it still is, in the sentence that says to what it falls."""
    still = Residual(1.6e-7, 9.1e-8, 1e-9, 1.0)
    assert verdict_text(Verdict(Outcome.NAMED, BEFORE, still, (slip(),))).sentence.endswith(
        ' from 0.360 to 0.160 µm, still 1.76 times the repeatability (p <1e−6).')


def test_why_a_likely_name_is_not_added():
    """It may be a part of what is said; alone it is not likely enough."""
    for doubtful, words in ((('table_backlash', 0.99), 'Not added, as it may be part of the motion above: backlash '
                             'of the table (99 %).'),
                            (('table_backlash', 0.6), ' Possible: backlash of the table (60 %).')):
        verdict = Verdict(Outcome.NAMED, BEFORE, AFTER, (slip(),), doubtful=(doubtful,))
        assert verdict_text(verdict).sentence.endswith(words)


@pytest.mark.parametrize(('noise', 'words'), [
    (NoiseFacts(walk=2e-7),
     'The probe wanders with time, by 0.200 µm over the run (random walk). '
     'The residual of 0.102 µm is 1.12 times the stated repeatability of 0.0910 µm (p-value of the lack-of-fit test: '
     '0.2).'),
    (NoiseFacts(worse=(('z', 2.5),), than='xy', scatter=(8e-8, 8e-8, 2e-7)),
     'The noise is not equal: standard deviations in x, y, z: 0.080, 0.080, 0.20 µm.'),
    (NoiseFacts(noisiest=(Group('ball', 5, 8),), factor=12.3),
     'Ball 5 scatters 12.3 times as much as the others. The residual of 0.102 µm is 1.12 times the stated '
     'repeatability of 0.0910 µm (p-value of the lack-of-fit test: 0.2).'),
    (NoiseFacts(1e-6, 0.9, tail='reading', tail_dof=3.0),
     'The noise is not normal: single readings are farther off than a normal distribution allows (Student, 3 degrees '
     'of freedom). The readings are rounded to 1.00 µm, which accounts for 90 % of the variance of the residual.')])
def test_noise_is_said_by_what_it_is_not(noise, words):
    """Of readings that are correlated nobody says that they show no structure."""
    sentence = verdict_text(Verdict(Outcome.NOISE, AFTER, AFTER, noise=noise)).sentence
    assert sentence.endswith(words)
    assert ('shows no structure' in sentence) == ('The model fits' in sentence) == (not (noise.walk or noise.noisiest))


def test_a_residual_above_the_repeatability_is_no_fit():
    """Where weights alone make it agree, and where neighbours are alike, nobody says that the model fits."""
    above = replace(AFTER, p_equal=0.002)
    for after, noise in ((above, NoiseFacts(worse=(('z', 2.5),), than='xy', scatter=(8e-8, 8e-8, 2e-7))),
                         (AFTER, NoiseFacts(correlation=0.3))):
        for outcome in (Outcome.NOISE, Outcome.DOUBTFUL_READINGS):
            sentence = verdict_text(Verdict(outcome, after, after, noise=noise)).sentence
            assert sentence.startswith('No missing effect is found, but the residual of 0.102 µm is 1.12 times the ')
            assert 'fits' not in sentence and 'structure' not in sentence


def cycle(name, body, period, u=5.0):
    """Return a cycle of a body with a period, s."""
    law = {name: 0.98}
    return MissingEffect(name, Setting(period=period), parameters=(Parameter('period', period, u, 's'),),
                         cause=cause(body, (('time',),), 0.995, law))


def test_motions_of_one_period_are_one_cause():
    """Bodies that move by one course with the same numbers are said together, others apart."""
    alike = (cycle('frame_cycle', 'frame', 672.0), cycle('axis_tilt_cycle', 'table axis tilting', 678.0),
             cycle('table_zero_cycle', 'table or plate turning', 682.0))
    said = verdict_text(Verdict(Outcome.NAMED, BEFORE, AFTER, alike)).sentence
    assert said.startswith(
        'The probe moves, the table axis tilts and the table or the plate turns with time (99 %), most likely by one '
        'cause, with a fixed period in time (period 11.2 min) (98 %). With them ')
    apart = (alike[0], cycle('axis_tilt_cycle', 'table axis tilting', 800.0))
    assert ' (99 %), most likely periodic tilt of the table axis (98 %). ' in verdict_text(
        Verdict(Outcome.NAMED, BEFORE, AFTER, apart)).sentence


def cause(bodies, variables, probability, laws, is_certain=False):
    """Return what moves with what; laws: title of a law, its names joined by ' + ', and its probability."""
    found = tuple((tuple(filter(None, law.split(' + '))), p) for law, p in laws.items())
    places = tuple((SimpleNamespace(name=name, is_free=False), Setting()) for name in found[0][0])
    return Cause(places, tuple(bodies.split(' and ')), variables, probability, found, is_certain)


def slip():
    """Return ball 11, that slips, or creeps."""
    sizes = tuple(Parameter(f'd_{axis}', value, 1e-8, 'm') for axis, value in zip('xyz', (1.9e-6, -1e-9, 4e-7)))
    return MissingEffect('ball_slip', Setting(ball=11, t0=2600.0), {'t0': Interval(2244.0, 2982.0, 69, 74, 0.967)},
                         cause('ball 11', (('time', 'touches'),), 0.996, {'ball_slip': 0.955, 'ball_creep': 0.041}),
                         (('ball_creep', 0.041), ('ball_rattle', 0.05)), 0.996, sizes)


def test_a_cause_says_what_it_does_by_how_much_and_when():
    """What moves with what, then the laws; a step that a run places between two readings is said so; only what is
    significant is said of its axes; what a run cannot tell apart is said once."""
    text = verdict_text(Verdict(Outcome.NAMED, BEFORE, AFTER, (slip(),), hidden=('table_backlash',)))
    assert text.sentence == (
        'Ball 11 moves with time (99 %), most likely slip of one ball (96 %). With it the '
        'residual standard deviation falls from 0.360 to 0.102 µm (repeatability 0.0910 µm).')
    assert text.limits == (
        'This run cannot distinguish slip of one ball from creep of one ball (4 %) or loose ball (5 %).',
        'This run could not have shown backlash of the table.')
    assert does_words(slip()) == (
        'ball 11 moves by 1.900 ± 0.020 µm in x, 0.400 ± 0.020 µm in z between readings 69 and 74 (37.4 to 49.7 min, '
        '97 %)')


def test_a_size_that_is_not_determined_is_said_as_that():
    """No larger than its U: no number that one could take for it."""
    vague = replace(slip(), parameters=(Parameter('dx', 2.1e-5, 3e-5, 'm'),))
    assert does_words(vague).startswith('ball 11 moves by an amount that is not determined (U = 60 µm) between')
    unknown = replace(slip(), parameters=(Parameter('dx', 2.1e-5, math.inf, 'm'),))
    assert does_words(unknown).startswith('ball 11 moves by an amount that is not determined between')
    assert minutes_words(60.0, 61.0) == '1 to 1.017 min'
    assert (chance(0.9999), chance(1e-5)) == ('99 %', '1 %')


@pytest.mark.parametrize(('one', 'wanted'), [
    (MissingEffect('plate_deviations'), 'ball centre deviations'),
    (replace(slip(), cause=replace(slip().cause, law_certain=True)), 'slip of one ball, ball 11 (96 %)'),
    (MissingEffect('outlier', Setting(reading=48), {}, cause(
        'reading 48', (('reading',),), 0.97, {'outlier': 0.97}, is_certain=True)),
     'single wrong reading, reading 48 (97 %)'),
    (MissingEffect('frame_drift', Setting(), {}, cause(
        'frame', ALIKE, 0.99, {'frame_drift': 0.61, 'frame_warmup': 0.36, 'frame_step': 0.01})),
     f'the probe moves with time ({RUN}; 99 %), most likely linear probe drift (61 %)'),
    (MissingEffect('frame_drift', Setting(), {}, cause('frame', (('time', 'travel'),), 0.99, {
        'frame_drift + frame_cycle': 0.6, '': 0.39})),
     'the probe moves with time (table travel runs alike; 99 %), most likely linear probe drift and periodic drift of '
     'the machine (60 %)'),
    (MissingEffect('frame_temperature', Setting(), {}, cause(
        'frame', (('temperature', 'time', 'travel'),), 0.99, {'frame_temperature': 0.95})),
     'the probe moves with the temperature (time runs alike; 99 %), most likely thermal drift proportional to air '
     'temperature (95 %)'),
    (MissingEffect('table_zero_drift', Setting(), {}, cause('table or plate turning', (('temperature',),), 0.99, {
        '': 0.93, 'table_zero_expansion': 0.06})),
     'the table or the plate turns with the temperature (99 %); its law is not in the library (93 %)'),
    (MissingEffect('frame_drift', Setting(), {}, cause('frame', ALIKE, 0.5, {'frame_drift': 0.5}),
                   (('table_zero_drift', 0.42),), 0.92),
     'linear probe drift (50 %), or angular drift of the table (42 %)')])
def test_what_is_missing_is_said_as_far_as_it_is_known(one, wanted):
    """Its name where the law is certain; what moves with what and the likeliest laws where that is surer than the
    names; else the names, each with its probability."""
    assert missing_words(one) == wanted


@pytest.mark.parametrize(('laws', 'wanted'), [
    ({'frame_drift': 0.61, 'frame_warmup': 0.36, 'frame_step': 0.01},
     'linear probe drift (61 %), warm-up of the machine (36 %)'),
    ({'frame_drift': 0.6, '': 0.39}, 'linear probe drift (60 %), one that is not in the library (39 %)'),
    ({'frame_step + frame_step': 0.42, 'frame_step + frame_step + frame_step': 0.26, 'frame_step': 0.25},
     'step in the machine coordinate system (2 times) (42 %), 3 times (26 %), once (25 %)')])
def test_the_likely_laws_of_a_cause_are_said_in_its_table(laws, wanted):
    """Until one of them would be claimed, none that is unlikely; in a sentence the likeliest."""
    one = cause('frame', ALIKE, 0.99, laws)
    assert laws_words(one) == wanted
    assert laws_words(one, 1) == wanted.partition(', ')[0]


def test_what_is_less_than_sure_is_suspected():
    """Its headline says so, and there is something to do; without a name, too, and beside what is surer."""
    one = replace(slip(), cause=replace(slip().cause, probability=0.8), together=0.8)
    text = verdict_text(Verdict(Outcome.SUSPECTED, BEFORE, AFTER, (one,), is_open=True))
    assert text.sentence.startswith('Ball 11 moves with time (80 %), most likely slip of one ball (96 %)')
    assert text.action == ('Eliminate the cause and repeat the measurement, or include it in the evaluation model; '
                           'consider further readings (advise --readings).')
    assert HEADLINES[text.outcome] == 'SYSTEMATIC EFFECT SUSPECTED, NOT IN THE MODEL'
    text = verdict_text(Verdict(Outcome.SUSPECTED, BEFORE, AFTER, unnamed=(unnamed('plate growing', ['time']),)))
    assert text.sentence.startswith('The plate grows or shrinks with time (97 %); its law is not in the library')
    assert text.action.startswith('Check the cell for what changes with time')
    assert text.level == 'doubtful' and text.model_fails
    both = Verdict(Outcome.UNNAMED, BEFORE, AFTER, (one,), (unnamed('plate growing', ['time']),))
    sentence = verdict_text(both).sentence  # the likeliest first
    assert sentence.startswith('The plate grows or shrinks with time (97 %)') and 'Ball 11 moves with time (80 %)' in (
        sentence)
    assert 'The plate grows or shrinks' in verdict_text(both).sentence


def test_what_is_said_twice_is_said_once():
    """Two courses of one motion with one variable are one statement, of one law."""
    one = unnamed('plate growing', ['time'])
    assert unnamed_words(one, one) == unnamed_words(one) and 'its law is' in unnamed_words(one, one)


def test_every_effect_says_what_it_does():
    """Each motion has its verb, one without a name, too."""
    assert {type(one.motion) for one in LAWS.values()} == set(MOVES)
    assert set(moving_bodies(planned_run(plan(6, 'random', 1), 0.18))) == set(VERBS)


def test_numbers_keep_their_units():
    """At the end of a line, too."""
    assert glued('from 0.36 µm to 3 % in 2 min') == 'from 0.36\u00a0µm to 3\u00a0% in 2\u00a0min'
    assert glued('U (k = 2) ± 0.3, 0.2 → 0.1') == 'U (k\u00a0=\u00a02) ±\u00a00.3, 0.2\u00a0→\u00a00.1'


def test_words_that_a_metrologist_would_not_use_are_gone():
    """From all that people read; and no shell command from studio, report and certificate."""
    read = [path for folder in ('rosette_ros', 'docs', 'config') for path in (PACKAGE.parent / folder).rglob('*')
            if path.suffix in ('.py', '.j2', '.md', '.yaml')]
    found = [(path.name, word) for path in (*read, PACKAGE.parent / 'README.md')
             for word in PRIVATE if word in path.read_text('utf-8')]
    commands = [(path.name, word) for folder in ('words', 'studio', 'presentation')
                for path in (PACKAGE / folder).rglob('*') if path.suffix in ('.py', '.j2')
                for word in ('pip install', '`rosette ', '(--identity') if word in path.read_text('utf-8')]
    assert (found, commands) == ([], [])


def test_a_verdict_says_what_u_lacks_or_has_of_what_the_order_hides():
    """In its first line; and what to do where that is most of U."""
    lacks = verdict_text(Verdict(Outcome.FITS, AFTER, AFTER, unseen=Unseen(
        '', 'ctz', 5.2e-8, 2.04e-7, 'frame_drift', 0.9)))
    assert lacks.sentence == (
        'The model fits: the residual of 0.102 µm is 1.12 times the stated repeatability of 0.0910 µm (p-value of the '
        'lack-of-fit test: 0.2) and shows no structure. U of ctz, 0.052 µm, does not contain what this order cannot '
        'show; in a laboratory environment it is 0.204 µm.')
    assert lacks.action == 'State the environment of the cell, or use the interleaved order.'
    has = verdict_text(Verdict(Outcome.FITS, AFTER, AFTER, unseen=Unseen(
        'workshop', 'crz', 3e-7, 4.4e-6, 'table_zero_drift', 0.97)))
    assert ' U contains what this order cannot show (environment: workshop). ' in has.sentence
    assert has.sentence.endswith('Most of U of crz is what this order cannot show, first of all angular drift of the '
                                 'table.')
    assert has.action == 'Use the interleaved order.'
    small = verdict_text(Verdict(Outcome.FITS, AFTER, AFTER, unseen=Unseen(
        'laboratory', 'crz', 3e-7, 3.1e-7, 'table_zero_drift', 0.1)))
    assert small.action == NOTHING_TO_DO and 'Most of U' not in small.sentence
