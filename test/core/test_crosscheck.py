# SPDX-License-Identifier: Apache-2.0
"""What one run taught, checked on another: the simulated machine measures both."""

import numpy as np
import pytest

from rosette_ros.analysis import claimed_model, cross_check, diagnose, ladder
from rosette_ros.core.diagnosis.second_run import _same_size
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.least_squares import FittedEffect, Parameter
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.result_words import check_words, reason_words

SIGMA = 1e-7
CYCLE = {'kind': 'frame_cycle', 'cosine_um': [0.6, 0.0, 0.4], 'period_min': 11.0}
CREEP = {'kind': 'plate_creep', 'rate_um_per_h': [3.0, -2.0, 0.0]}
STEP = {'kind': 'frame_step', 'step_um': [0.8, 0.5, 0.4], 'at_h': 0.6}


def machine_run(seed, *hidden, order='random', n=8):
    """Return a run of a machine that hides effects; the seed draws its noise, not its effects."""
    config = MachineConfig().changed(seed=seed, plate={'balls': n}, hidden=list(hidden))
    return Machine(config).run(plan(n, order, seed), run_id=f'run_{seed}')


@pytest.fixture(scope='module')
def creeping():
    """Return the diagnosis of a run in which the plate creeps."""
    found = diagnose(machine_run(1, CREEP))
    assert found.missing == ('plate_creep',)
    return found


@pytest.mark.long
def test_a_rate_is_confirmed_with_its_size(creeping):
    """Noise does as well never; amplitudes agree; carried over without any fit it is the noise."""
    check = cross_check(machine_run(2, CREEP), creeping)
    entry, = check.effects
    assert check.confirmed is True
    assert (entry.outcome, entry.carries, entry.same_size) == ('confirmed', 'all', True)
    assert entry.p < 1e-6
    assert check.after.rms == pytest.approx(SIGMA, rel=0.2)
    assert check.carried.rms == pytest.approx(SIGMA, rel=0.25)
    assert check.cross_validation_after < 0.7 * check.cross_validation_before
    assert check.after.dof == check.before.dof - 2, 'nothing is searched on the second run'


@pytest.mark.long
def test_another_size_is_said(creeping):
    """Half the rate is the same shape; carried over it makes things worse than a fit."""
    half = {**CREEP, 'rate_um_per_h': [1.5, -1.0, 0.0]}
    check = cross_check(machine_run(2, half), creeping)
    assert check.effects[0].outcome == 'confirmed'
    assert check.effects[0].same_size is False
    assert 'with another size' in check_words(check)
    assert check.carried.rms > 1.3 * check.after.rms


def test_amplitudes_that_are_not_determined_say_nothing_of_the_size():
    """Four standard uncertainties apart in one amplitude are another size, whatever else the effect has."""
    def fitted(value, others):
        pairs = [(value, 1.0), *[(0.0, np.inf)] * others]
        parameters = tuple(Parameter(f'd_{k}', one, u, 'm') for k, (one, u) in enumerate(pairs))
        return FittedEffect('frame_drift', Setting(), parameters, np.zeros((1, 3)))

    assert [_same_size(fitted(0.0, others), fitted(4.5, others)) for others in (0, 2)] == [False, False]
    assert _same_size(fitted(0.0, 2), fitted(1.0, 2))


@pytest.mark.long
def test_what_is_not_there_is_not_seen(creeping):
    """The error in left-out readings does not fall, and no confirmation is given."""
    check = cross_check(machine_run(3), creeping)
    assert check.confirmed is False
    assert check.effects[0].outcome == 'not seen'
    assert check.cross_validation_after > 0.98 * check.cross_validation_before


@pytest.mark.long
def test_a_frame_that_wanders_does_not_confirm_a_drift():
    """A random walk of 10 sigma passed for the drift in 19 of 20 runs; under the noise of the run in 3."""
    drifting = diagnose(machine_run(1, {'kind': 'frame_drift', 'rate_um_per_h': [1.5, 0.0, -1.0]}))
    assert drifting.missing == ('frame_drift',)
    outcomes = []
    for seed in range(100, 106):
        still, rng = machine_run(seed), np.random.default_rng(seed - 100)
        walk = 10 * SIGMA * np.cumsum(rng.standard_normal((still.size, 3)), axis=0) / np.sqrt(still.size)
        check = cross_check(still.replace(centre=still.centre + walk), drifting)
        outcomes.append(check.effects[0].outcome)
    assert ' is not white, which is taken into account: the frame wanders' in check_words(check)
    assert outcomes.count('confirmed') <= 1, outcomes


@pytest.mark.long
def test_a_second_run_without_noise_has_none(creeping):
    """What rounding leaves of it has sizes by axis, but is none."""
    config = MachineConfig().changed(seed=2, plate={'balls': 8}, probing={'repeatability_um': 0.0}, hidden=[CREEP])
    check = cross_check(Machine(config).run(plan(8, 'random', 2), run_id='silent'), creeping)
    assert check.effects[0].outcome == 'confirmed'
    assert 'The noise of this run' not in check_words(check)


