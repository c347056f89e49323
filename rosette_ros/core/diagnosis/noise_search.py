# SPDX-License-Identifier: Apache-2.0
"""Which noise a run has: tests of what a fit leaves, and estimates by restricted maximum likelihood.

Noise and effects compete by the same score, twice the log likelihood less what the parameters cost: with the model and
the effects beside it as columns B in white coordinates, -2 L = dof ln RSS + ln det C + ln det B'B.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import scipy.linalg

from rosette_ros.core.diagnosis.candidates import NO_RESIDUAL
from rosette_ros.core.diagnosis.noise_statistics import (
    check_of,
    divergence,
    log_density,
    one_sided,
    remembered,
    two_sided,
    two_sided_f,
)
from rosette_ros.core.diagnosis.scores import cost
from rosette_ros.core.model.base_space import Basis
from rosette_ros.core.model.least_squares import HIDDEN, Fit
from rosette_ros.core.model.model import KINDS_OF_NOISE
from rosette_ros.core.model.noise import Noise, Whitening, place_of
from rosette_ros.core.model.normal_equations import PARTS
from rosette_ros.core.records import Floats, Run, resolution_of

DRAWS = 200
CALIBRATED = 20
TAILS_DRAWN = 60
FEW = 0.15
"""Share of parameters in the coordinates below which their freedom to fit tails does not count."""
PLAIN = 0.25
SEEN = 2e-3
"""Probability, over all tests, below which the noise is looked at as other than it was taken."""
NO_AXIS = 1e-8
"""An axis whose square sum is such a share of another's has no residual: its noise cannot be estimated."""
KINDS = 6
"""Kinds of noise that are looked for; each has to pay for the choice."""
TAILS = (2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 20.0)
MEMORIES = (0.3, 0.6, 0.8, 0.9, 0.97, 1.0)
"""phi of the wander that are tried."""
LONGER = 3.0
"""By how much -2 L may be larger for the longer memory: too short a one makes slow effects too certain."""
LEAST_FACTOR = 0.01
"""No group of readings is taken as quieter beside the noisiest one, nor than about what rounding makes them."""
GROUPS = ('time', 'ball', 'CMM position', 'table position')
MOST_KINDS = 3


@dataclass(frozen=True)
class Misfit:
    """A way in which what a fit leaves is not noise as it was taken: its kind, what it is of, and the p of as much.

    phi: memory of the wander that was tested.
    """

    kind: str
    of: str
    p: float
    phi: float = 0.0

    @property
    def words(self) -> str:
        """What the test has found."""
        of = self.of
        return {'axes': 'the axes repeat unequally', 'tail': f'single {of}s stand out',
                'groups': f'it scatters unequally by {of}', 'wander': f'neighbours are alike in {of}'}[self.kind]


