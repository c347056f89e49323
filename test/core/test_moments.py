# SPDX-License-Identifier: Apache-2.0
"""Where the moment of a step lies, with its probability; degrees of freedom count what was searched."""

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.diagnosis.moments import moments_of
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model, Term

SIGMA, SEEDS = 1e-7, 20


def moment(name, seed, size, **of):
    """Return the run, the Interval that is found of a step of `size` sigma, and its true time, s."""
    run = synthetic_run(6, 'random', seed, noise=SIGMA)[0]
    time = run.time - run.time[0]
    true = float(np.random.default_rng(seed).uniform(0.3, 0.7) * time[-1])
    columns = EFFECTS[name].columns(run, Setting(t0=true, **of))
    moved = run.replace(centre=run.centre + size * SIGMA * columns[..., 0])
    model = Model().with_effect(name, of)
    return moved, moments_of(fit(moved, model, choose_settings(moved, model)), 0)['t0'], true


@pytest.mark.parametrize(('name', 'of'), [
    ('plate_slip', {}), ('frame_step', {'axes': 'xyz'}), ('ball_slip', {'ball': 3})])
def test_the_moment_lies_in_its_interval_as_often_as_is_said(name, of):
    """95 % of weak steps: at least 16 of 20 of each (p < 0.003 of fewer); a strong one lies between two readings."""
    inside, widths = 0, []
    for seed in range(SEEDS):
        run, found, true = moment(name, seed, 3.0, **of)
        time = run.time - run.time[0]
        assert found.probability >= 0.95 and found.low < found.high
        assert time[found.last - 1] <= found.low and time[found.first - 1] == found.high
        inside += found.low <= true <= found.high
        widths.append(found.first - found.last)
    assert inside >= 16 and max(widths) > min(widths)
    run, found, true = moment(name, 1, 300.0, **of)
    assert found.low <= true <= found.high and found.probability > 0.99
    own = run.ball == of['ball'] if 'ball' in of else np.full(run.size, True)
    assert np.count_nonzero(own[found.last:found.first - 1]) == 0


@pytest.mark.parametrize(('name', 'setting', 'searched'), [
    ('ball_slip', {'ball': 3, 't0': 900.0}, 1), ('frame_warmup', {'axes': 'xyz', 'tau': 600.0}, 1),
    ('ball_rattle', {'ball': 3, 'motion': 'pulse', 't0': 500.0, 't1': 1000.0}, 2)])
def test_degrees_of_freedom_count_what_was_searched(name, setting, searched):
    """What the search has fixed, as in an effect that stands twice in a ladder, is adjusted; what a user has is not."""
    run = synthetic_run(6, 'random', 3, noise=SIGMA)[0]
    run = run.replace(time=np.linspace(0.0, 1500.0, run.size))
    by_user, by_search = (fit(run, Model(terms=(Term(EFFECTS[name], Setting(setting), is_found),)), [setting])
                          for is_found in (False, True))
    assert by_user.dof - by_search.dof == searched
    assert np.all(by_search.error_motions.u >= by_user.error_motions.u * (1 - 1e-9))
