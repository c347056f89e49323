# SPDX-License-Identifier: Apache-2.0
"""The evaluator: turns a finished run into six error motions, with the same code as offline, and diagnoses it."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

from geometry_msgs.msg import TransformStamped
from rcl_interfaces.msg import Parameter, ParameterType
from rclpy.publisher import Publisher
from rosette_msgs.msg import BallCentre, Diagnosis, ErrorMotions, JointEvaluation, Model, ProbeTarget, RunState
from rosette_msgs.srv import AddEffect, Diagnose, EvaluateJointly, Recall, RemoveEffect
from tf2_msgs.msg import TFMessage

from rosette_ros.analysis import MOST_BALLS_JUDGED
from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.errors import InvalidModel, RosetteError, one_line, plain
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.records import Run
from rosette_ros.io.messages import TABLE_FRAME, TableFrame, answer_of, table_frame_of, target_of
from rosette_ros.io.model_file import parse_entry, read_model
from rosette_ros.io.run_assembly import RunAnswers
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import ERROR, OK, WARN, CellNode, Health, run_node
from rosette_ros.nodes.evaluation import ModelChange, ModelInUse, RunCollection, declared_sharing
from rosette_ros.nodes.interfaces import introspected_service
from rosette_ros.nodes.joint_conversions import joint_message
from rosette_ros.nodes.liveliness import SETTLING
from rosette_ros.nodes.node_requests import Recalls

WANTED = (
    Wanted('quiet_s', 1.0, 'a run without states of a sequencer is evaluated when all its balls are in and nothing '
           'more has arrived for so long, s of wall time', 0.01, 3600.0),
    Wanted('patience_s', 10.0, 'how long missing messages are waited for before that is reported, s of wall time', 0.01,
           3600.0),
    Wanted('model', '', 'model file (YAML) to start with; empty: the base model', read_only=True),
    Wanted('diagnose_after_run', True, 'whether each run is diagnosed, so that the diagnosis is in its log'),
    Wanted('diagnose_most_balls', MOST_BALLS_JUDGED, 'larger plates are diagnosed on request only', 0, 1000))
RECALL_AFTER, RECALL_PERIOD = 0.3, 2.0
"""Messages that are missing for so long are requested from the recorder, again after so long, s."""


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


class _Results(NamedTuple):
    """What was published last of a run that was evaluated, in this order; published: steady time, s."""

    run_id: str
    published: float
    messages: tuple[tuple[Publisher, Any], ...]


class Evaluator(CellNode):
    """Evaluates and diagnoses runs under the model in use, which requests may change.

    Topics: subscribes to `probe_target`, `ball_centre`, `run_state`, `/tf_static`; publishes `model`, `diagnosis`,
    `error_motions`, in this order, and `joint_evaluation`, all latched. Services: `evaluator/diagnose`,
    `evaluator/add_effect`, `evaluator/remove_effect`, `evaluator/evaluate_jointly`, answered after their calculation,
    during which messages wait. Parameters: WANTED."""

    def __init__(self) -> None:
        super().__init__(names.EVALUATOR, WANTED)
        self._in_use = ModelInUse(read_model(self.parameters['model'] or None))
        self._runs = RunCollection()
        self._level, self._last = OK, 'no run yet'
        self._reported: set[str] = set()
        self._recorder = Recalls(self)
        self._recalled: dict[str, float] = {}
        self._results = _Results('', 0.0, ())
        self._motions_out = self.create_publisher(ErrorMotions, names.ERROR_MOTIONS, qos.RESULT)
        self._model_out = self.create_publisher(Model, names.MODEL, qos.RESULT)
        self._diagnosis_out = self.create_publisher(Diagnosis, names.DIAGNOSIS, qos.RESULT)
        introspected_service(self, Diagnose, names.DIAGNOSE, self._on_diagnose)
        self._joint_out = self.create_publisher(JointEvaluation, names.JOINT_EVALUATION, qos.RESULT)
        introspected_service(self, EvaluateJointly, names.EVALUATE_JOINTLY, self._on_evaluate_jointly)
        introspected_service(self, AddEffect, names.ADD_EFFECT, self._on_add)
        introspected_service(self, RemoveEffect, names.REMOVE_EFFECT, self._on_remove)
        self.on(names.PROBE_TARGET, ProbeTarget, self._on_target, qos.COLLECT_LATCHED, from_one=True)
        self.on(names.BALL_CENTRE, BallCentre, self._on_answer, qos.COLLECT, from_one=True)
        self.on(names.TF_STATIC, TFMessage, self._on_frames, qos.COLLECT_LATCHED)
        self.on(names.RUN_STATE, RunState, self._on_state, qos.COLLECT_LATCHED, from_one=True)
        self.publishers_of(names.RUN_STATE).on_change = self._runs.end_all
        self._model_out.publish(conversions.model_message(self._in_use.model, self.now().to_msg()))

    def _on_target(self, message: ProbeTarget) -> None:
        self._runs.add_target(target_of(message), self.seconds())
        self._evaluate_ready()

    def _on_answer(self, message: BallCentre) -> None:
        self._runs.add_answer(answer_of(message), self.seconds())
        self._evaluate_ready()

    def _on_frames(self, message: TFMessage) -> None:
        for frame in self._frames_in(message.transforms):
            self._runs.add_frame(frame)
        self._evaluate_ready()

    def _frames_in(self, transforms: Iterable[TransformStamped]) -> Iterator[TableFrame]:
        """Yield the table frames among transforms; a malformed one is reported."""
        for one in transforms:
            try:
                if frame := table_frame_of(one):
                    yield frame
            except RosetteError as error:
                self.get_logger().error(f'{names.TF_STATIC}: not used: {error}')

    def _on_state(self, message: RunState) -> None:
        run_id, now = plain(message.run_id), self.seconds()
        if message.phase != RunState.PHASE_EVALUATION:
            self.status.report('')
        if message.phase == RunState.PHASE_IDLE:
            self._runs.end_all()
            self._reported.clear()
        elif message.phase in (RunState.PHASE_CANCELLED, RunState.PHASE_FAILED):
            self._runs.forget(run_id)
            self._recalled.pop(run_id, None)
            self._reported.discard(run_id)  # resumed, it may lack something again
        elif message.phase == RunState.PHASE_EVALUATION:
            self._runs.expect(run_id, message.done, now)
            self._publish_again(run_id, now)
        else:
            self._runs.note_state(run_id, now, message.phase == RunState.PHASE_DONE)
        self._evaluate_ready()

    def wake(self) -> None:
        """Evaluate what is complete; request or report what is missing."""
        now = self.seconds()
        self._recorder.tick(now)
        self._evaluate_ready()
        for run_id in self._runs.lacking():
            requested = self._recalled.setdefault(run_id, now - RECALL_PERIOD + RECALL_AFTER)
            if now - requested >= RECALL_PERIOD and self._recorder.is_there:
                self._recalled[run_id] = now
                self._recorder.recall(run_id, self._on_recalled)
        for run_id, lacks in self._runs.late(now, self.parameters['patience_s']):
            if run_id not in self._reported:
                self._reported.add(run_id)
                self._report_failure(run_id, lacks)

    def _on_recalled(self, response: Recall.Response) -> None:
        if not response.success:
            self.get_logger().warning(f'messages of a run are missing and not recalled: {plain(response.message)}')
            return
        recorded = RunAnswers(response.run_id, list(self._frames_in(response.frames)))
        for target in response.targets:
            recorded.add_target(target_of(target))
        for answer in response.answers:
            recorded.add_answer(answer_of(answer))
        self._runs.add_recorded(recorded, self.seconds())
        self.get_logger().info(plain(f'run {response.run_id}: recalled {len(response.answers)} answers from its log'))
        self._evaluate_ready()

    def _evaluate_ready(self) -> None:
        for run_id in self._runs.ready(self.seconds(), self.parameters['quiet_s']):
            try:
                fit = self._in_use.evaluate(self._runs.to_run(run_id), self._runs.frame(run_id))
            except RosetteError as error:
                self._report_failure(run_id, str(error))
                self.status.report(self._last)  # ends the run: it would wait in vain for error motions
                continue
            diagnosis = self._diagnose_after(fit.run)
            model, motions = self._publish(fit, diagnosis)
            self._results = _Results(run_id, self.seconds(), (
                *([(self._diagnosis_out, diagnosis)] if diagnosis else ()), (self._model_out, model),
                (self._motions_out, motions)))
            doubts = ''.join(f'; {remark}' for remark in fit.run.remarks)
            self._level = WARN if doubts else OK
            self._last = plain(f'run {run_id} is evaluated, {fit.run.size} ball centres{doubts}', most=2000)
            if doubts:
                self.get_logger().warning(self._last)
            else:
                self.get_logger().info(self._last)

    def _diagnose_after(self, run: Run) -> Diagnosis | None:
        """Publish and return the diagnosis of a run that was evaluated; None where it is not wanted or not possible."""
        if not self.parameters['diagnose_after_run']:
            return None
        if run.n > self.parameters['diagnose_most_balls']:
            self.get_logger().info(f'run {run.run_id} has {run.n} balls: it is diagnosed when {names.DIAGNOSE} is '
                                   'called')
            return None
        try:
            diagnosis = self._diagnose(run.run_id)
        except RosetteError as error:
            self.get_logger().warning(f'run {run.run_id} could not be diagnosed: {error}')
            return None
        self.get_logger().info(diagnosis.verdict)
        return diagnosis

    def _publish_again(self, run_id: str, now: float) -> None:
        """Publish the same results again: nodes do not use what is published before they know who publishes it."""
        last = self._results
        if run_id == last.run_id and self._runs.is_evaluated(run_id) and now - last.published >= SETTLING:
            self._results = last._replace(published=now)
            for publisher, message in last.messages:
                publisher.publish(message)

    def _publish(self, fit: Fit, diagnosis: Diagnosis | None) -> tuple[Model, ErrorMotions]:
        """Publish model and error motions; these come last, since they end a run.

        diagnosis: that is published already, None where none is."""
        stamp = self.now().to_msg()
        model, motions = (conversions.model_message(fit.model, stamp, fit),
                          conversions.error_motions_message(fit, stamp, TABLE_FRAME))
        motions.diagnosed, motions.readings_hash = diagnosis is not None, self._runs.readings_hash(fit.run.run_id)
        if diagnosis is not None:
            motions.outcome, motions.verdict, motions.action = diagnosis.outcome, diagnosis.verdict, diagnosis.action
        self._model_out.publish(model)
        self._motions_out.publish(motions)
        return model, motions

    def _diagnose(self, run_id: str = '') -> Diagnosis:
        message = conversions.diagnosis_message(*self._in_use.diagnose(run_id), self.now().to_msg())
        self._diagnosis_out.publish(message)
        return message

    def _report_failure(self, run_id: str, reason: str) -> None:
        self._level, self._last = ERROR, plain(
            f'run {run_id} could not be evaluated: {reason.removeprefix(f"run {run_id}: ")}')
        self.get_logger().error(self._last)

    # Services: what becomes known is published too, before the response

    @_callback_of(names.DIAGNOSE)
    def _on_diagnose(self, request: Diagnose.Request, response: Diagnose.Response) -> None:
        response.diagnosis = self._diagnose(request.run_id)
        response.message = response.diagnosis.verdict

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
        response.message, diagnosis = change.sentence, None
        try:
            diagnosis = self._diagnose(change.run.run_id)
        except RosetteError as error:
            response.message += f'; not diagnosed: {error}'
        _, response.error_motions = self._publish(change.after, diagnosis)
        self.get_logger().info(response.message)

    def health(self) -> Health:
        """Return what became of the last run."""
        return self._level, self._last, {'model': self._in_use.model}


def entry_of(request: AddEffect.Request) -> Mapping[str, object]:
    """Return the effect of a request as a model file describes it; raises InvalidModel."""
    own = {name: getattr(request, name) for name in ('direction', 'expression', 'per') if getattr(request, name)}
    settings = {plain(one.name): _setting(one) for one in request.settings}
    if len(settings) < len(request.settings):
        raise InvalidModel(f'settings: wanted each once, got {", ".join(plain(one.name) for one in request.settings)}')
    given = [*(['settings'] if settings else ()), *own]
    if request.definition and given:
        raise InvalidModel(f'definition: wanted it empty, or no {", ".join(given)} beside it')
    if settings and own:
        raise InvalidModel(f"settings: wanted none for a user's own term ({', '.join(own)}), got {', '.join(settings)}")
    if own:
        return {'own': request.effect, **own}
    return settings or parse_entry(request.definition, 'definition')


def _setting(parameter: Parameter) -> float | str:
    value, name = parameter.value, plain(parameter.name)
    fields = {ParameterType.PARAMETER_DOUBLE: 'double_value', ParameterType.PARAMETER_INTEGER: 'integer_value',
              ParameterType.PARAMETER_STRING: 'string_value'}
    if value.type not in fields:
        raise InvalidModel(f'settings: {name}: wanted a number or a text, got a parameter of type {value.type}')
    return getattr(value, fields[value.type])


main = partial(run_node, names.EVALUATOR, Evaluator)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())
