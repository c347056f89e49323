# SPDX-License-Identifier: Apache-2.0
"""What a run shows that a model lacks: named effects, motions without a name and kinds of noise, by one score.

A name is claimed where the probability that it, or what this order of measurement cannot tell from it, is there is at
least CLAIM. The search-wide probability that noise alone does as well stays beside it as a guard.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from rosette_ros.core.diagnosis.base_terms import f_test, missing_base
from rosette_ros.core.diagnosis.candidates import Candidate, candidates_of
from rosette_ros.core.diagnosis.effect_settings import RELINEARISED, choose_settings, evidence_of, moments_of
from rosette_ros.core.diagnosis.hypotheses import Search
from rosette_ros.core.diagnosis.limits import CLAIM, SURE
from rosette_ros.core.diagnosis.log_evidence import Member, Place, State, with_priors
from rosette_ros.core.diagnosis.noise_hypotheses import NOISELESS, Choice, choose, noise_beside
from rosette_ros.core.diagnosis.null_gains import is_coarse, null_gains, p_of, p_of_tail
from rosette_ros.core.diagnosis.posterior import (
    STANDS,
    Cause,
    Claim,
    Explanation,
    Posterior,
    Unnamed,
    course_of,
    motion_of,
)
from rosette_ros.core.diagnosis.recovered_shape import Shape, recovered_shapes
from rosette_ros.core.diagnosis.verdict import Verdict, decide
from rosette_ros.core.effects.free import PLACES, moving_bodies
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.model.least_squares import HIDDEN_SHARE, Fit, FittedEffect, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.records import Floats, Run, resolution_of
from rosette_ros.core.sight.bank import Bank, families_of, why_not_judged
from rosette_ros.core.sight.visibility import strongest_first
from rosette_ros.core.uncertainty.hidden_effects import unseen
from rosette_ros.core.uncertainty.mixture import total

GUARD = 0.05
"""Search-wide probability of noise alone above which no name is claimed, whatever it is worth, and no effect of a
model is needed: what users were promised."""
NEAR_LAW = 0.05
"""Share of its log likelihood, and at least 2, by which another law of the same motion has to be worse."""
LIKELY = 0.03
"""Probability of an explanation from which on it is fitted: less likely ones are of effects that an environment has."""
HOPEFUL = 12
"""Sets of variables whose free courses are looked at under other noise: those that explain most in white noise."""


@dataclass(frozen=True, eq=False)
class Finding:
    """What the search finds that a model lacks.

    model, fit: as given; final: the fit with all that is claimed; missing: names claimed, strongest first, and terms,
    the effects of them; claims: what is known of each; causes: what moves with what, of all
    that is told; of_terms: the one of each of `terms`; doubtful: names of the best explanation that are not claimed;
    unnamed: what has no name; invisible: effects that this order of measurement hides; not_needed: effects of the model
    that the run does not ask for; explanations: at least up to 95 % together; probability_of_nothing,
    probability_of_unnamed: that nothing, and that something without a name, is missing.
    """

    model: Model
    fit: Fit
    final: Fit
    missing: tuple[str, ...]
    terms: tuple[Term, ...]
    claims: tuple[Claim, ...]
    causes: tuple[Cause, ...]
    of_terms: tuple[Cause, ...]
    doubtful: tuple[Claim, ...]
    unnamed: tuple[Unnamed, ...]
    invisible: tuple[str, ...]
    not_needed: tuple[str, ...]
    explanations: tuple[Explanation, ...]
    probability_of_nothing: float
    probability_of_unnamed: float

    @property
    def with_cause(self) -> Fit | None:
        """The Fit with the cause found; None where nothing that has a name is missing."""
        return self.final if self.verdict.missing else None

    @property
    def verdict(self) -> Verdict:
        """The one decision."""
        found = decide(self.fit, self.final, self.missing, self.unnamed, self.claims, self.of_terms, self.doubtful,
                       strongest_first(self.fit.run, self.invisible, self.model.base), self.not_needed,
                       [moments_of(self.final, place)
                        for place in range(len(self.fit.effects), len(self.final.effects))])
        return found if found.model_fails else replace(found, unseen=unseen(self.final))

    @property
    def unexplained(self) -> bool:
        """Whether something remains that no named effect explains."""
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
    """Return the Finding of `diagnose` without candidates and shapes, sooner; see there."""
    with _bounded(run):
        return search_of(run, model or Model()).finding


def diagnose(run: Run, model: Model | None = None, without: str = '') -> Diagnosis:
    """Return the Diagnosis of a run under a model (the base model if none is given).

    without: the name of an effect that the library shall not have. The same run gives the same answer. Raises
    NotDeterminable where the run does not determine the model, InvalidData where its times, temperatures or travels are
    such that no calculation ends.
    """
    with _bounded(run):
        return (RunSearch(run, model or Model(), without) if without else search_of(run, model or Model())).diagnosis


def fitted_with_noise(run: Run, model: Model, white: Fit, is_searched: bool) -> Fit:
    """Return the fit of a model under the noise of a run; white: that under white noise.

    is_searched: whether effects that the model lacks are distinguished from noise by a search; else the noise is that
    beside the model alone. Raises NotDeterminable where the run does not determine the model.
    """
    if white.rms < NOISELESS:
        return white
    if is_coarse(white):
        return replace(white, noise=Noise(resolution=resolution_of(run.centre)))
    kinds = noise_beside(white)
    if not kinds.may_be:
        return white
    if is_searched:
        with _bounded(run):
            return search_of(run, model).start
    noise = kinds.found()[0].noise
    return white if noise.is_white else fit(run, model, choose_settings(run, model, noise), noise)


@contextmanager
def _bounded(run: Run) -> Iterator[None]:
    """Turn an iteration without end into InvalidData."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise InvalidData(f'{run.source}: cannot be diagnosed ({error}); check its times, temperatures and '
                          'travels') from error


