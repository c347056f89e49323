# SPDX-License-Identifier: Apache-2.0
"""The search: which named effects, at which nonlinear parameters, explain what a model leaves.

Sets of effects are grown side by side (beam search), refitted jointly with the model at every step, and judged by

    score = nu ln(RSS_0 / RSS) - sum over effects of (k (1 + ln(A / k)) + 2 ln(chances * effects)),

twice the logarithm of an approximate Bayes factor. k amplitudes with A the square of their visible part over sigma^2
have a normal prior whose width is the one that suits them best (empirical Bayes), so that one amplitude costs about as
much as in the Bayesian information criterion and many small ones, such as the form of every ball, do not cost more than
they must. The search costs the number of separate chances that an effect had; small runs pay nu / (nu - k) times as
much. The score is free of a stated sigma: a wrong repeatability cannot make a cause out of noise.
"""

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy  # which loads `optimize` where it is used: 0.08 s, and many runs have nothing to refine

from rosette_ros.core.diagnosis.candidates import NO_RESIDUAL, Family, families, gains, whiten
from rosette_ros.core.diagnosis.projection import SMALL, Projection
from rosette_ros.core.diagnosis.scores import cost, grouped, products_by_group, search_cost
from rosette_ros.core.effects.effect import Bracket, Effect, Setting
from rosette_ros.core.effects.free_forms import SEARCHED_FORMS, FreeForm
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.model.least_squares import JointSpace
from rosette_ros.core.records import Floats, Run

MOST_EFFECTS = 5
BEAM = 4
BRANCHES = 7
MANY_ROWS = 4
"""An effect of so many amplitudes is compared with several simpler ones in its place."""
TOGETHER = 2.0
"""So many times as much as the best effect alone may each of several more, at most, raise the score together."""
SWAPPED = 30.0
"""What exchanging effects adds to a score at most."""
FINE = 0.3
"""Share of its bracket, times the square root of the gain, to which a parameter is refined."""
AGAIN = 1.05
"""Factor by which what parameters explain has to grow for them to be refined in turn once more."""
AT_ONCE = 100
"""Runs of noise that are looked at together: products with all candidates are kept for each."""
HOPELESS = -5.0
"""Score gain on the grid below which no refinement of continuous parameters can make it pay."""


@dataclass(frozen=True, eq=False)
class Member:
    """One effect at one setting: its rows freed of the model, (k, 3 N), orthonormal.

    instead: names of effects that it replaces, as they have the wrong shape or, where they are `alike`, as one shape
    is simpler than two that explain no less; beneath: whether it is smaller than the linear model can tell beside
    the others, so that it has no name.
    """

    effect: Effect
    setting: Setting
    rows: Floats
    chances: float
    share: float
    instead: str = ''
    alike: bool = False
    beneath: bool = False

    @property
    def name(self) -> str:
        """The name of the effect."""
        return self.effect.name

    @property
    def named(self) -> bool:
        """Whether it is a physical effect of the library."""
        return not isinstance(self.effect, FreeForm) and not self.beneath


