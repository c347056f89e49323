# SPDX-License-Identifier: Apache-2.0
"""What a run says, or several as one: error motions, what is missing, where a model fails, the budget, a correction."""

import datetime
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros import analysis
from rosette_ros.analysis import LadderStep, RunCurves, RunResult, claimed_model
from rosette_ros.api.cells import diagnosed_cell
from rosette_ros.api.correction_targets import ROS, correction_file
from rosette_ros.api.measurement import (
    Doing,
    JudgedRun,
    Measurement,
    model_of,
    read,
    several,
    with_experience,
)
from rosette_ros.api.result import DrawnResult, Result, frame_of, html_of, in_notebook, plots
from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.second_run import CrossCheck
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult, evaluate_jointly
from rosette_ros.core.joint.run_to_run import joint_spheres
from rosette_ros.core.model.experience import Experience
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import CURVES, ErrorMotions, Floats, Run
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.core.sight.visibility import Visibility, visibility
from rosette_ros.core.table.correction import Correction
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.budget_monte_carlo import MonteCarlo, monte_carlo
from rosette_ros.core.uncertainty.error_summary import ONE_SENSE, AxisError, four_axis_errors
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.io.budget_file import environment_of, read_stated, source_of
from rosette_ros.io.open_run import joint_identity
from rosette_ros.io.qdas_file import Characteristic, format_dfq
from rosette_ros.io.qif_results import format_qif
from rosette_ros.io.sharing_file import read_sharing
from rosette_ros.io.text_file import write_text
from rosette_ros.io.touch_log import open_refitted, refit_if_touched
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation import joint_results, tables
from rosette_ros.presentation.budget_results import (
    agreement_words,
    budget_json,
    budget_tables,
    environment_json,
    expanded_words,
)
from rosette_ros.presentation.correction_results import correction_table
from rosette_ros.presentation.error_results import FourAxis, errors_of, four_axis_json, four_axis_table
from rosette_ros.presentation.explanation_results import explanations
from rosette_ros.presentation.json_output import comparison_json, diagnosis_json, evaluation_json
from rosette_ros.presentation.table_format import Table
from rosette_ros.presentation.touch_results import spheres_json
from rosette_ros.words.budget_words import not_considered
from rosette_ros.words.result_words import check_words, comparison_words, conclusion_text
from rosette_ros.words.verdict_words import verdict_text

Runs = Any
"""One run, or a list of runs, each as `read` takes it."""
SPC_FILES = {'.dfq': format_dfq, '.qif': format_qif}
"""What writes results for statistical process control, by the ending of the file."""
ModelLike = Model | str | Path | None
ExperienceLike = Experience | str | Path | None
Stated = Mapping[str, Any] | str | Path | None


class ErrorCurves:
    """Six error motions with their expanded uncertainties; motions: as the core has them, SI, standard uncertainties.
    """

    def __init__(self, motions: ErrorMotions, which: str = '') -> None:
        self.motions, self.which = motions, which

    @property
    def table(self) -> Table:
        """The table of the command line."""
        return tables.curves(self.motions, self.which)

    def to_frame(self) -> Any:
        """Return a DataFrame (pandas): angle, the six curves and their U (k = 2); units of all columns in attrs."""
        factors, units = text.curve_factors(), text.curve_units()
        frame = frame_of(Table('curves', self.table.title, ()))
        frame['angle'] = np.rad2deg(self.motions.angle)
        for place, curve in enumerate(CURVES):
            frame[curve] = factors[place] * self.motions.values[:, place]
        for place, curve in enumerate(CURVES):
            frame[f'U_{curve}'] = factors[place] * text.COVERAGE_FACTOR * self.motions.u[:, place]
        by_curve = dict(zip(CURVES, units, strict=True))
        frame.attrs = {'title': self.table.title, 'coverage_factor': text.COVERAGE_FACTOR, 'units': {
            'angle': '°', **by_curve, **{f'U_{curve}': unit for curve, unit in by_curve.items()}}}
        return frame

    def _repr_html_(self) -> str:
        return html_of(self.table)


