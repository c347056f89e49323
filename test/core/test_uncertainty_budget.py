# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget: its lines by hand, its sum, examples of the GUM, Monte Carlo, coverage of true curves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special
from synthetic import MICROMETRE, RADIUS

from benchmarks.bench_coverage import coverage
from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.touches import centre_factors, usual_directions
from rosette_ros.core.sight.visibility import visibility
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.budget_lines import root_mean
from rosette_ros.core.uncertainty.budget_monte_carlo import monte_carlo
from rosette_ros.core.uncertainty.error_summary import fit_lines
from rosette_ros.core.uncertainty.form_field import form_basis
from rosette_ros.core.uncertainty.hidden_effects import surrounded
from rosette_ros.core.uncertainty.stated_environment import CLASSES
from rosette_ros.core.uncertainty.uncertainty_budget import BudgetGap, TouchScatter, budget
from rosette_ros.presentation.budget_results import together_words
from rosette_ros.words.budget_words import not_considered

pytestmark = pytest.mark.long

NOISE = 1e-7
ALL = BudgetInputs({
    'ball_form': {'form_um': 4e-7, 'touches': 8},
    'plate_expansion': {'coefficient_um_per_m_K': 1e-6, 'u_um_per_m_K': 1e-6},
    'frame_expansion': {'u_um_per_K': 1e-7}, 'radius': {'u_um': 5e-4},
    'alignment': {'origin_um': 5e-4, 'tilt_urad': 5e-4, 'azimuth_urad': 1e-2}})
"""Every contribution large enough to be seen in the sum."""


def lines(made):
    """Return the contributions by name."""
    return {one.name: one for one in made.contributions}


def warm_run(make_run, n=6, order='random', **rest):
    """Return a run with noise whose temperature rises by 1 K."""
    run = make_run(n, order, noise=NOISE, **rest)[0]
    return run.replace(temperature=20 + np.linspace(0, 1, run.size))


@pytest.mark.parametrize('kind', ['complete', 'missing', 'axes', 'wander', 'effect'])
def test_without_inputs_the_budget_is_the_uncertainty_of_the_fit(make_run, kind):
    """Its lines are the parts of what the fit states: axes, touches, effects, whatever noise and gaps there are."""
    run = make_run(6, 'random', noise=NOISE)[0]
    run = run.take(np.arange(run.size) % 9 != 4) if kind == 'missing' else run
    noise = {'axes': Noise(axes=np.array([1.0, 1.0, 2.0])), 'wander': Noise(wander=np.array([0.5, 0.5, 0.5]), phi=0.9)}
    model = Model().with_effect('frame_drift') if kind == 'effect' else Model()
    fitted = fit(run, model, choose_settings(run, model), noise.get(kind))
    touch = TouchScatter(3 * NOISE, usual_directions(20), 500, 'test') if kind == 'axes' else None
    made = budget(fitted, touch=touch)
    np.testing.assert_allclose(made.combined(), fitted.error_motions.u, rtol=1e-9)
    assert ('effects in the model' in lines(made)) == (kind == 'effect')


@pytest.mark.filterwarnings('error')
def test_effects_that_do_not_move_a_curve_contribute_nothing(make_run):
    """The form of all balls leaves ctz alone: rounding makes no variance below 0, whose root is no number."""
    run = make_run(12, 'diagonal', noise=NOISE)[0]
    model = Model().with_effect('ball_form', {'ball': 0, 'harmonic': 0, 'part': 'both'})
    made = budget(fit(run, model, choose_settings(run, model)))
    assert np.all(np.isfinite(made.combined()))


def test_the_six_lines_have_the_uncertainty_of_the_budget(make_run):
    """u(R) alone stretches a curve: its range r gets r u(R) / R; without inputs the lines are those of the fit."""
    fitted = fit(make_run(6, 'random', noise=NOISE)[0])
    bare, without = fit_lines(fitted), budget(fitted).lines()
    for one, other in zip(bare, without, strict=True):
        assert one.u_range == pytest.approx(other.u_range, rel=1e-9)
    made = budget(fitted, BudgetInputs({'radius': {'u_um': 5e-3}}))
    found = made.lines({'crz': 1e-3})
    for place, (one, other) in enumerate(zip(found, bare, strict=True)):
        more = one.range * 5e-3 / fitted.mean_radius if place > 2 else 0.0
        assert one.u_range == pytest.approx(np.hypot(other.u_range, more), rel=1e-6)
        assert one.u_point == pytest.approx(made.combined()[:, place].max())
    assert found[5].tolerance == 1e-3
    np.testing.assert_allclose(made.error_motions.u, made.combined(), rtol=1e-12)


