# SPDX-License-Identifier: Apache-2.0
"""Touches, spheres and noise: geometry of the paper, least squares of scipy, statistics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ideal_cell import ideal_cell
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.touches import centre_factors, fit_spheres
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.machine import rotated
from rosette_ros.simulation.probing import ProbingSettings, TouchPattern, contact
from rosette_ros.simulation.random_streams import standard_normal

small = st.floats(-3, 3)
vectors = st.tuples(small, small, small).map(np.array)


def test_touches_are_those_of_the_paper():
    """20 touches, 5 circles of 4; top 1 mm below the pole, lowest 1 mm below the equator."""
    direction = TouchPattern(ProbingSettings(), 7.5e-3).direction
    height = 7.5 * direction[:, 2].reshape(5, 4)
    assert direction.shape == (20, 3)
    assert np.abs(np.linalg.norm(direction, axis=1) - 1).max() < 1e-15
    assert np.ptp(height, axis=1).max() < 1e-15
    assert height[0, 0] == pytest.approx(6.5)
    assert height[-1, 0] == pytest.approx(-1.0)


@given(centre=vectors, radius=st.floats(0.5, 50), off=vectors)
def test_sphere_fit_finds_any_sphere(centre, radius, off):
    """Touches on a sphere give its centre back, wherever the aim was."""
    direction = TouchPattern(ProbingSettings(), 7.5e-3).direction
    aim = (centre + 0.05 * radius * off / 3)[None, None]
    way = contact(aim, direction, centre[None, None], radius)
    found = fit_spheres(aim + way[..., None] * direction)
    assert np.abs(found.centre[0] - centre).max() < 1e-13 * max(radius, 10)
    assert found.radius[0] == pytest.approx(radius, abs=1e-13 * max(radius, 10))
    assert found.form[0] < 1e-13 * max(radius, 10)


@pytest.mark.parametrize('noise', [1e-7, 1e-5])
def test_sphere_fit_is_the_geometric_least_squares(noise):
    """Centre and form error agree with scipy's minimiser, for 0.1 and for 10 um of form."""
    rng = np.random.default_rng(4)
    direction = TouchPattern(ProbingSettings(), 7.5e-3).direction
    points = (1e-2 + noise * rng.standard_normal((30, 20, 1))) * direction
    found = fit_spheres(points)
    for k in range(30):
        def distances(x, touches=1e6 * points[k]):
            return np.linalg.norm(touches - x[:3], axis=1) - x[3]

        def slopes(x, touches=1e6 * points[k]):
            off = touches - x[:3]
            normal = off / np.linalg.norm(off, axis=1, keepdims=True)
            return np.column_stack([-normal, -np.ones(20)])

        best = least_squares(distances, [0, 0, 0, 1e4], slopes, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        # scipy stops where its sum of squares no longer changes: well below 1e-5 of the noise.
        assert np.abs(found.centre[k] - 1e-6 * best.x[:3]).max() < 1e-5 * noise
        assert np.abs(found.residual[k] - 1e-6 * best.fun).max() < 1e-5 * noise
        assert found.form[k] == pytest.approx(1e-6 * np.ptp(best.fun), abs=1e-5 * noise)


def test_sphere_fit_has_converged():
    """At the centre found the gradient of the sum of squares is zero to rounding."""
    rng = np.random.default_rng(5)
    direction = TouchPattern(ProbingSettings(), 7.5e-3).direction
    points = (1e-2 + 2e-6 * rng.standard_normal((200, 20, 1))) * direction
    off = points - fit_spheres(points).centre[:, None]
    distance = np.linalg.norm(off, axis=-1, keepdims=True)
    gradient = ((1 - distance.mean(axis=1, keepdims=True) / distance) * off).sum(axis=1)
    assert np.abs(gradient).max() < 1e-15


@given(vector=vectors, point=vectors, scale=st.sampled_from([0, 1e-9, 1e-5, 1]))
def test_rotations_are_exact(vector, point, scale):
    """Rotations of points agree with scipy's, from none to full turns."""
    vector = scale * vector
    expected = Rotation.from_rotvec(vector).apply(point)
    assert np.abs(rotated(vector[None, None], point[None, None])[0, 0] - expected).max() < 1e-14
    about_z = Rotation.from_rotvec([0, 0, vector[2]]).apply(point)
    got = rotate_z(vector[None, None, 2], point[None, None])[0, 0]
    assert np.abs(got - about_z).max() < 1e-14


@pytest.mark.parametrize(('touches', 'pole'), [(0, None), (9, (0.1, 0.2, 1.0))])
def test_touches_of_a_reading_give_its_centre(touches, pole):
    """The sphere through them is the centre that was sent, noise of the positioning included, to rounding."""
    machine = Machine(ideal_cell(probing={'repeatability_um': 0.5}))
    readings = machine.measure_many(*np.array([(1, 1, 1), (2, 3, -1), (5, 2, 1)]).T, touches=touches, pole=pole)
    found = fit_spheres(readings.touch_point, 12)
    assert np.abs(found.centre - readings.centre).max() < 1e-15
    assert np.abs(found.form - readings.form_error).max() < 1e-15
    assert np.abs(found.radius - machine.pattern.radius - machine.pattern.tip).max() < 1e-6
    assert readings.touch_time.mean(axis=1) == pytest.approx(readings.time, abs=1e-9)
    off = readings.touch_point - readings.centre[:, None]
    assert (np.vecdot(off, readings.touch_normal) > 0.99 * found.radius[:, None]).all()
    one = readings[1]
    assert (one.touch_point == readings.touch_point[1]).all()
    assert one.time == readings.time[1]


def test_every_coordinate_repeats_alike():
    """4000 readings of a ball: sd 0.1 um per axis, uncorrelated, normal, as configured."""
    one = np.ones(4000, dtype=int)
    machine = Machine(ideal_cell(probing={'repeatability_um': 0.1}))
    centre = 1e7 * (machine.measure_many(one, one, one).centre - machine.true_frame.to_outer(
        [machine.radius, 0, 0]))
    # sd of a sd of 4000 values: 0.011; of a correlation: 0.016; of a kurtosis: 0.077
    assert np.abs(centre.std(axis=0) - 1).max() < 0.045
    assert np.abs(centre.mean(axis=0)).max() < 0.064
    assert np.abs(np.corrcoef(centre.T) - np.eye(3)).max() < 0.064
    assert np.abs((centre**4).mean(axis=0) / (centre**2).mean(axis=0)**2 - 3).max() < 0.35


@pytest.mark.parametrize('share', [0.0, 1.0])
def test_shares_of_touches_and_positioning(share):
    """Noise of touches shows in the form error, noise of positioning does not."""
    one = np.ones(3000, dtype=int)
    machine = Machine(ideal_cell(probing={'repeatability_um': 0.1, 'touch_share': share}))
    readings = machine.measure_many(one, one, one)
    assert np.abs(1e7 * readings.centre.std(axis=0) - 1).max() < 0.055
    assert (readings.form_error.mean() > 1e-7) == (share == 1.0)


def test_centre_factors_of_touches_alone():
    """Touches alone scatter the centre by the linear problem: z worse than x and y."""
    rng = np.random.default_rng(6)
    pattern = TouchPattern(ProbingSettings(), 7.5e-3)
    points = (1e-2 + 1e-8 * rng.standard_normal((20000, 20, 1))) * pattern.direction
    factors = fit_spheres(points).centre.std(axis=0) / 1e-8
    assert factors == pytest.approx(centre_factors(pattern.direction), rel=0.025)
    assert factors[2] > 1.5 * factors[0]


def test_streams_belong_to_reading_and_seed():
    """The numbers of a reading do not depend on the others; seeds and readings share none."""
    whole = standard_normal(7, np.arange(100), 26)
    assert np.array_equal(standard_normal(7, [42], 26)[0], whole[42])
    other = standard_normal(8, np.arange(100), 26)
    both = np.concatenate([whole.ravel(), other.ravel()])
    assert np.unique(both).size == both.size


def test_streams_are_normal_and_independent():
    """Mean, variance, tails and neighbours of a million numbers are those of white noise."""
    numbers = standard_normal(1, np.arange(40000), 25)
    assert abs(numbers.mean()) < 5e-3
    assert abs(numbers.std() - 1) < 4e-3
    assert np.mean(np.abs(numbers) > 3) == pytest.approx(0.0027, rel=0.1)
    for first, second in ((numbers[1:], numbers[:-1]), (numbers[:, 1:], numbers[:, :-1])):
        assert abs(np.mean(first * second)) < 5e-3


def test_a_drift_acts_on_each_touch():
    """A ball that moves is seen where it was when its widest circles were touched."""
    still = ideal_cell(timing={'touch_s': 10.0})
    moving = still.changed(hidden=[{'kind': 'frame_drift', 'rate_um_per_h': [3.6, 0, 0]}])
    before, after = Machine(still).measure(1, 1), Machine(moving).measure(1, 1)
    assert after.time == pytest.approx(105.0)
    # 1 nm/s: x is measured by the touches at +x and -x, by the square of their distance from the pole.
    height = np.linspace(6.5, -1.0, 5) / 7.5
    moments = 10.0 * (4 * np.arange(5) + 2)
    seen = np.average(moments, weights=1 - height**2)
    assert after.centre[0] - before.centre[0] == pytest.approx(1e-9 * seen, abs=1e-13)
    assert 100e-9 < after.form_error < 250e-9
    assert before.form_error < 1e-15


def test_same_seed_same_noise():
    """Two machines of one seed differ by what the second hides, and by nothing else."""
    one = np.ones(5, dtype=int)
    hidden = [{'kind': 'frame_step', 'step_um': [1, 0, 0], 'at_h': 0.0}]
    plain = Machine(MachineConfig()).measure_many(one, one, one)
    moved = Machine(MachineConfig().changed(hidden=hidden)).measure_many(one, one, one)
    assert np.abs(moved.centre - plain.centre - [1e-6, 0, 0]).max() < 1e-11