def _said(verdict: Verdict | None) -> tuple[str, ...]:
    """Return the sentences of a verdict, none where none was asked for."""
    if verdict is None:
        return ()
    words = verdict_text(verdict)
    return (words.sentence, *words.limits, words.action)


def _level(verdict: Verdict | None) -> str:
    return verdict_text(verdict).level.value if verdict else ''


class Evaluation(DrawnResult):
    """The evaluation of one run under a model.

    result: the curves that count and those as modelled; fit: as modelled; refit: the spheres of touches; spheres:
    four-axis errors."""

    def __init__(self, judged: JudgedRun, refit: SphereRefit | None = None, where: Sequence[float] = ()) -> None:
        self.judged, self.refit, self.result, self.fit = judged, refit, judged.result, judged.fit
        self.verdict = self.result.verdict
        self.tolerances = judged.identity.limits(judged.run.rotation)
        self.spheres: FourAxis = [('rotary table', four_axis_errors([judged.motions], *where),
                                   ONE_SENSE)] if where else []
        self.level, self.source = _level(self.verdict), judged.measured.name

    @property
    def model(self) -> Model:
        """The model as given."""
        return self.fit.model

    @property
    def lines(self) -> tuple[AxisError, ...]:
        """The six error motions of the result in a line each."""
        return self.result.curves.lines(self.tolerances)

    @property
    def curves(self) -> ErrorCurves:
        """The curves of the result: over all explanations where something is missing, else as modelled."""
        return self._named(self.result.curves)

    @property
    def as_modelled(self) -> ErrorCurves:
        """The curves of the model as given."""
        return self._named(self.result.modelled)

    def _named(self, curves: RunCurves) -> ErrorCurves:
        return ErrorCurves(curves.motions, curves.which if self.result.beside else '')

    @property
    def residuals(self) -> Floats:
        """What the model leaves of each reading, (N, 3), m, in the order of measuring."""
        return self.fit.residual

    def to_mapping(self) -> dict[str, Any]:
        more = ({'spheres': spheres_json(self.refit)} if self.refit else {}) | four_axis_json(self.spheres)
        return {**evaluation_json(self.result, self.tolerances), **environment_json(self.result.curves.budget), **more}

    def sentences(self) -> tuple[str, ...]:
        return _said(self.verdict) or (f'Residual: {text.residual_words(self.fit)}',)

    def tables(self) -> tuple[Table, ...]:
        """Return the tables of the result, then those of the fit as modelled."""
        two = bool(self.result.beside)
        return (*tables.curves_of(self.result), *errors_of(self.result, self.tolerances),
                *four_axis_table(self.spheres, f', {self.result.curves.which}' * two),
                tables.deviations(self.fit, self.result.modelled.which if two else ''),
                tables.fitted_effects(self.fit, 'Effects in the model'))

    def save_spc(self, path: str | Path, force: bool = False) -> None:
        """Write ranges with U and tolerances for statistical process control: Q-DAS K-fields (AQDEF, .dfq) or a QIF 3.0
        document (.qif).

        Raises InvalidData where the file exists, unless `force`, and where its name ends otherwise."""
        if (write := SPC_FILES.get(Path(path).suffix.lower())) is None:
            raise InvalidData(f'{path}: expected a name that ends in {" or ".join(SPC_FILES)}')
        every, run = list[Characteristic](), self.judged.run
        for line, scale in zip(self.lines, text.curve_scales(), strict=True):
            limit, unit = line.tolerance, text.file_unit(scale.unit)
            every += [Characteristic(f'{line.curve} {line.name}, range', scale.factor * line.range,
                                     None if limit is None else scale.factor * limit, unit,
                                     scale.factor * line.u_range, line.conformity),
                      Characteristic(f'{line.curve}, U (k = {text.COVERAGE_FACTOR}) of the range',
                                     scale.factor * line.expanded, None, unit)]
        stated = self.judged.identity['measured.begin']
        when = (datetime.datetime.fromtimestamp(run.begun, datetime.UTC) if run.begun is not None else
                datetime.datetime.fromisoformat(stated) if stated else None)
        write_text(path, write(every, self.judged.identity, run.run_id or self.source, when, self.sentences()[0]),
                   force)

    def draw(self, truth: ErrorMotions | None = None) -> Any:
        drawn, known = plots('result_plots'), truth or self.judged.measured.truth
        series = drawn.Series('measured', self.curves.motions)
        return drawn.six_curves([series], f'Error motions: {self.judged.measured.name}',
                                None if known is None else known.values)

    def plot(self, truth: ErrorMotions | None = None) -> Any:
        """Return the picture of the recommended curves with bands of U, a matplotlib Figure; truth: drawn beside them.
        """
        return in_notebook(self.draw(truth))


