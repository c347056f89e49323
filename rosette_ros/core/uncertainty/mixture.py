# SPDX-License-Identifier: Apache-2.0
"""Mixtures of normal distributions: what is one thing or another, each with its probability."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.run.records import Floats

MOST_PARTS = 10
"""Parts that may be there or not and are told apart; the smaller ones are taken as normal."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """Normal distributions with probabilities p (m,), which add up to 1, means (m,) and standard deviations (m,)."""

    p: Floats
    mean: Floats
    sd: Floats

    @classmethod
    def of_parts(cls, mean: float, variance: float, parts: Sequence[tuple[float, float]]) -> Self:
        """Return the distribution of a quantity with a normal part and parts that may be there or not.

        variance: of all together; parts: (probability that it is there, its part of the variance)."""
        most = sorted((one for one in parts if one[1] > 0 and one[0] > 0), key=lambda one: -one[1])[:MOST_PARTS]
        there, share = (np.array([one[place] for one in most]) for place in (0, 1))
        cases = np.array(list(product((0.0, 1.0), repeat=len(most)))).reshape(2**len(most), len(most))
        p = np.prod(np.where(cases > 0, there, 1 - there), axis=1)
        rest = max(variance - float(share.sum()), 0.0)
        return cls(p, np.full(p.shape, mean), np.sqrt(rest + cases @ (share / np.maximum(there, 1e-300))))

    @classmethod
    def together(cls, p: Sequence[float], every: Sequence['Mixture']) -> 'Mixture':
        """Return the mixture of several that are there with probabilities in the ratio of p."""
        weight = np.asarray(p) / np.sum(p)
        return cls(np.concatenate([share * one.p for share, one in zip(weight.tolist(), every, strict=True)]),
                   *(np.concatenate([getattr(one, name) for one in every]) for name in ('mean', 'sd')))

    @property
    def moments(self) -> tuple[float, float]:
        """Mean and variance, that within and that between (law of total variance)."""
        mean, variance = total(self.p, self.mean, self.sd)
        return float(mean), float(variance)**2

    def below(self, limit: float) -> float:
        """Return the probability that the quantity is at most a limit."""
        off = limit - self.mean
        z = np.divide(off, self.sd, out=np.where(off >= 0, np.inf, -np.inf), where=self.sd > 0)
        return float(self.p @ scipy.special.ndtr(z))

    def factor(self, probability: float) -> float:
        """Return k so that mean +- k standard deviations contain the quantity with a probability."""
        mean, variance = self.moments
        u = float(np.sqrt(variance))
        if not u:
            return 0.0

        low, high = 0.0, 1 / float(np.sqrt(1 - probability))  # Chebyshev
        while low < (k := 0.5 * (low + high)) < high:
            is_less = self.below(mean + k * u) - self.below(mean - k * u) < probability
            low, high = (k, high) if is_less else (low, k)
        return high


def total(p: Floats, mean: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation over explanations with probabilities p (m,), of each (m, ...) (law of total
    variance): u^2 = sum of p (u_h^2 + (mean_h - mean)^2)."""
    middle = np.tensordot(p, mean, axes=1)
    return middle, np.sqrt(np.tensordot(p, u**2 + (mean - middle)**2, axes=1))
