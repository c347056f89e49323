# SPDX-License-Identifier: Apache-2.0
"""What is refused of a whole plan before anything moves: balls elsewhere, unsafe ways, turns that cannot be made."""

from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from rosette_ros.core.run.axes import ALONG, words
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import TWO_PI, Floats
from rosette_ros.dme.dme_settings import DmeSettings
from rosette_ros.dme.probe_path import ball_path, lifted, obstacles, refuse_unsafe
from rosette_ros.dme.rotary_table import TableState, turning_steps

Way = tuple[int, bytes, bytes]
"""What decides whether the way around a ball is safe: touches, its place, and those of all balls."""


class PlannedBall(NamedTuple):
    """A ball that is to be measured.

    balls: how many there are on the circle; ball, table_position: one-based; centre: (3,) where it is expected, m;
    table_angle: rad; approach: sense in which the table gets there, 0 for the shorter way; pole: (3,) to the side that
    is probed, 0, 0, 0 for the table axis; touches: 0 for the usual number."""

    balls: int
    table_position: int
    ball: int
    centre: Floats
    table_angle: float
    approach: int = 0
    pole: Floats = np.zeros(3)
    touches: int = 0

    def __str__(self) -> str:
        return f'table position {self.table_position}, ball {self.ball}'


def all_balls(settings: DmeSettings) -> Iterator[PlannedBall]:
    """Yield all balls of the settings at all table positions."""
    table = settings.table
    for position in range(table.balls):
        angle = TWO_PI * position / table.balls
        for ball, centre in enumerate(table.frame.to_outer(table.balls_at(angle)), 1):
            yield PlannedBall(table.balls, position + 1, ball, centre, angle)


def own_ball(settings: DmeSettings, balls: Floats, ball: int, centre: Floats) -> int:
    """Return which of the balls (n, 3), m, of the settings a target means, from 0; raises InvalidPlan for none.

    ball: one-based; where the balls have no equal pitch, it is the place on the circle, and the next ball is meant."""
    if settings.table.azimuths_deg is not None:
        return int(np.argmin(np.linalg.norm(balls - centre, axis=-1)))
    if not 1 <= ball <= len(balls):
        raise InvalidPlan(f'expected one of the {len(balls)} balls of the settings (table.balls), found ball {ball}')
    return ball - 1


def refuse_target(settings: DmeSettings, target: PlannedBall) -> tuple[Floats, int]:
    """Return where the balls of the settings are then, (n, 3), m, and which one is meant, from 0.

    Raises InvalidPlan for a target that is none of them, and says how far it is off."""
    table, frame = settings.table, settings.table.frame
    if target.balls != table.balls:
        raise InvalidPlan(f'expected a plan of {table.balls} balls, as the settings have (table.balls), found one of '
                          f'{target.balls}')
    balls = frame.to_outer(table.balls_at(target.table_angle))
    own = own_ball(settings, balls, target.ball, target.centre)
    off = 1e3 * np.linalg.norm(balls[own] - target.centre)
    if not off <= table.search_mm:
        there, (x, y, height) = frame.to_inner(balls[own]), frame.to_inner(target.centre)
        radial = 1e3 * (np.hypot(x, y) - np.hypot(*there[:2]))
        turned = np.rad2deg((np.arctan2(y, x) - np.arctan2(there[1], there[0]) + np.pi) % TWO_PI - np.pi)
        raise InvalidPlan(f'expected the ball within {table.search_mm:g} mm of {words(1e3 * balls[own])} mm, where the '
                          f'settings have it (table), found {words(1e3 * target.centre)}: {off:.1f} mm off, turned by '
                          f'{turned:+.1f} deg about the table axis, {radial:+.1f} mm in radius, '
                          f'{1e3 * height:+.1f} mm along the axis')
    axis = frame.rotation[:, 2]
    if target.pole.any() and target.pole @ axis < np.cos(ALONG):
        raise InvalidPlan(f'expected the pole along {words(axis)}, table.axis of the settings, found '
                          f'{words(target.pole)}')
    return balls, own


def refuse_plan(settings: DmeSettings, plan: Iterable[PlannedBall], table: TableState,
                known: Collection[Way] = ()) -> set[Way]:
    """Check targets in the order of asking; table: where it stands; the rest as of `refuse_unsafe_plan`.

    Raises InvalidPlan, naming table position and ball: of a ball that the settings have elsewhere, a way that is not
    safe, an angle that the table cannot be turned to."""
    plan = list(plan)
    for target in plan:
        try:
            refuse_target(settings, target)
            wanted = float(np.rad2deg(target.table_angle))
            for angle in turning_steps(settings.table, table, wanted, target.approach):
                table = TableState(angle, int(np.sign(angle - table.angle)))
        except InvalidPlan as error:
            raise InvalidPlan(f'{target}: {error}') from None
    return refuse_unsafe_plan(settings, plan, known)


def refuse_unsafe_plan(settings: DmeSettings, plan: Iterable[PlannedBall] | None = None,
                       known: Collection[Way] = ()) -> set[Way]:
    """Check the ways of targets, None: of all balls at all table positions; return the different ones.

    known: ways that are safe with these settings. Raises UnsafePath and InvalidPlan, naming table position and ball."""
    frame, ways, rings = settings.table.frame, set[Way](), dict[float, tuple[Floats, bytes]]()
    for target in all_balls(settings) if plan is None else plan:
        if target.table_angle not in rings:
            ring = frame.to_outer(settings.table.balls_at(target.table_angle))
            rings[target.table_angle] = ring, (np.unique(np.round(ring, 6), axis=0) + 0.0).tobytes()
        balls, places = rings[target.table_angle]
        # The same place among balls at the same places, whichever they are: the same way.
        way = target.touches or settings.ball.touches, (np.round(target.centre, 6) + 0.0).tobytes(), places
        if way in ways:
            continue
        ways.add(way)
        if way in known:
            continue
        try:
            path = ball_path(settings, target.centre, frame.rotation[:, 2], target.touches)
            refuse_unsafe(settings, lifted(settings, path) if settings.dry_run else path,
                          obstacles(settings, balls, own_ball(settings, balls, target.ball, target.centre),
                                    target.centre))
        except InvalidPlan as error:
            raise type(error)(f'{target}: {error}') from None
    return ways