class JointEvaluation(DrawnResult):
    """Several runs evaluated as one; result: as the core has it."""

    def __init__(self, result: JointResult, tolerances: Mapping[str, Tolerance], spheres: FourAxis) -> None:
        self.result, self.tolerances, self.spheres = result, tolerances, spheres
        self.level = conclusion_text(conclude(result)).level.value

    def to_mapping(self) -> dict[str, Any]:
        return {**joint_results.joint_json(self.result, self.tolerances), **four_axis_json(self.spheres)}

    def sentences(self) -> tuple[str, ...]:
        words = conclusion_text(conclude(self.result))
        return words.sentence, words.action

    @property
    def curves(self) -> ErrorCurves:
        """The curves of the first table, in its first sense of turning, as the title says; `result.curves` has all."""
        (first, motions), *others = self.result.curves
        return ErrorCurves(motions, first.words if others else '')

    def tables(self) -> tuple[Table, ...]:
        return (*joint_results.joint_errors(self.result, self.tolerances), joint_results.sharing_table(self.result),
                *joint_results.joint_effects(self.result), *joint_results.joint_curves(self.result))

    def draw(self) -> Any:
        drawn = plots('result_plots')
        return drawn.six_curves([drawn.Series(one.words, motions) for one, motions in self.result.curves])


def evaluate(runs: Runs, model: ModelLike = None, *, inputs: Stated = None, environment: str | None = None,
             share: str | Path | None = None, refit_spheres: bool = False, test_spheres: Sequence[float] = (),
             identity: str | Path | None = None, experience: ExperienceLike = None, any_cell: bool = False) -> Any:
    """Return the Evaluation of a run, or the JointEvaluation of several as one (of a plate of any pitch, too).

    model: or its file; inputs: of the uncertainty budget, as its file says them; environment: 'laboratory' or
    'workshop', so that U contains what the order of measurement hides; share: file with what several runs share;
    refit_spheres: ball centres from the touches in the log; test_spheres: radius and height, mm, for the four-axis
    errors (ISO 10360-3); identity: a file that states tolerances; experience: what earlier runs of the cell have
    taught, or its file; any_cell: also of another table or CMM. Raises InvalidData, NotDeterminable."""
    every = several(runs)
    where = [1e-3 * one for one in test_spheres]
    if len(every) > 1 or every[0].has_plate or share:
        if model is not None or refit_spheres or experience is not None:
            raise InvalidData('evaluate: expected no model, no refit_spheres and no experience with several runs as '
                              'one')
        return evaluated_jointly(every, inputs, environment, share, identity, where)
    judged = JudgedRun(every[0], model, inputs, environment, experience=experience, any_cell=any_cell)
    return evaluated(judged, refit_spheres, where)


def evaluated(judged: JudgedRun, refit_spheres: bool = False, where: Sequence[float] = ()) -> Evaluation:
    """Return the Evaluation of one run; where: radius and height of test spheres, m."""
    refit = None
    if refit_spheres:
        judged.run, refit = open_refitted(judged.path, judged.measured.run_id)
    return Evaluation(judged, refit, where)


