# SPDX-License-Identifier: Apache-2.0
"""What the next run should be, so that it shows what this one cannot."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.planning.size import refuse_more
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import Floats, Ints, Run
from rosette_ros.core.run.scheme import ORDERS, TURNINGS, Scheme, nominal_places, plan, unwrap_travel
from rosette_ros.core.run.touches import USUAL, USUAL_PACE, Pace
from rosette_ros.core.sight.visibility import (
    GOOD_SHARE,
    Share,
    Visibility,
    is_same_share,
    visibility,
    visible_share,
    visible_shares,
)
from rosette_ros.core.uncertainty.hidden_effects import expected_u
from rosette_ros.core.uncertainty.stated_environment import Environment

VARIANTS = tuple((order, turning) for order in ORDERS for turning in ('forward', 'alternate')
                 if order != 'row_there_and_back'
                 and (turning == 'forward' or order in ('diagonal', 'column', 'random')))
"""Orders and turnings that differ and are advised: a row never turns back, others have senses of their own."""
AS_MEASURED = 'as measured'
"""Name of an order that is none of the known ones."""
BETTER = 0.02
"""An order is advised whose smallest share of what is wanted is larger by more than this."""
ALMOST = 0.9
"""Worst share of an order beside the best one from which the time that it takes decides."""
WHOLE = 0.9
"""Measured share of the cells of its balls from which a run lacks the other balls by plan, not by a break."""


@dataclass(frozen=True, eq=False)
class OrderAdvice:
    """What one order shows: visibility of each effect, and what the run costs.

    run: that is measured so; sigma: standard deviation of a coordinate, m; wanted: names of the effects that count, all
    that can be judged if none; names: of those that are looked at, likewise; travel_time: s of table and CMM moves;
    duration: s of the whole run; environment: that is stated, None where none is.
    """

    order: str
    turning: str
    seed: int
    run: Run
    sigma: float
    wanted: tuple[str, ...]
    names: tuple[str, ...]
    travel_time: float
    duration: float
    environment: Environment | None = None

    @cached_property
    def u(self) -> Floats | None:
        """Standard uncertainties of the curves, rms over the angles, (6,), m and rad, of a run that shows nothing of
        what may be there in the environment; None where none is stated."""
        if self.environment is None:
            return None
        return np.asarray(np.sqrt(np.mean(expected_u(self.run, self.sigma, self.environment)**2, axis=0)))

    @property
    def displacement(self) -> float:
        """Root of the square sum of these, m at a ball."""
        return float(np.linalg.norm(self.u * np.repeat([1.0, self.run.radius], 3))) if self.u is not None else 0.0

    @property
    def label(self) -> str:
        """Order and turning in words."""
        plain = (self.order, 'alternate') not in VARIANTS
        return self.order if plain or self.turning == 'forward' else f'{self.order}, turning {self.turning}'

    @cached_property
    def shares(self) -> dict[str, Share]:
        """The Share of each effect by its name."""
        return {one.name: one for one in visible_shares(self.run, names=self.names)}

    @property
    def visibilities(self) -> tuple[Visibility, ...]:
        """The Visibility of each effect."""
        return visibility(self.run, self.sigma, names=self.names)

    def share(self, name: str) -> float:
        """Return the typical sensitivity to an effect."""
        return self.shares[name].typical_share

    @property
    def worst(self) -> float:
        """The smallest typical share over the wanted effects."""
        return self._least.typical_share

    @property
    def worst_effect(self) -> str:
        """The name of the wanted effect of the smallest typical share."""
        return self._least.name

    @cached_property
    def _least(self) -> Share:
        some = [one for one in self.shares.values() if not self.wanted or one.name in self.wanted]
        if all(one.reason for one in some):
            raise NotDeterminable('expected effects that an order can show, found ' + '; '.join(
                f'{one.name}: {one.reason}' for one in some))
        judged = [one for one in some if not one.reason]
        least = min(one.typical_share for one in judged)
        return next(one for one in judged if is_same_share(one.typical_share, least))

    def shows(self, names: Sequence[str], least: float) -> bool:
        """Return whether the typical share of none of some effects is smaller; the first that is ends the search."""
        seen = (visible_share(self.run, name) for name in names)
        return all(one.reason or one.typical_share >= least for one in seen)


@dataclass(frozen=True, eq=False)
class Advice:
    """The present order, the recommended next one, and all that were compared.

    weak: effects that the present order hides or shows badly; wanted: those that the next one must show;
    balls: those in use in all orders, () where they are all.
    """

    present: OrderAdvice
    best: OrderAdvice
    orders: tuple[OrderAdvice, ...]
    weak: tuple[str, ...]
    wanted: tuple[str, ...]
    balls: tuple[int, ...] = ()


def planned_run(scheme: Scheme, radius: float, pace: Pace = USUAL_PACE, rotation: Floats | None = None) -> Run:
    """Return a run as it is expected: nominal centres, times of moves and touches, slow warming; rotation: as of Run.

    pace: of the cell. The temperature rises by 0.1 K along half a sine, so that temperature and time
    differ in shape.
    """
    centres = nominal_places(scheme.n, radius, scheme.table_position, scheme.ball)
    time = times_of(scheme, radius, np.where(scheme.touches > 0, scheme.touches, USUAL), pace)
    temperature = 20 + 0.1 * np.sin(0.5 * np.pi * time / time[-1])
    return Run(scheme.n, radius, scheme.table_position, scheme.ball, centres, time=time, temperature=temperature,
               approach=scheme.approach, repeats=scheme.repeats, session=scheme.session,
               source=f'planned run, order {scheme.order}', rotation=rotation, table_offset=scheme.table_offset)


def times_of(scheme: Scheme, radius: float, touches: Floats | Ints | int, pace: Pace = USUAL_PACE) -> Floats:
    """Return when each reading of a scheme is expected, (N,), s from the first; touches: of each, or of all."""
    travel = unwrap_travel(scheme.table_angle, scheme.approach, scheme.n)
    centres = nominal_places(scheme.n, radius, scheme.table_position, scheme.ball)
    move = np.linalg.norm(np.diff(centres, axis=0, prepend=centres[:1]), axis=1)
    time = pace.times(np.broadcast_to(touches, move.shape), np.abs(np.diff(travel, prepend=travel[:1])), move)
    return np.asarray(time - time[0] + np.cumsum(scheme.wait) - scheme.wait[0])


def advise_order(scheme: Scheme, radius: float, sigma: float, wanted: Sequence[str] = (), names: Sequence[str] = (),
                 run: Run | None = None, rotation: Floats | None = None,
                 environment: Environment | None = None) -> OrderAdvice:
    """Return the OrderAdvice of a scheme.

    wanted: names that count, all that can be judged if none; names: of the effects to look at, all if none; run: that
    was measured so, without it the run is taken as it is expected, with a rotation as of Run; environment: that is
    stated.
    """
    planned = planned_run(scheme, radius, rotation=rotation)
    backwards = scheme.approach < 0
    turning = 'clockwise' if backwards.all() else 'alternate' if backwards.any() else 'forward'
    duration = float(planned.time[-1])
    return OrderAdvice(scheme.order, turning, scheme.seed, run or planned, sigma, tuple(wanted), tuple(names),
                       duration - Pace.touch * USUAL * (planned.size - 1), duration, environment)


def advise(n: int, order: str = 'diagonal', radius: float = 0.1825, sigma: float = 1e-7, wanted: Sequence[str] = (),
           turning: str = 'forward', seed: int = 0, environment: Environment | None = None) -> Advice:
    """Return the Advice for a cell of n balls that measures in `order` now.

    wanted: names of effects that the next run must show (the weak ones of the present order if none). The best order
    has the largest worst share over what is wanted; of orders within a tenth of it, the one with the least travel.
    In an environment it is that of the least U; of orders within a tenth of it, the quickest.
    Raises NotDeterminable for an effect that the cell cannot have, whatever the order.
    """
    present = advise_order(plan(n, order, seed, turning), radius, sigma, environment=environment)
    return _advice(present, n, radius, sigma, wanted, seed)


def advise_run(run: Run, wanted: Sequence[str] = (), seed: int = 0, environment: Environment | None = None) -> Advice:
    """Return the Advice for the cell that measured a run, its own times and senses; arguments as of `advise`.

    Orders are compared with the balls that the run has: a plate may have fewer balls than the table has positions.
    """
    sigma = run.repeatability or 1e-7
    present = advise_order(scheme_of(run), run.radius, sigma, run=run, environment=environment)
    return _advice(present, run.n, run.radius, sigma, wanted, seed, run.rotation, _balls_in_use(run))


def _balls_in_use(run: Run) -> tuple[int, ...]:
    """Return the balls of a run that has only some by plan, () for others."""
    planned = run.n * len(run.balls)
    return run.balls if len(run.balls) < run.n and run.completeness * run.n**2 >= WHOLE * planned else ()


def scheme_of(run: Run) -> Scheme:
    """Return the Scheme in which a run was measured; its order is named where it is known."""
    cell = (run.table_position, run.ball)
    order = AS_MEASURED
    known = ((name, plan(run.n, name, 0, turning)) for name in ORDERS for turning in TURNINGS)
    order = next((name for name, one in known if np.array_equal(cell, (one.table_position, one.ball))), order)
    return Scheme(run.n, order, 0, *cell, run.approach)


def _advice(present: OrderAdvice, n: int, radius: float, sigma: float, wanted: Sequence[str], seed: int,
            rotation: Floats | None = None, balls: tuple[int, ...] = ()) -> Advice:
    refuse_more(n, 'advise')
    judged = [entry for entry in present.shares.values() if not entry.reason]
    weak = tuple(entry.name for entry in judged if entry.typical_share < GOOD_SHARE)
    for name in wanted:
        if name not in present.shares:
            why = EFFECTS[name].unavailable(present.run) if name in EFFECTS else 'it is a form without a name'
            raise NotDeterminable(f'{name}: expected an effect that the cell of this run can have, found one that no '
                                  'order '
                                  f'shows: {why}')
    wanted = tuple(wanted) or weak or tuple(entry.name for entry in judged)
    every = tuple(advise_order(plan(n, name, seed, turning, balls=balls), radius, sigma, wanted, names=wanted,
                               rotation=rotation, environment=present.environment) for name, turning in VARIANTS)
    best = _best(every, sorted(wanted, key=present.share))
    if present.environment:
        least = min(one.displacement for one in every)
        best = min((one for one in every if ALMOST * one.displacement <= least), key=lambda one: one.duration)
        is_better = ALMOST * present.displacement > best.displacement
    else:
        is_better = best.worst > min(present.share(name) for name in wanted) + BETTER
    if is_better:
        best = advise_order(plan(n, best.order, seed, best.turning, balls=balls), radius, sigma, wanted,
                            rotation=rotation, environment=present.environment)
    else:
        best = present
    return Advice(present, best, every, weak, wanted, balls)


def _best(orders: Sequence[OrderAdvice], wanted: Sequence[str]) -> OrderAdvice:
    """Return the order of the least travel among those whose worst share is within a tenth of the best one.

    wanted: effects that count, those first that tell soonest that an order is none of these."""
    near: list[OrderAdvice] = []
    top = 0.0
    for one in sorted(orders, key=lambda one: one.order != 'interleaved'):  # this one is made to show most
        if one.shows(wanted, ALMOST * top):
            near.append(one)
            top = max(top, one.worst)
    return min((one for one in orders if one in near and one.worst >= ALMOST * top), key=lambda one: one.travel_time)
