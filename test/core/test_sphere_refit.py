# SPDX-License-Identifier: Apache-2.0
"""What single touches show: known forms of balls and of the probe are found where they are, and nowhere else."""

import numpy as np
import pytest
from ideal_cell import ideal_cell

from rosette_ros.core.run.scheme import plan
from rosette_ros.core.run.sphere_refit import RINGS, SECTORS, TouchedBalls, fields, refit_spheres
from rosette_ros.simulation import Machine

N = 6
LOBES = {'kind': 'ball_lobes', 'ball': 3, 'height_um': 0.4, 'order': 2, 'phase_deg': 30}
LOBING = {'kind': 'probe_lobing', 'height_um': 0.3, 'order': 2}
ONE_PICOMETRE = 1e-12


def refit_of(hidden=(), **groups):
    """Return the spheres fitted to the touches of a whole run of an ideal cell that hides something."""
    machine = Machine(ideal_cell(plate={'balls': N}, hidden=list(hidden), **groups))
    _, alignment, readings = machine.calibrate(plan(N, 'random'))
    return refit_spheres(TouchedBalls(
        np.arange(1, N * N + 1), readings.table_position, readings.ball, readings.table_angle, readings.centre,
        np.full(N * N, machine.pattern.tip), np.repeat(np.arange(N * N), 20), readings.touch_point.reshape(-1, 3),
        readings.touch_normal.reshape(-1, 3), readings.touch_time.ravel(), alignment.frame.rotation))


def expected(direction, height, order, phase=0.0):
    """Return lobes of a surface at directions (T, 3), m."""
    azimuth = np.arctan2(direction[:, 1], direction[:, 0])
    return height * np.hypot(direction[:, 0], direction[:, 1]) * np.cos(order * (azimuth - phase))


def test_round_balls_leave_nothing():
    """Radii, centres and residuals of an ideal cell: rounding."""
    refit = refit_of()
    assert np.abs(refit.radius - 7.5e-3).max() < ONE_PICOMETRE
    assert refit.moved.max() < ONE_PICOMETRE
    assert np.abs(refit.residual).max() < ONE_PICOMETRE
    assert refit.lobing.systematic < ONE_PICOMETRE


def test_lobes_of_a_ball_are_found_on_it_and_turn_with_the_plate():
    """Two lobes at 30 degrees on ball 3: height and place to 1 %, and none of it on another ball."""
    refit = refit_of([LOBES])
    on_ball = refit.touched.ball[refit.touched.owner] == 3
    forms = refit.ball_forms
    assert refit.balls.tolist() == list(range(1, N + 1))
    assert int(np.argmax(forms.systematic)) == 2
    phi = refit.touched.table_angle[refit.touched.owner][on_ball]
    turned = np.stack([np.cos(phi), np.sin(phi)])
    own = np.column_stack([refit.direction[on_ball, 0] * turned[0] + refit.direction[on_ball, 1] * turned[1],
                           refit.direction[on_ball, 1] * turned[0] - refit.direction[on_ball, 0] * turned[1],
                           refit.direction[on_ball, 2]])
    lobes = expected(own, 4e-7, 2, np.deg2rad(30))
    assert np.abs(refit.residual[on_ball] - lobes).max() < 1e-10  # second order, and the sphere is free of them
    assert np.abs(refit.residual[~on_ball]).max() < ONE_PICOMETRE
    found = forms.mean[2].ravel()[fields(own)]
    assert np.abs(found - lobes).max() < 0.01 * 4e-7
    assert forms.systematic[[0, 1, 3, 4, 5]].max() < 0.05 * forms.systematic[2]


def test_lobing_of_the_probe_is_found_on_all_balls_and_does_not_turn():
    """Every ball shows it in the same directions, and no ball has a form."""
    refit = refit_of([LOBING])
    lobes = expected(refit.approach, 3e-7, 2)
    assert np.abs(refit.lobing.at(fields(refit.approach)) - lobes).max() < 1e-10
    assert refit.lobing.systematic == pytest.approx(np.sqrt(np.mean(lobes**2)), rel=1e-3)
    assert refit.ball_forms.systematic.max() < 1e-10


def test_both_are_told_apart_in_noise():
    """Touch noise of 0.13 um: lobing of 0.3 um and lobes of 0.4 um are found; the scatter is that of the touches."""
    refit = refit_of([LOBES, LOBING], probing={'repeatability_um': 0.1})
    machine = Machine(ideal_cell(probing={'repeatability_um': 0.1}))
    lobes = expected(refit.approach, 3e-7, 2)
    assert refit.lobing.systematic == pytest.approx(np.sqrt(np.mean(lobes**2)), rel=0.05)
    around = np.sqrt(np.mean(np.hypot(*refit.direction[:, :2].T)**2))
    assert refit.ball_forms.systematic[2] == pytest.approx(4e-7 * around / np.sqrt(2), rel=0.1)
    assert np.delete(refit.ball_forms.systematic, 2).max() < 1e-7
    noise = machine.pattern.touch_noise * np.sqrt(16 / 20)  # four of twenty touches determine the sphere
    assert refit.ball_forms.scatter == pytest.approx(noise, rel=0.15)


def test_noise_alone_is_not_a_form():
    """Means of noise are not taken for a systematic part: the standard deviation of a touch is."""
    refit = refit_of(probing={'repeatability_um': 0.1})
    noise = Machine(ideal_cell(probing={'repeatability_um': 0.1})).pattern.touch_noise
    assert refit.sigma == pytest.approx(noise, rel=0.1)
    assert refit.lobing.systematic < 0.3 * noise
    assert np.median(refit.ball_forms.systematic) < 0.5 * noise


def test_dust_is_one_touch():
    """The one with the largest residual, and its ball moves by what the fit makes of it."""
    refit = refit_of([{'kind': 'touch_dust', 'thickness_um': 2.0, 'touch': 7, 'at_h': 0.3}])
    place = int(np.argmax(np.abs(refit.residual)))
    assert place % 20 == 6
    assert refit.form[place // 20] > 1e-6
    assert np.sum(refit.form > 1e-9) == 1


def test_fields_of_directions():
    """From the pole to the other, centred on +x; the last one holds the lower pole."""
    direction = np.array([[0, 0, 1.0], [1, 0, 0], [np.cos(-0.01), np.sin(-0.01), 0], [0, 1, 0], [0, 0, -1]])
    assert fields(direction).tolist() == [0, 7 * SECTORS, 7 * SECTORS, 7 * SECTORS + 6, (RINGS - 1) * SECTORS]
