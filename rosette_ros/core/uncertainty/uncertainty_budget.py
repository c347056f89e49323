# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget of a run (GUM): what each influence contributes to each of the six curves.

An influence with the displacements D_m of the readings and the standard uncertainties u_m contributes

    u^2(point) = sum over m of (G D_m)^2 u_m^2

with G the least squares from readings to curves, effects of the model fitted anew. Independent influences add in
squares; the degrees of freedom follow Welch and Satterthwaite.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.model.least_squares import Fit, SigmaSource
from rosette_ros.core.model.noise import AXES
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import radial, rotate_z
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import ErrorMotions, Floats
from rosette_ros.core.run.remarks import Remark, remark
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.core.run.touches import LEAST_TOUCHES, centre_factors, usual_directions
from rosette_ros.core.sight.visibility import Visibility
from rosette_ros.core.uncertainty.budget_inputs import SECTIONS, BudgetInputs, temperature_course
from rosette_ros.core.uncertainty.budget_lines import (
    Contribution,
    bound_lines,
    explained_lines,
    frame_lines,
    hidden_lines,
    root_mean,
)
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import (
    AxisError,
    error_lines,
    explained_ranges,
    extremes,
    fit_lines,
    lines_of,
)
from rosette_ros.core.uncertainty.form_field import form_basis, standard_height
from rosette_ros.core.uncertainty.hidden_effects import CLAIMED, MOST_BALLS, Surrounded, surrounded
from rosette_ros.core.uncertainty.mixture import Mixture, total

CHUNK = 256
"""Readings that are propagated together."""
LEAST_SHARE = 0.25
"""Of the variance of the residuals at least this part is taken as noise, whatever the form of the balls explains."""
SEEN = 1e-6
"""What an influence leaves of the residuals is seen from this part of their standard deviation on."""
HARMLESS = 0.05
"""Bias of the curves, as displacement per rms displacement of the balls, below which an effect is left out."""
PROBABILITY = math.erf(COVERAGE_FACTOR / math.sqrt(2))
"""That a normal quantity lies within k = 2 of its mean: 0.9545."""


class BudgetGap(StrEnum):
    """What a budget does not consider; words/budget_words.py says it."""

    MODEL = 'what the model lacks'
    NOT_STATED = 'sections without a value'
    TOUCHES = 'scatter of single touches'
    HIDDEN = 'effects that the order hides'
    UNBOUNDED = 'hidden effects without a largest size'
    STATED_IN_NO_LINE = 'effects of stated size that are not judged'
    NOT_JUDGED = 'effects that are not judged'
    HARMONICS = 'harmonics that the table positions do not sample'


class TouchScatter(NamedTuple):
    """Scatter of single touches along their normals, m, directions of the touches of a ball (Q, 3), dof, its source."""

    sigma: float
    direction: Floats
    dof: float
    source: str


