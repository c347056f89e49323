# SPDX-License-Identifier: Apache-2.0
"""Plans side by side: what each determines and shows, and which is better where."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.planning.expectation import Expectation, expect
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.records import Floats
from rosette_ros.core.run.reduced_sets import best_members, fewest_members, penalty, relative_uncertainty
from rosette_ros.core.run.remarks import Remark, remark
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.core.run.touches import USUAL_PACE, Pace
from rosette_ros.core.sight.visibility import GOOD_SHARE, Visibility, visibility
from rosette_ros.core.uncertainty.hidden_effects import MOST_BALLS as LARGEST
from rosette_ros.core.uncertainty.hidden_effects import expected_u
from rosette_ros.core.uncertainty.stated_environment import Environment

NOTICED = 0.02
"""Relative differences of uncertainties and times that are not worth a word."""
SHARES, MOST_BALLS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 1), 36
"""Shares of the CMM positions for which the best sets are looked for; of larger plates neither these nor effects."""
Point = tuple[str, float, float]
"""Name, share N / n^2 of the readings of a complete run, uncertainty of the curves relative to it."""


class PlanRemark(StrEnum):
    """In what plans differ; words/plan_words.py says it."""

    UNCERTAINTY = 'uncertainty of the curves'
    TIME = 'time'
    EFFECTS = 'effects shown well'
    SHOWN_BY_ONE = 'effects that one plan alone shows'
    SHOWN_BY_NONE = 'effects that no plan shows'
    BALL_PLACES_LEFT_OUT = 'ball places without deviations'
    CMM_POSITIONS_LEFT_OUT = 'CMM positions without deviations'


@dataclass(frozen=True, eq=False)
class Outlook:
    """A plan by its name, with what it determines; radius: m; sigma: of a coordinate from USUAL touches, m.

    effects: what it shows of each effect of the library, () for plates of more than MOST_BALLS balls; rotation: of the
    table in the machine, as of Run; environment: that is stated, None where none is; u: (n, 6) expected standard
    uncertainties of the curves, m and rad, with what it hides where it is stated.
    """

    name: str
    scheme: Scheme
    radius: float
    sigma: float
    expectation: Expectation
    effects: tuple[Visibility, ...]
    u: Floats
    rotation: Floats | None = None
    environment: Environment | None = None

    @property
    def penalty(self) -> float:
        """u relative to that of a complete run of the usual touches that hides nothing, rms over the curves."""
        return relative_uncertainty((self.u / self.sigma)**2, self.radius) if self.environment else (
            self.expectation.penalty)

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of the effects that it shows well."""
        return tuple(one.name for one in self.effects if not one.reason and one.typical_share >= GOOD_SHARE)

    @property
    def judged(self) -> tuple[str, ...]:
        """Names of the effects that it can be judged on."""
        return tuple(one.name for one in self.effects if not one.reason)


def outlook(name: str, scheme: Scheme, radius: float, sigma: float = 1e-7, pace: Pace = USUAL_PACE,
            effects: bool = True, rotation: Floats | None = None, environment: Environment | None = None) -> Outlook:
    """Return the Outlook of a plan; pace: of the cell; effects: whether to look at them; environment: that is stated.

    rotation: of the table in the machine, as of Run: effects of gravity and of the CMM's axes depend on it.

    Raises InvalidPlan where the plan does not determine the curves or is too large.
    """
    expected = expect(scheme, radius, pace)
    if environment and scheme.n > LARGEST:
        raise InvalidPlan(f'{name}: expected at most {LARGEST} balls in an environment, found {scheme.n}')
    run, spread = planned_run(scheme, radius, pace, rotation), sigma * expected.spread
    seen = visibility(run, spread) if effects and scheme.n <= MOST_BALLS else ()
    u = expected_u(run, spread, environment) if environment else sigma * expected.u
    return Outlook(name, scheme, radius, sigma, expected, seen, u, rotation, environment)


def point_of(plan: Outlook) -> Point:
    """Return the Point of a plan."""
    return plan.name, plan.scheme.ball.size / plan.scheme.n**2, plan.expectation.penalty


def best_sets(n: int) -> list[tuple[float, float]]:
    """Return share and relative uncertainty of the best sets of CMM positions of n balls, for some shares."""
    sizes = sorted({max(fewest_members(n), round(n * share)) for share in SHARES}) if n <= MOST_BALLS else []
    return [(size / n, penalty(n, best_members(n, size))) for size in sizes]


def better(plans: Sequence[Outlook]) -> tuple[Remark, ...]:
    """Return which of several plans is better in which respect."""
    said = [_best(plans, PlanRemark.UNCERTAINTY, lambda one: one.penalty),
            _best(plans, PlanRemark.TIME, lambda one: one.expectation.duration)]
    if all(one.effects for one in plans):
        said.append(_best(plans, PlanRemark.EFFECTS, lambda one: len(one.shown), most=True,
                          judged=max(len(one.judged) for one in plans)))
        for one in plans:
            others = {name for other in plans if other is not one for name in other.shown}
            if own := tuple(name for name in one.shown if name not in others):
                said.append(remark(PlanRemark.SHOWN_BY_ONE, plan=one.name, effects=own))
        nobody = tuple(effect.name for effect in plans[0].effects
                       if effect.name in plans[0].judged and not any(effect.name in one.shown for one in plans))
        said += [remark(PlanRemark.SHOWN_BY_NONE, effects=nobody)] if nobody else []
    for one in plans:
        for kind, used in ((PlanRemark.BALL_PLACES_LEFT_OUT, one.scheme.ball),
                           (PlanRemark.CMM_POSITIONS_LEFT_OUT, one.scheme.cmm_position)):
            if number := one.scheme.n - np.unique(used).size:
                said.append(remark(kind, plan=one.name, number=number))
    return tuple(said)


def _best(plans: Sequence[Outlook], kind: PlanRemark, value: Callable[[Outlook], float], most: bool = False,
          **numbers: int) -> Remark:
    """Return which plans have the least value, or the most, and what the others have, none where all are alike."""
    every = sorted(plans, key=value, reverse=most)
    best = value(every[0])
    same = [one for one in every if abs(value(one) - best) <= NOTICED * abs(best)]
    return remark(kind, value=best, best=tuple(one.name for one in same),
                  others=tuple((one.name, value(one)) for one in every[len(same):]), **numbers)
