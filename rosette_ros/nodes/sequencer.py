# SPDX-License-Identifier: Apache-2.0
"""The sequencer: runs calibrations, asks the CMM for one ball after the other."""

import sys

from rclpy.action import CancelResponse, GoalResponse
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.task import Future
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, ErrorMotions, ProbeTarget
from rosette_msgs.srv import Recall, StartRecording, StopRecording
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from rosette_ros.core.errors import CellError, RosetteError, plain
from rosette_ros.data.assemble import MACHINE_FRAME, TABLE_FRAME
from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.announcer import Announcer
from rosette_ros.nodes.company import SETTLING, Company
from rosette_ros.nodes.introspection import introspected_service
from rosette_ros.nodes.jobs import Request, make_job
from rosette_ros.nodes.long_action import LongActionServer
from rosette_ros.nodes.managed import ManagedNode
from rosette_ros.nodes.programme import Phase
from rosette_ros.nodes.recorder_link import RecorderLink
from rosette_ros.nodes.runner import ERROR, OK, WARN, run_node
from rosette_ros.nodes.sequence import Ask, Finish, Locate, Remark, Tell, Verify
from rosette_ros.nodes.settings import LIMITS, PLANNED, RESUME, Wanted, wanted_changes

CALIBRATION = PLANNED + LIMITS
CELL = (
    Wanted('require_recorder', True, 'whether a run without a log is refused'),
    Wanted('recorder_timeout_s', 10.0, 'wall time for opening or closing a log, s', 0.1, 1e4),
    Wanted('state_rate_hz', 10.0, 'most states per second of wall time while a phase lasts, Hz',
           0.1, 1e4),
)
NODE_WORDS = {names.CMM: 'CMM', names.RECORDER: 'recorder'}
RECALL_TIMEOUT = 60.0
"""How long the recorder may read in the log of an earlier part, s."""
RESULT_KEPT = 3600
"""How long the result of a goal can be fetched, s."""
FAREWELLS = 10
"""So many more steps at the end, in which the client of a goal is told its result."""


