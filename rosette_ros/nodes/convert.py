# SPDX-License-Identifier: Apache-2.0
"""Messages to records and back, and nothing else."""

import math
import struct

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Transform, TransformStamped, Vector3
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy
from rosette_msgs.msg import (
    BallCentre,
    Candidate,
    Diagnosis,
    Effect,
    ErrorMotions,
    Model,
    ProbeTarget,
    RunState,
)
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from rosette_ros.core import records
from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import Frame
from rosette_ros.data.bag_metadata import Qos
from rosette_ros.data.model_file import format_entry
from rosette_ros.data.table_frame import frame_told
from rosette_ros.nodes.programme import Answer, Phase, Target


def nanoseconds(stamp):
    """Return a message's time in ns since the epoch, int."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def time_message(stamp_ns):
    """Return a Time message of ns since the epoch, the nearest that there is."""
    stamp_ns = min(max(stamp_ns, -2**31 * 1_000_000_000), 2**31 * 1_000_000_000 - 1)
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def clock_nanoseconds(data):
    """Return the time in a serialised Clock, ns; data: CDR bytes, little-endian or big-endian."""
    try:
        order = '<' if data[1] & 1 else '>'
        seconds, rest = struct.unpack_from(f'{order}iI', data, 4)
    except (struct.error, IndexError) as error:
        raise InvalidData(f'Clock: wanted its CDR, got {len(data)} bytes that are none') from error
    return seconds * 1_000_000_000 + rest


def answer_head(data):
    """Return (stamp in ns, run_id, seq, status) of a serialised BallCentre, in a tenth of the time of the message.

    data: CDR bytes, little-endian or big-endian. Numbers stand at multiples of their size, texts with their length.
    """
    try:
        order = '<' if data[1] & 1 else '>'
        seconds, rest, length = struct.unpack_from(f'{order}iII', data, 4)
        at = 16 + length + (-length) % 4
        length, = struct.unpack_from(f'{order}I', data, at)
        run_id = data[at + 4:at + 3 + length].decode(errors='replace')
        seq, _, _, _, status = struct.unpack_from(f'{order}IIIIB', data, at + 4 + length + (-length) % 4)
    except (struct.error, IndexError) as error:
        raise InvalidData(f'BallCentre: wanted its CDR, got {len(data)} bytes that are none') from error
    return seconds * 1_000_000_000 + rest, run_id, seq, status


def point(values):
    """Return a Point of (3,) numbers, m."""
    return Point(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def point_array(message):
    """Return the numbers of a Point, (3,), m."""
    return np.array([message.x, message.y, message.z])


def target_message(target: Target, run_id, attempt, session, centre, frame_id, stamp):
    """Return the ProbeTarget of a target whose centre is given in `frame_id`; stamp: Time."""
    return ProbeTarget(
        header=Header(stamp=stamp, frame_id=frame_id), run_id=run_id, seq=target.seq,
        attempt=attempt, session=session, phase=int(target.phase), balls=target.balls, radius=target.radius,
        table_position=target.table_position, ball=target.ball,
        cmm_position=target.cmm_position, table_angle=target.table_angle,
        approach=target.approach, centre=point(centre))


def answer_record(message: BallCentre):
    """Return the Answer of a BallCentre."""
    return Answer(
        run_id=message.run_id, seq=message.seq, table_position=message.table_position,
        ball=message.ball, cmm_position=message.cmm_position,
        ok=message.status == BallCentre.STATUS_OK, text=message.text,
        frame_id=message.header.frame_id, table_angle=message.table_angle,
        table_travel=message.table_travel, centre=point_array(message.centre),
        stamp_ns=nanoseconds(message.header.stamp))


def state_message(phase: Phase, run_id, order, done, total, text, stamp):
    """Return the RunState of a phase."""
    return RunState(header=Header(stamp=stamp), run_id=run_id, phase=int(phase), order=order,
                    done=done, total=total, text=text)


def frame_message(frame: Frame, parent, child, stamp):
    """Return the TFMessage that says where the frame `child` is in `parent`."""
    x, y, z, w = (float(value) for value in frame.quaternion())
    origin = [float(value) for value in frame.origin]
    transform = TransformStamped(
        header=Header(stamp=stamp, frame_id=parent), child_frame_id=child,
        transform=Transform(translation=Vector3(x=origin[0], y=origin[1], z=origin[2]),
                            rotation=Quaternion(x=x, y=y, z=z, w=w)))
    return TFMessage(transforms=[transform])


def frame_record(transform: Transform):
    """Return the Frame of a Transform message; raises InvalidData where it is none."""
    q, t = transform.rotation, transform.translation
    return frame_told((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def error_motions_record(message: ErrorMotions):
    """Return the core record of an ErrorMotions message; raises InvalidData where its curves are no curves."""
    if not len(message.angle):
        raise InvalidData(f'error motions of run {message.run_id!r}: wanted curves, got none')
    return records.ErrorMotions.from_curves(
        message.angle, [getattr(message, curve) for curve in records.CURVES],
        [getattr(message, f'u_{curve}') for curve in records.CURVES])


def error_motions_message(run, report, stamp, frame_id):
    """Return the ErrorMotions message of a Report; float64 on both sides, so it is exact."""
    motions, fit = report.error_motions, report.fit
    curves = {}
    for curve in records.CURVES:
        curves[curve] = motions[curve]
        curves[f'u_{curve}'] = motions.uncertainty(curve)
    return ErrorMotions(
        header=Header(stamp=stamp, frame_id=frame_id), run_id=run.run_id, balls=run.n,
        radius=float(run.radius), angle=motions.angle, model_name=str(report.model),
        model_hash=report.model.hash, residual_rms=float(fit.rms), sigma=float(fit.sigma),
        degrees_of_freedom=int(fit.dof), rank=int(fit.rank),
        completeness=float(run.completeness), **curves)


_HISTORY = {HistoryPolicy.KEEP_ALL: 'keep_all'}
_RELIABILITY = {ReliabilityPolicy.BEST_EFFORT: 'best_effort'}
_DURABILITY = {DurabilityPolicy.TRANSIENT_LOCAL: 'transient_local'}
_LIVELINESS = {LivelinessPolicy.MANUAL_BY_TOPIC: 'manual_by_topic'}
_DEPTH_UNKNOWN = 10


def qos_record(profile):
    """Return the Qos of a publisher's QoSProfile as found on the graph.

    History and depth do not travel in discovery: what is unknown becomes "keep last 10".
    """
    return Qos(
        history=_HISTORY.get(profile.history, 'keep_last'),
        depth=profile.depth or _DEPTH_UNKNOWN,
        reliability=_RELIABILITY.get(profile.reliability, 'reliable'),
        durability=_DURABILITY.get(profile.durability, 'volatile'),
        deadline_ns=profile.deadline.nanoseconds, lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=_LIVELINESS.get(profile.liveliness, 'automatic'),
        liveliness_lease_ns=profile.liveliness_lease_duration.nanoseconds)


def fill_answer(message: BallCentre, reading, stamp, frame_id):
    """Write a machine's Reading into the answer to a target."""
    message.header.stamp, message.header.frame_id = stamp, frame_id
    message.status = BallCentre.STATUS_OK
    message.table_angle, message.table_travel = reading.table_angle, reading.table_travel
    message.approach = int(reading.approach)
    message.centre = point(reading.centre)
    message.form_error, message.temperature = reading.form_error, reading.temperature


