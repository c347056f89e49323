# SPDX-License-Identifier: Apache-2.0
"""Which physical effect is missing: claimed only with a probability that counts the whole search."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import special

from rosette_ros.core.base import BASE_TERMS
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.errors import InvalidData
from rosette_ros.core.fit import JointSpace, fit
from rosette_ros.core.heldout import HeldOut
from rosette_ros.core.model import Model, Term
from rosette_ros.core.search import Problem, Selection
from rosette_ros.core.settings import choose_settings, effect_problems, search_settings

CLAIM = 0.002
"""Search-wide probability below which a name is claimed; 5 % is what the users were promised."""
INVISIBLE = 0.05
"""Visible share below which an order of measurement is said to hide an effect."""
LOOK_ALIKE = 8.0
"""Difference of scores (twice the log Bayes factor) below which two effects cannot be told apart."""
DRAWS = 300
NOISELESS = 1e-10
"""Residual rms, m, below which nothing is searched: a tenth of a nanometre concerns nobody."""
BLIND_STEPS = 2
"""How often the settings of effects are searched without a block of readings, each time better."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect that could be what the model lacks.

    p: search-wide probability that noise does as well; rms before and after adding it, fit and held
    out, m; delta_bic: before minus after, positive favours it; parameters: of the joint fit.
    """

    effect: str
    setting: dict
    p: float
    visible_fraction: float
    rms_before: float
    rms_after: float
    held_out_before: float
    held_out_after: float
    delta_bic: float
    parameters: tuple
    look_alikes: tuple[str, ...]
    claimed: bool


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the model lacks, as far as the run can show.

    missing: names claimed, strongest first; unexplained: whether something is left that no named
    effect explains, and unexplained_text, what it depends on; candidates: best first; invisible:
    effects that this order hides; unavailable: effects that the run's records cannot judge, with the
    reason; final: the fit with all that is claimed; verdict: for a person.
    """

    model: Model
    fit: object
    final: object
    missing: tuple[str, ...]
    terms: tuple[Term, ...]
    unexplained: bool
    unexplained_text: str
    candidates: tuple[Candidate, ...]
    invisible: tuple[str, ...]
    unavailable: tuple[tuple[str, str], ...]
    verdict: str


def diagnose(run, model=None, seed=0):
    """Return the Diagnosis of a run under a model (the base model if none is given).

    seed: of the simulated noise and of the held-out blocks; the same run gives the same answer. Raises InvalidData
    where its times, temperatures or travels are such that no calculation ends.
    """
    try:
        return _diagnose(run, model or Model(), seed)
    except np.linalg.LinAlgError as error:
        raise InvalidData(f'{run.source}: cannot be diagnosed ({error}); look at its times, temperatures and '
                          'travels') from error


def _diagnose(run, model, seed):
    start = fit(run, model, choose_settings(run, model))
    absent = missing_base(run, start)
    full = Model((*model.base, *absent), model.terms)
    base = fit(run, full, start.settings) if absent else start
    search = _Search(run, full, base, seed)
    chosen = search.chosen()
    named = tuple(member for member in chosen.members if member.named)
    final = search.final_fit(named)
    unexplained, text = search.unexplained(chosen, final)
    candidates = search.candidates(chosen, start, absent)
    missing = tuple(dict.fromkeys([*absent, *(member.name for member in named)]))
    invisible, unavailable = search.hidden(missing)
    diagnosis = Diagnosis(
        model, start, final, missing,
        tuple(Term(member.effect, member.setting) for member in named), unexplained, text,
        candidates, invisible, unavailable, '')
    return _with_verdict(diagnosis)


def held_out_rms(run, fitted, seed=0):
    """Return the error of a fit in readings left out, m; its settings are searched without each block."""
    if not fitted.model.terms:
        residual = fitted.residual.reshape(-1)
        blocks = HeldOut(fitted.joint, run.size, seed)
        return blocks.rms([(residual, np.zeros((0, residual.size)))] * blocks.folds)
    base = fit(run, Model(fitted.model.base))
    space = base.joint
    blocks = HeldOut(space, run.size, seed)
    whole = Problem(run, space, base.residual, base.dof, (), ())
    problems = effect_problems(run, fitted.model, space, base.residual, base.dof)
    fits = [(whole.residual, np.zeros((0, whole.residual.size)))] * blocks.folds
    # at first the effects count for nothing in a block, then for what they predict there
    for _ in range(BLIND_STEPS if any(term.effect.searched for term in fitted.model.terms) else 1):
        blind = blocks.imputed(whole.residual, fits) * whole.scale
        fits = [_with_settings(whole, fitted.model, search_settings(
            run, fitted.model, [problem.on(one.reshape(-1, 3)) for problem in problems]))
            for one in blind]
    return whole.scale * blocks.rms(fits)


