# SPDX-License-Identifier: Apache-2.0
"""The story in one pure function: a run and a model give a report; every door calls it."""

from dataclasses import dataclass

from rosette_ros.core.base import GAUGE
from rosette_ros.core.fit import Fit, fit
from rosette_ros.core.model import Model
from rosette_ros.core.records import ErrorMotions, Run
from rosette_ros.core.settings import choose_settings


@dataclass(frozen=True, eq=False)
class Report:
    """What a run says under a model: error motions, plate and CMM deviations, fit, effects."""

    run: Run
    model: Model
    fit: Fit

    @property
    def error_motions(self) -> ErrorMotions:
        """The six curves with standard uncertainties."""
        return self.fit.error_motions

    @property
    def plate(self):
        """Plate deviations P, (n, 3), m, in the plate's frame."""
        return self.fit.plate

    @property
    def cmm(self):
        """CMM deviations M, (n, 3), m, in the table frame."""
        return self.fit.cmm

    @property
    def effects(self):
        """The fitted effects, a tuple of FittedEffect."""
        return self.fit.effects

    @property
    def gauge(self):
        """What no three-rosette run can know, in words."""
        return GAUGE


def analyse(run, model=None, weight=None):
    """Return the Report of a run under a model (the base model if none is given).

    run: Run; model: Model or None; weight: (N,) inverse relative variances, or None.

    Raises NotDeterminable where the run cannot tell what the model asks.
    """
    model = model or Model()
    return Report(run, model, fit(run, model, choose_settings(run, model), weight))
