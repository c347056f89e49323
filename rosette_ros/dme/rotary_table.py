# SPDX-License-Identifier: Apache-2.0
"""How the table is turned: which values of R are commanded one after the other, and what its encoder says.

No command of the protocol states a sense. A table is turned by steps below 180 degrees, which have one shortest way,
the last one in the wanted sense: also where it stands there but is not known to have come so. Angles here are those of
the table, counter-clockwise about its axis, degrees; R is sign * angle + zero.
"""

import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.run.errors import CellError, InvalidPlan
from rosette_ros.dme.dme_session import Data
from rosette_ros.dme.dme_settings import DmeTableSettings
from rosette_ros.dme.wire import Call, call, numbers

Request = Callable[[Call], Awaitable[Data]]
Move = Callable[[Call], Awaitable[object]]
"""What sends a command that asks, and returns its data; what sends one that moves."""
LONGEST_STEP = 120.0
"""Degrees that the table is turned by one command."""
_SAME = 1e-6  # degrees by which two angles of a plan are one


@dataclass
class TableState:
    """Where the table stands: unwrapped angle of the encoder, degrees, and the sense of its last move, 0 if unknown."""

    angle: float
    approach: int = 0


def turning_steps(settings: DmeTableSettings, state: TableState, target: float, approach: int) -> list[float]:
    """Return the unwrapped angles, degrees, through which the table turns from where it is to `target` modulo a turn.

    approach: sense in which it gets there, 0 for the shorter way; where it stands there from another sense, it comes
    again, from one step of its positions before. A table with limits turns back beyond the target
    where the wanted way would leave them. Raises InvalidPlan where that is not possible; [] where it stands there.
    """
    now = state.angle
    forward = (target - now) % 360.0
    is_there = min(forward, 360.0 - forward) <= settings.tolerance_deg
    if is_there and (approach in (0, state.approach) or settings.turn == 'none'):
        return []
    if settings.turn == 'none':
        raise InvalidPlan(f'table angle {target:g} deg: expected a table that can be turned, found table.turn: none')
    sense, before = approach or (1 if forward <= 180.0 else -1), 360.0 / settings.balls
    if settings.limits_deg is None:
        if is_there:
            end = now + (forward + 180.0) % 360.0 - 180.0
            return [end - sense * before, end]
        return _divided(now, now + (forward if sense > 0 else forward - 360.0))
    first, last = sorted((value - settings.zero_deg) * settings.sign for value in settings.limits_deg)
    turns = range(math.floor((first - target) / 360.0), math.ceil((last - target) / 360.0) + 1)
    ends = [end for end in (target + 360.0 * turn for turn in turns) if first - _SAME <= end <= last + _SAME]
    ahead = [end for end in ends if (end - now) * sense > 0]
    if ahead and not is_there:
        return _divided(now, min(ahead, key=lambda end: abs(end - now)))
    for end in sorted(ends, key=lambda end: abs(end - now)):
        back = min(max(end - sense * (before if is_there else settings.overrun_deg), first), last)
        if (end - back) * sense > settings.tolerance_deg:
            return [*_divided(now, back), end]
    raise InvalidPlan(f'table angle {target:g} deg: expected a way there {"counter-" * (sense > 0)}clockwise within R '
                      f'{settings.limits_deg[0]:g} .. {settings.limits_deg[1]:g}, there is none; turn the other way, '
                      'or set table.zero_deg elsewhere')


def _divided(now: float, end: float) -> list[float]:
    count = max(math.ceil(abs(end - now) / LONGEST_STEP - _SAME), 1)
    return [now + (end - now) * step / count for step in range(1, count + 1)]


def commanded(settings: DmeTableSettings, angle: float) -> float:
    """Return the R of an unwrapped angle, as it is commanded, degrees."""
    value = settings.sign * angle + settings.zero_deg
    return value % 360.0 if settings.reading == 'modulo' and settings.limits_deg is None else value


def unwrapped(settings: DmeTableSettings, reading: float, near: float) -> float:
    """Return the unwrapped angle, degrees, of what R reads, the one that is next to `near`."""
    angle = (reading - settings.zero_deg) * settings.sign
    return angle if settings.reading == 'cumulative' else angle + 360.0 * round((near - angle) / 360.0)


async def read_table(request: Request, settings: DmeTableSettings, near: float | None = None) -> float:
    """Return the unwrapped angle of the encoder, degrees; 0 if it is not turned. Raises NotDme, DmeRefused."""
    if settings.turn == 'none':
        return 0.0
    [reading] = numbers(sum(await request(Call('Get', (Call('R'),))), ()), 'R')
    starts_again = settings.reading == 'modulo' and settings.limits_deg is None
    angle = (reading - settings.zero_deg) * settings.sign
    return unwrapped(settings, reading, (180.0 if starts_again else angle) if near is None else near)


async def turn_table(move: Move, request: Request, settings: DmeTableSettings, state: TableState, target: float,
                     approach: int) -> None:
    """Turn the table to an angle, degrees, in a sense, and update its state; raises CellError where it is elsewhere."""
    for angle in turning_steps(settings, state, target, approach):
        before, state.approach = state.angle, 0  # unknown where the move is aborted
        await move(turning_call(settings, angle))
        found = await read_table(request, settings, angle)
        if abs(found - angle) > settings.tolerance_deg:
            raise CellError(f'expected the table at {angle:.4f} deg, found {found:.4f} from R; see table.sign, '
                            'table.reading, table.zero_deg and table.tolerance_deg')
        state.angle, state.approach = found, int(np.sign(angle - before))


def turning_call(settings: DmeTableSettings, angle: float) -> Call:
    """Return the command that turns the table to an unwrapped angle, degrees."""
    if settings.turn == 'goto':
        return call('GoTo', call('R', commanded(settings, angle)))
    frame = settings.frame.rotation
    turned = np.deg2rad(angle)
    towards = frame[:, 0] * np.cos(turned) + frame[:, 1] * np.sin(turned)
    return call('AlignPart', *map(float, (*frame[:, 0], *towards, settings.tolerance_deg)))
