# SPDX-License-Identifier: Apache-2.0
"""The one least squares: base model and effects, jointly.

Effects are linear in their amplitudes a. With D their columns, Q the base model's space and
D_perp = D - Q Q' D, the joint solution is a = D_perp^+ y, the base parameters follow from y - D a.
Nonlinear parameters enter the uncertainties by their tangents d(D a)/d(theta).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from rosette_ros.core.base import Basis, base_space
from rosette_ros.core.effects.contract import Setting
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.geometry import rotate_z
from rosette_ros.core.model import Model
from rosette_ros.core.records import ErrorMotions

HIDDEN = 1e-6
"""Visible share below which an effect is taken as hidden altogether (rounding is 1e-15)."""


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
    displacement: np.ndarray


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model.

    residual: (N, 3), m, observed minus model; plate, cmm: (n, 3), m; rms: root of the residuals'
    square sum per degree of freedom, m; sigma: standard deviation of a coordinate in use for the
    uncertainties, m, and sigma_source, where it comes from; reduced_chi_square: (rms/repeatability)
    squared, None where the repeatability is unknown; lack_of_fit_p: probability that noise of the
    known repeatability leaves as much, None likewise.
    """

    run: object
    model: Model
    error_motions: ErrorMotions
    plate: np.ndarray
    cmm: np.ndarray
    residual: np.ndarray
    effects: tuple[FittedEffect, ...]
    rank: int
    dof: int
    rms: float
    sigma: float
    sigma_source: str
    reduced_chi_square: float | None
    lack_of_fit_p: float | None
    mean_radius: float
    joint: object

    @cached_property
    def settings(self):
        """The settings of the effects, in the order of the model."""
        return tuple(effect.setting for effect in self.effects)


def mean_radius(run):
    """Return the mean radius of the circle of ball centres, equation (10), m."""
    x, y = run.centre[:, 0], run.centre[:, 1]
    return float(np.mean((x * np.cos(run.alpha) + y * np.sin(run.alpha))[_by_place(run)]))


def _by_place(run):
    """Return the indices that sort readings by table position and ball: sums do not depend on when one was taken."""
    return np.lexsort((run.ball, run.table_position))


def observed(run, plate=None):
    """Return centres minus nominal centres at the actual table angle, (N, 3), m.

    The base model is linear at nominal angles, so known parts are turned to the actual angle here:
    p - R_z(phi + delta) b_j - (R_z(phi + delta) - R_z(phi)) P_j. plate: P, (n, 3), m, or None.
    """
    delta = run.angle_deviation
    out = run.centre - run.radius * np.stack(
        [np.cos(run.alpha + delta), np.sin(run.alpha + delta), np.zeros(run.size)], axis=-1)
    if plate is not None and np.any(delta):
        turned = rotate_z(run.phi, plate[run.ball - 1])
        out = out - (rotate_z(delta, turned) - turned)
    return out


