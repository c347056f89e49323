# SPDX-License-Identifier: Apache-2.0
"""The one least squares: base model and effects, jointly.

Effects are linear in their amplitudes a. With D their columns, Q the base model's space and
D_perp = D - Q Q' D, the joint solution is a = D_perp^+ y, the base parameters follow from y - D a.
Nonlinear parameters enter the uncertainties by their tangents d(D a)/d(theta).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, reduce
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
import scipy  # which loads its parts where they are used
from numpy.typing import NDArray

from rosette_ros.core.effects.effect import Searched, Setting
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.effects.run_functions import BodyMotion
from rosette_ros.core.model.base_space import GAUGE, BaseParameters, BaseSpace
from rosette_ros.core.model.columns import independent
from rosette_ros.core.model.model import BASE_TERMS, Model, Term
from rosette_ros.core.model.noise import Noise, Real, Whitening
from rosette_ros.core.model.second_order import (
    CONVERGED,
    MOST_STEPS,
    ROUNDING,
    is_negligible,
    second_order,
    turned_plate,
)
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.geometry import TWO_PI, radial
from rosette_ros.core.run.number_words import micrometres
from rosette_ros.core.run.records import UNLIKELY, ErrorMotions, Floats, Ints, Run, in_time

HIDDEN = 1e-6
"""Visible share below which an effect is taken as hidden altogether (rounding is 1e-15)."""
HIDDEN_SHARE = 0.05
"""Visible share below which an order of measurement hides an effect, or a direction of a free course."""
REFINED = ('scale', 'phase')
"""Kinds of searched parameters that have an uncertainty."""
DRAWS = 128
"""Draws of noise by which it is known what a fit makes of neighbouring readings."""


SAME_STEPS = 1e-9
"""Share of the largest variance by rounding by which steps differ that are the same in a frame that was turned."""
FINEST = 3e-4
"""Size of noise over the largest errors of rounding below which the normal equations lose what is rounded coarsely."""
OF_ACCOUNT = 0.03
"""Share of the variance of the noise from which on errors of rounding shape it, and are told."""


class SigmaSource(StrEnum):
    """Whence the standard deviation of a coordinate is that the uncertainties are worked out from."""

    RESIDUALS = 'residuals'
    LARGER = 'residuals (larger than the repeatability)'
    UNEQUAL = 'residuals (the noise is not equal)'
    REPEATABILITY = 'repeatability'
    ROUNDING = 'rounding of the coordinates'
    POOLED = 'residuals and repeatability'


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter: value and standard uncertainty in an SI unit."""

    name: str
    value: float
    u: float
    unit: str


