# SPDX-License-Identifier: Apache-2.0
"""What each explanation of a run predicts of readings to come, and how well these tell the explanations apart.

An explanation is a model that is linear in its amplitudes a, with normal priors of the size that the readings show, and
in small changes of its settings. With the equations E of the base model, F what this leaves of the columns of the
readings so far, y, and W what the readings so far leave open of the columns D of those to come (' transposed),

    W = D - E (E'E)^-1 E' D    mean = W a,  a = Q F y,  Q = (F F' + 1 / prior)^-1    covariance = s^2 (1 + K + W' Q W)

in which K, the base model's part, and E (E'E)^-1 E' y are common to all. Explanations with means m_i and covariances
C_i have the distances, with C = (C_i + C_j) / 2,

    d_ij^2 = (m_i - m_j)' C^-1 (m_i - m_j) + 4 ln det C - 2 ln det C_i - 2 ln det C_j

and the information of the readings on them is at least

    I = - sum_i p_i ln sum_j p_j exp(-d_ij^2 / 8)

(Kolchinsky and Tracey, Estimating mixture entropy with pairwise distances, Entropy 19 (2017) 361: Bhattacharyya
distances).

If i is true, a block moves the log odds of i against j by X ~ N(G, 2 G), G = d_ij^2 / 2, which is the Kullback-Leibler
divergence. Of the log odds N that are still needed E (N - X)+ are expected to be left, so that m = 1 + E (N - X)+ / G
times the growth of the block is needed (Wald, Sequential tests of statistical hypotheses, Ann. Math. Stat. 16 (1945)
117). The block twice, one after the other, grows by G_2. With a power law through both, n blocks by G n^b,

    b = log2(G_2 / G)    n = m^(1 / b)    share of what is needed = 1 / n, 0 .. 1

b is 1 where readings tell something new each time, less where what the run so far leaves open limits them, more where
the time between them tells. The share is not above 1 however much more a block tells. Divided by its time, it is one
over the expected time until i is settled against j (Chernoff, Sequential design of experiments, Ann. Math. Stat. 30
(1959) 755, for one need, b = 1 and blocks of one time).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.log_evidence import SIZES
from rosette_ros.core.diagnosis.posterior import Posterior
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.effects.free import FREE, WALK
from rosette_ros.core.model.columns import independent
from rosette_ros.core.model.least_squares import REFINED, Fit, observed
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.sight.linear_explanation import Solution

ROUNDS = 3
"""Times that the sizes of members are taken from their amplitudes, from the likeliest one of all members together."""
RANK, STEP = 1e-9, 1e-3
"""Share of the square sum of columns below which that of a mix is rounding; step of a derivative."""
TINY = 1e-12
"""Growth of log odds that is none."""
NODES = 24
"""Points at which an expectation is taken."""
Acting = tuple[Effect, Setting]
"""An effect at a setting."""


@dataclass(frozen=True, eq=False)
class Predictions:
    """What explanations predict of S readings.

    p: (m,) probabilities of the explanations; mean: (m, 3 S), in standard deviations of a coordinate, but for what is
    common; spread: (m, 3 S, 3 S), covariances without that of the new readings' noise.
    """

    p: Floats
    mean: Floats
    spread: Floats

    def chosen(self, count: int) -> tuple[list[int], Floats]:
        """Return the readings, 0..S-1, that one after the other add most to the information on the explanations, and
        the squared distances (m, m) in them; the mean covariance is taken for all."""
        p, mean, size = self.p, self.mean.copy(), self.mean.shape[1] // 3
        spread = np.tensordot(p, self.spread, axes=1)
        square, out, place = np.zeros((len(p), len(p))), list[int](), np.arange(3 * size).reshape(size, 3)
        for _ in range(min(count, size)):
            z = Solution(spread[place[:, :, None], place[:, None, :]]).halved(mean[:, place].transpose(1, 2, 0))
            apart = np.sum((z[..., :, None] - z[..., None, :])**2, axis=1)
            gain = information(p, square + apart)
            gain[out] = -1
            best = int(np.argmax(gain))
            out.append(best)
            square = square + apart[best]
            rows = place[best]
            held = Solution(spread[np.ix_(rows, rows)]).solved(spread[rows])
            mean = mean - mean[:, rows] @ held
            spread = spread - spread[:, rows] @ held
        return out, square

    def distances(self, count: int) -> Floats:
        """Return the squared distances of the explanations in the first readings, so many, together, (m, m)."""
        mean, spread = self.mean[:, :3 * count], self.spread[:, :3 * count, :3 * count]
        log_det, out = Solution(spread).log_det, np.zeros((len(self.p), len(self.p)))
        for i, j in combinations(range(len(self.p)), 2):
            middle = Solution((spread[i] + spread[j]) / 2)
            square = middle.fall(mean[i] - mean[j])
            out[i, j] = out[j, i] = square + 4 * middle.log_det - 2 * (log_det[i] + log_det[j])
        return out


def information(p: Floats, square: Floats) -> Floats:
    """Return the information of readings on explanations p (m,), nats, from squared distances (..., m, m)."""
    return np.asarray(-np.log(np.exp(-square / 8) @ p) @ p)


def share_of_need(square: Floats, twice: Floats, need: Floats) -> Floats:
    """Return the share of the needed log odds that a block is expected to give, 0..1: one over the expected number.

    square, twice: squared distances of pairs in the block, and in it twice; need: log odds that each lacks, above 0, of
    the same shape."""
    growth = np.maximum(square / 2, TINY)
    lacking, sd = need - growth, np.sqrt(2 * growth)
    z = lacking / sd
    left = lacking * scipy.special.ndtr(z) + sd * np.exp(-z**2 / 2) / np.sqrt(2 * np.pi)
    power = np.log2(np.maximum(twice / (2 * growth), 1 + TINY))
    return np.asarray((1 + left / growth)**(-1 / power))


def expected_share(share: float, square: float) -> float:
    """Return the probability that one of two explanations, at a squared distance, is expected to get if it is true.

    share: its now. The log odds of normal predictions change by d^2 / 2 +- d."""
    z, weight = np.polynomial.hermite_e.hermegauss(NODES)
    odds = scipy.special.logit(share) + square / 2 + np.sqrt(square) * z
    return float(scipy.special.expit(odds) @ weight / weight.sum())


def members_of(posterior: Posterior, names: tuple[str, ...]) -> list[Acting]:
    """Return the members of an explanation at their best settings; a frame that wanders, as noise, is one of them."""
    key = next(key for key in posterior.keys if key[0] == names)
    walk = (FREE, Setting(of='time', kind=WALK, along='frame along x, y and z'))
    return [*((family.effect, setting) for family, setting in posterior.places(key)), *[walk] * ('wander' in key[1])]


def best_fit(search: RunSearch) -> Fit:
    """Return the fit of the likeliest explanation of a run."""
    return search.with_members(search.chosen.members)


class Predictor:
    """Predictions of explanations, each the effects of a model and its own members at their settings.

    search: of the run; members: of each explanation; p: (m,) their probabilities, which add up to 1.
    """

    def __init__(self, search: RunSearch, members: Sequence[Sequence[Acting]], p: Floats) -> None:
        fit, self.p = search.base, p
        self.run, self._space = search.run, fit.joint.space
        known = [(term.effect, setting) for term, setting in zip(fit.model.terms, fit.settings)]
        self._members = [[*known, *some] for some in members]
        self._every = list(dict.fromkeys(one for some in self._members for one in some))
        sigma = best_fit(search).sigma
        self._y = self._space.residual((observed(self.run) - fit.beyond)[None]).ravel() / sigma
        self._sd = np.sqrt(fit.noise.axes**2 + fit.noise.wander)

    def predicted(self, longer: Run) -> Predictions:
        """Return what is predicted of the readings that a longer run has beyond this one."""
        size = self.run.size
        at = longer.table_position[size:], longer.ball[size:]
        blocks, start = dict[Acting, tuple[slice, list[slice]]](), 0
        columns = []
        for one in self._every:
            parts = _linear(longer, *one, size)
            ends = np.cumsum([start, *map(len, parts)]).tolist()
            own, *tangents = (slice(*pair) for pair in pairwise(ends))
            blocks[one], start = (own, tangents), ends[-1]
            columns += parts
        every = np.concatenate([np.zeros((0, longer.size, 3)), *columns])
        seen = self._space.residual(every[:, :size]).reshape(len(every), -1)
        later = (every[:, size:] - self._space.continued(every[:, :size], *at)).reshape(len(every), -1)
        gram, product = seen @ seen.T, seen @ self._y
        scale = np.tile(1 / self._sd, longer.size - size)
        spread = np.repeat(self._space.cofactor_at(*at)[None], len(self._members), axis=0)
        mean = np.zeros((len(self._members), len(scale)))
        for k, some in enumerate(self._members):
            if some:
                mix, amplitude, q = _solved([blocks[one] for one in some], gram, product)
                rows = mix @ later
                mean[k] = amplitude @ rows[:len(amplitude)]
                spread[k] += rows.T @ q @ rows
        return Predictions(self.p, mean * scale, scale[:, None] * spread * scale)


def _solved(blocks: Sequence[tuple[slice, list[slice]]], gram: Floats,
            product: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the columns of an explanation as mixes (k, all) of all columns, its amplitudes (q,), the columns' first
    ones, in sigma, and Q (k, k); blocks: of its members, those of the columns and of the tangents."""
    own = np.concatenate([np.arange(one.start, one.stop) for one, _ in blocks])
    of = np.repeat(np.arange(len(blocks)), [one.stop - one.start for one, _ in blocks])
    normal, right = gram[np.ix_(own, own)], product[own]
    prior = np.full(len(own), _likeliest_size(normal, right))
    for _ in range(ROUNDS):
        q = _covariance(normal, prior)
        amplitude = q @ right
        prior = np.maximum(np.sqrt(np.bincount(of, amplitude**2 + q.diagonal()) / np.bincount(of)), 1.0)[of]
    mix = list(np.eye(len(gram))[own])
    for place, (_, tangents) in enumerate(blocks):
        for one in tangents:
            mix.append(np.zeros(len(gram)))
            mix[-1][one] = amplitude[of == place]
    every = np.array(mix).reshape(-1, len(gram))
    return every, amplitude, _covariance(every @ gram @ every.T, np.append(prior, np.ones(len(every) - len(own))))


