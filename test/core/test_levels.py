# SPDX-License-Identifier: Apache-2.0
"""What moves with what, as far as a run tells, and by which law: on runs whose truth is known."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.diagnosis import find
from rosette_ros.core.diagnosis.levels import causes_of, motion_of
from rosette_ros.core.diagnosis.posterior import Posterior
from rosette_ros.core.diagnosis.verdict import Level, Outcome, decide, facts_of
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import PARTS, moving_bodies, variables
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.sight.bank import families_of
from rosette_ros.core.uncertainty.error_summary import fit_lines
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.motion_words import moves_words

SIGMA = 1e-7
HIDDEN = {
    'drift': [{'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}],
    'growth': [{'kind': 'plate_expansion', 'rate_ppm_per_h': 8.0}],
    'outlier': [{'kind': 'outlier', 'shift_um': [2.0, 1.0, 0.5], 'at_h': 0.5}],
    'slip': [{'kind': 'ball_slip', 'ball': 3, 'shift_um': [1.5, 1.0, 0.5], 'at_h': 0.5}],
    'large slip': [{'kind': 'ball_slip', 'ball': 3, 'shift_um': [3.0, 2.0, 1.0], 'at_h': 0.4}],
    'step': [{'kind': 'frame_step', 'step_um': [0.0, 0.4, 0.0], 'at_h': 0.3}],
    'clear step': [{'kind': 'frame_step', 'step_um': [1.5, 1.0, 1.5], 'at_h': 0.3}],
    'reversal': [{'kind': 'cmm_reversal', 'value_um': [1.5, 1.0, 0.0]}],
    'two steps': [{'kind': 'frame_step', 'step_um': [3.0, 0.0, 2.0], 'at_h': 0.3},
                  {'kind': 'frame_step', 'step_um': [-1.0, 2.0, 0.0], 'at_h': 0.45}]}


@functools.cache
def found_in(order, name):
    """Return the Diagnosis of a run of 8 balls of the machine that hides effects."""
    config = MachineConfig().changed(seed=1, plate={'balls': 8}, hidden=HIDDEN[name])
    return find(Machine(config).run(plan(8, order, 1)))


def unnamed(probability):
    """Return a motion without a name."""
    cause = Cause((), ('plate growing',), (('time',),), probability)
    return MissingEffect('free', Setting(of='time', along='plate growing'), cause=cause, together=probability)


def place_of(run, name, **setting):
    """Return a family of a run at a setting, its first one changed."""
    family, = (one for one in families_of(run) if one.name == name)
    return family, Setting({**family.settings[0], **setting})


def test_a_drift_moves_the_frame_with_time():
    """And with what runs like time in this order; most like a drift, whose law others are near by likelihood."""
    cause, = found_in('sensitive', 'drift').causes
    assert (cause.bodies, cause.names) == (('frame',), ('frame_drift',))
    assert [some[0] for some in cause.variables] == ['time'] and frozenset(['travel']) in cause.alternatives
    assert cause.laws[0][0] == ('frame_drift',) and cause.probability > 0.95
    assert sum(p for _, p in cause.laws) == pytest.approx(cause.probability)


def test_one_ball_or_reading_is_said_by_its_number():
    """The slip of ball 3 may be a creep: the body is surer than the law. A wrong reading has one law only, but may be
    the one that a course of its ball takes at the longest way of the CMM."""
    slip, = found_in('diagonal', 'slip').causes
    assert (slip.bodies, slip.number('ball'), slip.number('reading')) == (('ball 3',), 3, None)
    assert slip.variables[0][0] == 'time' and slip.probability > 0.97 > slip.law_probability
    assert {law for law, p in slip.laws if p > 0.05} == {('ball_slip',), ('ball_creep',)} and not slip.law_certain
    for order, number, is_certain in (('diagonal', 36, True), ('random', 25, False)):
        found = found_in(order, 'outlier')
        wrong, = found.causes
        assert wrong.number('reading') == found.verdict.outliers[0].number == number
        assert wrong.bodies == (f'reading {number}',) and wrong.variables == (('reading',),)
        assert wrong.probability > 0.97 and wrong.law_certain == is_certain


def test_two_laws_that_another_one_replaces_are_one_cause():
    """Drift and warm-up, or a drift along a curve: the frame moves with time. Where no likely hypothesis has one in the
    place of both, they are two; a motion of the plate always is another one."""
    run = planned_run(plan(6, 'random', 1), 0.18)
    drift, warm, curved, warp = (place_of(run, name) for name in (
        'frame_drift', 'frame_warmup', 'frame_drift_curved', 'plate_warp'))
    both, other = (('frame_drift', 'frame_warmup', 'plate_warp'), ()), (('frame_drift_curved', 'plate_warp'), ())
    looked = {both: (5.0, (drift, warm, warp)), other: (4.5, (curved, warp)), ((), ()): (0.0, ())}
    said = {place: motion_of(run, place) for place in (drift, warm, warp)}
    frame, plate = causes_of(Posterior(looked), run, said)
    assert (frame.bodies, plate.bodies) == (('frame',), ('plate',))
    assert frame.names == ('frame_drift', 'frame_warmup') and plate.names == ('plate_warp',)
    weight = np.exp([5.0, 4.5, 0.0])
    assert dict(frame.laws) == {('frame_drift', 'frame_warmup'): pytest.approx(weight[0] / weight.sum()),
                                ('frame_drift_curved',): pytest.approx(weight[1] / weight.sum())}
    assert frame.probability == plate.probability == pytest.approx(weight[:2].sum() / weight.sum())
    looked[other] = 1.0, (curved, warp)
    assert [one.names for one in causes_of(Posterior(looked), run, said)] == [
        ('frame_drift',), ('frame_warmup',), ('plate_warp',)]


def test_variables_of_several_laws_that_run_alike_are_one_set():
    """A drift in time and a growth with the table travel, in place of which a curved drift may be: in a run that turns
    on steadily they go with time, or with what runs like it, not with a product. A warping plate goes with a product.
    """
    run = planned_run(plan(6, 'diagonal', 1), 0.18)
    drift, grown, curved, warp = (place_of(run, name) for name in (
        'frame_drift', 'table_warmup', 'frame_drift_curved', 'plate_warp'))
    grown = grown[0], next(one for one in grown[0].settings if one.get('angle') == 'turned')
    assert (motion_of(run, drift).own, motion_of(run, grown).own) == ({'time'}, {'travel'})
    both, other = (('frame_drift', 'table_warmup'), ()), (('frame_drift_curved',), ())
    looked = {both: (5.0, (drift, grown)), other: (4.5, (curved,)), ((), ()): (0.0, ())}
    cause, = causes_of(Posterior(looked), run, {place: motion_of(run, place) for place in (drift, grown)})
    (first, *others), = cause.variables
    assert first == 'time' and 'travel' in others
    looked = {(('plate_warp',), ()): (5.0, (warp,)), ((), ()): (0.0, ())}
    run = planned_run(plan(8, 'interleaved', 1), 0.1825)
    cause, = causes_of(Posterior(looked), run, {warp: motion_of(run, warp)})
    assert [some[0] for some in cause.variables] == ['time', 'ball']


def test_a_course_that_repeats_with_the_balls_may_be_of_the_ball():
    """Order diagonal measures the balls in turn: a cycle of as many readings is a function of the ball, and one of
    another period is not."""
    run, *_ = synthetic_run(8, 'diagonal', 2, noise=SIGMA)
    turn = (run.time[-1] - run.time[0]) * 8 / (run.size - 1)
    assert 'ball' in motion_of(run, place_of(run, 'frame_cycle', period=turn)).may_be
    assert 'ball' not in motion_of(run, place_of(run, 'frame_cycle', period=1.7 * turn)).may_be
    moved = np.cos(2 * np.pi * run.time / turn)[:, None] * np.array([0.0, 0.5e-6, 1e-6])
    cause, = find(run.replace(centre=run.centre + moved)).causes
    assert frozenset(['ball']) in cause.alternatives and cause.bodies == ('frame',)


def test_what_moves_the_balls_alike_is_told_together():
    """A plate that grows and scales of the CMM that shrink alike: no run tells them apart; a drift of the probe is
    neither. Of each part of the cell one motion is said, and each has a part."""
    assert moving_bodies(planned_run(plan(6, 'random', 1), 0.18)).keys() == PARTS.keys()
    cause, = found_in('random', 'growth').causes
    assert cause.bodies == ('plate growing', 'scales and squareness of the CMM') and cause.probability > 0.97


def test_what_is_less_than_sure_is_suspected():
    """Below 90 %: in doubt, with a name or without; beside something that is sure, it is what that is."""
    found = found_in('sensitive', 'drift')
    effect, = found.verdict.missing
    doubted = replace(effect, together=0.8, cause=replace(effect.cause, probability=0.8))
    one = unnamed(0.8)

    def outcome(*unnamed, missing=()):
        return decide(replace(facts_of(found.fit, found.final if missing else found.fit), missing=missing,
                              unnamed=unnamed)).outcome

    assert found.verdict.outcome == Outcome.NAMED
    assert outcome(missing=(doubted,)) == outcome(one) == outcome(one, missing=(doubted,)) == Outcome.SUSPECTED
    surer = unnamed(0.95)
    assert outcome(surer) == outcome(surer, missing=(doubted,)) == Outcome.UNNAMED
    sure = replace(doubted, cause=replace(doubted.cause, probability=0.95))
    assert outcome(one, missing=(sure,)) == Outcome.NAMED
    verdict = decide(replace(facts_of(found.fit, found.fit), unnamed=(one,)))
    assert verdict.level == Level.DOUBTFUL and verdict.model_fails


def test_curves_are_those_of_all_explanations():
    """In a row steps of the frame may be slips of the plate, which move other curves: mean and variance are those of
    all, and where one explanation is left, the curves are its own."""
    found = found_in('row', 'two steps')
    p, fits = zip(*found.with_cause.explanations)
    assert len(p) > 1 and max(p) < 0.9 and found.with_cause.explanations == found.final.explanations
    weight = np.array(p) / sum(p)
    values = np.stack([one.error_motions.values for one in fits])
    within = np.tensordot(weight, np.stack([one.error_motions.u for one in fits])**2, axes=1)
    mean, motions = np.tensordot(weight, values, axes=1), found.with_cause.error_motions
    assert motions.values == pytest.approx(mean, abs=1e-15)
    assert motions.u**2 == pytest.approx(within + np.tensordot(weight, (values - mean)**2, axes=1))
    for line, spread in zip(fit_lines(found.with_cause), motions.values.T):
        assert line.range == pytest.approx(np.ptp(spread)) and line.spread.moments == pytest.approx(
            (line.range, line.u_range**2))
    single = found_in('random', 'outlier')
    (_, alone), = single.with_cause.explanations
    assert np.array_equal(single.with_cause.error_motions.values, alone.error_motions.values)


def test_a_ball_that_surely_moves_is_said_though_not_with_what():
    """Ball 3 slips 30 times the noise, and no reading that follows tells time from the sense of the table moves: the
    ball is said, with all that it may move with."""
    found = found_in('sensitive', 'large slip')
    cause, = found.causes
    assert cause.bodies == ('ball 3',) and cause.probability > 0.95 and found.missing == ('ball_slip',)
    assert {'time', 'table sense', 'travel'} <= cause.may_be and not cause.law_certain
    assert cause.law_probability < 0.9 and () in dict(cause.laws)
    missing, = found.verdict.missing
    assert missing.depth == 1 and found.verdict.outcome == Outcome.NAMED
    words = moves_words(missing)
    assert words.startswith('ball 3 moves with time (temperature, table travel and 2 more run alike)')


def test_two_laws_of_one_motion_are_not_certain():
    """A frame that steps twice may as well follow one course that the library does not have."""
    found = found_in('random', 'two steps')
    cause, = [one for one in found.causes if one.bodies[0] == 'frame']
    assert cause.names == ('frame_step', 'frame_step') and not cause.law_certain


def test_a_law_is_certain_only_where_its_variable_leaves_no_other():
    """A sense has two values: it does one thing. A step in time may be one of many that look like it."""
    reversal, = found_in('random', 'reversal').causes
    assert (reversal.names, reversal.own, reversal.law_certain) == (('cmm_reversal',), {'cmm sense'}, True)
    step, = found_in('random', 'clear step').causes
    assert step.names == ('frame_step',) and step.law_probability > 0.97 and not step.law_certain


def test_what_nobody_knows_of_the_first_reading_is_as_on_average():
    """No move before it is known: what moves do moves it as it does the others on average."""
    moves = {'cmm distance', 'cmm direction', 'move size', 'time since move', 'pause'}
    for order in ('column', 'interleaved'):
        run = planned_run(plan(8, order, 1), 0.18)
        known = {one.name: one.functions for one in variables(run) if one.name in moves}
        assert {'cmm distance', 'cmm direction'} <= known.keys()
        for functions in known.values():
            assert not functions[:, 0].any() and np.abs(functions.mean(axis=1)).max() < 1e-12


def test_a_plate_that_warps_moves_by_ball_and_time():
    """The saddle lies in the plate: no ball moves as another one does."""
    run = planned_run(plan(8, 'interleaved', 1), 0.1825)
    warp = motion_of(run, place_of(run, 'plate_warp'))
    assert warp.own == {'ball', 'time'} and 'travel' in warp.standing('time') and not warp.standing('ball')


def test_what_else_it_moves_with_is_told_until_little_is_left():
    """With the table angle in one of ten, with the distance of the CMM move in one of a hundred: the first follows, and
    both count as doubt. Explanations are told until all others together are below the same limit."""
    run = planned_run(plan(6, 'random', 1), 0.18)
    drift, angle, distance = (place_of(run, name) for name in (
        'frame_drift', 'table angle | frame', 'cmm distance | frame'))
    looked = {(('frame_drift',), ()): (np.log(0.88), (drift,)), (('table angle | frame',), ()): (np.log(0.1), (angle,)),
              (('cmm distance | frame',), ()): (np.log(0.01), (distance,)), ((), ()): (np.log(0.01), ())}
    posterior = Posterior(looked)
    cause, = causes_of(posterior, run, {drift: motion_of(run, drift)})
    assert cause.or_with == (('table angle',),) and cause.probability == pytest.approx(0.98)
    assert [one.members for one in posterior.explanations()] == [('frame_drift',), ('table angle | frame',)]
    assert len(posterior.near) == 4 and Posterior({**looked, ((), ()): (-10.0, ())}).near == posterior.near[:3]


def test_a_base_that_follows_the_heavy_side_goes_by_the_moves_of_the_table():
    """It leans to where the heavy side was, of which three quarters stay from reading to reading."""
    run, *_ = synthetic_run(8, 'random', seed=5, noise=SIGMA, repeatability=SIGMA)
    heavy, leans = np.stack([np.cos(run.phi), np.sin(run.phi), 0 * run.phi], axis=1), np.zeros((run.size, 3))
    for k in range(1, run.size):
        leans[k] = 0.75 * leans[k - 1] + 0.25 * heavy[k]
    cause, = find(run.replace(centre=run.centre + 3e-6 * leans)).causes
    assert (cause.bodies, [some[0] for some in cause.variables]) == (('frame',), ['table memory'])
    assert cause.probability > 0.97 and cause.laws[0][0] == ()


@pytest.mark.parametrize('stays, variable', [(0.0, 'cmm direction'), (0.5, 'cmm memory')])
def test_what_moves_of_the_cmm_leave_goes_by_their_length(stays, variable):
    """It overshoots by 2 um/m of the way to a ball, or its base leans after it and half of that stays to the next."""
    run, *_ = synthetic_run(7, 'random', seed=5, noise=SIGMA, repeatability=SIGMA)
    along = run.phi + run.beta
    place = run.radius * np.stack([np.cos(along), np.sin(along), np.zeros(run.size)], axis=1)
    off = np.zeros((run.size, 3))
    for k in range(1, run.size):
        off[k] = stays * off[k - 1] + 2e-6 * (place[k] - place[k - 1])
    cause, = find(run.replace(centre=run.centre + off)).causes
    assert (cause.bodies, [some[0] for some in cause.variables]) == (('frame',), [variable])
    assert cause.probability > 0.97 and cause.laws[0][0] == ()


def test_a_frame_that_wanders_moves_with_time():
    """A hypothesis in which it does counts for the frame and time, and for time where another body moves with it."""
    run = planned_run(plan(6, 'random', 1), 0.18)
    weight = np.exp([3.0, 2.5, 0.0])
    for name, bodies in (('time | frame', ('frame',)), ('time | plate tilting', ('plate tilting', 'frame'))):
        place = place_of(run, name)
        looked = {((name,), ()): (3.0, (place,)), ((), ('wander',)): (2.5, ()), ((), ()): (0.0, ())}
        cause, = causes_of(Posterior(looked), run, {place: motion_of(run, place)})
        assert cause.bodies == bodies and cause.variables[0][0] == 'time' and cause.laws[0][0] == ()
        assert cause.probability == pytest.approx(weight[:2].sum() / weight.sum())


def test_what_moves_by_a_constant_amount_is_said_so():
    """The stem of a ball leans in the machine: its ball moves with nothing, in the hypotheses that have it and in place
    of a slip. Every effect of the library can be said so, where no law is certain."""
    run = planned_run(plan(6, 'random', 1), 0.18)
    stem, slip = place_of(run, 'ball_machine_offset', ball=2), place_of(run, 'ball_slip', ball=2)
    looked = {(('ball_machine_offset',), ()): (5.0, (stem,)), (('ball_slip',), ()): (4.5, (slip,)), ((), ()): (0.0, ())}
    weight = np.exp([5.0, 4.5, 0.0])
    for place, own in ((stem, weight[0]), (slip, weight[1])):
        cause, = causes_of(Posterior(looked), run, {place: motion_of(run, place)})
        assert dict(cause.laws)[cause.names] == pytest.approx(own / weight.sum())
        other = 'with time' if place is stem else 'by a constant amount'
        missing = MissingEffect(place[0].name, place[1], cause=cause)
        assert moves_words(missing).endswith(f', or {other}') and moves_words(missing).count('constant') == 1
    for family in families_of(run):
        own = motion_of(run, (family, family.settings[0])).own
        if not family.is_free:
            said = replace(cause, variables=tuple((one,) for one in sorted(own)), or_with=((), ('time',)))
            words = moves_words(MissingEffect(family.name, family.settings[0], cause=said))
            assert words.endswith(', or by a constant amount, or with time'), family.name
            assert words.count('constant') == 1 + (not own)
