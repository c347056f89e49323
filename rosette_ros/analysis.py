# SPDX-License-Identifier: Apache-2.0
"""The story in pure functions: every door calls them and none does an analysis of its own.

A run and a model give a report (`analyse`), the place where the model fails (`compare`), the
effect that is missing (`diagnose`), what changes when an effect comes or goes (`change`, `ladder`),
whether another run confirms it (`cross_check`), and the next measurement (`advise`, `advise_run`).
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core import compare as comparison
from rosette_ros.core import crosscheck
from rosette_ros.core.advice import advise, advise_run
from rosette_ros.core.base import GAUGE
from rosette_ros.core.diagnosis import diagnose, held_out_rms
from rosette_ros.core.fit import Fit, fit
from rosette_ros.core.model import Model, Term
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


def compare(run, model=None):
    """Return the Comparison of a model with a run: where it fails, and by how much of sigma."""
    return comparison.compare(analyse(run, model).fit)


@dataclass(frozen=True, eq=False)
class Change:
    """What changes when a model is replaced by another on the same run.

    before, after: Report; held_out_before, held_out_after: error in left-out readings, m;
    curve_change: largest change of each curve, (6,), m and rad; helps, hurts: whether the error in
    readings that the fit did not use falls or rises by more than chance.
    """

    before: Report
    after: Report
    held_out_before: float
    held_out_after: float
    curve_change: np.ndarray
    helps: bool
    hurts: bool


def change(run, before, after):
    """Return the Change from model `before` to model `after` on a run."""
    reports = analyse(run, before), analyse(run, after)
    held = [held_out_rms(run, report.fit) for report in reports]
    shift = np.abs(reports[1].error_motions.values - reports[0].error_motions.values).max(axis=0)
    # in units of sigma^2 the square sum of 3 N left-out errors falls by more than 12 + 2 k by chance
    # for k amplitudes in less than one of a thousand cases (chi square of the gain)
    extra = abs(reports[1].fit.rank - reports[0].fit.rank)
    chance = 1 - (12 + 2 * extra) / (6 * run.size)
    return Change(*reports, *held, shift, bool(held[1] < held[0] * chance),
                  bool(held[0] < held[1] * chance))


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of a ladder: the effect that came last ('' for the base model) and its errors.

    report: Report; held_out: error in left-out readings, m.
    """

    added: str
    report: Report
    held_out: float


def ladder(run, model):
    """Return the Rungs from the base terms of a model to the whole of it, effect after effect."""
    rungs = []
    for count in range(len(model.terms) + 1):
        part = Model(model.base, model.terms[:count], model.repeated)
        report = analyse(run, part)
        added = str(model.terms[count - 1]) if count else ''
        rungs.append(Rung(added, report, held_out_rms(run, report.fit)))
    return tuple(rungs)


def claimed_model(diagnosis):
    """Return the Model with all that a diagnosis claims; what stands twice has its settings fixed."""
    names = [term.name for term in (*diagnosis.model.terms, *diagnosis.terms)]
    claimed = tuple(term if names.count(term.name) > 1 else Term(term.effect)
                    for term in diagnosis.terms)
    return Model(diagnosis.final.model.base, (*diagnosis.model.terms, *claimed))


def cross_check(run, diagnosis):
    """Return the CrossCheck on a run of what a diagnosis of another run claims."""
    learnt = diagnosis.final.effects[len(diagnosis.final.effects) - len(diagnosis.terms):]
    model = Model(diagnosis.final.model.base, diagnosis.model.terms)
    return crosscheck.cross_check(
        run, model, tuple((term.effect, fitted)
                          for term, fitted in zip(diagnosis.terms, learnt)))


__all__ = [
    'Change',
    'Report',
    'Rung',
    'advise',
    'advise_run',
    'analyse',
    'change',
    'claimed_model',
    'compare',
    'cross_check',
    'diagnose',
    'ladder',
]
