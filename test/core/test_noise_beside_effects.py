# SPDX-License-Identifier: Apache-2.0
"""Noise of a run beside effects and wrong readings: neither is told as the other."""

import numpy as np
import pytest
from noisy_runs import SIGMA, moved, noise_of, noisy, student, walk, white
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.diagnosis import find, judge
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.model.least_squares import fit
from rosette_ros.words.verdict_words import unexplained_words, verdict_text

pytestmark = pytest.mark.long


def test_a_ball_that_scatters_more_makes_no_shape():
    """A free course of as many functions as the ball has readings describes any noise: it is no course of the ball."""
    wrong = {}
    for order in ('column', 'diagonal', 'random'):
        run = synthetic_run(12, order, 2, repeatability=SIGMA)[0]
        for factor in (3.0, 5.0):
            size = np.where(run.ball == 7, factor, 1.0)[:, None]
            found = find(run.replace(centre=run.centre + SIGMA * size * white(52)[0]))
            kinds = found.final.noise.kinds
            if found.missing or found.unnamed or not any(kind.startswith(('by ', 'tail')) for kind in kinds):
                wrong[order, factor] = (found.missing, unexplained_words(found.verdict), kinds)
    assert not wrong, wrong


def test_a_noise_that_leaves_readings_out_is_not_taken():
    """Without noise all that is left is where a plate dropped: other parts of the run would count for everything."""
    run, *_ = synthetic_run(12, 'row', 0)
    dropped = np.clip((np.arange(run.size) - 88) / 5, 0, 1) * np.sin(run.beta - 1) * 9e-6
    dropped = (dropped * (run.time < run.time[96]))[:, None] * np.eye(3)[2]
    assert judge(run.replace(centre=run.centre + dropped)).outcome in (Outcome.NAMED, Outcome.UNNAMED)


def test_an_effect_is_named_in_noisy_axes():
    """A drift is named where z is twice as noisy, and both are told."""
    run = noisy(white(3)[0] * (1, 1, 2), 3)
    drift = 1.2e-6 * (run.time / run.time[-1])[:, None] * np.array([1.0, 0.5, 0.0])
    found = find(run.replace(centre=run.centre + drift))
    assert found.missing == ('frame_drift',)
    assert 'standard deviations in x, y, z: ' in verdict_text(found.verdict).sentence


def test_heavy_tails_do_not_hide_unequal_axes():
    """z twice as noisy, of Student's distribution of 4 degrees of freedom: the sizes of the axes are those that are
    true, whether a kind of noise has them white or of a short memory."""
    found = [noise_of(noisy(student(seed, 4) * (1, 1, 2), seed)) for seed in range(4)]
    size = [np.sqrt(noise.axes**2 + noise.wander) for noise in found]
    assert np.mean([one[2] / one[0] for one in size]) == pytest.approx(2, rel=0.15)
    assert all(set(noise.kinds) & {'axes', 'wander'} for noise in found), [noise.kinds for noise in found]


def test_one_wrong_reading_at_an_edge_is_among_the_explanations():
    """Off along one axis: the first of a run, and the first of its ball, are at the edge of what looks like a step."""
    told = {}
    for reading, order, off in ((0, 'random', (9.0, 0, 0)), (60, 'column', (0, 11.0, 0))):
        offset = white(5)[0]
        offset[reading] += off
        found = find(noisy(offset, 5, order))
        listed = {name for one in found.explanations[:3] for name in one.members}
        told[reading] = ('outlier' in listed and not found.unnamed) or (found.explanations[:3], found.unnamed)
    assert set(told.values()) == {True}, told


BESIDE = {
    'ball_machine_offset': lambda run: (run.ball == 9)[:, None] * np.array([1.0, -0.4, 0]),
    'plate_expansion': lambda run: (run.time / run.time[-1])[:, None] * np.stack(
        [np.cos(run.alpha), np.sin(run.alpha), 0 * run.alpha], axis=1),
    'cmm_scale_drift': lambda run: (run.time / run.time[-1] * np.cos(run.alpha))[:, None] * np.array([1.0, 0, 0]),
}


def test_the_noise_beside_an_effect_is_not_what_the_effect_alone_looks_like():
    """40 sigma look like a loud ball, a wander or unequal axes: beside the effect no more is left than without it."""
    run, wrong = noisy(student(2, 4), 2), {}
    for kind, displacement in BESIDE.items():
        found = find(moved(run, displacement(run), 40))
        noise = found.final.noise
        if found.missing != (kind,) or noise.by or noise.wander.any() or abs(found.final.rms / fit(run).rms - 1) > 0.05:
            wrong[kind] = (found.missing, unexplained_words(found.verdict), noise.kinds, found.final.rms / fit(run).rms)
    assert not wrong, wrong


def test_a_wander_beside_an_effect_is_that_or_a_motion_of_the_frame_with_time():
    """Beside a ball that stands off by 25 sigma a random walk of the frame of 2 sigma is told as what it is."""
    wrong = {}
    for seed in (1, 2, 6, 9, 11):
        run = noisy(walk(seed, 2.0), seed)
        found = find(moved(run, BESIDE['ball_machine_offset'](run), 25))
        others = [one.cause for one in (*found.claimed, *found.unnamed) if one.name != 'ball_machine_offset']
        if 'ball_machine_offset' not in found.missing or not all(
                'frame' in one.bodies and 'time' in one.may_be and not one.law_certain for one in others):
            wrong[seed] = (found.missing, unexplained_words(found.verdict), found.final.noise.kinds)
    assert not wrong, wrong


def test_a_drift_beside_an_effect_is_no_wander():
    """In white noise both are named, the drift of 15 sigma, too."""
    wrong = {}
    for seed in range(3):
        run = noisy(white(seed)[0], seed)
        run = moved(run, BESIDE['ball_machine_offset'](run), 25)
        found = find(moved(run, run.time[:, None] * np.array([1e-4, 0, 5e-5]), 15))
        drift, = set(found.missing) - {'ball_machine_offset'} or {''}
        if len(found.missing) != 2 or drift not in ('frame_drift', 'frame_warmup'):
            wrong[seed] = (found.missing, unexplained_words(found.verdict), found.final.noise.kinds)
    assert not wrong, wrong
