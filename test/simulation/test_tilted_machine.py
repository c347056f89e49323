# SPDX-License-Identifier: Apache-2.0
"""A table along any axis: its curves are those of the truth, and what is hidden in it is named."""

import numpy as np
import pytest

from rosette_ros.analysis import diagnose
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import BallNotFound, Machine, MachineConfig

N, SEEDS = 6, 20
AXES = {'x': (1, 0, 0), 'y': (0, 1, 0), '-z': (0, 0, -1), 'oblique': (0.5, 0, 0.75**0.5)}


def machine(axis, seed=1, n=N, azimuth_deg=0.0, **groups):
    """Return the machine with a table along an axis."""
    return Machine(MachineConfig().changed(
        seed=seed, plate={'balls': n}, placement={'axis': axis, 'azimuth_deg': azimuth_deg}, **groups))


@pytest.mark.parametrize('name', AXES)
def test_normalised_errors_are_those_of_noise(name):
    """Over 20 seeds, ball 1 at another azimuth in each: (curve - truth) / u has an rms of 0.8 to 1.2."""
    errors = []
    for seed in range(SEEDS):
        made = machine(AXES[name], seed, azimuth_deg=17.0 * seed)
        run, alignment, _ = made.calibrate(plan(N))
        assert run.rotation[:, 2] == pytest.approx(np.array(AXES[name]) / np.linalg.norm(AXES[name]), abs=1e-3)
        motions = fit(run).error_motions
        errors.append((motions.values - remove_gauge(made.table_truth(frame=alignment.frame))) / motions.u)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2
    assert all(0.7 < one < 1.3 for one in np.sqrt(np.mean(np.square(errors), axis=(0, 1))))


def test_without_noise_the_curves_do_not_depend_on_the_axis():
    """The same table, plate and clamping stood another way up: the same curves within the second order."""
    quiet = {'probing': {'repeatability_um': 0.0}, 'cmm': {'residual_share': 0.0}, 'timing': {'jitter_s': 0.0}}
    upright, *others = (fit(machine(axis, **quiet).run(plan(N))).error_motions.values
                        for axis in ((0, 0, 1), *AXES.values()))
    for other in others:
        assert np.abs(other - upright)[:, :3].max() < 1e-11
        assert np.abs(other - upright)[:, 3:].max() < 1e-10


HIDDEN = {
    'cmm_reversal': {'kind': 'cmm_reversal', 'value_um': [1.2, 0.9, 1.0]},
    'ball_sag': {'kind': 'ball_sag', 'ball': 2, 'sag_um': [0.6, 1.5, 0.9]}}


@pytest.mark.parametrize(('name', 'hidden'), [('oblique', 'cmm_reversal'), ('x', 'ball_sag')])
def test_what_is_hidden_is_named(name, hidden):
    """Ball 1 is at 30 degrees, so that the axes of table and CMM differ."""
    run = machine(AXES[name], 3, N, 30.0, hidden=[HIDDEN[hidden]]).run(plan(N, 'sensitive'))
    found = diagnose(run)
    assert found.missing == (hidden,)
    assert not found.unexplained
    if hidden == 'cmm_reversal':
        for one in found.candidates[0].parameters:
            true = 1e-6 * HIDDEN[hidden]['value_um']['xyz'.index(one.name[-1])]
            assert abs(one.value - true) < 4 * one.u


def test_equal_sag_of_all_balls_is_absorbed_by_the_cmm():
    """It depends on the CMM position alone: nothing is missing, and no curve is changed."""
    sag = [{'kind': 'ball_sag', 'sag_um': [0.3, 1.2, 0.4]}]
    with_, without = (fit(machine(AXES['x'], hidden=hidden).run(plan(N))) for hidden in (sag, []))
    assert np.abs(with_.error_motions.values - without.error_motions.values)[:, :3].max() < 1e-9
    assert with_.rms == pytest.approx(without.rms, rel=0.01)
    assert np.abs(with_.cmm - without.cmm).max() > 1e-7


@pytest.mark.parametrize('name', AXES)
def test_touches_are_about_the_pole(name):
    """A ball is touched on the free side; a pole near it gives the same centre, one behind the plate is refused."""
    quiet = {'probing': {'repeatability_um': 0.0}, 'cmm': {'residual_share': 0.0}}
    made = machine(AXES[name], **quiet)
    axis = np.array(AXES[name]) / np.linalg.norm(AXES[name])
    centre = made.measure(1, 2).centre
    assert machine(AXES[name], **quiet).measure(1, 2, pole=axis).centre == pytest.approx(centre, abs=1e-15)
    aside = axis_rotation(axis) @ [0.6, 0, 0.8]
    assert machine(AXES[name], **quiet).measure(1, 2, pole=aside).centre == pytest.approx(centre, abs=1e-12)
    with pytest.raises(BallNotFound, match=r'expected a pole on the free side of the plate, .* check the axis'):
        made.measure(1, 3, pole=-axis)


def test_repeatability_is_alike_in_all_directions():
    """Also where the pole is oblique to the axes of the CMM."""
    one = np.ones(2000, dtype=int)
    centre = machine((1, 1, 1), cmm={'residual_share': 0.0}).measure_many(one, one, one).centre
    spread = np.cov(centre.T) / 1e-7**2
    assert spread == pytest.approx(np.eye(3), abs=0.12)


@pytest.mark.parametrize(('axis', 'words'), [
    ([0, 0, 0], r'placement.axis: expected 3 numbers that are not all 0, found \[0.0, 0.0, 0.0\]'),
    ([0, 1], 'placement.axis'), ([0, float('nan'), 1], r'placement.axis.2: expected a finite number'),
    ('up', 'placement.axis: expected a list')])
def test_a_bad_axis_is_refused_in_one_line(axis, words):
    """By its key."""
    with pytest.raises(InvalidConfig, match=words) as caught:
        MachineConfig().changed(placement={'axis': axis})
    assert '\n' not in str(caught.value)
