# SPDX-License-Identifier: Apache-2.0
"""The sequencer: runs calibrations, asks the CMM for one ball after the other."""

import sys
from datetime import UTC, datetime

from rclpy.action import CancelResponse, GoalResponse
from rclpy.event_handler import PublisherEventCallbacks
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, ErrorMotions, ProbeTarget
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from rosette_ros.core.errors import CellError, RosetteError
from rosette_ros.data.assemble import MACHINE_FRAME, TABLE_FRAME
from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.announcer import Announcer, Job, Request
from rosette_ros.nodes.introspection import introspected_service
from rosette_ros.nodes.long_action import LongActionServer
from rosette_ros.nodes.programme import Phase
from rosette_ros.nodes.recorder_link import RecorderLink
from rosette_ros.nodes.runner import ERROR, OK, WARN, CellNode, run_node
from rosette_ros.nodes.sequence import Ask, Finish, Locate, Remark, Sequence, Tell
from rosette_ros.nodes.settings import (
    LIMITS,
    PLATE,
    RUN,
    TABLE,
    Wanted,
    change,
    limits_of,
    programme_of,
    run_name,
)

CALIBRATION = PLATE + TABLE + RUN + LIMITS
CELL = (
    Wanted('require_recorder', True, 'whether a run without a log is refused'),
    Wanted('recorder_timeout_s', 10.0, 'wall time for opening or closing a log, s', 0.1, 1e4),
    Wanted('state_rate_hz', 10.0, 'most states per second of wall time while a phase lasts, Hz',
           0.1, 1e4),
)
RESULT_KEPT = 3600
"""How long the result of a goal can be fetched, s."""
SETTLING = 1.0
"""How long all nodes have to be there before a run: each finds each other in its own time, s."""
FAREWELLS = 10
"""So many more steps at the end, in which the client of a goal is told its result."""


