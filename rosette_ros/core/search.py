# SPDX-License-Identifier: Apache-2.0
"""The search: which named effects, at which nonlinear parameters, explain what a model leaves.

Sets of effects are grown side by side (beam search), refitted jointly with the model at every step,
and judged by

    score = nu ln(RSS_0 / RSS) - sum over effects of (k (1 + ln(A / k)) + 2 ln(chances * effects)),

twice the logarithm of an approximate Bayes factor. k amplitudes with A the square of their visible
part over sigma^2 have a normal prior whose width is the one that suits them best (empirical Bayes),
so that one amplitude costs about as much as in the Bayesian information criterion and many small
ones, such as the form of every ball, do not cost more than they must. The search costs the number
of separate chances that an effect had; small runs pay nu / (nu - k) times as much. The score is free
of a stated sigma: a wrong repeatability
cannot make a cause out of noise.
"""

import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from rosette_ros.core.atoms import Family, Projection, families, gains, products_of, whiten
from rosette_ros.core.effects.contract import Effect, Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.structure import STRUCTURES, Structure

STRUCTURE_PRIOR = 10.0
"""A shape without a physical name must beat named effects by this score."""
REPEATABLE = ('outlier', 'ball_slip', 'ball_form', 'frame_cycle', 'asynchronous_motion')
"""Effects that can be present more than once."""
MOST_EFFECTS = 5
BEAM = 4
BRANCHES = 7
MANY_ROWS = 4
"""An effect of so many amplitudes is held against several simpler ones in its place."""
HOPELESS = -5.0
"""Score gain on the grid below which no refinement of continuous parameters can make it pay."""


@dataclass(frozen=True, eq=False)
class Member:
    """One effect at one setting: its rows freed of the model, (k, 3 N), orthonormal."""

    effect: Effect
    setting: Setting
    rows: np.ndarray
    chances: float
    share: float

    @property
    def name(self):
        """The name of the effect."""
        return self.effect.name

    @property
    def named(self):
        """Whether it is a physical effect of the library."""
        return not isinstance(self.effect, Structure)


@dataclass(frozen=True, eq=False)
class Selection:
    """A set of members fitted jointly: residual (3 N,), its square sum, orthonormal rows, score."""

    members: tuple[Member, ...]
    rows: np.ndarray
    residual: np.ndarray
    rss: float
    score: float

    @property
    def names(self):
        """Names of the members."""
        return tuple(member.name for member in self.members)

    def without(self, place):
        """Return the members but one."""
        return self.members[:place] + self.members[place + 1:]


