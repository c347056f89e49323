# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on data of the simulated machine, which shares no code with the library."""

import numpy as np
import pytest
from monte_carlo import monte_carlo
from synthetic import synthetic_run

from rosette_ros.analysis import analyse
from rosette_ros.core.diagnosis.comparison import compare
from rosette_ros.core.diagnosis.cross_validation import CrossValidation
from rosette_ros.core.diagnosis.diagnosis import RunSearch, _search, diagnose, find, judge
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import BASE_TERMS, Model
from rosette_ros.core.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.result_words import comparison_words
from rosette_ros.words.verdict_words import unexplained_words, verdict_text

SIGMA = 1e-7


def machine_run(order='random', seed=1, n=12, hidden=(), turning='forward', **groups):
    """Return a run of the simulated machine that hides effects."""
    config = MachineConfig().changed(seed=seed, plate={'balls': n}, hidden=list(hidden), **groups)
    return Machine(config).run(plan(n, order, seed, turning))


HIDDEN = {
    'frame_drift': {'rate_um_per_h': [0.4, 0.0, 0.3]},
    'frame_cycle': {'cosine_um': [0.2, 0.0, 0.1], 'period_min': 17.0},
    'table_zero_drift': {'rate_urad_per_h': 3.0},
    'plate_creep': {'rate_um_per_h': [0.5, -0.4, 0.0]},
    'plate_warp': {'rate_um_per_h': 0.7},
    'cmm_reversal': {'value_um': [0.4, 0.3, 0.0]},
}


@pytest.mark.parametrize('kind', HIDDEN)
def test_the_hidden_effect_is_named(kind):
    """What the machine hides is named alone, with a small probability, and the error falls to noise."""
    found = diagnose(machine_run(hidden=[{'kind': kind, **HIDDEN[kind]}]))
    assert found.missing == (kind,)
    top = found.candidates[0]
    assert top.effect == kind and top.claimed and top.p < 1e-3
    assert top.rms_after < top.rms_before
    assert abs(top.rms_after / SIGMA - 1) < 3 * 0.041  # 301 degrees of freedom: sigma to 4 %
    assert abs(top.cross_validation_after / SIGMA - 1) < 4 * 0.041
    assert top.cross_validation_after < top.cross_validation_before
    assert not found.unexplained
    assert f'Missing: {EFFECTS[kind].plain}' in verdict_text(found.verdict).sentence


def test_what_the_model_describes_is_still_in_the_cell():
    """A verdict that a model fits says how large its effects are, but for those that are not there."""
    run = machine_run(n=8, hidden=[{'kind': 'frame_drift', **HIDDEN['frame_drift']}])
    drift = Model().with_effect('frame_drift')
    found = find(run, drift)
    size = f'{1e6 * found.fit.effects[0].rms:#.3g} µm rms'
    assert found.verdict.outcome == Outcome.FITS
    action = verdict_text(found.verdict).action
    assert f'the cause of what the model only describes, frame_drift ({size}), or keep it' in action
    assert not find(machine_run(n=8), drift).verdict.present


def test_a_model_without_base_terms_is_judged():
    """What it lacks are the base terms."""
    found = find(machine_run(n=5), Model(()))
    assert found.verdict.outcome == Outcome.NAMED and set(BASE_TERMS) <= set(found.missing)


def test_amplitudes_are_those_of_the_machine():
    """A drift of 0.4, 0, 0.3 um/h comes back within three standard uncertainties."""
    top = diagnose(machine_run(hidden=[{'kind': 'frame_drift', **HIDDEN['frame_drift']}])).candidates[0]
    truth = {'d_x': 0.4e-6 / 3600, 'd_y': 0.0, 'd_z': 0.3e-6 / 3600}
    for parameter in top.parameters:
        assert abs(parameter.value - truth[parameter.name]) < 3 * parameter.u


def test_two_effects_are_named_together():
    """Two effects at once are found as a set."""
    hidden = [{'kind': 'frame_drift', 'rate_um_per_h': [0.6, 0.2, 0.0]},
              {'kind': 'plate_warp', 'rate_um_per_h': 0.9}]
    assert set(find(machine_run(hidden=hidden)).missing) == {'frame_drift', 'plate_warp'}


@pytest.mark.parametrize('order', ['row', 'diagonal', 'column', 'random'])
def test_clean_runs_yield_no_name(order):
    """Noise alone is not given a name (the blind tests count this over hundreds of runs)."""
    found = find(machine_run(order, seed=5))
    assert found.missing == () and not found.unexplained
    assert found.verdict.outcome == Outcome.FITS


def test_hidden_by_the_order_is_said_and_not_claimed():
    """Backlash of a table that turns one way only cannot be seen, and is not claimed."""
    found = find(machine_run('diagonal', hidden=[{'kind': 'table_backlash', 'width_urad': 9.0}]))
    assert found.missing == ()
    assert 'table_backlash' in found.invisible and found.verdict.hidden == found.invisible
    assert 'in an order that shows table_zero_drift, ' in verdict_text(found.verdict).action


