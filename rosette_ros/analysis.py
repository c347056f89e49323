# SPDX-License-Identifier: Apache-2.0
"""The analysis of a run in pure functions: every interface calls them and none does an analysis of its own.

A run and a model give a fit (`analyse`), the one verdict (`judge`), the place where the model fails (`compare`), the
effect that is missing (`diagnose`), what changes when an effect is added or removed (`change`, `ladder`), whether
another run confirms it (`cross_check`), the next measurement (`advise`, `advise_run`), and all of it (`summarise`).
Several runs give one evaluation (`evaluate_jointly`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rosette_ros.core.diagnosis import comparison as comparison
from rosette_ros.core.diagnosis import second_run
from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.cross_validation import cross_validation_rms
from rosette_ros.core.diagnosis.diagnosis import (
    MOST_BALLS_JUDGED,
    Diagnosis,
    diagnose,
    find,
    fitted_with_noise,
    judge,
)
from rosette_ros.core.diagnosis.effect_settings import choose_settings, families_of_terms
from rosette_ros.core.diagnosis.run_result import (
    RunCurves,
    RunResult,
    Which,
    explanations_of,
    in_environment,
    stated_budget,
)
from rosette_ros.core.diagnosis.second_run import CrossCheck
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.joint.joint_evaluation import evaluate_jointly
from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.planning.advice import Advice, advise, advise_run
from rosette_ros.core.planning.next_readings import NextReadings as NextReadings
from rosette_ros.core.planning.next_readings import next_readings as next_readings
from rosette_ros.core.run.axes import refuse_other_axes
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import ErrorMotions, Floats, Run
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.core.sight.visibility import Visibility, visibility
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.error_summary import Conformity, Judgement, doubt_of, fit_lines, worst_of
from rosette_ros.core.uncertainty.hidden_effects import unseen as unseen
from rosette_ros.core.uncertainty.stated_environment import Environment

STEPS = ('evaluate', 'compare', 'diagnose', 'ladder', 'advise')
"""Parts of a summary in the order in which they are calculated."""
MOST_BALLS_ADVISED = 24
"""On larger plates the orders are compared on request only: it would take longer than all the rest."""


def analyse(run: Run, model: Model | None = None) -> Fit:
    """Return the Fit of a run under a model (the base model if none is given), and the noise that the run has.

    Raises NotDeterminable where the run does not determine the model.
    """
    model = model or Model()
    return fitted_with_noise(run, model, fit(run, model, choose_settings(run, model)), run.n <= MOST_BALLS_JUDGED)


def result(run: Run, model: Model | None = None, inputs: BudgetInputs | None = None,
           refit: SphereRefit | None = None) -> RunResult:
    """Return the RunResult of a run; what is missing is looked for on plates of at most MOST_BALLS_JUDGED.

    inputs, refit: as of RunResult; model and NotDeterminable: as of `analyse`."""
    fitted = analyse(run, model)
    found = find(fitted.run, fitted.model) if run.n <= MOST_BALLS_JUDGED else None
    return RunResult(fitted, found, inputs, refit)


def conformity_of(fitted: Fit, verdict: Judgement | None, tolerances: Mapping[str, Tolerance]) -> Conformity | None:
    """Return what a fit says of all its tolerances together: the worst of them; None where none is stated."""
    return worst_of(line.conformity for line in fit_lines(fitted, tolerances, doubt_of(verdict)))


def curves_over(first: Run, other: Run, model: Model | None = None) -> ErrorMotions:
    """Return the curves of another run along the axes of a first one, to be drawn over its curves.

    Between the steps of the table x and y are turned by its offset. Raises InvalidData where the other run is of a
    table about another axis; model and NotDeterminable: as of `analyse`.
    """
    refuse_other_axes([(run.run_id or run.source, run.rotation) for run in (first, other)])
    return result(other, model).curves.motions.turned_back(other.table_offset - first.table_offset)


def compare(run: Run, model: Model | None = None) -> Comparison:
    """Return the Comparison of a model with a run: where the residual is, and by how much of sigma."""
    return comparison.compare(analyse(run, model))


@dataclass(frozen=True, eq=False)
class LadderStep:
    """A model of a ladder: the effect added last ('' for the base model), and the error of its cross-validation, m."""

    added: str
    fit: Fit
    cross_validation: float

    @classmethod
    def of(cls, fit: Fit, cross_validation: float) -> 'LadderStep':
        """Return the step to the model of a fit, whose last effect is the one added."""
        return cls(str(fit.model.terms[-1]) if fit.model.terms else '', fit, cross_validation)


@dataclass(frozen=True, eq=False)
class Change:
    """What changes when a model is replaced by another on the same run.

    cross_validation_before, cross_validation_after: error of the cross-validation, m; curve_change: largest change of
    each curve, (6,), m and rad; helps, hurts: whether that residual falls or rises by more than chance.
    """

    before: Fit
    after: Fit
    cross_validation_before: float
    cross_validation_after: float
    curve_change: Floats
    helps: bool
    hurts: bool


def change(run: Run, before: Model, after: Model, known: Sequence[LadderStep] = ()) -> Change:
    """Return the Change from model `before` to model `after` on a run; known: as of `ladder`."""
    (old, error), (new, left) = ((one.fit, one.cross_validation) for one in (
        _step(run, model, known) for model in (before, after)))
    shift = np.abs(new.error_motions.values - old.error_motions.values).max(axis=0)
    # in units of sigma^2 the square sum of 3 N errors falls by more than 12 + 2 k by chance for k parameters in less
    # than one of a thousand cases (chi square of the gain), and by 2 ln m more for the best of m settings
    extra = abs(new.dof - old.dof) + abs(_log_settings(run, after) - _log_settings(run, before))
    chance = 1 - (12 + 2 * extra) / (6 * run.size)
    return Change(old, new, error, left, shift, bool(left < error * chance), bool(error < left * chance))


def _log_settings(run: Run, model: Model) -> float:
    """Return the logarithm of the number of settings of which those of the effects of a model are the best."""
    return float(sum(np.log(len(family.settings)) for family in families_of_terms(run, model)))


def ladder(run: Run, model: Model, known: Sequence[LadderStep] = ()) -> tuple[LadderStep, ...]:
    """Return the LadderSteps from the base terms of a model to the whole of it, effect after effect.

    known: steps of the same run, which are not calculated again.
    """
    return tuple(_step(run, replace(model, terms=model.terms[:count]), known)
                 for count in range(len(model.terms) + 1))


def _step(run: Run, model: Model, known: Sequence[LadderStep]) -> LadderStep:
    for step in known:
        if step.fit.model == model:
            return step
    found = analyse(run, model)
    return LadderStep.of(found, cross_validation_rms(found))


def claimed_model(diagnosis: Diagnosis) -> Model:
    """Return the Model with all that a diagnosis claims; the settings of an effect that stands twice are fixed."""
    names = [term.name for term in (*diagnosis.model.terms, *diagnosis.terms)]
    claimed = tuple(term if names.count(term.name) > 1 else Term(term.effect) for term in diagnosis.terms)
    return replace(diagnosis.final.model, terms=(*diagnosis.model.terms, *claimed), repeated=False)


def cross_check(run: Run, diagnosis: Diagnosis) -> CrossCheck:
    """Return the CrossCheck on a run of what a diagnosis of another run claims; raises InvalidData for the same."""
    second_run.refuse_same(run, diagnosis.fit.run)
    learnt = diagnosis.final.effects[len(diagnosis.final.effects) - len(diagnosis.terms):]
    model = replace(diagnosis.final.model, terms=diagnosis.model.terms, repeated=False)
    return second_run.cross_check(run, model, tuple(zip((term.effect for term in diagnosis.terms), learnt)))


@dataclass(frozen=True, eq=False)
class Summary:
    """All results of one run under one model.

    fit, comparison, diagnosis: of the model as given; ladder: from the base model over the model to all that is
    claimed, effect after effect, () where it was not asked for; advice: for the next run, None where there are too many
    balls to compare orders unasked; environment: that is stated, None where none is.
    """

    fit: Fit
    comparison: Comparison
    diagnosis: Diagnosis
    ladder: tuple[LadderStep, ...]
    advice: Advice | None
    environment: Environment | None = None

    @property
    def run(self) -> Run:
        """The run."""
        return self.fit.run

    @property
    def model(self) -> Model:
        """The model as given."""
        return self.fit.model

    @property
    def final(self) -> Fit:
        """The Fit with all that is claimed: the best account of the run."""
        return self.diagnosis.final

    @cached_property
    def result(self) -> RunResult:
        """The result, and the fit as modelled beside it."""
        return RunResult(self.fit, self.diagnosis, BudgetInputs(environment=self.environment))

    @property
    def verdict(self) -> Verdict:
        """The one verdict."""
        return in_environment(self.diagnosis.verdict, self.final, self.environment)

    @cached_property
    def visibilities(self) -> tuple[Visibility, ...]:
        """Visibility of every effect in the order in which this run was measured."""
        if self.advice is not None:
            return self.advice.present.visibilities
        return visibility(self.run, self.run.repeatability or self.final.sigma)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a run: steps of its ladders, and the advice for the next run."""

    steps: tuple[LadderStep, ...] = ()
    advice: Advice | None = None


