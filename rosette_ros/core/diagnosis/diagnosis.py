# SPDX-License-Identifier: Apache-2.0
"""Which physical effect is missing: claimed only with a probability that counts the whole search."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from rosette_ros.core.diagnosis.base_terms import f_test, missing_base
from rosette_ros.core.diagnosis.candidates import HIDDEN_SHARE, Family, why_not_judged
from rosette_ros.core.diagnosis.cross_validation import CrossValidation, WithoutBlocks
from rosette_ros.core.diagnosis.look_alikes import LOOK_ALIKE, axis_open, look_alikes
from rosette_ros.core.diagnosis.noise_choice import noise_of_z, noise_problem, under_best_noise
from rosette_ros.core.diagnosis.noise_search import SEEN, noise_of_rounding
from rosette_ros.core.diagnosis.parameter_search import RELINEARISED, choose_settings
from rosette_ros.core.diagnosis.recovered_shape import Shape, recovered_shapes
from rosette_ros.core.diagnosis.right_shape import free_instead, replaced_words, right_shapes
from rosette_ros.core.diagnosis.search import BRANCHES, SWAPPED, Member, Problem, Selection, searched_count
from rosette_ros.core.diagnosis.verdict import Verdict, decide
from rosette_ros.core.effects.free_forms import FreeForm, axes_words
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.errors import InvalidData, NotDeterminable
from rosette_ros.core.model.least_squares import Fit, FittedEffect, JointSpace, Parameter, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.records import Floats, Run, resolution_of

CLAIM = 0.002
"""Search-wide probability below which a name is claimed; 5 % is what the users were promised."""
DRAWS = 300
COARSE = 1.5
"""Step of the readings, over the residual, above which their noise is mostly that of rounding."""
LEFT = 1e-3
"""Probability, over all tests, below which the rest is not noise of the run's kind."""
NOISELESS = 1e-10
"""Residual rms, m, below which nothing is searched: a tenth of a nanometre is negligible."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect that could be what the model lacks.

    p: search-wide probability that noise does as well; rms of the fit and of the cross-validation before and after
    adding it, m; delta_bic: before minus after, positive favours it; parameters: of the joint fit with all claimed."""

    effect: str
    setting: Mapping[str, float | str]
    p: float
    visible_fraction: float
    rms_before: float
    rms_after: float
    cross_validation_before: float
    cross_validation_after: float
    delta_bic: float
    parameters: tuple[Parameter, ...]
    look_alikes: tuple[str, ...]
    claimed: bool


@dataclass(frozen=True, eq=False)
class Finding:
    """What the search finds that a model lacks.

    model, fit: as given; final: the fit with all that is claimed; missing: names claimed, strongest first, and terms,
    the effects of them; shapes: what the unnamed terms depend on that were found beside them; look_alikes: effects that
    would look like a claimed one; invisible: effects that this order of measurement hides; misfits: in what the rest is
    not noise of the kind that the run has.
    """

    model: Model
    fit: Fit
    final: Fit
    missing: tuple[str, ...]
    terms: tuple[Term, ...]
    shapes: str
    look_alikes: tuple[str, ...]
    invisible: tuple[str, ...]
    misfits: tuple[str, ...]

    @property
    def verdict(self) -> Verdict:
        """The one decision."""
        return decide(self.fit, self.final, self.missing, self.shapes, self.look_alikes, self.invisible,
                      self.misfits)

    @property
    def unexplained(self) -> bool:
        """Whether something is left that no named effect explains."""
        return self.verdict.unexplained


@dataclass(frozen=True, eq=False)
class Diagnosis(Finding):
    """A Finding with all candidates, best first, what the records cannot judge, with reasons, and recovered Shapes."""

    candidates: tuple[Candidate, ...]
    recovered: tuple[Shape, ...]
    unavailable: tuple[tuple[str, str], ...]


def judge(run: Run, model: Model | None = None) -> Verdict:
    """Return the Verdict of `diagnose` without what only a diagnosis shows; arguments and errors as there."""
    return find(run, model).verdict


