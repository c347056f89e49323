# SPDX-License-Identifier: Apache-2.0
"""Curves of a table from two sources side by side, both without what no run can know: a maker's table against a run.

A maker's table has an origin and an axis of its own: another mean of each curve and, of (ctx, cty) and (crx, cry),
another once-per-turn part, which is how its body was clamped. Both are taken off both sides at the same angles; what is
then left of their difference is a difference of the tables.
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import TWO_PI, Bools, same_angles
from rosette_ros.core.run.records import CURVES, Floats, remove_gauge
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR

PAIRS = ((0, 1), (3, 4))
"""Places of the curves whose once-per-turn part is that of the clamping."""
MOST_WITHIN = 0.95
"""Share of points within U that agreeing curves have."""


@dataclass(frozen=True, eq=False)
class TableCurves:
    """Curves from one source. angle: (m,), rad; values, u: (m, 6), SI, standard; NaN in curves that it does not have or
    whose uncertainty it does not state."""

    name: str
    angle: Floats
    values: Floats
    u: Floats

    @property
    def known(self) -> Bools:
        """Which curves it has, (6,)."""
        return np.asarray(np.isfinite(self.values).all(axis=0))


@dataclass(frozen=True, eq=False)
class CurveComparison:
    """Two sources of curves at the angles of the coarser one, without their gauge.

    angle: (m,), rad; first, second: (m, 6), m and rad, NaN where not both have a curve; u: (m, 6) of the difference,
    NaN where neither states one; interpolated: name of the source that was interpolated, '' where none was; alone:
    curves of which the other one of the pair is missing, so that once-per-turn parts stay in them."""

    names: tuple[str, str]
    angle: Floats
    first: Floats
    second: Floats
    u: Floats
    interpolated: str
    alone: tuple[str, ...]

    @property
    def difference(self) -> Floats:
        """First less second, (m, 6)."""
        return self.first - self.second

    @property
    def compared(self) -> tuple[str, ...]:
        """The curves that both have."""
        return tuple(curve for place, curve in enumerate(CURVES) if np.isfinite(self.first[:, place]).all())

    def within(self, curve: str) -> float | None:
        """Return the share of the points whose difference is within U (k = 2), None where no U is stated."""
        place = CURVES.index(curve)
        u = self.u[:, place]
        if not np.isfinite(u).all():
            return None
        return float(np.mean(np.abs(self.difference[:, place]) <= COVERAGE_FACTOR * u))

    def agreeing(self, do_agree: bool | None) -> tuple[str, ...]:
        """Return the curves that agree within U, those that do not (False), or those without a U (None)."""
        shares = {curve: self.within(curve) for curve in self.compared}
        return tuple(curve for curve, share in shares.items()
                     if (None if share is None else share >= MOST_WITHIN) is do_agree)


def compare_curves(first: TableCurves, second: TableCurves) -> CurveComparison:
    """Return the comparison of two sources at the angles of the one with fewer, between which the other one is a
    straight line; raises InvalidData where they have no curve in common."""
    both = first.known & second.known
    if not both.any():
        raise InvalidData('compare-curves: expected curves that both have, found '
                          f'{", ".join(f"{one.name} with {_list(one.known)}" for one in (first, second))}')
    angle = min((first, second), key=lambda one: one.angle.size).angle
    sides, interpolated = [], ''
    for one in (first, second):
        if not same_angles(one.angle, angle):
            interpolated = one.name
        sides.append((_at(one, one.values, angle), _at(one, one.u, angle)))
    gauged = [np.where(both, remove_gauge(np.where(both, values, 0.0), angle), np.nan) for values, _ in sides]
    alone = []
    for pair in PAIRS:
        if both[[*pair]].sum() == 1:  # the other one is 0 there and would take half of the part
            place = next(one for one in pair if both[one])
            alone.append(CURVES[place])
            for made, (values, _) in zip(gauged, sides, strict=True):
                made[:, place] = values[:, place] - values[:, place].mean()
    u = np.sqrt(np.nansum([u**2 for _, u in sides], axis=0))
    unknown = np.all([np.isnan(u) for _, u in sides], axis=0)
    return CurveComparison((first.name, second.name), angle, gauged[0], gauged[1],
                           np.where(unknown | ~both, np.nan, u), interpolated, tuple(alone))


def _at(one: TableCurves, values: Floats, angle: Floats) -> Floats:
    """Return curves at angles (m,), rad, by straight lines around the turn, (m, 6)."""
    if same_angles(one.angle, angle):
        return values
    place = np.argsort(one.angle % TWO_PI)
    known = (one.angle % TWO_PI)[place]
    return np.column_stack([np.interp(angle % TWO_PI, known, column[place], period=TWO_PI) for column in values.T])


def _list(known: Bools) -> str:
    return ' '.join(curve for curve, is_there in zip(CURVES, known, strict=True) if is_there) or 'none'
