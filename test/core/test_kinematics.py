# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies carry points as products of rotation matrices do, one run or many trials at once."""

import numpy as np
from scipy.linalg import expm

from rosette_ros.core.model.kinematics import axis_tilt, moved, on_table
from rosette_ros.core.run.geometry import nominal_angles, rotate_z

RNG = np.random.default_rng(1)


def matrix(vector):
    """Return the rotation matrix of a rotation vector by the exponential of its cross product."""
    x, y, z = vector
    return expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))


def test_a_table_turns_and_moves_points():
    """R(Theta) R_z(angle) p + T of each trial and reading, large rotations too."""
    points, angle, curves = RNG.standard_normal((4, 7, 3)), RNG.standard_normal(7), RNG.standard_normal((4, 7, 6))
    found = on_table(points, angle, curves)
    for k, i in np.ndindex(4, 7):
        wanted = matrix(curves[k, i, 3:]) @ matrix([0, 0, angle[i]]) @ points[k, i] + curves[k, i, :3]
        assert np.abs(found[k, i] - wanted).max() < 1e-14
    assert np.array_equal(moved(points, np.zeros(3)), points)
    assert np.abs(moved(points, np.array([0, 0, 0.3])) - rotate_z(0.3, points)).max() < 1e-15


def test_the_tilt_of_the_axis_is_what_all_deviations_have_in_common():
    """Height and higher harmonics are none; positions without a reading are left out."""
    angle, lever = nominal_angles(12), 0.2
    cmm = np.zeros((2, 12, 3))
    cmm[0, :, 2] = lever * (3e-5 * np.sin(angle) + 2e-5 * np.cos(angle)) + 1e-6 + 1e-6 * np.cos(3 * angle)
    cmm[1, :, 2] = lever * 1e-5 * np.sin(angle)
    assert np.abs(axis_tilt(cmm, lever) - [[3e-5, -2e-5, 0], [1e-5, 0, 0]]).max() < 1e-18
    cmm[:, 4] = np.nan
    assert np.abs(axis_tilt(cmm, lever)[1] - [1e-5, 0, 0]).max() < 1e-18
