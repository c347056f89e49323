# SPDX-License-Identifier: Apache-2.0
"""Rotations, frames, and finding the table axis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.geometry import (
    TWO_PI,
    Frame,
    rigid_motion,
    rotate_z,
    rotation_matrix,
    same_angles,
    table_frame,
    travel_to,
    wrap,
)

NANOMETRE = 1e-9
component = st.floats(-3, 3)


@given(st.tuples(component, component, component))
def test_rotation_matrix_is_rodrigues(vector):
    """Rotation matrices equal those of SciPy, small angles included."""
    for scale in (1.0, 1e-6, 1e-12):
        expected = Rotation.from_rotvec(np.array(vector) * scale).as_matrix()
        assert np.abs(rotation_matrix(np.array(vector) * scale) - expected).max() < 4e-16 * 4


@given(st.tuples(component, component, component), st.tuples(component, component, component))
def test_frames_go_there_and_back(vector, origin):
    """to_inner undoes to_outer, and quaternions bring the rotation back."""
    frame = Frame(rotation_matrix(np.array(vector)), np.array(origin))
    points = np.arange(12.0).reshape(4, 3)
    assert np.allclose(frame.to_inner(frame.to_outer(points)), points, atol=1e-13)
    again = Frame.from_quaternion(frame.quaternion(), frame.origin)
    assert np.abs(again.rotation - frame.rotation).max() < 2e-15
    assert frame.quaternion()[3] >= 0


@given(st.tuples(component, component, component), st.tuples(component, component, component))
def test_a_rigid_motion_is_found_from_displacements(turn, shift):
    """Shift and small rotation of a real motion, a micro of each, also where some places are not known."""
    places = 0.2 * np.random.default_rng(1).standard_normal((7, 3))
    moved = Frame(rotation_matrix(1e-6 * np.array(turn)), 1e-6 * np.array(shift)).to_outer(places) - places
    moved[2] = np.nan
    found = rigid_motion(moved, places)
    np.testing.assert_allclose(found, 1e-6 * np.array([shift, turn]), atol=3e-11)


@given(st.floats(-50, 50))
def test_wrap(angle):
    """Wrapping keeps the direction and lands in [-pi, pi)."""
    assert -np.pi <= wrap(angle) < np.pi
    assert np.isclose(np.exp(1j * wrap(angle)), np.exp(1j * angle))


@pytest.mark.parametrize('n', [3, 6, 12])
def test_table_frame_is_found(n):
    """A table somewhere in the machine, tilted by 0.3 mrad, is found to a nanometre."""
    true = Frame(rotation_matrix(np.array([2e-4, -3e-4, 0.4])), np.array([0.3, 0.25, 0.12]))
    phi = 2 * np.pi * np.arange(n) / n
    ball = np.array([0.1825, 0.0, 0.0])
    axis_points = true.to_outer(rotate_z(phi, ball))
    plane_points = axis_points
    frame = table_frame(axis_points, plane_points)
    assert np.abs(frame.origin - true.origin).max() < NANOMETRE
    assert np.abs(frame.rotation - true.rotation).max() < NANOMETRE
    assert np.allclose(frame.rotation.T @ frame.rotation, np.eye(3), atol=1e-15)


def test_x_axis_goes_through_ball_one():
    """An eccentric, tilted plate: ball 1 has y = 0, and the balls' plane passes the origin."""
    n = 12
    phi = 2 * np.pi * np.arange(n) / n
    plate = Frame(rotation_matrix(np.array([1e-4, 2e-4, 3e-4])), np.array([2e-4, -1e-4, 5e-5]))
    balls = plate.to_outer(rotate_z(phi, np.array([0.1825, 0.0, 0.0])))
    frame = table_frame(rotate_z(phi, balls[0]), balls)
    seen = frame.to_inner(balls)
    assert abs(seen[0, 1]) < 1e-15
    assert np.abs(frame.rotation[:, 2] - [0, 0, 1]).max() < 1e-12
    normal = np.linalg.svd(seen - seen.mean(axis=0))[2][2]
    assert abs(normal @ seen.mean(axis=0)) < 1e-15


@pytest.mark.parametrize('points, words', [
    (np.zeros((2, 3)), 'expected at least 3 points'),
    (np.arange(9.0).reshape(3, 3), 'found points on a line'),
])
def test_points_that_span_no_circle(points, words):
    """An axis needs points that span a circle."""
    with pytest.raises(NotDeterminable, match=words):
        table_frame(points, np.eye(3))


def test_wrong_balls_are_noticed():
    """A plane of balls that stands on edge is a mix-up of targets."""
    phi = 2 * np.pi * np.arange(6) / 6
    circle = rotate_z(phi, np.array([0.1825, 0.0, 0.0]))
    with pytest.raises(NotDeterminable, match='found 90.0 deg between its normal and the axis'):
        table_frame(circle, circle[:, [0, 2, 1]])


def test_table_angles_are_the_same_within_a_microradian_and_whole_turns():
    """As many, in their order; 1 µrad is 0.1 µm at 100 mm."""
    angle = np.array([0.0, 2.0, 4.0])
    assert same_angles(angle, angle + 0.9e-6)
    assert same_angles(angle, angle + 2 * np.pi * np.array([1, 0, -2]))
    assert same_angles(angle, np.array([2 * np.pi - 0.9e-6, 2.0, 4.0]))
    assert not same_angles(angle, angle + np.array([0, 1.1e-6, 0]))
    assert not same_angles(angle, angle[:2])
    assert not same_angles(angle, angle[[0, 2, 1]])
    assert not same_angles(angle, np.array([0.0, np.nan, 4.0]))


@pytest.mark.parametrize('approach', [0, 1, -1])
def test_a_table_that_stands_does_not_turn_by_the_rounding_of_its_angle(approach):
    """Twelve balls at each of twelve positions, three turns in one sense: 3 x 360 deg less the first step."""
    travel, step = 0.0, TWO_PI / 12
    for turn in range(3 * 12):
        for _ in range(12):
            travel = travel_to(travel, (turn % 12) * step * (-1 if approach < 0 else 1), approach)
    assert travel == pytest.approx((35 * step) * (-1 if approach < 0 else 1), abs=1e-9)
