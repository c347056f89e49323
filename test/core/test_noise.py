# SPDX-License-Identifier: Apache-2.0
"""The noise of a run: whitening makes it white, its estimates are right, and it is never told as a physical effect."""

import re

import numpy as np
import pytest
from noisy_runs import NONE, SIGMA, autoregressive, covariance, estimated, noisy, student, walk, white
from synthetic import synthetic_run

from rosette_ros.analysis import analyse
from rosette_ros.core.diagnosis.comparison import compare
from rosette_ros.core.diagnosis.diagnosis import judge
from rosette_ros.core.diagnosis.noise_choice import noise_problem
from rosette_ros.core.diagnosis.noise_search import NoiseProblem, estimate
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.errors import InvalidModel
from rosette_ros.core.model.least_squares import fit, observed
from rosette_ros.core.model.model import Model
from rosette_ros.core.model.noise import Noise, Whitening
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.records import remove_gauge
from rosette_ros.core.scheme import plan
from rosette_ros.presentation.formatting import uncertainty_words
from rosette_ros.words.verdict_words import verdict_text


@pytest.mark.parametrize('size', [20, 80])
@pytest.mark.parametrize('phi', [0.3, 0.97, 1.0])
def test_whitening_makes_white(phi, size):
    """W C W' = 1, the adjoint is W', the inverse is W^-1, and the determinant is that of C; many rows are whitened by
    blocks."""
    sd, wander = np.random.default_rng(1).uniform(0.5, 2, (size, 3)), np.array([0.5, 0.0, 2.0])
    white_of, every = Whitening(size, sd, phi, wander), 3 * size
    units = np.eye(every).reshape(every, size, 3)
    w, adjoint, inverse = (part(units).reshape(every, every).T for part in (
        white_of.apply, white_of.adjoint, white_of.inverse))
    wanted = covariance(sd, phi, wander)
    assert np.abs(w @ wanted @ w.T - np.eye(every)).max() < 1e-11
    assert np.abs(adjoint - w.T).max() < 1e-14
    assert np.abs(w @ inverse - np.eye(every)).max() < 1e-12
    assert white_of.log_det_of((0, 1, 2)) == pytest.approx(np.linalg.slogdet(wanted)[1], abs=1e-10)
    single = white_of.apply(units.astype(np.float32)).reshape(every, every).T
    assert single.dtype == np.float32 and np.abs(single - w).max() < 1e-6


@pytest.mark.parametrize('noise', [
    Noise(axes=np.array([0.8, 0.8, 1.3])), Noise(axes=np.array([0.5, 1.0, 1.3])), Noise(by='ball', factors=np.arange(
        1.0, 7.0)), Noise(phi=0.9, wander=np.array([1.0, 1.0, 3.0])), Noise(phi=1.0, wander=np.array([0.0, 0.0, 0.1]))])
def test_a_fit_is_generalised_least_squares(noise):
    """Residual and uncertainty of the curves are those of a dense solution with the covariance written out."""
    run = synthetic_run(6, 'random', 3, noise=SIGMA)[0]
    found = fit(run, Model().with_effect('plate_warp', {'order': 2}), [{'order': 2}], noise)
    plain = np.eye(108).reshape(108, 36, 3)
    rest = fit(run).joint.space.free(plain).reshape(108, 108)
    columns = np.moveaxis(found.joint.columns, 0, -1).reshape(108, -1)
    design = np.hstack([np.eye(108) - rest, columns])
    sd = np.broadcast_to(noise.whitening(run).sd, (36, 3))
    root = np.linalg.cholesky(covariance(sd, noise.phi, noise.wander))
    basis = np.linalg.svd(np.linalg.solve(root, design), full_matrices=False)
    basis = basis[0][:, basis[1] > 1e-9 * basis[1][0]]
    left = np.linalg.solve(root, observed(run).reshape(-1))
    left = root @ (left - basis @ (basis.T @ left))
    assert np.abs(left - found.residual.reshape(-1)).max() < 1e-9 * SIGMA + 1e-12 * 0.18
    # the curves of unit readings spread as the covariance says
    each = np.array([fit(run.replace(centre=run.centre + 1e-6 * unit), found.model, found.settings, noise)
                     .error_motions.values - found.error_motions.values for unit in plain[::1]])
    spread = np.einsum('anc,ab,bnc->nc', each, root @ root.T, each) / 1e-12
    assert np.sqrt(spread) * found.sigma == pytest.approx(found.error_motions.u, rel=1e-5)


