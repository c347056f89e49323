# SPDX-License-Identifier: Apache-2.0
"""Records to messages and back."""

import math
from array import array
from collections.abc import Iterable, Sequence
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Transform, TransformStamped, Vector3
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosette_msgs import msg
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from rosette_ros.calibration.calibration_plan import BLOCK, block_of
from rosette_ros.calibration.goal import OF_EVENT, Job, Request
from rosette_ros.core.diagnosis.noise_facts import noise_facts
from rosette_ros.core.run import records
from rosette_ros.core.run.errors import InvalidData, plain
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_run import PublishedMotions
from rosette_ros.io.messages import TOUCH_ARRAYS, Answer, Target, table_frame_of
from rosette_ros.io.model_file import format_entry
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.words.verdict_words import noise_words, unexplained_words, verdict_text

if TYPE_CHECKING:  # a node that only passes messages on starts in half of the time without what makes these
    from rosette_ros.core.diagnosis import diagnosis as core
    from rosette_ros.core.diagnosis.cause import MissingEffect
    from rosette_ros.core.diagnosis.run_result import RunCurves, RunResult
    from rosette_ros.core.model import model as core_model
    from rosette_ros.core.model.least_squares import Fit, Parameter
    from rosette_ros.dme.ball_probing import MeasuredBall
    from rosette_ros.simulation.probing import BallReading

POLICIES = {'history': HistoryPolicy.KEEP_ALL, 'reliability': ReliabilityPolicy.BEST_EFFORT,
            'durability': DurabilityPolicy.TRANSIENT_LOCAL, 'liveliness': LivelinessPolicy.MANUAL_BY_TOPIC}
"""Of each policy the value that is not the default of Qos."""
_POINTS = 'centre', 'pole'


def event_message(header: Header, request: Request, kind: int, text: str, job: Job | None) -> msg.CalibrationEvent:
    """Return the event of a request, and of its job where there is one."""
    goal, given = job.goal if job else None, {**OF_EVENT, **request.goal}
    return msg.CalibrationEvent(
        header=header, run_id=job.run_id if job else '', kind=kind, origin=request.origin,
        order=job.order if job else given['order'], goal_id=bytes(goal.goal_id.uuid).hex() if goal else '',
        seed=given['seed'], options=given['options'], fields=request.fields, settings=job.settings if job else '',
        resumes=job.resumes if job else '', text=text)