def _with_settings(problem, model, settings):
    """Return residual and orthonormal rows of a problem with a model's effects at settings."""
    members = [problem.member(term.effect, setting, 1.0)
               for term, setting in zip(model.terms, settings)]
    chosen = problem.select([member for member in members if member])
    return chosen.residual, chosen.rows


def missing_base(run, start):
    """Return the base terms that a model lacks and the run asks for, in order.

    Every cell has plate and CMM deviations, so an absent term needs less than an effect does: an
    F-test over all sets of absent terms, and of those that pass the best by Akaike's criterion.
    """
    model = start.model
    absent = [term for term in BASE_TERMS if term not in model.base]
    best, best_score = (), 0.0
    sets = [chosen for size in range(1, len(absent) + 1)
            for chosen in itertools.combinations(absent, size)]
    rss = start.rms**2 * start.dof
    for chosen in sets:
        tried = fit(run, Model((*model.base, *chosen), model.terms), start.settings)
        extra = tried.rank - start.rank
        if extra <= 0:
            continue
        left = max(tried.rms**2 * tried.dof, 1e-300)
        ratio = (rss - left) / extra / (left / tried.dof)
        score = start.dof * np.log(rss / left) - 2 * extra
        if special.fdtrc(extra, tried.dof, ratio) * len(sets) < 1e-4 and score > best_score:
            best, best_score = chosen, score
    return best


