# SPDX-License-Identifier: Apache-2.0
"""Noise of a run beside effects and wrong readings: neither is told as the other."""

import re

import numpy as np
import pytest
from noisy_runs import SIGMA, estimated, noisy, problem, student, walk, white
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.diagnosis import find, judge
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.noise import Noise
from rosette_ros.words.verdict_words import verdict_text


@pytest.mark.parametrize('order', ['column', 'diagonal', 'random'])
@pytest.mark.parametrize('factor', [3.0, 5.0])
def test_a_ball_that_scatters_more_makes_no_shape(factor, order):
    """A form of as many coefficients as the ball has readings describes any noise: it is no course of the ball."""
    run = synthetic_run(12, order, 2, repeatability=SIGMA)[0]
    size = np.where(run.ball == 7, factor, 1.0)[:, None]
    verdict = judge(run.replace(centre=run.centre + SIGMA * size * white(52)[0]))
    assert verdict.outcome in (Outcome.NOISE, Outcome.SCATTERS)
    assert re.search(r'scatters [1-9]\.\d times as much|stand out', verdict_text(verdict).sentence)


@pytest.mark.parametrize('seed', range(3))
def test_a_noise_that_leaves_readings_out_is_not_taken(seed):
    """Without noise all that is left is where a plate dropped: other parts of the run would count for everything."""
    run, *_ = synthetic_run(12, 'row', seed)
    dropped = np.clip((np.arange(run.size) - 88) / 5, 0, 1) * np.sin(run.beta - 1) * 9e-6 * (run.time < run.time[96])
    verdict = judge(run.replace(centre=run.centre + dropped[:, None] * np.eye(3)[2]))
    assert verdict.outcome in (Outcome.NAMED, Outcome.UNNAMED)


def test_an_effect_is_named_in_noisy_axes():
    """A drift is named where z is twice as noisy, and both are told."""
    run = noisy(white(3)[0] * (1, 1, 2), 3)
    drift = 1.2e-6 * (run.time / run.time[-1])[:, None] * np.array([1.0, 0.5, 0.0])
    verdict = judge(run.replace(centre=run.centre + drift))
    assert verdict.outcome == Outcome.NAMED
    assert [one.name for one in verdict.missing] == ['frame_drift'] and verdict.noise.worse[0][0] == 'z'


def test_heavy_tails_and_unequal_axes_are_both_found():
    """z twice as noisy, beside Student's distribution of 4 degrees of freedom: one does not stand for the other."""
    found = [estimated(student(seed, 4) * (1, 1, 2), seed).noise for seed in range(4)]
    assert all(set(noise.kinds) >= {'axes', 'tail reading'} for noise in found)
    assert np.mean([noise.axes[2] / noise.axes[0] for noise in found]) == pytest.approx(2, rel=0.15)


def test_what_wrong_readings_leave_decides_between_them_and_heavy_tails():
    """Normal noise is not taken for Student's in more than 5 % of the runs; Student's is known from what is left."""
    tails = Noise(tail='reading', tail_dof=4.0)
    normal = [problem(white(seed)[0], seed).start.p_of_tail(tails) for seed in range(40)]
    assert sum(p < 0.01 for p in normal) <= 2 and 0.3 < np.mean(normal) < 0.7
    assert sum(problem(student(seed, 3), seed).start.p_of_tail(tails) < 0.01 for seed in range(10)) >= 9


@pytest.mark.parametrize(('reading', 'order'), [(0, 'random'), (60, 'column')])
def test_one_wrong_reading_is_no_other_effect(reading, order):
    """Off along one axis, the first of a run is no warm-up, the first of its ball no slip of the plate."""
    offset = white(5)[0]
    offset[reading] += (9.0, 0.0, 0.0) if reading == 0 else (0.0, 11.0, 0.0)
    verdict = judge(noisy(offset, 5, order))
    assert [one.name for one in verdict.missing] == ['outlier'] and verdict.outliers[0].number == reading + 1


BESIDE = {
    'all of one ball': lambda run: (run.ball == 9)[:, None] * np.array([1.0, -0.4, 0]),
    'a radius that drifts': lambda run: (run.time / run.time[-1])[:, None] * np.stack(
        [np.cos(run.alpha), np.sin(run.alpha), 0 * run.alpha], axis=1),
    'a scale that drifts': lambda run: (run.time / run.time[-1] * np.cos(run.alpha))[:, None] * np.array([1.0, 0, 0]),
}


@pytest.mark.parametrize('kind', BESIDE)
def test_the_noise_beside_an_effect_is_not_what_the_effect_alone_looks_like(kind):
    """40 sigma look like a loud ball, a wander or unequal axes: beside the effect no more is left than without it."""
    run = noisy(student(2, 4), 2)
    moved = BESIDE[kind](run)
    visible = np.linalg.norm(fit(run.replace(centre=run.centre + 1e-6 * moved)).residual - fit(run).residual)
    found = find(run.replace(centre=run.centre + 40 * SIGMA * 1e-6 / visible * moved))
    assert len(found.missing) == 1
    assert found.final.rms == pytest.approx(fit(run).rms, rel=0.05)
    assert not found.final.noise.by and not found.final.noise.wander.any()


@pytest.mark.parametrize('seed', [1, 2, 6, 9, 11])
def test_a_wander_beside_an_effect_is_no_course_of_the_frame(seed):
    """Beside a ball that stands off by 25 sigma a random walk of 2 sigma is a wander, as it is alone."""
    run = noisy(walk(seed, 2.0), seed)
    moved = BESIDE['all of one ball'](run)
    visible = np.linalg.norm(fit(run.replace(centre=run.centre + 1e-6 * moved)).residual - fit(run).residual)
    found = find(run.replace(centre=run.centre + 25 * SIGMA * 1e-6 / visible * moved))
    assert found.missing == ('ball_machine_offset',)
    assert found.final.noise.wander.any() or not found.unexplained


@pytest.mark.parametrize('seed', range(3))
def test_a_drift_beside_an_effect_is_no_wander(seed):
    """In white noise both are named, the drift of 15 sigma, too."""
    run = noisy(white(seed)[0], seed)
    for moved, size in ((BESIDE['all of one ball'](run), 25), (run.time[:, None] * np.array([1e-4, 0, 5e-5]), 15)):
        visible = np.linalg.norm(fit(run.replace(centre=run.centre + 1e-6 * moved)).residual - fit(run).residual)
        run = run.replace(centre=run.centre + size * SIGMA * 1e-6 / visible * moved)
    missing = find(run).missing
    assert missing[0] == 'ball_machine_offset' and len(missing) == 2
    assert missing[1] in ('frame_drift', 'frame_warmup')
