# SPDX-License-Identifier: Apache-2.0
"""What moves with what, and by which law: the Causes that the hypotheses of a run agree on."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np

from rosette_ros.core.diagnosis.cause import Cause
from rosette_ros.core.diagnosis.log_evidence import Place
from rosette_ros.core.diagnosis.posterior import Posterior
from rosette_ros.core.effects.free import FREE, PARTS, PLACES, variables
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.sight.limits import ALIKE, LISTED

WAVES = 12
"""Functions of a variable on a line that are asked: slow ones."""

Law = tuple[str, ...]
"""Names of effects, sorted, none of a motion without a name."""
Laws = dict[Law, float]
"""Laws with their probabilities."""


# What a single member says


@lru_cache(maxsize=4096)
def motion_of(run: Run, place: Place) -> Cause:
    """Return what a family at a setting says of what moves with what in a run."""
    family, setting = place
    effect = family.effect
    own = effect.driven_by(setting)
    standing = {one: _standing(run, one) for one in own}

    course = course_of(run, place)
    if len(own) == 1 and not family.is_free and course is not None and np.ptp(course, axis=1).any():
        standing[next(iter(own))] |= {  # a law may be a function of more than its variable is
            name for name, basis in slow_functions(run).items() if _share(course, basis) > ALIKE} - own
    return Cause((place,), tuple(sorted(effect.moved(setting), key=lambda body: [*PARTS, body].index(body))),
                 tuple((one, *sorted(standing[one])) for one in sorted(own)))


def wander_of(run: Run) -> Cause:
    """Return what a frame that wanders says: it moves with time, by no law."""
    return Cause((), ('frame',), (('time', *sorted(_standing(run, 'time'))),))


def _standing(run: Run, name: str) -> set[str]:
    """Return the variables that stand for one."""
    return {a if name == b else b for (a, b), share in _described(run).items()
            if name in (a, b) and a != b and share > ALIKE}


def course_of(run: Run, place: Place) -> Floats | None:
    """Return the functions (k, N) by which a family at a setting moves; None where it moves one ball or place only."""
    family, setting = place
    if family.is_free:
        functions = FREE.course(run, setting)[0]
        return functions if 2 * np.count_nonzero(functions.any(axis=0)) > run.size else None
    factors, = family.effect.factors(run, [setting])
    return None if factors.at is not None else np.asarray(factors.waves[factors.of_setting[0][0]], dtype=float)


@lru_cache(maxsize=2)
def _described(run: Run) -> dict[tuple[str, str], float]:
    """Return the share of the variance of variable b that slow functions of variable a describe, by (a, b)."""
    out = {}
    for name, basis in slow_functions(run).items():
        for other in variables(run):
            circle = np.stack([np.cos(other.values), np.sin(other.values)])
            out[name, other.name] = _share(circle if other.name in PLACES else other.values[None], basis)
    return out


@lru_cache(maxsize=2)
def slow_functions(run: Run) -> dict[str, Floats]:
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


# What all hypotheses say together


class _Group:
    """Members of the best hypothesis that say the same, and what the other hypotheses say of it.

    laws: probability of each law that does it; seen: of each variable with which it may move; moved: of each set of
    bodies that move; apart: of each law by which the same body moves with other variables, or others with the same, by
    the bodies and these variables, None for the same.
    """

    def __init__(self, places: Sequence[Place], said: Mapping[Place, Cause]) -> None:
        self.places = tuple(places)
        self.said = [said[place] for place in places]
        self.laws, self.seen, self.moved = Laws(), dict[str, float](), dict[frozenset[str], float]()
        self.apart: dict[tuple[frozenset[str], tuple[str, ...] | None], Laws] = {}

    def has_name(self, name: str) -> bool:
        return any(family.name == name for family, _ in self.places)

    def agrees(self, other: Cause) -> bool:
        return any(other.agrees(own) for own in self.said)

    def count(self, mine: Sequence[Cause], p: float) -> None:
        """Count a hypothesis in which some members say what this group says."""
        _add(self.laws, _law(mine), p)
        bodies = frozenset(body for one in mine for body in one.bodies if body not in one.alike)
        self.moved[bodies] = self.moved.get(bodies, 0.0) + p
        for name in frozenset().union(*(one.may_be for one in mine)):
            self.seen[name] = self.seen.get(name, 0.0) + p

    def count_apart(self, others: list[Cause], p: float) -> None:
        """Count a hypothesis in which the same body moves with something else, or else another one with the same; what
        does is taken from the others."""
        for is_it in (self._moves_same, self._moves_with_same):
            for place, other in [(k, one) for k, one in enumerate(others) if is_it(one)][:1]:
                del others[place]
                bodies = frozenset(body for body in other.bodies if body not in other.alike)
                variables = tuple(sorted(other.own)) if is_it == self._moves_same else None
                _add(self.apart.setdefault((bodies, variables), {}), _law([other]), p)
                return

    def _moves_same(self, other: Cause) -> bool:
        return any(not set(own.bodies).isdisjoint(other.bodies) for own in self.said)

    def _moves_with_same(self, other: Cause) -> bool:
        return any(own.own and own.moves_with(other) for own in self.said)

    def _bodies(self) -> list[str]:
        """Return the bodies of the best hypothesis, and the likeliest others until one of all these moves surely."""
        out = list(dict.fromkeys(body for one in self.said for body in one.bodies if body not in one.alike))
        left = {bodies: p for bodies, p in self.moved.items() if bodies.isdisjoint(out)}
        while sum(left.values()) > LISTED * sum(self.moved.values()):
            worth: dict[str, float] = {}
            for bodies, p in left.items():
                for body in bodies:
                    worth[body] = worth.get(body, 0.0) + p
            out.append(max(sorted(worth), key=lambda body: worth[body]))
            left = {bodies: p for bodies, p in left.items() if out[-1] not in bodies}
        return out

    def cause(self, total: float, plainest: Sequence[str]) -> Cause:
        """Return the Cause; total: probability of all hypotheses that were counted; plainest: variables that are
        recorded, in the order in which they are said."""
        laws, or_with, elsewhere = self.laws.copy(), list[tuple[str, ...]](), list[str]()
        apart = sorted(((sum(some.values()), sorted(bodies), variables)
                        for (bodies, variables), some in self.apart.items()), key=lambda one: -one[0])
        left = sum(p for p, _, _ in apart)
        moved = sum(laws.values()) + left
        for p, bodies, other_variables in apart:
            if left > LISTED * moved:
                if other_variables is not None and other_variables not in or_with:
                    or_with.append(other_variables)
                elsewhere += bodies
                left -= p
                for law, share in self.apart[frozenset(bodies), other_variables].items():
                    _add(laws, law, share)

        # of several variables those that nearly every explanation has, at least the likeliest
        own = {one: self.seen.get(one, 0.0) for one in frozenset().union(*(some.own for some in self.said))}
        least = min((1 - LISTED) * max(self.seen.values(), default=0.0), max(own.values(), default=0.0))
        sets: dict[str, set[str]] = {}
        for one in [*plainest, *sorted(own.keys() - {*plainest})]:
            if own.get(one, -1.0) >= least:
                standing = {one}.union(*(some.standing(one) for some in self.said))
                same = next((first for first, some in sets.items() if one in some or first in standing), one)
                sets.setdefault(same, set()).update(standing)

        moving = dict.fromkeys([*self._bodies(), *elsewhere])
        parts, alike = {PARTS.get(body) for body in moving}, list[str]()
        for body in sorted(frozenset().union(*(one.alike for one in self.said))):
            if PARTS[body] not in parts:
                parts.add(PARTS[body])
                alike.append(body)
        likeliest = tuple((law, p / total) for law, p in sorted(laws.items(), key=lambda pair: -pair[1]))
        probability = min(sum(laws.values()) / total, 1.0)  # a sum of all may be rounded up
        driving = tuple((first, *sorted(some - {first})) for first, some in sets.items())
        return Cause(self.places, (*moving, *alike), driving, probability, likeliest, or_with=tuple(or_with),
                     alike=frozenset(alike))


def causes_of(posterior: Posterior, run: Run, said: Mapping[Place, Cause]) -> tuple[Cause, ...]:
    """Return what the members of the best hypothesis say; two of one law that move the same with the same, and two
    that another one replaces, are a Cause together.

    said: what each of these members may say in the run."""
    together = [[place] for place in said]
    for one, other in combinations(said, 2):
        first, second = (next(some for some in together if place in some) for place in (one, other))
        if first is not second and ((one[0].name == other[0].name and said[one].agrees(said[other]))
                                    or _is_replaced(posterior, run, one, other, said)):
            first += second
            together.remove(second)

    groups = [_Group(places, said) for places in together]
    for key in posterior.near if groups else ():
        p = posterior.p[key]
        every = [motion_of(run, place) for place in posterior.places(key)] + [wander_of(run)] * ('wander' in key[1])
        assigned = _assigned(every, groups)
        taken = {id(one) for mine in assigned for one in mine}
        others = [one for one in every if id(one) not in taken]
        for group, mine in zip(groups, assigned):
            if mine:
                group.count(mine, p)
            else:
                group.count_apart(others, p)
    total = sum(posterior.p[key] for key in posterior.near)
    return tuple(group.cause(total, [*slow_functions(run)]) for group in groups)


def _assigned(every: Sequence[Cause], groups: Sequence[_Group]) -> list[list[Cause]]:
    """Return which members of a hypothesis say what each group says: those of its names first."""
    out: list[list[Cause]] = [[] for _ in groups]
    agreeing = [[k for k, group in enumerate(groups) if group.agrees(one)] for one in every]
    for is_name in (True, False):
        for one, ks in zip(every, agreeing):
            own = [k for k in ks if is_name == any(groups[k].has_name(family.name) for family, _ in one.places)]
            if own:
                out[min(own, key=lambda k: len(out[k]))].append(one)
            if is_name and own:
                ks.clear()
    return out


def _add(laws: Laws, law: Law, p: float) -> None:
    laws[law] = laws.get(law, 0.0) + p


def _law(some: Sequence[Cause]) -> Law:
    return Cause(tuple(place for one in some for place in one.places), (), ()).names


def _is_replaced(posterior: Posterior, run: Run, one: Place, other: Place, said: Mapping[Place, Cause]) -> bool:
    """Return whether a hypothesis that is not unlikely has one member that agrees with two in their place."""
    rest = sorted(family.name for family, _ in said)
    rest.remove(one[0].name)
    rest.remove(other[0].name)
    for key, p in posterior.p.items():
        if p < LISTED * posterior.p[posterior.best]:
            return False
        if len(key[0]) == len(rest) + 1:
            more = [place for place in posterior.places(key) if place[0].name not in rest]
            if len(more) == 1 and all(said[place].agrees(motion_of(run, more[0])) for place in (one, other)):
                return True
    return False