@dataclass(frozen=True, eq=False)
class Budget:
    """The uncertainty budget of a Fit.

    inputs: as stated; contributions: in order; open: what is not considered; sigma: what white noise is
    multiplied by, m, once what other influences leave in the residuals is taken off; touch: scatter and directions of
    the touches; touch_share: (3,) part of the variance of a centre that they are; around: the fit in the environment
    that is stated, explained: each explanation of the run in it, with its probability; None and empty without one.
    """

    fit: Fit
    inputs: BudgetInputs
    contributions: tuple[Contribution, ...]
    open: tuple[Remark, ...]
    sigma: float
    dof: float
    touch: TouchScatter | None
    touch_share: Floats
    around: Surrounded | None = None
    explained: tuple[tuple[float, Surrounded], ...] = ()

    def combined(self, with_hidden: bool = True) -> Floats:
        """Return the combined standard uncertainty of each point, (n, 6), m and rad (GUM 5.1.2); no bound is in it."""
        return np.asarray(np.sqrt(sum(one.u**2 for one in self.contributions if not one.is_bound and (
            with_hidden or not one.is_hidden))))

    @property
    def mean(self) -> Floats:
        """Combined standard uncertainties, root mean square over the points of each curve, (6,), m and rad."""
        return root_mean(self.combined())

    @property
    def error_motions(self) -> ErrorMotions:
        """The curves with their combined standard uncertainties."""
        values = _explained(self.explained)[0] if self.explained else self.fit.error_motions.values
        return replace(self.fit.error_motions, values=values, u=self.combined())

    def lines(self, tolerances: Mapping[str, Tolerance] | None = None, doubt: str = '') -> tuple[AxisError, ...]:
        """Return the AxisErrors of the curves with these uncertainties; tolerances, doubt: as of error_lines.

            u^2(range) = sigma^2 cofactor(difference) + sum over what is no noise of (u(highest) + u(lowest))^2

        No correlation of both points exceeds the sum; that of what is claimed or may be there is known."""
        motions, curve = self.error_motions, range(6)
        high, low = extremes(motions)
        others = sum(((one.u[high, curve] + one.u[low, curve])**2 for one in self.contributions
                      if not (one.is_noise or one.is_bound or one.is_hidden)), np.zeros(6))
        if not self.explained and len(self.fit.explanations) > 1:
            scale = self.sigma / (self.fit.weighted_sigma or 1.0)
            return lines_of(motions, explained_ranges(self.fit, high, low, scale, others), tolerances, doubt)
        if not self.explained:
            square = self.sigma**2 * self.fit.joint.difference_cofactor(high, low) + others
            return error_lines(motions, np.sqrt(square), tolerances, doubt)
        p, every = zip(*self.explained)
        spreads = [one.ranges(high, low, others) for one in every]
        together = [Mixture.together(p, some) for some in zip(*spreads)]
        return lines_of(motions, together, tolerances, doubt)

    @property
    def effective_dof(self) -> Floats:
        """Degrees of freedom of the mean of each curve by Welch and Satterthwaite (GUM G.4.1), (6,); inf without any.

        The lines of the noise share one estimate of its size, and count as one."""
        noise = sum(one.mean**2 for one in self.contributions if one.is_noise)
        fourth = noise**2 / self.dof + sum(one.mean**4 / one.dof for one in self.contributions
                                              if not (one.is_noise or one.is_bound))
        whole = np.broadcast_to(fourth, self.mean.shape)
        dof: Floats = np.divide(self.mean**4, whole, out=np.full(self.mean.shape, np.inf), where=whole > 0)
        return dof

    @property
    def coverage(self) -> Floats:
        """Factors k for the probability of k = 2 of a normal quantity, by the degrees of freedom, (6,)."""
        dof = self.effective_dof
        finite = np.minimum(dof, 1e9)
        return np.asarray(scipy.special.stdtrit(finite, (1 + PROBABILITY) / 2))


def _explained(every: Sequence[tuple[float, Surrounded]]) -> tuple[Floats, Floats]:
    """Return curves and u over explanations with probabilities, (n, 6) each (law of total variance)."""
    p = np.array([one for one, _ in every])
    values, u = (np.stack([getattr(one.error_motions, name) for _, one in every]) for name in ('values', 'u'))
    return total(p / p.sum(), values, u)


def probability_of_u(dof: float) -> float:
    """Return the probability that U (k = 2) contains the true value, P(|t| < k) of Student's t (GUM G.3)."""
    return float(2 * scipy.special.stdtr(min(dof, 1e9), COVERAGE_FACTOR) - 1)


