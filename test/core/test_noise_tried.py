# SPDX-License-Identifier: Apache-2.0
"""Which kinds of noise are tried: a wander only where the spectra ask for it, and nothing is lost by that."""

import math

import numpy as np
import pytest
from noisy_runs import SIGMA, autoregressive, noisy, walk, white

from rosette_ros.core.diagnosis.log_evidence import NEAR
from rosette_ros.core.diagnosis.noise_hypotheses import noise_beside
from rosette_ros.core.diagnosis.noise_kinds import LEAST, NOT_WHITE
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan


def clean(n, order, seed):
    """Return the kinds of noise beside the base model on a run of n balls with white noise."""
    scheme = plan(n, order)
    noise = SIGMA * np.random.default_rng(seed).standard_normal((scheme.ball.size, 3))
    return noise_beside(fit(Run(n, 0.1825, scheme.table_position, scheme.ball, scheme.centres(0.1825) + noise)))


@pytest.mark.parametrize('order', ['random', 'diagonal', 'interleaved'])
def test_a_wander_is_seldom_tried_in_white_noise(order):
    """A tenth of the clean runs at most, of 12 and 36 balls."""
    for n, count in ((12, 40), (36, 10)):
        assert sum(clean(n, order, seed)._wander_hope > LEAST for seed in range(count)) <= 0.1 * count


@pytest.mark.long
def test_no_wander_is_lost_that_takes_part():
    """Whatever is within a third of NEAR of white noise by its evidence itself is tried; the estimate follows it."""
    found = []
    for seed in range(12):
        size = (0.3, 0.5, 2.0, 4.0)[seed % 4]
        moved = walk(seed, size) if size > 1 else white(seed)[0] + size * autoregressive(seed + 100, 0.8)
        kinds = noise_beside(fit(noisy(moved, seed, ('random', 'diagonal')[seed % 2])))
        found.append((max(one.log_evidence for one in kinds._wander(-np.inf)), kinds._wander_hope))
    own, hope = np.array(found).T
    near = own > math.log(1 - NOT_WHITE) - NEAR / 3
    assert 5 <= near.sum() <= 14 and (hope[near] > LEAST).all(), found
    assert np.abs(hope - own)[own < 3].max() < 2, found