def test_the_curves_follow_the_readings_as_a_refit_does(make_run):
    """The map from readings to curves is the derivative of the fit, effects in the model refitted."""
    run, model = make_run(7, 'random', noise=NOISE)[0], Model().with_effect('frame_drift')
    settings = choose_settings(run, model)
    first = fit(run, model, settings)
    rows = 1e-8 * np.random.default_rng(1).standard_normal((1, run.size, 3))
    again = fit(run.replace(centre=run.centre + rows[0]), model, settings, beyond=first.beyond)
    change = again.error_motions.values - first.error_motions.values
    assert np.abs(change - first.joint.curves(rows)[0]).max() < 1e-6 * np.abs(change).max()


def test_a_steady_change_of_temperature_moves_a_run_in_rows(make_run):
    """In the order row a drift d is in the table motions as it stands: d (mean time of a table position)."""
    n, size = 6, 36
    run = make_run(n, 'row', noise=NOISE)[0]
    made = budget(fit(run), BudgetInputs({'frame_expansion': {'u_um_per_K': MICROMETRE, 'range_K': 0.3}}))
    course = np.arange(size).reshape(n, n).mean(axis=1) / (size - 1) - 0.5
    wanted = MICROMETRE * 0.3 / np.sqrt(3) * np.sqrt(np.mean(course**2))
    assert lines(made)['temperature: frame'].mean[2] == pytest.approx(wanted, rel=1e-9)


def test_touches_are_what_their_spheres_make_of_them(make_run):
    """Of independent readings: u(ctz) = factor sigma sqrt(n - 1) / n; no more of the repeatability is left."""
    n = 8
    fitted = fit(make_run(n, noise=NOISE)[0])
    touch = TouchScatter(0.4 * fitted.sigma, usual_directions(20), 1000, 'test')
    made = lines(budget(fitted, touch=touch))
    z = centre_factors(touch.direction)[2] * touch.sigma
    np.testing.assert_allclose(made['touches'].u[:, 2], z * np.sqrt(n - 1) / n, rtol=1e-9)
    np.testing.assert_allclose(made['repeatability z'].u[:, 2]**2, (fitted.sigma**2 - z**2) * (n - 1) / n**2, rtol=1e-9)


def test_the_form_of_a_ball_is_alike_from_all_sides():
    """The random surface has its standard deviation everywhere, and no part that is a radius or a shift."""
    rng = np.random.default_rng(0)
    at = rng.standard_normal((20_000, 3))
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    basis = form_basis(at)
    np.testing.assert_allclose((basis**2).sum(axis=1), 1, rtol=1e-12)
    assert np.abs(basis.mean(axis=0)).max() < 0.01
    assert np.abs(at.T @ basis / len(at)).max() < 0.01


def test_what_form_leaves_in_the_residuals_is_not_counted_twice(make_run):
    """The noise of a run of round balls and the stated form together are what the residuals say, about."""
    run = make_run(6, 'random', noise=NOISE)[0]
    fitted = fit(run)
    made = budget(fitted, BudgetInputs({'ball_form': {'form_um': 3e-7}}))
    assert made.sigma < fitted.sigma
    assert np.all(made.mean > 0.9 * root_mean(fitted.error_motions.u))
    assert np.all(made.mean < 1.15 * root_mean(fitted.error_motions.u))
    worst = budget(fitted, BudgetInputs({'ball_form': {'form_um': 3e-5}}))
    assert worst.sigma == pytest.approx(fitted.sigma / 2)


@pytest.mark.parametrize('shown', [0, 1, 3])
def test_a_temperature_takes_off_what_the_readings_show_of_it(make_run, shown):
    """However large it is stated, the noise is that of the run without: no larger U of an input lowers U elsewhere.

    shown: how many of the stated standard uncertainties the plate expands."""
    quiet, size = warm_run(make_run, n=8), 3e-6
    course = quiet.temperature - quiet.temperature.mean()
    radial = np.stack([np.cos(quiet.alpha), np.sin(quiet.alpha), np.zeros(quiet.size)], axis=-1)
    run = quiet.replace(centre=quiet.centre + shown * size * quiet.radius * course[:, None] * radial)
    alone, stated = fit(quiet), {'plate_expansion': {'u_um_per_m_K': size}}
    made = budget(fit(run), BudgetInputs(stated))
    assert made.sigma == pytest.approx(alone.sigma, rel=0.02)
    assert alone.dof - 1 <= made.dof < alone.dof - 0.9
    assert np.all(made.mean > 0.98 * root_mean(alone.error_motions.u))
    assert budget(fit(run), BudgetInputs({'plate_expansion': {'u_um_per_m_K': 1e-12}})).sigma == pytest.approx(
        fit(run).sigma, rel=1e-6)


