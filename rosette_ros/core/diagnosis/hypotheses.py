# SPDX-License-Identifier: Apache-2.0
"""The search for hypotheses that explain a run: members join one and two at a time, are exchanged, leave.

Neither of two effects may be worth anything alone, so that a search that adds the best one at a time never meets them:
the best setting of each named family is kept in a pool, of which all pairs are scored together.
"""

import math
from collections.abc import Callable, Collection, Container, Iterator
from functools import cached_property
from itertools import combinations, combinations_with_replacement, islice, product
from operator import attrgetter

import numpy as np

from rosette_ros.core.diagnosis.log_evidence import ENOUGH, NEAR, Evidence, Member, Place, State
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.least_squares import HIDDEN_SHARE
from rosette_ros.core.run.records import Floats, Ints
from rosette_ros.core.sight.bank import WIDTHS, CauseFamily
from rosette_ros.core.sight.linear_explanation import Solution

MOST = 5
"""Families of members of a hypothesis, and exchanges in it, at most."""
BRANCHES = 3
"""Ways in which a hypothesis is grown, by one member and by two each."""
POOL = 48
"""Members of a pool."""
PAIR_SIZES = 2.0**np.array([2, 4, 6])
"""Sizes of each of two members over sigma at which their pair is scored: an estimate."""
COARSE, FINE = 5e-3, 0.3
"""Share of its bracket to which a parameter is refined, at most and times the square root of what it is worth."""

_evidence = attrgetter('log_evidence')
Looked = tuple[float, tuple[Place, ...]]
"""Log evidence of a hypothesis and its members at their best settings."""


class Pool:
    """The best settings of the named families alone, one of each number of columns: what each two are worth together.

    volumes: of the families, as of Member."""

    def __init__(self, evidence: Evidence, volumes: dict[str, float]) -> None:
        best: list[tuple[float, CauseFamily, Setting]] = []
        for key, blocks in evidence.named.items():
            if not blocks.seen.size:
                continue
            group, worth = evidence.bank.groups[key], blocks.log_bf(None, evidence.empty)
            family = group.family[blocks.seen]
            order = np.lexsort((worth, family))
            for k in order[np.diff(family[order], append=-1) != 0]:
                one = evidence.bank.families[family[k]]
                if one.name in volumes:
                    best.append((worth[k] + one.log_prior + volumes[one.name], one,
                                 one.settings[group.setting[blocks.seen[k]]]))
        best.sort(key=lambda each: -each[0])
        self.members = [evidence.member(one, setting, volumes[one.name]) for _, one, setting in best[:POOL]]
        self._log_prior = np.array([one.volume + one.family.log_prior for one in self.members])
        self._rows = np.concatenate([np.zeros((0, evidence.y.size)), *(one.rows for one in self.members)])
        self._gram, self._product = self._rows @ self._rows.T, self._rows @ evidence.y
        width = np.array([len(one.rows) for one in self.members], dtype=int)
        ends, kind = np.cumsum([0, *width]), np.searchsorted(WIDTHS, width)
        self._alike: list[tuple[Ints, Ints]] = []  # members of like width, and their rows, filled up by zeros
        for k in np.unique(kind):
            own = np.flatnonzero(kind == k)
            rows = np.full((len(own), width[own].max()), len(self._rows))
            for place, one in enumerate(own):
                rows[place, :width[one]] = np.arange(ends[one], ends[one + 1])
            self._alike.append((own, rows))
        name = np.array([one.name for one in self.members])
        single = np.array([not one.family.effect.repeatable for one in self.members], dtype=bool)
        self._excluded = (name[:, None] == name) & single & ~np.eye(len(name), dtype=bool)

    def best(self, state: State, without: Collection[str] = ()) -> list[tuple[float, tuple[Member, ...]]]:
        """Return the BRANCHES best ones and twos beside a state, of other names or widths each, and what each gains.

        without: names that they do not have."""
        gains = self._gains(state)
        there = {*without, *(one.name for one in state.members if not one.family.effect.repeatable)}
        out: dict[tuple[tuple[str, int], ...], tuple[float, tuple[Member, ...]]] = {}
        for flat in np.argsort(-gains, axis=None).tolist():
            i, j = divmod(flat, len(gains))
            if len(out) == BRANCHES or not np.isfinite(gains[i, j]):
                break
            members = tuple(self.members[k] for k in dict.fromkeys((i, j)))
            key = tuple(sorted((one.name, len(one.rows)) for one in members))
            if key not in out and there.isdisjoint(one.name for one in members):
                out[key] = float(gains[i, j]), members
        return list(out.values())

    def _gains(self, state: State) -> Floats:
        """Return the log evidence that each two members add to a state, (m, m), each alone on the diagonal."""
        across = self._rows @ state.rows.T
        used = across @ state.inverse
        gram = np.pad(self._gram - used @ across.T, (0, 1))
        product_ = np.pad(self._product - used @ state.product, (0, 1))
        out = np.full((len(self.members),) * 2, -np.inf)
        for (own, first), (others, second) in combinations_with_replacement(self._alike, 2):
            i, j = np.triu_indices(len(own)) if own is others else np.indices((len(own), len(others))).reshape(2, -1)
            rows = np.concatenate([first[i], second[j]], axis=1)
            alone = own[i] == others[j]
            rows[alone, first.shape[1]:] = len(self._rows)
            gain = _pair_log_bf(gram[rows[:, :, None], rows[:, None]], product_[rows], first.shape[1], state)
            out[own[i], others[j]] = gain + self._log_prior[own[i]] + np.where(alone, 0, self._log_prior[others[j]])
        out[self._excluded] = -np.inf
        return out


