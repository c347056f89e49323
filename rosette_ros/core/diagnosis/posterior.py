# SPDX-License-Identifier: Apache-2.0
"""What a run is explained by: the probabilities of all hypotheses that were looked at."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.hypotheses import Looked
from rosette_ros.core.diagnosis.log_evidence import NEAR, Place, State
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.run.records import Floats
from rosette_ros.core.sight.limits import LISTED

Key = tuple[tuple[str, ...], tuple[str, ...]]
"""Names of the members, sorted, and kinds of the noise, none for white."""


@dataclass(frozen=True)
class Explanation:
    """A hypothesis: its members, sorted, names or the variables of what has no name, none where nothing is missing; its
    probability; its kinds of noise, none of white noise or of any."""

    members: tuple[str, ...]
    probability: float
    noise: tuple[str, ...] = ()


class Posterior:
    """The probabilities of hypotheses, and the best one as it was found.

    state: its State, under its noise; noise: of it; beyond: (N, 3), m, second-order terms with which it was found.
    """

    def __init__(self, looked: Mapping[Key, Looked], state: State | None = None, noise: Noise | None = None,
                 beyond: Floats | None = None) -> None:
        """Take of each hypothesis what is known, and what is known of the best one."""
        self._state, self.noise, self.beyond = state, noise or Noise(), beyond
        self.keys = sorted(looked, key=lambda key: -looked[key][0])
        values = np.array([looked[key][0] for key in self.keys])
        weight = np.exp(values - values[0])
        self.p = dict(zip(self.keys, (weight / weight.sum()).tolist()))
        self._looked = looked

    @property
    def state(self) -> State:
        """The State of the best hypothesis; raises ValueError where there is none."""
        if self._state is None:
            raise ValueError('expected the state of the best hypothesis, found probabilities alone')
        return self._state

    def places(self, key: Key) -> tuple[Place, ...]:
        """Return the members of a hypothesis at their best settings."""
        return self._looked[key][1]

    def log_evidence(self, key: Key) -> float:
        """Return the log evidence of a hypothesis, its prior included."""
        return self._looked[key][0]

    @cached_property
    def nothing(self) -> float:
        """The probability that nothing is missing."""
        return float(sum(p for (names, _), p in self.p.items() if not names))

    @cached_property
    def unnamed(self) -> float:
        """The probability that something without a name is missing."""
        return float(sum(p for (names, _), p in self.p.items() if any(name not in LAWS for name in names)))

    @cached_property
    def best(self) -> Key:
        """The likeliest hypothesis of what is missing, or nothing where that is likelier than all others together."""
        return next(key for key in self.keys if bool(key[0]) == (self.nothing < 0.5))

    def of(self, *names: str) -> float:
        """Return the probability that one of some members is there."""
        return float(sum(p for (members, _), p in self.p.items() if not set(names).isdisjoint(members)))

    @cached_property
    def is_open(self) -> bool:
        """Whether some member is neither likely there nor likely not there: what further readings may settle."""
        there = Counter[str]()
        for (members, _), p in self.p.items():
            there.update(dict.fromkeys(members, p))
        return any(LISTED < p < 1 - LISTED for p in there.values())

    @cached_property
    def named(self) -> dict[str, MissingEffect]:
        """The names of the best hypothesis, the likeliest first, with those that the run cannot tell from them."""
        out = []
        for name in dict.fromkeys(one for one in self.best[0] if one in LAWS):
            others = {other: p for other, p in self.instead(name).items() if other in LAWS and other != name}
            least = LISTED * self.of(name)
            alike = tuple(sorted(((other, p) for other, p in others.items() if p > least), key=lambda pair: -pair[1]))
            together = self.of(name, *(other for other, _ in alike))
            out.append(MissingEffect(name, alternatives=alike, together=together, is_there=self.of(name)))
        return {one.name: one for one in sorted(out, key=lambda one: -one.together)}

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

    @cached_property
    def alone(self) -> 'Posterior':
        """The same without what experience of the cell has added to the priors."""
        return Posterior({key: (value - sum({family.name: family.learnt for family, _ in places}.values()), places)
                          for key, (value, places) in self._looked.items()})

    @cached_property
    def near(self) -> tuple[Key, ...]:
        """The hypotheses that are asked what they say, the likeliest first: what is worse is not looked at."""
        least = self.log_evidence(self.keys[0]) - NEAR
        return tuple(key for key in self.keys if self.log_evidence(key) > least)

    def explanations(self) -> tuple[Explanation, ...]:
        """Return hypotheses, the likeliest first, until all others together need not be told."""
        total = np.cumsum([self.p[key] for key in self.keys])
        return tuple(Explanation(names, self.p[names, noise], noise)
                     for names, noise in self.keys[:np.searchsorted(total, 1 - LISTED) + 1])
