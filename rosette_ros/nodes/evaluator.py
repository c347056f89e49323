# SPDX-License-Identifier: Apache-2.0
"""The evaluator: turns a finished run into six error motions, with the same code as offline, and diagnoses it."""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import Parameter, ParameterType
from rosette_msgs import msg
from rosette_msgs.msg import Diagnosis, ErrorMotions, JointEvaluation, Model, RunState
from rosette_msgs.msg import Run as RunMessage
from rosette_msgs.srv import AddEffect, Diagnose, EvaluateJointly, NextReadings, RemoveEffect
from std_msgs.msg import Header

from rosette_ros.analysis import MOST_BALLS_JUDGED
from rosette_ros.calibration.commands import Until
from rosette_ros.calibration.settings import EXPERIENCE, UNTIL, Wanted, until_of
from rosette_ros.core.diagnosis import diagnosis as core
from rosette_ros.core.diagnosis.run_result import RunResult
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.sharing import ITEMS
from rosette_ros.core.planning.next_readings import BLOCK
from rosette_ros.core.run import records
from rosette_ros.core.run.errors import InvalidModel, RosetteError, one_line, plain
from rosette_ros.core.run.records import Run
from rosette_ros.io.experience_file import read_experience
from rosette_ros.io.messages import TABLE_FRAME
from rosette_ros.io.model_file import parse_entry, read_model
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import ERROR, OK, WARN, CellNode, Health, run_node
from rosette_ros.nodes.evaluation import ModelChange, ModelInUse, declared_sharing
from rosette_ros.nodes.interfaces import introspected_service
from rosette_ros.words.joint_words import note_words, part_words
from rosette_ros.words.reading_words import remark_words
from rosette_ros.words.result_words import conclusion_text
from rosette_ros.words.settling_words import block_words, standing_words

WANTED = (
    Wanted('model', '', 'model file (YAML) to start with; empty: the base model', read_only=True),
    EXPERIENCE,
    Wanted('diagnose_after_run', True, 'whether each run is diagnosed, so that the diagnosis is in its log'),
    Wanted('diagnose_most_balls', MOST_BALLS_JUDGED, 'larger plates are diagnosed on request only', 0, 1000),
    Wanted('longest_work_s', 600.0, 'a calculation that lasts longer is taken for one that never ends: the evaluator '
           'counts as disconnected, and `rosette cell` restarts it, s', 1.0, 1e6, read_only=True))


