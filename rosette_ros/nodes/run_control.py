# SPDX-License-Identifier: Apache-2.0
"""The carrying out of a calibration: what its state machine commands, its log, the nodes that it needs, its end."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rosette_msgs.action import Calibrate
from rosette_msgs.msg import CalibrationEvent, ErrorMotions, JointEvaluation
from rosette_msgs.srv import EvaluateJointly, Recorded, StartRecording, StopRecording

from rosette_ros.calibration import commands as to
from rosette_ros.calibration.goal import Job
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.messages import Answer, Phase, Target, nanoseconds
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.nodes import conversions, names
from rosette_ros.nodes.base_node import ERROR, OK, WARN, CellNode, Health
from rosette_ros.nodes.liveliness import SETTLING
from rosette_ros.nodes.node_requests import (
    END_EVENTS,
    CellMonitor,
    NextBlock,
    PlanCheck,
    RecorderLink,
    Requests,
    RoleClient,
    Within,
)
from rosette_ros.nodes.run_topics import RunTopics
from rosette_ros.words.calibration_words import with_advice

TELL = 60.0  # a run logs its progress so often, s
RECORDER_TIMEOUT = 'recorder_timeout_s'
REMARKS = 5  # so many of the last warnings of a run are in /diagnostics


class RunControl:
    """Carries out one job at a time.

    job: the present one, None between two; unfinished: what was measured in the last run, where it has not succeeded;
    recorder: the requests to the recorder."""

    def __init__(self, node: CellNode, topics: RunTopics, on_end: Callable[[Job, Calibrate.Result], None]) -> None:
        """Take the node that carries out, what it publishes, and who is told the result of each job."""
        self._node, self._topics, self._on_end = node, topics, on_end
        self.job: Job | None = None
        self.unfinished: RunAnswers | None = None
        self._last, self._last_level, self._published = 'no run yet', OK, 0.0
        self.recorder, self._evaluator = RecorderLink(node), Requests(node, names.EVALUATOR)
        self._joint_client = RoleClient(node, EvaluateJointly, names.EVALUATE_JOINTLY)
        self._cell, self._plan_check = CellMonitor(node, self.recorder), PlanCheck(node)
        self._next_block = NextBlock(node, self._evaluator, self._plan_check)
        # A request that a killed one has, is lost: its service is on the graph until the next one offers it.
        node.monitor(names.EVALUATOR).on_change = partial(self._evaluator.give_up, 'the evaluator was restarted')

    @property
    def lacks(self) -> str:
        """What keeps a calibration from starting, '' where nothing does."""
        return '; '.join(self._cell.missing(self._is_recorder_required)) or self._cell.problems(names.NEEDED)

    @property
    def _is_recorder_required(self) -> bool:
        return bool(self._node.parameters['require_recorder'])

    @property
    def recorder_timeout(self) -> Within:
        """Wall time for opening, verifying or closing a log."""
        return Within(float(self._node.parameters[RECORDER_TIMEOUT]), RECORDER_TIMEOUT)

    def begin(self, job: Job) -> None:
        """Begin a job: the log first, then the first target."""
        node = self._node
        self.job, job.since, job.sequence.clock = job, node.seconds(), lambda: node.now().nanoseconds
        job.is_waiting = True
        self._cell.update(job.since, self._is_recorder_required)
        for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.ACCEPTED):
            self._topics.event(job.request, kind, f'run {job.run_id}', job)
        continues = f', continues {job.resumes}' if job.resumes else ''
        node.get_logger().info(f'run {job.run_id}: {job.sequence.plan.total} balls{continues}')
        self._open_log(job)

    def _open_log(self, job: Job) -> None:
        """Open the log as soon as all nodes have had the time to discover each other, and the CMM takes the plan."""
        now = self._node.seconds()
        lacks_recorder = self._is_recorder_required and not self.recorder.is_there
        if lacks_recorder or not self._cell.is_settled(now):
            return
        try:
            self._next_block.refuse_none(job.sequence)
            job.is_waiting = not self._plan_check.is_passed(job.run_id, job.sequence.plan, now)
        except CellError as error:
            self._do(job, job.sequence.fail(str(error)))
        if not job.is_waiting and self.recorder.is_there:
            self.recorder.start(job.run_id, job.resumes, self.recorder_timeout, self._on_opened)
        elif not job.is_waiting:
            self._on_opened(StartRecording.Response(success=True))

    def _on_opened(self, response: StartRecording.Response) -> None:
        job = self.job
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
            self._do(job, job.sequence.resume_asking(self._node.seconds(), restarted=True) if job.sequence.is_held
                     else job.sequence.begin(self._node.seconds()))
            if job.resumes and not job.is_over and job.sequence.phase is not Phase.EVALUATION:
                self._topics.run(job)  # the log that it continues may lack what the sequencer has

    def answer(self, answer: Answer) -> None:
        """Take an answer of the CMM; of a run that is over it counts where that is resumed."""
        job, now = self.job, self._node.seconds()
        if job is None:
            if self.unfinished is not None and self.unfinished.run_id == answer.run_id:
                self.unfinished.add_answer(answer)
            return
        done = job.sequence.done
        self._do(job, job.sequence.answer(answer, now))
        rate = self._node.parameters['state_rate_hz']
        if job.sequence.done > done and self._node.seconds() - self._published >= 1.0 / rate:
            self._publish_state(job)

    def evaluated(self, message: ErrorMotions) -> None:
        """Take the results of the evaluator."""
        job = self.job
        if job is not None and message.run_id == job.run_id:
            results = to.Results(nanoseconds(message.header.stamp), message.readings_hash, message.model_hash,
                                 message.diagnosed)
            commands = job.sequence.evaluated(results)
            job.motions = message if commands else job.motions
            self._do(job, commands)

    def cancel(self, job: Job, text: str = '') -> None:
        """Cancel a job; text: why, where nobody requested it."""
        self._do(job, job.sequence.cancel(text) if text else job.sequence.cancel())

    def fail(self, text: str) -> None:
        """End the present job as failed; text: why."""
        if self.job is not None:
            self._do(self.job, self.job.sequence.fail(text))

    def tick(self) -> None:
        """Check the time limits and which nodes are connected; call it from a timer."""
        now = self._node.seconds()
        self.recorder.tick(now)
        self._evaluator.tick(now)
        job = self.job
        is_asked = job and (job.is_over or job.opening or job.sequence.phase is Phase.EVALUATION)
        if job and is_asked and names.RECORDER in self._cell.trouble(job.processes, 0).restarted:
            self.recorder.give_up('the recorder was restarted')
            job = self.job
        if job is None or job.is_waiting or job.sequence.is_held:
            self._cell.update(now, self._is_recorder_required)
        if job is None:
            return
        if self._plan_check.is_asking:  # that has a time limit of its own
            job.since = now
        if job.is_waiting and job.is_over:
            self._on_closed(StopRecording.Response(success=True))
        elif job.is_waiting and now - job.since > self.recorder_timeout.seconds + SETTLING:
            self._do(job, job.sequence.fail(self._cell.status))
        elif job.is_waiting:
            self._open_log(job)
        else:
            if not (job.opening or job.is_over):
                self._check_nodes(job, now)
            if not self._cell.is_late(names.CMM):  # else it may not have been there to be asked
                if self._knows_cmm(job, now):
                    self._do(job, self._next_block.tick(job.sequence, now))
                self._do(job, job.sequence.tick(now))
            if job.sequence.left is not None:
                words = f'run {job.run_id}: {job.progress}: {job.sequence.describe()}'
                self._node.get_logger().info(words, throttle_duration_sec=TELL, skip_first=True)

    def _knows_cmm(self, job: Job, now: float) -> bool:
        """Return whether what follows an evaluation may be asked: of another CMM than before, in a new session.

        None is needed meanwhile. Of one that is gone it is asked in vain, as at any other moment."""
        sequence, cell = job.sequence, self._cell
        if not sequence.is_settling or sequence.phase is not Phase.EVALUATION or names.CMM not in job.processes:
            return True
        trouble = cell.trouble({names.CMM: job.processes[names.CMM]}, job.ignored)
        if trouble.gone or not trouble.restarted:
            return True
        cell.update(now, self._is_recorder_required)
        if not (cell.is_settled(now) and self._node.has_single_publishers):
            return False
        job.processes[names.CMM] = cell.processes()[names.CMM]
        self._do(job, sequence.begin_session())
        return True

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
        if trouble.gone or trouble.conflict or not (sequence.is_held and self._node.has_single_publishers):
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
            if not self.recorder.has_answered:  # it has ended again: the next one is another process
                job.recording, job.processes[names.RECORDER] = True, ''
            else:
                self._do(job, job.sequence.fail(f'no log: {response.message}'))

        self._topics.event(job.request, CalibrationEvent.ACCEPTED, f'continues {job.resumes}', job)
        self.recorder.start(job.run_id, job.run_id, self.recorder_timeout, on_opened)

    def _do(self, job: Job, commands: Sequence[to.Command]) -> None:
        node = self._node
        for command in commands:
            match command:
                case to.Ask(target, wait):
                    node.after(0.0 if not wait or node.has_simulated_time else wait, partial(self._ask, job, target))
                case to.Locate(frame, stamp_ns):
                    # In a run that is resumed: when its alignment found the frame, should the old log lack that.
                    job.frames += self._topics.frame(frame, job.located_ns or stamp_ns)
                case to.Warn(text):
                    node.get_logger().warning(f'run {job.run_id}: {text}')
                    job.remarks.append(text)
                case to.PublishState():
                    self._publish_state(job)
                case to.PublishRun():
                    self._topics.run(job)
                case to.Verify(results):
                    self._verify(job, results)
                case to.AskNext(results, readings):
                    self._next_block.ask(job.sequence, results.readings_hash, readings)
                case to.Extended(text):
                    node.get_logger().info(f'run {job.run_id}: {text}')
                    self._topics.event(job.request, CalibrationEvent.EXTENDED, text, job)
                case to.Finish():
                    self._finish(job, command)

    def _ask(self, job: Job, target: Target) -> None:
        if job.sequence.is_asked(target):  # it may be over, or held, after a wait
            self._topics.target(target)

    def _publish_state(self, job: Job) -> None:
        self._published = self._node.seconds()
        state = self._topics.state(job)
        if job.goal is not None and job.goal.is_active:
            job.goal.publish_feedback(Calibrate.Feedback(state=state))

    def _verify(self, job: Job, results: to.Results) -> None:
        request = Recorded.Request(
            run_id=job.run_id, error_motions=conversions.time_message(results.stamp_ns), diagnosis=results.diagnosed,
            readings_hash=results.readings_hash, model_hash=results.model_hash)
        self.recorder.recorded(request, self.recorder_timeout, lambda response: self._do(
            job, job.sequence.verified(response.missing) if response.success else
            job.sequence.not_verified(response.message, self._node.seconds())))

    def _finish(self, job: Job, command: to.Finish) -> None:
        self._topics.event(job.request, END_EVENTS[command.phase], command.text, job)
        words = f'run {job.run_id}: {command.phase.name.lower()}: {command.text}'
        if command.phase is Phase.FAILED:
            self._node.get_logger().error(words)
        else:
            self._node.get_logger().info(words)
        job.end_goal()
        if command.phase is not Phase.DONE or not job.joint_with:
            self._close(job)
            return

        def on_evaluated(response: EvaluateJointly.Response) -> None:
            job.joint = response
            self._close(job)

        self._evaluator.call(self._joint_client, EvaluateJointly.Request(run_ids=[*job.joint_with, job.run_id]),
                             Within(job.sequence.limits.evaluation_timeout, 'limits.evaluation_timeout_s'),
                             on_evaluated)

    def _close(self, job: Job, end_is_recorded: bool = True) -> None:
        """Close the log of a job that is over; while it is being opened, wait for that."""
        if job.opening:
            return
        if job.recording and self.recorder.is_there:
            job.recording = False
            request = StopRecording.Request(run_id=job.run_id)
            if end_is_recorded:
                request.answers, request.phase = job.sequence.done, int(job.sequence.phase)
            self.recorder.stop(request, self.recorder_timeout, self._on_closed)
        else:
            self._on_closed(StopRecording.Response(success=True, log=job.log))

    def _on_closed(self, response: StopRecording.Response) -> None:
        job, self.job = self.job, None
        if job is None:
            return
        sequence, words = job.sequence, job.text
        if not response.success:
            lacks = f'it lacks {", ".join(response.missing)}' if response.missing else response.message
            words = words if lacks in words else f'{words}; closing the log: {lacks}'
            self._node.get_logger().error(f'run {job.run_id}: closing the log: {lacks}')
        succeeded = sequence.phase is Phase.DONE and response.success
        self.unfinished = None if succeeded else sequence.answers
        self._last = f'last run {job.run_id} {sequence.phase.name.lower()}: {words}'
        self._last_level = OK if succeeded or (sequence.phase is Phase.CANCELLED and response.success) else ERROR
        log = response.log or ('' if response.messages else job.log)
        if not succeeded:
            where = names.where(self._node.context.get_domain_id(), self._node.get_namespace())
            words = with_advice(words, log, bool(sequence.done), where)
        self._on_end(job, Calibrate.Result(
            success=succeeded, paused=sequence.is_paused and response.success, message=words, run_id=job.run_id,
            error_motions=job.motions or ErrorMotions(), log=log,
            joint_evaluation=job.joint_evaluation or JointEvaluation()))

    def health(self) -> Health:
        """Say how far the present calibration is, or whether one can start and how the last one ended."""
        job = self.job
        if job is None:
            lacks = self.lacks
            return (WARN, lacks, {'last': self._last}) if lacks else (self._last_level, f'ready; {self._last}', {})
        sequence = job.sequence
        silent = ''.join(f'; {words}' for words in self._cell.busy())
        silent += f'; {len(job.remarks)} warnings, the last: {job.remarks[-1]}' if job.remarks else ''
        return WARN if silent or sequence.is_held else OK, f'{job.progress}: {sequence.describe()}{silent}', {
            'run_id': job.run_id, 'done': sequence.done, 'total': sequence.plan.total,
            'warnings': '; '.join(job.remarks[-REMARKS:])}