def _pair_log_bf(gram: Floats, product_: Floats, first: int, state: State) -> Floats:
    """Return the log Bayes factors (b,) of pairs beside a state, each of the two at the best of PAIR_SIZES.

    gram, product_: (b, q, q), (b, q) beside the state; first: columns of the first of each pair."""
    count, q = product_.shape
    best, own = np.full(count, -np.inf), np.arange(q)
    for one, other in product(PAIR_SIZES, PAIR_SIZES):
        size = np.where(own < first, one, other)
        solution = Solution(size[:, None] * gram * size)
        best = np.maximum(best, solution.log_bayes_factor(size * product_, state.left, state.evidence.dof))
    return best


class Search:
    """All hypotheses that were looked at under one noise, the best State of each set of names."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.states: dict[tuple[str, ...], State] = {}
        self.looked: dict[tuple[str, ...], Looked] = {}
        self._offers: dict[tuple[bool, tuple[Place, ...]], list[Member]] = {}
        self._exhausted: set[tuple[Place, ...]] = set()

    @cached_property
    def grown(self) -> State:
        """The State of the largest evidence that is found by adding members to names, and apart, to free courses."""
        empty = self._kept(self.evidence.empty)
        best, growing = {True: empty, False: empty}, [empty]
        while growing:
            some = [child for state in growing for child in self._with_one(state, is_open=False)]
            if growing == [empty]:
                some += [*self._with_one(empty, is_open=True), *self._with_pool(empty, -NEAR), *self._of_a_kind()]
            growing = []
            for is_named, before in best.items():
                own = [one for one in some if one.is_named == is_named and len(set(one.names)) <= MOST]
                child = self.settled(max(own, key=_evidence)) if own else before
                if child.log_evidence > before.log_evidence:
                    best[is_named] = child
                    growing.append(child)
        return max(best.values(), key=_evidence)

    @property
    def grown_of_names(self) -> State:
        """The State of the largest evidence among those on the way to `grown` whose members all have names."""
        self.grown  # noqa: B018 (looks at them)
        return max((one for one in self.states.values() if one.is_named), key=_evidence)

    @cached_property
    def best(self) -> State:
        """The State of the largest evidence that the search finds, by exchanging members of the one that was grown."""
        best, better = self.evidence.empty, self.grown
        while better.log_evidence > best.log_evidence + ENOUGH:
            best = better
            better = self.settled(max((best, *self._exchanged(best)), key=_evidence))
            for names in [one for one, (value, _) in self.looked.items()
                          if one not in self.states and value > better.log_evidence]:
                better = max(better, self.settled(self.state(names)), key=_evidence)
        return max(best, better, key=_evidence)

    @cached_property
    def pool(self) -> Pool:
        """The members that may join two at a time."""
        return Pool(self.evidence, {one.family.name: one.volume for one in self.offers(self.evidence.empty, True)})

    def hopeful(self, most: int) -> list[CauseFamily]:
        """Return all named families, and so many free ones that are worth most alone or beside the best members."""
        worth: dict[str, float] = {}
        for offers in self._offers.values():
            for place, one in enumerate(one for one in offers if one.family.is_free):
                worth[one.family.name] = min(worth.get(one.family.name, np.inf), place)
        free = sorted(worth, key=lambda name: worth[name])[:most]
        return [one for one in self.evidence.bank.families if not one.is_free or one.name in free]

    def state(self, names: tuple[str, ...]) -> State:
        """Return the State of names that were looked at, refined where only its value on the grid is known."""
        if names not in self.states:
            for place, name in enumerate(names):
                if rest := self.states.get(names[:place] + names[place + 1:]):
                    for offer in [one for one in self.offers(rest, True) if one.family.name == name]:
                        self._kept(State(self.evidence, (*rest.members, self.refined(rest, offer))))
        return self.states[names]

    def _kept(self, state: State) -> State:
        names = state.names
        if names not in self.states or state.log_evidence > self.states[names].log_evidence:
            self.states[names], self.looked[names] = state, (state.log_evidence, state.places)
        return state

    def offers(self, state: State, is_open: bool) -> list[Member]:
        """Return what may join a state, best first; what they are worth counts among the hypotheses."""
        key = is_open, state.places
        if key not in self._offers:
            found = [one for one in state.offers(is_open)
                     if one.family.effect.repeatable or one.family.name not in state.names]
            for one in found:
                names, value = tuple(sorted((*state.names, one.family.name))), state.log_evidence + one.gain
                if names not in self.states and value > self.looked.get(names, (-np.inf,))[0]:  # until it is refined
                    self.looked[names] = value, (*state.places, (one.family, one.setting))
            self._offers[key] = found
        return self._offers[key]

    def _with_one(self, state: State, is_open: bool, least: float = -np.inf) -> Iterator[State]:
        """Yield a state with each of the best single members more; least: log evidence that is of use."""
        offers = self.offers(state, is_open)
        for offer in offers[:BRANCHES]:
            near = offers[0].gain - NEAR - 0.5 * max(offers[0].gain, 0)
            if offer.gain > max(near, -NEAR, least - state.log_evidence):
                yield self._kept(State(self.evidence, (*state.members, self.refined(state, offer))))

    def _of_a_kind(self) -> Iterator[State]:
        """Yield what several of one family explain where one does a part: none of them need be among the best alone."""
        for first in self.offers(self.evidence.empty, is_open=False):
            if first.gain > 0 and first.family.effect.repeatable:
                before, state = self.evidence.empty, State(self.evidence, (self.refined(self.evidence.empty, first),))
                while state.log_evidence > before.log_evidence and (more := state.offer(first.family)):
                    before, state = state, State(self.evidence, (*state.members, self.refined(state, more)))
                if len(before.members) > 1:
                    yield self._kept(before)

    def _with_pool(self, state: State, least: float, without: Collection[str] = ()) -> Iterator[State]:
        """Yield a state with each of the best ones and twos of the pool; arguments as of `_with_one` and `best`."""
        for gain, members in self.pool.best(state, without):
            if state.log_evidence + gain > least:
                yield self.settled(State(self.evidence, (*state.members, *members)))

    def _exchanged(self, state: State) -> Iterator[State]:
        """Yield what none to two members less and one or two others in their place make of a state."""
        useful, near = state.log_evidence - NEAR, state.log_evidence - NEAR / 3
        for fewer in (0, 1, 2)[:len(state.members) + 1]:
            some: dict[tuple[str, ...], State] = {}
            for kept in combinations(state.members, len(state.members) - fewer):
                rest = State(self.evidence, kept, is_sized=True) if fewer else state
                some[rest.names] = max(rest, some.get(rest.names, rest), key=_evidence)
            for rest in some.values():  # of events of one kind those that are missed least
                yield self._kept(State(self.evidence, rest.members))
                if rest.places in self._exhausted:
                    continue
                self._exhausted.add(rest.places)
                # what is worth as much as two others need not be so on the grid
                for child in self._with_one(rest, fewer < 2, useful if fewer < 2 else -np.inf):
                    yield self.settled(child) if child.log_evidence > near else child
                yield from self._with_pool(rest, near, set(state.names) - set(rest.names))

    def refined(self, state: State, offer: Member) -> Member:
        """Return what may join a state, what is searched continuously refined beside a state.

        Of a coarse grid from the best place of it and from the next best one that this would not reach."""
        def worth(one: Member) -> float:
            return 2 * float(state.line(one.rows).max())

        reached = offer.family.effect.brackets(self.evidence.run, offer.setting)
        apart = (setting for setting in offer.next if setting.keys() != offer.setting.keys() or any(
            not min(reach) <= setting.number(name) <= max(reach) for name, reach in reached.items() if len(reach)))
        starts = [offer.setting, *islice(apart, 1)]
        return max((refined(offer.at(setting), worth) for setting in starts), key=worth)

    def settled(self, state: State) -> State:
        """Return a state with each member searched again, and refined, beside the others, or left out if better so."""
        place = 0
        while place < len(state.members) > 1:
            one, rest = state.members[place], state.without(place)
            offer = None if one.family.is_free else rest.offer(one.family)
            made = self.refined(rest, (offer or one).at(one.setting))
            if offer:  # somewhere else, or with another choice, it may be better beside these others
                others = [offer.at(setting) for setting in (offer.setting, *_other_choices(made))]
                seen = [each for each in others if each.sensitivity >= HIDDEN_SHARE]
                best = max((made, *seen), key=lambda each: rest.line(each.rows).max())
                if best is not made:
                    made = self.refined(rest, best)
            state = State(self.evidence, (*rest.members[:place], made, *rest.members[place:]))
            if rest.log_evidence > state.log_evidence:
                state = State(self.evidence, rest.members)
            else:
                place += 1
        return self._kept(state)


def _other_choices(member: Member) -> list[Setting]:
    """Return the settings of a member with its choice made otherwise, all else as it is."""
    names = [one.name for one in member.family.effect.searched if one.kind == 'choice' and one.name in member.setting]
    if len(names) != 1:
        return []
    name, = names
    others = {setting[name] for setting in member.family.settings if name in setting} - {member.setting[name]}
    return [Setting({**member.setting, name: value}) for value in sorted(others, key=str)]


def refined(member: Member, worth: Callable[[Member], float], fixed: Container[str] = ()) -> Member:
    """Return a member with its continuous parameters refined, again while several gain by that.

    worth: of a member, twice a log likelihood; fixed: parameters that stay.
    """
    def at(name: str, value: float) -> Member:
        return member.at(Setting({**member.setting, name: float(value)}))

    while True:
        before = worth(member)
        every = member.family.effect.brackets(member.evidence.run, member.setting)
        brackets = {name: bracket for name, bracket in every.items() if name not in fixed}
        for name, bracket in brackets.items():
            def loss(value: float, name: str = name) -> float:
                return -worth(at(name, value))

            if isinstance(bracket, tuple):
                # strong effects want it so exact that what is left of them is no structure
                share = min(COARSE, FINE / max(worth(member), 1.0)**0.5)
                value = _golden_section(loss, *bracket, share)
            elif len(bracket):
                value = min(bracket, key=loss)
            else:
                continue
            member = max(member, at(name, value), key=worth)
        if len(brackets) < 2 or worth(member) <= before + ENOUGH:
            return member


def _golden_section(loss: Callable[[float], float], low: float, high: float, share: float) -> float:
    """Return where a function has a minimum within a bracket, to a share of it; loading scipy's search takes longer."""
    golden, width = (math.sqrt(5) - 1) / 2, share * (high - low)
    places = [high - golden * (high - low), low + golden * (high - low)]
    values = [loss(place) for place in places]
    while high - low > 2 * width:
        if values[0] < values[1]:
            high, place = places[1], places[1] - golden * (places[1] - low)
            places, values = [place, places[0]], [loss(place), values[0]]
        else:
            low, place = places[0], places[0] + golden * (high - places[0])
            places, values = [places[1], place], [values[1], loss(place)]
    return places[values.index(min(values))]
