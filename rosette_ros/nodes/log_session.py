# SPDX-License-Identifier: Apache-2.0
"""The logs of the recorder: the open one and what it holds of a run, those of earlier parts."""

import os
import re
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from enum import Enum
from itertools import count, takewhile
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from rosette_msgs import msg
from rosette_msgs.msg import CalibrationEvent
from rosette_msgs.srv import Recall, Recorded, StopRecording
from service_msgs.msg import ServiceEventInfo
from tf2_msgs.msg import TFMessage

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import CellError, InvalidData, RosetteError
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_reader import MAGIC, LoggedMessage, find_files, iter_log
from rosette_ros.io.log_writer import COMPRESSIONS, LogWriter
from rosette_ros.io.messages import answer_of, nanoseconds, phase_name, table_frame_of, target_of
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.type_definitions import TypeDefinition, TypeLibrary
from rosette_ros.nodes import names
from rosette_ros.nodes.interfaces import decoded, interface_class
from rosette_ros.nodes.node_requests import END_EVENTS

LATCHED_KEPT = 10
RECENT_KEPT = 256

LOG = (  # a change applies from the next log on
    Wanted('compression', 'none', 'how the chunks of a log are compressed', choices=tuple(COMPRESSIONS)),)

_PART = re.compile(r'(?P<run>.+)_part(?P<number>[1-9]\d{0,5})')
_FIELDS = {'rosette_msgs/msg/ProbeTarget': 'targets', 'rosette_msgs/msg/BallCentre': 'answers',
           'rosette_msgs/msg/CalibrationEvent': 'events'}
_COPIED = {'rosette_msgs/msg/ProbeTarget': names.PROBE_TARGET, 'rosette_msgs/msg/BallCentre': names.BALL_CENTRE,
           'rosette_msgs/msg/Touches': names.TOUCHES}
"""What of an earlier part opens the log that continues it; and the table frames after its first target: those before it
are of earlier runs, whatever their stamps are."""


class Retention(Enum):
    """What becomes of a message while no log is open."""

    NONE = 'it is dropped'
    LATCHED = 'it is valid until the next one and opens every log'
    RECENT = 'it belongs to a request that opens a log, or describes the nodes then: it is at the head of that log'


