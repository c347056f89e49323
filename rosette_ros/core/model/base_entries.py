# SPDX-License-Identifier: Apache-2.0
"""The measurement equation of the base model, by coordinates, and whether a plan determines it; numpy alone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.run.errors import InvalidPlan, counted
from rosette_ros.core.run.geometry import Floats, Ints, nominal_angles
from rosette_ros.core.run.scheme import Scheme, cmm_position

TERM = np.array([0, 0, 0, 1, 2, 0, 0, 0, 1, 1, 2, 2])
"""The base term of each block of n unknowns: ctz, R crx, R cry, P_z, M_z; ctx, cty, R crz, P_x, P_y, M_x, M_y."""
AXIAL, PLANE = PARTS = (slice(2, 3), slice(0, 5)), (slice(0, 2), slice(5, 12))
"""The parts that are independent of each other, z, and x and y: their axes, and their blocks of unknowns."""
MOST_RANKED = 72
"""Balls up to which the rank of a plan is calculated before it is measured."""
NAMED = 8
ROUNDING = 1e-9
"""Eigenvalues of normal equations below this share of the largest are 0."""


def entries(n: int, table_position: Ints, ball: Ints, terms: tuple[str, ...] = BASE_TERMS) -> tuple[Ints, Floats]:
    """Return the equations of readings (N,), one-based, from n balls: each coordinate sees five of the 12 n unknowns.

    These, from 0, and their factors, along x, y and z, (N, 3, 5) each; unknowns: see TERM."""
    at, of, on = table_position - 1, ball - 1, cmm_position(n, table_position, ball) - 1
    alpha, phi, one = nominal_angles(n)[on], nominal_angles(n)[at], np.ones(at.size)
    sin, cos, sin_t, cos_t = np.sin(alpha), np.cos(alpha), np.sin(phi), np.cos(phi)
    unknown = np.array([[5 * n + at, 7 * n + at, 8 * n + of, 9 * n + of, 10 * n + on],
                        [6 * n + at, 7 * n + at, 8 * n + of, 9 * n + of, 11 * n + on],
                        [at, n + at, 2 * n + at, 3 * n + of, 4 * n + on]]).transpose(2, 0, 1)
    factor = np.array([[one, -sin, cos_t, -sin_t, one], [one, cos, sin_t, cos_t, one], [one, sin, -cos, one, one]])
    return unknown, factor.transpose(2, 0, 1) * np.isin(BASE_TERMS, terms)[TERM][unknown // n]


def pairs(size: int, unknown: NDArray[np.integer[Any]], factor: Floats) -> tuple[NDArray[np.integer[Any]], Floats]:
    """Return what coordinates (..., 5 of `size` unknowns) add to the lower triangle of their normal equations.

    Entries (..., 15), column by column, and the products of factors there."""
    one, other = np.triu_indices(5)
    return unknown[..., one] * size + unknown[..., other], factor[..., one] * factor[..., other]


def normal_equations(n: int, part: tuple[slice, slice], unknown: Ints, factor: Floats) -> Floats:
    """Return the lower triangle of the normal equations of one of PARTS, (q, q), of entries (N, 3, 5)."""
    axes, blocks = part
    size = (blocks.stop - blocks.start) * n
    entry, product = pairs(size, unknown[:, axes] - blocks.start * n, factor[:, axes])
    return np.asarray(np.bincount(entry.ravel(), product.ravel(), size * size).reshape(size, size).T, dtype=float)


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
        raise InvalidPlan(f'{source}: does not determine the curves: expected at least 3 different balls at each of '
                          'the '
                          f'table positions 1 .. {n}, found {got}{more}; add readings there')
    fewest = 3 * n + balls.size + positions.size - 6
    if pairs.size < fewest:
        raise InvalidPlan(f'{source}: does not determine the curves: expected at least {fewest} different pairs of '
                          'table '
                          f'position and ball for {balls.size} balls and {counted(positions.size, "CMM position")} in '
                          f'use, found {pairs.size}; add readings')
    if n > MOST_RANKED:
        return
    wanted = 12 * n - 13 - 3 * (n - balls.size) - 3 * (n - positions.size)
    every = entries(n, pairs // n + 1, pairs % n + 1)
    values = [np.linalg.eigvalsh(normal_equations(n, part, *every)) for part in PARTS]
    rank = sum(np.count_nonzero(value > ROUNDING * value[-1]) for value in values)
    if rank < wanted:
        raise InvalidPlan(f'{source}: does not determine the curves: its {pairs.size} pairs of table position and ball '
                          f'have rank {rank} where {wanted} is needed; expected CMM positions or balls that are not '
                          'equally spaced, and readings that join all of them')


def unmeasurable(n: int) -> tuple[Floats, Floats]:
    """Return the combinations of unknowns that no readings see, of z, (5 n, 6), and of x and y, (7 n, 7)."""
    phi = nominal_angles(n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    z = np.block([
        [one, o, o, o, -one],       # height of the table against the CMM
        [o, o, o, one, -one],       # height of the plate against the CMM
        [o, one, o, o, -s],         # mean tilt about x: z = R sin alpha
        [o, o, one, o, c],          # mean tilt about y: z = -R cos alpha
        [o, c, s, -s, o],           # tilt that turns: z = R sin(alpha - phi)
        [o, -s, c, c, o]])          # z = -R cos(alpha - phi)
    w = np.block([
        [one, o, o, o, o, -one, o],     # mean of ctx against the CMM
        [o, one, o, o, o, o, -one],     # mean of cty
        [c, s, o, -one, o, o, o],       # eccentricity of the plate
        [-s, c, o, o, -one, o, o],
        [o, o, one, s, -c, o, o],       # mean turn of the table against the plate
        [o, o, o, -s, c, s, -c],        # turn of the plate against the CMM
        [o, o, o, c, s, -c, -s]])       # radial scale of plate against CMM
    return z.T, w.T
