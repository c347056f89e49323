# SPDX-License-Identifier: Apache-2.0
"""The recorder: everything that the cell says, one log per run."""

import math
import os
import re
import shutil
import sys
import time
from pathlib import Path

from rcl_interfaces.msg import Log
from rosette_msgs.msg import BallCentre, RunState
from rosette_msgs.srv import Recall, Recorded, StartRecording, StopRecording
from service_msgs.msg import ServiceEventInfo
from std_msgs.msg import Header

from rosette_ros.core.errors import CellError, InvalidConfig, InvalidData, RosetteError, plain
from rosette_ros.data.log_reader import RESUMES_KEY
from rosette_ros.data.schemas import TypeLibrary
from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.alive import read_beat
from rosette_ros.nodes.follow_up import FollowUp, free_name
from rosette_ros.nodes.interfaces import decoded, interface_class
from rosette_ros.nodes.introspection import introspected_service
from rosette_ros.nodes.recalling import find_part, iter_copied, next_part, recall
from rosette_ros.nodes.runner import BUSY_PERIOD, ERROR, OK, WARN, CellNode, run_node
from rosette_ros.nodes.settings import Wanted
from rosette_ros.nodes.tape import LOG, Memory, Message, Tape

WANTED = (
    Wanted('log_dir', 'runs', 'folder in which every run gets a folder of its own'),
    Wanted('recent_s', 2.0, 'requests and node health heard so long before a log opens belong '
           'to it, s of wall time', 0.0, 60.0),
    Wanted('drain_s', 0.1, 'a log is closed when nothing has come for so long, s of wall time',
           0.01, 10.0),
    Wanted('follow_up_s', 10.0, 'questions to the evaluator after a run get a log of their own, '
           'closed when nothing has been asked for so long, s of wall time; 0: no such logs',
           0.0, 3600.0),
    Wanted('least_free_mb', 20, 'a log is not begun with less room on the disk, MB', 0, 1_000_000),
    *LOG,
)
DRAIN_LIMIT = 10
"""A log is closed after so many times `drain_s` at the latest."""
MATCH_TIMEOUT = 5.0
"""How long the recorder waits for its connection to known publishers, s."""
ANSWER_TIMEOUT = 0.5
"""How long the recorder waits for answers that others have heard already, s."""
DISCOVERY_PERIOD = 1.0

LATCHED = (names.PROBE_TARGET, names.ERROR_MOTIONS, names.RUN_STATE, names.MODEL, names.TF_STATIC)
"""Topics whose publishers keep their last messages: none is lost to a late connection."""
TOPICS = (
    (names.PROBE_TARGET, 'rosette_msgs/msg/ProbeTarget', Memory.NONE),
    (names.BALL_CENTRE, 'rosette_msgs/msg/BallCentre', Memory.NONE),
    (names.ERROR_MOTIONS, 'rosette_msgs/msg/ErrorMotions', Memory.NONE),
    (names.DIAGNOSIS, 'rosette_msgs/msg/Diagnosis', Memory.NONE),
    (names.RUN_STATE, 'rosette_msgs/msg/RunState', Memory.NONE),
    (names.CALIBRATE_FEEDBACK, 'rosette_msgs/action/Calibrate_FeedbackMessage', Memory.NONE),
    (names.CLOCK, 'rosgraph_msgs/msg/Clock', Memory.NONE),
    (names.DIAGNOSTICS, 'diagnostic_msgs/msg/DiagnosticArray', Memory.RECENT),
    (names.MODEL, 'rosette_msgs/msg/Model', Memory.LATCHED),
    (names.TF_STATIC, 'tf2_msgs/msg/TFMessage', Memory.LATCHED),
    (names.CALIBRATION_EVENT, 'rosette_msgs/msg/CalibrationEvent', Memory.RECENT),
    (names.CALIBRATE_STATUS, 'action_msgs/msg/GoalStatusArray', Memory.RECENT),
    (names.START_CALIBRATION + names.SERVICE_EVENT, 'std_srvs/srv/Trigger_Event', Memory.RECENT),
    (names.CANCEL_CALIBRATION + names.SERVICE_EVENT, 'std_srvs/srv/Trigger_Event', Memory.RECENT),
    (names.START_RECORDING + names.SERVICE_EVENT, 'rosette_msgs/srv/StartRecording_Event',
     Memory.RECENT),
    (names.STOP_RECORDING + names.SERVICE_EVENT, 'rosette_msgs/srv/StopRecording_Event',
     Memory.NONE),
    *((f'{node}/{names.ALIVE}', 'std_msgs/msg/Header', Memory.NONE) for node in names.NODES),
    (names.PARAMETER_EVENTS, 'rcl_interfaces/msg/ParameterEvent', Memory.RECENT),
    (names.ROSOUT, 'rcl_interfaces/msg/Log', Memory.RECENT),
)
QUESTIONS = ((names.DIAGNOSE, 'rosette_msgs/srv/Diagnose_Event'),
             (names.ADD_EFFECT, 'rosette_msgs/srv/AddEffect_Event'),
             (names.REMOVE_EFFECT, 'rosette_msgs/srv/RemoveEffect_Event'))