def test_effective_degrees_of_freedom_are_those_of_the_gum(make_run):
    """GUM G.4.1, note 2 to H: relative u of 0.25 %, 0.57 %, 0.82 % with 9, 4, 14 degrees give 19.0."""
    made = budget(fit(make_run(6, noise=NOISE)[0]))
    parts = tuple(replace(made.contributions[0], u=np.full((6, 6), u), dof=dof, is_noise=False)
                  for u, dof in ((0.25, 9), (0.57, 4), (0.82, 14)))
    example = replace(made, contributions=parts)
    np.testing.assert_allclose(example.mean, 1.03, atol=0.005)
    np.testing.assert_allclose(example.effective_dof, 19.0, atol=0.05)
    assert np.all((example.coverage > 2.1) & (example.coverage < 2.15))


def test_radius_and_frame_stretch_and_turn_the_curves(make_run):
    """u(crz) = crz u(R) / R; an azimuth exchanges ctx and cty, a shift of the origin adds Theta x o."""
    fitted = fit(warm_run(make_run))
    made, values = lines(budget(fitted, ALL)), fitted.error_motions.values
    np.testing.assert_allclose(made['radius'].u[:, 5], np.abs(values[:, 5]) * 5e-4 / fitted.mean_radius, rtol=1e-9)
    assert made['radius'].u[:, :3].max() == 0
    np.testing.assert_allclose(made['alignment: azimuth'].u[:, 0], 1e-2 * np.abs(values[:, 1]), rtol=1e-6)
    tilts = np.hypot(values[:, 3], values[:, 4])
    np.testing.assert_allclose(made['alignment: origin'].u[:, 2], 5e-4 * tilts, rtol=1e-6)


@pytest.mark.parametrize('is_recorded', [True, False])
def test_monte_carlo_confirms_the_budget(make_run, is_recorded):
    """Exact bodies, spheres and another fit give every curve the same u, to 4 %; the seed decides the draws."""
    curves = 5e-6 * np.random.default_rng(3).standard_normal((6, 6))
    run = warm_run(make_run, curves=curves)
    inputs = ALL
    if not is_recorded:
        run = run.replace(temperature=np.full(run.size, np.nan))
        inputs = replace(ALL, values={name: {**entries, **({'range_K': 1.0} if 'expansion' in name else {})}
                                      for name, entries in ALL.values.items()})
    touch = TouchScatter(0.5 * NOISE, usual_directions(8), 1000, 'test')
    model = Model().with_effect('frame_drift')
    made = budget(fit(run, model, choose_settings(run, model)), inputs, touch)
    steps = []
    found = monte_carlo(made, 2500, 1, steps.append)
    assert sum(steps) == 2500
    np.testing.assert_allclose(root_mean(found.u) / made.mean, 1, atol=0.04)
    assert found.agrees is not False
    assert np.array_equal(monte_carlo(made, 50, 1).u, monte_carlo(made, 50, 1).u)


def test_monte_carlo_refutes_a_wrong_budget(make_run):
    """A contribution that was left out, and a size that too few degrees of freedom support."""
    made = budget(fit(warm_run(make_run)), BudgetInputs({'ball_form': {'form_um': 6e-7}}))
    without = replace(made, contributions=made.contributions[:3])
    assert monte_carlo(without, 2000).agrees is False
    assert monte_carlo(replace(made, dof=2), 2000).agrees is False
    assert monte_carlo(made, 900).agrees is None
    assert monte_carlo(made, 4000).agrees is True


def gap(made, kind):
    """Return what a budget does not consider of a kind."""
    return next(one for one in made.open if one.kind is kind)


def test_hidden_effects_are_bounded_or_named(make_run):
    """In the order row a drift is hidden and harmful: it is named, or has the bound that is stated, D / sqrt(3)."""
    run = make_run(6, 'row', noise=NOISE)[0]
    fitted = fit(run)
    shown = visibility(run, fitted.sigma)
    assert 'frame_drift' in gap(budget(fitted, hidden=shown), BudgetGap.UNBOUNDED).numbers['effects']
    made = budget(fitted, BudgetInputs(bounds={'frame_drift': 3e-7}), hidden=shown)
    bias = next(one.bias for one in shown if one.name == 'frame_drift')
    np.testing.assert_allclose(lines(made)['hidden: frame_drift'].mean, 3e-7 / np.sqrt(3) * bias)
    assert 'frame_drift' not in gap(made, BudgetGap.UNBOUNDED).numbers['effects']
    assert np.all(made.mean >= root_mean(made.combined()))
    with pytest.raises(InvalidData, match="hidden_effects: expected one of .*, found 'drift'"):
        budget(fitted, BudgetInputs(bounds={'drift': 3e-7}), hidden=shown)