class _Search:
    """One diagnosis: the problem, its null distribution and what follows from both."""

    def __init__(self, run, model, base, seed):
        self.run, self.model, self.base = run, model, base
        self.seed = seed
        joint = base.joint
        space = JointSpace(joint.space, joint.every, np.zeros((0, run.size, 3)))
        self.dof = 3 * run.size - joint.space.rank - space.rank
        self.residual = space.residual(base.residual[None])[0]
        self.problem = Problem(run, space, self.residual, self.dof)
        self.noiseless = base.rms < NOISELESS
        rng = np.random.default_rng(seed)
        self.null = np.sort(self.problem.null_scores(DRAWS if run.n < 48 else DRAWS // 2, rng))
        self.held_out = HeldOut(space, run.size, seed)
        self._blind_fits = {}

    def p(self, score):
        """Return the chance that noise reaches a score anywhere in the search.

        Beyond the simulated tail it falls exponentially, as the tails of the score do.
        """
        above = np.count_nonzero(self.null >= score)
        if above >= 10:
            return (above + 1) / (self.null.size + 1)
        edge = self.null[int(0.8 * self.null.size)]
        scale = max(2.2, 1.1 * float(np.mean(self.null[self.null > edge] - edge)))
        return float(min(0.2, 0.2 * np.exp(-(score - edge) / scale)))

    def unrefined_score(self, rest, name):
        """Return the best score on the grid of an effect beside the members of `rest`."""
        return max((score for score, *_ in self.problem.offers([rest], (name,))[0]),
                   default=-np.inf)

    def chosen(self):
        """Return the Selection that the search ends with: each member holds beside the others."""
        if self.noiseless:
            return self.problem.empty
        selection = self.problem.grow()
        while selection.members:
            scores = [self.unrefined_score(self.problem.select(selection.without(k)), member.name)
                      for k, member in enumerate(selection.members)]
            weakest = int(np.argmin(scores))
            if self.p(scores[weakest]) <= CLAIM:
                break
            selection = self.problem.swap(self.problem.select(selection.without(weakest)))
        return self._strongest_first(selection)

    def _strongest_first(self, selection):
        falls = [self.problem.select(selection.without(k)).rss
                 for k in range(len(selection.members))]
        # shapes without a name come last: what is told of the named ones is told without them
        order = sorted(range(len(falls)), key=lambda k: (not selection.members[k].named, -falls[k]))
        return self.problem.select(tuple(selection.members[k] for k in order))

    def final_fit(self, members):
        """Return the joint fit of the model with members added."""
        model = self.model
        terms = tuple(Term(member.effect) for member in members)
        settings = tuple(member.setting for member in members)
        return fit(self.run, Model(model.base, (*model.terms, *terms), repeated=True),
                   (*self.base.settings, *settings), space=self.base.joint.space)

    def unexplained(self, chosen, final):
        """Return whether something is left that no named effect explains, and what it depends on."""
        shapes = [member for member in chosen.members if not member.named]
        if shapes:
            return True, '; '.join(member.effect.describe(member.setting) for member in shapes)
        chi, p = final.reduced_chi_square, final.lack_of_fit_p
        if chi is not None and chi > 1.5 and p < 1e-6:
            return True, (f'the residuals scatter {np.sqrt(chi):.2g} times as much as the '
                          'repeatability says, and no shape was found in them')
        return False, ''

    def candidates(self, chosen, start, absent):
        """Return all candidates: claimed ones as a ladder, then the others beside all claimed."""
        out = [self._base_candidate(term, start) for term in absent]
        ladder = ()
        for place, member in enumerate(chosen.members):
            rest = self.problem.select(chosen.without(place))
            before = self.problem.select(ladder)
            ladder = (*ladder, member)
            if not member.named:
                continue
            score = self.unrefined_score(rest, member.name)
            own = self.problem.select(chosen.members).score - rest.score
            alike = tuple(rival.name for rival, other, _ in self.problem.rivals(rest)
                          if rival.named and rival.name != member.name
                          and other > max(own - LOOK_ALIKE, 0))
            out.append(self._candidate(member, before, self.p(score), alike, True, (member.name,)))
        if self.noiseless:
            return tuple(out)
        claimed = set(chosen.names)
        others = [(self.p(score), -gain, rival)
                  for rival, gain, score in self.problem.rivals(chosen)
                  if rival.named and rival.name not in claimed
                  and self.dof > (len(chosen.rows) + len(rival.rows)
                                  + _searched((*chosen.members, rival)))]
        among = tuple(rival.name for _, _, rival in others if rival.effect.searched)
        named = self.problem.select([member for member in chosen.members if member.named])
        for p, _, rival in sorted(others, key=lambda entry: entry[:2]):
            out.append(self._candidate(rival, named, p, (), False, among))
        return tuple(out)

    def _candidate(self, member, before, p, look_alikes, claimed, among):
        after = self.problem.select((*before.members, member))
        scale = self.problem.scale
        dof_before, dof_after = (self.dof - len(s.rows) - _searched(s.members)
                                 for s in (before, after))
        size = 3 * self.run.size
        k = (len(after.rows) + _searched(after.members)
             - len(before.rows) - _searched(before.members))
        fitted = self.final_fit([m for m in after.members if m.named])
        parameters = fitted.effects[-1].parameters
        held_before = self._blind(before).rms
        return Candidate(
            member.name, dict(member.setting), p, member.share,
            scale * float(np.sqrt(before.rss / dof_before)),
            scale * float(np.sqrt(after.rss / dof_after)), scale * held_before,
            scale * self._held_out_after(member, before, among),
            float(size * np.log(before.rss / after.rss) - k * np.log(size)), parameters,
            look_alikes, claimed)

    def _blind(self, before):
        """Return the held-out error of a selection and what is known without each block, a _Blind."""
        key = tuple(id(member) for member in before.members)
        if key not in self._blind_fits:
            training = self.held_out.training_residuals(before.residual, before.rows)
            rms = self.held_out.rms([(before.residual, before.rows)] * self.held_out.folds)
            selections = [Selection(before.members, before.rows, residual, float(residual @ residual), 0.0)
                          for residual in training]
            self._blind_fits[key] = _Blind(rms, self.problem, selections)
        return self._blind_fits[key]

    def _held_out_after(self, member, before, among):
        """Return the held-out error with an effect whose settings are searched without each block."""
        found, fits = {}, []
        for setting in self._blind(before).settings(member, among):
            if setting not in found:
                again = (member if setting is member.setting else
                         self.problem.member(member.effect, setting, member.chances))
                after = self.problem.select((*before.members, again))
                found[setting] = after.residual, after.rows
            fits.append(found[setting])
        return self.held_out.rms(fits)

    def _base_candidate(self, term, start):
        model = self.model.without_effect(term)
        before = fit(self.run, model, self.base.settings)
        extra = self.base.rank - before.rank
        left = self.base.rms**2 * self.base.dof
        rss = before.rms**2 * before.dof
        ratio = (rss - left) / extra / (left / self.base.dof)
        p = float(special.fdtrc(extra, self.base.dof, ratio)) * 7
        held = []
        for one in (before, self.base):
            residual = one.residual.reshape(-1)
            blocks = HeldOut(one.joint, self.run.size, self.seed)
            held.append(blocks.rms([(residual, np.zeros((0, residual.size)))] * blocks.folds))
        size = 3 * self.run.size
        return Candidate(term, {}, min(p, 1.0), 1.0, before.rms, self.base.rms, *held,
                         float(size * np.log(rss / left) - extra * np.log(size)), (), (), True)

    def hidden(self, missing):
        """Return the effects that this order hides, and those that the records cannot judge."""
        shares = {}
        for family in self.problem.families:
            shares[family.name] = max(shares.get(family.name, 0.0), float(family.shares.max()))
        present = {term.name for term in self.model.terms}
        unavailable = tuple((name, reason) for name, effect in EFFECTS.items()
                            if (reason := _reason(effect, self.run)))
        out = {name for name, _ in unavailable}
        invisible = tuple(name for name in EFFECTS
                          if name not in out and name not in missing and name not in present
                          and shares.get(name, 0.0) < INVISIBLE)
        return invisible, unavailable


class _Blind:
    """A selection fitted without each block of readings; rms: its held-out error in sigma."""

    def __init__(self, rms, problem, selections):
        self.rms, self._problem, self._selections = rms, problem, selections
        self._offers = {}

    def settings(self, member, among):
        """Return the best setting of a member's effect without each block.

        among: names of the effects that will be asked for beside this selection; they are looked at
        together.
        """
        if not member.effect.searched:
            return [member.setting] * len(self._selections)
        if member.name not in self._offers:
            offers = self._problem.offers(self._selections, among, allow_repeats=True)
            for name in among:
                self._offers[name] = [next((offer for offer in found if offer[1].name == name), None)
                                      for found in offers]
        return [member.setting if offer is None or len(offer[1].settings) == 1
                else offer[1].settings[offer[2]] for offer in self._offers[member.name]]


def _reason(effect, run):
    return effect.unavailable(run) or (
        '' if effect.settings(run) else 'what it depends on does not change in this run')


def _searched(members):
    return sum(parameter.kind != 'choice' for member in members
               for parameter in member.effect.searched)


def _with_verdict(diagnosis):
    """Return the diagnosis with one or two sentences for a person."""
    rms, final = diagnosis.fit.rms * 1e6, diagnosis.final.rms * 1e6
    parts = []
    if diagnosis.missing:
        names = ' and '.join(diagnosis.missing)
        them = 'it' if len(diagnosis.missing) == 1 else 'them'
        parts.append(f'The model lacks {names}: with {them} the residual falls from {rms:#.3g} um to '
                     f'{final:#.3g} um.')
        alike = sorted({other for c in diagnosis.candidates if c.claimed for other in c.look_alikes})
        if alike:
            parts.append(f'In this order {" and ".join(alike)} would look nearly the same.')
    if diagnosis.unexplained:
        parts.append(f'Something is left that no named effect explains: '
                     f'{diagnosis.unexplained_text}.')
    if not parts:
        parts.append(f'Nothing is missing that this run can show: the residual of {rms:#.3g} um is '
                     'noise.')
    if diagnosis.invisible:
        parts.append(f'This order of measurement cannot show {", ".join(diagnosis.invisible)}.')
    values = {name: getattr(diagnosis, name) for name in diagnosis.__dataclass_fields__}
    return Diagnosis(**{**values, 'verdict': ' '.join(parts)})
