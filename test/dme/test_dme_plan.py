# SPDX-License-Identifier: Apache-2.0
"""Plans that are refused in words before anything moves, for all their balls."""

import numpy as np
import pytest
from scripted_server import settings_of

from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.dme.dme_plan import PlannedBall, all_balls, refuse_plan, refuse_unsafe_plan
from rosette_ros.dme.probe_path import UnsafePath
from rosette_ros.dme.rotary_table import TableState


@pytest.mark.parametrize(('changes', 'said'), [
    ({'path': {'stand_off_mm': 40.0, 'clearance_mm': 80.0}, 'table': {'balls': 12}},
     'touch .*: expected at least 20 mm between tip and '),
    ({'table': {'balls': 36}}, 'expected at least 5 mm between tip and ball 2, found 4.8; see path.stand_off_mm'),
    ({'table': {'radius_mm': 350.0}}, r'table position 1, ball 1: .*expected a tip within the box \(0, 0, -400\) to'),
    ({'ball': {'shaft_length_mm': 5.0}}, 'between tip and plate, found .*; see ball.shaft_length_mm'),
    ({'ball': {'shaft_radius_mm': 16.0}}, 'expected at least 5 mm between tip and the shaft of the ball, found'),
])
def test_plans_that_are_refused(changes, said):
    """With table position, ball, step and setting."""
    with pytest.raises(UnsafePath, match=said):
        refuse_unsafe_plan(settings_of(**changes))


def test_every_place_is_checked_once():
    """Six balls at six table positions are at six places; known ways are not checked again, other touches are."""
    settings = settings_of()
    ways = refuse_unsafe_plan(settings)
    assert len(ways) == 6
    unsafe = settings_of(path={'box_low_mm': [0, 0, 0], 'box_high_mm': [1, 1, 1]})
    assert refuse_unsafe_plan(unsafe, known=ways) == ways
    with pytest.raises(UnsafePath, match='table position 1, ball 1: .*expected a tip within the box'):
        refuse_unsafe_plan(unsafe, [one._replace(touches=6) for one in all_balls(unsafe)], ways)


def test_unequal_pitch_is_checked_everywhere():
    """A ball with its neighbour 28 degrees off at one place is another way than one alone there."""
    settings = settings_of(table={'balls': 3, 'azimuths_deg': [0, 28, 120]})
    assert len(refuse_unsafe_plan(settings)) == 9


def planned(balls=6, radius=0.1825, turned=0.0, shift=(0.0, 0.0, 0.0), **changes):
    """Return a plan as a sequencer asks for it: every ball at every position, forward."""
    out = []
    for position in range(balls):
        for ball in range(balls):
            angle = TWO_PI * (position + ball) / balls + np.deg2rad(turned)
            place = np.array([0.35, 0.26, -0.3]) + radius * np.array([np.cos(angle), np.sin(angle), 0.0]) + shift
            out.append(PlannedBall(balls, position + 1, ball + 1, place, TWO_PI * position / balls, 1,
                                   np.array([0.0, 0.0, 1.0]))._replace(**changes))
    return out


def test_a_plan_that_fits():
    """Also a few millimetres off, as two persons teach a table."""
    assert len(refuse_plan(settings_of(), planned(), TableState(0.0))) == 6
    assert len(refuse_plan(settings_of(), planned(shift=(2e-3, -1e-3, 1e-3)), TableState(0.0))) == 6


@pytest.mark.parametrize(('changes', 'plan', 'said'), [
    ({}, planned(12), 'table position 1, ball 1: expected a plan of 6 balls, as the settings have (table.balls), '
                      'found one '
                      'of 12'),
    ({}, planned(radius=0.21), 'table position 1, ball 1: expected the ball within 20 mm of (532, 260, -300) mm, where '
                               'the settings have it (table), found (560, 260, -300): 27.5 mm off, turned by +0.0 deg '
                               'about the table axis, +27.5 mm in radius, +0.0 mm along the axis'),
    ({}, planned(turned=-30.0), 'turned by -30.0 deg about the table axis, +0.0 mm in radius'),
    ({}, planned(shift=(0, 0, 0.05)), '50.0 mm off, turned by +0.0 deg about the table axis, +0.0 mm in radius, '
                                      '+50.0 mm along the axis'),
    ({}, planned(pole=np.array([1.0, 0.0, 0.0])), 'expected the pole along (0, 0, 1), table.axis of the settings'),
    ({}, planned(touches=7), 'table position 1, ball 1: touches: expected one of'),
    ({}, planned(ball=7), 'expected one of the 6 balls of the settings (table.balls), found ball 7'),
    ({}, planned(centre=np.full(3, np.nan)), 'expected the ball within 20 mm of'),
    ({'path': {'box_low_mm': [0, 0, -285]}}, planned(), 'table position 1, ball 1: touch '),
    ({'path': {'box_low_mm': [175, 0, -400]}}, planned(), 'table position 1, ball 4: above the ball: expected a tip '
                                                          'within the box'),
    ({'table': {'turn': 'none'}}, planned(), 'table position 2, ball 1: table angle 60 deg: expected a table that can '
                                             'be turned, found table.turn: none'),
])
def test_plans_of_others_that_are_refused(changes, plan, said):
    """In words that say how far plan and settings differ, with table position and ball."""
    with pytest.raises(InvalidPlan) as caught:
        refuse_plan(settings_of(**changes), plan, TableState(0.0))
    assert said in str(caught.value)


def test_balls_of_unequal_pitch_are_known_by_their_places():
    """Their numbers are places on the circle of the plan."""
    settings = settings_of(table={'balls': 12, 'azimuths_deg': [0, 90, 210]})
    whole = planned(12)
    assert refuse_plan(settings, [one for one in whole if one.ball in (1, 4, 8)], TableState(0.0))
    with pytest.raises(InvalidPlan, match='table position 1, ball 2: expected the ball within 20 mm of'):
        refuse_plan(settings, [one for one in whole if one.ball in (1, 2)], TableState(0.0))