class NoiseProblem:
    """The readings freed of a model whose noise is asked for.

    basis: of the base model in white noise; columns: (q, N, 3) of the effects in the model; observed: (N, 3), m,
    whatever base model and effects may add to it.
    """

    def __init__(self, run: Run, basis: Basis, columns: Floats, observed: Floats, seed: int = 0) -> None:
        self.run, self._observed = run, observed
        self.rounding = resolution_of(run.centre) / 12**0.5
        designs = []
        for rows, axes in zip((basis.axial, _one_by_one(basis.plane, (0, 1))), PARTS):
            extra = _one_by_one(columns, axes)
            extra = extra / np.maximum(np.linalg.norm(extra, axis=1, keepdims=True), 1e-300)  # of any unit
            extra = extra - (extra @ rows.T) @ rows
            value, vector = np.linalg.eigh(extra @ extra.T)
            keep = value > HIDDEN**2
            designs.append(np.hstack([rows.T, extra.T @ (vector[:, keep] / np.sqrt(value[keep]))]))
        self.dof = 3 * run.size - sum(design.shape[1] for design in designs)
        rng = np.random.default_rng(seed)
        self._draws = rng.standard_normal((DRAWS, run.size, 3))
        axial = run.size - designs[0].shape[1]
        self.axis_dof: Floats = np.array([self.dof - axial, self.dof - axial, 2 * axial]) / 2
        self.check_dof, self._checked = check_of(run)
        self._check = rng.chisquare(self.check_dof, (DRAWS, 3)) if self.check_dof else np.zeros((DRAWS, 3))
        spans = [_Span(design, is_orthonormal=True) for design in designs]
        self._plain = [(span, self._left(span, axes, observed[None])) for span, axes in zip(spans, PARTS)]
        self.start = self.at(Noise())

    def at(self, noise: Noise) -> 'NoiseFit':
        """Return what is left under a noise."""
        white = noise.whitening(self.run)
        left, log_det, spans = np.empty((1 + DRAWS, self.run.size, 3)), white.log_det_of((0, 1, 2)), []
        for part, axes in enumerate(PARTS):
            span, scale = self._plain[part][0], white.scale_of(axes)
            if scale:
                left[..., axes] = self._plain[part][1]
                left[0][..., axes] *= scale
                log_det += 2 * span.design.shape[1] * np.log(scale)
            else:
                span = _Span(_whitened(white, axes, span.design))
                left[..., axes] = self._left(span, axes, white.apply(self._observed[None]))
                log_det += span.log_det
            spans.append(span)
        rss = float(np.sum(left[0]**2))
        return NoiseFit(self, noise, white, left, rss, self.dof * np.log(rss) + log_det, spans)

    def _left(self, span: '_Span', axes: tuple[int, ...], observed: Floats) -> Floats:
        """Return what a span leaves of white readings (1, N, 3) and of the draws, (1 + DRAWS, N, axes)."""
        rows = np.concatenate([_one_by_one(observed, axes), _one_by_one(self._draws, axes)])
        return _together(rows - span.taken(rows), axes)

    def check(self, noise: Noise) -> Floats:
        """Return the square sums of the repeatability by axis, (1 + DRAWS, 3): of the run, its mean 1 under a noise."""
        own = self._checked / noise.axes**2
        return np.concatenate([self.check_dof * own[None] / own.mean(), self._check])

    def minus_of_check(self, noise: Noise) -> float:
        """Return -2 L of the repeatability by axis, whose size is its own."""
        own = self._checked / noise.axes**2
        return self.check_dof * float(3 * np.log(own.mean()) + 2 * np.sum(np.log(noise.axes)))

    def minus_log_likelihood(self, axes: tuple[int, ...], white: Whitening) -> float:
        """Return -2 L of some axes alone, whose size is their own."""
        variance, dof, log_det = self.of_part(axes, white)
        return float(dof * np.log(max(variance, 1e-300)) + log_det + white.log_det_of(axes))

    def of_part(self, axes: tuple[int, ...], white: Whitening) -> tuple[float, int, float]:
        """Return the variance of what is left of some axes, its degrees of freedom, and ln det B'B."""
        design = _whitened(white, axes, self._plain[PARTS.index(axes)][0].design)
        rows = np.concatenate([white.along(axis).apply(self._observed[None, :, axis])[0] for axis in axes])
        root = np.linalg.cholesky(design.T @ design)
        taken = scipy.linalg.solve_triangular(root, design.T @ rows, lower=True, check_finite=False)
        dof = rows.size - len(taken)
        left = max(float(rows @ rows - taken @ taken), 1e-14 * float(rows @ rows))  # not below rounding
        return left / dof, dof, 2 * float(np.sum(np.log(np.diag(root))))


def _one_by_one(rows: Floats, axes: Sequence[int]) -> Floats:
    """Return some axes of rows (m, N, 3) one after the other, (m, axes * N)."""
    return np.concatenate([rows[..., axis] for axis in axes], axis=1)


