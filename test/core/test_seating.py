# SPDX-License-Identifier: Apache-2.0
"""How plate and table lie is taken off ball centres; what is neither stays."""

import numpy as np

from rosette_ros.core.run.geometry import TWO_PI, rotate_z
from rosette_ros.core.run.scheme import nominal_places, plan
from rosette_ros.core.run.seating import unseated
from rosette_ros.simulation import Machine, MachineConfig


def test_a_plate_that_lies_otherwise_leaves_nothing():
    """0.2 mm of eccentricity, 0.3 mrad of tilt and turn, a larger circle, an axis 50 µm from where it was found; a ball
    that is 3 µm too high stays so, but for what it turns the plate."""
    n, radius = 8, 0.18
    position, ball = (one.ravel() for one in np.meshgrid(np.arange(1, n + 1), np.arange(1, n + 1)))
    angle = TWO_PI * (position - 1) / n
    expected = nominal_places(n, radius, position, ball)
    own = rotate_z(-angle, expected)  # on the plate
    turn = np.array([3e-4, -2e-4, 1e-4])
    moved = rotate_z(angle, own + np.array([2e-4, -1e-4, 5e-5]) + np.cross(turn, own) + 2e-5 * own)
    assert np.abs(moved - expected).max() > 2e-4
    moved = moved + np.array([5e-5, 0, 0]) + np.cross([0, 1e-4, 0], expected)
    assert np.abs(unseated(moved, expected, angle)).max() < 1e-12
    moved[ball == 3, 2] += 3e-6
    left = unseated(moved, expected, angle)[:, 2]
    np.testing.assert_allclose(left[ball == 3], 3e-6 * (1 - 3 / n), atol=1e-12)  # mean and two slopes of n balls


def test_a_measured_run_shows_its_errors_and_not_its_eccentricity():
    """A simulated plate lies 0.2 mm beside the axis, its balls are up to 50 µm from their places; each keeps its own
    distance in all table positions, but for errors of table and CMM of a few µm."""
    run = Machine(MachineConfig().changed(plate={'balls': 6})).run(plan(6, 'random'))
    expected = nominal_places(run.n, run.radius, run.table_position, run.ball)
    left = np.linalg.norm(unseated(run.centre, expected, run.table_angle), axis=1)
    assert np.linalg.norm(run.centre - expected, axis=1).max() > 2e-4
    assert left.max() < 1e-4
    assert max(np.ptp(left[run.ball == ball]) for ball in range(1, 7)) < 5e-6
    assert unseated([], [], []).shape == (0, 3)