def _covariance(normal: Floats, prior: Floats) -> Floats:
    """Return that of amplitudes with normal equations (q, q) and standard deviations before, (q,), in sigma."""
    half = Solution(prior[:, None] * normal * prior).halved(np.diag(prior))
    return np.asarray(half.T @ half)


def _likeliest_size(normal: Floats, right: Floats) -> float:
    """Return the one of SIZES at which amplitudes with normal equations explain the readings best."""
    size = SIZES[:, None]
    return float(SIZES[np.argmax(Solution(size[:, None]**2 * normal).log_bayes_factor(size * right))])


def _linear(run: Run, effect: Effect, setting: Setting, size: int) -> list[Floats]:
    """Return mixes of the columns of an effect, (q, N, 3), that are orthonormal in the first `size` readings, of a free
    course of the sizes of its process and a square sum of 1 together, and what they change by where each of its refined
    parameters is doubled, to first order, (q, N, 3) each."""
    raw = _columns(run, effect, setting)
    flat = raw[:, :size].reshape(len(raw), -1)
    if effect is FREE:
        weight = np.sqrt(effect.variances(run, setting))
        mix = np.diag(weight / np.linalg.norm(weight[:, None] * flat))
    else:
        mix = independent(flat @ flat.T, RANK * float(np.sum(flat**2)))
    out = [np.tensordot(mix, raw, axes=1)]
    for one in effect.searched:
        if one.kind in REFINED and one.name in setting:
            number = setting.number(one.name)
            changed = Setting({**setting, one.name: number + STEP * (abs(number) or 1.0)})
            out.append(np.tensordot(mix, (_columns(run, effect, changed) - raw) / STEP, axes=1))
    return out


def _columns(run: Run, effect: Effect, setting: Setting) -> Floats:
    return np.asarray(np.moveaxis(effect.columns(run, setting), -1, 0), dtype=float)