def find(run: Run, model: Model | None = None) -> Finding:
    """Return the Finding of `diagnose` without candidates and shapes, in two thirds of its time; see there."""
    with _bounded(run):
        return _search(run, model or Model()).finding


def diagnose(run: Run, model: Model | None = None) -> Diagnosis:
    """Return the Diagnosis of a run under a model (the base model if none is given).

    The same run gives the same answer, simulated noise included. Raises NotDeterminable where the run does not
    determine the model, InvalidData where its times, temperatures or travels are such that no calculation ends.
    """
    with _bounded(run):
        return _search(run, model or Model()).diagnosis


@contextmanager
def _bounded(run: Run) -> Iterator[None]:
    """Turn an iteration without end into InvalidData."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise InvalidData(f'{run.source}: cannot be diagnosed ({error}); check its times, temperatures and '
                          'travels') from error


class RunSearch:
    """The search on one run: what it chooses, its null distribution, and what the verdict rests on.

    needed: score below which nothing that it finds is of use.
    """

    def __init__(self, run: Run, model: Model, noise: Noise | None = None,
                 like: Sequence[Family] = ()) -> None:
        """Free the readings of the model, to whose fit, `start`, the `absent` base terms are added in `base`."""
        self.run, self.needed = run, -np.inf
        self._without: dict[tuple[Member, ...], WithoutBlocks] = {}
        self.start = base = fit(run, model, choose_settings(run, model, noise), noise)
        self.absent = missing_base(run, self.start)
        if self.absent:
            base = fit(run, replace(model, base=(*model.base, *self.absent)), self.start.settings, noise)
        if noise is None and (step := resolution_of(run.centre)) > COARSE * base.rms:
            self.start, base = (replace(one, noise=Noise(resolution=step)) for one in (self.start, base))
        self.base, joint = base, base.joint
        self.space = JointSpace(joint.space, joint.every, np.zeros((0, run.size, 3)))
        self.dof = 3 * run.size - joint.space.rank - self.space.rank
        self.problem = Problem(run, self.space, self.space.free(base.white_residual[None])[0], self.dof, like=like)
        self.noiseless = base.rms < NOISELESS

    @cached_property
    def finding(self) -> Finding:
        """All that the verdict rests on."""
        members = self.chosen.members
        named = tuple(member for member in members if member.named)
        missing = tuple(dict.fromkeys([*self.absent, *(member.name for member in named)]))
        final = self._final
        shapes = [one.effect.describe(one.setting, axes_words(self.run), axis_open(self.problem, self.chosen, place),
                                      replaced_words(one))
                  for place, one in enumerate(members) if isinstance(one.effect, FreeForm)]
        if beneath := [member.name for member in members if member.beneath]:
            shapes.append(
                f'here the linear model ends: what looks like {" and ".join(beneath)} is below '
                f'{1e6 * final.linear_limit:.2g} µm, the square of the largest displacement over the radius')
        return Finding(
            self.start.model, self.start, final, missing,
            tuple(Term(member.effect, member.setting) for member in named), '; '.join(shapes),
            tuple(sorted(set(itertools.chain(*self.look_alikes.values())))), self._invisible(missing), self._misfits())

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """The finding with candidates and shapes."""
        candidates, refused = _candidates(self)
        return Diagnosis(**vars(self.finding), candidates=candidates,
                         recovered=recovered_shapes(self.problem, self.chosen),
                         unavailable=(*self.unavailable, *refused))

    @cached_property
    def null(self) -> Floats:
        """Best scores of pure noise, sorted: the null distribution of the search."""
        rng = np.random.default_rng(0)
        noise = rng.standard_normal((DRAWS if self.run.n < 48 else DRAWS // 2, self.run.size, 3))
        return np.sort(self.problem.null_scores(noise_of_rounding(self.base, noise) if self.is_coarse else noise))

    @property
    def is_coarse(self) -> bool:
        """Whether the readings are rounded by as much as what is left, so that their noise is mostly that."""
        return self.base.noise.resolution > 0

    def p(self, score: float) -> float:
        """Return the probability that noise reaches a score anywhere; it falls exponentially beyond what is drawn."""
        above = np.count_nonzero(self.null >= score)
        if above >= 10:
            return (above + 1) / (self.null.size + 1)
        edge = self.null[int(0.8 * self.null.size)]
        beyond = self.null[self.null > edge] - edge  # none where rounding makes one score of all
        scale = max(2.2, 1.1 * float(beyond.mean()) if beyond.size else 0.0)
        return float(min(0.2, 0.2 * np.exp(-(score - edge) / scale)))

    def score_beside(self, selection: Selection, place: int) -> float:
        """Return the score on the grid (as noise is scored) of one member of a selection beside the others.

        A form that is no part of the search, only set beside claims, has the score by which it is kept."""
        rest = self.problem.select(selection.without(place))
        offers = self.problem.offers([rest], (selection.members[place].name,))[0]
        return max((offer.score for offer in offers), default=selection.score - rest.score)

    @cached_property
    def chosen(self) -> Selection:
        """The Selection that the search ends with: each member holds beside the others."""
        if self.noiseless:
            return self.problem.empty
        selection = self._relinearised(self._held(self.problem.grow(self.needed), self.problem.swap))
        if selection.score < self.needed - SWAPPED:
            return self._ordered(selection)  # the noise without it is better: what matters is what it leaves
        selection = right_shapes(self.problem, self._above_limit(self.problem.polish(selection)), self._held)
        while vain := [place for place in range(len(selection.members)) if not self._predicts(selection, place)]:
            instead = free_instead(self.problem, selection, vain[:1]) or self.problem.select(selection.without(vain[0]))
            selection = self.problem.polish(self._held(instead))
        return self._ordered(self._simplest(selection))

    def _simplest(self, selection: Selection) -> Selection:
        """Return the selection with a wrong reading in place of an effect that cannot be distinguished from it."""
        for place, member in enumerate(selection.members):
            if member.named and member.name != 'outlier':
                rest = self.problem.select(selection.without(place))
                for offer in self.problem.offers([rest], ('outlier',), allow_repeats=True)[0][:1]:
                    child = self.problem.child(rest, offer)
                    if child and self.p(offer.score) <= CLAIM and (
                            child.score > selection.score - LOOK_ALIKE or child.rss < selection.rss):
                        return self._simplest(child)
        return selection

    def _relinearised(self, selection: Selection) -> Selection:
        """Return what the search finds once the readings are freed of the second-order terms of what it found."""
        for _ in range(RELINEARISED):
            tried = [tuple(member for member in selection.members if member.named)]
            if len(tried[0]) < len(selection.members):  # a free form may stand for one effect and its square
                tried += [child.members for offer in self.problem.offers([self.problem.empty])[0][:BRANCHES]
                          if offer.family.effect.moves_plate
                          and (child := self.problem.child(self.problem.empty, offer))]
            beyond = min((self.final_fit(members) for members in tried), key=lambda one: one.rms).beyond
            if np.abs(beyond - self.base.beyond).max() <= NEGLIGIBLE:
                break
            base = self.base
            self.base = fit(self.run, base.model, base.settings, base.noise, base.joint.space, beyond)
            self.problem = self.problem.on(self.space.free(self.base.white_residual[None])[0])
            selection = self._held(self.problem.grow(), self.problem.swap)
        return selection

    def _above_limit(self, selection: Selection) -> Selection:
        """Return the selection with no name for what is smaller than the linear model can tell beside the others."""
        if not selection.members:
            return selection
        final = self.final_fit(selection.members)
        limit, found = final.linear_limit, final.effects[-len(selection.members):]
        return self.problem.select([
            replace(member, beneath=one.largest < limit and not isinstance(member.effect, FreeForm))
            for member, one in zip(selection.members, found)])

    def _ordered(self, selection: Selection) -> Selection:
        falls = [self.problem.select(selection.without(place)).rss for place in range(len(selection.members))]
        # unnamed shapes come last: the named effects are judged without them
        order = sorted(range(len(falls)), key=lambda place: (not selection.members[place].named, -falls[place]))
        return self.problem.select(tuple(selection.members[place] for place in order))

    def _held(self, selection: Selection, settle: Callable[[Selection], Selection] = lambda same: same) -> Selection:
        """Return the selection without the members that do not hold beside the others, settled after each."""
        while selection.members:
            scores = [self.score_beside(selection, place) for place in range(len(selection.members))]
            weakest = int(np.argmin(scores))
            if self.p(scores[weakest]) <= CLAIM:
                break
            selection = settle(self.problem.select(selection.without(weakest)))
        return selection

    def without(self, before: Selection) -> WithoutBlocks:
        """Return a selection fitted without each block; those that were asked for are kept."""
        if before.members not in self._without:
            self._without[before.members] = WithoutBlocks(self.blocks, self.problem, before)
        return self._without[before.members]

    def _predicts(self, selection: Selection, place: int) -> bool:
        """Return whether a named member lowers the error of the cross-validation beside the others.

        A wrong reading says nothing of the others: it need not."""
        member = selection.members[place]
        if not member.named or member.name == 'outlier':
            return True
        without = self.without(self.problem.select(selection.without(place)))
        error = without.rms_with(member, (member.name,))
        return not error > without.rms  # not a number where the others do not determine it

    @cached_property
    def blocks(self) -> CrossValidation:
        """Readings to be left out."""
        return CrossValidation(self.space, self.run.size)

    def final_fit(self, members: Sequence[Member]) -> Fit:
        """Return the joint fit of the model with members added."""
        terms = tuple(Term(member.effect) for member in members)
        model = replace(self.base.model, terms=(*self.base.model.terms, *terms), repeated=True)
        return fit(self.run, model, (*self.base.settings, *(member.setting for member in members)), self.base.noise,
                   self.base.joint.space)

    @cached_property
    def _final(self) -> Fit:
        """The fit with all that is claimed."""
        return self.final_fit([member for member in self.chosen.members if member.named])

    @property
    def claimed_effects(self) -> tuple[FittedEffect, ...]:
        """The named members of the selection as they are fitted together."""
        return self._final.effects[len(self.base.settings):]

    @cached_property
    def look_alikes(self) -> dict[int, tuple[str, ...]]:
        """Effects that would look nearly the same, by the place of each named member of the selection."""
        return look_alikes(self.problem, self.chosen, self.claimed_effects)

    @cached_property
    def unavailable(self) -> tuple[tuple[str, str], ...]:
        """Effects that the run's records cannot judge, with the reason."""
        return tuple((name, reason) for name, effect in effects_of(self.run).items()
                     if (reason := why_not_judged(effect, self.run)))

    def _misfits(self) -> tuple[str, ...]:
        if self.noiseless or self.base.noise.resolution:
            return ()
        problem = noise_problem(self.base, self.chosen.members)
        return tuple(dict.fromkeys(one.words for one in problem.at(self.base.noise).misfits() if one.p < LEFT))

    def _invisible(self, missing: Sequence[str]) -> tuple[str, ...]:
        shares: dict[str, float] = {}
        for family in self.problem.families:
            shares[family.name] = max(shares.get(family.name, 0.0), float(family.shares.max()))
        known = {*missing, *(term.name for term in self.base.model.terms), *(name for name, _ in self.unavailable)}
        return tuple(name for name in effects_of(self.run)
                     if name not in known and shares.get(name, 0.0) < HIDDEN_SHARE)


