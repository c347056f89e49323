# SPDX-License-Identifier: Apache-2.0
"""Lines of an uncertainty budget: what a line is; those of the table frame, of hidden effects, of bounds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import InvalidData, unknown
from rosette_ros.core.run.records import Floats, remove_gauge
from rosette_ros.core.sight.visibility import GOOD_SHARE, Visibility
from rosette_ros.core.uncertainty.budget_inputs import BOUNDS, BudgetInputs
from rosette_ros.core.uncertainty.hidden_effects import Surrounded, at_ball, source_of

SEEN = 1e-3
"""Ratio to the uncertainty of a point from which on what other explanations add is a line."""


@dataclass(frozen=True, eq=False)
class Contribution:
    """One line of a budget.

    name, words: what it is; kind: A by statistics, B by other knowledge (GUM 4.2, 4.3); distribution: of the input;
    value: standard uncertainty of the input in `unit` (SI); dof: its degrees of freedom; u: (n, 6) of the curves, m and
    rad; source: whence the value is; is_bound: whether it is a bound, is_hidden: an effect that may be there: a Monte
    Carlo repeats neither; is_noise: whether its size is that of the noise of the readings.
    """

    name: str
    words: str
    kind: str
    distribution: str
    value: float
    unit: str
    dof: float
    u: Floats
    source: str
    is_bound: bool = False
    is_noise: bool = False
    is_hidden: bool = False

    @property
    def mean(self) -> Floats:
        """Root mean square over the points of each curve, (6,), m and rad: squares of these add up, too."""
        return root_mean(self.u)

    @property
    def sensitivity(self) -> Floats:
        """Mean standard uncertainty of each curve per unit of the input, (6,)."""
        return self.mean / self.value if self.value else np.zeros(6)


def root_mean(u: Floats) -> Floats:
    """Return the root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(u**2, axis=0)))


def frame_lines(fit: Fit, inputs: BudgetInputs) -> list[Contribution]:
    """Return the contributions of the table frame and of the radius: they turn, move and stretch the curves.

        T' = T + Theta x o - delta x T,  Theta' = Theta - delta x Theta,  Theta' = Theta (1 - u(R) / R)
    """
    curves, out = fit.error_motions.values, []
    shift, turn = curves[:, :3], curves[:, 3:]

    def line(section: str, name: str, words: str, entry: str, unit: str, parts: list[Floats]) -> None:
        value = inputs.value(section, entry)
        if value:
            square = sum(remove_gauge(part, fit.error_motions.angle)**2 for part in parts)
            out.append(Contribution(name, words, 'B', 'normal', value, unit, inputs.dof.get(section, np.inf),
                                    value * np.sqrt(square), inputs.words.get(section, 'inputs')))

    still = np.zeros_like(turn)
    line('alignment', 'alignment: origin', 'the curves are those of another point', 'origin_um', 'm',
         [np.hstack([np.cross(turn, one), still]) for one in np.eye(3)])
    turned = [np.hstack([-np.cross(one, shift), -np.cross(one, turn)]) for one in np.eye(3)]
    line('alignment', 'alignment: axis', 'the curves are along other axes', 'tilt_urad', 'rad', turned[:2])
    line('alignment', 'alignment: azimuth', 'the curves are along other axes', 'azimuth_urad', 'rad', turned[2:])
    line('radius', 'radius', 'rotations are displacements divided by it', 'u_um', 'm',
         [np.hstack([still, -turn / fit.mean_radius])])
    return out


def hidden_lines(around: Surrounded, u: Floats) -> Iterator[Contribution]:
    """Yield a line for each effect that may be there, the one of the largest share in a curve first, and one for what
    other explanations of the run add; u: over all explanations, (n, 6)."""
    stated, words = at_ball(around.environment, around.fit.run), 'may be there by {:.0f} %, as far as the readings show'
    for name in around.shares:
        yield Contribution(f'hidden: {name}', words.format(100 * around.there[name]), 'B', 'normal, or nothing',
                           stated[name], 'm', np.inf, np.sqrt(around.parts[name]),
                           source_of(around.environment, name), is_hidden=True)
    yield from _others(around.fit, u, around.error_motions.u)


def explained_lines(fit: Fit) -> Iterator[Contribution]:
    """Yield a line for what other explanations of the run add to the curves of a fit over them."""
    if len(fit.explanations) > 1:
        yield from _others(fit, fit.error_motions.u, fit.weighted_sigma * np.sqrt(fit.joint.curve_cofactor()))


def _others(fit: Fit, u: Floats, alone: Floats) -> Iterator[Contribution]:
    """Yield the line of other explanations; u: over all of them, alone: of that of the fit, (n, 6)."""
    more = np.sqrt(np.maximum(u**2 - alone**2, 0))
    if np.any(more > SEEN * alone):
        yield Contribution('other explanations', 'curves with other causes in the model, by their probabilities', 'A',
                           'mixture', fit.sigma, 'm', np.inf, more, 'the diagnosis', is_hidden=True)


def bound_lines(fit: Fit, inputs: BudgetInputs, hidden: Sequence[Visibility] | None) -> list[Contribution]:
    """Return bounds of effects that are not in the model: of stated sizes, and of the worst that stays unnoticed."""
    if hidden is None:
        return []
    present, out, n = {one.name for one in fit.effects}, [], fit.run.n
    known = {one.name: one for one in hidden}
    for name, size in inputs.bounds.items():
        if name not in known:
            raise InvalidData(f'budget: {BOUNDS}: {unknown(name, known)}')
        if known[name].reason:
            continue
        value = size / np.sqrt(3)
        out.append(Contribution(f'hidden: {name}', 'an effect of at most the stated size, rms over the readings', 'B',
                                'rectangular', value, 'm', np.inf, np.tile(value * known[name].bias, (n, 1)),
                                'inputs', True))
    noticed = [one for one in hidden if not one.reason and np.isfinite(one.detectable)
               and one.typical_share < GOOD_SHARE and one.name not in {*present, *inputs.bounds}]
    if noticed:
        each = np.array([one.detectable / np.sqrt(3) * one.bias for one in noticed])
        worst = [noticed[place] for place in each.argmax(axis=0)]
        names = ', '.join(dict.fromkeys(one.name for one in worst))
        out.append(Contribution('hidden: any one effect', f'at its detection limit; worst: {names}',
                                'B', 'rectangular', float(np.median([one.detectable for one in worst]) / np.sqrt(3)),
                                'm', np.inf, np.tile(each.max(axis=0), (n, 1)), 'the order of measurement', True))
    return out
