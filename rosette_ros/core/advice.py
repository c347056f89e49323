# SPDX-License-Identifier: Apache-2.0
"""What the next run should be, so that it shows what this one cannot."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.records import Run
from rosette_ros.core.scheme import ORDERS, TURNINGS, Scheme, plan, unwrap_travel
from rosette_ros.core.visibility import HIDDEN_SHARE, Visibility, visibility

SECONDS_PER_BALL = 30.0   # s, 20 touches and the move down and up
TABLE_SPEED = 0.1         # rad/s
CMM_SPEED = 0.05          # m/s
VARIANTS = tuple((order, turning) for order in ORDERS for turning in TURNINGS
                 if turning == 'forward' or order not in ('row', 'sensitive'))
"""Orders and turnings that differ: a row never turns back, `sensitive` has senses of its own."""
AS_MEASURED = 'as measured'
"""Name of an order that is none of the known ones."""
GOOD_SHARE = 0.3
"""Visible share from which an order is said to show an effect well."""


@dataclass(frozen=True, eq=False)
class OrderAdvice:
    """What one order shows: visibility of each effect, and what the run costs.

    worst: smallest typical share over the wanted effects and its name; travel_time: s of table and
    CMM moves; duration: s of the whole run. Of the orders that are only compared, `visibilities`
    holds the wanted effects alone.
    """

    order: str
    turning: str
    seed: int
    visibilities: tuple[Visibility, ...]
    worst: float
    worst_effect: str
    travel_time: float
    duration: float

    @property
    def label(self):
        """Order and turning in words."""
        plain = (self.order, 'alternate') not in VARIANTS
        return self.order if plain or self.turning == 'forward' else (
            f'{self.order}, turning {self.turning}')

    def share(self, name):
        """Return the typical visible share of an effect."""
        return next(v.typical_share for v in self.visibilities if v.name == name)


@dataclass(frozen=True, eq=False)
class Advice:
    """The present order, the recommended next one, all that were compared, and why.

    weak: effects that the present order hides or shows badly; apart: for each pair of look-alikes of
    the present order, the largest cosine of their shapes in the recommended one is below that of the
    look-alikes; text: for a person.
    """

    present: OrderAdvice
    best: OrderAdvice
    orders: tuple[OrderAdvice, ...]
    weak: tuple[str, ...]
    wanted: tuple[str, ...]
    text: str


def planned_run(scheme, radius, seconds_per_ball=SECONDS_PER_BALL):
    """Return a run as it is expected: nominal centres, times of moves and touches, slow warming.

    scheme: Scheme; radius: m. The temperature rises by 0.1 K along half a sine, so that what follows
    the temperature is not the same as what follows the time.
    """
    travel = unwrap_travel(scheme.table_angle, scheme.approach, scheme.n)
    centres = scheme.centres(radius)
    turn = np.abs(np.diff(travel, prepend=travel[:1])) / TABLE_SPEED
    move = np.linalg.norm(np.diff(centres, axis=0, prepend=centres[:1]), axis=1) / CMM_SPEED
    time = np.cumsum(seconds_per_ball + np.maximum(turn, move))
    time = time - time[0]
    return Run.from_readings(
        scheme.n, radius, scheme.table_position, scheme.ball, centres, time=time,
        temperature=20 + 0.1 * np.sin(0.5 * np.pi * time / time[-1]), approach=scheme.approach,
        source=f'planned run, order {scheme.order}')


def judge(scheme, radius, sigma, wanted=(), terms=None, names=(), run=None):
    """Return the OrderAdvice of a scheme.

    wanted: names that count, all that can be judged if none; names: of the effects to look at, all
    if none; run: the Run that was measured so, without it the run is taken as it is expected.
    """
    planned = planned_run(scheme, radius)
    seen = visibility(planned if run is None else run, sigma, terms, names=names)
    counted = [v for v in seen if not v.reason and (not wanted or v.name in wanted)]
    worst = min(counted, key=lambda v: v.typical_share)
    turning = 'alternate' if np.any(scheme.approach < 0) else 'forward'
    duration = float(planned.time[-1])
    return OrderAdvice(scheme.order, turning, scheme.seed, seen, worst.typical_share, worst.name,
                       duration - SECONDS_PER_BALL * (planned.size - 1), duration)


def advise(n, order='diagonal', radius=0.1825, sigma=1e-7, wanted=(), turning='forward', seed=0):
    """Return the Advice for a cell of n balls that measures in `order` now.

    wanted: names of effects that the next run must show (the weak ones of the present order if none).
    The best order has the largest worst share over what is wanted; of orders within a tenth of it,
    the one with the least travel.
    """
    present = judge(plan(n, order, seed, turning), radius, sigma)
    return _advice(present, n, radius, sigma, wanted, seed)


def advise_run(run, wanted=(), seed=0):
    """Return the Advice for the cell that measured a run: its own times and senses count.

    wanted: as in `advise`; seed: of the order random that is compared.
    """
    sigma = run.repeatability or 1e-7
    present = judge(scheme_of(run), run.radius, sigma, run=run)
    return _advice(present, run.n, run.radius, sigma, wanted, seed)


def scheme_of(run):
    """Return the Scheme in which a run was measured; its order is named where it is known."""
    cell = (run.table_position, run.ball)
    for name in ORDERS:
        for turning in TURNINGS:
            known = plan(run.n, name, 0, turning)
            if run.is_complete and np.array_equal(cell, (known.table_position, known.ball)):
                return Scheme(run.n, name, 0, *cell, run.approach)
    return Scheme(run.n, AS_MEASURED, 0, *cell, run.approach)


def compared_orders(n, radius, sigma, wanted, seed=0):
    """Return the OrderAdvice of every order and turning, about the wanted effects alone."""
    return tuple(judge(plan(n, name, seed, turning), radius, sigma, wanted, names=wanted)
                 for name, turning in VARIANTS)


def best_of(orders):
    """Return the OrderAdvice with the least travel of those whose worst share is near the top."""
    top = max(entry.worst for entry in orders)
    return min((entry for entry in orders if entry.worst >= 0.9 * top),
               key=lambda entry: entry.travel_time)


def _advice(present, n, radius, sigma, wanted, seed):
    """Return the Advice beside the present order."""
    weak = tuple(v.name for v in present.visibilities
                 if not v.reason and v.typical_share < GOOD_SHARE)
    wanted = tuple(wanted) or weak or tuple(v.name for v in present.visibilities if not v.reason)
    every = compared_orders(n, radius, sigma, wanted, seed)
    best = best_of(every)
    best = judge(plan(n, best.order, seed, best.turning), radius, sigma, wanted)
    return Advice(present, best, every, weak, wanted, _text(present, best, weak, wanted))


def _text(present, best, weak, wanted):
    hidden = [name for name in weak if present.share(name) < HIDDEN_SHARE]
    shy = [name for name in weak if name not in hidden]
    parts = []
    if hidden:
        parts.append(f'Order {present.label} hides {", ".join(hidden)}.')
    if shy:
        parts.append(f'It shows {", ".join(shy)} only weakly.')
    if not weak:
        parts.append(f'Order {present.label} shows every effect of the library.')
    if best.label != present.label and best.worst > present.worst + 0.02:
        shares = ', '.join(f'{name} {present.share(name):.2f} -> {best.share(name):.2f}'
                           for name in wanted[:6])
        longer = best.duration / present.duration - 1
        parts.append(f'Measure next in order {best.label}: visible shares {shares}; the run takes '
                     f'{abs(longer):.0%} {"longer" if longer >= 0 else "less"}.')
    still = [name for name in wanted if best.share(name) < HIDDEN_SHARE]
    if still:
        parts.append(f'No order here shows {", ".join(still)}: repeat balls after turning the table '
                     'the other way, or check it with another instrument.')
    return ' '.join(parts)