def evaluated_jointly(every: Sequence[Measurement], inputs: Stated = None, environment: str | None = None,
                      share: str | Path | None = None, identity: str | Path | None = None,
                      where: Sequence[float] = ()) -> JointEvaluation:
    """Return the JointEvaluation of runs; arguments as of `evaluate`, where as of `evaluated`."""
    result = joint_result(every, inputs, environment, share)
    files = [(one.path, one.run_id) for one in every if one.path]
    known = joint_identity(files, identity)[0] if files or identity else every[0].identity
    return JointEvaluation(result, known.limits(result.solution.model.runs[0].rotation),
                           joint_spheres(result, *where) if where else [])


def joint_result(every: Sequence[Measurement], inputs: Stated = None, environment: str | None = None,
                 share: str | Path | None = None) -> JointResult:
    """Return the runs evaluated as one, in the environment that is stated."""
    within = environment_of(read_stated(inputs, environment), source_of(inputs))
    return evaluate_jointly([one.readings for one in every], read_sharing(share, len(every)), within)


class Diagnosed(DrawnResult):
    """What is missing from a model; diagnosis: as the core has it; check: on another run, None without one."""

    def __init__(self, diagnosis: Diagnosis, check: CrossCheck | None = None) -> None:
        self.diagnosis, self.check, self.level = diagnosis, check, _level(diagnosis.verdict)

    @property
    def verdict(self) -> Verdict:
        """The verdict."""
        return self.diagnosis.verdict

    @property
    def missing(self) -> tuple[str, ...]:
        """The names of what is missing, the strongest first."""
        return self.diagnosis.missing

    @cached_property
    def model(self) -> Model:
        """The model with all that was found."""
        return claimed_model(self.diagnosis)

    @cached_property
    def invisible(self) -> tuple[Visibility, ...]:
        """Of every effect that the run could not have shown, how much of it is hidden."""
        final, names = self.diagnosis.final, self.diagnosis.invisible
        return visibility(final.run, final.sigma, final.model.base, names=names) if names else ()

    def to_mapping(self) -> dict[str, Any]:
        return diagnosis_json(self.diagnosis, self.invisible, self.check)

    def sentences(self) -> tuple[str, ...]:
        return (*_said(self.verdict), *([check_words(self.check)] if self.check else []),
                *([f'Model with what was found: {text.model_words(self.model)}.'] if self.missing else []))

    def tables(self) -> tuple[Table, ...]:
        diagnosis = self.diagnosis
        claimed = [(one.name, one.setting, one.parameters) for one in diagnosis.candidates if one.claimed]
        return (explanations(diagnosis), tables.effects(claimed, 'Parameters of the missing effects',
                                                        diagnosis.fit.run.time_unit),
                tables.candidates(diagnosis.candidates, diagnosis.fit.run, 'Candidates'),
                *([tables.cross_check(self.check)] if self.check else []))

    def draw(self) -> Any:
        fit = self.diagnosis.fit
        return plots('comparison_plots').candidates(self.diagnosis.candidates, fit.run.repeatability)


def diagnose(run: Runs, model: ModelLike = None, check: Any = None, experience: ExperienceLike = None,
             any_cell: bool = False) -> Any:
    """Return the Diagnosed of a run, which effects are missing from a model, or the CellDiagnosed of several runs of a
    cell, what comes again in it.

    check: another run of the same cell that confirms what is missing in one; experience: what earlier runs of the cell
    have taught, or its file, of one run; any_cell: as of `evaluate`. Raises InvalidData, NotDeterminable."""
    if isinstance(run, list | tuple):
        if check is not None or experience is not None:
            raise InvalidData('diagnose: expected no check and no experience with several runs, which say it together')
        return diagnosed_cell(several(run), model_of(model))
    measured = read(run)
    diagnosis = analysis.diagnose(measured.run, with_experience(model_of(model), experience, any_cell, measured))
    return Diagnosed(diagnosis, None if check is None else analysis.cross_check(read(check).run, diagnosis))


