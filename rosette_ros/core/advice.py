# SPDX-License-Identifier: Apache-2.0
"""What the next run should be, so that it shows what this one cannot."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.records import Run
from rosette_ros.core.scheme import ORDERS, TURNINGS, plan, unwrap_travel
from rosette_ros.core.visibility import HIDDEN_SHARE, Visibility, visibility

SECONDS_PER_BALL = 30.0   # s, 20 touches and the move down and up
TABLE_SPEED = 0.1         # rad/s
CMM_SPEED = 0.05          # m/s
GOOD_SHARE = 0.3
"""Visible share from which an order is said to show an effect well."""


@dataclass(frozen=True, eq=False)
class OrderAdvice:
    """What one order shows: visibility of each effect, and what the run costs.

    worst: smallest typical share over the wanted effects and its name; travel_time: s of table and CMM
    moves; duration: s of the whole run.
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
        return self.order if self.turning == 'forward' else f'{self.order}, turning {self.turning}'

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


def judge(scheme, radius, sigma, wanted=(), terms=None):
    """Return the OrderAdvice of a scheme; wanted: names that count, all that can be judged if none."""
    run = planned_run(scheme, radius)
    seen = visibility(run, sigma, terms)
    counted = [v for v in seen if not v.reason and (not wanted or v.name in wanted)]
    worst = min(counted, key=lambda v: v.typical_share)
    turning = 'forward' if np.all(scheme.approach == 1) else 'alternate'
    touching = SECONDS_PER_BALL * (run.size - 1)
    return OrderAdvice(scheme.order, turning, scheme.seed, seen, worst.typical_share, worst.name,
                       float(run.time[-1] - touching), float(run.time[-1]))


def advise(n, order='diagonal', radius=0.1825, sigma=1e-7, wanted=(), turning='forward', seed=0):
    """Return the Advice for a cell of n balls that measures in `order` now.

    wanted: names of effects that the next run must show (the weak ones of the present order if none).
    The best order has the largest worst share over what is wanted; of orders within a tenth of it,
    the one with the least travel.
    """
    present = judge(plan(n, order, seed, turning), radius, sigma)
    weak = tuple(v.name for v in present.visibilities
                 if not v.reason and v.typical_share < GOOD_SHARE)
    wanted = tuple(wanted) or weak or tuple(v.name for v in present.visibilities if not v.reason)
    every = tuple(judge(plan(n, name, seed, sense), radius, sigma, wanted)
                  for name in ORDERS for sense in TURNINGS
                  if not (name == 'row' and sense == 'alternate'))
    top = max(entry.worst for entry in every)
    best = min((entry for entry in every if entry.worst >= 0.9 * top),
               key=lambda entry: entry.travel_time)
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
