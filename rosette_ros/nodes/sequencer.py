# SPDX-License-Identifier: Apache-2.0
"""The sequencer: runs calibrations, asks the CMM for one ball after the other."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.action import CancelResponse, GoalResponse
from rclpy.task import Future
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, CalibrationEvent, ErrorMotions, JointEvaluation, ProbeTarget, Run, RunState
from rosette_msgs.srv import EvaluateJointly, Recall, Recorded, StartRecording, StopRecording
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from rosette_ros.calibration import commands as to
from rosette_ros.calibration.goal import Job, Request, make_job
from rosette_ros.calibration.settings import IDENTITY, LIMITS, PLANNED, RESUME, Wanted, goal_changes
from rosette_ros.calibration.state_machine import with_advice
from rosette_ros.core.run.errors import CellError, RosetteError, plain
from rosette_ros.io.messages import MACHINE_FRAME, TABLE_FRAME, Phase, Target, answer_of, nanoseconds
from rosette_ros.io.run_assembly import RunAnswers
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import ERROR, OK, WARN, Health, ManagedNode, run_node
from rosette_ros.nodes.interfaces import CalibrateServer, introspected_service
from rosette_ros.nodes.liveliness import SETTLING
from rosette_ros.nodes.node_requests import END_EVENTS, CellMonitor, NextBlock, PlanCheck, RecorderLink, Requests

CALIBRATION = (*PLANNED, *LIMITS, IDENTITY)
CELL = (
    Wanted('require_recorder', True, 'whether a run without a log is refused'),
    Wanted('recorder_timeout_s', 10.0, 'wall time for opening, verifying or closing a log, s', 0.1, 1e4),
    Wanted('state_rate_hz', 10.0, 'most states per second of wall time while a phase lasts, Hz', 0.1, 1e4))
TELL = 60.0  # a run logs its progress so often, s
REMARKS = 5  # so many of the last warnings of a run are in /diagnostics


class Sequencer(ManagedNode):
    """One calibration at a time, by action or service; none while the node is not active."""

    def __init__(self) -> None:
        super().__init__(names.SEQUENCER, CALIBRATION + CELL)
        self._job: Job | None = None
        self._next_job: Job | None = None
        self._taken, self._refusal = set[str](), ''
        self._unfinished: RunAnswers | None = None  # of the last run, where it has not succeeded
        self._last, self._last_level, self._published = 'no run yet', OK, 0.0
        self._states = self.create_publisher(RunState, names.RUN_STATE, qos.STATE)
        self._events = self.create_publisher(CalibrationEvent, names.CALIBRATION_EVENT, qos.EVENT)
        self._targets = self.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET)
        self._runs = self.create_publisher(Run, names.RUN, qos.RESULT)
        self._frames = self.create_publisher(TFMessage, names.TF_STATIC, qos.RESULT)
        self.on(names.BALL_CENTRE, BallCentre, self._on_ball_centre, qos.ANSWER, from_one=True)
        self.on(names.ERROR_MOTIONS, ErrorMotions, self._on_error_motions, qos.RESULT, from_one=True)
        self._recorder, self._evaluator = RecorderLink(self), Requests(self, names.EVALUATOR)
        self._joint_client = self.create_client(EvaluateJointly, names.EVALUATE_JOINTLY)
        self._cell, self._plan_check = CellMonitor(self, self._recorder), PlanCheck(self)
        self._next_block = NextBlock(self, self._evaluator, self._plan_check)
        # A request that a killed one has, is lost: its service is on the graph until the next one offers it.
        self.monitor(names.EVALUATOR).on_change = partial(self._evaluator.give_up, 'the evaluator was restarted')
        introspected_service(self, Trigger, names.START_CALIBRATION, self._on_start)
        introspected_service(self, Trigger, names.CANCEL_CALIBRATION, self._on_cancel_service)
        self._action = CalibrateServer(
            self, Calibrate, names.CALIBRATE, execute_callback=lambda goal_handle: None, goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted, cancel_callback=self._on_cancel, result_timeout=3600)
        self.say(self._states, RunState(header=self._header(), phase=int(Phase.IDLE), text='ready'))
        self.autostart()

    def destroy_node(self) -> None:
        self._action.destroy()
        super().destroy_node()

    def _on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._prepare(Request(names.START_CALIBRATION))
        if response.success:
            self._accept()
        return response

    def _on_cancel_service(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Cancel the running calibration, by whichever interface it was requested."""
        job = self._job
        if job is None or job.is_over:
            return Trigger.Response(message='wanted a run to cancel, got none that is running')
        self._publish_event(job.request, CalibrationEvent.CANCEL_REQUESTED, 'cancel requested', job)
        self._do(job, job.sequence.cancel())
        return Trigger.Response(success=True, message=job.run_id)

    async def _on_goal(self, goal: Calibrate.Goal) -> GoalResponse:
        request = Request.of_goal(names.CALIBRATE, goal)
        accepted, words = self._prepare(request, await self._recalled(request))
        self._refusal = '' if accepted else words
        return GoalResponse.ACCEPT  # a goal that is rejected has no result to say why

    async def _recalled(self, request: Request) -> Recall.Response | None:
        """Return what is recorded of the run that a request resumes; None: a new run."""
        try:
            name = str(goal_changes(request.goal).get(RESUME.name, ''))
        except RosetteError:
            return None  # the reason is given when the job is made
        if not name:
            return None
        if not self._recorder.is_there:
            return Recall.Response(message='resume: no recorder: it has the log of the run; start it')
        answer = Future()
        self._recorder.recall(name, answer.set_result)
        return await answer

    def _on_accepted(self, goal_handle: Any) -> None:
        goal_handle.execute()
        if self._refusal or self._next_job is None:
            goal_handle.abort()
            self._action.send_result(goal_handle, Calibrate.Result(message=self._refusal))
        else:
            self._next_job.goal = goal_handle
            self._accept()

    def _on_cancel(self, goal_handle: Any) -> CancelResponse:
        job = self._job
        if job is None or job.goal is not goal_handle or job.is_over:
            return CancelResponse.REJECT
        self._publish_event(job.request, CalibrationEvent.CANCEL_REQUESTED, 'cancel requested', job)
        # The goal may only become "canceled" once this callback has returned.
        self.executor.create_task(lambda: self._do(job, job.sequence.cancel()))
        return CancelResponse.ACCEPT

    def _prepare(self, request: Request, recalled: Recall.Response | None = None) -> tuple[bool, str]:
        """Prepare the job of a request; return (True, run_id) or (False, why not)."""
        try:
            job = self._make_job(request, recalled)
        except RosetteError as error:
            words = plain(str(error), most=2000)
            self.get_logger().error(f'{request.origin} refused: {words}')
            for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.REJECTED):
                self._publish_event(request, kind, words)
            return False, words
        self._next_job = job
        return True, job.run_id

    def _make_job(self, request: Request, recalled: Recall.Response | None) -> Job:
        if not self.is_active:
            raise CellError(f'the sequencer is not active: no calibration starts until it is activated (ros2 lifecycle '
                            f'set {self.get_fully_qualified_name()} activate)')
        if self._job is not None:
            raise CellError(f'run {self._job.run_id} is running ({self._job.progress}); wait for its end or cancel it')
        if lacks := self._lacks:
            raise CellError(lacks)
        return make_job(request, self.parameters.values(CALIBRATION), self._taken, recalled, self._unfinished)

    def _accept(self) -> None:
        """Accept the job that was prepared: the log first, then the first target."""
        job, self._next_job = self._next_job, None
        if job is None:
            return
        self._job, job.since, job.sequence.clock = job, self.seconds(), self._nanoseconds
        self._taken.add(job.run_id)
        self._cell.update(job.since, self.parameters['require_recorder'])
        for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.ACCEPTED):
            self._publish_event(job.request, kind, f'run {job.run_id}', job)
        continues = f', continues {job.resumes}' if job.resumes else ''
        self.get_logger().info(f'run {job.run_id}: {job.sequence.plan.total} balls{continues}')
        self._open_log(job)

    def _open_log(self, job: Job) -> None:
        """Open the log as soon as all nodes have had the time to discover each other, and the CMM takes the plan."""
        job.is_waiting, now = True, self.seconds()
        lacks_recorder = self.parameters['require_recorder'] and not self._recorder.is_there
        if lacks_recorder or not self._cell.is_settled(now):
            return
        try:
            self._next_block.refuse_none(job.sequence)
            job.is_waiting = not self._plan_check.is_passed(job.run_id, job.sequence.plan, now)
        except CellError as error:
            self._do(job, job.sequence.fail(str(error)))
        if not job.is_waiting and self._recorder.is_there:
            self._recorder.start(job.run_id, job.resumes, self._recorder_timeout, self._on_opened)
        elif not job.is_waiting:
            self._on_opened(StartRecording.Response(success=True))

    def _on_opened(self, response: StartRecording.Response) -> None:
        job = self._job
        if job is None:
            return
        job.opening, job.recording, job.log = False, bool(response.log), response.log or job.log
        job.processes, job.ignored = self._cell.processes(), self._cell.ignored
        job.sequence.verifies = job.recording
        if job.is_over:
            self._close(job, end_is_recorded=False)
        elif not response.success:
            self._do(job, job.sequence.fail(f'no log: {response.message}'))
        else:
            self._do(job, job.sequence.resume_asking(self.seconds(), restarted=True) if job.sequence.is_held
                     else job.sequence.begin(self.seconds()))
            if job.resumes and not job.is_over and job.sequence.phase is not Phase.EVALUATION:
                self._publish_run(job)  # the log that it continues may lack what the sequencer has

    def _on_ball_centre(self, message: BallCentre) -> None:
        job, answer = self._job, answer_of(message)
        if job is None:  # the run is over; where it is resumed, its last answer counts
            if self._unfinished is not None and self._unfinished.run_id == answer.run_id:
                self._unfinished.add_answer(answer)
            return
        done = job.sequence.done
        self._do(job, job.sequence.answer(answer, self.seconds()))
        if job.sequence.done > done and self.seconds() - self._published >= 1.0 / self.parameters['state_rate_hz']:
            self._publish_state(job)

    def _on_error_motions(self, message: ErrorMotions) -> None:
        job = self._job
        if job is not None and message.run_id == job.run_id:
            results = to.Results(nanoseconds(message.header.stamp), message.readings_hash, message.model_hash,
                              message.diagnosed)
            commands = job.sequence.evaluated(results)
            job.motions = message if commands else job.motions
            self._do(job, commands)

    @property
    def is_busy(self) -> bool:
        """Whether a calibration is running."""
        return self._job is not None

    def wake(self) -> None:
        """Check the time limits and which nodes are connected."""
        now = self.seconds()
        self._recorder.tick(now)
        self._evaluator.tick(now)
        job = self._job
        is_asked = job and (job.is_over or job.opening or job.sequence.phase is Phase.EVALUATION)
        if job and is_asked and names.RECORDER in self._cell.trouble(job.processes, 0).restarted:
            self._recorder.give_up('the recorder was restarted')
            job = self._job
        if job is None or job.is_waiting or job.sequence.is_held:
            self._cell.update(now, self.parameters['require_recorder'])
        if job is None:
            return
        if self._plan_check.is_asking:  # that has a time limit of its own
            job.since = now
        if job.is_waiting and job.is_over:
            self._on_closed(StopRecording.Response(success=True))
        elif job.is_waiting and now - job.since > self._recorder_timeout + SETTLING:
            self._do(job, job.sequence.fail(self._cell.status))
        elif job.is_waiting:
            self._open_log(job)
        else:
            if not (job.opening or job.is_over):
                self._check_nodes(job, now)
            self._do(job, self._next_block.tick(job.sequence, now))
            if not self._cell.is_late(names.CMM):  # else it may not have been there to be asked
                self._do(job, job.sequence.tick(now))
            if job.sequence.left is not None:
                words = f'run {job.run_id}: {job.progress}: {job.sequence.describe()}'
                self.get_logger().info(words, throttle_duration_sec=TELL, skip_first=True)

    def _check_nodes(self, job: Job, now: float) -> None:
        """Hold a run while a node that it needs is disconnected; continue when that one is back."""
        sequence, cell, is_measured = job.sequence, self._cell, job.sequence.phase is Phase.EVALUATION
        needed = {name: process for name, process in job.processes.items() if name != names.CMM or not is_measured}
        trouble, problems = cell.trouble(needed, job.ignored), cell.problems(needed)
        if is_measured:
            nodes = names.EVALUATOR, names.RECORDER
            problems = problems or cell.problems(nodes)
        if problems and not trouble.nodes:
            self._do(job, sequence.fail(problems))
        elif (trouble.nodes or (str(trouble) and not is_measured)) and not sequence.is_held:
            self._do(job, sequence.hold(str(trouble), now, bool(trouble.nodes)))
        if trouble.gone or trouble.conflict or not (sequence.is_held and self.has_single_publishers):
            return
        if not (trouble.restarted or trouble.has_ignored):
            self._do(job, sequence.resume_asking(now, restarted=False))
        elif cell.is_settled(now):
            job.processes, job.ignored = cell.processes(), cell.ignored
            if names.RECORDER in trouble.restarted and job.recording:
                self._reopen(job)
            else:
                self._do(job, sequence.resume_asking(now, restarted=True))

    def _reopen(self, job: Job) -> None:
        """Continue in a new log; the recorder writes into it what the disconnected one had on the disk, and the rest as
        it is in the run."""
        job.opening, job.recording, job.resumes = True, False, Path(job.log).name

        def on_opened(response: StartRecording.Response) -> None:
            if response.success or job.is_over:
                self._on_opened(response)
                return
            job.opening = False
            if not self._recorder.has_answered:  # it has ended again: the next one is another process
                job.recording, job.processes[names.RECORDER] = True, ''
            else:
                self._do(job, job.sequence.fail(f'no log: {response.message}'))

        self._publish_event(job.request, CalibrationEvent.ACCEPTED, f'continues {job.resumes}', job)
        self._recorder.start(job.run_id, job.run_id, self._recorder_timeout, on_opened)

    def _do(self, job: Job, commands: Sequence[to.Command]) -> None:
        for command in commands:
            match command:
                case to.Ask(target, wait):
                    self.after(0.0 if not wait or self.has_simulated_time else wait, partial(self._ask, job, target))
                case to.Locate(frame, stamp_ns):
                    # In a run that is resumed: when its alignment found the frame, should the old log lack that.
                    stamp = conversions.time_message(job.located_ns or stamp_ns)
                    found = conversions.frame_message(frame, MACHINE_FRAME, TABLE_FRAME, stamp)
                    job.frames += found.transforms
                    self._frames.publish(found)
                case to.Remark(text):
                    self.get_logger().warning(f'run {job.run_id}: {text}')
                    job.remarks.append(text)
                case to.PublishState():
                    self._publish_state(job)
                case to.PublishRun():
                    self._publish_run(job)
                case to.Verify(results):
                    self._verify(job, results)
                case to.AskNext(results, readings):
                    self._next_block.ask(job.sequence, results.readings_hash, readings)
                case to.Extended(text):
                    self.get_logger().info(f'run {job.run_id}: {text}')
                    self._publish_event(job.request, CalibrationEvent.EXTENDED, text, job)
                case to.Finish():
                    self._finish(job, command)

    def _ask(self, job: Job, target: Target) -> None:
        if job.sequence.is_asked(target):  # it may be over, or held, after a wait
            self._targets.publish(conversions.target_message(target))

    def _publish_state(self, job: Job) -> None:
        sequence = job.sequence
        self._published = self.seconds()
        state = RunState(header=self._header(), run_id=job.run_id, phase=int(sequence.phase), order=job.order,
                         done=sequence.done, total=sequence.plan.total, text=sequence.describe())
        self.say(self._states, state)
        if job.goal is not None and job.goal.is_active:
            job.goal.publish_feedback(Calibrate.Feedback(state=state))

    def _publish_run(self, job: Job) -> None:
        self.say(self._runs, conversions.run_message(job.sequence.answers, job.frames, self.now().to_msg()))

    def _publish_event(self, request: Request, kind: int, text: str, job: Job | None = None) -> None:
        self._events.publish(conversions.event_message(self._header(), request, kind, text, job))

    def _nanoseconds(self) -> int:
        return self.now().nanoseconds

    def _header(self) -> Header:
        return Header(stamp=self.now().to_msg())

    def _verify(self, job: Job, results: to.Results) -> None:
        request = Recorded.Request(
            run_id=job.run_id, error_motions=conversions.time_message(results.stamp_ns), diagnosis=results.diagnosed,
            readings_hash=results.readings_hash, model_hash=results.model_hash)
        self._recorder.recorded(request, self._recorder_timeout, lambda response: self._do(
            job, job.sequence.verified(response.missing) if response.success else
            job.sequence.not_verified(response.message, self.seconds())))

    def _finish(self, job: Job, command: to.Finish) -> None:
        self._publish_event(job.request, END_EVENTS[command.phase], command.text, job)
        words = f'run {job.run_id}: {command.phase.name.lower()}: {command.text}'
        if command.phase is Phase.FAILED:
            self.get_logger().error(words)
        else:
            self.get_logger().info(words)
        job.end_goal()
        if command.phase is not Phase.DONE or not job.joint_with:
            self._close(job)
            return

        def on_evaluated(response: EvaluateJointly.Response) -> None:
            job.joint = response
            self._close(job)

        self._evaluator.call(self._joint_client, EvaluateJointly.Request(run_ids=[*job.joint_with, job.run_id]),
                             job.sequence.limits.evaluation_timeout, on_evaluated)

    def _close(self, job: Job, end_is_recorded: bool = True) -> None:
        """Close the log of a job that is over; while it is being opened, wait for that."""
        if job.opening:
            return
        if job.recording and self._recorder.is_there:
            job.recording = False
            request = StopRecording.Request(run_id=job.run_id)
            if end_is_recorded:
                request.answers, request.phase = job.sequence.done, int(job.sequence.phase)
            self._recorder.stop(request, self._recorder_timeout, self._on_closed)
        else:
            self._on_closed(StopRecording.Response(success=True, log=job.log))

    def _on_closed(self, response: StopRecording.Response) -> None:
        job, self._job = self._job, None
        if job is None:
            return
        sequence, words = job.sequence, job.text
        if not response.success:
            lacks = f'it lacks {", ".join(response.missing)}' if response.missing else response.message
            words = words if lacks in words else f'{words}; closing the log: {lacks}'
            self.get_logger().error(f'run {job.run_id}: closing the log: {lacks}')
        succeeded = sequence.phase is Phase.DONE and response.success
        self._unfinished = None if succeeded else sequence.answers
        self._last = f'last run {job.run_id} {sequence.phase.name.lower()}: {words}'
        self._last_level = OK if succeeded or (sequence.phase is Phase.CANCELLED and response.success) else ERROR
        log = response.log or ('' if response.messages else job.log)
        if not succeeded:
            where = names.where(self.context.get_domain_id(), self.get_namespace())
            words = with_advice(words, log, bool(sequence.done), where)
        if job.goal is not None:
            self._action.send_result(job.goal, Calibrate.Result(
                success=succeeded, message=words, run_id=job.run_id, error_motions=job.motions or ErrorMotions(),
                log=log, joint_evaluation=job.joint_evaluation or JointEvaluation()))

    def finish(self) -> None:
        """End a running calibration in good order."""
        job = self._job
        if job is None:
            return
        self._do(job, job.sequence.cancel('the sequencer was stopped'))
        self.spin_until(lambda: self._job is None, self._recorder_timeout)
        self.spin_until(lambda: False, 0.5)  # the client of the goal fetches the result

    def health(self) -> Health:
        """Say whether a calibration can start, or how far the present one is."""
        job = self._job
        if job is not None:
            sequence = job.sequence
            silent = ''.join(f'; {words}' for words in self._cell.busy())
            silent += f'; {len(job.remarks)} warnings, the last: {job.remarks[-1]}' if job.remarks else ''
            return WARN if silent or sequence.is_held else OK, f'{job.progress}: {sequence.describe()}{silent}', {
                'run_id': job.run_id, 'done': sequence.done, 'total': sequence.plan.total,
                'warnings': '; '.join(job.remarks[-REMARKS:])}
        if not self.is_active:
            return WARN, 'not active: no calibration starts until the node is activated', {}
        if lacks := self._lacks:
            return WARN, lacks, {'last': self._last}
        return self._last_level, f'ready; {self._last}', {}

    @property
    def _lacks(self) -> str:
        return '; '.join(self._cell.missing(self.parameters['require_recorder'])) or self._cell.problems(names.NEEDED)

    @property
    def _recorder_timeout(self) -> float:
        return float(self.parameters['recorder_timeout_s'])


main = partial(run_node, names.SEQUENCER, Sequencer)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())
