# SPDX-License-Identifier: Apache-2.0
"""The recorder: all traffic of the cell, one log per run."""

import math
import os
import re
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from rosette_msgs.msg import BallCentre, CalibrationEvent, Diagnosis, ProbeTarget, Run, RunState
from rosette_msgs.srv import Recall, Recorded, StartRecording, StopRecording
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import CellError, InvalidConfig, InvalidData, RosetteError, plain
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_run import RESUMES_KEY, SIMULATED_KEY
from rosette_ros.io.messages import Answer, Target, nanoseconds
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import ERROR, OK, WAKE_PERIOD, CellNode, Health, run_node
from rosette_ros.nodes.interfaces import decoded, interface_class, introspected_service
from rosette_ros.nodes.liveliness import PROCESS, values_of
from rosette_ros.nodes.log_session import (
    LOG,
    LogSession,
    Message,
    Retention,
    RunContents,
    find_part,
    iter_copied,
    key_of,
    next_part,
    recall,
)
from rosette_ros.nodes.node_requests import Progress

WANTED = (
    Wanted('log_dir', 'runs', 'folder in which every run gets a folder of its own', read_only=True),
    Wanted('recent_s', 2.0, 'requests and node health received so long before a run is requested belong to its log, s '
           'of wall time', 0.0, 60.0),
    Wanted('least_free_mb', 20, 'a log is not begun with less room on the disk, MB', 0, 1_000_000),
    Wanted('simulated', False, 'whether logs say that no real CMM measured; on a simulated clock they do anyway',
           read_only=True), *LOG)
SETTLED, FORGOTTEN = 5.0, 30.0
"""A log whose run is over is closed when another run begins so long after that, and by itself after so long, s.
Where the sequencer tells to be idle: when another run begins, by itself after SETTLED; another program may tell so."""
OVER = (RunState.PHASE_IDLE, RunState.PHASE_DONE, RunState.PHASE_CANCELLED, RunState.PHASE_FAILED)
LAST_MESSAGES = 4.0
"""How long an open log waits for what belongs to its end, and an ending recorder for the sequencer to close it, after
the last answer, s."""


class RecordedTopic(NamedTuple):
    """A topic of the cell; profile: latched where its publishers keep their last messages."""

    name: str
    type_name: str
    retention: Retention = Retention.NONE
    profile: QoSProfile = qos.RECORD


TOPICS = (
    RecordedTopic(names.PROBE_TARGET, 'rosette_msgs/msg/ProbeTarget', profile=qos.RECORD_LATCHED),
    RecordedTopic(names.BALL_CENTRE, 'rosette_msgs/msg/BallCentre'),
    RecordedTopic(names.TOUCHES, 'rosette_msgs/msg/Touches'),
    RecordedTopic(names.ERROR_MOTIONS, 'rosette_msgs/msg/ErrorMotions', profile=qos.RECORD_LATCHED),
    RecordedTopic(names.DIAGNOSIS, 'rosette_msgs/msg/Diagnosis', profile=qos.RECORD_LATCHED),
    RecordedTopic(names.JOINT_EVALUATION, 'rosette_msgs/msg/JointEvaluation'),
    RecordedTopic(names.RUN, 'rosette_msgs/msg/Run', profile=qos.RECORD_LATCHED),
    RecordedTopic(names.RUN_STATE, 'rosette_msgs/msg/RunState', profile=qos.RECORD_LATCHED),
    RecordedTopic(names.CALIBRATE_FEEDBACK, 'rosette_msgs/action/Calibrate_FeedbackMessage'),
    RecordedTopic(names.CLOCK, 'rosgraph_msgs/msg/Clock'),
    RecordedTopic(names.DIAGNOSTICS, 'diagnostic_msgs/msg/DiagnosticArray', Retention.RECENT),
    RecordedTopic(names.MODEL, 'rosette_msgs/msg/Model', Retention.LATCHED, qos.RECORD_LATCHED),
    RecordedTopic(names.TF_STATIC, 'tf2_msgs/msg/TFMessage', Retention.LATCHED, qos.RECORD_LATCHED),
    RecordedTopic(names.CALIBRATION_EVENT, 'rosette_msgs/msg/CalibrationEvent', Retention.RECENT),
    RecordedTopic(names.CALIBRATE_STATUS, 'action_msgs/msg/GoalStatusArray', Retention.RECENT),
    RecordedTopic(names.STOP_RECORDING + names.SERVICE_EVENT, 'rosette_msgs/srv/StopRecording_Event'),
    RecordedTopic(names.PARAMETER_EVENTS, 'rcl_interfaces/msg/ParameterEvent', Retention.RECENT),
    RecordedTopic(names.ROSOUT, 'rcl_interfaces/msg/Log', Retention.RECENT),
    *(RecordedTopic(name + names.SERVICE_EVENT, type_name, Retention.RECENT) for name, type_name in (
        (names.DIAGNOSE, 'rosette_msgs/srv/Diagnose_Event'), (names.ADD_EFFECT, 'rosette_msgs/srv/AddEffect_Event'),
        (names.REMOVE_EFFECT, 'rosette_msgs/srv/RemoveEffect_Event'),
        (names.EVALUATE_JOINTLY, 'rosette_msgs/srv/EvaluateJointly_Event'),
        (names.START_CALIBRATION, 'std_srvs/srv/Trigger_Event'),
        (names.CANCEL_CALIBRATION, 'std_srvs/srv/Trigger_Event'),
        (names.START_RECORDING, 'rosette_msgs/srv/StartRecording_Event'))))