def time_message(stamp_ns: int) -> Time:
    """Return a Time message of ns since the epoch, the nearest that there is."""
    stamp_ns = min(max(stamp_ns, -2**31 * 1_000_000_000), 2**31 * 1_000_000_000 - 1)
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def point(values: Sequence[float] | records.Floats) -> Point:
    """Return a Point of (3,) numbers, m."""
    return Point(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def point_array(message: Point | Vector3) -> records.Floats:
    """Return the numbers of a Point or Vector3, (3,)."""
    return np.array([message.x, message.y, message.z])


def target_message(target: Target, stamp: Time | None = None) -> msg.ProbeTarget:
    """Return the ProbeTarget of a target; stamp: another than its own."""
    fields = {name: value for name, value in target._asdict().items() if name not in ('frame_id', 'stamp_ns')}
    return msg.ProbeTarget(**{**fields, 'phase': int(target.phase), 'centre': point(target.centre),
                             'pole': Vector3(**dict(zip('xyz', target.pole, strict=True)))},
                       header=Header(stamp=stamp or time_message(target.stamp_ns), frame_id=target.frame_id))


def block_message(block: Scheme | None) -> msg.Block:
    """Return the Block of readings, an empty one of None."""
    return msg.Block() if block is None else msg.Block(**{name: getattr(block, name).tolist() for name in BLOCK})


def block_scheme(message: msg.Block, n: int) -> Scheme | None:
    """Return the readings of a Block on n balls, None where it has none; raises InvalidPlan as block_of does."""
    block = block_of(n, {name: getattr(message, name) for name in BLOCK})
    return block if block.ball.size else None


def run_message(answers: RunAnswers, frames: list[TransformStamped], stamp: Time) -> msg.Run:
    """Return the Run message of all targets and answers of a run and its table frames."""
    made = msg.Run(header=Header(stamp=stamp), run_id=answers.run_id, frames=frames)
    for target in Target._fields[1:]:  # without run_id
        setattr(made, f'target_{target}', answers.targets.column(target))
    for answer in Answer._fields[1:]:
        setattr(made, f'answer_{answer}', answers.answers.column(answer))
    return made


def answers_of(message: msg.Run) -> RunAnswers:
    """Return what a Run message holds; raises InvalidData where its arrays are of different lengths."""
    answers = RunAnswers(plain(message.run_id))
    try:
        for row in zip(*(_column(message, 'target', name) for name in Target._fields), strict=True):
            answers.add_target(Target(*row))
        for row in zip(*(_column(message, 'answer', name) for name in Answer._fields), strict=True):
            answers.add_answer(Answer(*row))
    except ValueError as error:
        raise InvalidData(f'run {answers.run_id}: expected arrays of one length, found others') from error
    answers.frames += filter(None, map(table_frame_of, message.frames))
    return answers


def _column(message: msg.Run, kind: str, name: str) -> Iterable[Any]:
    if name == 'run_id':
        return repeat(plain(message.run_id), len(getattr(message, f'{kind}_seq')))
    values = getattr(message, f'{kind}_{name}')
    if name in _POINTS:
        return zip(values[::3], values[1::3], values[2::3], strict=True)
    return map(plain, values) if name in ('text', 'frame_id') else values


def answer_message(answer: Answer) -> msg.BallCentre:
    """Return the BallCentre of an answer."""
    fields = {name: value for name, value in answer._asdict().items() if name not in ('frame_id', 'stamp_ns')}
    return msg.BallCentre(**{**fields, 'centre': point(answer.centre)},
                          header=Header(stamp=time_message(answer.stamp_ns), frame_id=answer.frame_id))


def frame_message(frame: Frame, parent: str, child: str, stamp: Time) -> TFMessage:
    """Return the TFMessage that says where the frame `child` is in `parent`."""
    x, y, z = map(float, frame.origin)
    transform = Transform(translation=Vector3(x=x, y=y, z=z), rotation=_quaternion(frame))
    return TFMessage(transforms=[TransformStamped(header=Header(stamp=stamp, frame_id=parent), child_frame_id=child,
                                                  transform=transform)])


def _quaternion(frame: Frame) -> Quaternion:
    return Quaternion(**dict(zip('xyzw', map(float, frame.quaternion()), strict=True)))


def published_motions(message: msg.ErrorMotions) -> PublishedMotions:
    """Return what an ErrorMotions message states; raises InvalidData where its curves are no curves."""
    if not len(message.angle):
        raise InvalidData(f'error motions of run {message.run_id!r}: expected curves, found none')
    return PublishedMotions.of(message)


def curve_fields(motions: records.ErrorMotions) -> dict[str, records.Floats]:
    """Return the fields of six curves and their standard uncertainties in a message; float64, so they are exact."""
    return {curve: motions[curve] for curve in records.CURVES} | {
        f'u_{curve}': motions.uncertainty(curve) for curve in records.CURVES}


def error_motions_message(result: 'RunResult', stamp: Time, frame_id: str) -> msg.ErrorMotions:
    """Return the ErrorMotions message of the result of a run."""
    fit, run, motions = result.fit, result.fit.run, result.curves.motions
    orientation = (Quaternion(x=0.0, y=0.0, z=0.0, w=0.0) if motions.rotation is None else
                   _quaternion(Frame(motions.rotation, np.zeros(3))))
    verdict = verdict_text(result.verdict) if result.verdict else None
    said = {'outcome': str(verdict.outcome), 'verdict': verdict.sentence, 'action': verdict.action} if verdict else {}
    return msg.ErrorMotions(
        header=Header(stamp=stamp, frame_id=frame_id), orientation=orientation, run_id=run.run_id, balls=run.n,
        radius=float(run.radius), angle=motions.angle, model_name=str(fit.model), model_hash=fit.model.hash,
        residual_rms=float(fit.rms), sigma=float(fit.sigma), degrees_of_freedom=int(fit.dof), rank=int(fit.rank),
        completeness=float(run.completeness), diagnosed=verdict is not None, which=str(result.curves.which),
        modelled=msg.Curves(**_with_ranges(result.modelled)), **_with_ranges(result.curves), **said)


def _with_ranges(curves: 'RunCurves') -> dict[str, Any]:
    motions, lines = curves.lines_with()
    return {**curve_fields(motions), 'range': [line.range for line in lines],
            'expanded_range': [line.expanded for line in lines]}


def qos_record(profile: QoSProfile) -> Qos:
    """Return the Qos of a publisher's QoSProfile as found on the graph.

    History and depth do not travel in discovery: what is unknown becomes "keep last 10"."""
    words = {name: policy.short_key for name, policy in POLICIES.items() if getattr(profile, name) is policy}
    return Qos(depth=profile.depth or 10, deadline=profile.deadline.nanoseconds, lifespan=profile.lifespan.nanoseconds,
               liveliness_lease_duration=profile.liveliness_lease_duration.nanoseconds, **words)


def qos_profile(recorded: Sequence[Qos], messages: int) -> QoSProfile:
    """Return the QoS profile with which a log is published: the first recorded one, defaults where there is none.

    The queue is as long as there are messages, so that none is dropped before a subscriber has it. Limits in time
    (deadline, lifespan, lease) are left out: they were promises of a live cell."""
    qos = recorded[0] if recorded else Qos()
    return QoSProfile(depth=max(qos.depth, messages, 1), **{
        name: policy if getattr(qos, name) == policy.short_key else type(policy)[getattr(Qos, name).upper()]
        for name, policy in POLICIES.items()})


def fill_answer(message: msg.BallCentre, reading: 'BallReading | MeasuredBall', stamp: Time, frame_id: str) -> None:
    """Write a machine's Reading into the answer to a target."""
    message.header, message.status = Header(stamp=stamp, frame_id=frame_id), msg.BallCentre.STATUS_OK
    message.table_angle, message.table_travel = reading.table_angle, reading.table_travel
    message.approach, message.centre = int(reading.approach), point(reading.centre)
    message.form_error, message.temperature = reading.form_error, reading.temperature


def touches_message(answer: msg.BallCentre, points: records.Floats, normals: records.Floats, times: records.Floats,
                    tip_radius: float, is_compensated: bool = False) -> msg.Touches:
    """Return the Touches message of the touches from which the centre in an answer was calculated.

    points: (Q, 3) m, in the frame of the answer, centres of the tip, or of the ball's surface where compensated;
    normals: (Q, 3) unit vectors out of the material; times: (Q,) s after the answer's stamp; tip_radius: m.
    """
    same = ('header', 'run_id', 'seq', 'table_position', 'ball', 'cmm_position', 'table_angle')
    columns = np.vstack([points.T, normals.T, times])
    return msg.Touches(
        **{name: getattr(answer, name) for name in same}, tip_radius=float(tip_radius), is_compensated=is_compensated,
        **{name: array('d', values.tobytes()) for name, values in zip(TOUCH_ARRAYS, columns, strict=True)})


def model_message(model: 'core_model.Model', stamp: Time, fit: 'Fit | None' = None) -> msg.Model:
    """Return the Model message of a model; fit: of the model to a run, or None before one."""
    message = msg.Model(header=Header(stamp=stamp), name=str(model), hash=model.hash, base=list(model.base),
                    residual_rms=math.nan, reduced_chi_square=math.nan)
    parameters = [effect.parameters for effect in fit.effects] if fit else [()] * len(model.terms)
    message.effects = [effect_message(term.name, fitted, _definition(term))
                       for term, fitted in zip(model.terms, parameters, strict=True)]
    if fit is not None:
        message.run_id, message.residual_rms = fit.run.run_id, float(fit.rms)
        if fit.reduced_chi_square is not None:
            message.reduced_chi_square = float(fit.reduced_chi_square)
    return message


def effect_message(name: str, parameters: 'Sequence[Parameter]', definition: str = '') -> msg.Effect:
    """Return the Effect message of an effect's name, fitted Parameters and definition in YAML."""
    return msg.Effect(name=name, definition=definition, parameter=[one.name for one in parameters],
                  value=[float(one.value) for one in parameters], u=[float(one.u) for one in parameters],
                  unit=[one.unit for one in parameters])


def _definition(term: 'core_model.Term') -> str:
    """Return what a model file says of a term besides its name, YAML; empty where nothing."""
    entry = term.to_entry()
    return '' if isinstance(entry, str) else format_entry(entry)


def diagnosis_message(run: records.Run, diagnosis: 'core.Diagnosis', stamp: Time) -> msg.Diagnosis:
    """Return the Diagnosis message of a core Diagnosis of a run."""
    model, text = diagnosis.model, verdict_text(diagnosis.verdict)
    return msg.Diagnosis(
        header=Header(stamp=stamp), run_id=run.run_id, model_name=str(model), model_hash=model.hash,
        verdict=text.sentence, outcome=str(text.outcome), level=str(text.level), action=text.action,
        missing=list(diagnosis.missing), unexplained=bool(diagnosis.unexplained),
        unexplained_text=unexplained_words(diagnosis.verdict),
        candidates=list(map(candidate_message, diagnosis.candidates)), invisible=list(diagnosis.invisible),
        noise=noise_message(diagnosis.final))


def noise_message(fit: 'Fit') -> msg.Noise:
    """Return the Noise message of the noise under which a run was fitted."""
    noise = fit.noise
    return msg.Noise(
        sigma=float(fit.sigma), sigma_source=fit.sigma_source, is_white=noise.is_white and not fit.step,
        words=noise_words(noise_facts(fit)), axes=noise.axes, by=noise.by, factors=noise.factors, tail=noise.tail,
        tail_dof=float(noise.tail_dof), memory=float(noise.phi), wander=noise.wander,
        resolution=float(fit.step))


def candidate_message(entry: 'MissingEffect') -> msg.Candidate:
    """Return the Candidate message of a core MissingEffect; what was searched is its definition."""
    setting = format_entry(dict(entry.setting)) if entry.setting else ''
    return msg.Candidate(
        effect=entry.name, p=float(entry.p), visible_fraction=float(entry.visible_fraction),
        rms_before=float(entry.before), rms_after=float(entry.after), look_alikes=list(entry.look_alikes),
        parameters=effect_message(entry.name, entry.parameters, setting),
        held_out_rms_before=math.nan, held_out_rms_after=math.nan, delta_bic=math.nan)  # no longer calculated
