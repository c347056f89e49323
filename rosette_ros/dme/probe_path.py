# SPDX-License-Identifier: Apache-2.0
"""The path of the tip around one ball as data, and what it must not come near: checked before anything moves.

From the clearance plane down to the ball, along stand-off points from touch to touch, over the top where the straight
way would come too near to the ball, and up again. Points are tip centres in machine coordinates, m.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.axes import axis_rotation, words
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import Bools, Floats
from rosette_ros.core.run.touches import TOUCHES, circles_of, touch_directions
from rosette_ros.dme.dme_settings import DmeSettings

_SHAFT_STEP = 1e-3  # a shaft is a row of spheres at this distance, m: 0.01 mm off at 12 mm
_ROUND = 1e-9  # m
BESIDE = 0.1
"""How far beyond the balls a plate may reach, m: the tip is not lifted from below that."""


class UnsafePath(InvalidPlan):  # noqa: N818
    """A path that cannot be made: where, and what it would come near."""


@dataclass(frozen=True, eq=False)
class PathStep:
    """One step: a move of the tip centre to `point`, (3,), m, or, with a normal (3,), the touch of the surface there.

    For a touch `point` is on the surface of the ball and `normal` points out of it. is_near: whether the way there may
    come near to the ball that is touched."""

    point: Floats
    why: str
    normal: Floats | None = None
    is_near: bool = False

    def ways(self, tip: float, approach: float) -> Floats:
        """Return the tip centres where a step begins and ends, (2, 3) for a touch, (1, 3) for a move."""
        if self.normal is None:
            return self.point[None, :]
        return self.point + np.outer([tip + approach, tip], self.normal)


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Spheres that the tip must not come near: centres (m, 3), radii (m,), m, and what each is.

    own: (m,) whether it is the ball that is touched."""

    centre: Floats
    radius: Floats
    name: tuple[str, ...]
    own: Bools


def obstacles(settings: DmeSettings, balls: Floats, own: int, centre: Floats | None = None) -> Obstacles:
    """Return balls (n, 3), m, and their shafts; own: which one is touched, -1 for none; centre: where it really is."""
    if centre is not None:
        balls = np.concatenate([balls[:own], centre[None, :], balls[own + 1:]])
    down = -settings.table.frame.rotation[:, 2]
    along = np.arange(1e-3 * settings.ball.radius_mm, 1e-3 * settings.ball.shaft_length_mm + _SHAFT_STEP, _SHAFT_STEP)
    shafts = (balls[:, None] + along[:, None] * down).reshape(-1, 3)
    tip = settings.tool.tip_radius_mm
    near = [f'{{}} ball {k + 1}' if k != own else '{} the ball' for k in range(len(balls))]
    return Obstacles(
        np.concatenate([balls, shafts]),
        1e-3 * (tip + np.repeat([settings.ball.radius_mm, settings.ball.shaft_radius_mm], [len(balls), len(shafts)])),
        (*(words.format('') for words in near),
         *(words.format('the shaft of') for words in near for _ in along)),
        np.concatenate([np.arange(len(balls)) == own, np.zeros(len(shafts), dtype=bool)]))


def distances(starts: Floats, ends: Floats, points: Floats) -> Floats:
    """Return the distances of straight ways (s, 3) to (s, 3) from points (m, 3), (s, m), m."""
    way = ends - starts
    length = np.maximum(np.vecdot(way, way), 1e-30)
    off = points[None, :] - starts[:, None]
    share = np.clip(np.einsum('smk,sk->sm', off, way) / length[:, None], 0.0, 1.0)
    return np.asarray(np.linalg.norm(off - share[..., None] * way[:, None], axis=-1))


def ball_path(settings: DmeSettings, centre: ArrayLike, pole: ArrayLike, touches: int = 0) -> list[PathStep]:
    """Return the steps around a ball, from the clearance plane above it to the clearance plane.

    centre: (3,) of the ball, m; pole: (3,) unit vector to the side from which it is probed; touches: of TOUCHES, 0 for
    the usual number. Raises InvalidPlan for another number.
    """
    centre, up = np.asarray(centre, dtype=float), np.asarray(pole, dtype=float)
    touches = touches or settings.ball.touches
    if touches not in TOUCHES:
        raise InvalidPlan(f'touches: expected one of {", ".join(map(str, TOUCHES))}, found {touches}')
    radius, tip = 1e-3 * settings.ball.radius_mm, 1e-3 * settings.tool.tip_radius_mm
    away = radius + tip + 1e-3 * settings.path.stand_off_mm
    least = radius + tip + 0.5e-3 * settings.path.stand_off_mm
    directions = touch_directions(*circles_of(touches), 1 - settings.ball.below_pole_mm / settings.ball.radius_mm,
                                  -settings.ball.below_equator_mm / settings.ball.radius_mm) @ axis_rotation(up).T

    def raised(point: Floats, height: float) -> Floats:
        return np.asarray(point + up * (height - (point - centre) @ up))

    clear = 1e-3 * settings.path.clearance_mm - (centre - settings.table.frame.origin) @ up
    steps = [PathStep(raised(centre, clear), 'above the ball')]
    for number, normal in enumerate(directions, 1):
        before, point = steps[-1].point, centre + away * normal
        if distances(before[None], point[None], centre[None])[0, 0] < least - _ROUND:
            for end in (before, point):
                steps.append(PathStep(raised(end, away), f'over the top to touch {number}'))
        steps.append(PathStep(point, f'stand-off of touch {number}'))
        steps.append(PathStep(centre + radius * normal, f'touch {number}', normal, is_near=True))
        steps.append(PathStep(point, f'back from touch {number}', is_near=True))
    steps.append(PathStep(raised(steps[-1].point, clear), 'up to the clearance plane'))
    return steps