class Compared(DrawnResult):
    """A model against the readings: where its residual is; steps: of the ladder of models, () where none was asked for.
    """

    def __init__(self, comparison: Comparison, verdict: Verdict, steps: Sequence[LadderStep] = ()) -> None:
        self.comparison, self.verdict, self.steps, self.level = comparison, verdict, tuple(steps), _level(verdict)

    def to_mapping(self) -> dict[str, Any]:
        return comparison_json(self.comparison, self.verdict, self.steps)

    def sentences(self) -> tuple[str, ...]:
        return (*_said(self.verdict), comparison_words(self.comparison))

    def tables(self) -> tuple[Table, ...]:
        comparison = self.comparison
        return (tables.axes(comparison), tables.places(comparison), tables.worst_readings(comparison),
                tables.groups(comparison), tables.residuals(comparison.fit, comparison.fit),
                *([tables.nested_models(self.steps)] if self.steps else []))

    def draw(self) -> Any:
        drawn, fit = plots('residual_plots'), self.comparison.fit
        return drawn.residual_maps([drawn.Residuals('residual', fit.run, fit.residual)])


def compare(run: Any, model: ModelLike = None, ladder: bool = False) -> Compared:
    """Return where a model fails on a run, and by how much of the noise; ladder: also the nested models up to it."""
    measured, known = read(run).run, model_of(model)
    return Compared(analysis.compare(measured, known), analysis.judge(measured, known),
                    analysis.ladder(measured, known) if ladder else ())


class Ladder(DrawnResult):
    """The residual of nested models, from the base model on, effect by effect."""

    def __init__(self, steps: Sequence[LadderStep]) -> None:
        self.steps = tuple(steps)

    def to_mapping(self) -> dict[str, Any]:
        fit = self.steps[-1].fit
        return compare(fit.run, fit.model, ladder=True).to_mapping()

    def sentences(self) -> tuple[str, ...]:
        return tuple(f'{one.added or "base model"}: residual {text.micro(one.fit.rms)} µm, cross-validation '
                     f'{text.micro(one.cross_validation)} µm' for one in self.steps)

    def tables(self) -> tuple[Table, ...]:
        return (tables.nested_models(self.steps),)

    def draw(self) -> Any:
        run = self.steps[0].fit.run
        return plots('comparison_plots').ladder(self.steps, run.repeatability, run.repeatability_dof)


def ladder(run: Any, model: ModelLike = None) -> Ladder:
    """Return how the residual of a run falls from the base model to a model, effect after effect."""
    return Ladder(analysis.ladder(read(run).run, model_of(model)))


class Budgeted(DrawnResult):
    """The uncertainty budget of a run (GUM); found: its confirmation by Monte Carlo, None where none was asked for."""

    def __init__(self, made: Budget, found: MonteCarlo | None = None) -> None:
        self.made, self.found = made, found

    def to_mapping(self) -> dict[str, Any]:
        return budget_json(self.made, self.found)

    def sentences(self) -> tuple[str, ...]:
        return (expanded_words(self.made), *([agreement_words(self.found)] if self.found else []),
                *(f'Not considered: {one}' for one in not_considered(self.made)))

    def tables(self) -> tuple[Table, ...]:
        return budget_tables(self.made, self.found)

    def draw(self) -> Any:
        return plots('comparison_plots').budget_bars(self.made, self.found)


def budget(run: Any, model: ModelLike = None, *, inputs: Stated = None, environment: str | None = None,
           hidden_effects: bool = False, trials: int = 0, seed: int = 0) -> Budgeted:
    """Return the uncertainty budget of a run.

    inputs, environment: as of `evaluate`; hidden_effects: with bounds of effects that this order hides; trials: of a
    Monte Carlo, 0 for none, drawn from seed."""
    return budgeted(JudgedRun(read(run), model, inputs, environment), hidden_effects, trials, seed)


def budgeted(judged: JudgedRun, hidden_effects: bool = False, trials: int = 0, seed: int = 0,
             step: Callable[[int], object] = lambda done: None, doing: Doing = lambda words: nullcontext()) -> Budgeted:
    """Return the budget of a run that is opened; step: called with the trials done since; doing: around all of them."""
    refit = refit_if_touched(judged.path, judged.measured.run_id) if judged.path else None
    result = RunResult(judged.fit, judged.finding, judged.inputs or BudgetInputs(), refit)
    fit = result.curves.fit
    hidden = visibility(judged.run, fit.sigma, fit.model.base) if hidden_effects else None
    made = result.budget_with(hidden)
    with doing('Monte Carlo') if trials else nullcontext():
        return Budgeted(made, monte_carlo(made, trials, seed, step) if trials else None)