@lru_cache(maxsize=1)
def search_of(run: Run, model: Model = Model()) -> 'RunSearch':  # noqa: B008 (it is frozen)
    """Return the search on a run; arguments as of `diagnose`."""
    return RunSearch(run, model)


class RunSearch:
    """The search on one run: start, the fit of the model as given; base, with the absent base terms, both under the
    noise of the best hypothesis; white: the search in white noise; posterior: of all hypotheses; chosen: the State of
    the best one."""

    def __init__(self, run: Run, model: Model, without: str = '') -> None:
        self.run, self.model, self._without = run, model, without
        self._settings = choose_settings(run, model)
        self.start = self.base = fit(run, model, self._settings)
        self.absent = missing_base(run, self.start)
        if self.absent:
            self.base = self._fit_of_base(Noise(), None)
        self.noiseless = self.base.rms < NOISELESS
        self.white = self._relinearised()
        self.bank = self.white.evidence.bank
        choice = self._choice()
        self.posterior, self.chosen = choice.posterior, choice.state
        self.evidence = self.chosen.evidence
        if choice.noise.resolution:
            self.start, self.base = (replace(one, noise=choice.noise) for one in (self.start, self.base))
        elif not choice.noise.is_white:
            self.base = self._fit_of_base(choice.noise, self.base.beyond)
            self.start = fit(run, model, self._settings, choice.noise, beyond=self.start.beyond)

    def _choice(self) -> Choice:
        white = self.white
        if self.noiseless:
            return Choice(Posterior({((), ()): (0.0, ())}), white.evidence.empty, Noise())
        if is_coarse(self.base):
            best = white.best
            posterior = Posterior({(names, ()): looked for names, looked in white.looked.items()})
            return Choice(posterior, best if posterior.best[0] else white.evidence.empty,
                          Noise(resolution=resolution_of(self.run.centre)))
        return choose(white, self.base, self._under)

    def _fit_of_base(self, noise: Noise, beyond: Floats | None) -> Fit:
        model = replace(self.model, base=(*self.model.base, *self.absent))
        return fit(self.run, model, self._settings, noise, beyond=beyond)

    def _relinearised(self) -> Search:
        """Return the search in white noise, with the second-order terms of what it finds."""
        families = [one for one in families_of(self.run) if one.name != self._without]
        bank = Bank(self.run, with_priors(families) if not self.noiseless else ())
        evidence = evidence_of(self.base, bank)
        for _ in range(RELINEARISED):
            search = Search(evidence)
            named = [] if self.noiseless else search.grown_of_names.members
            beyond = self.with_members(named).beyond if named else self.base.beyond
            if np.abs(beyond - self.base.beyond).max() <= NEGLIGIBLE:
                break
            self.base = self._fit_of_base(Noise(), beyond)
            evidence = evidence.on(self.base.white_residual)
        return search

    def _under(self, noise: Noise) -> Search:
        """Return a search under another noise among what is hopeful in white noise."""
        return Search(evidence_of(self._fit_of_base(noise, self.base.beyond), self._few))

    @cached_property
    def _few(self) -> Bank:
        return Bank(self.run, self.white.hopeful(HOPEFUL), self.bank)

    def with_members(self, members: Sequence[Member]) -> Fit:
        """Return the joint fit of the model with members added, under the noise of the run."""
        return self._with_places([one.place for one in members])

    def _with_places(self, places: Sequence[Place]) -> Fit:
        terms = tuple(Term(family.effect) for family, _ in places)
        model = replace(self.base.model, terms=(*self.base.model.terms, *terms), repeated=True)
        return fit(self.run, model, (*self.base.settings, *(setting for _, setting in places)), self.base.noise,
                   self.base.joint.space)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """What the members of the best hypothesis say moves with what, the likeliest first."""
        motions = {one.place: replace(motion_of(self.run, one.place), alike=self._moving_alike(place))
                   for place, one in enumerate(self.chosen.members)}
        found = self.posterior.causes(self.run, motions)
        return tuple(sorted((replace(one, law_certain=self._is_certain(one)) for one in found),
                            key=lambda one: -one.probability))

    def _moving_alike(self, place: int) -> frozenset[str]:
        """Return the bodies whose motion by the course of a member describes what the readings show of it."""
        member, state = self.chosen.members[place], self.chosen
        course = course_of(self.run, member.place)
        if course is None:
            return frozenset()
        own = slice(*state.ends[place:place + 2])
        shown = (state.inverse @ state.product)[own] @ member.rows
        out = set()
        for body, directions in moving_bodies(self.run).items():
            columns = (course[:, None, :, None] * directions).reshape(-1, *directions.shape[1:])
            rows = self.evidence.space.residual(columns).reshape(len(columns), -1)
            basis = np.linalg.svd(rows, full_matrices=False)[2][:np.linalg.matrix_rank(rows)]
            left = shown - (shown @ basis.T) @ basis
            if 1 - float(left @ left) / max(float(shown @ shown), 1e-300) > STANDS:
                out.add(body)
        return frozenset(out)

    def _is_certain(self, cause: Cause) -> bool:
        """Return whether no other law of the motions of a cause is near its own by likelihood.

        Beside a motion without a name none is certain: what has no law of the library may be a part of it; nor are two
        of the same motion, in one cause or in two: they may be parts of one that the library does not have; nor is one
        where a place of the readings stands for the time or travel that it is a law of."""
        places = frozenset(PLACES)
        if (len(cause.names) != 1 or cause.law_probability < SURE
                or any(one.family.is_free for one in self.chosen.members)
                or any(not places.isdisjoint(some) and not places.issuperset(some) for some in cause.variables)):
            return False
        place = next(k for k, one in enumerate(self.chosen.members) if one.place in cause.places)
        member, rest = self.chosen.members[place], self.chosen.without(place)
        motion, own = motion_of(self.run, member.place), float(rest.line(member.rows).max())
        if any(motion.agrees(motion_of(self.run, one.place)) for one in rest.members):
            return False
        for offer in rest.offers(is_open=False):
            other = self.evidence.member(offer.family, offer.setting, offer.volume)
            if (other.name != member.name and motion.agrees(motion_of(self.run, other.place))
                    and rest.line(other.rows).max() > own - max(NEAR_LAW * own, 2.0)):
                return False
        return True

    @cached_property
    def said(self) -> tuple[Cause, ...]:
        """The causes that are told: of what is claimed, and of what has no name."""
        told = {*(self._cause_of(one) for one, _ in self.claimed), *map(self._cause_of, self._without_name)}
        return tuple(one for one in self.causes if one in told)

    @cached_property
    def _without_name(self) -> list[Member]:
        return [one for place, one in enumerate(self.chosen.members) if one.family.is_free and self._is_guarded(place)]

    def _cause_of(self, member: Member) -> Cause:
        return next(one for one in self.causes if member.place in one.places)

    @cached_property
    def claimed(self) -> tuple[tuple[Member, Claim], ...]:
        """The named members that are claimed, the one that explains most first.

        What stands beside a larger motion without a name, or one of the same body and variable, may be a part of it: it
        is not claimed."""
        members, claims = self.chosen.members, {one.name: one for one in self.posterior.claims}
        unnamed = [one for one in members if one.family.is_free]
        out = [(one, claims[one.name]) for place, one in enumerate(members)
               if one.name in claims and self._is_guarded(place) and not any(
                   other.size > one.size or motion_of(self.run, other.place).agrees(motion_of(self.run, one.place))
                   for other in unnamed)
               and max(self._cause_of(one).probability, claims[one.name].together) >= CLAIM]
        falls = {one: State(self.evidence, [other for other, _ in out if other is not one]).rss for one, _ in out}
        return tuple(sorted(out, key=lambda pair: -falls[pair[0]]))

    def p_of_member(self, place: int) -> float:
        """Return the probability that noise makes anything worth as much as a member of the best hypothesis."""
        member = self.chosen.members[place]
        offers = self.chosen.without(place).offers(member.family.is_free)
        return self.p(next((one.gain for one in offers if one.family is member.family), -np.inf))

    def _is_guarded(self, place: int) -> bool:
        return self.p_of_member(place) <= GUARD and place not in self._of_tail

    @cached_property
    def _of_tail(self) -> frozenset[int]:
        """The places of the wrong readings that do not stand out of the tail that the other readings have."""
        members = self.chosen.members
        readings = {place: one.setting.whole('reading') - 1 for place, one in enumerate(members)
                    if 'reading' in one.setting}
        if not readings:
            return frozenset()
        others = self._unweighted(self.chosen)
        own = {place: self._unweighted(self.chosen.without(place))[row] for place, row in readings.items()}
        out: set[int] = set()
        for place in sorted(readings, key=lambda one: float(own[one] @ own[one])):
            rest = np.delete(others, [row for one, row in readings.items() if one not in out], axis=0)
            if p_of_tail(own[place], rest) > GUARD:
                out.add(place)  # and is a part of the tail of those that are farther off
                others[readings[place]] = own[place]
        return frozenset(out)

    def _unweighted(self, state: State) -> Floats:
        """Return what a state leaves of the readings, (N, 3), without the weights of a tail."""
        left = state.residual.reshape(-1, 3)
        return np.asarray(self.base.joint.whitening.inverse(left[None])[0]) if self.base.noise.tail else left.copy()

    @cached_property
    def null(self) -> Floats:
        """What the best hypothesis is worth in runs of pure noise, falling."""
        return null_gains(self.evidence, self.base)

    def p(self, gain: float) -> float:
        """Return the probability that noise makes anything worth as much."""
        return p_of(gain, self.null)

    @cached_property
    def finding(self) -> Finding:
        """All that the verdict rests on."""
        members, claims = [one for one, _ in self.claimed], [claim for _, claim in self.claimed]
        missing = tuple(dict.fromkeys([*self.absent, *(one.name for one in members)]))
        return Finding(
            self.model, self.start, self._final, missing,
            tuple(Term(one.family.effect, one.setting, True) for one in members), tuple(dict.fromkeys(claims)),
            self.said, tuple(self._cause_of(one) for one in members),
            tuple(one for one in self.posterior.claims if one not in claims), self._unnamed(), self._invisible(missing),
            self._not_needed(), self.posterior.explanations(), self.posterior.nothing, self.posterior.unnamed)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """The finding with candidates and shapes."""
        candidates, refused = candidates_of(self)
        unavailable = tuple((name, reason) for name, effect in effects_of(self.run).items()
                            if (reason := why_not_judged(effect, self.run)))
        return Diagnosis(**vars(self.finding), candidates=candidates,
                         recovered=recovered_shapes(self.chosen, [one for one, _ in self.claimed]),
                         unavailable=(*unavailable, *refused))

    @cached_property
    def _final(self) -> Fit:
        """The fit with all that is claimed, with the curves over all explanations where that is something."""
        final = self.with_members([one for one, _ in self.claimed])
        if not (self.claimed and self.explained):
            return final
        p, fits = zip(*self.explained)
        values, u = (np.stack([getattr(one.error_motions, name) for one in fits]) for name in ('values', 'u'))
        values, u = total(np.array(p) / sum(p), values, u)
        return replace(final, error_motions=replace(final.error_motions, values=values, u=u),
                       explanations=self.explained)

    @cached_property
    def explained(self) -> tuple[tuple[float, Fit], ...]:
        """The likely explanations, up to 95 % together, each with its probability and fit, best first."""
        out = list[tuple[float, Fit]]()
        for one in self.posterior.explanations():
            if one.probability < LIKELY and out:
                break
            try:
                out.append((one.probability, self._with_places(self.posterior.places((one.members, one.noise)))))
            except NotDeterminable:
                continue
        return tuple(out)

    @property
    def claimed_effects(self) -> tuple[FittedEffect, ...]:
        """The claimed members as they are fitted together."""
        return self._final.effects[len(self.base.settings):]

    def _unnamed(self) -> tuple[Unnamed, ...]:
        return tuple(Unnamed(tuple(some | {'ball'} if cause.number('ball') else some for some in cause.alternatives),
                             one.setting.word('along'), one.setting, cause.probability)
                     for one in self._without_name for cause in (self._cause_of(one),))

    def _invisible(self, missing: Sequence[str]) -> tuple[str, ...]:
        if self.noiseless:
            return ()
        shares: dict[str, float] = {}
        for key, seen in self.white.evidence.shares.items():
            if not key[1]:
                for number, share in zip(self.bank.groups[key].family.tolist(), seen.tolist()):
                    name = self.bank.families[number].name
                    shares[name] = max(shares.get(name, 0.0), share)
        known = {*missing, *(term.name for term in self.base.model.terms)}
        return tuple(name for name in effects_of(self.run)
                     if name not in known and shares.get(name, 1.0) < HIDDEN_SHARE)

    def _not_needed(self) -> tuple[str, ...]:
        """The effects of the model without which the residual rises by no more than chance."""
        out, terms = [], self.start.model.terms
        for place, term in enumerate(terms):
            rest = (*terms[:place], *terms[place + 1:])
            settings = (*self.start.settings[:place], *self.start.settings[place + 1:])
            without = fit(self.run, replace(self.start.model, terms=rest, repeated=True), settings, self.start.noise,
                          self.start.joint.space)
            if f_test(without, self.start) > GUARD:
                out.append(str(term))
        return tuple(out)