class Sequencer(ManagedNode):
    """Two doors (action and service), one calibration at a time; none while the node is not active."""

    def __init__(self):
        """Declare parameters and stand up all interfaces."""
        super().__init__(names.SEQUENCER, CALIBRATION + CELL)
        self._job = self._next_job = None
        self._taken = set()
        self._last = 'no run yet'
        self._last_level = OK
        self._announcer = Announcer(self)
        self._carry_out = {Ask: self._ask, Locate: self._locate, Remark: self._remark, Verify: self._verify,
                           Tell: self._tell, Finish: self._finish}
        # A CMM that asks for another quality of service shall be noticed.
        self._targets = self.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET,
                                              event_callbacks=PublisherEventCallbacks())
        self._frames = self.create_publisher(TFMessage, names.TF_STATIC, qos.RESULT)
        self.on(names.BALL_CENTRE, BallCentre, self._on_ball_centre, qos.ANSWER,
                tell_incompatible=True)
        self.on(names.ERROR_MOTIONS, ErrorMotions, self._on_error_motions, qos.RESULT)
        self._recorder = RecorderLink(self)
        self._company = Company(self, self._recorder)
        introspected_service(self, Trigger, names.START_CALIBRATION, self._on_trigger)
        introspected_service(self, Trigger, names.CANCEL_CALIBRATION, self._on_cancel_trigger)
        self._action = LongActionServer(
            self, Calibrate, names.CALIBRATE, goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted, cancel_callback=self._on_cancel,
            result_timeout=RESULT_KEPT)
        self._announcer.tell_idle()
        self.autostart()

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

    def _on_cancel_trigger(self, request, response):
        """Cancel what is on, by whichever door it came."""
        job = self._job
        response.success = job is not None and not job.is_over
        if not response.success:
            response.message = 'wanted a run to cancel, got none that is on'
            return response
        response.message = job.run_id
        self._announcer.cancel_requested(job)
        self._do(job, job.sequence.cancel())
        return response

    async def _on_goal(self, goal):
        request = Request(names.CALIBRATE, goal.order, goal.seed, goal.options)
        recalled = await self._recalled(request)
        accepted, _ = self._prepare(request, recalled)
        return GoalResponse.ACCEPT if accepted else GoalResponse.REJECT

    async def _recalled(self, request):
        """Return what is recorded of the run that a request goes on with, a Recall.Response; None: a new run."""
        try:
            name = wanted_changes(request.order, request.seed, request.options).get(RESUME.name)
        except RosetteError:
            return None  # the reason is told when the job is made
        if not name:
            return None
        if not self._recorder.is_there:
            return Recall.Response(message='resume: no recorder: it has the log of the run; start it')
        answer = Future()
        self._recorder.recall(name, RECALL_TIMEOUT, answer.set_result)
        return await answer

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

    def _prepare(self, request, recalled=None):
        """Prepare the job of a request; return (True, run_id) or (False, why not)."""
        try:
            job = self._make_job(request, recalled)
        except RosetteError as error:
            words = plain(str(error), most=2000)
            self.get_logger().warning(f'{request.origin} refused: {words}')
            self._announcer.refused(request, words)
            return False, words
        self._next_job = job
        return True, job.run_id

    def _make_job(self, request, recalled):
        """Return the job of a request; raises RosetteError with the reason why not."""
        if not self.is_active:
            raise CellError(f'the sequencer is {self.state}: calibrations are held back until it is activated '
                            f'(ros2 lifecycle set {self.get_fully_qualified_name()} activate)')
        if self._job is not None:
            raise CellError(f'run {self._job.run_id} is on ({_progress(self._job)}); '
                            'wait for its end or cancel it')
        missing = self._company.missing(self.parameters['require_recorder'])
        if missing:
            raise CellError('; '.join(missing))
        return make_job(request, self.parameters.values(CALIBRATION), self._taken, recalled)

    # From request to result

    def _open(self, job):
        """Take a job on: the log first, then the first target."""
        self._job, job.since = job, self.seconds()
        self._taken.add(job.run_id)
        self._look(job.since)
        self._announcer.accepted(job)
        goes_on = f', goes on from {job.resumes}' if job.resumes else ''
        self.get_logger().info(f'run {job.run_id}: {job.sequence.programme.total} balls{goes_on}')
        self._open_log(job)

    def _open_log(self, job):
        """Open the log as soon as all nodes have had the time to find each other."""
        lacks_recorder = self.parameters['require_recorder'] and not self._recorder.is_there
        job.is_waiting = lacks_recorder or not self._company.is_settled(self.seconds())
        if job.is_waiting:
            return
        if self._recorder.is_there:
            self._recorder.start(job.run_id, job.resumes, self._recorder_timeout, self._on_opened)
        else:
            self._on_opened(StartRecording.Response(success=True))

    def _on_opened(self, response):
        job = self._job
        job.opening, job.recording, job.log = False, bool(response.log), response.log or job.log
        job.lives = self._company.lives()
        job.sequence.verifies = job.recording
        if job.is_over:
            self._close(job)
        elif response.success:
            self._do(job, job.sequence.begin(self.seconds()))
        else:
            self._do(job, job.sequence.fail(f'no log: {response.message}'))

    def _on_ball_centre(self, message):
        job = self._job
        if job is None or job.is_over:
            return
        done = job.sequence.done
        commands = job.sequence.answer(convert.answer_record(message), self.seconds())
        if not any(isinstance(command, Remark) for command in commands):  # else it is not used, nor is its time
            job.stamp_ns = max(job.stamp_ns, convert.nanoseconds(message.header.stamp))
        self._do(job, commands)
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
        """Look after the time limits and who is there."""
        now = self.seconds()
        self._recorder.tick(now)
        job = self._job
        if job is not None and job.is_over and self._has_lost(job, names.RECORDER):
            self._recorder.give_up('the recorder has gone, the last answers may not be in the log')
            job = self._job
        if job is None or job.is_waiting or job.sequence.is_held:
            self._look(now)
        if job is None:
            return
        if job.is_waiting and job.is_over:
            self._on_closed(StopRecording.Response(success=True))
        elif job.is_waiting and now - job.since > self._recorder_timeout + SETTLING:
            self._do(job, job.sequence.fail(self._company.words))
        elif job.is_waiting:
            self._open_log(job)
        else:
            if not (job.opening or job.is_over):
                self._look_after(job, now)
            self._do(job, job.sequence.tick(now))

    def _look(self, now):
        self._company.look(now, self.parameters['require_recorder'])

    def _look_after(self, job, now):
        """Hold a run while a node has gone that it needs; go on with it when that one is back."""
        sequence, company = job.sequence, self._company
        gone, anew = company.gone(job.lives), company.started_anew(job.lives)
        trouble = company.trouble(job.lives)
        if trouble and not gone and not anew:
            self._do(job, sequence.fail(trouble))
            return
        if (gone or anew) and not sequence.is_held:
            who = ' and '.join(f'the {NODE_WORDS[name]}' for name in dict.fromkeys(gone + anew))
            self._do(job, sequence.hold(f'{who} has gone', now))
        if gone or not sequence.is_held:
            return
        if not anew:
            self._do(job, sequence.go_on(now, anew=False))
        elif company.is_settled(now):
            job.lives = company.lives()
            if names.RECORDER in anew and job.recording:
                self._reopen(job)
            else:
                self._do(job, sequence.go_on(now, anew=True))

    def _has_lost(self, job, name):
        return name in self._company.gone(job.lives) or name in self._company.started_anew(job.lives)

    def _reopen(self, job):
        """Go on in a new log with what the recorder that has gone had brought to the disk."""
        job.opening, job.recording = True, False

        def on_recalled(recalled):
            sequence = job.sequence
            if job.is_over or not recalled.success:
                job.opening = False
                self._do(job, sequence.fail(f'the recorder has gone: {recalled.message}') if not job.is_over else ())
                if job.is_over:
                    self._close(job)
                return
            job.go_on_from(recalled)
            self._announcer.resumed(job)
            self._recorder.start(job.run_id, job.resumes, self._recorder_timeout, self._on_opened)

        self._recorder.recall(job.run_id, RECALL_TIMEOUT, on_recalled)

    def _stamp(self, job):
        """Return the ROS time, in a run never less than before."""
        job.stamp_ns = max(job.stamp_ns, self.now().nanoseconds)
        return convert.time_message(job.stamp_ns)

    def _do(self, job, commands):
        """Carry out the commands of the sequence."""
        for command in commands:
            self._carry_out[type(command)](job, command)

    def _ask(self, job, command):
        self._targets.publish(convert.target_message(
            command.target, job.run_id, command.attempt, command.session, command.centre,
            command.frame_id, self._stamp(job)))

    def _locate(self, job, command):
        # In a run that goes on: where its alignment found the frame, should the old log have missed that.
        stamp = convert.time_message(job.located_ns) if job.located_ns else self._stamp(job)
        self._frames.publish(convert.frame_message(command.frame, MACHINE_FRAME, TABLE_FRAME, stamp))

    def _remark(self, job, command):
        self.get_logger().warning(f'run {job.run_id}: {command.text}')

    def _verify(self, job, command):
        """Ask the recorder which answers are in the log."""
        sequence = job.sequence

        def on_recorded(response):
            if job.sequence is not sequence or sequence.is_held:
                return  # the recorder was started anew meanwhile
            if not response.success:
                self._do(job, sequence.not_verified(response.message, self.seconds()))
                return
            stamps = {}
            for seq, stamp in zip(response.seq, response.stamp_ns, strict=True):
                stamps.setdefault(seq, []).append(stamp)
            self._do(job, sequence.verified(stamps, self.seconds()))

        self._recorder.recorded(job.run_id, command.answers, self._recorder_timeout, on_recorded)

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
            self._on_closed(StopRecording.Response(success=True, log=job.log))

    def _on_closed(self, response):
        job, self._job = self._job, None
        sequence, closed = job.sequence, response.success
        words = sequence.text if closed else f'{sequence.text}; closing the log: {response.message}'
        if not closed:
            self.get_logger().error(f'run {job.run_id}: closing the log: {response.message}')
        self._last = f'last run {job.run_id} {sequence.phase.name.lower()}: {words}'
        self._last_level = ERROR if sequence.phase is Phase.FAILED or not closed else OK
        if job.goal is not None:
            self._action.finish(job.goal, Calibrate.Result(
                success=sequence.phase is Phase.DONE, message=words, run_id=job.run_id,
                error_motions=job.motions, log=response.log or job.log))

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
            silent = ''.join(f'; {name} does not beat: it hangs, or its computer is overloaded'
                             for name in self._company.silent())
            level = WARN if silent or sequence.is_held else OK
            return level, f'{_progress(job)}: {sequence.describe()}{silent}', {
                'run_id': job.run_id, 'done': sequence.done, 'total': sequence.programme.total}
        if not self.is_active:
            return WARN, f'{self.state}: calibrations are held back until the node is activated', {}
        missing = self._company.missing(self.parameters['require_recorder'])
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
