# SPDX-License-Identifier: Apache-2.0
"""The measurement equation of the base model, reading by reading, and whether a plan determines it; numpy alone."""

import numpy as np

from rosette_ros.core.errors import InvalidPlan, counted
from rosette_ros.core.geometry import Floats, Ints, nominal_angles
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.scheme import Scheme, cmm_position

Entries = list[tuple[int, Ints, Floats]]
"""Columns' entries: the first column, the column of each reading counted from it, (N,), the value, (N,)."""
MOST_RANKED = 72
"""Balls up to which the rank of a plan is calculated before it is measured."""
NAMED = 8


def entries(n: int, table_position: Ints, ball: Ints,
            terms: tuple[str, ...] = BASE_TERMS) -> tuple[Entries, Entries, Entries]:
    """Return the equations of z, x and y of readings (N,), one-based, from n balls.

    Unknowns of z, each (n,): ctz, R crx, R cry, P_z, M_z; of x and y: ctx, cty, R crz, P_x, P_y, M_x, M_y.
    """
    table, plate, cmm = (float(term in terms) for term in BASE_TERMS)
    position = cmm_position(n, table_position, ball)
    at, of, on, one = table_position - 1, ball - 1, position - 1, np.ones(table_position.size)
    alpha, phi = nominal_angles(n)[on], nominal_angles(n)[at]
    sin, cos, sin_t, cos_t = np.sin(alpha), np.cos(alpha), np.sin(phi), np.cos(phi)
    z = [(0, at, table * one), (n, at, table * sin), (2 * n, at, -table * cos), (3 * n, of, plate * one),
         (4 * n, on, cmm * one)]
    x = [(0, at, table * one), (2 * n, at, -table * sin), (3 * n, of, plate * cos_t), (4 * n, of, -plate * sin_t),
         (5 * n, on, cmm * one)]
    y = [(n, at, table * one), (2 * n, at, table * cos), (3 * n, of, plate * sin_t), (4 * n, of, plate * cos_t),
         (6 * n, on, cmm * one)]
    return z, x, y


def refuse_undetermined(scheme: Scheme, source: str = 'plan') -> None:
    """Raise InvalidPlan, with what is missing, where the curves do not follow from the readings of a scheme.

    Wanted are three balls at every table position, 3 n + b + c - 6 readings where b balls and c CMM positions are in
    use, and 12 n - 13 less the unknowns of what is not in use as the rank (up to MOST_RANKED balls).
    """
    n, balls, positions = scheme.n, np.unique(scheme.ball), np.unique(scheme.cmm_position)
    pairs = np.unique((scheme.table_position - 1) * n + scheme.ball - 1)
    at = np.bincount(pairs // n, minlength=n)
    if at.min() < 3:
        poor = np.flatnonzero(at < 3) + 1
        got = ', '.join(f'{counted(int(at[one - 1]), "ball")} at table position {one}' for one in poor[:NAMED].tolist())
        more = f' and fewer than 3 at {poor.size - NAMED} more' if poor.size > NAMED else ''
        raise InvalidPlan(f'{source}: does not determine the curves: wanted at least 3 different balls at each of the '
                          f'table positions 1 .. {n}, got {got}{more}; add readings there')
    fewest = 3 * n + balls.size + positions.size - 6
    if pairs.size < fewest:
        raise InvalidPlan(f'{source}: does not determine the curves: wanted at least {fewest} different pairs of table '
                          f'position and ball for {balls.size} balls and {counted(positions.size, "CMM position")} in '
                          f'use, got {pairs.size}; add readings')
    if n > MOST_RANKED:
        return
    wanted = 12 * n - 13 - 3 * (n - balls.size) - 3 * (n - positions.size)
    z, x, y = entries(n, pairs // n + 1, pairs % n + 1)
    rank = _rank(5 * n, z) + _rank(7 * n, x, y)
    if rank < wanted:
        raise InvalidPlan(f'{source}: does not determine the curves: its {pairs.size} pairs of table position and ball '
                          f'have rank {rank} where {wanted} is needed; wanted CMM positions or balls that are not '
                          'equally spaced, and readings that join all of them')


def _rank(unknowns: int, *rows: Entries) -> int:
    """Return the rank of the equations of some unknowns."""
    normal = np.zeros((unknowns, unknowns))
    for one in rows:
        for first, row, value in one:
            for other, column, factor in one:
                np.add.at(normal, (first + row, other + column), value * factor)
    found = np.linalg.eigvalsh(normal)
    return int(np.count_nonzero(found > 1e-9 * max(found[-1], 1.0)))