@dataclass(frozen=True, eq=False)
class FittedEffect:
    """An effect with the setting in use, its parameters and its part of the model, (N, 3), m."""

    name: str
    setting: Setting
    parameters: tuple[Parameter, ...]
    displacement: Floats

    @property
    def rms(self) -> float:
        """Root mean square of its part over all coordinates, m."""
        return float(np.sqrt(np.mean(self.displacement**2)))


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model.

    residual: (N, 3), m, observed minus model; plate, cmm: (n, 3), m; rms: root of the residuals' square sum per degree
    of freedom, m; sigma: standard deviation of a coordinate in use for the uncertainties, m, and sigma_source, where it
    comes from; reduced_chi_square: (rms/repeatability) squared, the repeatability with the errors of rounding, None
    where it is unknown; lack_of_fit_p: probability that noise of the known repeatability leaves as much, None likewise;
    rms, sigma: of the size that noise takes as 1; beyond: (N, 3) or (1, 3), m, second-order terms of which the readings
    were freed; explanations: fits with probabilities of which the curves are the mean, none where they are those of
    this fit; gauge: what no three-rosette run can know, in words.
    """

    run: Run
    model: Model
    error_motions: ErrorMotions
    plate: Floats
    cmm: Floats
    residual: Floats
    effects: tuple[FittedEffect, ...]
    rank: int
    dof: int
    rms: float
    sigma: float
    sigma_source: SigmaSource
    reduced_chi_square: float | None
    lack_of_fit_p: float | None
    mean_radius: float
    joint: 'JointSpace'
    noise: Noise
    beyond: Floats
    explanations: tuple[tuple[float, 'Fit'], ...] = ()
    gauge: ClassVar[tuple[str, ...]] = GAUGE

    @cached_property
    def white_residual(self) -> Floats:
        """The residual in white coordinates, (N, 3), m."""
        return np.asarray(self.joint.whitening.apply(self.residual[None])[0])

    @cached_property
    def neighbours(self) -> tuple[float, float]:
        """The correlation of consecutive readings, in white coordinates, beyond what the fit itself makes of noise of
        its kind, and the probability that such noise leaves as much, from DRAWS of it."""
        draws = np.random.default_rng(0).standard_normal((DRAWS, self.run.size, 3))
        every = np.concatenate([self.white_residual[None], self.joint.free(draws)])
        total = np.maximum(np.sum(every**2, axis=(1, 2)), np.finfo(float).tiny)
        value = np.sum(every[:, 1:] * every[:, :-1], axis=(1, 2)) / total
        beyond, sd = value[0] - value[1:].mean(), value[1:].std()
        return float(beyond), float(2 * scipy.special.ndtr(-abs(beyond) / sd)) if sd else 1.0

    @cached_property
    def equal_p(self) -> float | None:
        """The probability that noise of the known repeatability leaves as much where all readings count alike; None
        where it is not known."""
        if self.lack_of_fit_p is None or not self.noise.kinds:
            return self.lack_of_fit_p
        return fit(self.run, self.model, self.settings, beyond=self.beyond).lack_of_fit_p

    @property
    def p_of_small(self) -> float:
        """Probability that noise of the known repeatability leaves as little; 1 where it is not known."""
        chi, scatter = self.reduced_chi_square, self.run.scatter
        if chi is None or scatter is None:
            return 1.0
        known_dof = scatter[1]
        return float(scipy.special.chdtr(self.dof, chi * self.dof) if known_dof is None
                     else scipy.special.fdtr(self.dof, known_dof, chi))

    @property
    def rounded(self) -> float:
        """Share of errors of rounding in the variance of the noise, at most 1."""
        return min((self.run.rounding / self.rms)**2, 1.0) if self.rms else 0.0

    @property
    def step(self) -> float:
        """Largest step to which readings are rounded, m, 0 where that is of no account."""
        return float(self.run.steps.max()) if self.rounded > OF_ACCOUNT else 0.0

    @property
    def weighted_sigma(self) -> float:
        """Sigma with what is lost as weights are estimated, m: what the square roots of cofactors are multiplied by."""
        return self.sigma * float(np.sqrt(self.noise.loss(1 - self.dof / (3 * self.run.size))))

    @cached_property
    def deviation_u(self) -> tuple[Floats, Floats]:
        """Standard uncertainties of the deviations of plate and CMM, (n, 3) each, m."""
        plate, cmm = (np.asarray(self.weighted_sigma * np.sqrt(one)) for one in self.joint.deviation_cofactors())
        return plate, cmm

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """The settings of the effects, in the order of the model."""
        return tuple(effect.setting for effect in self.effects)


def mean_radius(run: Run) -> float:
    """Return the mean radius of the circle of ball centres, equation (10), m."""
    x, y = run.centre[:, 0], run.centre[:, 1]
    return float(np.mean((x * np.cos(run.alpha) + y * np.sin(run.alpha))[_by_place(run)]))


def _by_place(run: Run) -> Ints:
    """Return the indices that sort readings by table position and ball: sums do not depend on when one was taken."""
    return np.lexsort((run.ball, run.table_position))


def observed(run: Run) -> Floats:
    """Return centres minus nominal centres at the actual table angle, (N, 3), m."""
    return run.centre - run.radius * radial(run.alpha + run.angle_deviation)


class JointSpace:
    """Base model and effects on one run: projection, solution and cofactors.

    columns: (q, N, 3) of all effects together; tangents: (k, N, 3) of the nonlinear parameters, used for uncertainties
    only; visible_share: (q + k,) share of each that the base model leaves; undetermined: (q + k,) whether the readings
    leave it open; rank: of the columns.
    """

    def __init__(self, space: BaseSpace, columns: Floats, tangents: Floats) -> None:
        self.space, self.columns, self.q = space, columns, len(columns)
        self.every: Floats = np.concatenate([columns, tangents])
        size = self.every.shape[1] * 3
        flat = space.residual(self.every).reshape(len(self.every), size)
        full = np.linalg.norm(self.every.reshape(len(self.every), size), axis=1)
        scale = np.where(full > 0, full, 1.0)
        self.visible_share: Floats = np.linalg.norm(flat, axis=1) / scale
        self._flat, self._scale = flat, scale
        self._solve, seen, _ = _pseudo_inverse(flat[:self.q], scale[:self.q])
        self.rank = seen.shape[1]
        self._solve_every, _, null = _pseudo_inverse(flat, scale)
        self.cofactor: Floats = self._solve_every @ self._solve_every.T
        self.undetermined = np.abs(null).max(axis=1, initial=0) > 1e-3

    def amplitudes(self, observed_perp: Floats) -> Floats:
        """Return the least-squares amplitudes (q,) of base-free observations (N, 3)."""
        return self._solve @ observed_perp.reshape(-1)

    @cached_property
    def without_effects(self) -> 'JointSpace':
        """The base model alone."""
        return JointSpace(self.space, self.columns[:0], self.columns[:0])

    @property
    def whitening(self) -> Whitening:
        """Of the noise."""
        return self.space.whitening

    def residual(self, rows: NDArray[Real]) -> NDArray[Real] | Floats:
        """Return rows (m, N, 3) freed of base model and effects, in white coordinates."""
        return self.free(self.whitening.apply(rows))

    def free(self, rows: NDArray[Real]) -> NDArray[Real] | Floats:
        """Return white rows (m, N, 3) freed of base model and effects."""
        free = self.space.free(rows)
        if not self.q or not len(free):
            return free
        flat: NDArray[Any] = free.reshape(len(free), -1)
        for _ in range(2):
            flat = flat - (flat @ self._solve.T) @ self._flat[:self.q]
        return flat.reshape(rows.shape)

    @cached_property
    def _mixed(self) -> Floats:
        """Orthonormal rows (r, 3 N) of what the effects have beyond the base model."""
        scaled = self._flat[:self.q] / self._scale[:self.q, None]
        return independent(scaled @ scaled.T, HIDDEN**2) @ scaled

    def curves(self, rows: Floats) -> Floats:
        """Return what displacements (m, N, 3), m, do to the curves, (m, n, 6), where all parameters are fitted anew.

        The nonlinear ones follow to first order, by their tangents."""
        out = self.space.described(rows)[0].curves
        if len(self.every):
            amplitude = self.space.residual(rows).reshape(len(rows), -1) @ self._solve_every.T
            out = out - np.tensordot(amplitude, self._bias.curves, axes=1)
        return np.asarray(out)

    @cached_property
    def _bias(self) -> BaseParameters:
        """What effects and tangents would do to the base parameters, were they not in the model."""
        return self.space.described(self.every)[0]

    def share(self, part: Callable[[BaseParameters], Floats]) -> Floats:
        """Return the effects' share in the variances of a part (m, n, c) of the base parameters, (n, c) or (1, 1)."""
        if not len(self.every):
            return np.zeros((1, 1))
        bias = part(self._bias)
        return np.asarray(np.einsum('anc,ab,bnc->nc', bias, self.cofactor, bias))

    def effect_cofactor(self) -> Floats:
        """Return the effects' share in the variances of the curves per unit variance, (n, 6)."""
        return np.maximum(self.share(attrgetter('curves')), np.zeros((self.space.n, 6)))  # rounding may leave less

    def curve_cofactor(self) -> Floats:
        """Return variances of the curves per unit variance, (n, 6), effects' share included."""
        return np.asarray(self.space.curve_cofactor() + self.effect_cofactor())

    def difference_cofactor(self, high: Sequence[int], low: Sequence[int]) -> Floats:
        """Return variances of one point less another of each curve per unit variance, (6,); high, low: 0..n-1.

        Of a complete run of equal noise at most the sum of both variances times n / (n - 2), as at most 2 of n waves
        are removed from a curve; else what no correlation exceeds. The share of the effects is exact."""
        base, every = self.space.curve_cofactor(), range(6)
        one, other = base[high, every], base[low, every]
        out = (np.sqrt(one) + np.sqrt(other))**2
        if self.space.is_even:
            out = np.minimum(out, (one + other) * len(base) / (len(base) - 2))
        if len(self.every):
            step = self._bias.curves[:, high, every] - self._bias.curves[:, low, every]
            out = out + np.einsum('ac,ab,bc->c', step, self.cofactor, step)
        return np.asarray(out)

    def deviation_cofactors(self) -> tuple[Floats, Floats]:
        """Return variances of plate and CMM per unit variance, (n, 3) each, effects' share included."""
        plate, cmm = self.space.deviation_cofactors()
        return plate + self.share(attrgetter('plate')), cmm + self.share(attrgetter('cmm'))