def target_row(message: ProbeTarget):
    """Return a ProbeTarget as a mapping by the columns of data.assemble.TargetTable."""
    return {'run_id': message.run_id, 'seq': message.seq, 'attempt': message.attempt,
            'phase': message.phase, 'balls': message.balls, 'radius': message.radius,
            'table_position': message.table_position, 'ball': message.ball,
            'stamp_ns': nanoseconds(message.header.stamp), 'session': message.session}


def answer_row(message: BallCentre):
    """Return a BallCentre as a mapping by the columns of data.assemble.AnswerTable."""
    centre = message.centre
    return {'run_id': message.run_id, 'seq': message.seq,
            'table_position': message.table_position, 'ball': message.ball,
            'status': message.status, 'stamp_ns': nanoseconds(message.header.stamp),
            'frame_id': message.header.frame_id, 'table_angle': message.table_angle,
            'table_travel': message.table_travel, 'approach': message.approach,
            'centre': (centre.x, centre.y, centre.z), 'form_error': message.form_error,
            'temperature': message.temperature, 'text': message.text}


def model_message(model, stamp, report=None):
    """Return the Model message of a model; report: its Report on a run, or None before one."""
    fit = report.fit if report else None
    if fit:
        effects = [effect_message(effect.name, effect.parameters, _definition(term))
                   for effect, term in zip(fit.effects, model.terms, strict=True)]
    else:
        effects = [effect_message(term.name, (), _definition(term)) for term in model.terms]
    chi_square = fit.reduced_chi_square if fit else None
    return Model(
        header=Header(stamp=stamp), run_id=report.run.run_id if report else '', name=str(model),
        hash=model.hash, base=list(model.base),
        effects=effects,
        residual_rms=float(fit.rms) if fit else math.nan,
        reduced_chi_square=math.nan if chi_square is None else float(chi_square))


def effect_message(name, parameters, definition=''):
    """Return the Effect message of an effect's name, fitted Parameters and definition in YAML."""
    return Effect(
        name=name, definition=definition, parameter=[one.name for one in parameters],
        value=[float(one.value) for one in parameters], u=[float(one.u) for one in parameters],
        unit=[one.unit for one in parameters])


def _definition(term):
    """Return what a model file says of a term besides its name, YAML; empty where nothing."""
    entry = term.to_entry()
    return '' if isinstance(entry, str) else format_entry(entry)


def diagnosis_message(run, diagnosis, stamp):
    """Return the Diagnosis message of a core Diagnosis of a run."""
    return Diagnosis(
        header=Header(stamp=stamp), run_id=run.run_id, model_name=str(diagnosis.model),
        model_hash=diagnosis.model.hash, verdict=diagnosis.verdict,
        missing=list(diagnosis.missing), unexplained=bool(diagnosis.unexplained),
        unexplained_text=diagnosis.unexplained_text,
        candidates=[candidate_message(entry) for entry in diagnosis.candidates],
        invisible=list(diagnosis.invisible))


def candidate_message(entry):
    """Return the Candidate message of a core Candidate; what was searched is its definition."""
    setting = format_entry(dict(entry.setting)) if entry.setting else ''
    return Candidate(
        effect=entry.effect, p=float(entry.p), visible_fraction=float(entry.visible_fraction),
        rms_before=float(entry.rms_before), rms_after=float(entry.rms_after),
        held_out_rms_before=float(entry.held_out_before),
        held_out_rms_after=float(entry.held_out_after), delta_bic=float(entry.delta_bic),
        parameters=effect_message(entry.effect, entry.parameters, setting),
        look_alikes=list(entry.look_alikes))