def lifted(settings: DmeSettings, steps: Iterable[PathStep]) -> list[PathStep]:
    """Return steps as they are in a dry run: higher by the clearance, a touch is a move to where the tip would be."""
    up = settings.table.frame.rotation[:, 2] * 1e-3 * settings.path.clearance_mm
    tip = 1e-3 * settings.tool.tip_radius_mm
    return [replace(step, point=step.ways(tip, 0.0)[-1] + up, normal=None) for step in steps]


def refuse_unsafe(settings: DmeSettings, steps: Sequence[PathStep], around: Obstacles,
                  start: Floats | None = None) -> None:
    """Raise UnsafePath for the first step that leaves the box or comes too near to a ball, a shaft or the plate.

    start: (3,) tip centre before the first step, m."""
    keep = 0.5e-3 * settings.path.stand_off_mm
    tip, approach = 1e-3 * settings.tool.tip_radius_mm, 1e-3 * settings.motion.approach_mm
    ways: list[tuple[PathStep, Floats, Floats]] = []
    place = start
    for step in steps:
        for point in step.ways(tip, approach):
            ways.append((step, point if place is None else place, point))
            place = point
    if not ways:
        return
    starts, ends = np.array([way[1] for way in ways]), np.array([way[2] for way in ways])
    low, high = 1e-3 * np.array(settings.path.box_low_mm), 1e-3 * np.array(settings.path.box_high_mm)
    frame = settings.table.frame
    plate = -1e-3 * settings.ball.shaft_length_mm + tip + keep
    reach = 1e-3 * (settings.table.radius_mm + settings.ball.radius_mm) + BESIDE
    inner = frame.to_inner(ends)
    gap = distances(starts, ends, around.centre) - around.radius
    gap[np.ix_(np.array([step.is_near for step, _, _ in ways]), around.own)] = np.inf
    for number, (step, _, point) in enumerate(ways):
        if not ((low - _ROUND <= point) & (point <= high + _ROUND)).all():
            raise UnsafePath(f'{step.why}: expected a tip within the box {words(1e3 * low)} to {words(1e3 * high)} mm, '
                             f'found {words(1e3 * point)}; see path.box_low_mm and path.box_high_mm')
        near = int(np.argmin(gap[number]))
        if gap[number, near] < keep - 1e-6:
            raise UnsafePath(f'{step.why}: expected at least {1e3 * keep:g} mm between tip and '
                             f'{" ".join(around.name[near].split())}, found {1e3 * gap[number, near]:.1f}; '
                             'see path.stand_off_mm and ball')
        if inner[number, 2] < plate and np.hypot(*inner[number, :2]) < reach:
            raise UnsafePath(f'{step.why}: expected at least {1e3 * keep:g} mm between tip and plate, found '
                             f'{1e3 * (inner[number, 2] - plate + keep):.1f}; see ball.shaft_length_mm')


def lift(settings: DmeSettings, position: Floats, balls: Floats) -> list[PathStep]:
    """Return the steps from where the tip stands, (3,), m, to the clearance plane.

    From beside a ball, where a run was aborted, it goes away from the ball first. balls: (n, 3), m. Raises UnsafePath.
    """
    frame, tip = settings.table.frame, 1e-3 * settings.tool.tip_radius_mm
    steps, place = list[PathStep](), position
    off = np.linalg.norm(balls - position, axis=-1)
    own = int(np.argmin(off))
    away = 1e-3 * (settings.ball.radius_mm + settings.path.stand_off_mm) + tip
    if 1e-3 < off[own] < away - _ROUND:
        place = balls[own] + (position - balls[own]) * (away / off[own])
        steps.append(PathStep(place, 'away from the ball', is_near=True))
    height = 1e-3 * settings.path.clearance_mm - frame.to_inner(place)[2]
    if height > _ROUND:
        steps.append(PathStep(place + height * frame.rotation[:, 2], 'up to the clearance plane'))
    refuse_unsafe(settings, [PathStep(position, 'where the tip stands', is_near=True), *steps],
                  obstacles(settings, balls, own))
    return steps


def refuse_to_turn(settings: DmeSettings, position: Floats) -> None:
    """Raise UnsafePath where the balls could sweep over the tip at (3,), m: below the clearance plane, not outside."""
    x, y, height = settings.table.frame.to_inner(position)
    ring = 1e-3 * (settings.table.radius_mm + settings.ball.radius_mm + settings.tool.tip_radius_mm
                   + settings.path.stand_off_mm)
    if height < 1e-3 * settings.path.clearance_mm - 1e-4 and np.hypot(x, y) < ring:
        raise UnsafePath(f'the table does not turn: expected the tip {settings.path.clearance_mm:g} mm over the balls, '
                         f'or {1e3 * ring:g} mm from the axis, found {1e3 * height:.1f} and {1e3 * np.hypot(x, y):.1f}')


def length(steps: Sequence[PathStep], tip: float) -> float:
    """Return how far the tip travels along steps, m."""
    points = np.concatenate([step.ways(tip, 0.0)[-1:] for step in steps])
    return float(sum(np.linalg.norm(after - before) for before, after in pairwise(points)))