class Sequencer(CellNode):
    """Two doors (action and service), one calibration at a time."""

    def __init__(self):
        """Declare parameters and stand up all interfaces."""
        super().__init__(names.SEQUENCER, CALIBRATION + CELL)
        self._job = self._next_job = None
        self._taken = set()
        self._lacks = ''
        self._complete_since = None
        self._present = frozenset()
        self._last = 'no run yet'
        self._last_level = OK
        self._announcer = Announcer(self)
        self._carry_out = {Ask: self._ask, Locate: self._locate, Remark: self._remark,
                           Tell: self._tell, Finish: self._finish}
        # A CMM that asks for another quality of service shall be noticed.
        self._targets = self.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET,
                                              event_callbacks=PublisherEventCallbacks())
        self._frames = self.create_publisher(TFMessage, names.TF_STATIC, qos.RESULT)
        self.on(names.BALL_CENTRE, BallCentre, self._on_ball_centre, qos.ANSWER,
                tell_incompatible=True)
        self.on(names.ERROR_MOTIONS, ErrorMotions, self._on_error_motions, qos.RESULT)
        self._recorder = RecorderLink(self)
        introspected_service(self, Trigger, names.START_CALIBRATION, self._on_trigger)
        self._action = LongActionServer(
            self, Calibrate, names.CALIBRATE, goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted, cancel_callback=self._on_cancel,
            result_timeout=RESULT_KEPT)
        self._announcer.tell_idle()

    def destroy_node(self):
        """Take the action down before the node it stands on."""
        self._action.destroy()
        super().destroy_node()

    # The doors

    def _on_trigger(self, request, response):
        response.success, response.message = self._prepare(Request(names.START_CALIBRATION))
        if response.success:
            self._open(self._next_job)
        return response

    def _on_goal(self, goal):
        request = Request(names.CALIBRATE, goal.order, goal.seed, goal.options)
        accepted, _ = self._prepare(request)
        return GoalResponse.ACCEPT if accepted else GoalResponse.REJECT

    def _on_accepted(self, goal_handle):
        self._next_job.goal = goal_handle
        goal_handle.execute()
        self._open(self._next_job)

    def _on_cancel(self, goal_handle):
        job = self._job
        if job is None or job.goal is not goal_handle or job.is_over:
            return CancelResponse.REJECT
        self._announcer.cancel_requested(job)
        # The goal may only become "canceled" once this callback has returned.
        self.executor.create_task(lambda: self._do(job, job.sequence.cancel()))
        return CancelResponse.ACCEPT

    def _prepare(self, request):
        """Prepare the job of a request; return (True, run_id) or (False, why not)."""
        try:
            job = self._make_job(request)
        except RosetteError as error:
            self.get_logger().warning(f'{request.origin} refused: {error}')
            self._announcer.refused(request, str(error))
            return False, str(error)
        self._next_job = job
        return True, job.run_id

    def _make_job(self, request):
        """Return the job of a request; raises RosetteError with the reason why not."""
        if self._job is not None:
            raise CellError(f'run {self._job.run_id} is on ({_progress(self._job)}); '
                            'wait for its end or cancel it')
        missing = self._missing()
        if missing:
            raise CellError('; '.join(missing))
        values = change(self.parameters.values(CALIBRATION), request.order, request.seed,
                        request.options)
        run_id = run_name(datetime.now(UTC), values['order'], self._taken)
        sequence = Sequence(run_id, programme_of(values), limits_of(values))
        return Job(sequence, request, values['order'])

    def _missing(self):
        """Return what the cell lacks for a calibration, in words."""
        missing = []
        if not (self.count_publishers(names.BALL_CENTRE) and self._listeners()):
            missing.append(f'no CMM: wanted one that listens to {names.PROBE_TARGET} and answers '
                           f'{names.BALL_CENTRE}, got none; start simulated_cmm or connect a CMM')
        elif not self.has_time():
            missing.append('no time: with use_sim_time the CMM publishes /clock, none has come')
        if not self.count_publishers(names.ERROR_MOTIONS):
            missing.append(f'no evaluator: wanted one that publishes {names.ERROR_MOTIONS}, got '
                           'none; start it')
        if self.parameters['require_recorder'] and not self._recorder.is_there:
            missing.append(f'no recorder: wanted its service {names.START_RECORDING}, got none; '
                           'start it, or set require_recorder to false')
        return missing

    def _listeners(self):
        """Return how many listen to the targets besides recorder and evaluator."""
        topic = self.resolve_topic_name(names.PROBE_TARGET)
        return sum(info.node_name not in (names.RECORDER, names.EVALUATOR)
                   for info in self.get_subscriptions_info_by_topic(topic))

    def _ends(self):
        """Return what tells who speaks and hears in the cell from a successor that has just come."""
        centres, motions = map(self.resolve_topic_name, (names.BALL_CENTRE, names.ERROR_MOTIONS))
        infos = (*self.get_publishers_info_by_topic(centres), *self.get_publishers_info_by_topic(motions),
                 *self.get_subscriptions_info_by_topic(centres))
        return frozenset(bytes(info.endpoint_gid) for info in infos)

    # From request to result

    def _open(self, job):
        """Take a job on: the log first, then the first target."""
        self._job, job.since = job, self.seconds()
        self._taken.add(job.run_id)
        self._watch(job.since)
        self._announcer.accepted(job)
        self.get_logger().info(f'run {job.run_id}: {job.sequence.programme.total} balls')
        self._open_log(job)

    def _open_log(self, job):
        """Open the log as soon as all nodes have had the time to find each other."""
        job.is_waiting = self._complete_since is None or (
            self.seconds() - self._complete_since < SETTLING)
        if job.is_waiting:
            return
        if self._recorder.is_there:
            self._recorder.start(job.run_id, self._recorder_timeout, self._on_opened)
        else:
            self._on_opened(True, 'no recorder', '')

    def _on_opened(self, success, message, log):
        job = self._job
        job.opening, job.recording, job.log = False, bool(log), log
        if job.is_over:
            self._close(job)
        elif success:
            self._do(job, job.sequence.begin(self.seconds()))
        else:
            self._do(job, job.sequence.fail(f'no log: {message}'))

    def _on_ball_centre(self, message):
        job = self._job
        if job is None or job.is_over:
            return
        done = job.sequence.done
        self._do(job, job.sequence.answer(convert.answer_record(message), self.seconds()))
        if job.sequence.done > done:
            self._announcer.tell_progress(job, self._state_rate)

    def _on_error_motions(self, message):
        job = self._job
        if job is not None and message.run_id == job.run_id:
            job.motions = message
            self._do(job, job.sequence.evaluated(self.seconds()))

    @property
    def is_busy(self):
        """Whether a calibration is on."""
        return self._job is not None

    def wake(self):
        """Look after the time limits and the recorder."""
        now = self.seconds()
        self._recorder.tick(now)
        job = self._job
        if job is None or job.is_waiting:
            self._watch(now)
        if job is None:
            return
        if job.is_waiting and job.is_over:
            self._on_closed(True, '', '')
        elif job.is_waiting and now - job.since > self._recorder_timeout + SETTLING:
            self._do(job, job.sequence.fail(self._lacks))
        elif job.is_waiting:
            self._open_log(job)
        elif job.recording and not job.is_over and not self._recorder.is_there:
            self._do(job, job.sequence.fail('the recorder has gone; what it wrote is in its log'))
        else:
            self._do(job, job.sequence.tick(now))

    def _watch(self, now):
        """Log what the cell lacks, and when it has become complete and settled."""
        lacks = '; '.join(self._missing())
        present = self._ends()
        if lacks or present != self._present:
            self._complete_since, self._present = None, present
        if not lacks and self._complete_since is None:
            self._complete_since = now
        settled = not lacks and now - self._complete_since >= SETTLING
        words = lacks or (names.COMPLETE if settled else 'the nodes are getting connected')
        if words != self._lacks:
            self._lacks = words
            self.get_logger().info(words)

    def _do(self, job, commands):
        """Carry out the commands of the sequence."""
        for command in commands:
            self._carry_out[type(command)](job, command)

    def _ask(self, job, command):
        self._targets.publish(convert.target_message(
            command.target, job.run_id, command.attempt, command.centre, command.frame_id,
            self.now().to_msg()))

    def _locate(self, job, command):
        self._frames.publish(convert.frame_message(command.frame, MACHINE_FRAME, TABLE_FRAME,
                                                   self.now().to_msg()))

    def _remark(self, job, command):
        self.get_logger().warning(f'run {job.run_id}: {command.text}')

    def _tell(self, job, command):
        self._announcer.tell(job)

    def _finish(self, job, command):
        self._announcer.ended(job)
        words = f'run {job.run_id}: {command.phase.name.lower()}: {command.text}'
        if command.phase is Phase.FAILED:
            self.get_logger().error(words)
        else:
            self.get_logger().info(words)
        if job.goal is not None:
            _end_goal(job.goal, command.phase)
        self._close(job)

    def _close(self, job):
        """Close the log of a job that is over; while it is being opened, wait for that."""
        if job.opening:
            return
        if job.recording and self._recorder.is_there:
            job.recording = False
            self._recorder.stop(job.run_id, self._recorder_timeout, self._on_closed)
        else:
            self._on_closed(True, '', job.log)

    def _on_closed(self, success, message, log):
        job, self._job = self._job, None
        sequence = job.sequence
        words = sequence.text if success else f'{sequence.text}; closing the log: {message}'
        if not success:
            self.get_logger().error(f'run {job.run_id}: closing the log: {message}')
        self._last = f'last run {job.run_id} {sequence.phase.name.lower()}: {words}'
        self._last_level = ERROR if sequence.phase is Phase.FAILED or not success else OK
        if job.goal is not None:
            self._action.finish(job.goal, Calibrate.Result(
                success=sequence.phase is Phase.DONE, message=words, run_id=job.run_id,
                error_motions=job.motions, log=job.log))

    def finish(self):
        """End a running calibration in good order."""
        job = self._job
        if job is None:
            return
        self._do(job, job.sequence.cancel('the sequencer was stopped'))
        deadline = self.seconds() + self._recorder_timeout
        while self._job is not None and self.seconds() < deadline:
            self.step()
        for _ in range(FAREWELLS):
            self.step()

    def health(self):
        """Say whether a calibration can start, or how far the present one is."""
        job = self._job
        if job is not None:
            sequence = job.sequence
            return OK, f'{_progress(job)}: {sequence.describe()}', {
                'run_id': job.run_id, 'done': sequence.done, 'total': sequence.programme.total}
        missing = self._missing()
        if missing:
            return WARN, '; '.join(missing), {'last': self._last}
        return self._last_level, f'ready; {self._last}', {}

    @property
    def _state_rate(self):
        return self.parameters['state_rate_hz']

    @property
    def _recorder_timeout(self):
        return self.parameters['recorder_timeout_s']


def _progress(job):
    sequence = job.sequence
    if job.is_over:
        return 'its log is being closed'
    return (f'{sequence.phase.name.lower().replace("_", " ")}, {sequence.done} of '
            f'{sequence.programme.total} balls')


def _end_goal(goal, phase):
    if phase is Phase.DONE:
        goal.succeed()
    elif phase is Phase.CANCELLED and goal.is_cancel_requested:
        goal.canceled()
    else:
        goal.abort()


def main(args=None):
    """Run the sequencer; returns the exit code."""
    return run_node(names.SEQUENCER, Sequencer, args)


if __name__ == '__main__':
    sys.exit(main())
