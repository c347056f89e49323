# SPDX-License-Identifier: Apache-2.0
"""Error motions of a table in a line each (ISO 230-7): range, parts, uncertainty, and conformity to a tolerance."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Protocol

import numpy as np

from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.geometry import Floats, same_angles
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.mixture import Mixture
from rosette_ros.core.uncertainty.stated_environment import Unseen

DECISION_RULE = ('ISO 14253-1, guard band U (k = 2) of the range: conforms where range + U is at most the tolerance, '
                 'does not conform where range − U is more; otherwise neither conformity nor non-conformity can be '
                 'proven (uncertainty range)')
LACKING = 'the model lacks what was found in the readings; it is stated under a model that has it'
"""Why no conformity is stated with curves over explanations that the model does not have."""
SURE = 0.5 + 0.5 * math.erf(COVERAGE_FACTOR / math.sqrt(2))
"""Probability from which on it is decided: that of a normal range at the guard band U, 97.7 %."""
WHOLE, NO_MEAN, ONE_SENSE = 'whole', 'no mean', 'one sense'
"""What four-axis errors contain of the reversal of a table: all, all but its mean, nothing."""
FEWEST_ANGLES = 4
"""A once-per-turn part is told from the rest of a curve with so many points at least."""


class Conformity(StrEnum):
    """What a range and its uncertainty say about a tolerance, ISO 14253-1."""

    CONFORMS = 'conforms'
    FAILS = 'does not conform'
    UNDECIDED = 'not decidable'


def conformity(value: float, expanded: float, limit: float) -> Conformity:
    """Return the Conformity of a value with its expanded uncertainty to an upper limit: the guard band is U."""
    if value + expanded <= limit:
        return Conformity.CONFORMS
    return Conformity.FAILS if value - expanded > limit else Conformity.UNDECIDED


def worst_of(decided: Iterable[Conformity | None]) -> Conformity | None:
    """Return what is decided of several tolerances together, the worst; None where none is stated."""
    every = set(decided)
    return next((one for one in (Conformity.FAILS, Conformity.UNDECIDED, Conformity.CONFORMS) if one in every), None)


class Judgement(Protocol):
    """What a verdict on one run or several says of U."""

    @property
    def model_fails(self) -> bool:
        """Whether the model is refuted."""

    @property
    def unseen(self) -> Unseen | None:
        """What U contains of what the order hides, None where that does not matter."""


def refuted(verdict: Judgement | None) -> str:
    """Return why the model is refuted: '' where it is not, or was not judged."""
    fails = verdict is not None and verdict.model_fails
    return 'the model does not fit the readings, so that U does not contain all' if fails else ''


def doubt_of(verdict: Judgement | None) -> str:
    """Return why U does not say how large the errors are: '' where it does, or the model was not judged."""
    lacks = verdict is not None and verdict.unseen is not None and not verdict.unseen.environment
    return refuted(verdict) or 'no environment is stated, and U lacks what this order cannot show' * lacks


@dataclass(frozen=True)
class AxisError:
    """One error of a table; m or rad.

    curve, name: after VDI/VDE 2617 and ISO 230-1; range: the synchronous error motion value; u_range: its standard
    uncertainty; u_point: the largest of a point of the curve; once_per_turn, residual: range of the fundamental
    error motion and of the rest, NaN where the curve has too few points; asynchronous, u_asynchronous: largest
    width of the curves of several runs at one angle, None from one run; tolerance: of the range, or None; doubt: why no
    conformity is stated although there is a tolerance, '' where it is; spread: distribution of the range, None where it
    is normal.
    """

    curve: str
    name: str
    range: float
    u_range: float
    u_point: float
    once_per_turn: float
    residual: float
    asynchronous: float | None = None
    u_asynchronous: float | None = None
    tolerance: Tolerance | None = None
    doubt: str = ''
    spread: Mixture | None = None

    @property
    def expanded(self) -> float:
        """U of the range, k times its standard uncertainty."""
        return self.factor * self.u_range

    @property
    def conformity(self) -> Conformity | None:
        """What is decided about the tolerance; None where there is none."""
        if self.tolerance is None:
            return None
        if self.doubt:
            return Conformity.UNDECIDED
        if self.spread is None:
            return conformity(self.range, self.expanded, self.tolerance)
        within = self.spread.below(self.tolerance)
        return (Conformity.CONFORMS if within >= SURE else
                Conformity.FAILS if within <= 1 - SURE else Conformity.UNDECIDED)

    @property
    def within(self) -> float | None:
        """Probability that the range is within the tolerance (JCGM 106, 7); None where there is none."""
        if self.tolerance is None:
            return None
        if self.spread is not None:
            return self.spread.below(self.tolerance)
        off = self.tolerance - self.range
        return 0.5 + 0.5 * math.erf(off / self.u_range / math.sqrt(2)) if self.u_range else float(off >= 0)

    @cached_property
    def factor(self) -> float:
        """k of the interval that contains the range as often as k = 2 does where it is normal."""
        return float(COVERAGE_FACTOR) if self.spread is None else self.spread.factor(2 * SURE - 1)


def error_lines(motions: ErrorMotions, u_range: Floats | None = None, tolerances: Mapping[str, Tolerance] | None = None,
                doubt: str = '', widths: tuple[Floats, Floats] | None = None) -> tuple[AxisError, ...]:
    """Return an AxisError for each of CURVES.

    u_range: (6,), None for the sum of the u of both points, which no correlation exceeds; tolerances: of ranges by
    curve; doubt: as of AxisError; widths: of several runs and their u, (6,) each, NaN where not known."""
    names, wanted = motions.iso_names, tolerances or {}
    high, low = extremes(motions)
    span = peak_to_valley(motions.values)
    spread = motions.u[high, range(6)] + motions.u[low, range(6)] if u_range is None else u_range
    lines = []
    for place, curve in enumerate(CURVES):
        values = motions.values[:, place]
        once = once_per_turn(values, motions.angle)
        width, u_width = ((float(one[place]) for one in widths) if widths and np.isfinite(widths[0][place])
                          else (None, None))
        lines.append(AxisError(
            curve, names[curve], float(span[place]), float(spread[place]), float(motions.u[:, place].max()),
            2 * abs(once), float(peak_to_valley(values - (once * np.exp(-1j * motions.angle)).real)), width, u_width,
            wanted.get(curve), doubt))
    return tuple(lines)


def fit_lines(fit: Fit, tolerances: Mapping[str, Tolerance] | None = None, doubt: str = '') -> tuple[AxisError, ...]:
    """Return the AxisErrors of a Fit, over its explanations; tolerances, doubt: as of error_lines."""
    high, low = extremes(fit.error_motions)
    if len(fit.explanations) < 2:
        return error_lines(fit.error_motions, _u_of_range(fit, high, low), tolerances, doubt)
    return lines_of(fit.error_motions, explained_ranges(fit, high, low), tolerances, doubt)


def explained_ranges(fit: Fit, high: Sequence[int], low: Sequence[int], scale: float = 1.0,
                     others: Floats | float = 0.0) -> list[Mixture]:
    """Return the distribution of one point less another of each curve, 0..n-1, over the explanations of a fit.

    scale: of the noise; others: variance beside, (6,)."""
    p, fits = zip(*fit.explanations)
    steps = [one.error_motions.values[high, range(6)] - one.error_motions.values[low, range(6)] for one in fits]
    spreads = [np.sqrt((scale * _u_of_range(one, high, low))**2 + others) for one in fits]
    return [Mixture(np.array(p) / sum(p), *map(np.array, some)) for some in zip(
        np.transpose(steps), np.transpose(spreads))]


def _u_of_range(fit: Fit, high: Sequence[int], low: Sequence[int]) -> Floats:
    return np.asarray(fit.weighted_sigma * np.sqrt(fit.joint.difference_cofactor(high, low)))


def lines_of(motions: ErrorMotions, spreads: Sequence[Mixture], tolerances: Mapping[str, Tolerance] | None = None,
             doubt: str = '') -> tuple[AxisError, ...]:
    """Return the AxisErrors of curves whose ranges have these distributions; the others as of error_lines."""
    lines = error_lines(motions, np.sqrt([one.moments[1] for one in spreads]), tolerances, doubt)
    return tuple(replace(line, spread=one) for line, one in zip(lines, spreads, strict=True))


@dataclass(frozen=True, eq=False)
class SphereErrors:
    """Four-axis errors of a test sphere (ISO 10360-3:2000), m.

    sphere: A or B; height, radius: where it is, m; ranges, u: FR, FT and FA, the ranges of its radial, tangential and
    axial coordinate, with their standard uncertainties, (3,)."""

    sphere: str
    height: float
    radius: float
    ranges: Floats
    u: Floats


def four_axis_errors(curves: Sequence[ErrorMotions], radius: float, height: float) -> tuple[SphereErrors, SphereErrors]:
    """Return what error motions of a table, of one sense or of both, make of two opposite test spheres.

    B stands on `radius`, m, in the plane of the balls at height 0, A opposite at `height`, m. At azimuth a a sphere at
    p moves by T + Theta x p, along (cos a, sin a, 0), (-sin a, cos a, 0) and z; means of T and Theta are those of the
    axis to which its coordinates refer. The six are taken as uncorrelated, the ends of a range as u1 + u2."""
    values = np.concatenate([one.values for one in curves])
    angle, u = np.concatenate([one.angle for one in curves]), np.concatenate([one.u for one in curves])
    made = []
    for sphere, level, azimuth in (('A', height, 0.0), ('B', 0.0, np.pi)):
        cosine, sine, none = np.cos(angle + azimuth), np.sin(angle + azimuth), np.zeros(angle.size)
        way = np.stack([  # (m, 3, 6)
            np.stack([cosine, sine, none, -level * sine, level * cosine, none], axis=-1),
            np.stack([-sine, cosine, none, -level * cosine, -level * sine, none + radius], axis=-1),
            np.stack([none, none, none + 1, radius * sine, -radius * cosine, none], axis=-1)], axis=1)
        moved = np.einsum('mkc,mc->mk', way, values - values.mean(axis=0))
        spread = np.sqrt(np.einsum('mkc,mc->mk', way**2, u**2))
        made.append(SphereErrors(sphere, level, radius, peak_to_valley(moved), sum(
            spread[at, range(3)] for at in (moved.argmax(axis=0), moved.argmin(axis=0)))))
    return made[0], made[1]


def peak_to_valley(values: Floats) -> Floats:
    """Return the range of each curve, (n, ...) to (...)."""
    return np.asarray(np.ptp(values, axis=0))


def difference(one: ErrorMotions, other: ErrorMotions) -> ErrorMotions | None:
    """Return the curves of one run less those of another, u^2 = u1^2 + u2^2; None where the table angles differ."""
    if not same_angles(one.angle, other.angle):
        return None
    return ErrorMotions(one.angle, one.values - other.values, np.hypot(one.u, other.u), one.rotation)


def extremes(motions: ErrorMotions) -> tuple[list[int], list[int]]:
    """Return at which points, 0..n-1, each of the six curves is highest and lowest."""
    return motions.values.argmax(axis=0).tolist(), motions.values.argmin(axis=0).tolist()


def once_per_turn(values: Floats, angle: Floats) -> complex:
    """Return c of the part Re(c exp(-i angle)) of a curve (n,), fitted together with its mean; NaN from few points."""
    if values.size < FEWEST_ANGLES:
        return complex(np.nan)
    columns = np.stack([np.cos(angle), np.sin(angle), np.ones(angle.size)], axis=-1)
    cosine, sine, _ = np.linalg.lstsq(columns, values)[0].tolist()
    return complex(cosine, sine)
