# SPDX-License-Identifier: Apache-2.0
"""The model in use and the last runs, and what is asked about them. No ROS here."""

from dataclasses import dataclass

from rosette_ros.analysis import Report, analyse, diagnose
from rosette_ros.core.base import BASE_TERMS
from rosette_ros.core.errors import InvalidData, InvalidModel, NotDeterminable
from rosette_ros.core.model import Model
from rosette_ros.core.records import Run
from rosette_ros.data.model_file import parse_entry
from rosette_ros.nodes.gathering import RUNS_KEPT


@dataclass(frozen=True, eq=False)
class Exchange:
    """A run under the old and the new model; before: None where the old one did not fit at all."""

    run: Run
    model_before: Model
    before: Report | None
    after: Report

    @property
    def words(self):
        """What has changed, for a person."""
        before = f'{1e6 * self.before.fit.rms:.4g}' if self.before else 'undetermined'
        return (f'run {self.run.run_id}: model {self.after.model}; residual {before} -> '
                f'{1e6 * self.after.fit.rms:.4g} um')


class Analyst:
    """Evaluates and diagnoses runs under one model, which questions may change."""

    def __init__(self, model):
        """Start with a model and without runs."""
        self.model = model
        self._runs = {}

    def evaluate(self, run):
        """Return the Report of a run and keep the run for questions."""
        self._runs.pop(run.run_id, None)
        self._runs[run.run_id] = run
        while len(self._runs) > RUNS_KEPT:
            del self._runs[next(iter(self._runs))]
        return analyse(run, self.model)

    def run(self, run_id=''):
        """Return a run that was kept, the last one if none is named; raises InvalidData."""
        if not self._runs:
            raise InvalidData('wanted a run, got none yet: calibrate first')
        if not run_id:
            return next(reversed(self._runs.values()))
        if run_id not in self._runs:
            raise InvalidData(f'run_id: wanted one of {", ".join(self._runs)} (the last '
                              f'{RUNS_KEPT} are kept), got {run_id!r}')
        return self._runs[run_id]

    def diagnose(self, run_id=''):
        """Return (Run, Diagnosis); raises RosetteError in words."""
        run = self.run(run_id)
        return run, diagnose(run, self.model)

    def add(self, run_id, effect, definition=''):
        """Add an effect to the model, fit a run again and return the Exchange.

        effect: name; definition: YAML, settings to be fixed or the user's own term. The model stays
        as it was where an error is raised: InvalidModel, NotDeterminable, InvalidData.
        """
        run = self.run(run_id)
        return self._exchange(run, extended(self.model, effect, definition), analyse(
            run, self.model))

    def remove(self, run_id, effect):
        """Remove an effect from the model, fit a run again and return the Exchange; see `add`."""
        run = self.run(run_id)
        model = self.model.without_effect(effect)
        try:
            before = analyse(run, self.model)
        except NotDeterminable:
            before = None  # which may be the very reason for removing the effect
        return self._exchange(run, model, before)

    def _exchange(self, run, model, before):
        after = analyse(run, model)
        before_model, self.model = self.model, model
        return Exchange(run, before_model, before, after)


def extended(model, effect, definition=''):
    """Return a model with an effect more; definition: YAML as of AddEffect.srv.

    Raises InvalidModel in words.
    """
    entry = parse_entry(definition, 'definition')
    if 'own' in entry:
        if effect not in ('', entry['own']):
            raise InvalidModel(f'effect: wanted {entry["own"]!r} as in the definition, or nothing, '
                               f'got {effect!r}')
        return model.with_entry(entry)
    if effect in BASE_TERMS:
        if entry:
            raise InvalidModel(f'definition: wanted none, {effect} has no settings, got '
                               f'{", ".join(entry)}')
        return model.with_effect(effect)
    if 'name' in entry and entry.pop('name') != effect:
        raise InvalidModel(f'definition: name: wanted {effect!r} as in `effect`')
    return model.with_effect(effect, entry)