@pytest.mark.long
def test_a_fall_no_larger_than_chance_is_none(creeping):
    """The error in left-out readings falls a little, but so it does by chance in one run of seven."""
    entry, = cross_check(machine_run(13), creeping).effects
    assert entry.cross_validation_with < entry.cross_validation_without
    assert entry.outcome == 'not seen'
    assert reason_words(entry) == 'the residual falls with it by no more than chance (p = 0.14)'


@pytest.mark.long
def test_an_order_that_hides_it_cannot_check_it(creeping):
    """Column order shows nothing of a creep."""
    check = cross_check(machine_run(4, CREEP, order='column'), creeping)
    assert check.confirmed is None
    assert check.effects[0].outcome == 'hidden'
    assert 'cannot be checked: it is not observable in this order of measurement' in check_words(check)
    assert check.carried is None


@pytest.mark.long
def test_a_cycle_keeps_its_period_but_not_its_phase():
    """The second run begins elsewhere in the cycle: the amplitudes are fitted, the period is not."""
    found = diagnose(machine_run(1, CYCLE))
    assert found.missing == ('frame_cycle',)
    check = cross_check(machine_run(5, CYCLE), found)
    entry, = check.effects
    assert (entry.outcome, entry.carries, entry.same_size) == ('confirmed', 'shape', None)
    assert check.carried is None and np.isnan(check.cross_validation_carried)
    assert entry.setting['period'] == pytest.approx(660, rel=0.05)
    assert [one.name for one in entry.found] == [one.name for one in entry.learnt
                                                 if one.name != 'period']


@pytest.mark.long
def test_an_event_need_not_come_again():
    """A bump of one run says nothing about the next."""
    found = diagnose(machine_run(1, STEP))
    assert found.missing == ('frame_step',)
    check = cross_check(machine_run(2), found)
    assert check.confirmed is None
    assert check.effects[0].outcome == 'event'
    assert check.after.rms == check.before.rms


@pytest.mark.long
def test_an_effect_too_small_for_the_second_run_is_not_denied(creeping):
    """A plate that creeps a tenth as fast on A could not show on a run that takes an hour."""
    small = diagnose(machine_run(1, CREEP, n=16))
    entry, = cross_check(machine_run(3, n=3), small).effects
    assert entry.outcome in ('too weak', 'hidden')


@pytest.mark.long
def test_nothing_learnt_is_nothing_checked():
    """A clean first run."""
    found = diagnose(machine_run(7))
    assert found.missing == ()
    check = cross_check(machine_run(8), found)
    assert check.effects == () and check.confirmed is None
    assert check_words(check) == 'No effect was found in the first run, so there is nothing to check.'


def test_every_effect_says_what_it_shares_with_the_next_run():
    """Rates and constants all, cycles and warm-ups their shape, events nothing."""
    carries = {name: effect.carries for name, effect in EFFECTS.items()}
    assert {name for name, word in carries.items() if word == 'nothing'} == {
        'frame_step', 'frame_pulse', 'frame_drift_onset', 'plate_slip', 'ball_slip', 'ball_creep',
        'ball_rattle', 'outlier', 'frame_recovery', 'axis_tilt_step', 'table_zero_step', 'plate_tilt_step'}
    assert {name for name, word in carries.items() if word == 'shape'} == {
        'frame_drift_curved', 'frame_warmup', 'frame_cycle', 'asynchronous_motion', 'table_warmup',
        'plate_creep_settling', 'plate_tilt_settling', 'plate_soaking', 'table_zero_warmup', 'axis_tilt_warmup'}
    assert set(carries.values()) == {'all', 'shape', 'nothing'}


@pytest.mark.long
def test_the_ladder_goes_from_the_base_to_the_whole_model():
    """Each step is the fit of one effect more; the last is the model itself."""
    run = machine_run(1, CREEP, CYCLE)
    model = claimed_model(diagnose(run))
    steps = ladder(run, model)
    assert [step.added for step in steps] == ['', *(str(term) for term in model.terms)]
    assert set(model.names[3:]) == {'plate_creep', 'frame_cycle'}
    assert steps[0].fit.model == Model()
    assert steps[-1].fit.model == model
    held = [step.cross_validation for step in steps]
    assert held == sorted(held, reverse=True)
    assert held[-1] == pytest.approx(SIGMA, rel=0.25)


@pytest.mark.long
def test_an_effect_claimed_twice_makes_a_model_that_can_be_written():
    """Two cycles of different periods stand in it with their settings fixed."""
    other = {**CYCLE, 'cosine_um': [0.0, 0.7, 0.5], 'period_min': 4.3}  # no overtone of 11 min
    found = diagnose(machine_run(1, CYCLE, other))
    model = claimed_model(found)
    assert [term.name for term in found.terms] == ['frame_cycle', 'frame_cycle']
    again = Model.from_mapping(model.to_mapping())
    assert again == model
    periods = sorted(term.fixed['period'] / 60 for term in model.terms)
    assert periods == pytest.approx([4.3, 11.0], rel=0.03)