class Message(NamedTuple):
    """One message as on the wire, CDR; times in ns, received: steady time, s."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    received: float


class RunContents:
    """What a log holds of its run."""

    _IDENTITIES: ClassVar[dict[type, Callable[[Any], Hashable]]] = {  # what tells messages of one type and run apart
        msg.RunState: lambda message: message.phase, msg.CalibrationEvent: lambda message: message.kind,
        msg.Model: lambda message: message.hash, msg.Diagnosis: lambda message: message.readings_hash,
        StopRecording.Event: lambda message: message.info.event_type,
        msg.ErrorMotions: lambda message: nanoseconds(message.header.stamp)}
    KINDS = (msg.ProbeTarget, msg.BallCentre, TFMessage, *_IDENTITIES)
    AT_ONCE = 1000

    def __init__(self, run_id: str, report: Callable[[str], object] = str) -> None:
        """Start empty; report: called with the words about a message that cannot be decoded."""
        self._answers, self._report = RunAnswers(run_id), report
        self._received: list[tuple[type, Message]] = []
        self._held: set[tuple[type, Hashable]] = set()
        self._kept: dict[Hashable, Message] = {}

    def receive(self, kind: type, message: Message) -> None:
        """Take a message of one of KINDS; it is decoded when that is needed, since many may arrive."""
        self._received.append((kind, message))
        if len(self._received) > self.AT_ONCE:
            _ = self.answers

    def messages(self) -> list[Message]:
        """Return what was taken of the run besides targets and answers, of its states the last."""
        return list(self._kept.values()) if self.answers else []

    @property
    def answers(self) -> RunAnswers:
        """The targets, answers and table frames of the run."""
        received, self._received = self._received, []
        for kind, raw in received:
            try:
                self.add(decoded(raw.data, kind), raw)
            except InvalidData as error:
                self._report(str(error))
        return self._answers

    def add(self, message: Any, raw: Message | None = None) -> None:
        """Take a message of one of KINDS, and as it was received; those of other runs do not count."""
        kind = type(message)
        is_frame = isinstance(message, TFMessage)
        if not is_frame and self._answers.run_id not in [one.run_id for one in getattr(message, 'request', [message])]:
            return
        if raw is not None and kind not in (msg.ProbeTarget, msg.BallCentre):
            self._kept[raw.topic if kind is msg.RunState else (raw.topic, raw.data)] = raw
        if is_frame:
            self._answers.frames += filter(None, map(table_frame_of, message.transforms))
        elif kind is msg.ProbeTarget:
            self._answers.add_target(target_of(message))
        elif kind is msg.BallCentre:
            self._answers.add_answer(answer_of(message))
        else:
            self._held.add((kind, self._IDENTITIES[kind](message)))

    def missing(self, wanted: Recorded.Request | StopRecording.Request) -> list[str]:
        """Return what is missing of what a request names, in words."""
        answers, wanted_too = self.answers, dict[tuple[type, Hashable], str]()
        missing = []
        if isinstance(wanted, Recorded.Request):
            missing += ['the table frame'] * bool(answers.lacking(0))
            missing += ['the readings'] * (wanted.readings_hash != answers.readings_hash)
            wanted_too[msg.ErrorMotions, nanoseconds(wanted.error_motions)] = 'the error motions'
            wanted_too[msg.Model, wanted.model_hash] = 'the model'
            if wanted.diagnosis:
                wanted_too[msg.Diagnosis, wanted.readings_hash] = 'the diagnosis'
        else:
            missing += [f'{wanted.answers - answers.answered} answers'] * (answers.answered < wanted.answers)
            wanted_too[StopRecording.Event, ServiceEventInfo.REQUEST_RECEIVED] = 'this request'
            if wanted.phase in END_EVENTS:
                wanted_too[msg.CalibrationEvent, END_EVENTS[wanted.phase]] = 'the event of the end'
                wanted_too[msg.RunState, wanted.phase] = f'the state {phase_name(wanted.phase).lower()}'
        return missing + [words for key, words in wanted_too.items() if key not in self._held]


class LogSession:
    """Takes every message of the cell and writes it to the open log, or keeps it for the next one.

    recent: how long a message of Retention.RECENT is kept, s; qos_of: returns the Qos of the publishers of a topic;
    settings: returns the values of LOG for the next log. run_id: of the open or last log; failure: why the disk refused
    a message, '' where it did not; directory, messages, lost: of that log, how many are in it, how many are not."""

    def __init__(self, recent: float, qos_of: Callable[[str], list[Qos]],
                 settings: Callable[[], Mapping[str, Any]] = dict) -> None:
        self._recent_kept, self._qos_of, self._settings = recent, qos_of, settings
        self._definitions, self._retention = dict[str, TypeDefinition](), dict[str, Retention]()
        self._latched, self._recent = dict[str, deque[Message]](), deque[Message](maxlen=RECENT_KEPT)
        self._writer: LogWriter | None = None
        self._written: set[str] = set()
        self.run_id, self.failure, self.directory = '', '', Path()
        self.messages = self.lost = 0

    @property
    def is_open(self) -> bool:
        """Whether a log is open."""
        return self._writer is not None

    def add_topic(self, topic: str, definition: TypeDefinition, retention: Retention) -> None:
        """Add a topic, before its first message."""
        self._definitions[topic], self._retention[topic] = definition, retention
        if retention is Retention.LATCHED:
            self._latched[topic] = deque(maxlen=LATCHED_KEPT)

    def take(self, message: Message) -> bool:
        """Take a message; return whether it is in the open log."""
        retention = self._retention[message.topic]
        if retention is Retention.LATCHED:
            self._latched[message.topic].append(message)
        if self.is_open:
            return self._write(message, message.log_time)
        if retention is Retention.RECENT:
            self._recent.append(message)
        return False

    def open(self, directory: Path, run_id: str, now: float, log_time: int, earlier: Iterable[Message] = (),
             custom_data: Mapping[str, str] | None = None) -> None:
        """Open the log of a run; latched messages, which may be of earlier runs, those of an earlier part and
        recent ones come first.

        now: steady time, s; log_time: ROS time of what was received before, ns; custom_data: for metadata.yaml.
        Raises InvalidData where the directory holds a log already, CellError where one is open."""
        if self.is_open:
            raise CellError(f'the log of run {self.run_id} is open; expected it closed first')
        settings = self._settings()
        self._writer = LogWriter(
            directory, directory.name, custom_data=custom_data, compression=settings.get('compression', 'none'))
        self.run_id, self.failure, self.directory = run_id, '', directory
        self.messages, self.lost, self._written = 0, 0, set()
        for topic in self._definitions:
            if profiles := self._qos_of(topic):
                self._add_to_log(self._writer, topic, profiles)
        for message in (*(one for kept in self._latched.values() for one in kept), *earlier):
            self._write(message, log_time)
        for message in self._recent:
            if now - message.received <= self._recent_kept:
                self._write(message, message.log_time)
        self._recent.clear()

    def damage(self, is_whole: bool = False) -> str:
        """Return how the open log differs on the disk from what was written, '' where it does not.

        is_whole: whether its bytes are read, too."""
        return '' if self._writer is None else self._writer.damage(is_whole)

    def replace(self, directory: Path, why: str, *state: Any) -> None:
        """Write no more to the open log, which is damaged, and continue in another; state: as of open() after run_id.

        Raises RosetteError where that is not possible; `failure` then says why."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.abandon()
        try:
            self.open(directory, self.run_id, *state)
        except RosetteError as error:
            self._writer, self.failure = writer, f'{why}; {error}'
            raise

    def close(self) -> None:
        """Close the log; raises CellError where the disk refuses, or does not hold what was written."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()
            if damage := writer.damage(is_whole=True):
                raise CellError(f'{self.directory}: {damage}')

    def flush(self, only_if_due: bool = False) -> None:
        """Bring what was written to the disk; only_if_due: what has waited long enough."""
        if self._writer is not None and not self.failure:
            try:
                (self._writer.flush_if_due if only_if_due else self._writer.flush)()
            except CellError as error:
                self.failure = str(error)

    def _write(self, message: Message, log_time: int) -> bool:
        """Write a message; the refusal of a disk is kept in `failure`, the cell continues."""
        if self._writer is not None and not self.failure:
            try:
                if message.topic not in self._written:
                    self._add_to_log(self._writer, message.topic, self._qos_of(message.topic))
                self._writer.write(message.topic, message.data, log_time, message.publish_time)
            except (CellError, InvalidData) as error:
                self.failure = str(error)
            else:
                self.messages += 1
                return True
        self.lost += 1
        return False

    def _add_to_log(self, writer: LogWriter, topic: str, profiles: list[Qos]) -> None:
        writer.add_topic(topic, self._definitions[topic], profiles)
        self._written.add(topic)


def find_part(log_dir: Path, wanted: str) -> Path:
    """Return the folder of the log to continue from; wanted: its name in `log_dir`, its path or that of its .mcap file,
    or a run_id (last part).

    Raises InvalidData where there is none, it lies elsewhere, or was continued already."""
    path = Path(os.path.expanduser(wanted))
    if path.suffix == '.mcap' and path.parent.name and path.name.startswith(f'{path.parent.name}_'):
        path, wanted = path.parent, str(path.parent)
    longest = max(map(len, wanted.encode(errors='replace').split(b'/')))
    if not path.name.strip('.') or longest > 255 or '\0' in wanted:
        raise InvalidData(f'resume: expected the name of a log in {log_dir}, found {wanted!r:.100}')
    if path.name != wanted and path.absolute().parent.resolve() != log_dir.resolve():
        raise InvalidData(f'resume: expected a log in the folder of the recorder, {log_dir}, found {wanted!r:.100}; '
                          'copy it there')
    parts = parts_of(log_dir, run_of(path.name))
    is_part = run_of(path.name) != path.name
    if not parts or (is_part and log_dir / path.name not in parts):
        raise InvalidData(f'resume: expected the log of a run in {log_dir}, found none named {path.name!r}; check the '
                          'name')
    if is_part and log_dir / path.name != parts[-1]:
        raise InvalidData(f'resume: {path.name} was continued already; resume {parts[-1].name}')
    return parts[-1]


def run_of(name: str) -> str:
    """Return the run_id in the name of a log."""
    match = _PART.fullmatch(name)
    return match['run'] if match else name


def parts_of(log_dir: Path, run_id: str) -> list[Path]:
    """Return the folders of a run's logs in order: the run, `_part2`, `_part3` and so on."""
    first = [log_dir / run_id] if (log_dir / run_id).is_dir() else []
    return first + list(takewhile(Path.is_dir, (log_dir / f'{run_id}_part{number}' for number in count(2))))