def summarise(run: Run, model: Model | None = None, on_step: Callable[[str], object] | None = None,
              on_part: Callable[[str, object], object] | None = None, known: Known | None = None,
              has_ladder: bool = True) -> Summary:
    """Return the Summary of a run under a model (the base model if none is given).

    on_step: called with the name of each of STEPS before it is calculated; on_part: with 'fit' and with 'ladder', the
    one up to the model as given, as soon as they are there; known: of the run, is not calculated again; has_ladder:
    whether it is asked for. Raises NotDeterminable where the run does not determine the model.
    """
    step, part = on_step or (lambda name: None), on_part or (lambda name, value: None)
    model, known = model or Model(), known or Known()
    step('evaluate')
    given = next((one for one in known.steps if one.fit.model == model), None)
    found = given.fit if given else analyse(run, model)
    part('fit', found)
    step('compare')
    compared = comparison.compare(found)
    step('diagnose')
    diagnosis = diagnose(run, model)
    steps: tuple[LadderStep, ...] = ()
    if has_ladder:
        step('ladder')
        given = given or LadderStep.of(found, cross_validation_rms(found))
        before = ladder(run, model, (*known.steps, given))
        part('ladder', before)
        steps = ladder(run, claimed_model(diagnosis), before)
        if diagnosis.terms:  # what the search found, which a search by name may miss by a little
            steps = (*steps[:-1], replace(steps[-1], fit=diagnosis.final))
    step('advise')
    advice = known.advice or (advise_run(run) if run.n <= MOST_BALLS_ADVISED else None)
    return Summary(found, compared, diagnosis, steps, advice)


__all__ = [
    'MOST_BALLS_ADVISED', 'MOST_BALLS_JUDGED', 'STEPS', 'Change', 'Known', 'LadderStep', 'RunCurves', 'RunResult',
    'Summary', 'Verdict', 'Which', 'advise', 'advise_run', 'analyse', 'change', 'claimed_model', 'compare',
    'cross_check', 'diagnose', 'evaluate_jointly', 'explanations_of', 'find', 'in_environment', 'judge', 'ladder',
    'result', 'stated_budget', 'summarise']