def _callback_of(name: str) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Make the callback of a service of a method that fills in the response or raises RosetteError: a refusal."""
    def decorate(handle: Callable[..., None]) -> Callable[..., Any]:
        def on_request(self: 'Evaluator', request: Any, response: Any) -> Any:
            try:
                handle(self, request, response)
                response.success = True
            except RosetteError as error:
                response.success, response.message = False, one_line(error)
                self.get_logger().warning(f'{name}: {response.message}')
            return response
        return on_request
    return decorate


class Evaluator(CellNode):
    """Evaluates and diagnoses runs under the model in use, which requests may change.

    Topics: subscribes to `run`, `run_state`; publishes `model`, `diagnosis`,
    `error_motions`, in this order, and `joint_evaluation`, all latched. Services: `evaluator/diagnose`,
    `evaluator/next_readings`, `evaluator/add_effect`, `evaluator/remove_effect`, `evaluator/evaluate_jointly`, answered
    after their calculation, during which messages wait. Parameters: WANTED."""

    def __init__(self) -> None:
        super().__init__(names.EVALUATOR, WANTED)
        self.status.longest = float(self.parameters['longest_work_s'])
        model, taught = read_model(self.parameters['model'] or None), str(self.parameters[EXPERIENCE.name])
        self._in_use = ModelInUse(replace(model, experience=read_experience(taught)) if taught else model)
        self._answers: RunAnswers | None = None  # published by the sequencer, not yet evaluated
        self._due = '', 0  # the run to be evaluated, and how many of its targets are answered
        self._level, self._last = OK, 'no run yet'
        self._motions_out = self.create_publisher(ErrorMotions, names.ERROR_MOTIONS, qos.RESULT)
        self._model_out = self.create_publisher(Model, names.MODEL, qos.RESULT)
        self._diagnosis_out = self.create_publisher(Diagnosis, names.DIAGNOSIS, qos.RESULT)
        introspected_service(self, Diagnose, names.DIAGNOSE, self._on_diagnose)
        self._joint_out = self.create_publisher(JointEvaluation, names.JOINT_EVALUATION, qos.RESULT)
        introspected_service(self, NextReadings, names.NEXT_READINGS, self._on_next_readings)
        introspected_service(self, EvaluateJointly, names.EVALUATE_JOINTLY, self._on_evaluate_jointly)
        introspected_service(self, AddEffect, names.ADD_EFFECT, self._on_add)
        introspected_service(self, RemoveEffect, names.REMOVE_EFFECT, self._on_remove)
        self.on(names.RUN, RunMessage, self._on_run, qos.RESULT, from_one=True)
        self.on(names.RUN_STATE, RunState, self._on_state, qos.COLLECT_LATCHED, from_one=True)
        self.say(self._model_out, conversions.model_message(self._in_use.model, self.now().to_msg()))

    def _on_run(self, message: RunMessage) -> None:
        try:
            self._answers = conversions.answers_of(message)
        except RosetteError as error:
            self.get_logger().error(f'{names.RUN}: not used: {error}')
        self._evaluate_if_due()

    def _on_state(self, message: RunState) -> None:
        run_id = plain(message.run_id)
        if message.phase == RunState.PHASE_EVALUATION:
            self._due = run_id, message.done
        else:
            self._due = self._due if message.phase == RunState.PHASE_DONE else ('', 0)
            self.status.report('')
        self._evaluate_if_due()

    def _evaluate_if_due(self) -> None:
        """Evaluate the run that the sequencer has published, once, where its state says that it is complete."""
        answers, (run_id, done) = self._answers, self._due
        if answers is None or answers.run_id != run_id or answers.answered < done:
            return
        self._answers = None
        try:
            assembly = RunAssembly(answers, f'run {run_id}')
            readings = assembly.run(), assembly.frame(), answers.readings_hash
            del answers, assembly  # 180 MB of 360 balls
            fit = self._in_use.evaluate(*readings)
        except RosetteError as error:
            self._report_failure(run_id, str(error))
            self.status.report(self._last)  # ends the run: it would wait in vain for error motions
            return
        self._publish(RunResult(fit, self._diagnose_after(fit.run)))
        doubts = ''.join(f'; {remark_words(one)}' for one in fit.run.remarks)
        self._level = WARN if doubts else OK
        self._last = plain(f'run {run_id} is evaluated, {fit.run.size} ball centres{doubts}', most=2000)
        if doubts:
            self.get_logger().warning(self._last)
        else:
            self.get_logger().info(self._last)

    def _diagnose_after(self, run: Run) -> core.Diagnosis | None:
        """Publish and return the diagnosis of a run that was evaluated; None where it is not wanted or not possible."""
        if not self.parameters['diagnose_after_run']:
            return None
        if run.n > self.parameters['diagnose_most_balls']:
            self.get_logger().info(f'run {run.run_id} has {run.n} balls: it is diagnosed when {names.DIAGNOSE} is '
                                   'called')
            return None
        try:
            found, diagnosis = self._diagnose(run.run_id)
        except RosetteError as error:
            self.get_logger().warning(f'run {run.run_id} could not be diagnosed: {error}')
            return None
        self.get_logger().info(diagnosis.verdict)
        return found

    def _publish(self, result: RunResult) -> ErrorMotions:
        """Publish model and error motions, and return these, which come last, since they end a run.

        result: of a run whose diagnosis, where it has one, is published already."""
        stamp, fit = self.now().to_msg(), result.fit
        model, motions = (conversions.model_message(fit.model, stamp, fit),
                          conversions.error_motions_message(result, stamp, TABLE_FRAME))
        motions.readings_hash = self._in_use.readings_hash(fit.run.run_id)
        self.say(self._model_out, model)
        self.say(self._motions_out, motions)
        return motions

    def _diagnose(self, run_id: str = '') -> tuple[core.Diagnosis, Diagnosis]:
        """Return what is missing, and the message that was published of it."""
        run, found = self._in_use.diagnose(run_id)
        message = conversions.diagnosis_message(run, found, self.now().to_msg())
        message.readings_hash = self._in_use.readings_hash(run.run_id)
        self.say(self._diagnosis_out, message)
        return found, message

    def _report_failure(self, run_id: str, reason: str) -> None:
        self._level, self._last = ERROR, plain(
            f'run {run_id} could not be evaluated: {reason.removeprefix(f"run {run_id}: ")}')
        self.get_logger().error(self._last)

    # Services: what becomes known is published too, before the response

    @_callback_of(names.DIAGNOSE)
    def _on_diagnose(self, request: Diagnose.Request, response: Diagnose.Response) -> None:
        _, response.diagnosis = self._diagnose(request.run_id)
        response.message = response.diagnosis.verdict

    @_callback_of(names.NEXT_READINGS)
    def _on_next_readings(self, request: NextReadings.Request, response: NextReadings.Response) -> None:
        wanted = until_of({one.name: one.check(value, names.NEXT_READINGS) for one, value in zip(
            UNTIL, (request.until_probability, request.until_uncertainty, 0), strict=True)})
        until = wanted or Until(0.0, 0.0, 0)
        found = self._in_use.next_readings(
            plain(request.run_id), plain(request.readings_hash),
            lambda n: [block for one in request.refused if (block := conversions.block_scheme(one, n))],
            readings=min(request.readings or BLOCK, BLOCK), until=until.probability,
            uncertainty=until.uncertainty or None)
        response.settled, response.block = found.is_settled, conversions.block_message(found.targets)
        response.text, response.message = standing_words(found), block_words(found)

    @_callback_of(names.EVALUATE_JOINTLY)
    def _on_evaluate_jointly(self, request: EvaluateJointly.Request, response: EvaluateJointly.Response) -> None:
        result = self._in_use.evaluate_jointly(list(map(plain, request.run_ids)), partial(declared_sharing, request))
        response.evaluation = joint_message(result, self.now().to_msg(), TABLE_FRAME)
        response.message = response.evaluation.verdict
        self._joint_out.publish(response.evaluation)

    @_callback_of(names.ADD_EFFECT)
    def _on_add(self, request: AddEffect.Request, response: AddEffect.Response) -> None:
        self._answer(self._in_use.add(request.run_id, request.effect, entry_of(request)), response)

    @_callback_of(names.REMOVE_EFFECT)
    def _on_remove(self, request: RemoveEffect.Request, response: RemoveEffect.Response) -> None:
        self._answer(self._in_use.remove(request.run_id, request.effect), response)

    def _answer(self, change: ModelChange, response: Any) -> None:
        """Publish and answer what a new model says of a run, and what it still lacks."""
        stamp = self.now().to_msg()
        response.before = conversions.model_message(change.model_before, stamp, change.before)
        response.after = conversions.model_message(change.after.model, stamp, change.after)
        response.message, found = change.sentence, None
        try:
            found, _ = self._diagnose(change.run.run_id)
        except RosetteError as error:
            response.message += f'; not diagnosed: {error}'
        response.error_motions = self._publish(RunResult(change.after, found))
        self.get_logger().info(response.message)

    def health(self) -> Health:
        """Return what became of the last run."""
        return self._level, self._last, {'model': self._in_use.model}


def entry_of(request: AddEffect.Request) -> Mapping[str, object]:
    """Return the effect of a request as a model file describes it; raises InvalidModel."""
    own = {name: getattr(request, name) for name in ('direction', 'expression', 'per') if getattr(request, name)}
    settings = {plain(one.name): _setting(one) for one in request.settings}
    if len(settings) < len(request.settings):
        raise InvalidModel('settings: expected each once, found '
                           f'{", ".join(plain(one.name) for one in request.settings)}')
    given = [*(['settings'] if settings else ()), *own]
    if request.definition and given:
        raise InvalidModel(f'definition: expected it empty, or no {", ".join(given)} beside it')
    if settings and own:
        raise InvalidModel(f"settings: expected none for a user's own term ({', '.join(own)}), found "
                           f"{', '.join(settings)}")
    if own:
        return {'own': request.effect, **own}
    return settings or parse_entry(request.definition, 'definition')


def _setting(parameter: Parameter) -> float | str:
    value, name = parameter.value, plain(parameter.name)
    fields = {ParameterType.PARAMETER_DOUBLE: 'double_value', ParameterType.PARAMETER_INTEGER: 'integer_value',
              ParameterType.PARAMETER_STRING: 'string_value'}
    if value.type not in fields:
        raise InvalidModel(f'settings: {name}: expected a number or a text, found a parameter of type {value.type}')
    return getattr(value, fields[value.type])


def joint_message(result: JointResult, stamp: Time, frame_id: str) -> msg.JointEvaluation:
    """Return the JointEvaluation message of a joint evaluation."""
    solution, verdict, unknown = result.solution, conclusion_text(conclude(result)), math.nan
    return msg.JointEvaluation(
        header=Header(stamp=stamp, frame_id=frame_id), run_ids=[run.run_id for run in solution.model.runs],
        verdict=verdict.sentence, level=str(verdict.level), action=verdict.action,
        curves=[joint_curves(motions, one.name, one.sense) for one, motions in result.curves],
        reversals=[joint_curves(
            one.motions, one.table, mean=np.where(one.is_known, one.mean, unknown).tolist(),
            u_mean=np.where(one.is_known, one.u_mean, unknown).tolist(), p=unknown if one.p is None else one.p)
            for one in result.reversals],
        tests=[msg.SharingTest(
            item=test.item, text=ITEMS[test.item], declared=test.item in result.declared, f=float(test.f),
            degrees_of_freedom=test.dof, p=unknown if test.p is None else test.p, used=test.is_used,
            contradicted=test.is_contradicted) for test in result.tests],
        known=list(part_words(result.knowledge.known)), not_known=list(part_words(result.knowledge.hidden)),
        notes=list(map(note_words, result.notes)),
        unknowns=solution.model.unknowns, rank=solution.rank, hidden=solution.hidden.shape[1],
        hidden_in_curves=solution.hidden_in_curves, degrees_of_freedom=solution.dof, residual_rms=result.rms,
        sigma=result.sigma, lack_of_fit_p=unknown if result.lack_of_fit_p is None else result.lack_of_fit_p)


def joint_curves(motions: records.ErrorMotions, table: str, sense: int = 0, p: float = math.nan,
                 **means: list[float]) -> msg.JointCurves:
    """Return the JointCurves message of curves; means: of a reversal."""
    return msg.JointCurves(table=table, sense=sense, angle=motions.angle, p=p, **conversions.curve_fields(motions),
                           **means)


main = partial(run_node, names.EVALUATOR, Evaluator)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())