def budget(fit: Fit, inputs: BudgetInputs | None = None, touch: TouchScatter | None = None,
           hidden: Sequence[Visibility] | None = None, doubt: str = '',
           explanations: Sequence[tuple[float, Fit]] = ()) -> Budget:
    """Return the Budget of a fit.

    inputs: what is stated beside the readings; touch: scatter of the touches in the log; hidden: what the order of the
    run shows of each effect, where bounds of unnoticed effects shall count; doubt: why the model is refuted, in words;
    explanations: of the run, fits with probabilities, over which curves and U are taken in an environment.
    Raises InvalidData where the plate has too many balls or inputs do not fit the run.
    """
    run, inputs = fit.run, inputs or BudgetInputs()
    if run.n > MOST_BALLS:
        raise InvalidData(f'{run.source}: budget: expected at most {MOST_BALLS} balls, found {run.n}')
    if 'table_motions' not in fit.model.base:
        raise InvalidData(f'{run.source}: budget: expected a model with table_motions, found {fit.model}')
    touch = touch or _stated_touch(inputs)
    displaced = [*_form(fit, inputs, touch), *_temperature(fit, inputs)]
    sigma, dof = _noise_of(fit, displaced)
    taken_off = ' without form and temperature' if sigma != fit.sigma else ''
    variance, spread = _noise_variances(fit)
    sd, share = sigma * fit_loss(fit) * spread, np.zeros(3)
    if touch:
        factors = centre_factors(touch.direction)
        most = float((sd / factors).min())  # no more than centres scatter
        if touch.sigma > most:
            touch = touch._replace(sigma=most, source=f'{touch.source}, limited by the scatter of the centres')
        share = np.minimum((factors * touch.sigma / sd)**2, 1.0)
    sigma *= fit_loss(fit)
    lines = [Contribution(
        f'repeatability {axis}', f'scatter of centres{taken_off}{", beyond that of touches" if touch else ""}', 'A',
        'normal', float(sd[place] * np.sqrt(1 - share[place])), 'm', dof, sigma * np.sqrt(
            variance[place] * (1 - share[place])), fit.sigma_source, is_noise=True) for place, axis in enumerate(AXES)]
    if touch:
        lines.append(Contribution(
            'touches', f'scatter of single touches, {len(touch.direction)} to a sphere', 'A',
            'normal', touch.sigma, 'm', touch.dof, sigma * np.sqrt(np.tensordot(share, variance, axes=1)),
            touch.source, is_noise=True))
    around, explained = None, []
    if inputs.environment:
        around = surrounded(fit, inputs.environment)
        explained = [(p, surrounded(one, inputs.environment)) for p, one in explanations] or [(1.0, around)]
    if fit.effects:
        u = np.sqrt(around.parts[CLAIMED]) if around else sigma * np.sqrt(fit.joint.effect_cofactor())
        names = ', '.join(dict.fromkeys(one.name for one in fit.effects))
        lines.append(Contribution(CLAIMED, f'U of {names}, with all covariances', 'A', 'normal',
                                  sigma, 'm', dof, u, 'the fit', is_noise=True))
    lines += [one.line for one in displaced]
    lines += [*frame_lines(fit, inputs), *(
        hidden_lines(around, _explained(explained)[1]) if around else explained_lines(fit)),
              *bound_lines(fit, inputs, hidden)]
    return Budget(fit, inputs, tuple(lines), tuple(_open(fit, inputs, touch, hidden, doubt)), sigma, dof, touch, share,
                  around, tuple(explained))


def touch_scatter(refit: SphereRefit | None) -> TouchScatter | None:
    """Return what the touches in a log say: their scatter, and where the first ball was touched; None without any."""
    if refit is None:
        return None
    touched = refit.touched
    dof = max(refit.residual.size - LEAST_TOUCHES * refit.radius.size, 1)
    return TouchScatter(refit.sigma, refit.direction[touched.owner == 0], float(dof), 'touches in the log')


def fit_loss(fit: Fit) -> float:
    """Return by how much estimated weights widen the uncertainties of a fit."""
    return fit.weighted_sigma / fit.sigma if fit.sigma else 1.0


def _stated_touch(inputs: BudgetInputs) -> TouchScatter | None:
    if 'touches' not in inputs:
        return None
    return TouchScatter(inputs.value('touches', 'u_um'), usual_directions(int(inputs.value('touches', 'number'))),
                        inputs.dof.get('touches', np.inf), inputs.words.get('touches', 'inputs'))


