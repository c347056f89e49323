# SPDX-License-Identifier: Apache-2.0
"""What a run shows that a model lacks: named effects, motions without a name and kinds of noise, by one score.

    search = search_of(run, model)      what explains the run: run_search.py
    claims = Claims(search)             what is said of it: claims.py
    final = over_all(...)               the fits and curves of it: explained_fit.py
    verdict = decide(facts)             the one decision: verdict.py
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from rosette_ros.core.diagnosis.candidates import candidates_of
from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.claims import Claims
from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.diagnosis.explained_fit import (
    Explained,
    explained_fits,
    fitted_effects,
    not_needed,
    over_all,
)
from rosette_ros.core.diagnosis.log_evidence import NOISELESS
from rosette_ros.core.diagnosis.noise_hypotheses import noise_beside
from rosette_ros.core.diagnosis.posterior import Explanation
from rosette_ros.core.diagnosis.recovered_shape import Shape, recovered_shapes
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.diagnosis.verdict import Verdict, decide, facts_of
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.model.least_squares import HIDDEN_SHARE, Fit, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import Run
from rosette_ros.core.sight.bank import why_not_judged
from rosette_ros.core.sight.visibility import strongest_first
from rosette_ros.core.uncertainty.hidden_effects import unseen

MOST_BALLS_JUDGED = 36
"""Larger plates are judged and diagnosed on request only: it takes seconds to minutes."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a run shows that a model lacks.

    model, fit: as given; final: the fit with all that is claimed; claimed: what is, base terms, then effects, the one
    that explains most first; terms: these effects with their settings; unnamed: what has no name; causes: what moves
    with what, of all that is told; invisible: effects that this order of measurement hides; not_needed: effects of the
    model that the run does not ask for; explanations: at least up to 95 % together; probability_of_nothing,
    probability_of_unnamed: that nothing, and that something without a name, is missing; verdict: the one decision.

    Of `diagnose` alone: candidates, best first, those claimed among them; recovered: shapes; unavailable: what the
    records cannot judge, with reasons.
    """

    model: Model
    fit: Fit
    final: Fit
    claimed: tuple[MissingEffect, ...]
    terms: tuple[Term, ...]
    unnamed: tuple[MissingEffect, ...]
    causes: tuple[Cause, ...]
    invisible: tuple[str, ...]
    not_needed: tuple[str, ...]
    explanations: tuple[Explanation, ...]
    probability_of_nothing: float
    probability_of_unnamed: float
    verdict: Verdict
    candidates: tuple[MissingEffect, ...] = ()
    recovered: tuple[Shape, ...] = ()
    unavailable: tuple[tuple[str, str], ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """Names claimed, strongest first, each once."""
        return tuple(dict.fromkeys(one.name for one in self.claimed))

    @property
    def lacks(self) -> bool:
        """Whether something is missing, with a name or without."""
        return bool(self.verdict.missing or self.verdict.unnamed)

    @property
    def with_cause(self) -> Fit | None:
        """The Fit with the cause found; None where nothing that has a name is missing."""
        return self.final if self.verdict.missing else None

    @property
    def unexplained(self) -> bool:
        """Whether something remains that no named effect explains."""
        return self.verdict.unexplained


def judge(run: Run, model: Model | None = None) -> Verdict:
    """Return the Verdict of `diagnose` without what only that shows; arguments and errors as there."""
    return find(run, model).verdict


def find(run: Run, model: Model | None = None) -> Diagnosis:
    """Return the Diagnosis of `diagnose` without candidates and shapes, sooner; see there."""
    with _bounded(run):
        return known_of(run, model or Model()).found


def diagnose(run: Run, model: Model | None = None, without: str = '') -> Diagnosis:
    """Return the Diagnosis of a run under a model (the base model if none is given).

    without: the name of an effect that the library shall not have. The same run gives the same answer. Raises
    NotDeterminable where the run does not determine the model, InvalidData where its times, temperatures or travels are
    such that no calculation ends.
    """
    with _bounded(run):
        model = model or Model()
        return (RunDiagnosis(run, model, without) if without else known_of(run, model)).complete


def explanations_as_fits(run: Run, model: Model) -> Explained:
    """Return the likely explanations of a run, each with its probability and fit; errors as of `diagnose`."""
    with _bounded(run):
        return known_of(run, model).explained


class RunDiagnosis:
    """What is known of a run under a model: each part is calculated once, where it is asked for."""

    def __init__(self, run: Run, model: Model, without: str = '') -> None:
        """Search a run; without: as of `diagnose`."""
        self.search = RunSearch(run, model, without)
        self.claims = Claims(self.search)

    @cached_property
    def explained(self) -> Explained:
        """The likely explanations as fits."""
        return explained_fits(self.search)

    @cached_property
    def found(self) -> Diagnosis:
        """The Diagnosis without candidates and shapes."""
        search, claims = self.search, self.claims
        final = claims.fit
        if claims.members:
            final = over_all(final, self.explained)

        lacking = fitted_effects(search, final, claims.named)
        hidden, useless = _invisible(search, [one.name for one in lacking]), not_needed(search.start)
        verdict = decide(replace(
            facts_of(search.start, final, claims.unnamed), missing=lacking, doubtful=claims.doubtful,
            is_open=bool(lacking or claims.unnamed) and search.posterior.is_open,
            hidden=strongest_first(search.run, hidden, search.model.base), not_needed=useless))
        if not verdict.model_fails:
            verdict = replace(verdict, unseen=unseen(final))

        terms, posterior = tuple(Term(one.family.effect, one.setting, True) for one in claims.members), search.posterior
        return Diagnosis(
            search.model, search.start, final, lacking, terms, claims.unnamed, claims.told, hidden, useless,
            posterior.explanations(), posterior.nothing, posterior.unnamed, verdict)

    @property
    def complete(self) -> Diagnosis:
        """The Diagnosis with candidates and shapes."""
        found, members = self.found, self.claims.members
        others, refused = candidates_of(self.search, members, found.final)
        unavailable = tuple((name, reason) for name, effect in effects_of(self.search.run).items()
                            if (reason := why_not_judged(effect, self.search.run)))
        return replace(found, candidates=(*found.claimed, *others), unavailable=(*unavailable, *refused),
                       recovered=recovered_shapes(self.claims.chosen, members))


@lru_cache(maxsize=1)
def known_of(run: Run, model: Model = Model()) -> RunDiagnosis:  # noqa: B008 (it is frozen)
    """Return what is known of a run under a model."""
    return RunDiagnosis(run, model)


def search_of(run: Run, model: Model = Model()) -> RunSearch:  # noqa: B008 (it is frozen)
    """Return the search on a run under a model."""
    return known_of(run, model).search


def _invisible(search: RunSearch, missing: list[str]) -> tuple[str, ...]:
    """Return the effects that the order hides at every setting, but for those that the model has or lacks."""
    shares, known = search.readings.white.sensitivities, {*missing, *(term.name for term in search.base.model.terms)}
    return tuple(name for name in effects_of(search.run) if name not in known and shares.get(name, 1.0) < HIDDEN_SHARE)


def fitted_with_noise(run: Run, model: Model, white: Fit, is_searched: bool) -> Fit:
    """Return the fit of a model under the noise of a run; white: that under white noise.

    is_searched: whether effects that the model lacks are distinguished from noise by a search; else the noise is that
    beside the model alone. Raises NotDeterminable where the run does not determine the model.
    """
    if white.rms < NOISELESS:
        return white
    kinds = noise_beside(white)
    if not kinds.may_be:
        return white
    if is_searched:
        with _bounded(run):
            return search_of(run, model).start
    noise = kinds.found()[0].noise
    return white if not noise.kinds else fit(run, model, choose_settings(run, model, noise), noise)


@contextmanager
def _bounded(run: Run) -> Iterator[None]:
    """Turn an iteration without end into InvalidData."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise InvalidData(f'{run.source}: cannot be diagnosed ({error}); check its times, temperatures and '
                          'travels') from error
