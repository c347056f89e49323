# SPDX-License-Identifier: Apache-2.0
"""What a run is explained by: the probabilities of all hypotheses that were looked at, and what they say together."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import combinations, product

import numpy as np

from rosette_ros.core.diagnosis.limits import SURE
from rosette_ros.core.diagnosis.log_evidence import Place
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import FREE, PLACES, variables
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.records import Floats, Run

ALIKE = 0.05
"""Probability of another name in its place, over that of a claim, from which on the run cannot tell them apart."""
STANDS = 0.975
"""Share of the variance of a variable, or of a course, that the functions of another variable describe where this
stands for it."""
WAVES = 12
"""Functions of a variable on a line that are asked: slow ones."""
HEARD = 1e-3
"""Probability of a hypothesis below which nobody asks what moves in it: its share counts in no sum that is told."""

Key = tuple[tuple[str, ...], tuple[str, ...]]
"""Names of the members, sorted, and kinds of the noise, none for white."""


@dataclass(frozen=True)
class Explanation:
    """A hypothesis: its members, names or the variables of what has no name, its kinds of noise, its probability."""

    members: tuple[str, ...]
    noise: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Unnamed:
    """Something that the library has no name for: which body moves along what, and with what.

    alternatives: sets of variables that this run cannot distinguish, the likeliest first; setting: of its free course.
    """

    alternatives: tuple[frozenset[str], ...]
    motion: str
    setting: Setting
    probability: float


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


@dataclass(frozen=True)
class Cause:
    """What moves with what, as far as the run tells.

    places: members of the best hypothesis; bodies: what moves, 'frame', 'plate growing', 'ball 7', 'reading 48' ...,
    then what moves the balls alike here;
    variables: with what, for each variable the set of those that stand for it in this order, itself first; or_with:
    where that is not sure, what they move with in other hypotheses, likeliest first, until it is; probability: that one
    of these bodies moves with one of these variables, by any law; laws: sets of names that do it, likeliest first,
    empty without a name, each with the probability that it is this; law_certain: whether that of the best hypothesis is
    surely it, no other one of the same motion being near by likelihood.
    """

    places: tuple[Place, ...] = field(compare=False)  # families belong to one search
    bodies: tuple[str, ...]
    variables: tuple[tuple[str, ...], ...]
    probability: float
    laws: tuple[tuple[tuple[str, ...], float], ...]
    law_certain: bool = False
    or_with: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its members in the best hypothesis, none where one has no name."""
        return _law(self.places)

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


@lru_cache(maxsize=2)
def _described(run: Run) -> dict[tuple[str, str], float]:
    """Return the share of the variance of variable b that slow functions of variable a describe, by (a, b)."""
    out = {}
    for name, basis in _slow_functions(run).items():
        for other in variables(run):
            circle = np.stack([np.cos(other.values), np.sin(other.values)])
            out[name, other.name] = _share(circle if other.name in PLACES else other.values[None], basis)
    return out


@lru_cache(maxsize=2)
def _slow_functions(run: Run) -> dict[str, Floats]:
    """Return orthonormal functions (N, k) of each variable that a run records."""
    out: dict[str, Floats] = {}
    for one in variables(run):
        functions = one.functions if one.name in PLACES else one.functions[:WAVES]
        out.setdefault(one.name, np.linalg.qr(np.column_stack([np.ones(run.size), functions.T]))[0])
    return out


def _share(values: Floats, basis: Floats) -> float:
    """Return the share of the variance of values (k, N) that orthonormal functions (N, m) describe."""
    values = values - values.mean(axis=1, keepdims=True)
    left = values - (values @ basis) @ basis.T
    return 1 - float(np.sum(left**2) / max(np.sum(values**2), 1e-300))


