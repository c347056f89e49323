# SPDX-License-Identifier: Apache-2.0
"""What the evaluator knows: the last runs and the model in use. No ROS here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, TypeVar

from rosette_ros.analysis import analyse, diagnose, evaluate_jointly
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.joint.sharing import PARTS, SEATS
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.next_readings import NextReadings, next_readings
from rosette_ros.core.run.errors import InvalidData, InvalidModel, NotDeterminable, plain
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.number_words import micrometres, significant
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import Scheme

RUNS_KEPT = 4
_Run = TypeVar('_Run')


def _keep(runs: dict[str, _Run], run_id: str, run: _Run) -> None:
    """Enter a run as the last one and drop the first where there are too many."""
    runs.pop(run_id, None)
    runs[run_id] = run
    if len(runs) > RUNS_KEPT:
        del runs[next(iter(runs))]


@dataclass(frozen=True, eq=False)
class ModelChange:
    """A run under the old and the new model; before: None where the old one could not be fitted."""

    run: Run
    model_before: Model
    before: Fit | None
    after: Fit

    @property
    def sentence(self) -> str:
        """What has changed, for a person."""
        before = significant(1e6 * self.before.rms) if self.before else 'undetermined'
        return (f'run {self.run.run_id}: model {self.after.model}; residual {before} -> '
                f'{micrometres(self.after.rms)}')


@dataclass(eq=False)
class ModelInUse:
    """The model under which runs are evaluated and diagnosed, and the last evaluated runs."""

    model: Model
    _runs: dict[str, Run] = field(default_factory=dict)
    _frames: dict[str, Frame | None] = field(default_factory=dict)
    _hashes: dict[str, str] = field(default_factory=dict)

    def evaluate(self, run: Run, frame: Frame | None = None, readings_hash: str = '') -> Fit:
        """Return the Fit of a run and keep the run for requests; frame: its table frame in the machine frame."""
        _keep(self._runs, run.run_id, run)
        _keep(self._frames, run.run_id, frame)
        _keep(self._hashes, run.run_id, readings_hash)
        return analyse(run, self.model)

    def readings_hash(self, run_id: str) -> str:
        """Return the hash of the readings of an evaluated run, '' where it is not known."""
        return self._hashes.get(run_id, '')

    def run(self, run_id: str = '') -> Run:
        """Return an evaluated run, the last one where none is named; raises InvalidData."""
        if not self._runs:
            raise InvalidData('expected a run, found none yet: calibrate first')
        if not run_id:
            return next(reversed(self._runs.values()))
        if run_id not in self._runs:
            raise InvalidData(f'run_id: expected one of {", ".join(self._runs)} (the last {RUNS_KEPT} are kept), found '
                              f'{run_id!r}; the logs of older ones are for rosette evaluate (several: --joint)')
        return self._runs[run_id]

    def next_readings(self, run_id: str, readings_hash: str, refused: Callable[[int], Sequence[Scheme]],
                      **wanted: Any) -> NextReadings:
        """Return the NextReadings of an evaluated run, the last one where none is named; raises RosetteError.

        readings_hash: of the readings that are meant, '' for any; refused: returns blocks on so many balls; wanted: as
        of `next_readings`."""
        run = self.run(run_id)
        known = self._hashes.get(run.run_id, '')
        if readings_hash not in ('', known):
            raise InvalidData(f'run {run.run_id}: expected readings with the hash {readings_hash!r:.80}, found '
                              f'{known!r}; '
                              'publish the run again')
        return next_readings(run, self.model, refused=refused(run.n), **wanted)

    def diagnose(self, run_id: str = '') -> tuple[Run, Diagnosis]:
        """Return the run and its Diagnosis; raises RosetteError."""
        run = self.run(run_id)
        return run, diagnose(run, self.model)

    def evaluate_jointly(self, run_ids: Sequence[str], declared: Callable[[int], dict[str, Any]]) -> JointResult:
        """Return the JointResult of evaluated runs, of all that are kept where none is named; raises RosetteError.

        declared: of the number of runs, as of `evaluate_jointly`."""
        runs = [self.run(run_id) for run_id in run_ids or self._runs or ('',)]
        return evaluate_jointly([Readings.of(run, self._frames.get(run.run_id)) for run in runs], declared(len(runs)))

    def add(self, run_id: str, effect: str, entry: Mapping[str, Any]) -> ModelChange:
        """Add an effect to the model and fit a run again; entry: as of extended().

        The model stays as it was where an error is raised: InvalidModel, NotDeterminable, InvalidData."""
        run = self.run(run_id)
        return self._change(run, extended(self.model, effect, entry), analyse(run, self.model))

    def remove(self, run_id: str, effect: str) -> ModelChange:
        """Remove an effect from the model and fit a run again; see add()."""
        run = self.run(run_id)
        model = self.model.without_effect(effect)
        try:
            before = analyse(run, self.model)
        except NotDeterminable:
            before = None  # which may be the reason for removing the effect
        return self._change(run, model, before)

    def _change(self, run: Run, model: Model, before: Fit | None) -> ModelChange:
        after = analyse(run, model)
        model_before, self.model = self.model, model
        return ModelChange(run, model_before, before, after)


def declared_sharing(request: Any, runs: int) -> dict[str, Any]:
    """Return the fields of Sharing that an EvaluateJointly request declares for so many runs; raises InvalidData."""
    declared: dict[str, Any] = {}
    for name in (*PARTS, 'plate_turned'):
        values = tuple(getattr(request, name))
        if values and len(values) != runs:
            raise InvalidData(f'{name}: expected {"an angle" if name == "plate_turned" else "a name"} for each of '
                              f'{runs} '
                              f'runs, or none, found {len(values)}')
        if values and name != 'plate_turned':
            declared[name] = tuple(plain(value) for value in values)
        elif values:
            if not all(map(isfinite, values)):
                raise InvalidData(f'{name}: expected finite angles, found {values}')
            declared['turn'] = tuple(map(float, values))
    if request.seat:
        if request.seat not in SEATS:
            raise InvalidData(f'seat: expected one of {", ".join(SEATS)}, or nothing, found '
                              f'{plain(request.seat)!r:.80}')
        declared['seat'] = request.seat
    if request.by_sense not in (-1, 0, 1):
        raise InvalidData(f'by_sense: expected YES, NO or AS_THE_RUNS, found {request.by_sense}')
    if request.by_sense:
        declared['by_sense'] = request.by_sense > 0
    return {**declared, 'cmm_is_calibrated': True} if request.cmm_is_calibrated else declared


def extended(model: Model, effect: str, entry: Mapping[str, Any]) -> Model:
    """Return a model with an effect more; entry: its settings or a user's own term, as in a model file.

    Raises InvalidModel."""
    if 'own' in entry:
        if effect not in ('', entry['own']):
            raise InvalidModel(f'effect: expected {entry["own"]!r} as in the definition, or nothing, found {effect!r}')
        return model.with_entry(dict(entry))
    settings = dict(entry)
    if 'name' in settings and settings.pop('name') != effect:
        raise InvalidModel(f'definition: name: expected {effect!r} as in `effect`')
    return model.with_effect(effect, settings)
