# SPDX-License-Identifier: Apache-2.0
"""Four-axis errors (ISO 10360-3) that six error motions make, against spheres on a table that is a rigid body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.core.uncertainty.error_summary import four_axis_errors

NANOMETRE = 1e-9


def motions(values, n=12, u=0.0):
    """Return error motions of values (n, 6) with one uncertainty, m and rad."""
    return ErrorMotions(nominal_angles(n), values, np.full((n, 6), u))


def measured(values, radius, height):
    """Return FR, FT, FA of A and B: spheres that stand on a table of rotation matrices, in coordinates that turn."""
    angle = nominal_angles(len(values))
    values = values - values.mean(axis=0)
    out = []
    for sphere in (np.array([radius, 0.0, height]), np.array([-radius, 0.0, 0.0])):
        centres = []
        for phi, row in zip(angle, values, strict=True):
            turn = Rotation.from_rotvec([0, 0, phi])
            there = row[:3] + (Rotation.from_rotvec(row[3:]) * turn).apply(sphere)
            centres.append(turn.inv().apply(there))
        x, y, z = np.ptp(centres, axis=0)
        out.append((x, y, z))
    return np.array(out)


@pytest.mark.parametrize('seed', range(3))
def test_spheres_on_a_rigid_table_show_the_same(seed):
    """Radial, tangential and axial ranges of both spheres, at two places."""
    values = np.random.default_rng(seed).normal(0, 1e-6, (12, 6)) * [1, 1, 1, 5, 5, 5]
    for radius, height in ((0.2, 0.2), (0.4, 0.8)):
        found = four_axis_errors([motions(values)], radius, height)
        assert [one.sphere for one in found] == ['A', 'B']
        assert [(one.radius, one.height) for one in found] == [(radius, height), (radius, 0.0)]
        assert np.allclose([one.ranges for one in found], measured(values, radius, height), atol=NANOMETRE)


def test_each_motion_alone_shows_where_it_does():
    """Axial motion in FA, positioning in FT at the radius, tilt in FR of the higher sphere and FA of both."""
    wave, none = np.cos(2 * nominal_angles(12)), np.zeros(12)
    alone = {curve: four_axis_errors([motions(1e-6 * np.stack([
        wave if one == curve else none for one in CURVES], axis=-1))], 0.2, 0.4) for curve in ('ctz', 'crz', 'cry')}
    assert np.allclose([one.ranges for one in alone['ctz']], [[0, 0, 2e-6]] * 2, atol=1e-15)
    assert np.allclose([one.ranges for one in alone['crz']], [[0, 4e-7, 0]] * 2, atol=1e-15)
    upper, lower = (one.ranges for one in alone['cry'])
    assert lower[0] == lower[1] == 0 < lower[2] and upper[0] > 3e-7 and upper[2] == pytest.approx(lower[2])


def test_how_plate_and_axis_lie_makes_no_four_axis_error():
    """A mean motion, and what turns with the table: eccentricity and tilt of the plate."""
    angle = nominal_angles(12)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    values = np.hstack([1e-5 * around, np.zeros((12, 1)), 1e-5 * around, np.zeros((12, 1))]) + 3e-6
    for one in four_axis_errors([motions(values)], 0.2, 0.4):
        assert one.ranges.max() < 1e-15


def test_the_range_of_both_senses_contains_their_reversal():
    """Two sets of curves that differ by a constant turn: FT grows by it, FR and FA by nothing."""
    values = np.random.default_rng(3).normal(0, 1e-6, (12, 6))
    other = values + 1e-5 * np.eye(6)[5]
    (one, _), (both, _) = (four_axis_errors(some, 0.2, 0.3) for some in (
        [motions(values)], [motions(values), motions(other)]))
    assert np.allclose(both.ranges - one.ranges, [0, 2e-6, 0], atol=1e-15)


def test_u_covers_what_noise_does_to_a_range():
    """Of 2000 draws about curves of tens of micrometres 95 % and more are within U, which is at most twice that."""
    rng, wave = np.random.default_rng(1), 2e-5 * np.cos(2 * nominal_angles(12) + 0.3)
    values, u = np.stack([wave] * 6, axis=-1), np.array([1, 1, 1, 6, 6, 6]) * 1e-7
    exact = four_axis_errors([motions(values, u=u)], 0.2, 0.3)
    for place, one in enumerate(exact):
        off = np.array([four_axis_errors([motions(values + rng.normal(0, 1, (12, 6)) * u)], 0.2, 0.3)[place].ranges
                        for _ in range(2000)]) - one.ranges
        inside = np.mean(np.abs(off) <= 2 * one.u, axis=0)
        assert (inside > 0.95).all()
        assert (2 * one.u < 2 * np.quantile(np.abs(off), 0.95, axis=0)).all()