@dataclass(frozen=True)
class MotionOf:
    """What a member says: bodies that move, its variables, and for each those that stand for it in a run.

    alike: bodies that move the balls alike by the same course."""

    bodies: frozenset[str]
    own: frozenset[str]
    standing: Mapping[str, frozenset[str]]
    alike: frozenset[str] = frozenset()

    def agrees(self, other: 'MotionOf') -> bool:
        """Return whether both say that one of the same bodies moves with something that may be the same, or by a
        constant amount, which is with nothing."""
        if (self.bodies | self.alike).isdisjoint(other.bodies | other.alike):
            return False
        return (not (self.own or other.own) or not self.may_be.isdisjoint(other.own)
                or not other.may_be.isdisjoint(self.own))

    @property
    def may_be(self) -> frozenset[str]:
        """All variables that it may depend on."""
        return self.own.union(*self.standing.values())


def course_of(run: Run, place: Place) -> Floats | None:
    """Return the functions (k, N) by which a family at a setting moves; None where it moves one ball or place only."""
    family, setting = place
    if family.is_free:
        functions = FREE.course(run, setting)[0]
        return functions if np.any(functions, axis=0).all() else None
    factors, = family.effect.factors(run, [setting])
    return None if factors.at is not None else np.asarray(factors.waves[factors.of_setting[0][0]], dtype=float)


@lru_cache(maxsize=4096)
def motion_of(run: Run, place: Place) -> MotionOf:
    """Return what a family at a setting says of what moves with what in a run."""
    (family, setting), described = place, _described(run)
    effect = family.effect
    bodies, own = effect.moved(setting), effect.driven_by(setting)
    standing = {one: {a if one == b else b for (a, b), share in described.items()
                      if one in (a, b) and a != b and share > STANDS} for one in own}
    course = course_of(run, place)
    if len(own) == 1 and not family.is_free and course is not None and np.ptp(course, axis=1).any():
        standing[next(iter(own))] |= {  # a law may be a function of more than its variable is
            name for name, basis in _slow_functions(run).items() if _share(course, basis) > STANDS} - own
    return MotionOf(bodies, own, {one: frozenset(some) for one, some in standing.items()})


def _law(places: Sequence[Place]) -> tuple[str, ...]:
    """Return the names of members, sorted, none where one has no name."""
    return () if any(family.is_free for family, _ in places) else tuple(sorted(family.name for family, _ in places))