def test_unequal_axes_come_back():
    """z twice as noisy is found within its uncertainty, over 20 runs without bias; the axes stay as one."""
    ratios = []
    for seed in range(20):
        noise = estimated(white(seed)[0] * (1, 1, 2), seed, ('row', 'random')[seed % 2]).noise
        ratios.append(noise.axes[2] / noise.axes[0])
    assert abs(np.mean(ratios) / 2 - 1) < 3 * 0.09 / np.sqrt(20)  # 90 and 211 degrees of freedom: 9 %


def test_a_wander_comes_back():
    """A random walk of 10 sigma over the run, and the correlation of neighbours, over some runs without bias."""
    ends = [np.sqrt(144 * np.mean(found.noise.wander) / np.mean(found.noise.axes**2)) for found in (
        estimated(walk(seed, 10.0), seed) for seed in range(6)) if found.noise.phi == 1]
    assert len(ends) >= 4
    assert np.mean(ends) == pytest.approx(10, rel=0.25)
    assert all('wander' in estimated(autoregressive(seed, 0.6), seed).noise.kinds for seed in range(4))


def test_white_noise_stays_white():
    """Equal white noise is taken as other in few runs."""
    assert sum(estimated(white(seed)[0], seed).noise.is_white for seed in range(40)) >= 38


KINDS = {
    'z': (lambda seed: white(seed)[0] * (1, 1, 2), 'z repeats '),
    'tails': (lambda seed: student(seed, 3), ' stand out more than a normal distribution allows (Student, '),
    'neighbours': (lambda seed: autoregressive(seed, 0.6), 'successive readings are correlated, coefficient 0.'),
    'walk': (lambda seed: walk(seed, 10.0), 'the frame wanders'),
    'ball': (lambda seed: white(seed)[0] * np.where(np.arange(144) % 12 == 6, 3.0, 1.0)[:, None], '7 scatters ')}


@pytest.mark.parametrize('kind', KINDS)
def test_noise_is_told_as_noise(kind):
    """No physical effect is named, and the sentence says what the noise is like."""
    make, words = KINDS[kind]
    order = 'row' if kind == 'ball' else 'random'
    verdicts = [judge(noisy(make(seed), seed, order)) for seed in (0, 2)]
    assert all(one.outcome in (Outcome.FITS, Outcome.NOISE, Outcome.SCATTERS) for one in verdicts)
    assert all(words in verdict_text(one).sentence for one in verdicts)


def test_rounding_is_told_as_rounding():
    """Readings in steps of 1 um, whose noise is a tenth of that."""
    run = synthetic_run(12, 'diagonal', 1, noise=SIGMA, repeatability=SIGMA)[0]
    verdict = judge(run.replace(centre=np.round(run.centre, 6)))
    assert verdict.outcome == Outcome.SCATTERS
    assert verdict.noise.resolution == pytest.approx(1e-6)
    assert 'the readings are rounded to 1.00 µm' in verdict_text(verdict).sentence
    assert 'more digits' in verdict_text(verdict).action
    as_much = judge(run.replace(centre=np.round(run.centre, 7)))  # in steps of the noise: no reason to doubt the model
    assert as_much.outcome == Outcome.FITS
    assert 'rounded to 0.100 µm, which accounts for 9 % of the variance' in verdict_text(as_much).sentence


@pytest.mark.parametrize(('axes', 'words', 'look'), [
    ((5, 1, 1), r'x repeats [45]\.\d times worse than [yz]\.', 'the slide of x ('),
    ((1, 1, 4), r'z repeats [34]\.\d times worse than x and y\.', 'the slide of z ('),
    ((6, 2, 1), r'x repeats [567]\.\d times and y repeats [12]\.\d times worse than z\.', 'the slide of x and y (')])