class Corrected(Result):
    """A correction of the table; serial: of the table; unknown: curves whose mean reversal the runs do not tell; which:
    curves of one run it takes off."""

    def __init__(self, correction: Correction, serial: str, verdict: Verdict | None, unknown: Sequence[str],
                 which: str = '') -> None:
        self.correction, self.serial, self.verdict, self.unknown = correction, serial, verdict, tuple(unknown)
        self.which = which
        self.level = _level(verdict)

    def sentences(self) -> tuple[str, ...]:
        return _said(self.verdict)[:1]

    def tables(self) -> tuple[Table, ...]:
        return (correction_table(self.correction),)

    def text(self, csv: bool = False, step: float = 5.0) -> str:
        """Return the correction as YAML (rosette-correction/1), or as a table with a line each `step` degrees."""
        return correction_file(self.correction, 'csv' if csv else ROS, self.serial, step)[0]

    def write(self, path: str | Path, force: bool = False) -> Path:
        """Write it, as a table where the name ends in .csv, and return the path.

        Raises InvalidData where the file exists, unless `force`."""
        write_text(path, self.text(Path(path).suffix.lower() == '.csv'), force)
        return Path(path)


def correct(runs: Runs, model: ModelLike = None, curves: Sequence[str] = CURVES, *, inputs: Stated = None,
            environment: str | None = None, share: str | Path | None = None) -> Corrected:
    """Return a correction of the table from a run, or from several as one; curves: which errors are taken off."""
    if wrong := [one for one in curves if one not in CURVES]:
        raise InvalidData(f'curves: expected some of {", ".join(CURVES)}, found {wrong[0]!r}')
    every = several(runs)
    if len(every) > 1 or every[0].has_plate:
        files = [(one.path, one.run_id) for one in every if one.path]
        serial = (joint_identity(files)[0] if files else every[0].identity)['table.serial']
        return corrected_jointly(joint_result(every, inputs, environment, share), serial, tuple(curves))
    return corrected(JudgedRun(every[0], model, inputs, environment), tuple(curves))


def corrected(judged: JudgedRun, curves: tuple[str, ...]) -> Corrected:
    """Return the correction of one run; raises InvalidData as `correction_of`."""
    return correction_of(judged.run, judged.result, judged.identity['table.serial'], curves, judged.path)


def correction_of(run: Run, result: RunResult, serial: str, curves: tuple[str, ...], path: str = '') -> Corrected:
    """Return the correction of a run by its result; serial: of the table; path: of the run, for errors.

    Raises InvalidData where table position 1 of the run is not at angle 0."""
    if run.table_offset:
        raise InvalidData(f'{path or run.source}: expected a run whose table position 1 is at angle 0, found '
                          f'{np.rad2deg(run.table_offset):.6g} deg; with --joint its curves are in the axes of angle 0')
    motions = result.curves.motions
    return Corrected(Correction(motions, motions, curves, run.run_id, run.simulated), serial, result.verdict, [],
                     result.curves.which)


def corrected_jointly(result: JointResult, serial: str, curves: tuple[str, ...]) -> Corrected:
    """Return the correction of several runs as one, each sense of turning with its own curves where they are known."""
    first, runs = result.curves[0][0].name, result.solution.model.runs
    by_sense = {table.sense: motions for table, motions in result.curves if table.name == first}
    known = [one for sense in (1, -1) if (one := by_sense.get(sense, by_sense.get(0))) is not None]
    if not known:
        raise RosetteError('correct: expected curves of a table, found none')
    unknown = [curve for curve, *are_known in zip(CURVES, *[one.is_known for one in result.reversals
                                                            if one.table == first])
               if curve in curves and not all(are_known)]
    return Corrected(Correction(known[0], known[-1], curves, '+'.join(one.run_id for one in runs),
                                any(one.simulated for one in runs)), serial, None, unknown)