@lru_cache(maxsize=1)
def _search(run: Run, model: Model) -> RunSearch:
    """Return the search under the noise of the run."""
    white = RunSearch(run, model)
    return under_best_noise(white, lambda noise: RunSearch(run, model, noise, white.problem.families))


def fitted_with_noise(run: Run, model: Model, white: Fit, is_searched: bool) -> Fit:
    """Return the fit of a model under the noise of a run; white: that under white noise.

    is_searched: whether effects that the model lacks are told from noise by a search, where the noise is not white;
    else only z is compared with x and y. Raises NotDeterminable where the run does not determine the model.
    """
    if white.rms < NOISELESS:
        return white
    if not is_searched:
        found = noise_of_z(white) if 'noise.axes' in model.noise else white.noise
        return white if found.is_white else fit(run, model, choose_settings(run, model, found), found)
    start = noise_problem(white).start
    if start.misfits()[0].p >= SEEN and not resolution_of(run.centre) > COARSE * white.rms:
        return white
    with _bounded(run):
        return _search(run, model).start


def _candidates(search: RunSearch) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """Return all candidates: claimed ones, each beside those before it, then the others beside all claimed; and the
    names of those that have no fit, with the reason."""
    problem, chosen, before = search.problem, search.chosen, search.problem.empty
    out = [_base_candidate(search, term) for term in search.absent]
    fitted = iter(search.claimed_effects)
    for place, member in enumerate(chosen.members):
        if member.named:
            p = search.p(search.score_beside(chosen, place))
            out.append(_candidate(search, member, before, p, search.look_alikes[place], (member.name,), next(fitted)))
        before = problem.select((*before.members, member))
    if search.noiseless:
        return tuple(out), ()
    others = [(search.p(score), -gain, rival) for rival, gain, score in problem.rivals(chosen)
              if rival.named and rival.name not in chosen.names
              and search.dof > len(chosen.rows) + len(rival.rows) + searched_count((*chosen.members, rival))]
    among = tuple(rival.name for _, _, rival in others if rival.effect.searched)
    named = problem.select([member for member in chosen.members if member.named])
    refused = []
    for p, _, rival in sorted(others, key=lambda entry: entry[:2]):
        try:
            out.append(_candidate(search, rival, named, p, (), among))
        except NotDeterminable:
            refused.append((rival.name, 'its fit to these readings does not converge'))
    return tuple(out), tuple(refused)


