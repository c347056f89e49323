# SPDX-License-Identifier: Apache-2.0
"""A log into arrays and a Run, decoded in bulk by the schemas that the log carries."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import Frame
from rosette_ros.core.records import CURVES, ErrorMotions
from rosette_ros.data.assemble import (
    MACHINE_FRAME,
    TABLE_FRAME,
    AnswerTable,
    Phase,
    TargetTable,
    assemble_run,
    choose_run,
    runs_in,
)
from rosette_ros.data.bag_metadata import TopicSummary, parse_qos
from rosette_ros.data.cdr import decode_columns, decode_message
from rosette_ros.data.labels import Labels
from rosette_ros.data.log_files import custom_data, find_files, open_files
from rosette_ros.data.ros2msg import parse_schema
from rosette_ros.data.table_frame import frame_told, refuse_two_frames

BALL_CENTRE = 'rosette_msgs/msg/BallCentre'
PROBE_TARGET = 'rosette_msgs/msg/ProbeTarget'
RUN_STATE = 'rosette_msgs/msg/RunState'
ERROR_MOTIONS = 'rosette_msgs/msg/ErrorMotions'
CALIBRATION_EVENT = 'rosette_msgs/msg/CalibrationEvent'
TF_MESSAGE = 'tf2_msgs/msg/TFMessage'
TF_STATIC = 'tf_static'

REPEATABILITY_KEY, DOF_KEY = 'rosette.repeatability_m', 'rosette.repeatability_dof'
"""Entries of custom_data where the repeatability is known but was not measured in the log."""
RESUMES_KEY = 'rosette.resumes'
"""Entry of custom_data, name of the log that a run goes on from."""
REPEATS_KEY = 'rosette.repeated_balls'
"""Entry of custom_data, `yes` where balls were planned more than once."""

_STAMP = {'sec': 'header.stamp.sec', 'nanosec': 'header.stamp.nanosec'}
_COLUMNS = {
    BALL_CENTRE: {
        **_STAMP, 'run_id': 'run_id', 'seq': 'seq', 'table_position': 'table_position',
        'ball': 'ball', 'status': 'status', 'frame_id': 'header.frame_id', 'text': 'text',
        'table_angle': 'table_angle', 'table_travel': 'table_travel', 'approach': 'approach',
        'x': 'centre.x', 'y': 'centre.y', 'z': 'centre.z', 'form_error': 'form_error',
        'temperature': 'temperature'},
    PROBE_TARGET: {
        **_STAMP, 'run_id': 'run_id', 'seq': 'seq', 'attempt': 'attempt', 'phase': 'phase',
        'balls': 'balls', 'radius': 'radius', 'table_position': 'table_position', 'ball': 'ball',
        'session': 'session'},
    RUN_STATE: {
        **_STAMP, 'run_id': 'run_id', 'phase': 'phase', 'order': 'order', 'done': 'done',
        'total': 'total', 'text': 'text'},
}
_YOUNG = {PROBE_TARGET: ('session',)}
"""Fields that older logs do not have; 0 where they are missing."""
_TEXTS = frozenset(('run_id', 'frame_id', 'text', 'order'))
_REALS = frozenset(('table_angle', 'table_travel', 'x', 'y', 'z', 'form_error', 'temperature', 'radius'))
_SINGLE = frozenset((ERROR_MOTIONS, CALIBRATION_EVENT))


@dataclass(frozen=True, eq=False)
class TableFrame:
    """A table frame that was latched: stamp in ns, frame: geometry.Frame in `parent`."""

    stamp_ns: int
    parent: str
    frame: Frame


@dataclass(frozen=True, eq=False)
class PublishedMotions:
    """Error motions as the evaluator published them, with what it said of the fit."""

    run_id: str
    motions: ErrorMotions
    model_name: str
    model_hash: str
    residual_rms: float
    sigma: float
    degrees_of_freedom: int
    rank: int
    completeness: float


@dataclass(frozen=True)
class LastState:
    """The last RunState of a run; phase as in RunState.msg."""

    run_id: str
    phase: int
    order: str
    done: int
    total: int
    text: str
    stamp_ns: int


@dataclass(frozen=True, eq=False)
class LogRun:
    """What a log holds.

    path, files: where; targets, answers: all ProbeTargets and BallCentres in order of receipt;
    frames: TableFrame each; error_motions: PublishedMotions each; states: LastState of each run;
    events: CalibrationEvents, decoded; topics: TopicSummary each; messages: number read; start_ns,
    end_ns: first and last log time; truncated: whether the log ends in the middle; problems: what
    is wrong with it, in words; custom_data: mapping of texts.
    """

    path: Path
    files: tuple
    targets: TargetTable
    answers: AnswerTable
    frames: tuple
    error_motions: tuple
    states: tuple
    events: tuple
    topics: tuple
    messages: int
    start_ns: int
    end_ns: int
    truncated: bool
    problems: tuple
    custom_data: dict

    @property
    def run_ids(self):
        """Runs in the log, in order of appearance."""
        return runs_in(self.targets)

    def latest_error_motions(self, run_id=None):
        """Return the PublishedMotions that came last (of one run), or None."""
        found = [one for one in self.error_motions if run_id in (None, one.run_id)]
        return found[-1] if found else None

    def frame_of(self, run_id):
        """Return the Frame of the table in the machine that holds for a run, or None.

        The last one latched before the run's first target; if none was, the first one of all.

        Raises InvalidData where frames that differ were latched during the alignment of the run.
        """
        if not self.frames:
            return None
        refuse_two_frames([(one.stamp_ns, one.frame) for one in self.frames], self.targets, self.answers, run_id,
                          str(self.path))
        rows = self.targets.run_id.equal(run_id) & (self.targets.phase == Phase.RUN)
        begin = self.targets.stamp_ns[rows].min()
        before = [one for one in self.frames if one.stamp_ns <= begin]
        return max(before, key=lambda one: one.stamp_ns).frame if before else self.frames[0].frame

    def to_run(self, run_id=None):
        """Return the Run of the log; run_id chooses where there are several.

        Raises InvalidData where there is no ball centre, or no one run; see assemble_run.
        """
        source = str(self.path)
        if not len(self.answers):
            topics = ', '.join(topic.name for topic in self.topics) or 'none'
            raise InvalidData(f'{source}: wanted ball centres ({BALL_CENTRE}), got none in '
                              f'{self.messages} messages (topics: {topics})')
        run_id = choose_run(self.targets, run_id, source)
        run = assemble_run(self.targets, self.answers, self.frame_of(run_id), run_id, source,
                           repeats=self.custom_data.get(REPEATS_KEY) == 'yes')
        if run.repeatability is None and REPEATABILITY_KEY in self.custom_data:
            run = self._with_known_repeatability(run)
        return run

    def _with_known_repeatability(self, run):
        try:
            sigma = float(self.custom_data[REPEATABILITY_KEY])
            dof = self.custom_data.get(DOF_KEY)
            dof = None if dof is None else float(dof)
        except ValueError as error:
            raise InvalidData(f'{self.path}: custom_data: {REPEATABILITY_KEY}: wanted a number, '
                              f'got {self.custom_data[REPEATABILITY_KEY]!r}') from error
        return run.replace(repeatability=sigma, repeatability_dof=dof)


def read_log(path) -> LogRun:
    """Return what a log directory or an .mcap file holds; a log cut short gives what is whole.

    Raises InvalidData where there is no log, it is empty, of another profile, or its ball centres
    cannot be decoded.
    """
    path = Path(path)
    listing = find_files(path)
    reading = _Reading(listing.problems)
    files = open_files(listing.files)
    for file in files:
        for batch in file.batches():
            reading.take(file, batch)
        reading.note_topics(file)
    return reading.result(path, files, listing.custom_data or custom_data(files))


class _Reading:
    """What has been read so far, over the files of a log."""

    def __init__(self, problems=()):
        self.columns = {type_name: [] for type_name in _COLUMNS}
        self.frames, self.motions, self.events = [], [], []
        self.topics, self.counts = {}, {}
        self.problems = list(problems)
        self.start, self.end = [], []
        self._schemas = {}

    def take(self, file, batch):
        """Take the messages of one batch."""
        if batch.log_time.size:
            self.start.append(int(batch.log_time.min()))
            self.end.append(int(batch.log_time.max()))
        bulk = {}
        counts = np.bincount(batch.channel)
        for identifier in np.flatnonzero(counts).tolist():
            channel, count = file.channels.get(identifier), int(counts[identifier])
            if channel is None:
                self.problems.append(f'{file.path}: {count} messages of a channel that the log '
                                     'does not describe')
                continue
            self.counts[channel.topic] = self.counts.get(channel.topic, 0) + count
            if channel.type_name in _COLUMNS:
                key = (channel.type_name, channel.schema_text)
                bulk.setdefault(key, (channel, []))[1].append(identifier)
            elif self._is_single(channel):
                self._take_single(file, channel, batch, np.flatnonzero(
                    batch.channel == identifier))
        for (type_name, _), (channel, own) in bulk.items():
            wanted = np.zeros(counts.size, dtype=bool)
            wanted[own] = True
            rows = np.flatnonzero(wanted[batch.channel])
            self._take_columns(file, type_name, channel, batch, rows)

    def note_topics(self, file):
        """Note the topics of a file that was read."""
        for channel in file.channels.values():
            self.topics[channel.topic] = TopicSummary(
                channel.topic, channel.type_name, channel.metadata.get('topic_type_hash', ''),
                parse_qos(channel.metadata.get('offered_qos_profiles', '')))

    def result(self, path, files, custom):
        """Return the LogRun."""
        targets, answers = self._table(PROBE_TARGET), self._table(BALL_CENTRE)
        centre = np.stack([answers.pop(axis) for axis in 'xyz'], axis=-1)
        return LogRun(
            path=path, files=tuple(Path(file.path) for file in files),
            targets=TargetTable(**targets), answers=AnswerTable(centre=centre, **answers),
            frames=tuple(self.frames), error_motions=tuple(self.motions),
            states=self._last_states(), events=tuple(self.events),
            topics=tuple(TopicSummary(topic.name, topic.type_name, topic.hash, topic.qos,
                                      self.counts.get(name, 0))
                         for name, topic in self.topics.items()),
            messages=sum(file.messages for file in files),
            start_ns=min(self.start, default=0), end_ns=max(self.end, default=0),
            truncated=any(file.truncated for file in files),
            problems=tuple(self.problems + [line for file in files for line in file.problems]),
            custom_data=custom)

    def _is_single(self, channel):
        return channel.type_name in _SINGLE or (
            channel.type_name == TF_MESSAGE and channel.topic.split('/')[-1] == TF_STATIC)

    def _schema(self, file, channel):
        if channel.message_encoding != 'cdr' or channel.schema_encoding != 'ros2msg':
            raise InvalidData(
                f'{file.path}: topic {channel.topic}: wanted messages in cdr with a schema in '
                f'ros2msg, got {channel.message_encoding!r} and {channel.schema_encoding!r}')
        key = (channel.type_name, channel.schema_text)
        if key not in self._schemas:
            self._schemas[key] = parse_schema(*key)
        return self._schemas[key]

    def _take_columns(self, file, type_name, channel, batch, rows):
        names = _COLUMNS[type_name]
        try:
            schema = self._schema(file, channel)
            lacking = set(_YOUNG.get(type_name, ())) - {field.name for field in schema.fields}
            values = decode_columns(schema, batch.buffer, batch.start[rows], batch.end[rows],
                                    [source for source in names.values() if source not in lacking])
            _check_kinds(schema, names, values)
        except InvalidData as error:
            raise InvalidData(f'{file.path}: topic {channel.topic}: {error}') from error
        values.update(dict.fromkeys(lacking, np.zeros(rows.size, dtype=np.int32)))
        table = {name: values[source] for name, source in names.items()}
        table['place'] = (len(self.start), rows)
        self.columns[type_name].append(table)

    def _table(self, type_name):
        """Return the columns of a type over the whole log, in order of receipt."""
        parts = self.columns[type_name]
        # Channels of different schema were read apart: put their rows in order again.
        keys = [np.zeros((0, 2), np.int64)]
        keys += [np.stack([np.full(rows.size, batch), rows], axis=-1)
                 for batch, rows in (part['place'] for part in parts)]
        keys = np.concatenate(keys)
        order = np.lexsort((keys[:, 1], keys[:, 0]))
        table = {}
        for name in _COLUMNS[type_name]:
            own = [part[name] for part in parts]
            if name in _TEXTS:
                table[name] = Labels.concatenate(own).take(order)
            else:
                table[name] = np.concatenate(own)[order] if own else np.zeros(0)
        seconds, rest = table.pop('sec'), table.pop('nanosec')
        table['stamp_ns'] = seconds.astype(np.int64) * 10**9 + rest.astype(np.int64)
        return table

    def _last_states(self):
        table = self._table(RUN_STATE)
        last = {}
        for code in np.unique(table['run_id'].code):
            row = int(np.flatnonzero(table['run_id'].code == code)[-1])
            last[row] = LastState(
                table['run_id'][row], int(table['phase'][row]), table['order'][row],
                int(table['done'][row]), int(table['total'][row]), table['text'][row],
                int(table['stamp_ns'][row]))
        return tuple(last[row] for row in sorted(last))

    def _take_single(self, file, channel, batch, rows):
        """Decode messages of which a log has few; a damaged one is a problem, not the end."""
        for row in rows:
            data = batch.buffer[batch.start[row]:batch.end[row]].tobytes()
            try:
                message = decode_message(self._schema(file, channel), data)
                self._keep(channel.type_name, message)
            except (InvalidData, ArithmeticError, AttributeError, TypeError, ValueError) as error:
                self.problems.append(f'{file.path}: topic {channel.topic}: a message cannot be '
                                     f'read: {error}')

    def _keep(self, type_name, message):
        if type_name == TF_MESSAGE:
            self.frames += [_table_frame(one) for one in message.transforms
                            if one.child_frame_id.split('/')[-1] == TABLE_FRAME
                            and one.header.frame_id.split('/')[-1] == MACHINE_FRAME]
        elif type_name == ERROR_MOTIONS:
            self.motions.append(_published(message))
        else:
            self.events.append(message)


def _check_kinds(schema, names, values):
    """Refuse columns that are another kind of value than what the message of that name means."""
    for name, source in names.items():
        if source not in values:
            continue
        kind = 'text' if isinstance(values[source], Labels) else values[source].dtype
        if name in _TEXTS:
            fits, wanted = kind == 'text', 'a text'
        elif name in _REALS:
            fits, wanted = kind != 'text' and kind.kind in 'iuf', 'a number'
        else:
            fits, wanted = kind != 'text' and kind.kind in 'iu' and kind.itemsize <= 4, 'a whole number of 32 bits'
        if not fits:
            raise InvalidData(f'{schema.name}: {source}: wanted {wanted}, the log has {kind}; it was written with '
                              'another version of the message')


def _stamp_ns(header):
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _table_frame(message):
    rotation, origin = message.transform.rotation, message.transform.translation
    frame = frame_told((rotation.x, rotation.y, rotation.z, rotation.w), (origin.x, origin.y, origin.z))
    return TableFrame(_stamp_ns(message.header), message.header.frame_id, frame)


def _published(message):
    motions = ErrorMotions.from_curves(message.angle, [getattr(message, curve) for curve in CURVES],
                                       [getattr(message, f'u_{curve}') for curve in CURVES])
    return PublishedMotions(
        str(message.run_id), motions, str(message.model_name), str(message.model_hash),
        float(message.residual_rms), float(message.sigma), int(message.degrees_of_freedom),
        int(message.rank), float(message.completeness))
