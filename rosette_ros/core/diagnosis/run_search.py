# SPDX-License-Identifier: Apache-2.0
"""The search on one run: its fits, its evidence under any noise, and the one function that explains it.

`explain` is the search: whatever returns a Posterior of a RunEvidence can stand in its place.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cache, cached_property

import numpy as np

from rosette_ros.core.diagnosis.base_terms import missing_base
from rosette_ros.core.diagnosis.effect_settings import RELINEARISED, choose_settings, evidence_of
from rosette_ros.core.diagnosis.hypotheses import Search
from rosette_ros.core.diagnosis.log_evidence import NOISELESS, Evidence, Member, Place
from rosette_ros.core.diagnosis.noise_hypotheses import choose
from rosette_ros.core.diagnosis.null_gains import null_gains, p_of
from rosette_ros.core.diagnosis.posterior import Posterior
from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.model.second_order import NEGLIGIBLE
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.sight.bank import Bank, families_of
from rosette_ros.core.sight.priors import with_priors

HOPEFUL = 12
"""Sets of variables whose free courses are looked at under other noise: those that explain most in white noise."""


class RunEvidence:
    """The readings of a run under a model and under any noise, and the bank of candidates.

    given: the fit of the model in white noise; absent: terms of the base model that it lacks and the run asks for;
    base: the fit with these.
    """

    def __init__(self, run: Run, model: Model, without: str = '') -> None:
        """Take a run and a model; without: the name of an effect that the library shall not have."""
        self.run, self.model = run, model
        self.settings = choose_settings(run, model)
        self.given = self.base = fit(run, model, self.settings)
        self.absent = missing_base(run, self.given)
        if self.absent:
            self.base = self.fitted(self.given.noise, None)
        families = [one for one in families_of(run) if one.name != without]
        self.bank = Bank(run, with_priors(families, experience=model.experience) if not self.is_noiseless else ())
        self.white = evidence_of(self.base, self.bank)

    @property
    def is_noiseless(self) -> bool:
        """Whether what is left is too little to be searched."""
        return self.base.rms < NOISELESS

    def fitted(self, noise: Noise, beyond: Floats | None) -> Fit:
        """Return the fit of the model with its absent base terms under a noise; beyond: (N, 3), second-order terms."""
        model = replace(self.model, base=(*self.model.base, *self.absent))
        return fit(self.run, model, self.settings, noise, beyond=beyond)

    def about(self, beyond: Floats) -> 'RunEvidence':
        """Return the same with other second-order terms (N, 3)."""
        other = copy(self)
        other.base = self.fitted(self.base.noise, beyond)
        other.white = self.white.on(other.base.white_residual)
        return other

    def under(self, noise: Noise, bank: Bank) -> Evidence:
        """Return the evidence of the candidates of a bank under a noise."""
        return evidence_of(self.fitted(noise, self.base.beyond), bank)


def explain(evidence: RunEvidence) -> Posterior:
    """Return what explains a run: the one search, in white noise, then what is hopeful there under other noise."""
    if evidence.is_noiseless:
        return Posterior({((), ()): (0.0, ())}, evidence.white.empty, evidence.base.noise,
                         evidence.base.beyond)
    evidence, white = _to_second_order(evidence)

    @cache
    def few() -> Bank:
        return Bank(evidence.run, white.hopeful(HOPEFUL), evidence.bank)

    return choose(white, evidence.base, lambda noise: Search(evidence.under(noise, few())))


def _to_second_order(evidence: RunEvidence) -> tuple[RunEvidence, Search]:
    """Return the evidence with the second-order terms of what is found in white noise, and the search that found it."""
    for _ in range(RELINEARISED):
        search = Search(evidence.white)
        named = search.grown_of_names.members
        beyond = with_places(evidence.base, [one.place for one in named]).beyond if named else evidence.base.beyond
        if np.abs(beyond - evidence.base.beyond).max() <= NEGLIGIBLE:
            break
        evidence = evidence.about(beyond)
    return evidence, search


def with_places(base: Fit, places: Sequence[Place]) -> Fit:
    """Return the joint fit of a model with families at settings added, under the same noise."""
    terms = tuple(Term(family.effect) for family, _ in places)
    model = replace(base.model, terms=(*base.model.terms, *terms), repeated=True)
    return fit(base.run, model, (*base.settings, *(setting for _, setting in places)), base.noise, base.joint.space)


class RunSearch:
    """What the search finds on one run.

    readings: as they were searched; posterior: of all hypotheses; chosen: the State of the best one, evidence: that
    under its noise; start, base: the fits of the model as given and with the absent base terms, under that noise.
    """

    def __init__(self, run: Run, model: Model, without: str = '') -> None:
        """Search a run; arguments as of RunEvidence."""
        self.run, self.model = run, model
        self.readings = RunEvidence(run, model, without)
        self.posterior = posterior = explain(self.readings)
        self.chosen, self.evidence = posterior.state, posterior.state.evidence

        if posterior.beyond is not None and posterior.beyond is not self.readings.base.beyond:
            self.readings = self.readings.about(posterior.beyond)
        readings, noise = self.readings, posterior.noise
        self.absent, self.noiseless = readings.absent, readings.is_noiseless
        self.start, self.base = readings.given, readings.base
        if noise is not self.base.noise:
            self.base = readings.fitted(noise, self.base.beyond)
            self.start = fit(run, model, readings.settings, noise, beyond=self.start.beyond)

    def with_members(self, members: Sequence[Member]) -> Fit:
        """Return the joint fit of the model with members added, under the noise of the run."""
        return with_places(self.base, [one.place for one in members])

    @cached_property
    def null(self) -> Floats:
        """What the best hypothesis is worth in runs of pure noise, falling."""
        return null_gains(self.evidence, self.base)

    def p(self, gain: float) -> float:
        """Return the search-wide probability that noise makes anything worth as much."""
        return p_of(gain, self.null)