class Posterior:
    """The probabilities of hypotheses; looked: of each the log evidence, its prior included, and its members at their
    best settings."""

    def __init__(self, looked: Mapping[Key, tuple[float, tuple[Place, ...]]]) -> None:
        self.keys = sorted(looked, key=lambda key: -looked[key][0])
        values = np.array([looked[key][0] for key in self.keys])
        weight = np.exp(values - values[0])
        self.p = dict(zip(self.keys, (weight / weight.sum()).tolist()))
        self._places = {key: looked[key][1] for key in self.keys}

    def places(self, key: Key) -> tuple[Place, ...]:
        """Return the members of a hypothesis at their best settings."""
        return self._places[key]

    def causes(self, run: Run, motions: Mapping[Place, MotionOf]) -> tuple[Cause, ...]:
        """Return what the members of the best hypothesis say; two of one law that move the same with the same, and two
        that another one replaces, are a Cause together.

        motions: what each of these members may say in the run."""
        groups = [[place] for place in motions]
        for one, other in combinations(motions, 2):
            first, second = (next(group for group in groups if place in group) for place in (one, other))
            if first is not second and ((one[0].name == other[0].name and motions[one].agrees(motions[other]))
                                        or self._is_replaced(run, one, other, motions)):
                first += second
                groups.remove(second)
        laws: list[Counter[tuple[str, ...]]] = [Counter() for _ in groups]
        seen: list[Counter[str]] = [Counter() for _ in groups]
        apart: list[dict[tuple[str, ...], Counter[tuple[str, ...]]]] = [{} for _ in groups]
        heard = [(key, p) for key, p in self.p.items() if p > HEARD]
        for key, p in heard:
            assigned = self._assigned(run, self._places[key], groups, motions)
            others = [place for place in self._places[key] if not any(place in mine for mine in assigned)]
            for k, mine in enumerate(assigned):
                if mine:
                    laws[k][_law(mine)] += p
                    for name in frozenset().union(*(motion_of(run, place).may_be for place in mine)):
                        seen[k][name] += p
                    continue
                bodies = frozenset[str]().union(*(motions[one].bodies | motions[one].alike for one in groups[k]))
                for other in [one for one in others if not bodies.isdisjoint(motion_of(run, one).bodies)][:1]:
                    others.remove(other)  # the same body moves, with something else
                    apart[k].setdefault(tuple(sorted(motion_of(run, other).own)), Counter())[_law([other])] += p
        total = sum(p for _, p in heard)
        return tuple(self._cause(motions, tuple(group), laws[k], seen[k], apart[k], total)
                     for k, group in enumerate(groups))

    @staticmethod
    def _assigned(run: Run, places: Sequence[Place], groups: Sequence[Sequence[Place]],
                  motions: Mapping[Place, MotionOf]) -> list[list[Place]]:
        """Return which members of a hypothesis say what each group says: those of its names first."""
        out: list[list[Place]] = [[] for _ in groups]
        agreeing = [[k for k, group in enumerate(groups) if any(
            motion_of(run, place).agrees(motions[one]) for one in group)] for place in places]
        for is_name in (True, False):
            for place, ks in zip(places, agreeing):
                own = [k for k in ks if is_name == any(place[0].name == family.name for family, _ in groups[k])]
                if own:
                    out[min(own, key=lambda k: len(out[k]))].append(place)
                if is_name and own:
                    ks.clear()
        return out

    @staticmethod
    def _cause(motions: Mapping[Place, MotionOf], places: tuple[Place, ...], laws: Counter[tuple[str, ...]],
               may_be: Mapping[str, float], apart: Mapping[tuple[str, ...], Counter[tuple[str, ...]]], total: float,
               ) -> Cause:
        own, or_with = [motions[place] for place in places], []
        for other_variables, others in sorted(apart.items(), key=lambda pair: -pair[1].total()):
            if laws.total() < SURE * total:
                or_with.append(other_variables)
                laws = laws + others
        # of several variables those that nearly every explanation has, at least the likeliest
        ranked = sorted({one for motion in own for one in motion.own}, key=lambda one: (-may_be[one], one))
        kept = [one for one in ranked if may_be[one] >= SURE * max(may_be.values())] or ranked[:1]
        standing = [frozenset[str]().union(*(motion.standing.get(one, ()) for motion in own)) - {one}
                    for one in kept]
        sets = {frozenset((one, *some)): (one, *sorted(some)) for one, some in reversed(list(zip(kept, standing)))}
        every = (*(motion.bodies for motion in own), *(motion.alike for motion in own))
        bodies = dict.fromkeys(body for some in every for body in sorted(some))
        return Cause(places, tuple(bodies), tuple(reversed(sets.values())), laws.total() / total,
                     tuple((law, p / total) for law, p in laws.most_common()), or_with=tuple(or_with))

    def _is_replaced(self, run: Run, one: Place, other: Place, places: Mapping[Place, MotionOf]) -> bool:
        """Return whether a hypothesis that is not unlikely has one member that agrees with two in their place."""
        rest = sorted(family.name for family, _ in places)
        rest.remove(one[0].name)
        rest.remove(other[0].name)
        motions = places[one], places[other]
        for key, p in self.p.items():
            if p < ALIKE * self.p[self.best]:
                return False
            if len(key[0]) == len(rest) + 1:
                more = [place for place in self._places[key] if place[0].name not in rest]
                if len(more) == 1 and all(motion.agrees(motion_of(run, more[0])) for motion in motions):
                    return True
        return False

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
        for name in dict.fromkeys(one for one in self.best[0] if one in EFFECTS):
            named = {other: p for other, p in self.instead(name).items() if other in EFFECTS and other != name}
            least = ALIKE * self.of(name)
            alike = tuple(sorted(((other, p) for other, p in named.items() if p > least), key=lambda pair: -pair[1]))
            out.append(Claim(name, self.of(name), self.of(name, *(other for other, _ in alike)), alike))
        return tuple(sorted(out, key=lambda one: -one.together))

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

    def explanations(self, share: float = 0.95) -> tuple[Explanation, ...]:
        """Return hypotheses, the likeliest first, until they have a share together."""
        total = np.cumsum([self.p[key] for key in self.keys])
        return tuple(Explanation(*key, self.p[key]) for key in self.keys[:np.searchsorted(total, share) + 1])