def _pseudo_inverse(flat: Floats, scale: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the pseudo-inverse (q, 3 N) of rows (q, 3 N), and the seen and the unseen mixes of them, (q, k) each."""
    if not len(flat):
        return flat, np.zeros((0, 0)), np.zeros((0, 0))
    scaled = flat / scale[:, None]
    value, vector = np.linalg.eigh(scaled @ scaled.T)
    keep = value > HIDDEN**2
    mix = vector[:, keep] / value[keep]
    return (mix @ vector[:, keep].T @ scaled) / scale[:, None], vector[:, keep], vector[:, ~keep]


@dataclass(frozen=True, eq=False)
class _Part:
    """An effect of a model at a setting: its columns (q, N, 3), and where they stand among those of all effects."""

    term: Term
    setting: Setting
    columns: Floats
    place: slice

    def adjusted(self, *kinds: str) -> list[Searched]:
        """Return the searched parameters of some kinds that nobody has fixed."""
        return [one for one in self.term.effect.searched if one.kind in kinds and one.name in self.setting
                and (self.term.is_found or one.name not in self.term.fixed)]


def _parts(run: Run, model: Model, settings: Sequence[Mapping[str, float | str]], space: BaseSpace) -> list[_Part]:
    parts, start = [], 0
    for term, setting in zip(model.terms, map(Setting, settings), strict=True):
        columns = np.moveaxis(term.effect.columns(run, setting), -1, 0)
        if term.effect is FREE:
            columns = _seen(columns, space)
        parts.append(_Part(term, setting, columns, slice(start, start + len(columns))))
        start += len(columns)
    return parts


def _seen(columns: Floats, space: BaseSpace) -> Floats:
    """Return columns (q, N, 3) freed of the mixes of them that the base model hides: amplitudes do not reach these."""
    length = np.linalg.norm(columns, axis=(1, 2), keepdims=True)
    unit = columns / np.where(length > 0, length, 1.0)
    own, left = (rows.reshape(len(rows), -1) for rows in (space.whitening.apply(unit), space.residual(unit)))
    size, mix = np.linalg.eigh(own @ own.T)
    mix = mix[:, size > HIDDEN * size[-1]] / np.sqrt(size[size > HIDDEN * size[-1]])
    share, turned = np.linalg.eigh((mix.T @ left) @ (mix.T @ left).T)
    keep = mix @ turned[:, share >= HIDDEN_SHARE**2]
    seen = np.linalg.qr(keep).Q if keep.size else keep
    return np.asarray(length * np.tensordot(seen @ seen.T, unit, axes=1))


def white_noise(run: Run, terms: tuple[str, ...] = BASE_TERMS) -> Noise:
    """Return the noise of readings that repeat alike, with what their digits add; terms: of the base model.

    A variance s^2 + (a step)^2 / 12 of each coordinate, s the repeatability, or where it is not known the likeliest of
    sizes a factor 2 apart, at least FINEST of the largest error. White where all steps are the same or errors of
    rounding are of no account.
    """
    added = run.steps**2 / 12
    if np.ptp(added) <= SAME_STEPS * added.max():
        return Noise()
    lever, y = mean_radius(run), observed(run)[None]

    def of_size(size: float) -> Noise:
        variance = size**2 + added
        return Noise(digits=np.sqrt(variance / variance.mean()))

    def left(noise: Noise) -> tuple[float, float]:
        """Return the standard deviation, m, and -2 ln of the restricted likelihood."""
        space = BaseSpace(run, lever, terms, noise.whitening(run))
        rest, dof = float(np.sum(space.residual(y)**2)), 3 * run.size - space.rank
        log_det = sum(space.log_dets) + space.whitening.log_det_of((0, 1, 2))
        return float(np.sqrt(rest / max(dof, 1))), dof * float(np.log(max(rest, 1e-300))) + log_det

    largest = run.repeatability or left(Noise())[0]
    if run.rounding**2 <= OF_ACCOUNT * largest**2:
        return Noise()
    least = FINEST * float(np.sqrt(added.max()))
    if run.repeatability:
        return of_size(max(run.repeatability, least))
    sizes = 2.0**-np.arange(max(np.log2(largest / least), 0) + 1) * largest
    return min(map(of_size, sizes.tolist()), key=lambda noise: left(noise)[1])


def fit(run: Run, model: Model | None = None, settings: Sequence[Mapping[str, float | str]] = (),
        noise: Noise | None = None, space: BaseSpace | None = None, beyond: Floats | None = None) -> Fit:
    """Return the joint least-squares Fit of a model on a run.

    settings: a Setting for each effect of the model, in its order; noise: of the readings, None for `white_noise`;
    space: of the base terms of the model where it is at hand from another fit of the same run and noise; beyond: as of
    Fit, None where it is to be found. Raises NotDeterminable where readings are too few, an effect cannot be seen in
    this order, or the second-order terms do not converge.
    """
    model = model or Model()
    lever = mean_radius(run)
    noise = noise or white_noise(run, model.base)
    space = space or BaseSpace(run, lever, model.base, noise.whitening(run))
    parts = _parts(run, model, settings, space)
    columns = np.concatenate([np.zeros((0, run.size, 3)), *(part.columns for part in parts)])
    linear = JointSpace(space, columns, np.zeros((0, run.size, 3)))
    places = observed(run)
    offset = np.zeros((1, 3)) if beyond is None else beyond
    is_linear = False
    for step in range(MOST_STEPS):
        y = places - offset
        perp = space.residual(y[None])[0]
        amplitude = linear.amplitudes(perp)
        base = space.described((y - np.tensordot(amplitude, columns, axes=1))[None])[0]
        if beyond is not None:
            found = offset
        elif is_linear:
            found = turned_plate(run, base)
        else:
            found, turned = second_order(run, lever, base, _motion(run, parts, amplitude)), turned_plate(run, base)
            if step == 0 and is_negligible(space, found - turned, float(np.sqrt(np.mean(linear.free(perp[None])**2)))):
                is_linear, found = True, turned
        change = float(np.abs(found - offset).max())
        if change <= ROUNDING:
            break
        offset = found
    if not change <= CONVERGED:
        raise NotDeterminable(
            f'{run.source}: the products of rotations and deviations do not converge for {model}: after {MOST_STEPS} '
            f'steps they still change by {micrometres(change)} (expected at most {1e6 * CONVERGED:g}); check plate, '
            'table frame and readings')
    tangents = _tangents(run, parts, amplitude)
    joint = JointSpace(space, columns, tangents) if len(tangents) else linear
    for part in parts:
        if not np.any(joint.visible_share[part.place] > HIDDEN):
            raise refused_as_hidden(run, part.term)
    weighted = joint.residual(y[None])[0] if joint.q else perp
    rss = float(np.sum(weighted**2))
    dof = 3 * run.size - space.rank - joint.rank - sum(len(part.adjusted(*REFINED, 'instant')) for part in parts)
    if dof <= 0:
        raise NotDeterminable(f'{run.source}: {3 * run.size} coordinates leave {dof} degrees of freedom for {model}; '
                              'measure more balls or remove an effect')
    sigma, source, chi, p = _noise(run, rss, dof, noise)
    scale = sigma * noise.loss(1 - dof / (3 * run.size))**0.5
    u = scale * np.sqrt(joint.curve_cofactor())
    motions = ErrorMotions(_mean_angles(run) + run.table_offset, base.curves[0], u, run.rotation)
    return Fit(run, model, motions, base.plate[0], base.cmm[0],
               space.whitening.inverse(weighted[None])[0], _fitted(run, parts, amplitude, joint, scale),
               space.rank + joint.rank, dof, float(np.sqrt(rss / dof)), sigma, source, chi, p, lever, joint, noise,
               offset)


def _motion(run: Run, parts: Sequence[_Part], amplitude: Floats) -> BodyMotion | None:
    """Return what the effects do to the plate as a body, None where none turns, tilts or stretches it."""
    motions = [motion for part in parts
               if (motion := part.term.effect.body_motion(run, part.setting, amplitude[part.place])) is not None]
    return reduce(BodyMotion.__add__, motions) if motions else None


def _mean_angles(run: Run) -> Floats:
    """Return the mean actual angle at each table position, (n,), rad; nominal where none was read."""
    order = _by_place(run)
    index = run.table_position[order] - 1
    count = np.bincount(index, minlength=run.n)
    total = np.bincount(index, weights=run.angle_deviation[order], minlength=run.n)
    return TWO_PI * np.arange(run.n) / run.n + total / np.maximum(count, 1)


def refused_as_hidden(run: Run, term: Term) -> NotDeterminable:
    """Return the error that refuses an effect of which a run shows nothing."""
    return NotDeterminable(f'{run.source}: {term} cannot be seen in this order of measurement: the base model takes it '
                           'up whole. Remove it, or measure in another order (rosette advise)')


def _tangents(run: Run, parts: Sequence[_Part], amplitude: Floats) -> Floats:
    """Return d(D a)/d(theta) of the refined parameters of all effects, (k, N, 3)."""
    tangents = [np.zeros((0, run.size, 3))]
    for part in parts:
        for parameter in part.adjusted(*REFINED):
            value = part.setting.number(parameter.name)
            step = 1e-4 * (abs(value) or 1.0)
            above, below = (np.moveaxis(part.term.effect.columns(
                run, Setting({**part.setting, parameter.name: value + sign * step})), -1, 0) for sign in (1, -1))
            tangents.append(np.tensordot(amplitude[part.place], above - below, axes=1)[None] / (2 * step))
    return np.concatenate(tangents)


def _noise(run: Run, rss: float, dof: int, noise: Noise) -> tuple[float, SigmaSource, float | None, float | None]:
    rms = float(np.sqrt(rss / dof))
    if run.scatter is None:
        return *_at_least(run.rounding, rms, SigmaSource.RESIDUALS), None, None
    known, known_dof = run.scatter
    chi = (rms / known)**2
    # the check was made at one place, which may be the quietest one
    least, of_tail = chi * noise.quietest**2, noise.share_of_dof
    p = float(scipy.special.chdtrc(dof * of_tail, least * dof * of_tail) if known_dof is None
              else scipy.special.fdtrc(dof * of_tail, known_dof * of_tail, least))
    if p < UNLIKELY:
        return rms, SigmaSource.LARGER, chi, p
    if noise.by or noise.tail:
        return *_at_least(run.rounding, rms, SigmaSource.UNEQUAL), chi, p
    if known_dof is None:
        return known, SigmaSource.REPEATABILITY, chi, p
    pooled = np.sqrt((rss + known_dof * known**2) / (dof + known_dof))
    return *_at_least(run.rounding, float(pooled), SigmaSource.POOLED), chi, p


def _at_least(rounding: float, sigma: float, source: SigmaSource) -> tuple[float, SigmaSource]:
    """Return a standard deviation and its source, that of errors of rounding, which readings alike do not show."""
    return (sigma, source) if sigma >= rounding else (rounding, SigmaSource.ROUNDING)


def _fitted(run: Run, parts: Sequence[_Part], amplitude: Floats, joint: JointSpace,
            sigma: float) -> tuple[FittedEffect, ...]:
    u = np.where(joint.undetermined, np.inf, sigma * np.sqrt(np.diag(joint.cofactor)))
    refined = iter(u[len(amplitude):])
    out = []
    for part in parts:
        quantities, time = part.term.effect.amplitudes(run, part.setting), run.time_unit
        parameters = [Parameter(quantity.name, float(value), float(error), in_time(quantity.unit, time))
                      for quantity, value, error in zip(quantities, amplitude[part.place], u[part.place], strict=True)]
        parameters += [Parameter(parameter.name, part.setting.number(parameter.name), float(next(refined)),
                                 in_time(parameter.unit, time)) for parameter in part.adjusted(*REFINED)]
        out.append(FittedEffect(part.term.name, part.setting, tuple(parameters),
                                np.tensordot(amplitude[part.place], part.columns, axes=1)))
    return tuple(out)
