# SPDX-License-Identifier: Apache-2.0
"""A run with a pause: what happened meanwhile is found where it happened."""

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.diagnosis import diagnose, find
from rosette_ros.core.effects.run_functions import between_readings
from rosette_ros.core.run.errors import InvalidData

N, SIGMA = 9, 1e-7
PAUSE = 43
HOUR = 3600.0


@pytest.fixture(scope='module')
def paused():
    """Return a run that was broken off before reading 44 and resumed two hours later."""
    run, *_ = synthetic_run(N, 'random', seed=4, noise=SIGMA, repeatability=SIGMA)
    after = np.arange(run.size) >= PAUSE
    return run.replace(time=run.time + np.where(after, 2 * HOUR, 0.0), session=1 + after)


def step(run, at, size=1e-6):
    """Return the run with the probe requalified before reading `at`, machine frame (which is the table's here)."""
    return run.replace(centre=run.centre + np.where(np.arange(run.size) >= at, size, 0.0)[:, None] * [1.0, 0.5, 0.0])


def test_a_step_in_the_pause_is_found_there(paused):
    """Somebody requalified the probe before going on: the moment found lies in the pause."""
    found = find(step(paused, PAUSE))
    assert found.missing == ('frame_step',)
    t0 = found.terms[0].fixed['t0']
    assert paused.time[PAUSE - 1] < t0 < paused.time[PAUSE]


def test_drift_knows_how_long_the_pause_was(paused):
    """2 h of 5 nm/min within the pause count."""
    drift = 5e-9 / 60 * (paused.time - paused.time[0])
    found = find(paused.replace(centre=paused.centre + drift[:, None] * [0.0, 0.0, 1.0]))
    assert found.missing == ('frame_drift',)
    rates = {one.name: one for one in found.final.effects[0].parameters}
    assert abs(rates['d_z'].value - 5e-9 / 60) < 3 * rates['d_z'].u


def test_a_pause_alone_is_no_effect(paused):
    """Nothing happened meanwhile: nothing is named."""
    found = find(paused)
    assert found.missing == ()
    assert not found.unexplained


def test_every_pause_is_among_the_moments(paused):
    """However many readings there are, a step may lie in each pause."""
    moments = between_readings(paused, most=10)
    assert 0.5 * (paused.time[PAUSE - 1] + paused.time[PAUSE]) in moments
    assert moments.size in (10, 11)
    assert (np.diff(moments) > 0).all()


def test_numbers_that_no_calculation_ends_with_are_refused_in_words(paused, monkeypatch):
    """Whoever asks, the evaluator above all, gets a reason and no traceback."""
    def diverge(*_):
        raise np.linalg.LinAlgError('Eigenvalues did not converge')

    monkeypatch.setattr('rosette_ros.core.diagnosis.run_search.choose_settings', diverge)
    with pytest.raises(InvalidData, match='cannot be diagnosed .Eigenvalues did not converge.; check its times'):
        diagnose(paused.replace(run_id='another'))
