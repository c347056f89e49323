# SPDX-License-Identifier: Apache-2.0
"""The machine moved by hand touches what the machine would have touched in its readings."""

import numpy as np
import pytest

from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.touches import fit_spheres
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.touch_by_touch import TouchByTouch

HIDDEN = (
    {'kind': 'frame_drift', 'rate_um_per_h': [3.0, 0.0, -1.0]}, {'kind': 'table_backlash', 'width_urad': 5.0},
    {'kind': 'asynchronous_motion', 'order': 0.43, 'radial_um': 0.5}, {'kind': 'table_warmup', 'growth_um': 1.0,
                                                                      'scale_turns': 2.0},
    {'kind': 'ball_form', 'ball': 2, 'order': 3, 'centre_um': 2.0}, {'kind': 'cmm_reversal', 'value_um': [0.4, 0.3, 0]})


@pytest.fixture
def machines():
    """Return the same machine twice, with noise and hidden effects, once to be moved by hand."""
    config = MachineConfig().changed(plate={'balls': 6}, hidden=HIDDEN, table={'positioning_urad': 20.0})
    return Machine(config), TouchByTouch(Machine(config))


def test_it_touches_what_the_machine_measures(machines):
    machine, by_hand = machines
    travel = np.cumsum([0, 1, 0, -2, 0, 1]) * TWO_PI / 6
    position, ball = np.array([1, 2, 2, 6, 6, 1]), np.array([1, 2, 5, 3, 2, 4])
    aim = machine.rough_frame.to_outer(machine._nominal[(position + ball - 2) % 6])
    readings = machine.measure_many(position, ball, np.array([1, 1, 1, -1, -1, 1]), aim)
    direction = by_hand.pattern.direction @ by_hand.pattern.axes.T
    touch_s = machine.config.timing.touch_s
    for place, way in enumerate(travel):
        if not place or way != travel[place - 1]:
            by_hand.turn(way, readings.began[place])
        times = readings.ended[place] - touch_s * np.arange(direction.shape[0])[::-1]
        touches = [by_hand.touch(aim[place], one, time) for one, time in zip(direction, times, strict=True)]
        assert {touch.ball for touch in touches} == {ball[place]}
        sphere = fit_spheres(np.array([touch.tip for touch in touches])[None])
        # The machine counts turns by divisions, here they count to where the table stopped: 20 urad of them.
        np.testing.assert_allclose(sphere.centre[0], readings.centre[place], rtol=0, atol=1e-11)
        assert sphere.form[0] == pytest.approx(readings.form_error[place], abs=1e-14)
        assert by_hand.travel % TWO_PI == pytest.approx(readings.table_angle[place], abs=1e-12)
        assert by_hand.temperature(times[-1]) == pytest.approx(readings.temperature[place], abs=1e-9)


def test_a_line_beside_all_balls_touches_none(machines):
    _, by_hand = machines
    beside = by_hand.centres(0.0)[0] + [0.0, 1.01 * by_hand.reach, 0.0]
    assert by_hand.touch(beside, np.array([1.0, 0.0, 0.0]), 1.0) is None


def test_the_nearest_ball_on_the_way_is_touched(machines):
    _, by_hand = machines
    centre = by_hand.centres(0.0)
    way = (centre[3] - centre[0]) / np.linalg.norm(centre[3] - centre[0])
    assert by_hand.touch(centre[0], way, 1.0).ball == 4
    assert by_hand.touch(centre[0], -way, 1.0).ball == 1
    assert by_hand.touch(centre[0], way, 1.0, start=0.02).ball == 1, 'the search begins behind ball 4'


def test_balls_turn_with_the_table(machines):
    _, by_hand = machines
    at = by_hand.centres(0.0, np.array([0.0, TWO_PI / 6]))
    np.testing.assert_allclose(at[1, :-1], at[0, 1:], rtol=0, atol=5e-4)  # clamping and deviations of the plate
    by_hand.turn(TWO_PI / 6, 0.0)
    np.testing.assert_allclose(by_hand.centres(0.0), at[1], rtol=0, atol=2e-5)  # error motions, positioning
