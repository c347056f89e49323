# SPDX-License-Identifier: Apache-2.0
"""What noise alone does: what the best hypothesis is worth in it, and how far single readings are off in its tail."""

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.log_evidence import SIZES, Evidence, log_mean, turned_by
from rosette_ros.core.diagnosis.noise_kinds import DEGREES, NOT_WHITE
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.records import EXACT, Floats
from rosette_ros.core.sight.linear_explanation import log_bayes_factor

DRAWS, PARTS = 100, 5
"""Runs of noise, and in how many parts they are looked at, one after the other, to save memory."""
TAIL = 10
"""Draws beyond which the probability falls as that of a log Bayes factor does: by e for each unit (Markov)."""


def null_gains(evidence: Evidence, fitted: Fit) -> Floats:
    """Return what the best hypothesis is worth in runs of noise, falling, (DRAWS,); fitted: of the model."""
    noise = np.random.default_rng(0).standard_normal((DRAWS, fitted.run.size, 3))
    if fitted.step:
        noise = _rounded(evidence, fitted, noise)
    rows = evidence.space.free(noise).reshape(DRAWS, -1)
    return np.sort(np.concatenate([_best_of(evidence, some) for some in np.split(rows, PARTS)]))[::-1]


def _best_of(evidence: Evidence, rows: Floats) -> Floats:
    """Return what the best hypothesis is worth in each of some rows of noise, (k,), freed of the model, (k, 3 N)."""
    left, bank = np.maximum(np.sum(rows**2, axis=1, dtype=float), evidence.least), evidence.bank
    log_bf = np.full((bank.ends[-1], len(rows)), -np.inf, np.float32)
    square = (SIZES[::4]**2).astype(np.float32)
    for key, products in bank.products(rows, evidence.space.whitening).items():
        blocks, group = evidence.blocks[key], bank.groups[key]
        log_bf[group.number] = 0.0
        if not blocks.seen.size:
            continue
        grown = 1 + blocks.value[:, None] * square[:, None]
        turned = turned_by(blocks.vector, products[blocks.seen])
        fall = (square[:, None] / grown) @ turned**2
        worth = log_bayes_factor(np.log(grown).sum(axis=2)[..., None], fall, left.astype(np.float32), evidence.dof)
        log_bf[blocks.number] = log_mean(worth.transpose(0, 2, 1))
    start, count = bank.ends[:-1], np.diff(bank.ends)
    top = np.maximum.reduceat(log_bf, start)
    mean = np.add.reduceat(np.exp(log_bf - np.repeat(top, count, axis=0)), start) / count[:, None]
    prior = np.array([family.log_prior for family in bank.families])
    return np.asarray(np.max(top + np.log(mean) + prior[:, None], axis=0))


def _rounded(evidence: Evidence, fitted: Fit, noise: Floats) -> Floats:
    """Return what white noise (m, N, 3) becomes in readings that are rounded, in white coordinates of unit variance.

    Errors of rounding repeat where a coordinate does: they have the patterns of the readings, each time about another
    model that may have made these."""
    run, whitening = fitted.run, fitted.joint.whitening
    steps = np.where(run.steps > 0, run.steps, np.inf)
    true = run.centre - fitted.residual + evidence.scale * whitening.inverse(noise - evidence.space.free(noise))
    size = run.repeatability or float(np.sqrt(max(fitted.rms**2 - run.rounding**2, 0.0)))
    read = true + size * np.random.default_rng(1).standard_normal(noise.shape)
    off = np.where(np.isinf(steps), read, np.rint(read / steps) * steps) - true
    return np.asarray(whitening.apply(off) / evidence.scale)


def p_of(gain: float, null: Floats) -> float:
    """Return the probability that noise makes anything worth as much."""
    above = int(np.count_nonzero(null >= gain))
    if above >= TAIL:
        return (above + 1) / (null.size + 1)
    return float((TAIL + 1) / (null.size + 1) * np.exp(min(null[TAIL - 1] - gain, 0.0)))


def p_of_tail(own: Floats, others: Floats) -> float:
    """Return the probability that the farthest of all readings is as far off as one, by the tail that the others have.

    own, others: residuals (3,), (m, 3). The tail is Student's, of readings or of coordinates, whichever makes it
    likelier; its degrees of freedom are averaged by their likelihood, NOT_WHITE shared out over finite ones."""
    return max(_p_of_student(float(own @ own), np.sum(others**2, axis=1), 3),
               _p_of_student(float(np.max(own**2)), others.reshape(-1)**2, 1))


def _p_of_student(own: float, square: Floats, dim: int) -> float:
    """Return it for a square of `dim` coordinates by Student's distribution, which the others, (m,), have."""
    finite = DEGREES[DEGREES >= 3]
    degrees = np.append(finite, EXACT)
    prior = np.append(np.full(finite.size, NOT_WHITE / finite.size), 1 - NOT_WHITE)
    scale = np.full(degrees.size, max(float(square.mean()) / dim, 1e-300))
    before = np.zeros(degrees.size)
    while not np.allclose(scale, before, atol=0):  # the likeliest one, by EM
        weighted = (degrees[:, None] + dim) / (degrees[:, None] + square / scale[:, None]) * square
        before, scale = scale, np.maximum(np.mean(weighted, axis=1) / dim, 1e-300)
    half, gammaln = degrees / 2, scipy.special.gammaln
    log_p = square.size * (gammaln(half + dim / 2) - gammaln(half) - dim / 2 * np.log(degrees * scale)) - np.sum(
        (half[:, None] + dim / 2) * np.log1p(square / (degrees * scale)[:, None]), axis=1) + np.log(prior)
    weight = np.exp(log_p - log_p.max())
    one = scipy.special.fdtrc(dim, degrees, own / (dim * scale))
    return float(weight / weight.sum() @ -np.expm1((square.size + 1) * np.log1p(-np.minimum(one, 1 - 1e-12))))
