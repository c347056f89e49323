# SPDX-License-Identifier: Apache-2.0
"""What a run is explained by: the probabilities of all hypotheses that were looked at, and what they say together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rosette_ros.core.effects.library import EFFECTS

CLAIM = 0.7
"""Probability of a name, with what this run cannot tell from it, from which on it is claimed."""
ALIKE = 0.05
"""Probability of another name in its place, over that of a claim, from which on the run cannot tell them apart."""

Key = tuple[tuple[str, ...], tuple[str, ...]]
"""Names of the members, sorted, and kinds of the noise, none for white."""


@dataclass(frozen=True)
class Claim:
    """A name that is in the best hypothesis: its probability, and the names that this run cannot distinguish from it.

    together: the probability that one of all these is there; alternatives: the other names, each with the probability
    that it is there in place of this one."""

    name: str
    probability: float
    together: float
    alternatives: tuple[tuple[str, float], ...]

    @property
    def alike(self) -> tuple[str, ...]:
        """The other names, likeliest first."""
        return tuple(name for name, _ in self.alternatives)


class Posterior:
    """The probabilities of hypotheses; log_evidence: of each, its prior included."""

    def __init__(self, log_evidence: Mapping[Key, float]) -> None:
        self.keys = sorted(log_evidence, key=lambda key: -log_evidence[key])
        values = np.array([log_evidence[key] for key in self.keys])
        weight = np.exp(values - values[0])
        self.p = dict(zip(self.keys, (weight / weight.sum()).tolist()))

    @cached_property
    def nothing(self) -> float:
        """The probability that nothing is missing."""
        return float(sum(p for (names, _), p in self.p.items() if not names))

    @cached_property
    def unnamed(self) -> float:
        """The probability that something without a name is missing."""
        return float(sum(p for (names, _), p in self.p.items() if any(name not in EFFECTS for name in names)))

    @cached_property
    def best(self) -> Key:
        """The likeliest hypothesis of what is missing, or nothing where that is likelier than all others together."""
        return next(key for key in self.keys if bool(key[0]) == (self.nothing < 0.5))

    def of(self, *names: str) -> float:
        """Return the probability that one of some members is there."""
        return float(sum(p for (members, _), p in self.p.items() if not set(names).isdisjoint(members)))

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """The names of the best hypothesis, the likeliest first."""
        out = []
        for name in dict.fromkeys(self.best[0]):
            instead = self.instead(name)
            named = {other: p for other, p in instead.items() if other in EFFECTS}
            if not named:
                continue
            best = max(named, key=lambda other: named[other])
            least = ALIKE * named[best]
            alike = tuple(sorted(((other, p) for other, p in named.items() if other != best and p > least),
                                 key=lambda pair: -pair[1]))
            out.append(Claim(best, self.of(best), self.of(best, *(other for other, _ in alike)), alike))
        return tuple(sorted(dict.fromkeys(out), key=lambda one: -one.together))

    def instead(self, name: str) -> dict[str, float]:
        """Return the probability of each member in place of one of the best hypothesis, the others being there."""
        rest = list(self.best[0])
        rest.remove(name)
        out: dict[str, float] = {}
        for (members, _), p in self.p.items():
            if len(members) == len(rest) + 1:
                more = list(members)
                for one in rest:
                    if one in more:
                        more.remove(one)
                if len(more) == 1:
                    out[more[0]] = out.get(more[0], 0.0) + p
        return out

    def explanations(self, share: float = 0.95) -> Sequence[tuple[Key, float]]:
        """Return hypotheses and their probabilities, best first, until they have a share together."""
        out, total = [], 0.0
        for key in self.keys:
            out.append((key, self.p[key]))
            total += self.p[key]
            if total >= share:
                break
        return out