def test_axes_that_repeat_worse_are_told_once(axes, words, look):
    """Each axis is compared with the one that repeats best, and the advice names those that repeat worse."""
    verdict = verdict_text(judge(noisy(white(5)[0] * axes, 5)))
    assert re.search(words, verdict.sentence)
    assert verdict.action.count('check the probe') == 1 and look in verdict.action


def test_unequal_axes_have_uncertainties_of_their_own():
    """What is printed of the size of the noise is what the uncertainties of the curves rest on: n - 1 of n waves of ctz
    are free, n - 2 of ctx."""
    fit = analyse(noisy(white(5)[0] * (1, 1, 4), 5))
    along_x, along_z = (float(re.search(rf'([\d.]+) µm along {axis}', uncertainty_words(fit))[1]) for axis in 'xz')
    u = 1e6 * fit.error_motions.u.max(axis=0)
    assert (along_x, along_z) == pytest.approx((12 * u[0] / np.sqrt(10), 12 * u[2] / np.sqrt(11)), rel=0.01)


def test_a_complete_run_of_unequal_axes_needs_no_dense_solution():
    """The variance of the curves is in closed form: z and the plane scale apart."""
    run = synthetic_run(6, 'row', 0, noise=SIGMA)[0]
    axes = np.array([0.5, 0.5, 2.0])
    equal, other = fit(run).joint.curve_cofactor(), fit(run, noise=Noise(axes=axes)).joint.curve_cofactor()
    assert other / equal == pytest.approx(np.tile([0.25, 0.25, 4, 4, 4, 0.25], (6, 1)), rel=1e-12)


def test_equal_axes_at_few_cmm_positions_stay_equal():
    """Balls and CMM positions that were not measured take no degrees of freedom of z; on large plates z alone is told
    from x and y."""
    run = planned_run(plan(48, 'diagonal', cmm_positions=(1, 2, 6, 13, 21, 30)), 0.1825)
    for seed in range(5):
        offset = SIGMA * np.random.default_rng(seed).standard_normal((run.size, 3))
        assert analyse(run.replace(centre=run.centre + offset)).noise.is_white, seed


@pytest.mark.parametrize('seed', [5, 8, 9])
def test_places_without_a_reading_cost_nothing(seed):
    """At 8 of 24 CMM positions, one of which scatters 2.2 times as much, eight sizes are estimated, not 21."""
    run = planned_run(plan(24, 'random', cmm_positions=(1, 2, 7, 9, 12, 16, 18, 21)), 0.1825)
    size = np.where(run.cmm_position == 7, 2.2, 1.0)[:, None]
    offset = SIGMA * size * np.random.default_rng(seed).standard_normal((run.size, 3))
    found = fit(run.replace(centre=run.centre + offset))
    assert estimate(noise_problem(found)).noise.by == 'CMM position'


@pytest.mark.parametrize('by', ['', 'CMM position'])
def test_a_reading_without_weight_changes_nothing_by_leaving_it_out(by):
    """What a wrong reading does to the curves is told under the noise of the run."""
    offset = white(1)[0]
    offset[70] += 300
    run, weight = noisy(offset), np.ones((144, 3))
    weight[70] = 1e-9
    factors = np.where(np.arange(12) % 3, 1.0, 5.0)
    found = compare(fit(run, noise=Noise(by=by, factors=factors if by else np.ones(1), weight=weight))).worst[0]
    assert found.number == 71
    assert max(found.without) < 1e-11


def test_what_the_noise_may_be_is_part_of_the_model():
    """It is left out, put back and written like an effect, and what is left out is not estimated."""
    whole = Model()
    less = whole.without_effect('noise.axes')
    assert 'noise' not in whole.to_mapping() and less.to_mapping()['noise'] == list(less.noise)
    assert Model.from_mapping(less.to_mapping()) == less and less.with_effect('noise.axes') == whole
    assert less.hash != whole.hash and str(less).endswith(' + noise.tail + noise.groups + noise.wander')
    run = noisy(white(3)[0] * (1, 1, 3), 3)
    assert analyse(run, Model(noise=())).noise.is_white
    assert analyse(run).noise.kinds == ('axes',)
    with pytest.raises(InvalidModel, match=r"noise: wanted some of noise.axes, .*, got 'noise.magic'"):
        Model(noise=('noise.magic',))
    with pytest.raises(InvalidModel, match='noise.axes is in the model already'):
        whole.with_effect('noise.axes')


