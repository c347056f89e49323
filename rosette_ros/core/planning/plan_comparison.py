# SPDX-License-Identifier: Apache-2.0
"""Plans side by side: what each determines and shows, and which is better where."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.planning.expectation import Expectation, expect
from rosette_ros.core.run.errors import InvalidPlan, counted
from rosette_ros.core.run.records import Floats
from rosette_ros.core.run.reduced_sets import best_members, fewest_members, penalty, relative_uncertainty
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.core.run.touches import USUAL_PACE, Pace
from rosette_ros.core.sight.visibility import GOOD_SHARE, Visibility, visibility
from rosette_ros.core.uncertainty.hidden_effects import MOST_BALLS as LARGEST
from rosette_ros.core.uncertainty.hidden_effects import expected_u
from rosette_ros.core.uncertainty.stated_environment import Environment

NOTICED = 0.02
"""Relative differences of uncertainties and times that are not worth a word."""
LISTED = 8
SHARES, MOST_BALLS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 1), 36
"""Shares of the CMM positions for which the best sets are looked for; of larger plates neither these nor effects."""
Point = tuple[str, float, float]
"""Name, share N / n^2 of the readings of a complete run, uncertainty of the curves relative to it."""


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
        raise InvalidPlan(f'{name}: wanted at most {LARGEST} balls in an environment, got {scheme.n}')
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


def better(plans: Sequence[Outlook]) -> tuple[str, ...]:
    """Return in sentences which of several plans is better in which respect."""
    said = [_best(plans, 'Uncertainty of the curves, relative to a complete run', lambda one: one.penalty,
                  '{:.2f}'),
            _best(plans, 'Time', lambda one: one.expectation.duration / 3600, '{:.2f} h')]
    if all(one.effects for one in plans):
        said.append(_best(plans, f'Effects shown well, of {max(len(one.judged) for one in plans)}',
                          lambda one: len(one.shown), '{:.0f}', most=True))
        for one in plans:
            others = {name for other in plans if other is not one for name in other.shown}
            if own := [name for name in one.shown if name not in others]:
                said.append(f'Only {one.name} shows {_listed(own)} well.')
        nobody = [effect.name for effect in plans[0].effects
                  if effect.name in plans[0].judged and not any(effect.name in one.shown for one in plans)]
        said += [f'None shows {_listed(nobody)} well.'] if nobody else []
    for one in plans:
        unused = [(what, one.scheme.n - np.unique(used).size) for what, used in (
            ('ball place', one.scheme.ball), ('CMM position', one.scheme.cmm_position))]
        said += [f'{one.name} does not measure the deviations of {counted(number, what)}.'
                 for what, number in unused if number]
    return tuple(said)


def _best(plans: Sequence[Outlook], what: str, value: Callable[[Outlook], float], form: str, most: bool = False) -> str:
    """Return which plans have the least value, or the most, and what the others have; form: of a value."""
    every = sorted(plans, key=value, reverse=most)
    best, worst = value(every[0]), value(every[-1])
    if abs(worst - best) <= NOTICED * abs(best):
        return f'{what}: all alike ({form.format(best)}).'
    same = [one.name for one in every if abs(value(one) - best) <= NOTICED * abs(best)]
    rest = '; '.join(f'{one.name} {form.format(value(one))}' for one in every[len(same):])
    return f'{what}: best {"is" if len(same) == 1 else "are"} {_listed(same)} ({form.format(best)}); {rest}.'


def _listed(names: Sequence[str]) -> str:
    if len(names) <= LISTED:
        return ' and '.join([', '.join(names[:-1]), names[-1]] if len(names) > 1 else names)
    return f'{", ".join(names[:LISTED])} and {len(names) - LISTED} more'
