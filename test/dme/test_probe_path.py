# SPDX-License-Identifier: Apache-2.0
"""The path around a ball, and paths that are refused, in words, before anything moves."""

import numpy as np
import pytest
from scripted_server import error, measured, run, settings_of

from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.dme.probe_path import (
    UnsafePath,
    ball_path,
    distances,
    lift,
    lifted,
    obstacles,
    refuse_to_turn,
    refuse_unsafe,
)
from rosette_ros.dme.wire import ACK, DONE, Response

MICROMETRE = 1e-6


def sampled(path, tip, approach):
    """Return tip centres every 0.2 mm along a path, with the step that leads there."""
    points, place = [], None
    for step in path:
        for end in step.ways(tip, approach):
            begin = end if place is None else place
            for share in np.linspace(0, 1, max(int(np.linalg.norm(end - begin) / 2e-4), 2)):
                points.append((step, begin + share * (end - begin)))
            place = end
    return points


@pytest.mark.parametrize('axis', [(0, 0, 1), (1, 0, 0), (0, 0.5, 0.866), (0, 0, -1)])
@pytest.mark.parametrize('touches', [6, 9, 12, 20])
def test_a_path_stays_away_from_everything(axis, touches):
    """Held against points every 0.2 mm: neighbours, shafts and the ball itself, but for its touches."""
    settings = settings_of(table={'axis': list(axis), 'balls': 12},
                           path={'box_low_mm': [-1000] * 3, 'box_high_mm': [1000] * 3})
    frame = settings.table.frame
    balls = frame.to_outer(settings.table.balls_at(0.3))
    path = ball_path(settings, balls[4], frame.rotation[:, 2], touches)
    refuse_unsafe(settings, path, obstacles(settings, balls, 4))
    assert sum(step.normal is not None for step in path) == touches
    for step, point in sampled(path, 2.5e-3, 3e-3):
        off = frame.to_inner(point) - frame.to_inner(balls)
        gap = np.linalg.norm(off, axis=1) - 17.5e-3
        assert min(np.delete(gap, 4)) > 5e-3 - MICROMETRE
        assert gap[4] > (-MICROMETRE if step.is_near else 5e-3 - MICROMETRE)
        below = off[:, 2] < -15e-3
        assert (np.hypot(*off[below, :2].T) > 12.5e-3 - MICROMETRE).all()


def test_over_the_top_beyond_70_degrees():
    """The straight way between two directions comes to (r + tip + stand-off) cos(half the angle)."""
    settings = settings_of()
    path = ball_path(settings, settings.table.frame.to_outer(settings.table.balls_at(0))[0], [0, 0, 1])
    touched = [step.normal for step in path if step.normal is not None]
    over = {int(step.why.split()[-1]) for step in path if 'over the top' in step.why}
    for number in range(2, 21):
        angle = np.rad2deg(np.arccos(np.clip(touched[number - 2] @ touched[number - 1], -1, 1)))
        assert (number in over) == (angle > 70.5)


@pytest.mark.parametrize(('place', 'steps'), [
    ((350, 260, 0), 0), ((350, 260, -280), 1), ((552, 260, -300), 2), ((532.5, 260, -281), 2), ((10, 10, -390), 1)])
def test_lifting(place, steps):
    """From beside a ball away from it first; from above the clearance plane not at all."""
    settings = settings_of()
    balls = settings.table.frame.to_outer(settings.table.balls_at(0.0))
    path = lift(settings, 1e-3 * np.array(place), balls)
    assert len(path) == steps
    assert not path or path[-1].point[2] == pytest.approx(-0.240)


@pytest.mark.parametrize(('place', 'said'), [
    ((350, 260, -360), 'where the tip stands: expected at least 5 mm between tip and plate'),
    ((350, 260, 200), 'where the tip stands: expected a tip within the box'),
    ((532.5, 260, -330), 'expected at least 5 mm between tip and the shaft'),
])
def test_places_from_which_nothing_is_lifted(place, said):
    """A person moves the tip away."""
    settings = settings_of()
    with pytest.raises(UnsafePath, match=said):
        lift(settings, 1e-3 * np.array(place), settings.table.frame.to_outer(settings.table.balls_at(0.0)))


def test_turning():
    """Above the clearance plane, or outside of the ring that the balls sweep."""
    settings = settings_of()
    for place in [(350, 260, -240), (532, 260, 0), (350, 480, -300)]:
        refuse_to_turn(settings, 1e-3 * np.array(place))
    with pytest.raises(UnsafePath, match='not turn: expected the tip 60 mm over the balls, or 210 mm from '):
        refuse_to_turn(settings, 1e-3 * np.array([532, 260, -250]))


def test_dry_run_is_above_the_balls():
    """By the clearance."""
    settings = settings_of()
    path = ball_path(settings, settings.table.frame.to_outer(settings.table.balls_at(0))[0], [0, 0, 1])
    high = lifted(settings, path)
    assert all(step.normal is None for step in high)
    assert min(step.point[2] for step in high) > -0.3 + 0.015 + 0.0025 + 0.01


def test_distances():
    """Of ways from points: beside them, beyond their ends, and of ways without length."""
    starts, ends = np.array([[0, 0, 0], [1, 1, 1.0]]), np.array([[2, 0, 0], [1, 1, 1.0]])
    found = distances(starts, ends, np.array([[1, 1, 0], [3, 0, 0.0]]))
    assert np.allclose(found, [[1, 1], [1, np.sqrt(6)]])


def test_plates_of_any_pitch():
    """Balls where their azimuths say."""
    settings = settings_of(table={'azimuths_deg': [0, 100, 200], 'balls': 3})
    angle = np.arctan2(*settings.table.balls_at(TWO_PI / 4).T[[1, 0]])
    assert np.allclose(np.rad2deg(angle) % 360, [90, 190, 290])


def test_a_tip_that_is_not_lifted():
    """Clamped with a warning, or without a word: the table does not turn, although the command has ended well."""
    async def scene(server, cmm):
        for clamped, said in [
                (lambda tag: [*error(tag, 1, 504, 'Argument clamped')],
                 r'GoTo\(X\(350\), Y\(260\), Z\(-240\)\): error 0504 \(severity 1\): Argument clamped; expected a '
                 r'place '
                 'that the machine reaches, it went elsewhere'),
                (lambda tag: [Response(tag, ACK), Response(tag, DONE)],
                 r'lift to the clearance plane: expected the tip at \(350, 260, -240\) mm, found \(350, 260, -285\)')]:
            server.place = np.array([350.0, 260.0, -285.0])
            server.replies['GoTo'] = lambda tag, asked, clamped=clamped: clamped(tag)
            with pytest.raises(CellError, match=said):
                await measured(cmm, position=3)
            assert server.moves[-1].values[0].name == 'X'
            assert server.r == 0.0
        server.replies.clear()
        assert (await measured(cmm, position=3)).table_angle == pytest.approx(2 * np.pi / 3)
    run(scene)
