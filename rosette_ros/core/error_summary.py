# SPDX-License-Identifier: Apache-2.0
"""The six errors of a table in a line each (ISO 230-7): range, parts, uncertainty, and conformity to a tolerance."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from rosette_ros.core.geometry import Floats, same_angles
from rosette_ros.core.records import CURVES, ErrorMotions

if TYPE_CHECKING:  # what only shows results starts without the least squares
    from rosette_ros.core.diagnosis.verdict import Judged
    from rosette_ros.core.joint.conclusion import Conclusion
    from rosette_ros.core.model.least_squares import Fit

COVERAGE_FACTOR = 2
"""k of expanded uncertainties, about 95 % (GUM 6.2)."""
DECISION_RULE = ('ISO 14253-1, guard band U (k = 2) of the range: conforms where range + U is at most the tolerance, '
                 'does not conform where range − U is more; otherwise not decidable')
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


def doubt_of(verdict: 'Judged | Conclusion | None') -> str:
    """Return why U does not say how large the errors are: '' where the model is not refuted, or was not judged."""
    fails = verdict is not None and verdict.model_fails
    return 'the model does not fit the readings, so that U does not contain all' if fails else ''


@dataclass(frozen=True)
class AxisError:
    """One error of a table; m or rad.

    curve, name: after VDI/VDE 2617 and ISO 230-1; range: peak to valley, the synchronous error; u_range: its standard
    uncertainty; u_point: the largest of a point of the curve; once_per_turn, residual: peak to valley of the
    fundamental part and of the rest, NaN where the curve has too few points; asynchronous, u_asynchronous: largest
    width of the curves of several runs at one angle, None from one run; tolerance: of the range, or None; doubt: why no
    conformity is stated although there is a tolerance, '' where it is.
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
    tolerance: float | None = None
    doubt: str = ''

    @property
    def expanded(self) -> float:
        """U of the range, k = 2."""
        return COVERAGE_FACTOR * self.u_range

    @property
    def conformity(self) -> Conformity | None:
        """What is decided about the tolerance; None where there is none."""
        if self.tolerance is None:
            return None
        return Conformity.UNDECIDED if self.doubt else conformity(self.range, self.expanded, self.tolerance)


def error_lines(motions: ErrorMotions, u_range: Floats | None = None, tolerances: Mapping[str, float] | None = None,
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


def fit_lines(fit: 'Fit', tolerances: Mapping[str, float] | None = None, doubt: str = '') -> tuple[AxisError, ...]:
    """Return the AxisErrors of a Fit; tolerances, doubt: as of error_lines."""
    return error_lines(fit.error_motions, fit.weighted_sigma * np.sqrt(
        fit.joint.difference_cofactor(*extremes(fit.error_motions))), tolerances, doubt)


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