def _together(rows: Floats, axes: Sequence[int]) -> Floats:
    """Return rows (m, axes * N) as (m, N, axes)."""
    return np.moveaxis(rows.reshape(len(rows), len(axes), -1), 1, 2)


def _square_sums(values: Floats) -> Floats:
    """Return the square sum of each of values (m, N, axes)."""
    out: Floats = np.einsum('mna,mna->m', values, values)
    return out


def _whitened(white: Whitening, axes: tuple[int, ...], design: Floats) -> Floats:
    if white.is_plain:
        return design
    parts = np.split(design, len(axes))
    return np.concatenate([white.along(axis).of_columns(part) for axis, part in zip(axes, parts)])


class _Span:
    """What the columns of a design (axes * N, r) describe; is_orthonormal: whether they are orthonormal."""

    def __init__(self, design: Floats, is_orthonormal: bool = False) -> None:
        self.design = design
        self._root = None if is_orthonormal else np.linalg.cholesky(design.T @ design)

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of the products of the columns."""
        return 0.0 if self._root is None else 2 * float(np.sum(np.log(np.diag(self._root))))

    def taken(self, rows: Floats) -> Floats:
        """Return what the columns describe of rows (m, axes * N)."""
        inside = self.design.T @ rows.T
        if self._root is not None:
            inside = scipy.linalg.cho_solve((self._root, True), inside, check_finite=False)
        return np.asarray((self.design @ inside).T)


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A noise and what it leaves of the readings and of DRAWS simulated ones, (1 + DRAWS, N, 3) in white coordinates.

    minus: -2 L, to be compared with that of another noise of the same problem; score: twice the log likelihood beside
    that of white noise, less what the parameters cost.
    """

    problem: NoiseProblem
    noise: Noise
    whitening: Whitening
    left: Floats
    rss: float
    minus: float
    spans: list[_Span]
    score: float = 0.0

    def misfits(self) -> list[Misfit]:
        """Return the tests of the noise, least probable first; p counts all of them."""
        found = list(self._tests())
        return sorted((replace(one, p=min(1.0, one.p * len(found))) for one in found), key=lambda one: one.p)

    def _tests(self) -> Iterator[Misfit]:
        run, (rows, scale) = self.problem.run, self._scaled
        square = (self.whitening.adjoint(rows) / scale)**2
        of_reading = square @ np.ones(3)
        size, check = np.maximum(self.problem.axis_dof, 1e-9), self.problem.check(self.noise)
        pooled = (size * (np.ones(run.size) @ square / run.size) + check) / (size + self.problem.check_dof)
        by_axis = np.log(np.maximum(pooled, 1e-12))  # an axis may have no residual at all
        yield Misfit('axes', 'z', two_sided(by_axis[:, 2] - np.log(np.mean(np.exp(by_axis[:, :2]), axis=1))))
        yield Misfit('axes', 'xyz', two_sided(by_axis[:, 0] - by_axis[:, 1]))
        (x, y, z), dof = check[0], self.problem.check_dof
        if size[2] < dof:  # the check says more of z than the readings do
            yield Misfit('axes', 'z', two_sided_f(2 * z / (x + y), dof, 2 * dof))
        yield Misfit('tail', 'coordinate', one_sided(_square_sums(square)))
        yield Misfit('tail', 'reading', one_sided(np.sum(of_reading**2, axis=1)))
        for by in GROUPS:
            index = place_of(run, by)
            hot = (index == np.arange(index.max() + 1)[:, None]).astype(float)
            sums, number = of_reading @ hot.T, np.maximum(hot.sum(axis=1), 1)
            yield Misfit('groups', by, one_sided(np.sum((sums - sums[1:].mean(axis=0))**2 / number, axis=1)))
        latest_first = [self.left[:, ::-1, axes] for axes in PARTS]
        sizes = [np.maximum(_square_sums(one), NO_RESIDUAL) for one in latest_first]
        for phi in (0.4, 0.9, 1.0):
            for of, one, size in zip(('z', 'xy'), latest_first, sizes):
                yield Misfit('wander', of, one_sided(_square_sums(remembered(one, phi)) / size), phi)

    def better(self, kinds: Sequence[str] = KINDS_OF_NOISE) -> 'NoiseFit':
        """Return the fit with a kind of noise more where one is seen and pays, else this one."""
        best = self
        seen = [one for one in self.misfits() if one.p < SEEN and one.kind in kinds]
        # what is less plain by far is a consequence of the plainest
        seen = [one for one in seen if one.p < max(seen[0].p, 1e-300)**PLAIN]
        wander = next((one.phi for one in seen if one.kind == 'wander'), 0.0)
        for kind, of in dict.fromkeys((one.kind, '' if one.kind == 'wander' else one.of) for one in seen):
            made = self._with_wander(wander) if kind == 'wander' else {
                'axes': self._with_axes, 'tail': self._with_tail, 'groups': self._with_factors}[kind](of)
            best = max(best, made, key=lambda one: one.score)
        return best

    def _kept(self, noise: Noise, k: int, extra: float = 0.0, gain: float | None = None) -> 'NoiseFit':
        """Return the fit of a noise of k numbers more; gain: in -2 L, that of the fits if None, and `extra` beside."""
        found = self.problem.at(noise.scaled())
        gain = self.minus - found.minus + extra if gain is None else gain
        return replace(found, score=self.score + gain - float(cost(max(gain, 0.0), k)) - 2 * np.log(KINDS))

    def _with_axes(self, of: str) -> 'NoiseFit':
        noise = self.noise
        for _ in range(1 if of == 'z' and not self.problem.check_dof else 3):
            left = self.problem.at(noise).left
            square, wanted = np.sum(left[0]**2, axis=0), np.mean(np.sum(left[1:]**2, axis=1), axis=0)
            square = square + self.problem.check(noise)[0] * square.sum() / wanted.sum()
            wanted = wanted + self.problem.check_dof
            if of == 'z':
                square[:2], wanted[:2] = square[:2].sum(), wanted[:2].sum()
            noise = replace(noise, axes=noise.axes * np.sqrt(square / wanted * wanted.sum() / square.sum()))
        gain = self.problem.minus_of_check(self.noise) - self.problem.minus_of_check(noise)
        return self._kept(noise, 1 if of == 'z' else 2, gain)

    def _with_factors(self, by: str) -> 'NoiseFit':
        """Return the fit with a size for each group, drawn to the common one by what it is known worse than that."""
        index, noise = place_of(self.problem.run, by), self.noise
        if noise.by:
            return self
        hot = (index == np.arange(index.max() + 1)[:, None]).astype(float)
        factors, fitted = np.ones(len(hot)), self
        for _ in range(3):
            square = hot @ np.sum(fitted.left**2, axis=2).T
            dof = np.maximum(square[:, 1:].mean(axis=1), 1e-3)  # groups may be empty
            logs = np.log(factors**2 * np.maximum(square[:, 0] * self.problem.dof / fitted.rss / dof, 1e-3))
            logs = logs - np.average(logs, weights=dof)
            spread = max(float(np.average(logs**2 - 2 / dof, weights=dof)), 1e-3)
            least = self.problem.rounding / float(np.sqrt(fitted.rss / self.problem.dof))
            factors = np.maximum(np.exp(0.5 * logs * spread / (spread + 2 / dof)), min(max(least, LEAST_FACTOR), 1.0))
            factors = np.maximum(factors, LEAST_FACTOR * factors[index].max())
            factors = factors / np.sqrt(np.mean(factors[index]**2))
            fitted = self.problem.at(replace(noise, by=by, factors=factors))
        return self._kept(fitted.noise, int(np.count_nonzero(hot.any(axis=1))))

    def _with_tail(self, per: str) -> 'NoiseFit':
        """Return the fit with Student weights, by the degrees of freedom of the largest likelihood.

        A fit by heavy tails has more freedom than its parameters say; what it gains by that from normal noise is taken
        off.
        """
        if self.noise.tail:
            return self
        rows, scale = self._scaled
        rows = rows[:1 + CALIBRATED] if self._share < 1 - FEW else rows[:1]
        normal = self._tail_of(rows, scale, per, np.inf)[0]
        found = []
        for dof in TAILS:
            likelihood, weight = self._tail_of(rows, scale, per, dof)
            gains = likelihood - normal
            freedom = gains[1:].mean() + rows[0].size * divergence(per, dof) * self._share if len(rows) > 1 else 0.0
            found.append((gains[0] - freedom, dof, weight))
        gain, dof, weight = max(found, key=lambda one: one[0])
        before = 1.0 if self.noise.weight is None else self.noise.weight
        weight = np.maximum(weight, LEAST_FACTOR**3 * weight.max())
        return self._kept(replace(self.noise, tail=per, tail_dof=dof, weight=before * weight), 2, gain=gain)

    def p_of_tail(self, noise: Noise) -> float:
        """Return the probability that normal noise is as much like the Student's distribution of a noise."""
        rows, scale = self._scaled
        gains = np.subtract(*(self._tail_of(rows[:1 + TAILS_DRAWN], scale, noise.tail, dof)[0]
                              for dof in (noise.tail_dof, np.inf)))
        return one_sided(gains)

    @cached_property
    def _scaled(self) -> tuple[Floats, Floats]:
        """What is left in units of its size, and the scatter (N, 3) of each coordinate in these beside all others."""
        rows = self.left / np.sqrt(_square_sums(self.left) / self.problem.dof)[:, None, None]
        return rows, np.sqrt(np.maximum(np.mean(self.whitening.adjoint(rows[1:])**2, axis=0), 1e-12))

    @property
    def _share(self) -> float:
        return float(self.problem.dof / (3 * self.problem.run.size))

    def _tail_of(self, rows: Floats, scale: Floats, per: str, dof: float) -> tuple[Floats, Floats]:
        """Return twice the log likelihood (m,) of Student's distribution, and weights (N, 3) of the first of rows."""
        wide = 3 if per == 'reading' else 1
        left, size = rows, np.ones((len(rows), 1, 1))
        for _ in range(12 if np.isfinite(dof) else 1):
            energy = (self.whitening.adjoint(left) / scale)**2
            energy = energy.sum(axis=2, keepdims=True) if wide == 3 else energy
            weight = (dof + wide) / (dof + energy / size) if np.isfinite(dof) else np.ones_like(energy)
            size = np.mean(weight * energy, axis=(1, 2), keepdims=True) / wide
            if self.whitening.is_diagonal:
                left = left - self._taken(left * weight / weight.max(axis=(1, 2), keepdims=True))
        density = log_density(energy / size, wide, dof) - wide / 2 * np.log(size)
        weight = np.broadcast_to(weight[0] / size[0], rows[0].shape)  # as the noise is 1
        return 2 * self._share * np.sum(density, axis=(1, 2)), weight

    def _taken(self, rows: Floats) -> Floats:
        """Return what the model takes of white rows (m, N, 3)."""
        out = np.empty_like(rows)
        for axes, span in zip(PARTS, self.spans):
            out[..., axes] = _together(span.taken(_one_by_one(rows, axes)), axes)
        return out

    def _with_wander(self, begin: float) -> 'NoiseFit':
        """Return the fit with a wander, by the best of MEMORIES; its variance and the rest's size for z and x, y.

        begin: the memory beside which the best is looked for first.
        """
        if self.noise.wander.any():
            return self
        sd = np.broadcast_to(self.whitening.sd, (self.problem.run.size, 3))
        none = [self.problem.minus_log_likelihood(axes, Whitening(len(sd), sd)) for axes in PARTS]
        ratios = lru_cache(lambda phi: [self._ratio(axes, sd, phi, one) for axes, one in zip(PARTS, none)])
        place = int(np.argmin(np.abs(np.array(MEMORIES) - begin)))
        while near := [k for k in (place - 1, place, place + 1) if 0 <= k < len(MEMORIES)]:
            better = min(near, key=lambda k: sum(value for value, _ in ratios(MEMORIES[k])))
            if better == place:
                break
            place = better
        best = sum(value for value, _ in ratios(MEMORIES[place]))
        while place + 1 < len(MEMORIES) and sum(value for value, _ in ratios(MEMORIES[place + 1])) < best + LONGER:
            place += 1
        size, wander, phi = np.ones(3), np.zeros(3), MEMORIES[place]
        for axes, (_, ratio) in zip(PARTS, ratios(phi)):
            white = Whitening(len(sd), sd, phi, np.full(3, ratio))
            size[list(axes)] = self.problem.of_part(axes, white)[0]
            wander[list(axes)] = ratio * size[list(axes)]
        size = np.maximum(size, NO_AXIS * size.max())
        return self._kept(replace(self.noise, phi=phi, axes=self.noise.axes * np.sqrt(size), wander=wander), 4)

    def _ratio(self, axes: tuple[int, ...], sd: Floats, phi: float, none: float) -> tuple[float, float]:
        """Return the least -2 L of some axes and the variance of the wander over that of the rest; none: -2 L of 0."""
        def minus(log_ratio: float) -> float:
            white = Whitening(len(sd), sd, phi, np.full(3, np.exp(log_ratio)))
            return self.problem.minus_log_likelihood(axes, white)

        # a random walk grows by its variance at every reading
        tried = np.log(np.geomspace(1e-3, 1.0, 5) if phi == 1 else np.geomspace(0.03, 30, 5))
        values: dict[int, float] = {}
        place = 2
        while missing := [k for k in (place - 1, place, place + 1) if k not in values]:
            values.update((k, minus(tried[k])) for k in missing)
            place = min(max(min(values, key=lambda k: values[k]), 1), 3)
        low, middle, high = (values[k] for k in (place - 1, place, place + 1))
        bend, step = low - 2 * middle + high, tried[1] - tried[0]
        best = tried[place] + (np.clip(0.5 * step * (low - high) / bend, -step, step) if bend > 0
                               else step * np.sign(low - high))
        return min((none, 0.0), (minus(best), float(np.exp(best))))