def _noise_of(fit: Fit, displaced: Sequence['_Displaced']) -> tuple[float, float]:
    """Return standard deviation, m, and degrees of freedom of noise of size 1, freed of what influences leave.

    Few influences leave a known direction w of the residuals r each, with variance lambda^2; what the forms of many
    balls leave has no direction, and its expected square sum is taken off. The variance s is the most likely one of

        w r ~ N(0, s + lambda^2),    the rest of the square sum ~ s chi^2

    (restricted maximum likelihood, Patterson and Thompson 1971): an influence takes off what the readings show of it.
    """
    if fit.sigma_source in (SigmaSource.REPEATABILITY, SigmaSource.ROUNDING):
        return fit.sigma, np.inf
    stated = fit.run.scatter if fit.sigma_source is SigmaSource.POOLED else None
    dof = fit.dof + ((stated[1] if stated else None) or 0.0)
    if not fit.sigma:
        return 0.0, dof
    rows = np.concatenate([np.zeros((1, 3 * fit.run.size)), *(one.rows for one in displaced)]) / fit.sigma
    _, size, direction = np.linalg.svd(rows, full_matrices=False)
    known = size > SEEN
    shown = (direction[known] @ fit.white_residual.reshape(-1))**2 / fit.sigma**2
    rest_dof, extra = dof - shown.size, size[known]**2
    every = dof - shown.sum()  # square sum per sigma^2
    rest = max(every - sum(one.left for one in displaced) / fit.sigma**2, LEAST_SHARE * every)
    if rest <= 0 or rest_dof < 1:
        return fit.sigma, dof

    def slope(variance: float) -> float:
        """Return that of -2 log likelihood."""
        of_known = variance + extra
        return float(np.sum(1 / of_known - shown / of_known**2) + rest_dof / variance - rest / variance**2)

    variance = scipy.optimize.brentq(slope, rest / dof, (rest + shown.sum()) / rest_dof) if shown.size else rest / dof
    sigma = max(fit.sigma * float(np.sqrt(variance)), fit.run.rounding)
    return sigma, rest_dof + float(np.sum((variance / (variance + extra))**2))


def _noise_variances(fit: Fit) -> tuple[Floats, Floats]:
    """Return the variances of the curves by the noise of each axis, (3, n, 6), and its mean size by axis, (3,).

    Both for white noise of unit variance, effects left out: theirs are in the line of the effects."""
    size, space = fit.run.size, fit.joint.space
    out, square = np.zeros((3, fit.run.n, 6)), np.zeros(3)
    for axis in range(3):
        for start in range(0, size, CHUNK):
            here = np.arange(start, min(start + CHUNK, size))
            rows = np.zeros((here.size, size, 3))
            rows[np.arange(here.size), here, axis] = 1.0
            rows = space.whitening.inverse(rows)
            square[axis] += float(np.sum(rows**2)) / size
            out[axis] += np.sum(space.described(rows)[0].curves**2, axis=0)
    return out, np.sqrt(square)


class _Displaced(NamedTuple):
    """A contribution of displaced readings, and what it leaves in the white residuals: rows (m, 3 N), m, of one
    standard uncertainty each, or the expected square sum, m^2."""

    line: Contribution
    rows: Floats
    left: float = 0.0


def _displaced(fit: Fit, rows: Floats, line: Contribution, scale: float = 1.0) -> _Displaced:
    """Return the contribution of displacements (m, N, 3) of one standard uncertainty each, and what they leave."""
    u = np.sqrt(np.sum(fit.joint.curves(rows)**2, axis=0))
    return _Displaced(replace(line, u=scale * u), scale * fit.joint.residual(rows).reshape(len(rows), -1))


def _form(fit: Fit, inputs: BudgetInputs, touch: TouchScatter | None) -> list[_Displaced]:
    if 'ball_form' not in inputs:
        return []
    run, height = fit.run, standard_height(inputs.value('ball_form', 'form_um'))
    direction = form_directions(inputs, touch)
    sphere = np.linalg.pinv(np.column_stack([direction, np.ones(len(direction))]))[:3]
    turned = rotate_z(-run.phi[:, None], direction[None])
    centre = np.swapaxes(sphere @ form_basis(turned), 1, 2)  # (N, 32, 3)
    out = Contribution('form of the balls', f'{len(direction)} touches on balls that turn', 'B', 'rectangular',
                       height, 'm', inputs.dof.get('ball_form', np.inf), np.zeros((run.n, 6)),
                       inputs.words.get('ball_form', 'inputs'))
    variance, left = np.zeros((run.n, 6)), 0.0
    for ball in run.balls:
        own = np.flatnonzero(run.ball == ball)
        rows = np.zeros((centre.shape[1], run.size, 3))
        rows[:, own] = height * np.swapaxes(centre[own], 0, 1)
        one = _displaced(fit, rows, out)
        variance, left = variance + one.line.u**2, left + float(np.sum(one.rows**2))
    return [_Displaced(replace(out, u=np.sqrt(variance)), np.zeros((0, 3 * run.size)), left)]