class JointSpace:
    """Base model and effects on one run: projection, solution and cofactors.

    columns: (q, N, 3) of all effects together; tangents: (k, N, 3) of the nonlinear parameters, used
    for uncertainties only.
    """

    def __init__(self, space, columns, tangents):
        """Project columns and tangents off the base model and decompose what is left."""
        self.space = space
        self.columns = columns
        self.q = len(columns)
        every = np.concatenate([columns, tangents])
        self.every = every
        size = every.shape[1] * 3
        flat = space.residual(every).reshape(len(every), size)
        full = np.linalg.norm(every.reshape(len(every), size), axis=1)
        scale = np.where(full > 0, full, 1.0)
        self.visible_share = np.linalg.norm(flat, axis=1) / scale
        self._flat, self._scale = flat, scale
        self._solve, self.rank = _pseudo_inverse(flat[:self.q], scale[:self.q])
        inverse, self.tangent_rank = _pseudo_inverse(flat, scale)
        self.cofactor = inverse @ inverse.T
        gram = flat / scale[:, None]
        value, vector = np.linalg.eigh(gram @ gram.T)
        null = vector[:, value <= HIDDEN**2]
        self.undetermined = np.abs(null).max(axis=1, initial=0) > 1e-3

    def amplitudes(self, observed_perp):
        """Return the least-squares amplitudes (q,) of base-free observations (N, 3)."""
        return self._solve @ observed_perp.reshape(-1)

    def residual(self, rows):
        """Return rows (m, N, 3) freed of base model and effects."""
        rows = self.space.residual(rows)
        if not self.q:
            return rows
        flat = rows.reshape(len(rows), -1)
        for _ in range(2):
            flat = flat - (flat @ self._solve.T) @ self._flat[:self.q]
        return flat.reshape(rows.shape)

    @cached_property
    def basis(self):
        """Orthonormal rows that span base model and effects, a Basis; None where there are weights."""
        base = self.space.basis
        if base is None or not self.q:
            return base
        scaled = self._flat[:self.q] / self._scale[:self.q, None]
        value, vector = np.linalg.eigh(scaled @ scaled.T)
        keep = value > HIDDEN**2
        rows = (vector[:, keep] / np.sqrt(value[keep])).T @ scaled
        return Basis(base.axial, base.plane, rows.reshape(len(rows), -1, 3))

    @cached_property
    def bias(self):
        """Curves per unit of each column and tangent, (q + k, n, 6)."""
        return self.space.parameters(self.every).curves

    def curve_cofactor(self):
        """Return variances of the curves per unit variance, (n, 6), effects' share included."""
        cofactor = self.space.curve_cofactor()
        if len(self.every):
            cofactor = cofactor + np.einsum('anc,ab,bnc->nc', self.bias, self.cofactor, self.bias)
        return cofactor


def _pseudo_inverse(flat, scale):
    """Return the pseudo-inverse (q, 3 N) of rows (q, 3 N) and its rank, rows scaled to length."""
    if not len(flat):
        return np.zeros((0, flat.shape[1])), 0
    scaled = flat / scale[:, None]
    value, vector = np.linalg.eigh(scaled @ scaled.T)
    keep = value > HIDDEN**2
    mix = vector[:, keep] / value[keep]
    return (mix @ vector[:, keep].T @ scaled) / scale[:, None], int(keep.sum())


def fit(run, model=None, settings=(), weight=None, space=None):
    """Return the joint least-squares Fit of a model on a run.

    settings: a Setting for each effect of the model, in its order; weight: (N,) inverse relative
    variances of the readings, or None; space: of the base terms of the model where it is at hand from
    another fit of the same run and weights.

    Raises NotDeterminable where readings are too few or an effect cannot be seen in this order.
    """
    model = model or Model()
    lever = mean_radius(run)
    space = space or base_space(run, lever, model.base, weight)
    blocks = [np.moveaxis(term.effect.columns(run, setting), -1, 0)
              for term, setting in zip(model.terms, settings, strict=True)]
    columns = np.concatenate([np.zeros((0, run.size, 3)), *blocks])
    plate = None
    for _ in range(4):
        y = observed(run, plate)
        perp = space.residual(y[None])[0]
        plain = JointSpace(space, columns, np.zeros((0, run.size, 3)))
        amplitude = plain.amplitudes(perp)
        rest = y - np.tensordot(amplitude, columns, axes=1)
        base = space.parameters(rest[None])
        if not np.any(run.angle_deviation):
            break
        plate = base.plate[0]
    tangents, names = _tangents(run, model, settings, amplitude, blocks)
    joint = JointSpace(space, columns, tangents) if len(tangents) else plain
    _refuse_hidden(run, model, blocks, joint)
    weighted = joint.residual(y[None])[0] if joint.q else perp
    rss = float(np.sum(weighted**2))
    dof = 3 * run.size - space.rank - joint.rank - _searched_count(model, settings)
    if dof <= 0:
        raise NotDeterminable(
            f'{run.source}: {3 * run.size} coordinates leave {dof} degrees of freedom for '
            f'{model}; measure more balls or remove an effect')
    sigma, source, chi, p = _noise(run, rss, dof)
    root = np.ones(run.size) if weight is None else np.sqrt(weight / np.mean(weight))
    u = sigma * np.sqrt(joint.curve_cofactor())
    effects = _fitted(run, model, settings, blocks, amplitude, joint, names, sigma)
    return Fit(run, model, ErrorMotions(_mean_angles(run), base.curves[0], u), base.plate[0],
               base.cmm[0], weighted / root[:, None], effects, space.rank + joint.rank, dof,
               float(np.sqrt(rss / dof)), sigma, source, chi, p, lever, joint)