def test_effects_of_any_unit_are_taken_off():
    """What is beside the noise spans the same, whatever its columns are measured in."""
    run = noisy(white(0)[0])
    found, time = fit(run), run.time - run.time.mean()
    columns = np.stack([time[:, None] * np.eye(3)[0], time[:, None]**2 * np.eye(3)[0], time[:, None] * np.eye(3)[2]])
    alike, unlike = (NoiseProblem(run, found.joint.space.basis, columns * np.array(units)[:, None, None],
                                  found.residual) for units in ([1, 1, 1], [1, 1e-9, 1e9]))
    assert alike.dof == found.dof - 3
    assert (unlike.dof, unlike.start.rss) == (alike.dof, pytest.approx(alike.start.rss, rel=1e-9))


def test_no_part_is_much_quieter_than_rounding_makes_it():
    """Where readings are repeated at once, as at the turn of there_and_back, their rounded values coincide."""
    run = synthetic_run(6, 'there_and_back', 11, noise=SIGMA, repeatability=SIGMA)[0]
    turned = np.stack([-np.sin(run.alpha), np.cos(run.alpha), np.zeros(run.size)], axis=-1)
    centre = run.centre + 5e-6 * (run.time / run.time[-1])[:, None] * turned
    run, step = run.replace(centre=np.rint(centre / 1e-6) * 1e-6), 1e-6
    found = fit(run)
    part = estimate(NoiseProblem(run, found.joint.space.basis, np.zeros((0, run.size, 3)), found.residual),
                    ('groups',))
    assert part.noise.by == 'time'
    assert part.noise.factors.min() * np.sqrt(part.rss / part.problem.dof) > 0.5 * step / np.sqrt(12)
    assert judge(run).outcome is Outcome.NAMED


def test_what_is_left_is_tested():
    """Where the model allows no other noise than white, what is left is said to be none."""
    run = noisy(white(7)[0] * (1, 1, 1.6), 7)
    verdict = judge(run, Model(noise=()))
    assert verdict.outcome in (Outcome.NOISE, Outcome.SCATTERS)
    assert 'the axes repeat unequally' in verdict.misfits and not judge(run).misfits
    assert 'The residual is no noise of that kind: ' in verdict_text(verdict).sentence


def test_a_repeatability_is_that_of_its_place():
    """Balls that scatter three times as much do not make the others' repeatability wrong; both places are told."""
    loud = np.where(np.arange(144) // 12 % 4 == 1, 3.0, 1.0)[:, None]  # a quarter of the balls, of the time too
    run = noisy(white(1)[0] * loud, 1, 'column').replace(repeatability_dof=30.0)
    verdict, found = judge(run), analyse(run)
    assert verdict.outcome == Outcome.NOISE
    where, alike = verdict.noise.noisiest
    assert where.endswith(' of 12 of the run') and alike.startswith('ball ')
    assert found.sigma == found.rms and found.sigma_source == 'residuals (the noise is not equal)'
    slow = Noise(by='time', factors=np.array([0.8, 1.0, 1.25]))  # the check was made one part before the run
    assert slow.quietest == pytest.approx(0.8) and Noise(by='ball', factors=slow.factors).quietest == 0.8
    assert Noise(by='time', factors=np.array([0.8, 1.2, 0.7, 1.5])).quietest < 0.55


def test_u_covers_under_heavy_tails():
    """Readings that choose their own weights have larger errors than weights that are given: by the formula of Huber.

    With the true curves in u: rms 1 (0.88 to 1.12 for twelve runs), where the weights are taken as given 1.15."""
    errors = []
    for seed in range(12):
        run, curves, *_ = synthetic_run(12, 'random', seed)
        run = run.replace(centre=run.centre + SIGMA * student(seed, 3))
        plain = fit(run)
        noise = estimate(NoiseProblem(run, plain.joint.space.basis, NONE, plain.residual, 0)).noise
        found = fit(run, noise=noise).error_motions
        errors.append((remove_gauge(found.values) - remove_gauge(curves)) / found.u)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1, abs=0.12)
    given, own = (Noise(tail='reading', tail_dof=3.0).loss(share) for share in (0.0, 0.3))
    assert given == pytest.approx(8 / 6) and (own / given)**0.5 == pytest.approx(1.14, abs=0.01)
    assert Noise().loss(0.3) == 1