def form_directions(inputs: BudgetInputs, touch: TouchScatter | None) -> Floats:
    """Return where balls are touched, (Q, 3): as in the log, else as stated."""
    return touch.direction if touch else usual_directions(int(inputs.value('ball_form', 'touches')))


def _temperature(fit: Fit, inputs: BudgetInputs) -> list[_Displaced]:
    run, (course, is_recorded), out = fit.run, temperature_course(fit.run), []
    empty = np.zeros((run.n, 6))
    for section, key, unit in (('plate_expansion', 'u_um_per_m_K', '1/K'), ('frame_expansion', 'u_um_per_K', 'm/K')):
        if section not in inputs:
            continue
        if not is_recorded and not inputs.value(section, 'range_K'):
            raise InvalidData(f'{run.source}: budget: {section}: expected range_K, as no temperature is recorded, '
                              'found '
                              'none')
        rows = (course[:, None] * (run.radius * radial(run.alpha)))[None] if section == 'plate_expansion' else np.stack(
            [course[:, None] * np.eye(3)[axis] for axis in range(3)])
        words, dof = inputs.words.get(section, 'inputs'), inputs.dof.get(section, np.inf)
        value, size = inputs.value(section, key), inputs.value(section, 'range_K') / np.sqrt(3)
        known = abs(inputs.value(section, 'coefficient_um_per_m_K')) if section == 'plate_expansion' else 0.0
        what = SECTIONS[section][0]
        name = f'temperature: {section.split("_")[0]}'
        if is_recorded:
            made = [(name, what, 'normal', value, unit, value)]
            if known:
                made.append(('temperature: plate, known', 'expansion that nobody took off; plate_expansion in the '
                             'model does', 'whole size', known, unit, known))
        else:
            made = [(name, f'{what}; steady change of temperature', 'rectangular', size, 'K',
                     size * float(np.hypot(value, known)))]
        for title, text, distribution, stated, of_unit, factor in made:
            line = Contribution(title, text, 'B', distribution, stated, of_unit, dof, empty, words)
            out.append(_displaced(fit, rows, line, factor))
    return out


def stated_lines(fit: Fit, made: Budget | None, tolerances: Mapping[str, Tolerance] | None = None,
                 doubt: str = '') -> tuple[ErrorMotions, tuple[AxisError, ...]]:
    """Return curves and AxisErrors of a Fit, with U of its budget where there is one; the others as of error_lines."""
    if made is None:
        return fit.error_motions, fit_lines(fit, tolerances, doubt)
    return made.error_motions, made.lines(tolerances, doubt)


def _open(fit: Fit, inputs: BudgetInputs, touch: TouchScatter | None,
          hidden: Sequence[Visibility] | None, doubt: str) -> list[Remark]:
    """Return what the budget does not consider."""
    out = [remark(BudgetGap.MODEL, doubt=doubt)] if doubt else []
    if lacking := tuple(section for section in SECTIONS if section not in inputs and section != 'touches'):
        out.append(remark(BudgetGap.NOT_STATED, sections=lacking))
    if touch is None:
        out.append(remark(BudgetGap.TOUCHES))
    if hidden is None:
        out.append(remark(BudgetGap.HIDDEN, environment=inputs.environment.name if inputs.environment else ''))
    else:
        harmful = tuple(one.name for one in hidden if not one.reason and not np.isfinite(one.detectable)
                        and one.name not in inputs.bounds
                        and np.max(one.bias * np.repeat([1.0, fit.mean_radius], 3)) > HARMLESS)
        if harmful:
            out.append(remark(BudgetGap.UNBOUNDED, effects=harmful))
        unjudged = {one.name: one.reason for one in hidden if one.reason}
        stated = {name: unjudged.pop(name) for name in inputs.bounds if name in unjudged}
        out += [remark(kind, reasons=reasons) for kind, reasons in (
            (BudgetGap.STATED_IN_NO_LINE, stated), (BudgetGap.NOT_JUDGED, unjudged)) if reasons]
    out.append(remark(BudgetGap.HARMONICS, order=fit.run.n // 2))
    return out
