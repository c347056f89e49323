# SPDX-License-Identifier: Apache-2.0
"""The sequencer: takes requests for calibrations by action and service, and answers of the CMM for the present one."""

import sys
from functools import partial
from typing import Any

from rclpy.action import CancelResponse, GoalResponse
from rclpy.task import Future
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, CalibrationEvent, ErrorMotions
from rosette_msgs.srv import Recall
from std_srvs.srv import Trigger

from rosette_ros.calibration.goal import Job, Request, make_job
from rosette_ros.calibration.settings import IDENTITY, LIMITS, PLANNED, RESUME, Wanted, goal_changes
from rosette_ros.core.run.errors import CellError, RosetteError, plain
from rosette_ros.io.messages import answer_of
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.base_node import WARN, Health, ManagedNode, run_node
from rosette_ros.nodes.interfaces import CalibrateServer, introspected_service, run_task, tell_defect
from rosette_ros.nodes.run_control import RECORDER_TIMEOUT, RunControl
from rosette_ros.nodes.run_topics import RunTopics

CALIBRATION = (*PLANNED, *LIMITS, IDENTITY)
CELL = (
    Wanted('require_recorder', True, 'whether a run without a log is refused'),
    Wanted(RECORDER_TIMEOUT, 10.0, 'wall time for opening, verifying or closing a log, s', 0.1, 1e4),
    Wanted('state_rate_hz', 10.0, 'most states per second of wall time while a phase lasts, Hz', 0.1, 1e4))


class Sequencer(ManagedNode):
    """One calibration at a time, by action or service; none while the node is not active."""

    def __init__(self) -> None:
        super().__init__(names.SEQUENCER, CALIBRATION + CELL)
        self._next_job: Job | None = None
        self._taken, self._refusal = set[str](), ''
        self._topics = RunTopics(self)
        self._control = RunControl(self, self._topics, self._send_result)
        self.on(names.BALL_CENTRE, BallCentre, lambda message: self._control.answer(answer_of(message)), qos.ANSWER,
                from_one=True)
        self.on(names.ERROR_MOTIONS, ErrorMotions, self._control.evaluated, qos.RESULT, from_one=True)
        introspected_service(self, Trigger, names.START_CALIBRATION, self._on_start)
        introspected_service(self, Trigger, names.CANCEL_CALIBRATION, self._on_cancel_service)
        self._action = CalibrateServer(
            self, Calibrate, names.CALIBRATE, execute_callback=lambda goal_handle: None, goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted, cancel_callback=self._on_cancel, result_timeout=3600)
        self._topics.ready()
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
        job = self._control.job
        if job is None or job.is_over:
            return Trigger.Response(message='expected a run to cancel, found none that is running')
        self._topics.event(job.request, CalibrationEvent.CANCEL_REQUESTED, 'cancel requested', job)
        self._control.cancel(job)
        return Trigger.Response(success=True, message=job.run_id)

    async def _on_goal(self, goal: Calibrate.Goal) -> GoalResponse:
        try:
            request = Request.of_goal(names.CALIBRATE, goal)
            accepted, words = self._prepare(request, await self._recalled(request))
        except Exception:
            accepted, words = False, tell_defect(self)
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
        if not self._control.recorder.is_there:
            return Recall.Response(message='resume: no recorder: it has the log of the run; start it')
        answer = Future()
        self._control.recorder.recall(name, answer.set_result)
        return await answer

    def _on_accepted(self, goal_handle: Any) -> None:
        goal_handle.execute()
        if self._refusal or self._next_job is None:
            goal_handle.abort()
            self._action.send_result(goal_handle, Calibrate.Result(message=self._refusal))
        else:
            self._next_job.goal = goal_handle
            try:
                self._accept()
            except Exception:
                self._control.fail(tell_defect(self))

    def _on_cancel(self, goal_handle: Any) -> CancelResponse:
        job = self._control.job
        if job is None or job.goal is not goal_handle or job.is_over:
            return CancelResponse.REJECT
        self._topics.event(job.request, CalibrationEvent.CANCEL_REQUESTED, 'cancel requested', job)
        # The goal may only become "canceled" once this callback has returned.
        run_task(self, lambda: self._control.cancel(job))
        return CancelResponse.ACCEPT

    def _prepare(self, request: Request, recalled: Recall.Response | None = None) -> tuple[bool, str]:
        """Prepare the job of a request; return (True, run_id) or (False, why not)."""
        try:
            job = self._make_job(request, recalled)
        except Exception as error:
            words = plain(str(error), most=2000) if isinstance(error, RosetteError) else tell_defect(self)
            self.get_logger().error(f'{request.origin} refused: {words}')
            for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.REJECTED):
                self._topics.event(request, kind, words)
            return False, words
        self._next_job = job
        return True, job.run_id

    def _make_job(self, request: Request, recalled: Recall.Response | None) -> Job:
        if not self.is_active:
            raise CellError('the sequencer is not active: no calibration starts until it is activated (ros2 lifecycle '
                            f'set {self.get_fully_qualified_name()} activate)')
        if running := self._control.job:
            raise CellError(f'run {running.run_id} is running ({running.progress}); wait for its end or cancel it')
        if lacks := self._control.lacks:
            raise CellError(lacks)
        return make_job(request, self.parameters.values(CALIBRATION), self._taken, recalled, self._control.unfinished)

    def _accept(self) -> None:
        """Accept the job that was prepared."""
        job, self._next_job = self._next_job, None
        if job is not None:
            self._taken.add(job.run_id)
            self._control.begin(job)

    def _send_result(self, job: Job, result: Calibrate.Result) -> None:
        if job.goal is not None:
            self._action.send_result(job.goal, result)

    @property
    def is_busy(self) -> bool:
        """Whether a calibration is running."""
        return self._control.job is not None

    def wake(self) -> None:
        """Do what is due in the present calibration."""
        self._control.tick()

    def finish(self) -> None:
        """End a running calibration in good order."""
        job = self._control.job
        if job is None:
            return
        self._control.cancel(job, 'the sequencer was stopped')
        self.spin_until(lambda: not self.is_busy, self._control.recorder_timeout.seconds)
        self.spin_until(lambda: False, 0.5)  # the client of the goal fetches the result

    def health(self) -> Health:
        """Say whether a calibration can start, or how far the present one is."""
        if not (self.is_busy or self.is_active):
            return WARN, 'not active: no calibration starts until the node is activated', {}
        return self._control.health()


main = partial(run_node, names.SEQUENCER, Sequencer)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())