@dataclass(frozen=True, eq=False)
class Selection:
    """A set of members fitted jointly: residual (3 N,), its square sum, orthonormal rows, score."""

    members: tuple[Member, ...]
    rows: Floats
    residual: Floats
    rss: float
    score: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members."""
        return tuple(member.name for member in self.members)

    def without(self, place: int) -> tuple[Member, ...]:
        """Return the members but one."""
        return self.members[:place] + self.members[place + 1:]


class Offer(NamedTuple):
    """The best block of a family beside a selection, and the gain of the score by adding it."""

    score: float
    family: Family
    block: int

    @property
    def setting(self) -> Setting:
        """The setting of the block."""
        return self.family.settings[self.block]


class Problem:
    """What is searched: a run, the model's projection, the residual in sigma, and the families of effects."""

    def __init__(self, run: Run, space: JointSpace, residual: Floats, dof: int, effects: Sequence[Effect] | None = None,
                 unnamed: Sequence[FreeForm] = SEARCHED_FORMS, like: Sequence[Family] = (),
                 fixed: Setting | None = None) -> None:
        """Build the families once; space, residual (N, 3), m, and its degrees of freedom: of the model.

        effects: those that the cell can have, if none are given; like: families of the same run under another noise,
        whose raw columns are used again; fixed: searched parameters that are held at a value.
        """
        self.run, self.dof, self._fixed = run, dof, fixed or Setting()
        effects = tuple(effects_of(run).values()) if effects is None else effects
        self.project = Projection(space, run.size)
        self._made: dict[tuple[str, Setting, float], Member | None] = {}
        self._scale_to(residual)
        self.families = families(run, (*effects, *unnamed), self.project, like=like, fixed=fixed)
        self._groups = grouped(self.families)

    def _scale_to(self, residual: Floats) -> None:
        self.scale = float(np.sqrt(np.sum(residual**2) / self.dof)) or 1.0
        self.residual = residual.reshape(-1) / self.scale

    def on(self, residual: Floats) -> 'Problem':
        """Return the same problem for another residual (N, 3), m; the families are shared."""
        other = copy.copy(self)
        for made in ('empty', '_offers_to_none'):
            other.__dict__.pop(made, None)
        other._scale_to(residual)
        return other

    @cached_property
    def empty(self) -> Selection:
        """The selection of nothing."""
        rss = max(float(self.residual @ self.residual), NO_RESIDUAL)
        return Selection((), np.zeros((0, self.residual.size)), self.residual, rss, 0.0)

    def reachable(self, score: float, more: float) -> float:
        """Return nu ln(RSS / (RSS - more F)): what so many effects reach, each of the fall F of one of a score alone.

        The last one of several of one size takes nearly all that is left."""
        share = -more * np.expm1(-max(score, 0.0) / self.dof)
        return -self.dof * float(np.log1p(-share)) if share < 1 else np.inf

    def member(self, effect: Effect, setting: Setting, chances: float) -> Member | None:
        """Return an effect at a setting as a Member, or None where it cannot be seen; small runs keep what was made."""
        key = effect.name, setting, chances
        if key in self._made:
            return self._made[key]
        block = np.moveaxis(effect.columns(self.run, setting), -1, 0)
        rows, _, share = whiten(block[None], self.project)
        rows = rows[0][np.any(rows[0] != 0, axis=1)]
        made = Member(effect, setting, rows, chances, float(share[0])) if len(rows) else None
        if 3 * self.run.size <= SMALL:
            self._made[key] = made
        return made

    def select(self, members: Sequence[Member]) -> Selection:
        """Return the joint Selection of members."""
        members = tuple(members)
        if not members:
            return self.empty
        stacked = np.concatenate([member.rows for member in members])
        value, vector = np.linalg.eigh(stacked @ stacked.T)
        keep = value > 1e-3
        rows = (vector[:, keep] / np.sqrt(value[keep])).T @ stacked
        residual = self.residual - (rows @ self.residual) @ rows
        residual = residual - (rows @ residual) @ rows
        rss = max(float(residual @ residual), NO_RESIDUAL)
        coefficients = vector[:, keep] @ ((vector[:, keep].T @ (stacked @ self.residual)) / value[keep])
        spent, start = 0.0, 0
        for member in members:
            stop = start + len(member.rows)
            energy = float(np.sum(coefficients[start:stop]**2)) * self.dof / rss
            spent += float(cost(energy, stop - start)) + search_cost(member.effect, member.chances)
            start = stop
        score = self.dof * np.log(self.empty.rss / rss) - spent * self.dof / self._left(rows, members)
        return Selection(members, rows, residual, rss, float(score))

    def _left(self, rows: Floats, members: Sequence[Member]) -> int:
        """Return the degrees of freedom that members and their orthonormal rows leave, at least one."""
        return max(self.dof - len(rows) - searched_count(members), 1)

    def offers(self, selections: Sequence[Selection], names: Sequence[str] | None = None,
               allow_repeats: bool = False) -> list[list[Offer]]:
        """Return, for each selection, the Offers of all families, best first.

        names: of the effects to look at, None for all; allow_repeats: offer effects that are in the selection already.
        """
        if names is None and len(selections) == 1 and selections[0] is self.empty:
            return [list(self._offers_to_none)]
        return self._offers(selections, names, allow_repeats)

    @cached_property
    def _offers_to_none(self) -> list[Offer]:
        """The offers beside nothing, which are asked for several times."""
        return self._offers([self.empty], None, True)[0]

    def _offers(self, selections: Sequence[Selection], names: Sequence[str] | None,
                allow_repeats: bool) -> list[list[Offer]]:
        stacked = np.concatenate([np.vstack([s.residual[None], s.rows]) for s in selections])
        stops = np.cumsum([1 + len(s.rows) for s in selections]).tolist()
        offers: list[list[Offer]] = [[] for _ in selections]
        groups = self._groups if names is None else grouped(
            [family for family in self.families if family.name in names])
        for group, products in products_by_group(groups, stacked, self.project):
            for selection, start, stop, found in zip(selections, [0, *stops], stops, offers):
                part = products[..., start:stop]
                score, block = group.best(gains(part[..., :1], part[..., 1:])[:, 0], selection.rss,
                                          self._left(selection.rows, selection.members))
                found += [Offer(float(one), family, int(place))
                          for one, family, place in zip(score, group.families, block)
                          if family.effect.repeatable or allow_repeats or family.name not in selection.names]
        return [sorted(found, key=lambda offer: -offer.score) for found in offers]

    def refine(self, member: Member, others: Selection) -> Member:
        """Return a member with its continuous parameters refined beside others, again while several gain by that."""
        while True:
            before, brackets = _gain(member, others), member.effect.brackets(self.run, member.setting)
            brackets = {name: bracket for name, bracket in brackets.items() if name not in self._fixed}
            for name, bracket in brackets.items():
                better = self.member(member.effect, self._best_value(member, others, name, bracket), member.chances)
                if better and _gain(better, others) >= _gain(member, others):
                    member = better
            if len(brackets) < 2 or _gain(member, others) <= AGAIN * before:
                return member

    def _best_value(self, member: Member, others: Selection, name: str, bracket: Bracket) -> Setting:
        def loss(value: float) -> float:
            tried = self.member(member.effect, Setting({**member.setting, name: float(value)}), member.chances)
            return -_gain(tried, others) if tried else 0.0

        best: float | str = member.setting[name]
        if isinstance(bracket, tuple):
            # strong effects want it so exact that what is left of them is no structure
            share = min(5e-3, FINE / max(_gain(member, others), 1.0)**0.5)
            best = scipy.optimize.minimize_scalar(loss, bounds=bracket, method='bounded', options={
                'maxiter': 9 if share == 5e-3 else 40, 'xatol': share * (bracket[1] - bracket[0])}).x
        else:
            best = min(bracket, key=loss, default=best)
        return Setting({**member.setting, name: float(best)})

    def grow(self, needed: float = -np.inf) -> Selection:
        """Return the best Selection that the beam search finds; empty where nothing pays.

        needed: score below which none is of use: the search ends where it cannot be reached.

        An unnamed term, or an effect of many amplitudes, may stand for several simpler effects that no exchange of one
        for one can find: each such member is compared with a search of its own that does without it, and an unnamed one
        with a search from the beginning.
        """
        best = self._beam(self.empty, needed=needed)
        if best.score < needed - SWAPPED:
            return best
        best = self.swap(best)
        for _ in range(2):
            better = best
            for place, member in enumerate(best.members):
                if member.named and len(member.rows) < MANY_ROWS:
                    continue
                starts = [self.select(best.without(place))]
                starts += [] if member.named or not starts[0].members else [self.empty]
                better = max(better, *(self._beam(start, member.name) for start in starts), key=lambda s: s.score)
            if better is best:
                return best
            best = self.swap(better)
        return best

    def _beam(self, start: Selection, without: str = '', needed: float = -np.inf) -> Selection:
        """Return the best Selection from `start` on; without: an effect to be left out, and all unnamed terms."""
        beam, best = [start], start
        for left in range(MOST_EFFECTS - len(start.members), 0, -1):
            children: dict[frozenset[object], Selection] = {}
            every = self.offers(beam)
            most = max((offers[0].score for offers in every if offers), default=0.0)
            if best.score and best.score + self.reachable(most, TOGETHER * left) < needed:
                break
            for selection, offers in zip(beam, every):
                if without:
                    offers = [offer for offer in offers if offer.family.name != without
                              and not isinstance(offer.family.effect, FreeForm)]
                for offer in offers[:BRANCHES]:
                    if offer.score < HOPELESS:
                        break
                    child = self.child(selection, offer)
                    if child is not None:
                        children.setdefault(_key(child), child)
            ranked = sorted(children.values(), key=lambda child: -child.score)
            beam = [self.settle(child) for child in ranked[:BEAM]]
            if not beam:
                break
            top = max(beam, key=lambda child: child.score)
            if top.score <= best.score and not without:
                break
            best = max(best, top, key=lambda selection: selection.score)
        return best

    def child(self, selection: Selection, offer: Offer, refined: bool = True) -> Selection | None:
        """Return the selection with an offer taken, None where it cannot be seen."""
        member = self.member(offer.family.effect, offer.setting, offer.family.chances)
        if member is None:
            return None
        return self.select((*selection.members, self.refine(member, selection) if refined else member))

    def settle(self, selection: Selection) -> Selection:
        """Return the selection with every member's continuous parameters refined beside the rest."""
        if len(selection.members) < 2:
            return selection
        for place in range(len(selection.members)):
            refined = self.refine(selection.members[place], self.select(selection.without(place)))
            tried = self.select((*selection.members[:place], refined, *selection.members[place + 1:]))
            selection = tried if tried.score >= selection.score else selection
        return selection

    def swap(self, selection: Selection) -> Selection:
        """Return the selection after exchanging or dropping members, one or two of more, while that helps."""
        for _ in range(4):
            best, members = selection, selection.members
            fewer = range(max(len(members) - 2, min(len(members) - 1, 1)), len(members)) if members else ()
            rests = [self.select(kept) for count in fewer for kept in itertools.combinations(members, count)]
            for rest, offers in zip(rests, self.offers(rests) if rests else []):
                best = max(best, rest, key=lambda each: each.score)
                for offer in offers[:3]:
                    child = self.child(rest, offer) if offer.score > HOPELESS else None
                    if child is not None and child.score > best.score:
                        best = self.settle(child)
            if best.score <= selection.score + 1e-9:
                return selection
            selection = best
        return selection

    def polish(self, selection: Selection) -> Selection:
        """Return the selection with all that is searched found again beside the rest, until nothing moves.

        Each is searched on the whole grid and then refined, so that a moment may be any between two readings.
        """
        for _ in range(4):
            before = selection
            for place, member in enumerate(selection.members):
                if not member.effect.searched:
                    continue
                rest = self.select(selection.without(place))
                offers = self.offers([rest], (member.name,), allow_repeats=True)[0]
                tried = [self.child(rest, offer) for offer in offers[:2]]
                tried.append(self.select((*rest.members, self.refine(member, rest))))
                best = max((one for one in tried if one is not None), key=lambda one: one.score)
                if best.score > selection.score + 1e-6:
                    moved = replace(best.members[-1], instead=member.instead, alike=member.alike,
                                    beneath=member.beneath)
                    selection = self.select((*rest.members[:place], moved, *rest.members[place:]))
            if selection is before:
                break
        return selection

    def rivals(self, rest: Selection) -> list[tuple[Member, float, float]]:
        """Return the best Member of each effect beside `rest`, its score gain, and that before refining, best first."""
        best: dict[str, Offer] = {}
        for offer in self.offers([rest])[0]:
            best.setdefault(offer.family.name, offer)
        out = []
        for offer in best.values():
            child = self.child(rest, offer, refined=offer.score > HOPELESS)
            if child is not None:
                out.append((child.members[-1], child.score - rest.score, offer.score))
        return sorted(out, key=lambda rival: -rival[1])

    def null_scores(self, noise: Floats) -> Floats:
        """Return the best score of any effect in runs of pure noise, (m,).

        The noise (m, N, 3), in white coordinates, goes through the same projection and the same families; a share of
        about a tenth of the library's score is not refined, alike for noise and data.
        """
        named = grouped([family for family in self.families if not isinstance(family.effect, FreeForm)])
        left = self.project.free(noise).reshape(len(noise), -1)
        rss, best = np.sum(left**2, axis=1), np.full(len(left), -np.inf)
        for start in range(0, len(left), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            for group, products in products_by_group(named, left[some], self.project):
                best[some] = np.maximum(best[some], group.best_of_all(gains(products), rss[some], self.dof))
        return best


def searched_count(members: Sequence[Member]) -> int:
    """Return how many numbers of members are searched; choices do not count."""
    return sum(parameter.kind != 'choice' for member in members for parameter in member.effect.searched)


def _gain(member: Member, others: Selection) -> float:
    return gain_and_rank(member, others)[0]


def gain_and_rank(member: Member, others: Selection) -> tuple[float, int]:
    """Return the fall of the square sum when a member joins a selection, and how many directions it adds."""
    x = member.rows @ others.rows.T
    y = member.rows @ others.residual
    if len(y) == 1:
        left = float(1 + 1e-9 - x[0] @ x[0])
        return (float(y[0]**2) / left, 1) if left > 1e-3 else (0.0, 0)
    gram = np.eye(len(y)) * (1 + 1e-9) - x @ x.T
    value, vector = np.linalg.eigh(gram)
    keep = value > 1e-3
    return float(np.sum((vector[:, keep].T @ y)**2 / value[keep])), int(keep.sum())


def _key(selection: Selection) -> frozenset[object]:
    return frozenset((m.name, *sorted((k, v) for k, v in m.setting.items() if not isinstance(v, float)))
                     for m in selection.members)