def test_backlash_shows_when_the_table_turns_both_ways():
    """The same backlash is named where the table turns both ways."""
    hidden = [{'kind': 'table_backlash', 'width_urad': 9.0}]
    found = find(machine_run('random', hidden=hidden, turning='alternate'))
    assert found.missing == ('table_backlash',)


def test_a_shape_without_name_is_unexplained():
    """z = t cos 3 alpha is no effect of the library: its shape is described, no cause is claimed."""
    run, *_ = synthetic_run(12, 'random', 2, noise=SIGMA, repeatability=SIGMA)
    shape = (run.time / run.time[-1]) * np.cos(3 * run.alpha)
    found = find(run.replace(centre=run.centre + 1e-6 * shape[:, None] * np.array([0, 0, 1.0])))
    assert found.unexplained and found.missing == ()
    assert unexplained_words(found.verdict) == ('it is a product of time and CMM position (3 waves per turn), '
                                      'in z')


@pytest.mark.parametrize('lacking', ['plate_deviations', 'cmm_deviations'])
def test_a_base_term_left_out_is_missed(lacking):
    """A model without plate or CMM deviations is told so."""
    model = Model(tuple(t for t in Model().base if t != lacking))
    found = diagnose(machine_run('diagonal', cmm={'correction': False}), model)
    assert found.missing == (lacking,)
    assert found.candidates[0].rms_after < 1.3 * SIGMA < found.candidates[0].rms_before


def test_adding_the_right_effect_ends_the_search():
    """With the effect in the model nothing is missing any more, and the curves are right again."""
    run = machine_run('column', hidden=[{'kind': 'frame_drift', 'rate_um_per_h': [1.5, 0, 0.9]}])
    clean = analyse(machine_run('column')).error_motions
    model = Model().with_effect('frame_drift')
    fit = analyse(run, model)
    assert find(run, model).missing == ()
    assert np.abs((fit.error_motions.values - clean.values) / fit.error_motions.u).max() < 4


def test_a_wrong_effect_does_not_help_left_out_readings():
    """Terms that only describe noise do not lower the held-out error by more than chance."""
    found = diagnose(machine_run('random', seed=8))
    worse = [c.cross_validation_after > c.cross_validation_before * 0.985 for c in found.candidates]
    assert all(worse) and len(worse) > 10


def test_cross_validation_error_of_noise_is_sigma():
    """The held-out error is free of the model's appetite: sigma for white noise."""
    run, *_ = synthetic_run(12, noise=SIGMA)
    result = fit(run)
    blocks = CrossValidation(result.joint, run.size)
    nothing = np.zeros((0, 3 * run.size))
    rms = blocks.rms([(result.residual.reshape(-1), nothing)] * blocks.folds)
    assert abs(rms / SIGMA - 1) < 0.15


def test_same_run_same_answer():
    """A diagnosis can be repeated to the last digit."""
    run = machine_run(hidden=[{'kind': 'plate_warp', **HIDDEN['plate_warp']}])
    one = diagnose(run)
    _search.cache_clear()
    other = diagnose(run)
    assert one is not other
    assert [c.p for c in one.candidates] == [c.p for c in other.candidates]


def warm_drift(seed, size):
    """Return a run of 9 balls forwards and backwards with a drift and what follows a temperature that rises and falls.

    size: of the drift, m over the run; the temperature moves the frame by 1.9 times as much per K."""
    run = synthetic_run(9, 'there_and_back', seed, noise=SIGMA, repeatability=SIGMA)[0]
    share = run.time / run.time[-1]
    temperature = 20 + 0.4 * np.sin(2 * np.pi * (1.1 * share + 0.15))
    drift, warm = (one / np.linalg.norm(one) for one in np.random.default_rng(seed).standard_normal((2, 3)))
    moved = size * share[:, None] * drift + 1.875 * size * (temperature - temperature[0])[:, None] * warm
    return run.replace(centre=run.centre + moved, temperature=temperature)


@pytest.mark.parametrize(('seed', 'size'), [(2, 1.6e-6), (5, 1.6e-6), (5, 2.4e-6)])
def test_two_effects_in_time_are_found_together(seed, size):
    """A curve in time of more numbers stands for both at first; of seed 5 a step and two others, or one other, did."""
    assert set(find(warm_drift(seed, size)).missing) == {'frame_drift', 'frame_temperature'}


def test_one_curve_in_place_of_two_effects_says_so():
    """Where the two are not so much better that chance is ruled out, they are neither claimed nor ruled out."""
    sentence = verdict_text(find(warm_drift(6, 1.1e-6)).verdict).sentence
    assert 'it changes with time along a curve' in sentence and ' together would make it, too' in sentence