"""What may be asked after a run; it is recorded, see follow_up."""
TOPICS += tuple((name + names.SERVICE_EVENT, type_name, Memory.RECENT)
                for name, type_name in QUESTIONS)
"""What a cell says; anything else in its namespace is found on the graph."""

_RUN_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,127}')


class Recorder(CellNode):
    """Subscribes to the whole cell from its start on and writes while a log is open."""

    is_patient = True

    def __init__(self):
        """Subscribe to everything that a cell says."""
        super().__init__(names.RECORDER, WANTED)
        self._library = TypeLibrary.from_environment(os.environ)
        self._tape = Tape(self.parameters['recent_s'], self._offered_qos,
                          lambda: self.parameters.values(LOG))
        self._unknown = set()
        self._in_cell = self.get_namespace().strip('/').replace('/', '.')
        self._clock_topic = self.resolve_topic_name(names.CLOCK)
        self._rosout_topic = self.resolve_topic_name(names.ROSOUT)
        self._answer_topic = self.resolve_topic_name(names.BALL_CENTRE)
        self._answers = {}
        self._beats = {self.resolve_topic_name(f'{name}/{names.ALIVE}'): ('', -math.inf)
                       for name in names.NODES if name != names.RECORDER}
        self._state_topic = self.resolve_topic_name(names.RUN_STATE)
        self._simulated = self.get_parameter('use_sim_time').value
        self._simulated_now = 0
        self._last, self._last_run = 'no log yet', ''
        self._follow_up = FollowUp(self.parameters['follow_up_s'])
        self._questions = {self.resolve_topic_name(name + names.SERVICE_EVENT):
                           interface_class(type_name) for name, type_name in QUESTIONS}
        for name, type_name, memory in TOPICS:
            profile = qos.RECORD_LATCHED if name in LATCHED else qos.RECORD
            self._record(self.resolve_topic_name(name), type_name, memory, profile)
        self._discover()
        introspected_service(self, StartRecording, names.START_RECORDING, self._on_start)
        introspected_service(self, StopRecording, names.STOP_RECORDING, self._on_stop)
        self.create_service(Recall, names.RECALL, self._on_recall)
        self.create_service(Recorded, names.RECORDED, self._on_recorded)

    @property
    def is_busy(self):
        """Whether a log is open."""
        return self._tape.is_open

    # Hearing

    def _record(self, topic, type_name, memory, profile):
        self._tape.add_topic(topic, self._library.definition(type_name), memory)
        self.ears.listen(topic, interface_class(type_name), profile, raw=True)

    def hear(self, heard):
        """Put all that was said on the tape, in the order in which it was heard."""
        now = self.seconds()
        for entry in heard:
            try:
                self._hear_one(*entry, now)
            except InvalidData as error:
                self.get_logger().error(f'{entry[1]}: {error}')

    def _hear_one(self, received, topic, data, published, now):
        if topic == self._clock_topic:
            self._simulated_now = convert.clock_nanoseconds(data)
        elif topic == self._rosout_topic and not self._is_ours(data):
            return
        time_ns = received
        if self._simulated and self._simulated_now:
            time_ns = published = self._simulated_now
        self._tape.take(Message(topic, data, time_ns, published, now))
        if topic == self._answer_topic and self._tape.is_open:
            self._note_answer(data)
        if topic in self._beats:
            self._beats[topic] = (read_beat(decoded(data, Header).frame_id)[0], now)
        if topic == self._state_topic:
            self._close_orphan(decoded(data, RunState))
        if topic in self._questions:
            self._follow(decoded(data, self._questions[topic]).info, now)

    def _follow(self, info, now):
        """Open a log for a question where none is open; take note of answers."""
        if info.event_type == ServiceEventInfo.RESPONSE_SENT:
            self._follow_up.answered(now)
        elif info.event_type == ServiceEventInfo.REQUEST_RECEIVED:
            if self._follow_up.asked(now) and not self._tape.is_open:
                self._open_follow_up(now)

    def _open_follow_up(self, now):
        try:
            name = free_name(self._last_run, lambda name: self._directory(name).exists())
            self._tape.open(self._directory(name), name, now, self.now().nanoseconds)
        except RosetteError as error:
            self.get_logger().warning(f'the answer is not recorded: {error}')
        else:
            self._follow_up.is_open = True

    def _note_answer(self, data):
        """Remember a good answer that is in the open log."""
        stamp_ns, run_id, seq, status = convert.answer_head(data)
        if status == BallCentre.STATUS_OK and run_id == self._tape.run_id:
            self._answers[seq, stamp_ns] = None

    def _close_orphan(self, state):
        """Close the log of a run whose sequencer was started anew: it says that nothing is on."""
        if state.phase == RunState.PHASE_IDLE and self._tape.is_open and not self._follow_up.is_open:
            self.get_logger().warning(f'the sequencer was started anew; the log of run {self._tape.run_id} is '
                                      'closed, the run can be resumed')
            self._last_run = self._tape.run_id
            self._close()

    def _end_follow_up(self):
        self._follow_up.is_open = False
        self._close()

    def lost(self, topic, count):
        """Count what was lost on the way."""
        self._tape.lose(count)

    def _is_ours(self, data):
        """Return whether a /rosout message comes from this cell."""
        logger = decoded(data, Log).name
        return f'{logger}.'.startswith(f'{self._in_cell}.') or not self._in_cell

    def _discover(self):
        """Subscribe to what is new in the cell's namespace."""
        self._discovered = self.seconds()
        home = self.get_namespace().rstrip('/') + '/'
        for topic, types in self.get_topic_names_and_types():
            if (not topic.startswith(home) or topic in self.ears.topics
                    or topic in self._unknown):
                continue
            try:
                self._record(topic, types[0], Memory.NONE, qos.RECORD)
            except InvalidConfig as error:
                self._unknown.add(topic)
                self.get_logger().warning(f'{topic} is not recorded: {error}')

    def _offered_qos(self, topic):
        return [convert.qos_record(info.qos_profile)
                for info in self.get_publishers_info_by_topic(topic)]

    # The doors

    def _on_start(self, request, response):
        try:
            directory, earlier, links = self._directory(request.run_id), (), {}
            if request.resumes:
                earlier, links = self._earlier(request.resumes)
                directory = next_part(self._log_dir, request.run_id)
            self._check_room(directory)
            self._until(self._is_connected, MATCH_TIMEOUT)
            self.hear(self.ears.take())
            if self._follow_up.is_open:
                self._end_follow_up()
            self._tape.open(directory, request.run_id, self.seconds(), self.now().nanoseconds, earlier, links)
            self._answers = {}
            for message in earlier:
                if message.topic == self._answer_topic:
                    self._note_answer(message.data)
        except RosetteError as error:
            self.get_logger().error(f'start_recording refused: {error}')
            response.success, response.message = False, str(error)
        else:
            self.get_logger().info(f'recording run {request.run_id} to {directory}')
            response.success, response.log = True, str(directory)
        return response

    def _is_connected(self):
        """Return whether all who are known on the graph are heard.

        That this side is connected to a publisher does not say that the publisher is to this side. A heartbeat says
        so for its whole node: it comes after the middleware of that node has learned of all subscriptions here.
        """
        now = self.seconds()
        return self.ears.is_connected() and all(
            now - heard < qos.BEAT_LOST or not self.count_publishers(topic)
            for topic, (_, heard) in self._beats.items())

    def _check_room(self, directory):
        """Refuse to begin a log that would soon end for want of room."""
        there = next(path for path in (directory, *directory.parents) if path.exists())
        free, wanted = shutil.disk_usage(there).free / 1e6, self.parameters['least_free_mb']
        if free < wanted:
            raise CellError(f'{directory}: wanted {wanted} MB of room for the log (least_free_mb), got {free:.1f} MB; '
                            'make room or choose another folder (log_dir)')

    def _earlier(self, wanted):
        """Return what the next part of a run begins with, Messages, and what links it to the part before."""
        folder = find_part(self._log_dir, wanted)
        now = self.seconds()
        earlier = [Message(self.resolve_topic_name(name), one.data, one.log_time, one.publish_time, now)
                   for name, one in iter_copied(folder)]
        for message in earlier:
            if message.topic == self._answer_topic:
                convert.answer_head(message.data)  # one that is none is refused before a log is open
        return earlier, {RESUMES_KEY: folder.name}

    def _on_recall(self, request, response):
        """Tell what is recorded of a run, up to this moment where its log is open."""
        try:
            self.hear(self.ears.take())
            if self._tape.is_open and request.run == self._tape.run_id:
                self._tape.flush()
                return recall(self._tape.directory, self._library)
            return recall(find_part(self._log_dir, request.run), self._library)
        except RosetteError as error:
            response.success, response.message = False, str(error)
            return response

    def _on_recorded(self, request, response):
        """Tell which answers are in the open log, once it is on the disk."""
        tape = self._tape
        if not tape.is_open or request.run_id != tape.run_id:
            response.message = f'wanted the log of run {plain(request.run_id)} open, got ' + (
                f'that of run {tape.run_id}' if tape.is_open else 'none')
            return response
        self._until(lambda: len(self._answers) >= request.wanted, ANSWER_TIMEOUT)
        tape.flush()
        response.success, response.message = not tape.failure, tape.failure
        response.seq = [seq for seq, _ in self._answers]
        response.stamp_ns = [stamp for _, stamp in self._answers]
        return response

    def _on_stop(self, request, response):
        if not self._tape.is_open or request.run_id != self._tape.run_id:
            open_now = f'the log of run {self._tape.run_id}' if self._tape.is_open else 'no log'
            response.message = f'wanted to close the log of run {plain(request.run_id)}, got {open_now}'
            return response
        self._drain()
        if not self._tape.is_open:  # what was heard last: the sequencer was started anew
            response.message = f'run {plain(request.run_id)}: its log was closed: {self._last}'
            return response
        self._last_run = request.run_id
        response.success, response.message, summary = self._close()
        if summary:
            response.log, response.messages = str(summary.directory), summary.messages
            response.lost = summary.lost
        return response

    def _drain(self):
        """Hear out those who still speak."""
        quiet, began = self.parameters['drain_s'], self.seconds()
        self._until(lambda: self.seconds() - max(self._tape.heard, began) >= quiet,
                    DRAIN_LIMIT * quiet)

    def _until(self, condition, timeout):
        """Go on hearing until a condition holds, at most for the steady time `timeout`, s."""
        deadline = self.seconds() + timeout
        while not condition() and self.seconds() < deadline:
            time.sleep(BUSY_PERIOD)
            self.hear(self.ears.take())
            self._beat.beat_if_due(self.seconds())

    def _directory(self, run_id):
        if not _RUN_NAME.fullmatch(run_id):
            raise InvalidConfig('run_id: wanted a name of letters, digits, ".", "_" and "-" that '
                                f'can be a folder, got {run_id!r}')
        return self._log_dir / run_id

    @property
    def _log_dir(self):
        return Path(self.parameters['log_dir']).expanduser().absolute()

    def wake(self):
        """Bring what is written to the disk; look for new topics."""
        self._tape.flush_if_due()
        self._beat.words = self._tape.failure if self._tape.is_open else ''
        now = self.seconds()
        self._beat.hears = tuple(life for life, heard in self._beats.values() if now - heard < qos.BEAT_LOST)
        if self._follow_up.is_over(self.seconds()):
            self._end_follow_up()
        if self.seconds() - self._discovered >= DISCOVERY_PERIOD:
            self._discover()

    def _close(self):
        """Close the log; return (success, message, Summary or None)."""
        run_id, failure = self._tape.run_id, self._tape.failure
        try:
            summary = self._tape.close()
        except RosetteError as error:
            failure, summary = failure or str(error), None
        if failure:
            self._last = f'run {run_id}: {failure}'
            self.get_logger().error(self._last)
            return False, failure, summary
        self._last = f'run {run_id}: {summary.messages} messages, {summary.lost} lost'
        self.get_logger().info(f'log of {self._last}')
        return True, '', summary

    def finish(self):
        """Close an open log once the last messages are in."""
        if self._tape.is_open:
            self._drain()
        if self._tape.is_open:
            self._close()

    def health(self):
        """Say whether a log is open and whether everything is in it."""
        tape = self._tape
        if not tape.is_open:
            return OK, f'waiting; {self._last}', {'topics': len(self.ears.topics)}
        values = {'run_id': tape.run_id, 'messages': tape.messages, 'lost': tape.lost}
        if tape.failure:
            return ERROR, tape.failure, values
        if tape.lost:
            return WARN, f'{tape.lost} messages were lost on the way', values
        return OK, f'recording run {tape.run_id}: {tape.messages} messages', values


def main(args=None):
    """Run the recorder; returns the exit code."""
    return run_node(names.RECORDER, Recorder, args)


if __name__ == '__main__':
    sys.exit(main())
