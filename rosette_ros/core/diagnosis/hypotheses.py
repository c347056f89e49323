# SPDX-License-Identifier: Apache-2.0
"""The search for hypotheses that explain a run: sets of members grown side by side, exchanged, dropped."""

from collections.abc import Callable, Container, Iterator
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy  # which loads `optimize` where it is used: many runs have nothing to refine

from rosette_ros.core.diagnosis.bank import CauseFamily
from rosette_ros.core.diagnosis.log_evidence import NEAR, Cause, Evidence, State, Suggestion
from rosette_ros.core.effects.effect import Setting

MOST = 5
"""Families of members of a hypothesis, and exchanges in it, at most."""
BEAM, BRANCHES = 2, 3
"""Hypotheses that are grown side by side, and how many ways each."""
COARSE, FINE = 5e-3, 0.3
"""Share of its bracket to which a parameter is refined, at most and times the square root of what it is worth."""
ENOUGH = 0.1
"""Log evidence by which an exchange has to be better for another one to be tried."""
AGAIN = 0.05
"""Share by which what parameters are worth has to grow for them to be refined in turn once more."""


class Search:
    """All hypotheses that were looked at under one noise, the best State of each set of names."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.states: dict[tuple[str, ...], State] = {}
        self.values: dict[tuple[str, ...], float] = {}
        self._offers: dict[tuple[tuple[str, Setting], ...], list[Suggestion]] = {}

    @cached_property
    def grown(self) -> State:
        """The State of the largest evidence that is found by adding members."""
        empty = self._kept(self.evidence.empty)
        beam, best = [empty], empty
        while True:
            children: dict[tuple[str, ...], State] = {}
            for state in beam:
                for child in self._children(state, BRANCHES, is_open=not state.members):
                    children[child.names] = max(child, children.get(child.names, child), key=_evidence)
            beam = [self._settled(one) for one in sorted(children.values(), key=_evidence)[:-BEAM - 1:-1]
                    if len(set(one.names)) <= MOST]
            top = max(beam, key=_evidence, default=empty)
            if top.log_evidence <= best.log_evidence:
                break
            best = top
        return best

    @cached_property
    def best(self) -> State:
        """The State of the largest evidence that the search finds, by exchanging members of the one that was grown."""
        best = self.grown
        for _ in range(MOST):
            better = max(self._exchanged(best), key=_evidence, default=best)
            if better.log_evidence <= best.log_evidence + ENOUGH:
                break
            best = better
        return best

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
            for name in names:
                rest = list(names)
                rest.remove(name)
                found = self.states.get(tuple(rest))
                offers = [] if found is None else [one for one in self.offers(found, True) if one.family.name == name]
                if found is not None and offers:
                    self._kept(State(self.evidence, (*found.members, self.refined(found, offers[0]))))
        return self.states[names]

    def _kept(self, state: State) -> State:
        names = state.names
        if names not in self.states or state.log_evidence > self.states[names].log_evidence:
            self.states[names] = state
        self.values[names] = max(self.values.get(names, -np.inf), state.log_evidence)
        return state

    def offers(self, state: State, is_open: bool) -> list[Suggestion]:
        """Return the Suggestions beside a state that may join it; what they are worth counts among the hypotheses."""
        key = (('open', Setting()), *((one.name, one.setting) for one in state.members)) if is_open else (
            *((one.name, one.setting) for one in state.members),)
        if key not in self._offers:
            found = [one for one in state.offers(is_open)
                     if one.family.effect.repeatable or one.family.name not in state.names]
            for one in found:
                names = tuple(sorted((*state.names, one.family.name)))
                self.values[names] = max(self.values.get(names, -np.inf), state.log_evidence + one.gain)
            self._offers[key] = found
        return self._offers[key]

    def _children(self, state: State, most: int, is_open: bool, least: float = -NEAR) -> Iterator[State]:
        offers = self.offers(state, is_open)
        for offer in offers[:most]:
            if offer.gain > max(offers[0].gain - NEAR - 0.5 * max(offers[0].gain, 0), least):
                yield self._kept(State(self.evidence, (*state.members, self.refined(state, offer))))

    def _exchanged(self, state: State) -> Iterator[State]:
        """Yield what one member more, one or two members less, or another in their place make of a state."""
        yield from map(self._settled, self._children(state, BRANCHES, True))
        for fewer in (1, 2)[:len(state.members)]:
            some: dict[tuple[str, ...], State] = {}
            for kept in combinations(state.members, len(state.members) - fewer):
                rest = State(self.evidence, kept)
                some[rest.names] = max(rest, some.get(rest.names, rest), key=_evidence)
            for rest in map(self._kept, some.values()):  # of events of one kind those that are missed least
                yield rest
                for child in self._children(rest, BRANCHES, fewer == 1, -np.inf):
                    near = child.log_evidence > state.log_evidence - NEAR / 3
                    yield self._settled(child) if near else child

    def refined(self, state: State, offer: Suggestion) -> Cause:
        """Return the member of an offer, what is searched continuously refined beside a state."""
        return refined(self.evidence, self.evidence.member(offer.family, offer.setting, offer.volume),
                       lambda one: 2 * float(state.line(one.rows).max()))

    def _settled(self, state: State) -> State:
        """Return a state with every member refined beside the others, where that is better."""
        for place in range(len(state.members) if len(state.members) > 1 else 0):
            one = state.members[place]
            rest = State(self.evidence, state.without(place))
            made = self.refined(rest, Suggestion(0.0, one.family, one.setting, one.volume))
            state = max(state, self._kept(State(self.evidence, (*rest.members[:place], made, *rest.members[place:]))),
                        key=_evidence)
        return state


def refined(evidence: Evidence, member: Cause, worth: Callable[[Cause], float],
            fixed: Container[str] = ()) -> Cause:
    """Return a member with its continuous parameters refined, again while several gain by that.

    worth: of a member, twice a log likelihood; fixed: parameters that stay.
    """
    def at(name: str, value: float) -> Cause:
        return evidence.member(member.family, Setting({**member.setting, name: float(value)}), member.volume)

    while True:
        before = worth(member)
        every = member.family.effect.brackets(evidence.run, member.setting)
        brackets = {name: bracket for name, bracket in every.items() if name not in fixed}
        for name, bracket in brackets.items():
            def loss(value: float, name: str = name) -> float:
                return -worth(at(name, value))

            if isinstance(bracket, tuple):
                # strong effects want it so exact that what is left of them is no structure
                share = min(COARSE, FINE / max(worth(member), 1.0)**0.5)
                value = scipy.optimize.minimize_scalar(loss, bounds=bracket, method='bounded', options={
                    'maxiter': 9 if share == COARSE else 40, 'xatol': share * (bracket[1] - bracket[0])}).x
            elif len(bracket):
                value = min(bracket, key=loss)
            else:
                continue
            better = at(name, value)
            member = better if worth(better) >= worth(member) else member
        if len(brackets) < 2 or worth(member) <= before + AGAIN * abs(before):
            return member


def _evidence(state: State) -> float:
    return state.log_evidence
