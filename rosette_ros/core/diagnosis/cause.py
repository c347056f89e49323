# SPDX-License-Identifier: Apache-2.0
"""What a model lacks, from the search to JSON: what moves with what, and each effect of it as it is fitted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.experience import KnownCause
from rosette_ros.core.sight.limits import SURE

if TYPE_CHECKING:  # nodes and clients pass a verdict on: they start faster without what makes a fit
    from rosette_ros.core.diagnosis.log_evidence import Place
    from rosette_ros.core.model.least_squares import Parameter


@dataclass(frozen=True)
class Cause:
    """What moves with what, as far as the run tells: of members of the best hypothesis, or of one member of any.

    places: these members; bodies: what moves, 'frame', 'plate growing', 'ball 7', 'reading 48' ..., then what moves in
    other hypotheses, until it is sure, then what moves the balls alike here by the same course, `alike`, of each other
    part of the cell one motion; variables: with what, for each variable the set of those that stand for it in this
    order, itself or the plainest first, none for a constant amount; or_with: where that is not sure, what they move
    with in other hypotheses, likeliest first, until it is; probability: that one of these bodies moves with one of
    these variables, by any law; laws: sets of names that do it, likeliest first, empty without a name, each with the
    probability that it is this; law_certain: whether its variables, and all else of the grammar, leave no other than
    that of the best hypothesis.
    """

    places: 'tuple[Place, ...]' = field(compare=False)  # families belong to one search
    bodies: tuple[str, ...]
    variables: tuple[tuple[str, ...], ...]
    probability: float = 0.0
    laws: tuple[tuple[tuple[str, ...], float], ...] = ()
    law_certain: bool = False
    or_with: tuple[tuple[str, ...], ...] = ()
    alike: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its members, sorted, none where one has no name."""
        if any(family.is_free for family, _ in self.places):
            return ()
        return tuple(sorted(family.name for family, _ in self.places))

    @cached_property
    def own(self) -> frozenset[str]:
        """The variables with which it moves."""
        return frozenset(first for first, *_ in self.variables)

    @cached_property
    def may_be(self) -> frozenset[str]:
        """All variables with which it may move."""
        return frozenset().union(*self.variables)

    def standing(self, variable: str) -> frozenset[str]:
        """Return what stands for one of its variables."""
        return frozenset().union(*(some[1:] for some in self.variables if some[0] == variable))

    def moves_with(self, other: 'Cause') -> bool:
        """Return whether both may move with the same, or by a constant amount, which is with nothing."""
        return (not (self.own or other.own) or not self.may_be.isdisjoint(other.own)
                or not other.may_be.isdisjoint(self.own))

    def agrees(self, other: 'Cause') -> bool:
        """Return whether both say that one of the same bodies moves with something that may be the same."""
        return not set(self.bodies).isdisjoint(other.bodies) and self.moves_with(other)

    @property
    def alternatives(self) -> tuple[frozenset[str], ...]:
        """Sets of variables that stand for each other: what is said is with one of these."""
        return tuple(dict.fromkeys(map(frozenset, (*product(*self.variables), *self.or_with))))

    def number(self, what: str) -> int | None:
        """Return the number of the ball or reading that moves, None where it is none."""
        found = [one.split()[1] for one in self.bodies if one.startswith(f'{what} ')]
        return int(found[0]) if found else None

    @property
    def law_probability(self) -> float:
        """The probability that its law is that of the best hypothesis."""
        return dict(self.laws).get(self.names, 0.0)


class Interval(NamedTuple):
    """Between which times, s since the first reading, and which readings an instant lies, with its probability."""

    low: float
    high: float
    last: int
    first: int
    probability: float


@dataclass(frozen=True)
class MissingEffect:
    """An effect that a model lacks, or a candidate for that: an effect of the library or a motion without a name, a
    base term, which has no setting, no parameters and no cause.

    setting, parameters: as fitted beside all that is claimed; moments: where its instants lie; cause: what moves with
    what, as far as the run tells, None of what is not said; is_there: the probability that the run has it, by its name;
    alternatives: names that the run cannot tell from it, each with the probability that it is there in its place;
    together: the probability that one of all these is there; learnt: what experience of the cell says of it, None
    where it says nothing; alone: `together` without it, by this run alone; p: search-wide probability that noise does
    as well; visible_fraction: what the order shows of it; before, after: rms of the residual, m, without it and with
    it, beside what stands above it; time_unit: as of Run, that of times in setting and moments; claimed: whether it is
    said.
    """

    name: str
    setting: Setting = field(default_factory=Setting)
    moments: Mapping[str, Interval] = field(default_factory=dict)
    cause: Cause | None = None
    alternatives: tuple[tuple[str, float], ...] = ()
    together: float = 1.0
    parameters: 'tuple[Parameter, ...]' = ()
    before: float = np.nan
    after: float = np.nan
    time_unit: str = 's'
    is_there: float = 1.0
    p: float = np.nan
    visible_fraction: float = 1.0
    claimed: bool = True
    learnt: KnownCause | None = None
    alone: float = 0.0

    @property
    def depth(self) -> int:
        """How much is known: 2, its law; 1, what moves with what; 0, only that it is one of several names."""
        if self.cause is None or self.cause.law_certain:
            return 2
        return int(self.cause.probability >= min(SURE, self.together))

    @property
    def probability(self) -> float:
        """The probability that what is said of it is true: its law, what moves with what, or one of the names."""
        if self.cause is None:
            return self.is_there
        return (self.together, self.cause.probability, self.cause.law_probability)[self.depth]

    @property
    def look_alikes(self) -> tuple[str, ...]:
        """The names that the run cannot tell from it, likeliest first."""
        return tuple(name for name, _ in self.alternatives)

    @property
    def motion(self) -> str:
        """Which body moves along what, of a motion without a name."""
        return self.setting.word('along')

    @property
    def driven_by(self) -> tuple[frozenset[str], ...]:
        """Sets of variables of which one drives a motion without a name, the likeliest first; the ball is among them
        where one ball moves."""
        if self.cause is None:
            return ()
        ball = {'ball'} if self.cause.number('ball') else set()
        return tuple(some | ball for some in self.cause.alternatives)