class Problem:
    """What is searched: a run, the model's projection and residual, and the families of effects.

    space: of the model, a JointSpace; residual: (N, 3), m; dof: its degrees of freedom.
    """

    def __init__(self, run, space, residual, dof, effects=None, structures=STRUCTURES):
        """Build the families once; see the class."""
        self.run, self.dof = run, dof
        self.project = project = Projection(space, run.size)
        self.scale = float(np.sqrt(np.sum(residual**2) / dof)) or 1.0
        self.residual = residual.reshape(-1) / self.scale
        effects = tuple(EFFECTS.values()) if effects is None else tuple(effects)
        self.families = families(run, (*effects, *structures), project)

    def on(self, residual):
        """Return the same problem for another residual (N, 3), m; the families are shared."""
        other = copy.copy(self)
        other.__dict__.pop('empty', None)
        other.scale = float(np.sqrt(np.sum(residual**2) / self.dof)) or 1.0
        other.residual = residual.reshape(-1) / other.scale
        return other

    @cached_property
    def empty(self):
        """The selection of nothing."""
        rss = float(self.residual @ self.residual)
        return Selection((), np.zeros((0, self.residual.size)), self.residual, rss, 0.0)

    def member(self, effect, setting, chances):
        """Return an effect at a setting as a Member, or None where it cannot be seen."""
        block = np.moveaxis(effect.columns(self.run, setting), -1, 0)
        rows, _, share = whiten(block[None], self.project)
        rows = rows[0][np.any(rows[0] != 0, axis=1)]
        return Member(effect, setting, rows, chances, float(share[0])) if len(rows) else None

    def select(self, members):
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
        rss = max(float(residual @ residual), 1e-300)
        coefficients = vector[:, keep] @ ((vector[:, keep].T @ (stacked @ self.residual)) / value[keep])
        spent, start = 0.0, 0
        for member in members:
            stop = start + len(member.rows)
            energy = float(np.sum(coefficients[start:stop]**2)) * self.dof / rss
            spent += cost(energy, stop - start) + search_cost(member.effect, member.chances)
            start = stop
        free = self.left(len(rows), members)
        score = self.dof * np.log(self.empty.rss / rss) - spent * self.dof / free
        return Selection(members, rows, residual, rss, float(score))

    def left(self, rank, members):
        """Return the degrees of freedom that members of a rank leave, at least one."""
        searched = sum(parameter.kind != 'choice' for member in members
                       for parameter in member.effect.searched)
        return max(self.dof - rank - searched, 1)

    def offers(self, selections, names=None, allow_repeats=False):
        """Return, for each selection, (score gain, family, block) of each family's best block.

        names: of the effects to look at, None for all; allow_repeats: offer effects that are in the
        selection already.
        """
        stacked = np.concatenate([np.vstack([s.residual[None], s.rows]) for s in selections])
        offers = [[] for _ in selections]
        wanted = [family for family in self.families if names is None or family.name in names]
        for family, products in products_of(wanted, stacked):
            start = 0
            for selection, found in zip(selections, offers):
                stop = start + 1 + len(selection.rows)
                part = products[..., start:stop]
                start = stop
                if (family.name in selection.names and family.name not in REPEATABLE
                        and not allow_repeats):
                    continue
                gain = gains(part[..., :1], part[..., 1:])
                score, best = self.best_scores(family, selection.rss, gain,
                                               self.left(len(selection.rows), selection.members))
                found.append((float(score[0]), family, int(best[0])))
        return [sorted(found, key=lambda offer: -offer[0]) for found in offers]

    def best_scores(self, family, rss, gain, dof):
        """Return the best score gain of a family's blocks, (m,), and its block, (m,).

        rss: square sums, (m,) or one; gain: (blocks, m), their fall; dof: degrees of freedom of rss.
        Of blocks of one rank the one with the largest gain has the best score.
        """
        columns = np.arange(gain.shape[1])
        best, block = np.full(gain.shape[1], -np.inf), np.zeros(gain.shape[1], dtype=int)
        for rank, places in family.by_rank:
            largest = places[np.argmax(gain[places], axis=0)]
            fall = gain[largest, columns].astype(float)
            left = np.maximum(rss - fall, 1e-12 * rss)
            score = (dof * np.log(rss / left) - cost(fall * dof / left, rank)
                     - search_cost(family.effect, family.chances))
            block = np.where(score > best, largest, block)
            best = np.maximum(score, best)
        return best, block

    def refine(self, member, others, chances, brackets=None):
        """Return a member with its continuous parameters at their best beside the others' rows.

        brackets: where to look for each parameter; the effect's own if None.
        """
        if brackets is None:
            brackets = member.effect.brackets(self.run, member.setting)
        for name, bracket in brackets.items():
            setting = self._best_value(member, others, name, bracket, chances)
            better = self.member(member.effect, setting, chances)
            if better and _gain(better, others) >= _gain(member, others):
                member = better
        return member

    def _best_value(self, member, others, name, bracket, chances):
        def loss(value):
            tried = self.member(member.effect, Setting({**member.setting, name: float(value)}),
                                chances)
            return -_gain(tried, others) if tried else 0.0

        if isinstance(bracket, tuple):
            best = minimize_scalar(loss, bounds=bracket, method='bounded',
                                   options={'maxiter': 9, 'xatol': 5e-3 * (bracket[1] - bracket[0])}).x
        else:
            best = min(bracket, key=loss, default=member.setting[name])
        return Setting({**member.setting, name: float(best)})

    def grow(self):
        """Return the best Selection that the beam search finds; empty where nothing pays.

        A shape without a name, or an effect of many amplitudes, may stand for several simpler effects
        that no exchange of one for one can find: each such member is held against a search of its own
        that does without it.
        """
        best = self.swap(self._beam(self.empty))
        for _ in range(2):
            better = best
            for place, member in enumerate(best.members):
                if member.named and len(member.rows) < MANY_ROWS:
                    continue
                rest = self.select(best.without(place))
                better = max(better, self._beam(rest, member.name), key=lambda s: s.score)
            if better is best:
                return best
            best = self.swap(better)
        return best

    def _beam(self, start, without=None):
        """Return the best Selection from `start` on; without: an effect to be left out, and all shapes
        that have no name."""
        beam, best = [start], start
        for _ in range(MOST_EFFECTS - len(start.members)):
            children = {}
            for selection, offers in zip(beam, self.offers(beam)):
                if without:
                    offers = [offer for offer in offers if offer[1].name != without
                              and not isinstance(offer[1].effect, Structure)]
                for score, family, block in offers[:BRANCHES]:
                    if score < HOPELESS:
                        break
                    child = self._child(selection, family, block)
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

    def _child(self, selection, family, block, refined=True):
        member = self.member(family.effect, family.settings[block], family.chances)
        if member is None:
            return None
        if refined:
            member = self.refine(member, selection, family.chances)
        return self.select((*selection.members, member))

    def settle(self, selection):
        """Return the selection with every member's continuous parameters refined beside the rest."""
        if len(selection.members) < 2:
            return selection
        for place in range(len(selection.members)):
            others = self.select(selection.without(place))
            member = selection.members[place]
            refined = self.refine(member, others, member.effect.independent_settings(self.run))
            tried = self.select((*selection.members[:place], refined,
                                 *selection.members[place + 1:]))
            selection = tried if tried.score >= selection.score else selection
        return selection

    def swap(self, selection):
        """Return the selection after exchanging or dropping members while that helps."""
        for _ in range(4):
            better = self._swap_once(selection)
            if better.score <= selection.score + 1e-9:
                return selection
            selection = better
        return selection

    def _swap_once(self, selection):
        best = selection
        rests = [self.select(selection.without(k)) for k in range(len(selection.members))]
        if not rests:
            return best
        for rest, offers in zip(rests, self.offers(rests)):
            best = max(best, rest, key=lambda s: s.score)
            for score, family, block in offers[:3]:
                child = self._child(rest, family, block) if score > HOPELESS else None
                if child is not None and child.score > best.score:
                    best = self.settle(child)
        return best

    def rivals(self, rest):
        """Return the best Member of each effect beside those of `rest`, best first.

        Each comes with its score gain and its score gain before refinement, as noise is scored.
        """
        best = {}
        for score, family, block in self.offers([rest])[0]:
            best.setdefault(family.name, (score, family, block))
        out = []
        for score, family, block in best.values():
            child = self._child(rest, family, block, refined=score > HOPELESS)
            if child is not None:
                out.append((child.members[-1], child.score - rest.score, score))
        return sorted(out, key=lambda rival: -rival[1])

    def null_scores(self, draws, rng):
        """Return the best score of any effect in `draws` runs of pure noise, (draws,).

        The noise is white, goes through the same projection and the same families; a share of about
        a tenth of the library's score is not refined, alike for noise and data.
        """
        n = self.run.size
        noise = self.project(rng.standard_normal((draws, n, 3))).reshape(draws, 3 * n)
        rss = np.sum(noise**2, axis=1)
        best = np.full(draws, -np.inf)
        named = [family for family in self.families if not isinstance(family.effect, Structure)]
        for family, products in products_of(named, noise):
            best = np.maximum(best, self.best_scores(family, rss, gains(products), self.dof)[0])
        return best


def cost(energy, k):
    """Return what k amplitudes of a square sum `energy` (in sigma^2) cost: k (1 + ln(energy / k)).

    Below energy = k they cost what they gain.
    """
    k = np.maximum(k, 1)
    return np.where(energy > k, k * (1 + np.log(np.maximum(energy, k) / k)), energy)


def search_cost(effect, chances):
    """Return what the search of an effect with so many separate chances costs."""
    extra = STRUCTURE_PRIOR if isinstance(effect, Structure) else 0.0
    return 2 * np.log(chances * len(EFFECTS)) + extra


def _gain(member, others):
    """Return the fall of the square sum when a member joins a selection."""
    x = member.rows @ others.rows.T
    y = member.rows @ others.residual
    gram = np.eye(len(y)) * (1 + 1e-9) - x @ x.T
    value, vector = np.linalg.eigh(gram)
    keep = value > 1e-3
    return float(np.sum((vector[:, keep].T @ y)**2 / value[keep]))


def _key(selection):
    return frozenset((m.name, *sorted((k, v) for k, v in m.setting.items() if not isinstance(v, float)))
                     for m in selection.members)


__all__ = ['Family', 'Member', 'Problem', 'Selection']
