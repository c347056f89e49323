# SPDX-License-Identifier: Apache-2.0
"""Which of the effects that a model lacks go together, most likely by one cause: a machine that warms up moves both its
probe and its table axis."""

import math
from collections.abc import Sequence

from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.verdict import CERTAIN
from rosette_ros.core.effects.composed import GOING, LAWS
from rosette_ros.core.effects.effect import PhysicalEffect
from rosette_ros.core.model.least_squares import Parameter


def going_together(missing: Sequence[MissingEffect]) -> tuple[tuple[MissingEffect, ...], ...]:
    """Return what is missing in its order, together effects of other bodies that go with the same variables by one
    course with the same numbers."""
    found: list[list[MissingEffect]] = []
    for one in missing:
        known = [some for some in found if all(_go_together(one, other) for other in some)]
        if known:
            known[0].append(one)
        else:
            found.append([one])
    return tuple(map(tuple, found))


def _go_together(one: MissingEffect, other: MissingEffect) -> bool:
    """Return whether two motions of other bodies have one course, with searched numbers that agree within their U."""
    first, second = LAWS.get(one.name), LAWS.get(other.name)
    courses = [type(going.course('m')) for going in GOING]
    if not (isinstance(first, PhysicalEffect) and isinstance(second, PhysicalEffect) and one.cause and other.cause
            and one.depth == other.depth == 1 and type(first.course) is type(second.course) in courses
            and type(first.motion) is not type(second.motion)
            and _drive(one.cause, first) == _drive(other.cause, second)):
        return False
    ways = [{part.name: part for part in some.parameters} for some in (one, other)]
    searched = [part.name for part in first.course.searched if part.kind != 'choice']
    return bool(searched) and all(name in ways[0] and name in ways[1] and _agree(ways[0][name], ways[1][name])
                                  for name in searched)


def _drive(cause: Cause, law: PhysicalEffect) -> tuple[tuple[str, ...], ...]:
    """Return the sets of variables that are said to drive it, but for those that its motion has."""
    return tuple(first for first, *_ in cause.variables if first not in law.motion.variables), *cause.or_with


def _agree(one: Parameter, other: Parameter) -> bool:
    return abs(one.value - other.value) <= CERTAIN * math.hypot(one.u, other.u)