def estimate(problem: NoiseProblem, kinds: Sequence[str] = KINDS_OF_NOISE) -> NoiseFit:
    """Return the noise of a problem: some kinds are taken on one by one as long as tests see them and they pay.

    Heavy tails can stand for what differs by axis or place: they are tried beside the best of the others too."""
    found = problem.start
    by_axis = np.sum(found.left[0]**2, axis=0)
    if by_axis.min() <= NO_AXIS * by_axis.max():
        return found
    found = _grown(found, kinds)
    if found.noise.tail and (others := [kind for kind in kinds if kind != 'tail']):
        beside = problem.start.better(others).better(['tail'])
        found = max(found, _grown(beside, kinds), key=lambda one: one.score)
    return found


def _grown(found: NoiseFit, kinds: Sequence[str]) -> NoiseFit:
    for _ in range(MOST_KINDS):
        better = found.better(kinds)
        if better is found:
            break
        found = better
    return found


def noise_of_rounding(fitted: Fit, noise: Floats) -> Floats:
    """Return what rounding makes of white noise (m, N, 3) about the readings as they are fitted, in white coordinates.

    Rounding errors repeat where a coordinate does: they have the patterns of the readings and are no white noise.
    """
    step = resolution_of(fitted.run.centre)
    true = fitted.run.centre - fitted.residual
    size = np.sqrt(max(fitted.rms**2 - step**2 / 12, (0.1 * fitted.rms)**2))
    rounded: Floats = np.rint((true + size * noise) / step) * step - true
    return np.asarray(fitted.joint.whitening.apply(rounded)) / fitted.rms