def test_a_bound_of_an_effect_that_the_run_cannot_judge_is_no_line_of_zeros(make_run):
    """Without senses of the table nobody knows what its backlash does: it is named with the reason, once."""
    run = make_run(6, 'row', noise=NOISE)[0]
    fitted = fit(run.replace(approach=np.zeros(run.size)))
    shown = visibility(fitted.run, fitted.sigma)
    made = budget(fitted, BudgetInputs(bounds={'table_backlash_angle': 3e-7, 'frame_drift': 3e-7}), hidden=shown)
    assert 'hidden: table_backlash_angle' not in lines(made)
    assert lines(made)['hidden: frame_drift'].mean.max() > 0
    named = [words for words in not_considered(made) if 'table_backlash_angle (' in words]
    assert named == ['Effects of stated size that are in no line, as the run does not tell what they do to the curves: '
                     'table_backlash_angle (the run does not say in which sense the table moved).']


def test_what_is_missing_is_told_and_not_invented(make_run):
    """Each section that is not stated is named; a range of temperature is asked for."""
    fitted = fit(make_run(6, noise=NOISE)[0])
    told = ' '.join(not_considered(budget(fitted, doubt='the model does not fit')))
    for section in ('ball_form', 'plate_expansion', 'frame_expansion', 'alignment', 'radius', 'touches'):
        assert f'({section})' in told
    assert told.startswith('What the model lacks: the model does not fit.')
    assert 'Harmonics of the errors above 3' in told
    with pytest.raises(InvalidData, match='frame_expansion: expected range_K, as no temperature is recorded'):
        budget(fitted, BudgetInputs({'frame_expansion': {'u_um_per_K': 1e-6}}))
    with pytest.raises(InvalidData, match='at most 72 balls, found 73'):
        budget(fit(make_run(73, noise=NOISE)[0]))
    assert fitted.run.radius == RADIUS


def test_coverage_of_true_curves():
    """All contributions on, U (k = 2) contains 92 to 98 % of the true points of 200 simulated runs, curve by curve."""
    share = np.mean(np.abs(coverage(6, 200)) <= 2, axis=(0, 1))
    assert np.all((share >= 0.92) & (share <= 0.98)), share


def test_the_six_errors_of_a_point_scatter_together(make_run):
    """GUM S2: their covariance is that of the least squares, J' J sigma^2; normal errors lie in its ellipsoid."""
    made = replace(budget(fit(make_run(6, noise=NOISE)[0])), dof=np.inf)
    run = made.fit.run
    jacobian = made.fit.joint.curves(np.eye(3 * run.size).reshape(-1, run.size, 3)) * np.broadcast_to(
        made.sigma, 3)[np.arange(3 * run.size) % 3][:, None, None]
    expected = np.einsum('ria,rib->iab', jacobian, jacobian)
    found = monte_carlo(made, 4000)
    sizes = np.sqrt(np.einsum('iaa->ia', expected))
    np.testing.assert_allclose(found.correlation, expected / (sizes[:, :, None] * sizes[:, None, :]), atol=0.06)
    np.testing.assert_allclose(found.reach, np.sqrt(special.chdtri(6, 0.0455)), rtol=0.04)
    assert together_words(found).endswith('standard deviations (normal: 3.58).')


def test_curves_and_u_over_explanations(make_run):
    """Two explanations, 3 to 1: mean and variance of each point by the law of total variance; the same for ranges."""
    run = make_run(6, 'row', noise=NOISE)[0]
    inputs = BudgetInputs(environment=CLASSES['laboratory'])
    plain, other = fit(run), fit(run, Model().with_effect('plate_creep'), [{}])
    made = budget(plain, inputs, explanations=[(0.6, plain), (0.2, other)])
    one, two = (surrounded(each, inputs.environment).error_motions for each in (plain, other))
    mean = 0.75 * one.values + 0.25 * two.values
    square = 0.75 * (one.u**2 + (one.values - mean)**2) + 0.25 * (two.u**2 + (two.values - mean)**2)
    np.testing.assert_allclose(made.error_motions.values, mean, rtol=1e-9, atol=1e-15)
    larger = square > one.u**2
    np.testing.assert_allclose(made.error_motions.u[larger]**2, square[larger], rtol=1e-6)
    assert lines(made)['other explanations'].is_hidden
    for place, line in enumerate(made.lines()):
        high, low = mean[:, place].argmax(), mean[:, place].argmin()
        steps = [each.values[high, place] - each.values[low, place] for each in (one, two)]
        assert line.spread.moments[0] == pytest.approx(line.range) == pytest.approx(0.75 * steps[0] + 0.25 * steps[1])
    alone, whole = budget(plain, inputs), budget(plain, inputs, explanations=[(0.97, plain)])
    np.testing.assert_allclose(whole.error_motions.u, alone.error_motions.u, rtol=1e-12)
    assert [one.u_range for one in whole.lines()] == pytest.approx([one.u_range for one in alone.lines()])
