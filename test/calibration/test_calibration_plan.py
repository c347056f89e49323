# SPDX-License-Identifier: Apache-2.0
"""The plan of a calibration: phases around the n*n run."""

from dataclasses import replace

import numpy as np
import pytest
from rosette_msgs.msg import RunState

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.scheme import ORDERS, TURNINGS, plan
from rosette_ros.io.messages import Phase


def calibration(n=4, order='diagonal', turning='forward', repeats=3, drift_check=True):
    return plan_calibration(plan(n, order, 1, turning), 0.1, Frame.identity(), repeats, drift_check)


def test_phases_carry_the_numbers_of_the_message():
    """The enum and the message constants are the same."""
    for phase in Phase:
        assert getattr(RunState, f'PHASE_{phase.name}') == phase


def test_phases_follow_the_paper():
    """Repeats of ball 1, the axis, the plane, the run, and the first ball again."""
    made = calibration()
    targets = [made.target(index) for index in range(made.total)]
    assert made.total == 3 + 4 + 4 + 16 + 1
    assert [t.seq for t in targets] == list(range(1, 29))
    by_phase = {phase: [(t.table_position, t.ball) for t in targets if t.phase is phase]
                for phase in Phase}
    assert by_phase[Phase.REPEATABILITY] == [(1, 1)] * 3
    assert by_phase[Phase.ALIGNMENT] == [(1, 1), (2, 1), (3, 1), (4, 1),
                                         (1, 1), (1, 2), (1, 3), (1, 4)]
    assert sorted(by_phase[Phase.RUN]) == [(i, j) for i in range(1, 5) for j in range(1, 5)]
    assert by_phase[Phase.DRIFT_CHECK] == by_phase[Phase.RUN][:1]


def test_repeats_and_drift_check_can_be_left_out():
    """Without both, alignment and run remain."""
    made = calibration(repeats=0, drift_check=False)
    assert made.total == 8 + 16
    assert made.target(0).phase is Phase.ALIGNMENT


@pytest.mark.parametrize('order', ORDERS)
@pytest.mark.parametrize('turning', TURNINGS)
def test_table_stays_exactly_where_its_position_stays(order, turning):
    """The approach is 0 where the table stands as it is to be approached, and its sense where it does not."""
    made = calibration(5, order, turning)
    before = None
    for index in range(made.total):
        target, sense = made.target(index), made.approach[index]
        assert target.approach == (0 if (target.table_position, sense) == before else sense)
        before = target.table_position, sense


def test_a_clockwise_run_finds_position_1_approached_clockwise():
    """The alignment turns as the run begins, so that its readings at position 1, too, are approached as planned."""
    made = calibration(4, 'row', 'clockwise')
    targets = [made.target(index) for index in range(made.total)]
    assert {target.approach for target in targets} == {0, -1}
    assert (targets[0].table_position, targets[0].table_angle, targets[0].approach) == (1, 0.0, -1)
    assert [one.table_position for one in targets if one.phase is Phase.ALIGNMENT] == [1, 4, 3, 2, 1, 1, 1, 1]


def test_a_position_that_is_approached_from_both_sides_is_approached_twice():
    """A plan may measure one place twice, once from either side."""
    scheme = plan(3, 'row')
    both = replace(scheme, table_position=scheme.table_position.repeat(2), ball=scheme.ball.repeat(2),
                   approach=np.tile([1, -1], 9), touches=scheme.touches.repeat(2), session=scheme.session.repeat(2),
                   wait=scheme.wait.repeat(2))
    made = plan_calibration(both, 0.1, Frame.identity(), 0, drift_check=False)
    assert [made.target(index).approach for index in range(6, made.total)] == [0, *[-1, 1] * 8, -1]


def test_nominal_centre_is_at_the_cmm_position():
    """The nominal centre lies at azimuth 2 pi (k - 1) / n."""
    made = calibration(6)
    for index in range(made.total):
        target = made.target(index)
        azimuth = 2 * np.pi * (target.cmm_position - 1) / 6
        assert target.centre == pytest.approx([0.1 * np.cos(azimuth), 0.1 * np.sin(azimuth), 0])


def test_place_in_phase_counts_within_the_phase():
    """A person reads 2 of 8, not 5 of 28."""
    made = calibration()
    assert made.place_in_phase(0) == (1, 3)
    assert made.place_in_phase(4) == (2, 8)
    assert made.place_in_phase(27) == (1, 1)