"""What a cell publishes; other topics in its namespace are found on the graph."""
HANDLED = (Run, RunState, CalibrationEvent)
"""What means something for the recorder itself."""

_RUN_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,127}')


class Recorder(CellNode):
    """Subscribes to the whole cell and writes while a log is open.

    Topics: subscribes to TOPICS and to all others in its namespace. Services: `recorder/start_recording`,
    `recorder/stop_recording`, `recorder/recorded`, `recorder/recall`. Parameters: WANTED."""

    def __init__(self) -> None:
        super().__init__(names.RECORDER, WANTED)
        self._library = TypeLibrary.from_environment(os.environ)
        self._session = LogSession(self.parameters['recent_s'], self._offered_qos, lambda: self.parameters.values(LOG))
        self._contents = RunContents('', self.get_logger().error)
        self._ending: Progress | None = None  # since the log was to be closed
        self._looked: Any = None  # what the log held when its bytes were read last
        self._told, self._over_since = ('', RunState.PHASE_IDLE), math.inf  # last run and phase; of the open log's run
        self._has_begun = False  # whether the sequencer told of the open log's run
        self._requested = ('', 0.0)  # the last run that was requested, and when
        self._is_simulated = self.get_parameter('use_sim_time').value
        self._said = {SIMULATED_KEY: 'yes'} if self.parameters['simulated'] or self._is_simulated else {}
        self._simulated_now = 0
        self._last = 'no log yet'
        self._filled = set[tuple[int, ...]]()  # what came with the run, and not yet by its own topic
        self._statuses: dict[str, tuple[Any, ...]] = {}  # of each node, as recorded last
        self._subscribed: dict[str, Subscription] = {}
        self._nodes = {f'{self.get_namespace()}/{node}'.lstrip('/'): self.monitor(node) for node in names.NODES}
        self._clock_topic, self._rosout_topic = map(self.resolve_topic_name, (names.CLOCK, names.ROSOUT))
        self._kinds = {self.resolve_topic_name(topic.name): interface_class(topic.type_name) for topic in TOPICS}
        self._not_recorded = set() if self._is_simulated else {self._clock_topic}
        for topic in TOPICS if self._is_simulated else (one for one in TOPICS if one.name != names.CLOCK):
            self._record(topic.name, topic.type_name, topic.retention, topic.profile)
        self.monitor(names.SEQUENCER).on_change = self._on_restart
        self._discover()
        self.every(1.0, self._discover)
        introspected_service(self, StartRecording, names.START_RECORDING, self._on_start)
        introspected_service(self, StopRecording, names.STOP_RECORDING, self._on_stop)
        self.create_service(Recall, names.RECALL, self._on_recall)
        self.create_service(Recorded, names.RECORDED, self._on_recorded)

    def _record(self, name: str, type_name: str, retention: Retention, profile: QoSProfile) -> None:
        topic = self.resolve_topic_name(name)
        self._session.add_topic(topic, self._library.definition(type_name), retention)
        self._subscribed[topic] = self.on(
            name, interface_class(type_name), partial(self._receive, topic), profile, raw=True, from_one=True)

    def _receive(self, topic: str, data: bytes) -> None:
        try:
            if topic == self._clock_topic:
                self._simulated_now = nanoseconds(decoded(data, Clock).clock)
            elif topic == self._rosout_topic and not names.is_of_cell(decoded(data, Log).name, self.get_namespace()):
                return
            log_time = self._simulated_now if self._is_simulated and self._simulated_now else time.time_ns()
            kind = self._kinds.get(topic, object)
            if (kind in (ProbeTarget, Run, Diagnosis) and self._is_of_another_run(decoded(data, kind))) or (
                    kind is DiagnosticArray and not self._is_news(decoded(data, kind))):
                return
            if self._filled and kind in (ProbeTarget, BallCentre) and key_of(decoded(data, kind)) in self._filled:
                self._filled.remove(key_of(decoded(data, kind)))
                return
            message = Message(topic, data, log_time, log_time, self.seconds())
            is_in_log = self._session.take(message) or (self._replace_damaged() and self._session.take(message))
            if is_in_log and kind in RunContents.KINDS:
                self._contents.receive(kind, message)
            if kind in HANDLED:
                self._handle(decoded(data, kind))
        except InvalidData as error:
            self.get_logger().error(f'{topic}: {error}')

    def _is_of_another_run(self, message: Any) -> bool:
        """Return whether a message is not of the open log: a new subscription may get those of earlier runs late."""
        return self._session.is_open and bool(message.run_id != self._session.run_id)

    def _is_news(self, message: DiagnosticArray) -> bool:
        """Return whether a status has another level, message or process than the one before in the same log: a node
        repeats its status twice a second."""
        before, log = dict(self._statuses), self._session.directory if self._session.is_open else None
        for status in message.status:
            process = values_of(status).get(PROCESS, '')
            self._statuses[status.name] = log, status.level, status.message, process
        return self._statuses != before

    def _handle(self, message: Any) -> None:
        if isinstance(message, CalibrationEvent):
            if message.kind == CalibrationEvent.REQUESTED and message.run_id:
                self._requested = message.run_id, self.seconds()
        elif isinstance(message, Run):
            self._fill(message)
        else:
            self._told = message.run_id, message.phase
            self._has_begun = self._has_begun or message.run_id == self._session.run_id
            self._note_end()

    def _fill(self, message: Run) -> None:
        """Write what of the run is not in its open log."""
        if not self._is_log_of(message.run_id):
            return
        known = self._contents.answers
        found = {one.stamp_ns for one in known.frames}
        for frame in message.frames:
            if nanoseconds(frame.header.stamp) not in found:
                self._receive(self.resolve_topic_name(names.TF_STATIC), serialize_message(
                    TFMessage(transforms=[frame])))
        asked, received = known.keys()
        if (asked.issuperset(zip(message.target_seq, message.target_session, message.target_attempt))
                and received.issuperset(zip(message.answer_seq, message.answer_stamp_ns))):
            return
        targets, answers = conversions.answers_of(message).lacking_in(known)
        for topic, data in self._readings(targets, answers):
            self._receive(topic, data)
            self._filled.add(key_of(decoded(data, self._kinds[topic])))

    def _readings(self, targets: Iterable[Target], answers: Iterable[Answer]) -> Iterator[tuple[str, bytes]]:
        """Yield (topic, CDR) of targets and answers."""
        topic, answer_topic = map(self.resolve_topic_name, (names.PROBE_TARGET, names.BALL_CENTRE))
        for target in targets:
            yield topic, serialize_message(conversions.target_message(target))
        for answer in answers:
            yield answer_topic, serialize_message(conversions.answer_message(answer))

    def _on_restart(self) -> None:
        """Close the log of a run whose sequencer was restarted."""
        if self._session.is_open:
            self.get_logger().warning(f'the sequencer was restarted; the log of run {self._session.run_id} is closed, '
                                      'the run can be resumed')
            self._close()

    def _note_end(self) -> None:
        """Take note since when the sequencer tells that the run of the log is over, or tells of another run."""
        self._over_since = min(self._over_since, self.seconds()) if self._is_over else math.inf

    def _close_if_over(self, is_another: bool = False) -> None:
        """Close the log of a run that has been over for some time, as the sequencer tells.

        Its request to open or to close the log was not answered in time, and it requests that no more; or the
        sequencer was restarted, or never told of this run. is_another: whether another run begins."""
        is_idle = self._told[1] == RunState.PHASE_IDLE
        least = SETTLED if is_idle else FORGOTTEN
        if is_another:
            least = 0.0 if is_idle or not self._has_begun else SETTLED
        if self._session.is_open and self.seconds() - self._over_since >= least:
            if is_idle:
                self._on_restart()
                return
            self.get_logger().warning(f'the log of run {self._session.run_id} is closed as it is: the run is over, and '
                                      'nothing requested to close it')
            self._close()

    def _discover(self) -> None:
        home = self.get_namespace().rstrip('/') + '/'
        if self._clock_topic in self._not_recorded and (others := self.get_publishers_info_by_topic(self._clock_topic)):
            self.get_logger().warning(
                f'{self._clock_topic} is neither used nor recorded: the cell has wall time (use_sim_time: false), and '
                f'{", ".join(one.node_name for one in others)} publishes another one', once=True)
        for topic, types in self.get_topic_names_and_types():
            if not topic.startswith(home) or topic in self._subscribed or topic in self._not_recorded:
                continue
            try:
                self._record(topic, types[0], Retention.NONE, qos.RECORD)
            except InvalidConfig as error:
                self._not_recorded.add(topic)
                self.get_logger().warning(f'{topic} is not recorded: {error}')

    def _offered_qos(self, topic: str) -> list[Qos]:
        return [conversions.qos_record(info.qos_profile) for info in self.get_publishers_info_by_topic(topic)]

    def _on_start(self, request: StartRecording.Request, response: StartRecording.Response) -> StartRecording.Response:
        try:
            directory, earlier, links = self._directory(request.run_id), [], self._said
            self._close_if_over(is_another=True)
            if request.resumes:
                folder = find_part(self._log_dir, request.resumes)
                directory, links = next_part(self._log_dir, request.run_id), links | {RESUMES_KEY: folder.name}
                earlier = [Message(self.resolve_topic_name(name), one.data, one.log_time, one.publish_time, 0.0)
                           for name, one in iter_copied(folder)]
            contents = self._contents_of(request.run_id, earlier)  # refused before a log is open
            self._check_room(directory)
            since = self._requested[1] if self._requested[0] == request.run_id else self.seconds()
            self._session.open(directory, request.run_id, since, self.now().nanoseconds, earlier, links)
            self._contents, self._ending, self._over_since = contents, None, math.inf
            self._has_begun = self._told[0] == request.run_id
            # Where no sequencer is heard, nothing is known before its first state, or after one of another run.
            if self._told[0] == request.run_id or self.monitor(names.SEQUENCER).count():
                self._note_end()
        except RosetteError as error:
            self.get_logger().error(f'start_recording refused: {error}')
            response.success, response.message = False, str(error)
        else:
            self.get_logger().info(f'recording run {request.run_id} to {directory}')
            response.success, response.log = True, str(directory)
        return response

    def _contents_of(self, run_id: str, messages: Iterable[Message]) -> RunContents:
        """Return the contents of a log that begins with these messages; raises InvalidData."""
        contents = RunContents(run_id, self.get_logger().error)
        for message in messages:
            kind = self._kinds[message.topic]
            if kind in RunContents.KINDS:
                contents.add(decoded(message.data, kind), message)
        return contents

    def _replace_damaged(self, is_whole: bool = False) -> bool:
        """Continue in a new log where the disk does not hold the open one as it was written; return whether it was so.

        The new log begins with all that was received of the run. is_whole: whether the bytes on the disk are read."""
        session, damage = self._session, self._session.damage(is_whole)
        if not damage:
            return False
        now, known = self.now().nanoseconds, self._contents.answers
        why, kept = f'the log {session.directory} is damaged: {damage}', [
            *self._contents.messages(), *(Message(*reading, now, now, 0.0) for reading in self._readings(
                known.targets, known.answers))]
        directory = next_part(self._log_dir, session.run_id)
        links = self._said | {RESUMES_KEY: session.directory.name}
        try:
            contents = self._contents_of(session.run_id, kept)
            session.replace(directory, why, self.seconds(), self.now().nanoseconds, kept, links)
        except RosetteError:
            self.get_logger().error(session.failure)
        else:
            self._contents = contents
            self.get_logger().error(f'{why}; it continues in {directory}, which begins with its ball centres')
        return True

    def _check_room(self, directory: Path) -> None:
        try:
            there = next(path for path in (directory, *directory.parents) if path.exists())
            free, wanted = shutil.disk_usage(there).free / 1e6, self.parameters['least_free_mb']
        except OSError as error:
            raise CellError(f'{directory}: expected a folder for the log, found: {error.strerror}; choose another '
                            'folder '
                            '(log_dir)') from error
        if free < wanted:
            raise CellError(f'{directory}: expected {wanted} MB of room for the log (least_free_mb), found {free:.1f} '
                            'MB; '
                            'make room or choose another folder (log_dir)')

    def _on_recall(self, request: Recall.Request, response: Recall.Response) -> Recall.Response:
        """Return what is recorded of a run, up to this moment where its log is open."""
        self._session.flush()
        try:
            return recall(find_part(self._log_dir, request.run), self._library)
        except RosetteError as error:
            return Recall.Response(message=str(error))

    def _on_recorded(self, request: Recorded.Request, response: Recorded.Response) -> Recorded.Response:
        """Return what of results and readings the open log lacks, once it is on the disk."""
        if not self._is_log_of(request.run_id):
            response.message = f'expected the log of run {plain(request.run_id)} open, found {self._open_log}'
            return response
        there = self._session.directory, self._contents.answers.answered, self._contents.missing(request)
        self._replace_damaged(is_whole=there != self._looked)  # asked again and again until it is all there
        self._looked = there
        self._session.flush()
        response.success, response.message = not self._session.failure, self._session.failure
        response.missing = self._contents.missing(request)
        return response

    def _on_stop(self, request: StopRecording.Request, response: StopRecording.Response) -> StopRecording.Response:
        """Close the log where it lacks nothing that the request names."""
        if not self._is_log_of(request.run_id):
            response.message = (f'close the log of run {plain(request.run_id)}: expected that it is open, found '
                                f'{self._open_log}')
            return response
        session = self._session
        if not self._is_over:  # the state may come after the request, which may be that of another node
            response.missing = ['the end of the run']
            response.message = (f'close the log of run {session.run_id}: expected the end of the run, found that it is '
                                'measured')
            return response
        self._replace_damaged()
        self._ending = self._ending or Progress(self.seconds, LAST_MESSAGES)
        response.missing = [] if session.failure else self._contents.missing(request)
        missing = f'the log lacks {", ".join(response.missing)}' if response.missing else ''
        if missing and self._ending.is_expected(self._contents.answers.answered):
            response.message = missing
            return response
        response.message = self._close() or missing
        response.success, response.messages, response.lost = not response.message, session.messages, session.lost
        response.log = str(session.directory) if session.directory.is_dir() else ''
        return response

    @property
    def _is_over(self) -> bool:
        """Whether the run of the log is over, as the sequencer tells, or it tells of another run."""
        run_id, phase = self._told
        return phase in OVER or run_id != self._session.run_id

    def _is_log_of(self, run_id: str) -> bool:
        return self._session.is_open and run_id == self._session.run_id

    @property
    def _open_log(self) -> str:
        return f'the log of run {self._session.run_id}' if self._session.is_open else f'no log open; {self._last}'

    def _directory(self, run_id: str) -> Path:
        if not _RUN_NAME.fullmatch(run_id):
            raise InvalidConfig('run_id: expected a name of letters, digits, ".", "_" and "-" that can be a folder, '
                                'found '
                                f'{run_id!r}')
        return self._log_dir / run_id

    @property
    def _log_dir(self) -> Path:
        return Path(self.parameters['log_dir']).expanduser().absolute()

    def wake(self) -> None:
        """Bring what was written to the disk; close the log of a run that is over; update the status."""
        self._replace_damaged()
        self._session.flush(only_if_due=True)
        self.status.report(self._session.failure if self._session.is_open else '')
        is_whole = self._is_connected() and self.has_single_publishers
        self.status.hears = tuple(one.process for name, one in self._nodes.items() if is_whole and one.process
                                  and one.process == self._statuses.get(name, ('',))[-1])
        self._close_if_over()

    def _is_connected(self) -> bool:
        """Return whether all answers that are published are received."""
        topic = self.resolve_topic_name(names.BALL_CENTRE)
        return self._subscribed[topic].get_publisher_count() >= self.count_publishers(topic)

    def _close(self) -> str:
        """Close the log; return why it is not whole, '' where it is."""
        session = self._session
        if filled := len(self._filled):
            self.get_logger().warning(f'run {session.run_id}: {filled} readings came with it alone')
        self._filled = set()
        try:
            session.close()
        except RosetteError as error:
            session.failure = session.failure or str(error)
        self.status.report('')
        if session.failure:
            self._last = f'run {session.run_id}: {session.failure}'
            self.get_logger().error(self._last)
        else:
            self._last = f'run {session.run_id}: {session.messages} messages, {session.lost} lost'
            self.get_logger().info(f'log of {self._last}')
        return session.failure

    def finish(self) -> None:
        """Close an open log once the sequencer, which may be ending too, has asked for it."""
        progress = Progress(self.seconds, LAST_MESSAGES)
        while self._session.is_open and progress.is_expected(self._contents.answers.answered):
            self.spin_until(lambda: not self._session.is_open, WAKE_PERIOD)
        if self._session.is_open:
            self._close()

    def health(self) -> Health:
        """Return whether a log is open and whether everything is in it."""
        session = self._session
        values = {'run_id': session.run_id, 'messages': session.messages, 'lost': session.lost,
                  'log': session.directory, 'topics': len(self._subscribed)}
        if not session.is_open:
            return OK, f'waiting; {self._last}', values
        if session.failure:
            return ERROR, session.failure, values
        return OK, f'recording run {session.run_id}', values


main = partial(run_node, names.RECORDER, Recorder)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())