def _candidate(search: RunSearch, member: Member, before: Selection, p: float, look_alikes: tuple[str, ...],
               among: Sequence[str], claimed: FittedEffect | None = None) -> Candidate:
    """Return the Candidate of a member beside a selection; among: as of WithoutBlocks.settings.

    claimed: the effect in the fit with all that is claimed, None for one that is not."""
    after, scale = search.problem.select((*before.members, member)), search.problem.scale
    used, more = (len(each.rows) + searched_count(each.members) for each in (before, after))
    rms_before, rms_after = (scale * float(np.sqrt(each.rss / (search.dof - count)))
                             for each, count in ((before, used), (after, more)))
    size = 3 * search.run.size
    fitted = claimed or search.final_fit([each for each in after.members if each.named]).effects[-1]
    return Candidate(
        member.name, dict(member.setting), p, member.share, rms_before, rms_after,
        scale * search.without(before).rms, scale * search.without(before).rms_with(member, among),
        float(size * np.log(before.rss / after.rss) - (more - used) * np.log(size)), fitted.parameters,
        look_alikes, claimed is not None)


def _base_candidate(search: RunSearch, term: str) -> Candidate:
    run, after = search.run, search.base
    before = fit(run, after.model.without_effect(term), after.settings, after.noise)
    left, rss = (each.rms**2 * each.dof for each in (after, before))
    error, error_with = (CrossValidation(each.joint, run.size).rms_of(each.white_residual.reshape(-1))
                         for each in (before, after))
    size = 3 * run.size
    return Candidate(term, {}, min(f_test(before, after) * 7, 1.0), 1.0, before.rms, after.rms, error, error_with,
                     float(size * np.log(rss / left) - (after.rank - before.rank) * np.log(size)), (), (), True)