def test_repeatability_by_axis_is_pooled_with_the_residuals():
    """Six balls leave z twelve degrees of freedom: with a check of 15 readings z is told from x and y most times."""
    told, ratio = {True: 0, False: 0}, []
    for seed in range(12):
        run = synthetic_run(6, 'random', seed)[0]
        rng = np.random.default_rng([seed, 3])
        noise, check = (SIGMA * rng.standard_normal((size, 3)) * (1, 1, 2) for size in (36, 15))
        axes = np.std(check, axis=0, ddof=1)
        run = run.replace(centre=run.centre + noise, repeatability=float(np.sqrt(np.mean(axes**2))),
                          repeatability_dof=42.0)
        for with_axes in told:
            plain = fit(run.replace(repeatability_axes=tuple(axes.tolist()) if with_axes else None))
            found = estimate(NoiseProblem(plain.run, plain.joint.space.basis, np.zeros((0, 36, 3)), plain.residual))
            told[with_axes] += found.noise.kinds == ('axes',)
            ratio += [found.noise.axes[2] / found.noise.axes[0]] if with_axes and found.noise.kinds == ('axes',) else []
    assert told[True] >= 7 and told[False] <= 4
    assert np.mean(ratio) == pytest.approx(2, rel=0.25)


def test_repeatability_by_axis_holds_where_the_readings_say_little_of_an_axis():
    """Four CMM positions of 12 balls leave z two degrees of freedom: U along z rests on the check, and covers."""
    off = []
    for seed in range(10):
        run, truth, *_ = synthetic_run(12, 'diagonal', seed)
        rng = np.random.default_rng([seed, 5])
        run = run.replace(centre=run.centre + SIGMA * rng.standard_normal((run.size, 3)) * (0.5, 0.5, 3.0))
        run = run.take(np.isin(run.cmm_position, [1, 5, 7, 10])).replace(
            repeatability=1.78e-7, repeatability_dof=27.0, repeatability_axes=(0.5e-7, 0.5e-7, 3e-7))
        found = analyse(run)
        assert found.noise.axes[2] > 3 * found.noise.axes[0]
        off.append((found.error_motions.values - remove_gauge(truth))[:, 2] / found.error_motions.u[:, 2])
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.4


def test_a_check_of_other_axes_is_no_noise_of_the_run():
    """Where the readings say more of an axis than the check, they decide: equal here."""
    check = np.array([1.0, 1.0, 4.0]) * SIGMA
    verdict = judge(noisy(white(1)[0]).replace(
        repeatability=float(np.sqrt(np.mean(check**2))), repeatability_dof=27.0,
        repeatability_axes=tuple(check.tolist())))
    assert verdict.outcome is Outcome.FITS
    assert verdict.too_large > 2 and not verdict.misfits


@pytest.mark.parametrize('seed', [0, 2, 4])
def test_the_residual_under_heavy_tails_is_that_of_their_variance(seed):
    """Student's noise of the stated standard deviation is no scatter: the residual is that of least squares, to 5 %."""
    run = noisy(student(seed, 4), seed)
    left = fit(run)
    verdict = judge(run)
    found = fit(run, Model(), (), estimated(student(seed, 4), seed).noise)
    assert found.noise.tail
    assert found.rms == pytest.approx(left.rms, rel=0.05)
    assert verdict.outcome != Outcome.SCATTERS and verdict.noise.tail