def next_part(log_dir: Path, run_id: str) -> Path:
    """Return the folder of the next part of a run."""
    return log_dir / f'{run_id}_part{max(len(parts_of(log_dir, run_id)), 1) + 1}'


def recall(folder: Path, library: TypeLibrary) -> Recall.Response:
    """Return what a log holds of its run; library: of the installed messages.

    Of a log that was not closed no success is returned: its run can be resumed, and ends from what is in the log.
    Raises InvalidData where the log cannot be read or was written with another version of the messages."""
    response = Recall.Response(success=True, log=folder.name, run_id=run_of(folder.name))
    files = find_files(folder).files
    if not any(file.stat().st_size for file in files):
        return response
    for message in iter_log(folder):
        if message.type_name in _FIELDS:
            if message.channel.type_hash not in ('', library.definition(message.type_name).hash):
                raise InvalidData(f'resume: {folder.name}: was written with another version of {message.type_name}; '
                                  'it can be evaluated, not continued')
            found = decoded(message.data, interface_class(message.type_name))
            if found.run_id == response.run_id:
                getattr(response, _FIELDS[message.type_name]).append(found)
    with open(files[-1], 'rb') as stream:
        stream.seek(-len(MAGIC), os.SEEK_END)
        is_closed = stream.read() == MAGIC
    if not is_closed:
        response.events = [event for event in response.events if event.kind != CalibrationEvent.SUCCEEDED]
    return response


def key_of(message: Any) -> tuple[int, ...]:
    """Return what tells the ProbeTargets, and the BallCentres, of a run apart."""
    return (message.seq, message.session, message.attempt) if isinstance(message, msg.ProbeTarget) else (
        message.seq, nanoseconds(message.header.stamp))


def iter_copied(folder: Path) -> Iterator[tuple[str, LoggedMessage]]:
    """Yield (name of the topic, message) for what of a log opens the next part."""
    has_begun = False
    for message in iter_log(folder):
        if message.type_name in _COPIED:
            has_begun = True
            yield _COPIED[message.type_name], message
        elif message.channel.is_static_frames and has_begun:
            yield names.TF_STATIC, message
