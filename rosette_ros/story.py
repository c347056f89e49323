# SPDX-License-Identifier: Apache-2.0
"""All that is told of one run, worked out once: what the report prints and the studio shows.

Every part is of `analysis`; here they are only put in the order in which a person asks for them.
"""

from dataclasses import dataclass
from functools import cached_property

from rosette_ros.analysis import (
    Report,
    Rung,
    advise_run,
    analyse,
    claimed_model,
    compare,
    diagnose,
    ladder,
)
from rosette_ros.core.advice import Advice
from rosette_ros.core.compare import Comparison
from rosette_ros.core.diagnosis import Diagnosis
from rosette_ros.core.model import Model
from rosette_ros.core.visibility import visibility

GOOD, DOUBTFUL, BAD = 'good', 'doubtful', 'bad'
"""What a verdict can be: the model fits; it cannot be said or something stays open; it fails."""
STEPS = ('evaluate', 'compare', 'diagnose', 'ladder', 'advise')
MOST_BALLS_ADVISED = 24
"""Above so many balls the orders are not compared unasked: it would take longer than all the rest."""


@dataclass(frozen=True)
class Verdict:
    """What a person reads first: how it stands, one sentence, and what to do."""

    level: str
    sentence: str
    action: str


@dataclass(frozen=True, eq=False)
class Story:
    """One run under one model, told to the end.

    report, comparison, diagnosis: of the model as it was given; rungs: from the base model over the
    model to all that is claimed, effect after effect; advice: for the next run, None where there are
    too many balls to compare orders unasked.
    """

    report: Report
    comparison: Comparison
    diagnosis: Diagnosis
    rungs: tuple[Rung, ...]
    advice: Advice | None
    verdict: Verdict

    @property
    def run(self):
        """The Run."""
        return self.report.run

    @property
    def model(self):
        """The Model that was asked about."""
        return self.report.model

    @property
    def final(self):
        """The Report with all that is claimed: the best account of the run."""
        return self.rungs[-1].report

    @cached_property
    def visibilities(self):
        """Visibility of every effect in the order in which this run was measured."""
        if self.advice is not None:
            return self.advice.present.visibilities
        return visibility(self.run, self.run.repeatability or self.final.fit.sigma)


def tell(run, model=None, on_step=None):
    """Return the Story of a run under a model (the base model if none is given).

    on_step: called with the name of each of STEPS before it is worked out.

    Raises NotDeterminable where the run cannot tell what the model asks.
    """
    step = on_step or (lambda name: None)
    model = model or Model()
    step('evaluate')
    report = analyse(run, model)
    step('compare')
    comparison = compare(run, model)
    step('diagnose')
    diagnosis = diagnose(run, model)
    step('ladder')
    rungs = ladder(run, claimed_model(diagnosis))
    step('advise')
    advice = advise_run(run) if run.n <= MOST_BALLS_ADVISED else None
    return Story(report, comparison, diagnosis, rungs, advice, verdict_of(diagnosis, advice))


def verdict_of(diagnosis, advice=None):
    """Return the Verdict on a diagnosis: one sentence, and what to do about it."""
    rms, final = (f'{1e6 * one.rms:#.3g} µm' for one in (diagnosis.fit, diagnosis.final))
    names = ' and '.join(diagnosis.missing)
    it = 'it' if len(diagnosis.missing) == 1 else 'them'
    steps = [f'Look after {names} in the cell, or add {it} to the model'] if names else []
    if diagnosis.invisible and advice is not None and advice.best.label != advice.present.label:
        steps.append(f'measure next in order {advice.best.label}, which shows what this order hides')
    if diagnosis.missing and not diagnosis.unexplained:
        level, sentence = BAD, (f'The model lacks {names}; with {it} the residual falls from {rms} '
                                f'to {final}.')
    elif diagnosis.missing:
        level, sentence = BAD, (f'The model lacks {names}; with {it} the residual falls from {rms} to '
                                f'{final}, and something is left that no named effect explains.')
    elif diagnosis.unexplained:
        level, sentence = BAD, ('The model does not explain the readings, and no effect of the '
                                f'library does: {diagnosis.unexplained_text}.')
        steps.insert(0, 'Look at the residual maps, and at what it depends on')
    elif diagnosis.fit.run.repeatability is None:
        level, sentence = DOUBTFUL, (f'Nothing is missing that this run can show; its residual of '
                                     f'{rms} cannot be held against the repeatability, which is '
                                     'not known.')
        steps.insert(0, 'Measure the repeatability')
    else:
        level, sentence = GOOD, (f'The model explains the readings: the residual of {rms} is '
                                 'noise.')
    text = '; '.join(steps)
    return Verdict(level, sentence, f'{text[:1].upper()}{text[1:]}.' if text else
                   'Nothing needs to be done.')
