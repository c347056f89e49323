# SPDX-License-Identifier: Apache-2.0
"""The result of a run: one set of six curves with U, beside it the fit as modelled; every interface takes this."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

from rosette_ros.core.diagnosis.diagnosis import Diagnosis, explanations_as_fits
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.core.sight.visibility import Visibility
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.error_summary import LACKING, AxisError, doubt_of, refuted
from rosette_ros.core.uncertainty.hidden_effects import MOST_BALLS, unseen
from rosette_ros.core.uncertainty.stated_environment import Environment
from rosette_ros.core.uncertainty.uncertainty_budget import Budget, budget, stated_lines, touch_scatter


class Which(StrEnum):
    """Which curves of a run they are."""

    AVERAGED = 'all explanations averaged'
    MODELLED = 'as modelled'


@dataclass(frozen=True, eq=False)
class RunCurves:
    """Six curves of a run.

    fit: whose curves they are; budget: whose U they have, None for that of the fit; doubt: why no conformity with a
    tolerance is stated, '' where it is."""

    which: Which
    fit: Fit
    budget: Budget | None
    doubt: str

    @cached_property
    def motions(self) -> ErrorMotions:
        """The curves with their standard uncertainties."""
        return self.lines_with()[0]

    def lines(self, tolerances: Mapping[str, Tolerance] | None = None) -> tuple[AxisError, ...]:
        """Return the six error motions in a line each; tolerances: of ranges by curve, m and rad."""
        return self.lines_with(tolerances)[1]

    def lines_with(self, tolerances: Mapping[str, Tolerance] | None = None,
                   ) -> tuple[ErrorMotions, tuple[AxisError, ...]]:
        """Return the curves and their lines."""
        return stated_lines(self.fit, self.budget, tolerances, self.doubt)


@dataclass(frozen=True, eq=False)
class RunResult:
    """What a run says of its table: the curves that count, and those as modelled.

    fit: of the model as given; found: what it lacks, None where that was not asked; inputs: stated for the uncertainty
    budget, None for nothing; refit: the spheres of the touches, where there are any."""

    fit: Fit
    found: Diagnosis | None = None
    inputs: BudgetInputs | None = None
    refit: SphereRefit | None = None

    @property
    def verdict(self) -> Verdict | None:
        """The one verdict, in the environment that is stated; None where it was not asked for."""
        found, inputs = self.found, self.inputs
        return in_environment(found.verdict, found.final, inputs.environment if inputs else None) if found else None

    @cached_property
    def curves(self) -> RunCurves:
        """The result: over all explanations where something is missing, else as modelled."""
        if self.found is None or not self.found.lacks:
            return self.modelled
        return RunCurves(Which.AVERAGED, self.found.final, self._budget_of(self.found.final, ''), LACKING)

    @cached_property
    def modelled(self) -> RunCurves:
        """Those of the model as given."""
        doubt = refuted(self.verdict)
        return RunCurves(Which.MODELLED, self.fit, self._budget_of(self.fit, doubt), doubt_of(self.verdict))

    @property
    def beside(self) -> RunCurves | None:
        """Those as modelled where they are not the result."""
        return None if self.curves is self.modelled else self.modelled

    @cached_property
    def budget(self) -> Budget | None:
        """The budget of the result, also where nothing is stated; None where there is none of so large a plate, or of a
        model without error motions."""
        fit = self.curves.fit
        return None if fit.run.n > MOST_BALLS or 'table_motions' not in fit.model.base else self.budget_with()

    def budget_with(self, hidden: Sequence[Visibility] | None = None) -> Budget:
        """Return the budget of the result; hidden, and InvalidData: as of `budget`."""
        if self.curves.budget and hidden is None:
            return self.curves.budget
        doubt = refuted(self.verdict) if self.beside is None else ''
        return stated_budget(self.curves.fit, self.inputs, self.found, doubt, self.refit, hidden)

    def _budget_of(self, fitted: Fit, doubt: str) -> Budget | None:
        if self.inputs is None or not self.inputs.is_stated:
            return None
        return stated_budget(fitted, self.inputs, self.found, doubt, self.refit)


def in_environment(verdict: Verdict, final: Fit, environment: Environment | None) -> Verdict:
    """Return the verdict on a run with what U of its final fit contains in an environment, None where none is stated.
    """
    return verdict if environment is None else replace(verdict, unseen=unseen(final, environment))


def explanations_of(found: Diagnosis, fitted: Fit) -> tuple[tuple[float, Fit], ...]:
    """Return the explanations of a run, fits with probabilities; none for a fit that lacks what is claimed."""
    return fitted.explanations if found.lacks else explanations_as_fits(found.fit.run, found.model)


def stated_budget(fitted: Fit, inputs: BudgetInputs | None, found: Diagnosis | None, doubt: str,
                  refit: SphereRefit | None = None, hidden: Sequence[Visibility] | None = None) -> Budget:
    """Return the budget of a fit, with the explanations found in the run where an environment is stated.

    doubt: as of `refuted`; refit: the spheres of the touches, where there are any; hidden: as of `budget`."""
    explanations = explanations_of(found, fitted) if found and inputs and inputs.environment else ()
    return budget(fitted, inputs, touch_scatter(refit), hidden, doubt, explanations)
