# SPDX-License-Identifier: Apache-2.0
"""Which plan a given time allows: order, places, touches, by the expected error of the curves."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from rosette_ros.core.errors import InvalidPlan
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.planning.advice import planned_run, times_of
from rosette_ros.core.records import Floats
from rosette_ros.core.reduced_sets import best_members, fewest_members, relative_uncertainty
from rosette_ros.core.scheme import Scheme, plan
from rosette_ros.core.touches import TOUCHES, USUAL_PACE, Pace, sigma_of_touches

ORDERS_TRIED = ('row', 'diagonal', 'row_there_and_back', 'there_and_back')
MOST_BALLS = 36
"""Of larger plates plans are not compared."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """A plan that fits into the time.

    touches: of each ball; duration: s; error: of the curves relative to the uncertainty of a complete run of 20 touches
    without drift, rms; u: (6,) expected standard uncertainty of the curves, drift included, rms over the positions, m
    and rad.
    """

    scheme: Scheme
    touches: int
    duration: float
    error: float
    u: Floats


def propose(n: int, radius: float, hours: float, sigma: float = 1e-7, drift: float = 0.0,
            pace: Pace = USUAL_PACE) -> tuple[Proposal, ...]:
    """Return the Proposals of n balls that take no longer than `hours`, best first, one of each order.

    sigma: standard deviation of a coordinate from 20 touches, m; drift: standard deviation of a random walk of the
    frame after an hour, m, which no model describes. Raises InvalidPlan where the time is too short for any plan.
    """
    if n > MOST_BALLS:
        raise InvalidPlan(f'a plan for a given time: wanted at most {MOST_BALLS} balls, got {n}; choose with '
                          '--cmm-positions')
    best, shortest = dict[str, Proposal](), float(np.inf)
    for count, order in product(range(fewest_members(n), n + 1), ORDERS_TRIED):
        scheme = plan(n, order, cmm_positions=[k + 1 for k in best_members(n, count)])
        times = {touches: times_of(scheme, radius, touches, pace) for touches in TOUCHES}
        shortest = min(shortest, *(float(time[-1]) for time in times.values()))
        short = {touches: time for touches, time in times.items() if time[-1] <= 3600 * hours}
        for one in _proposals(scheme, radius, short, sigma, drift) if short else ():
            if scheme.order not in best or one.error < best[scheme.order].error:
                best[scheme.order] = one
    if not best:
        raise InvalidPlan(f'{hours:g} h are too short for {n} balls: the shortest plan takes {shortest / 3600:.2f} h; '
                          'wanted more time, fewer balls or quicker touches')
    return tuple(sorted(best.values(), key=lambda one: one.error))


def _proposals(scheme: Scheme, radius: float, times: Mapping[int, Floats], sigma: float,
               drift: float) -> Iterator[Proposal]:
    """Yield what a scheme gives by numbers of touches; times: (N,) of the readings by these, s."""
    run = planned_run(scheme, radius)
    space = BaseSpace(run, radius)
    cofactor, effects = space.curve_cofactor(), _of_steps(space, run.size) if drift else None
    for touches, time in times.items():
        plane, axial = sigma_of_touches(touches, sigma)[[0, 2]]**2
        variance = cofactor * [plane, plane, axial, axial, axial, plane]
        if effects is not None:
            variance = variance + drift**2 / 3600 * np.einsum('arc,r->c', effects[:, 1:], np.diff(time))
        yield Proposal(scheme, touches, float(time[-1]), relative_uncertainty(variance / sigma**2, radius),
                       np.sqrt(variance.mean(axis=0)))


def _of_steps(space: BaseSpace, size: int) -> Floats:
    """Return what a unit step of the frame before each of N readings does to the curves, (3 axes, N, 6), mean square
    over the positions."""
    out = np.empty((3, size, 6))
    for axis in range(3):
        columns = np.zeros((size, size, 3))
        columns[..., axis] = np.tri(size).T  # reading r and those after it
        out[axis] = np.mean(space.parameters(columns).curves**2, axis=1)
    return out
