# SPDX-License-Identifier: Apache-2.0
"""Trials hide what they say, of the strength asked for, and answers to them are judged rightly."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind import SETS, Trial, Truth, trials
from benchmarks.blind.answers import answered, determined, is_told, judged, law_judged, level_judged, truths
from benchmarks.blind.cause import BODIES, PARTS, said
from benchmarks.blind.library import COMPOSED, LIBRARY, alike, statement
from benchmarks.blind.regret import regret
from benchmarks.blind.runs import CROSSED, ORDERS, SIGMA, Plan, true_curves, visible_part
from benchmarks.blind.trial import CAUSES, NotShown, causes_of
from rosette_ros.analysis import diagnose
from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.diagnosis.verdict import Outcome, Verdict
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.words.motion_words import VARIABLES, VERBS


def hidden(kind, seed=1, strength=16.0):
    """Return run and truth of a cause in order sensitive or random."""
    return Trial('open', seed, (kind,), strength, orders=('sensitive', 'random'), causes=CAUSES).run()


def test_causes_move_the_balls_by_their_size():
    """What table, plate and CMM leave of each has a norm of 16 σ, and σ is that of the noise in the run."""
    for kind in causes_of(CAUSES):
        run, truth = hidden(kind)
        assert np.linalg.norm(visible_part(run, truth.shift)) == pytest.approx(16 * SIGMA)
        assert truth.share[0] >= 0.1 and truth.hidden == ()
    run = Trial('white', 1).run()[0]
    # 3 n² − 12 n + 13 = 301 degrees of freedom: four standard deviations of the estimate
    assert np.sqrt((visible_part(run, run.centre)**2).sum() / 301) == pytest.approx(SIGMA, rel=4 / np.sqrt(2 * 301))


def test_what_a_cause_allows_is_in_the_library_and_in_the_vocabulary():
    """A name that the library does not have could not be fair, nor a variable that nothing can tell."""
    for cause in causes_of(CAUSES).values():
        assert {*cause.right, *cause.part, *cause.family} <= set(EFFECTS)
        assert cause.body and {*cause.body} <= set(BODIES)
        assert cause.variables and frozenset().union(*cause.variables) <= set(VARIABLES)


def test_causes_act_where_they_say():
    """A cracked stem moves its ball alone; a plate bends as a saddle; a chip is under one position, from then on."""
    run, truth = hidden('soft_stem')
    moved = np.ptp(np.stack([truth.shift[run.ball == ball].std(axis=0) for ball in range(1, 13)]), axis=1) > 2 * SIGMA
    assert moved.sum() == 1
    run, truth = hidden('plate_bimetal')
    seen = visible_part(run, truth.shift)
    assert np.abs(seen[:, :2]).max() < 1e-3 * np.abs(seen).max()
    pattern = np.array([seen[run.ball == ball, 2] @ run.temperature[run.ball == ball] for ball in range(1, 13)])
    power = np.abs(np.fft.rfft(pattern - pattern.mean()))
    assert power.argmax() == 2
    run, truth = hidden('chip_on_guide', strength=40.0)
    off = np.linalg.norm(truth.shift - np.median(truth.shift, axis=0), axis=1) > 3 * SIGMA
    assert len(set(run.cmm_position[off])) == 1 and off.sum() < 12
    assert not off[run.time < run.time[off].min()].any()


def test_the_table_of_the_library_is_complete():
    """Every effect of the library once, with bodies and variables that can be told, a place beside its body too."""
    assert set(LIBRARY) == set(EFFECTS) and set(COMPOSED) - set(LIBRARY) >= set(LAWS) - set(EFFECTS)
    for name, (body, variables) in LIBRARY.items():
        assert {*body} <= set(BODIES) and frozenset().union(*variables) <= set(VARIABLES)
        assert bool(body) == bool(variables) == (name != 'outlier')
    assert {*BODIES, *PARTS} == set(VERBS) and frozenset().union(*BODIES.values()) <= set(VARIABLES)
    assert set(alike('frame_temperature')) == {'frame_temperature_lag'} and alike('table_backlash') == ()
    assert statement('frame_temperature')[1] == said('temperature', 'time')
    assert statement('plate_tilt_step')[1] == said('time', 'time + ball')
    assert 'plate_expansion_lag' in alike('plate_expansion') and 'plate_expansion_lag' not in alike('plate_soaking')


def test_a_cause_is_hidden_in_every_order():
    """Each of the causes in the six orders, a number of readings of it in the order there and back, or not shown."""
    crossed = trials(['crossed'], 1)
    assert len({(one.kinds, one.strength, one.orders) for one in crossed}) == len(crossed) == 16 * 2 * 6
    assert {one.orders[0] for one in crossed} == {*CROSSED} == {*ORDERS, 'there_and_back'}
    for trial in [one for one in crossed if one.orders == ('there_and_back',) and one.strength == 16.0][:3]:
        run, truth = trial.run()
        assert len(set(run.cells)) < run.size and truth.order == 'there_and_back'
        assert np.linalg.norm(visible_part(run, truth.shift)) == pytest.approx(16 * SIGMA)
    with pytest.raises(NotShown, match='expected an order that shows it'):
        next(one for one in crossed if one.kinds == ('oil_film',) and one.orders == ('diagonal',)).run()


def test_an_effect_left_out_is_judged_as_a_cause():
    """Its own name is not true of a run, that of an effect of the same body and variable is."""
    every = trials(['left_out'], 1)
    assert len(every) == 17 * 2 * 6 and 'outlier' not in {one.left_out for one in every}
    assert all(one.kinds == (one.left_out,) for one in every)
    truth = next(one for one in every if one.left_out == 'frame_temperature' and one.orders == ('random',)).run()[1]
    assert truth.hidden == () and truth.right == ('frame_temperature_lag',)
    assert judged(answer(claim('frame_temperature_lag')), truth, 16) == 'fair name'
    assert judged(answer(claim('frame_drift')), truth, 16) == 'wrong name'
    assert judged(answer(told=[[['temperature']]]), truth, 16) == 'right variable'


@pytest.mark.parametrize('order', ['random', 'there_and_back'])
def test_the_truth_of_the_curves_is_that_of_the_machine(order):
    """Its repeatable errors at the table positions; what is of second order stays below 0.5 nm and 0.5 nrad."""
    clean, machine = Plan(12, order, 3).measure()
    found, true = remove_gauge(true_curves(clean)), remove_gauge(machine.table_truth())
    assert found == pytest.approx(true, abs=5e-10) and np.abs(true).max(axis=0).min() > 1e-8


def test_trials_depend_on_their_name_alone():
    """The same one gives the same run, in whatever list it stands; names of a campaign differ."""
    every = trials()
    assert len({one.name for one in every}) == len(every) and 2000 <= len(every) <= 2500
    one = next(trial for trial in every if trial.set == 'pairs')
    assert one in trials(['pairs'], 3) and one not in trials(['pairs'], first_seed=2)
    run, truth = one.run()
    again, same = pickle.loads(pickle.dumps(one)).run()
    assert run == again and np.array_equal(truth.shift, same.shift) and set(truth.hidden) == set(one.kinds)
    with pytest.raises(ValueError, match='expected some of white, .* found grey'):
        trials(['grey'])
    assert {trial.set for trial in every} == set(SETS)


def claim(effect, *look_alikes, reading=None):
    """Return a claim as a record has it."""
    setting = {} if reading is None else {'reading': float(reading)}
    return {'effect': effect, 'setting': setting, 'look_alikes': list(look_alikes)}


def answer(*claims, told=None):
    """Return an answer of claims, or that tells variables."""
    return {'claims': list(claims), 'unexplained': told is not None, 'told': told or []}


TRUTH = Truth('random', ('frame_drift', 'plate_slip'), (), (), np.zeros((1, 3)), np.zeros((12, 6)))
CAUSE = replace(TRUTH, hidden=(), part=('frame_step',), family=('frame_drift',),
                variables=said('travel', 'time + ball'))
OUTLIER = replace(TRUTH, hidden=('outlier',), readings=(5, 9), stray=(9,))


@pytest.mark.parametrize(('truth', 'given', 'left', 'wanted'), [
    (TRUTH, answer(claim('plate_slip'), claim('frame_drift')), 0, 'right'),
    (TRUTH, answer(claim('frame_step', 'plate_slip'), claim('frame_drift')), 0, 'right'),
    (TRUTH, answer(claim('plate_slip'), claim('plate_slip')), 0, 'incomplete'),
    (TRUTH, answer(claim('plate_slip')), 0, 'incomplete'),
    (TRUTH, answer(claim('plate_slip'), claim('frame_step')), 0, 'wrong name'),
    (TRUTH, answer(told=[[['time']]]), 0, 'nothing'),
    (OUTLIER, answer(claim('outlier', reading=5)), 0, 'right'),
    (OUTLIER, answer(claim('outlier', reading=9), claim('outlier', reading=5)), 0, 'right'),
    (OUTLIER, answer(claim('outlier', reading=6)), 0, 'wrong name'),
    (replace(OUTLIER, hidden=()), answer(claim('outlier', reading=9)), 0, 'right'),
    (replace(TRUTH, hidden=()), answer(claim('frame_drift')), 0, 'wrong name'),
    (CAUSE, answer(claim('frame_step')), 9, 'fair name'),
    (CAUSE, answer(claim('frame_drift')), 9, 'wrong name'),
    (CAUSE, answer(claim('frame_drift')), 3, 'fair name'),
    (CAUSE, answer(claim('frame_cycle', 'frame_step')), 9, 'fair name'),
    (CAUSE, answer(claim('frame_step'), claim('outlier', reading=3)), 3, 'wrong name'),
    (CAUSE, answer(told=[[['temperature'], ['travel']]]), 16, 'right variable'),
    (CAUSE, answer(told=[[['time']]]), 16, 'other'),
    (CAUSE, answer(told=[]), 16, 'other'),
    (CAUSE, answer(), 16, 'nothing'),
])
def test_answers_are_judged(truth, given, left, wanted):
    """Sets of names with look-alikes; names of a family only where they describe the cause; variables."""
    assert judged(given, truth, left) == wanted


def test_a_claim_is_true_by_its_own_name():
    """A look-alike does not make its probability true, and an outlier is one reading."""
    assert truths([claim('frame_step', 'plate_slip'), claim('frame_drift')], TRUTH, 0) == [False, True]
    assert truths([claim('outlier', reading=5), claim('outlier', reading=6), claim('outlier')], OUTLIER, 0) == [
        True, False, False]


@pytest.mark.parametrize(('told', 'wanted'), [
    ([[['table angle', 'ball']]], True), ([[['CMM position', 'ball']]], True), ([[['ball']]], False),
    ([[['table angle', 'ball', 'time']]], False), ([[['ball'], ['ball', 'table angle']]], True), ([], False),
    ([[['ball', 'table angle']], [['time']]], False)])
def test_what_is_told_has_to_be_all_and_nothing_else(told, wanted):
    """Of table angle, ball and CMM position two tell the third."""
    assert is_told(told, said('table angle + ball')) is wanted


def level(motion, *variables, law=None):
    """Return a level of an answer."""
    return {'motion': motion, 'variables': [one.split(' + ') for one in variables], 'law': law}


TILT = replace(CAUSE, body=('table axis tilting',), variables=said('time'))
BALL = replace(CAUSE, body=('plate',), variables=said('ball + table angle'))


@pytest.mark.parametrize(('truth', 'given', 'wanted'), [
    (TILT, level('table axis tilting', 'temperature', 'time'), 'complete'),
    (TILT, level('table axis tilting', 'travel'), 'wrong'),
    (TILT, level('plate tilting', 'time'), 'wrong'),
    (TILT, level('frame along z', 'time + CMM position'), 'complete'),
    (TILT, level('frame along z', 'time'), 'wrong'),
    (TILT, level('table axis tilting', 'time + ball'), 'wrong'),
    (BALL, level('plate along its x and y', 'ball + CMM position'), 'complete'),
    (BALL, level('plate along its x and y', 'ball'), 'part'),
    (BALL, level('plate along its x and y', 'time'), 'wrong'),
    (BALL, level('plate growing', 'ball + table angle'), 'complete'),
    (BALL, level('table axis tilting', 'ball'), 'complete'),
    (BALL, level('table axis tilting', 'time'), 'wrong'),
    (BALL, level('plate tilting', 'ball'), 'wrong'),
    (TRUTH, level('frame along x', 'time'), 'complete'),
    (TRUTH, level('plate along its x and y', 'time', law='plate_slip'), 'complete'),
    (TRUTH, level('plate along its x and y', 'travel', law='plate_slip'), 'wrong'),
    (TRUTH, level('plate along its z', 'time + table angle'), 'complete'),
    (TRUTH, level('scales and squareness of the CMM', 'time'), 'wrong'),
    (OUTLIER, level('frame along x', 'time', law='outlier'), 'complete'),
    (TRUTH, level('frame along x', 'time', law='outlier'), 'wrong'),
])
def test_levels_are_judged(truth, given, wanted):
    """Body and one alternative of the variables, all or a part; a displacement of frame or plate with the place of a
    tilt, turn or growth says the same."""
    assert level_judged([given], truth) == [wanted]


def test_variables_that_determine_each_other_are_the_same():
    """In a row the time is the table angle: with the place, any two of these are what time and ball are; where nothing
    determines the other they are not."""
    given, truth = level('plate', 'CMM position + time'), replace(BALL, variables=said('ball + time'))
    row, random = (determined(planned_run(plan(12, order, 1), 0.18)) for order in ('row', 'random'))
    assert {'table angle', 'temperature'} <= row['time'] and 'ball' not in row['time'] | row['touches']
    assert 'travel' in random['time'] and not random['table angle'] | random['ball']
    assert level_judged([given], truth, row) == ['complete'] and level_judged([given], truth, random) == ['wrong']
    assert level_judged([level('plate', 'CMM position')], truth, row) == ['part']


def test_laws_are_judged_as_names():
    """Hidden or fair, of a family only where it describes the cause; no law is neither."""
    laws = [level('frame along x', 'time', law=one) for one in ('frame_step', 'frame_drift', None, 'outlier')]
    assert law_judged(laws, CAUSE, 9) == [True, False, None, False]
    assert law_judged(laws, CAUSE, 3) == [True, True, None, False]
    assert law_judged(laws, TRUTH, 9) == [False, True, None, False]


def test_a_diagnosis_is_read_with_its_probabilities():
    """Claims, explanations and the variables of what has no name."""
    claim = MissingEffect('frame_drift', Setting(axes='x'), alternatives=(('frame_cycle', 0.1),), is_there=0.9)
    of_ball = Cause((), ('frame',), (('travel',), ('ball',)), 0.7)
    new = SimpleNamespace(
        claimed=[claim], unexplained=True, verdict=Verdict(Outcome.UNNAMED),
        final=SimpleNamespace(rms=1e-7), probability_of_nothing=0.01, probability_of_unnamed=0.2,
        unnamed=(MissingEffect('free', cause=of_ball),), causes=(),
        explanations=(SimpleNamespace(members=('frame_drift',), noise=('white',), probability=0.9),))
    said_now = answered(new)
    assert said_now['told'] == [[['ball', 'travel']]] and said_now['claims'][0]['probability'] == 0.9
    assert said_now['levels'] == []
    laws = (('frame_drift',), 0.6), ((), 0.3)
    place = SimpleNamespace(name='frame_drift', is_free=False), {}
    new.causes = (Cause((place,), ('frame',), (('time', 'travel'), ('ball',)), 0.9, laws),)
    new.claimed = [replace(claim, cause=new.causes[0])]
    level, = answered(new)['levels']
    assert level.pop('text').startswith('the probe moves with ')
    assert level == {
        'motion': 'frame', 'motions': ('frame',), 'variables': [['ball', 'time'], ['ball', 'travel']],
        'probability': 0.9, 'law': 'frame_drift', 'law_probability': 0.6, 'law_certain': False,
        'laws': [{'effect': 'frame_drift', 'probability': 0.6}, {'effect': None, 'probability': 0.3}]}
    assert said_now['explanations'] == [{'members': ['frame_drift'], 'noise': 'white', 'probability': 0.9}]


def test_an_effect_is_named_in_a_run_of_its_own():
    """A slip of 12 σ: named, nothing of it is left, and the curves lie within U at most points."""
    trial = Trial('library', 1, ('plate_slip',), 12.0, orders=('interleaved',), n=8)
    run, truth = trial.run()
    record = trial.judge(diagnose(run), truth)
    assert record['judged'] == 'right' and record['left'] < 4 and record['claims'][0]['true']
    assert np.mean(record['covered']) > 0.8 and record['order'] == 'interleaved'
    assert np.abs(rotate_z(-run.phi, truth.shift)).max() > SIGMA


def test_two_effects_are_found_of_which_neither_is_worth_much_alone():
    """A warm-up, or a drift along a curve, and what follows the temperature, in an order that measures one ball after
    the other: what is hidden is worth no more than what was visited."""
    trial, = trials(['pairs'], seeds=1, first_seed=5019)
    run, truth = trial.run()
    found, posterior = diagnose(run), search_of(run).posterior
    assert trial.judge(found, truth)['judged'] == 'right' and regret(run, truth.hidden) < 0.1
    both, *alone = (posterior.log_evidence((tuple(sorted(names)), ())) - posterior.log_evidence(((), ()))
                    for names in (truth.hidden, *zip(truth.hidden)))
    assert both > sum(alone) + 15 and {one.bodies[0] for one in found.causes} == {'frame'}