def _mean_angles(run):
    """Return the mean actual angle at each table position, (n,), rad; nominal where none was read."""
    order = _by_place(run)
    index = run.table_position[order] - 1
    count = np.bincount(index, minlength=run.n)
    total = np.bincount(index, weights=run.angle_deviation[order], minlength=run.n)
    return 2 * np.pi * np.arange(run.n) / run.n + total / np.maximum(count, 1)


def _searched_count(model, settings):
    """Return how many searched numbers were adjusted to the data (choices do not count)."""
    return sum(parameter.kind != 'choice' and parameter.name not in term.fixed
               for term, setting in zip(model.terms, settings)
               for parameter in term.effect.searched if parameter.name in setting)


def _refuse_hidden(run, model, blocks, joint):
    start = 0
    for term, block in zip(model.terms, blocks):
        share = joint.visible_share[start:start + len(block)]
        start += len(block)
        if not np.any(share > HIDDEN):
            raise NotDeterminable(
                f'{run.source}: {term} cannot be seen in this order of measurement: the base model '
                'takes it up whole. Remove it, or measure in another order (rosette advise)')


def _tangents(run, model, settings, amplitude, blocks):
    """Return d(D a)/d(theta) of refined parameters, (k, N, 3), and their (term, parameter)."""
    tangents, names = [np.zeros((0, run.size, 3))], []
    start = 0
    for index, (term, setting, block) in enumerate(zip(model.terms, settings, blocks)):
        part = amplitude[start:start + len(block)]
        start += len(block)
        for parameter in term.effect.searched:
            if parameter.kind not in ('scale', 'phase') or parameter.name in term.fixed:
                continue
            value = setting[parameter.name]
            step = 1e-4 * value
            shifted = [np.moveaxis(term.effect.columns(
                run, Setting({**setting, parameter.name: value + sign * step})), -1, 0)
                for sign in (1, -1)]
            tangents.append(np.tensordot(part, shifted[0] - shifted[1], axes=1)[None] / (2 * step))
            names.append((index, parameter))
    return np.concatenate(tangents), names


def _noise(run, rss, dof):
    """Return sigma, its source, reduced chi square and lack-of-fit probability."""
    rms = np.sqrt(rss / dof)
    known, known_dof = run.repeatability, run.repeatability_dof
    if known is None:
        return rms, 'residuals', None, None
    chi = (rms / known)**2
    if known_dof is None:
        p = float(special.chdtrc(dof, chi * dof))
        if p >= 1e-3:
            return known, 'repeatability', chi, p
        return rms, 'residuals (larger than the repeatability)', chi, p
    p = float(special.fdtrc(dof, known_dof, chi))
    if p >= 1e-3:
        pooled = np.sqrt((rss + known_dof * known**2) / (dof + known_dof))
        return float(pooled), 'residuals and repeatability', chi, p
    return rms, 'residuals (larger than the repeatability)', chi, p


def _fitted(run, model, settings, blocks, amplitude, joint, names, sigma):
    u = sigma * np.sqrt(np.diag(joint.cofactor))
    u = np.where(joint.undetermined, np.inf, u)
    out, start = [], 0
    for index, (term, setting, block) in enumerate(zip(model.terms, settings, blocks)):
        part = slice(start, start + len(block))
        start += len(block)
        quantities = term.effect.amplitudes(run, setting)
        parameters = [Parameter(quantity.name, float(value), float(error), quantity.unit)
                      for quantity, value, error in zip(quantities, amplitude[part], u[part])]
        for place, (owner, parameter) in enumerate(names):
            if owner == index:
                parameters.append(Parameter(parameter.name, float(setting[parameter.name]),
                                            float(u[len(amplitude) + place]), parameter.unit))
        out.append(FittedEffect(term.name, setting, tuple(parameters),
                                np.tensordot(amplitude[part], block, axes=1)))
    return tuple(out)
