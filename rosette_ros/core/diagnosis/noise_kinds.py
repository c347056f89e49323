# SPDX-License-Identifier: Apache-2.0
"""Kinds of noise: what each is, and its log evidence beside the members of a hypothesis.

Scatter differs: the coordinates fall into groups (axes, balls, places, parts of the run, readings, single coordinates),
the weight of each is drawn from a gamma distribution of mean 1 and nu / 2; a group of one is Student's distribution of
nu degrees of freedom. The evidence is summed over nu, the weights are found by variational Bayes.

Wander: beside white noise a frame that moves at random, u_r = phi u_(r-1) + white, of another share along z than along
x and y; summed over phi, the shares and the sizes of the axes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.log_evidence import ENOUGH, NEAR, log_mean
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.model import NOISE_TERMS
from rosette_ros.core.model.noise import Noise, Whitening, places
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import EXACT, Floats, Ints, Run
from rosette_ros.core.sight.linear_explanation import Solution

NOT_WHITE = 0.2
"""Share of the runs whose noise is not white and equal, shared out evenly over its kinds."""
LEAST = math.log(1 - NOT_WHITE) - 4
"""Log evidence over white noise without prior, by its estimate, below which a kind is not looked at: the estimate of a
wander is low by about 1, that of scatter by 2."""
DEGREES = np.array([3.0, 0.5, 1.5, 6.0, 12.0, 25.0])
"""Degrees of freedom of the weights of groups that are summed over: from wild to hardly any difference, and a middle
that is looked at first."""
MEMORIES = (0.3, 0.6, 0.8, 0.9, 0.97, 1.0)
"""phi of the wander that are summed over."""
SHARES = 2.0**np.arange(-6, 7, 2)
"""Variances of the wander over that of the white noise that are summed over; of a random walk: after the run."""
RATIOS = 2.0**np.arange(-2, 2.5, 0.5)
"""Sizes of the noise of z over that of x and y beside a wander that are summed over."""
LOOKED = 2.0**np.arange(-5, 5.1, 0.25)
"""Sizes of the noise, squared, over those in equal noise of which the best one counts where kinds are looked at."""
PROBES = 256
"""Draws of white noise, times balls, by which the share that a fit leaves of each frequency is known."""
SAMPLES = 32
"""Weights that are drawn from what variational Bayes has found: the bound is lower than the evidence by a few nats."""


class Beside:
    """The readings of a run freed of a model and of the members of a hypothesis under any noise.

    observed: (N, 3), whatever the base model adds, in units of the residual; fixed: (q, N, 3) columns of the effects of
    the model; members: (k, N, 3), orthonormal; sizes: (k,) of these over sigma; plain: the noise of which others are
    kinds: white, with what the digits of the readings add; unit: of the residual, m.
    """

    def __init__(self, run: Run, lever: float, terms: tuple[str, ...], observed: Floats, fixed: Floats,
                 members: Floats, sizes: Floats, plain: Noise | None = None, unit: float = 1.0) -> None:
        self.run, self._lever, self._terms, self.unit = run, lever, terms, unit
        self.plain = plain or Noise()
        self.digits: Floats = np.ones((1, 3)) if self.plain.digits is None else self.plain.digits
        length = np.sqrt(np.maximum(np.sum(fixed**2, axis=(1, 2)), 1e-300))
        self.sizes = np.concatenate([np.full(len(fixed), 1e6), sizes])  # of what the model has nothing is known before
        space = BaseSpace(run, lever, terms)
        self.rows = space.free(np.concatenate([observed[None], fixed / length[:, None, None], members]))
        self.white = Left(self, space) if self.plain.digits is None else self.under(self.plain.whitening(run))
        self.dof = 3 * run.size - space.rank - len(fixed)
        self.least = max(self.dof * (run.rounding / unit)**2, 1e-300)

    def under(self, whitening: Whitening) -> 'Left':
        """Return what is left under a noise; raises NotDeterminable where too little counts."""
        return Left(self, BaseSpace(self.run, self._lever, self._terms, whitening))

    def likelihoods(self, weight: Floats) -> Floats:
        """Return the log likelihoods under weights of the coordinates (D, N, 3), (D,); raises as `under`."""
        weight = weight / self.digits**2
        products, log_det = map(np.array, zip(*self.white.space.weighed(self.rows, weight)))
        return _joined(self, products, log_det - np.sum(np.log(weight), axis=(1, 2)))[0]


class Left:
    """What a noise leaves: by part (z; x and y) square sums, products with and of the columns, and ln det."""

    def __init__(self, beside: Beside, space: BaseSpace) -> None:
        self.beside, self.space, self._white = beside, space, space.whitening.apply(beside.rows)
        self.parts = [(products, log_det + space.whitening.log_det_of(axes)) for products, log_det, axes in zip(
            space.products(self._white), space.log_dets, ((2,), (0, 1)))]

    @cached_property
    def joined(self) -> tuple[float, float, Floats]:
        """Log likelihood, square sum and amplitudes (k,)."""
        (z, det_z), (w, det_w) = self.parts
        likelihood, square, amplitude = _joined(self.beside, z + w, np.array(det_z + det_w))
        return float(likelihood), float(square), amplitude

    @property
    def free_of_z(self) -> int:
        """Degrees of freedom of z."""
        return self.beside.run.size - self.space.ranks[0]

    @cached_property
    def _rows(self) -> Floats:
        """What is left of the readings and of the columns, (k + 1, N, 3), in white coordinates."""
        return np.asarray(self.space.free(self._white, 1))

    @cached_property
    def _solution(self) -> Solution:
        """That of the columns at their sizes."""
        (z, _), (w, _) = self.parts
        return Solution(self.beside.sizes[:, None] * (z + w)[1:, 1:] * self.beside.sizes)

    def freed(self, columns: Floats) -> Floats:
        """Return columns (m, N, 3) freed of the model and the members, in white coordinates."""
        rows, free = self.beside.sizes[:, None, None] * self._rows[1:], self.space.residual(columns)
        used = self._solution.solved(np.tensordot(rows, free, axes=((1, 2), (1, 2))))
        return np.asarray(free - np.tensordot(used.T, rows, axes=1))

    @cached_property
    def fitted(self) -> tuple[Floats, Floats, float, float]:
        """Residual (3 N,), its variance by the fit over sigma^2, (3 N,), square sum and log likelihood; in units in
        which the plain noise is white."""
        likelihood, square, amplitude = self.joined
        rows = self._rows.reshape(len(self._rows), -1)
        share = self.space.leverage.reshape(-1).copy()
        share += np.sum(self._solution.halved(self.beside.sizes[:, None] * rows[1:])**2, axis=0)
        sd = np.broadcast_to(self.space.whitening.sd / self.beside.digits, (self.beside.run.size, 3)).reshape(-1)
        return (rows[0] - amplitude @ rows[1:]) * sd, share * sd**2, square, likelihood


def _joined(beside: Beside, products: Floats, log_det: Floats) -> tuple[Floats, Floats, Floats]:
    """Return log likelihoods, square sums (...,) and amplitudes (..., k) of products (..., k + 1, k + 1).

    That of nothing but the model, and the log Bayes factor of the columns beside it; no noise is less than errors of
    rounding."""
    left, across, gram = np.maximum(products[..., 0, 0], beside.least), products[..., 1:, 0], products[..., 1:, 1:]
    solution, told = Solution(beside.sizes[:, None] * gram * beside.sizes), beside.sizes * across
    amplitude = beside.sizes * solution.solved(told[..., None])[..., 0]
    alone = -0.5 * beside.dof * np.log(left) - 0.5 * log_det
    return (alone + solution.log_bayes_factor(told, left, beside.dof), left - np.sum(amplitude * across, axis=-1),
            amplitude)


@dataclass(frozen=True, eq=False)
class Found:
    """A noise and its log evidence, prior included, over that of white noise without prior."""

    kinds: tuple[str, ...]
    noise: Noise
    log_evidence: float
    likelihood: float


def degrees_of(name: str) -> Floats:
    """Return the degrees of freedom to sum over of a kind of scatter: tails without a kurtosis are wrong readings."""
    return DEGREES[DEGREES > 4] if name in ('reading', 'coordinate') else DEGREES


def check_of(run: Run) -> tuple[float, Floats]:
    """Return the degrees of freedom of the repeatability along each axis, 0 where it is not known by axis, and its
    variances, (3,), of mean 1."""
    if run.repeatability is None or run.repeatability_axes is None:
        return 0.0, np.ones(3)
    square = np.array(run.repeatability_axes)**2
    return (run.repeatability_dof or EXACT) / 3, square / square.mean()


def groups_of(run: Run) -> dict[str, Ints]:
    """Return the group of each coordinate, (3 N,), by the kinds of scatter."""
    size = run.size
    out = {'z': np.tile([0, 0, 1], size), 'axis': np.tile([0, 1, 2], size)}
    out |= {name: np.repeat(index, 3) for name, index, _ in places(run) if name != 'sequence'}
    return out | {'reading': np.repeat(np.arange(size), 3), 'coordinate': np.arange(3 * size)}


class NoiseKinds:
    """The kinds of noise of a run beside a hypothesis."""

    def __init__(self, beside: Beside, allowed: Sequence[str] = NOISE_TERMS, least: float = 0.0,
                 of_motion: float | None = None) -> None:
        """Take the kinds that a model allows; each is one of its terms of noise.

        least: standard deviation that any reading has, m; of_motion: log prior of a motion without a name, where such
        are looked for: a frame that wanders is one of them, and has no other; else it stands for them all."""
        self.beside, self.run = beside, beside.run
        variance = np.maximum(beside.run.steps**2 / 12, least**2) / (beside.unit * beside.digits)**2
        self._least: Floats = variance.reshape(-1)
        self.groups = {name: group for name, group in groups_of(beside.run).items() if _term_of(name) in allowed}
        self._may_wander = _term_of('wander') in allowed
        self._each = math.log(NOT_WHITE / (len(self.groups) + 1))
        self._of_wander = self._each if of_motion is None else of_motion
        self._zero = beside.white.joined[0]

    @property
    def may_be(self) -> bool:
        """Whether one of them is worth looking at beside white noise."""
        return any(self._hope(name) > LEAST for name in self.groups) or (
            self._may_wander and self._wander_hope > LEAST)

    def found(self, least: float = LEAST) -> list[Found]:
        """Return the kinds worth looking at, best first, white noise among them; least: log evidence that is of use."""
        white = Found((), self.beside.plain, math.log(1 - NOT_WHITE), self._zero)
        least = min(least, LEAST)
        out = [white, *(self._wander(least) if self._may_wander and self._wander_hope > LEAST else ())]
        made = [one for name in self.groups if self._hope(name) > least for one in self._scatter((name,), least)]
        single = sorted((one for one in made if one.bound > white.log_evidence), key=lambda one: -one.bound)
        for other in single[1:3]:
            made += self._scatter((*single[0].names, *other.names))
        made.sort(key=lambda one: -one.bound)
        near = max((one.bound for one in made), default=0.0) - NEAR
        out += [self._found(one, one.bound > near) for one in made]
        return sorted(out, key=lambda one: -one.log_evidence)

    def _hope(self, name: str) -> float:
        """Return about what a scatter is worth, from the square sums of its groups in the fit of equal noise.

        A group has as many degrees of freedom as that fit leaves it. The size of the noise is the best one."""
        residual, share, square, _ = self.beside.white.fitted
        group, dof = self.groups[name], self.beside.dof
        free, energy = (np.bincount(group, one) for one in (np.maximum(1 - share, 0), residual**2 * dof / square))
        values, gammaln = [], scipy.special.gammaln
        for nu in degrees_of(name):
            shape, rate, known = self._prior(name, nu)
            a = shape + free / 2
            each = (np.array_split(one, 1 + len(a) // 4096) for one in (a, rate, energy))
            by_size = dof / 2 * np.log(LOOKED) - sum(np.log(r + LOOKED[:, None] / 2 * e) @ s for s, r, e in zip(*each))
            values.append(known + by_size.max() + np.sum(gammaln(a) - gammaln(shape) + shape * np.log(rate)) + dof / 2)
        return float(log_mean(np.array(values))) + self._each

    @cached_property
    def _wander_hope(self) -> float:
        """About what a wander is worth, from the spectra of what the fit of equal noise leaves (Whittle).

        ln p = -m/2 ln sum p / f - 1/2 sum g ln f over the frequencies, p the power of what is left, f the spectrum of
        the noise over that of white noise, g the share of a frequency that the fit leaves of white noise: what that
        has in common with what is left of it, in so many PROBES that the sum is known to a fourth of its scatter."""
        white, size, rng = self.beside.white, self.run.size, np.random.default_rng(0)
        residual, _, square, _ = white.fitted
        power = np.abs(np.fft.rfft(residual.reshape(size, 3), axis=0))**2 / size
        common, whole = np.zeros(power.shape), np.zeros(power.shape)
        for _ in range(max(2, -(-PROBES // self.run.n))):  # one by one, as they may be long
            drawn = rng.standard_normal((1, size, 3))
            before, after = (np.fft.rfft(one[0], axis=0) for one in (drawn, white.freed(drawn)))
            common += (after * before.conj()).real
            whole += np.abs(before)**2
        angle = 2 * np.pi * np.arange(len(power)) / size
        times = np.where((angle > 0) & (angle < np.pi), 2.0, 1.0)[:, None]
        energy, free = times * power, times * common / whole
        values = []
        for phi in MEMORIES:
            drive = 1 - phi**2 if phi < 1 else 1 / size
            spectrum = 1 + SHARES[:, None] * drive / np.abs(1 - phi * np.exp(1j * np.maximum(angle, np.pi / size)))**2
            (z, w), (det_z, det_w) = ((one[:, 2], one[:, 0] + one[:, 1]) for one in (
                (1 / spectrum) @ energy, np.log(spectrum) @ free))
            values.append(-self.beside.dof / 2 * np.log(np.add.outer(z, w) / square) - np.add.outer(det_z, det_w) / 2)
        return float(log_mean(np.array(values).reshape(-1))) + self._of_wander

    def _prior(self, name: str, nu: Floats | float) -> tuple[Floats, Floats, Floats]:
        """Return shapes and rates (..., groups) of the gamma distributions of weights, and log evidence of the check.

        What a repeatability by axis says of the axes is known before the run."""
        (dof, square), gammaln = check_of(self.run), scipy.special.gammaln
        if name not in ('z', 'axis'):
            dof, square = 0.0, np.ones(int(self.groups[name].max()) + 1)
        seen = dof * np.array([2.0, 1.0] if name == 'z' else [1.0] * len(square))
        energy = seen * (np.array([square[:2].mean(), square[2]]) if name == 'z' else square)
        half = np.asarray(nu)[..., None] / 2
        shape, rate = half + seen / 2, half + energy / 2
        known = gammaln(shape) - gammaln(half) + half * np.log(half) - shape * np.log(rate) + energy / 2
        return shape, rate, np.sum(known, axis=-1)

    def _scatter(self, names: tuple[str, ...], least: float = -np.inf) -> Iterator['_Scatter']:
        """Yield the scatter that differs by all of some groups, the degrees of freedom of the last one summed over.

        None where those in the middle are worth less than `least`."""
        degrees, state = [6.0] * len(names), _Weights.equal([self.groups[name] for name in names], self.beside.white)
        prior = len(names) * self._each - self._zero
        try:
            for place in range(len(names)):
                found = []
                for nu in degrees_of(names[place]):
                    degrees[place] = float(nu)
                    state = self._bayes(names, degrees, state)
                    found.append((state, float(nu)))
                    if found[0][0].bound + prior < least:
                        return
                best = max(found, key=lambda one: one[0].bound)
                degrees[place], state = best[1], best[0]
        except (NotDeterminable, np.linalg.LinAlgError):
            return  # a part of the readings counts for nothing
        bound = float(log_mean(np.array([one.bound for one, _ in found])))
        yield _Scatter(names, degrees, state, bound + prior)

    def _found(self, one: '_Scatter', is_near: bool) -> Found:
        """Return a scatter as a kind of noise; is_near: whether its evidence itself is asked for, not its bound."""
        gap = self._gap(one.names, one.degrees, one.state) if is_near else 0.0
        return Found(one.names, self._noise(one.names, one.degrees, one.state), one.bound + gap, one.state.likelihood)

    def _bayes(self, names: Sequence[str], degrees: Sequence[float], state: '_Weights') -> '_Weights':
        """Return weights of groups by variational Bayes; state: where to begin."""
        shapes: list[Floats] = [np.zeros(0)] * len(names)
        weights, left, before = list(state.weights), state.left, -np.inf
        digamma, gammaln = scipy.special.digamma, scipy.special.gammaln
        while True:
            residual, share, square, _ = left.fitted
            error = np.maximum(residual**2, self._least) * self.beside.dof / square + share
            total = np.prod([one[self.groups[name]] for one, name in zip(weights, names)], axis=0)
            bound = 0.0
            for k, (name, nu) in enumerate(zip(names, degrees)):
                group, (shape, rate, known) = self.groups[name], self._prior(name, nu)
                rest, count = total / weights[k][group], np.bincount(group, minlength=len(weights[k]))
                a, b = shape + count / 2, rate + np.bincount(group, error * rest, minlength=len(weights[k])) / 2
                weights[k], shapes[k] = a / b, a
                bound += float(known + np.sum(
                    -(a - shape) * digamma(a) + gammaln(a) - gammaln(shape) + shape * np.log(rate / b)
                    - a * (rate - b) / b + count / 2 * (digamma(a) - np.log(a))))
                total = rest * weights[k][group]
            left = self.beside.under(Whitening(self.run.size, self.beside.digits / np.sqrt(total.reshape(-1, 3))))
            # the determinant of the noise counts the mean of the logarithm, not the logarithm of the mean
            likelihood = left.joined[0]
            if not likelihood + bound > before + ENOUGH:
                break
            before = likelihood + bound
        return _Weights(tuple(weights), tuple(shapes), left, max(before, likelihood + bound), likelihood)

    def _gap(self, names: Sequence[str], degrees: Sequence[float], state: '_Weights') -> float:
        """Return by how much the log evidence is above its bound, by weights drawn from what was found."""
        rng, gammaln = np.random.default_rng(0), scipy.special.gammaln
        total, odds = np.ones((SAMPLES, 3 * self.run.size)), np.zeros(SAMPLES)
        drawn = list(zip(*[[rng.gamma(a) for a in state.shapes] for _ in range(SAMPLES)]))
        for name, nu, weights, a, some in zip(names, degrees, state.weights, state.shapes, map(np.array, drawn)):
            b, own, (shape, rate, known) = a / weights, some * weights / a, self._prior(name, nu)
            odds += known + np.sum(shape * np.log(rate) - gammaln(shape) + (shape - a) * np.log(own)
                                   - (rate - b) * own - a * np.log(b) + gammaln(a), axis=1)
            total *= own[:, self.groups[name]]
        found = self.beside.likelihoods(total.reshape(SAMPLES, -1, 3)) + odds
        return max(float(log_mean(found)) - state.bound, 0.0)

    def _noise(self, names: Sequence[str], degrees: Sequence[float], state: '_Weights') -> Noise:
        noise = self.beside.plain
        for name, nu, weights in zip(names, degrees, state.weights):
            if name in ('z', 'axis'):
                noise = replace(noise, axes=noise.axes / np.sqrt(weights[[0, 0, 1] if name == 'z' else [0, 1, 2]]))
            elif name in ('reading', 'coordinate'):
                before = 1.0 if noise.weight is None else noise.weight
                own, left = weights[self.groups[name]].reshape(-1, 3), state.left.fitted[0].reshape(-1, 3)
                own = own * np.sum(left**2) / np.sum(own * left**2)  # sigma is the root of the variance, as without
                noise = replace(noise, tail=name, tail_dof=nu, weight=before * own)
            else:
                noise = replace(noise, by=name, factors=1 / np.sqrt(weights))
        return noise.scaled()

    def _wander(self, least: float) -> Iterator[Found]:
        """Yield the wander where it is worth looking at."""
        def tried(phi: float, shares: Sequence[float]) -> list[Left]:
            end = self.run.size if phi == 1 else 1
            sd = np.ones(3) if self.beside.plain.is_white else self.beside.digits
            return [self.beside.under(Whitening(self.run.size, sd, phi, np.full(3, share / end))) for share in shares]

        def log_bf(made: Sequence[Left]) -> Floats:
            """Return the log likelihoods over white noise, (z, xy, ratio)."""
            (z, det_z), (w, det_w) = (tuple(map(np.array, zip(*(one.parts[part] for one in made)))) for part in (0, 1))
            products = z[:, None, None] / RATIOS[:, None, None]**2 + w[:, None]
            log_det = det_z[:, None, None] + det_w[:, None] + 2 * np.log(RATIOS) * made[0].free_of_z
            return _joined(self.beside, products, log_det)[0] - self._zero

        hope = float(log_mean(np.concatenate([log_bf(tried(phi, SHARES[2:4].tolist())).reshape(-1)
                                              for phi in (0.6, 0.97)])))
        if hope + self._of_wander < least:  # too rough to be held against more than white noise
            return
        every = {phi: log_bf(tried(phi, SHARES.tolist())) for phi in MEMORIES}
        equal = np.flatnonzero(RATIOS == 1)
        for kinds, ratios in ((('wander',), equal), (('z', 'wander'), np.arange(len(RATIOS)))):
            some = {phi: one[..., ratios] for phi, one in every.items()}
            best = max(some, key=lambda phi: some[phi].max())
            weight = np.exp(some[best] - some[best].max())
            weight /= weight.sum()
            share_z, share_w, ratio = (float(np.exp(np.sum(weight * np.log(axis)))) for axis in (
                SHARES[:, None, None], SHARES[None, :, None], RATIOS[ratios][None, None]))
            size = np.array([1.0, 1.0, ratio])
            wander = size**2 * np.array([share_w, share_w, share_z]) / (self.run.size if best == 1 else 1)
            value = float(log_mean(np.array([float(log_mean(one.reshape(-1))) for one in some.values()])))
            noise = replace(self.beside.plain, axes=size, phi=best, wander=wander).scaled()
            prior = self._of_wander + (len(kinds) - 1) * self._each
            yield Found(kinds, noise, value + prior, self._zero + float(some[best].max()))


def _term_of(name: str) -> str:
    """Return the term of a model that allows a kind of noise."""
    kinds = {'z': 'axes', 'axis': 'axes', 'reading': 'tail', 'coordinate': 'tail', 'wander': 'wander'}
    return f'noise.{kinds.get(name, "groups")}'


@dataclass(frozen=True, eq=False)
class _Scatter:
    """Scatter that differs by all of some groups; bound: of its log evidence, as of Found."""

    names: tuple[str, ...]
    degrees: Sequence[float]
    state: '_Weights'
    bound: float


@dataclass(frozen=True, eq=False)
class _Weights:
    """Weights of groups and the shapes of their gamma distributions, what is left under them, bound and likelihood."""

    weights: tuple[Floats, ...]
    shapes: tuple[Floats, ...]
    left: Left
    bound: float
    likelihood: float

    @classmethod
    def equal(cls, groups: Sequence[Ints], white: Left) -> '_Weights':
        """Return equal weights of groups; white: what is left under them."""
        return cls(tuple(np.ones(int(group.max()) + 1) for group in groups), (), white, -np.inf, white.joined[0])