def test_a_candidate_without_a_fit_is_not_judged(monkeypatch):
    """Its reason is listed, and the others are; it was the end of the whole diagnosis."""
    fitted = RunSearch.final_fit

    def refused(search, members):
        if any(member.name == 'plate_warp' for member in members):
            raise NotDeterminable('the products of rotations and deviations do not converge')
        return fitted(search, members)

    run = machine_run()
    whole = diagnose(run)
    assert 'plate_warp' in {one.effect for one in whole.candidates}
    monkeypatch.setattr(RunSearch, 'final_fit', refused)
    _search.cache_clear()
    found = diagnose(run)
    assert ('plate_warp', 'its fit to these readings does not converge') in found.unavailable
    assert {one.effect for one in found.candidates} == {one.effect for one in whole.candidates} - {'plate_warp'}


def test_a_model_without_table_motions_says_so():
    """Curves that nothing has determined are no result of a measurement."""
    verdict = judge(machine_run('diagonal', n=6), Model(BASE_TERMS[1:]))
    text = verdict_text(verdict)
    assert not verdict.has_motions
    assert text.sentence.endswith('no error motions of the table: their curves are zero by assumption.')
    assert 'add table_motions to the model' in text.action.lower()


def test_comparison_says_where_it_fails():
    """A ball that moved shows as that ball; a clean run fails nowhere."""
    hidden = [{'kind': 'ball_slip', 'ball': 4, 'shift_um': [1.5, 1.0, 0.5], 'at_h': 1.0}]
    moved = compare(analyse(machine_run('diagonal', hidden=hidden)))
    groups = {grouping.label: grouping for grouping in moved.groupings}
    assert groups['ball'].keys[groups['ball'].worst] == '4'
    clean = compare(analyse(machine_run('diagonal')))
    assert 'at ball 4' in comparison_words(moved) and 'at ball' not in comparison_words(clean)
    assert np.allclose(clean.axis_rms, SIGMA, rtol=0.2)


def test_neighbours_are_alike_or_not():
    """A course in time makes neighbours in the sequence alike; what goes to and fro with each reading does not."""
    run = synthetic_run(8, 'random', 4, noise=SIGMA)[0]
    drift = 2e-6 * run.time / run.time[-1]
    for moved, words in ((drift, 'are alike'), (2e-7 * (-1.0)**np.arange(run.size), 'differ more than by chance')):
        summary = comparison_words(compare(fit(run.replace(centre=run.centre + moved[:, None] * np.eye(3)[0]))))
        assert f'successive readings {words}' in summary


@pytest.mark.parametrize('model, draws, tolerance', [
    (Model(), 1000, 0.03), (Model().with_effect('frame_drift'), 1000, 0.05),
    (Model().with_effect('frame_warmup'), 60, 0.25)], ids=['base', 'drift', 'warm-up'])
def test_monte_carlo_confirms_the_uncertainties(model, draws, tolerance):
    """Drawing the noise anew spreads curves and parameters as the fit states (GUM Supplement 1)."""
    hidden = [{'kind': 'frame_warmup', 'amplitude_um': [2.0, 0, 1.0], 'time_constant_h': 0.3,
               'from_h': 0.25}]
    result = analyse(machine_run('random', hidden=hidden, n=8), model)
    drawn = monte_carlo(result, draws)
    assert abs(drawn.ratio - 1) < tolerance
    for _, _, spread, stated in drawn.parameters:
        assert abs(spread / stated - 1) < max(tolerance, 0.1) * 1.5


def test_expanded_uncertainty_covers_amplitudes():
    """Over 60 runs the amplitude lies within k = 2 about 95 % of the time."""
    inside = []
    for seed in range(60):
        run, *_ = synthetic_run(6, 'random', seed, noise=SIGMA)
        drift = run.time[:, None] * np.array([1e-10, 0, 0])
        result = fit(run.replace(centre=run.centre + drift), Model().with_effect('frame_drift'),
                     ({'axes': 'xyz'},))
        for parameter, truth in zip(result.effects[0].parameters, (1e-10, 0, 0)):
            inside.append(abs(parameter.value - truth) < 2 * parameter.u)
    assert 0.90 < np.mean(inside) < 0.99


@pytest.mark.parametrize('seed', [3, 4])
def test_a_pulse_is_one_pulse(seed):
    """Its moments are searched on a coarse grid: a wrong reading stood beside it, and two steps in its place."""
    run = synthetic_run(12, 'there_and_back', seed, noise=SIGMA, repeatability=SIGMA)[0]
    inside = (run.time > 0.105 * run.time[-1]) & (run.time < 0.3427 * run.time[-1])
    moved = 1e-6 * inside[:, None] * np.array([-0.7, -0.56, -0.42])
    assert find(run.replace(centre=run.centre + moved)).missing == ('frame_pulse',)
