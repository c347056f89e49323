# SPDX-License-Identifier: Apache-2.0
"""What the sequencer tells others about a calibration: states, feedback, events."""

from rosette_msgs.action import Calibrate
from rosette_msgs.msg import CalibrationEvent, RunState
from std_msgs.msg import Header

from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.programme import Phase

_END_EVENTS = {Phase.DONE: CalibrationEvent.SUCCEEDED, Phase.CANCELLED: CalibrationEvent.CANCELLED,
               Phase.FAILED: CalibrationEvent.FAILED}


class Announcer:
    """Publishes run_state and calibration_event and gives feedback to the goal."""

    def __init__(self, node):
        """Create the publishers on a CellNode."""
        self._node = node
        self._told = 0.0
        self._states = node.create_publisher(RunState, names.RUN_STATE, qos.STATE)
        self._events = node.create_publisher(CalibrationEvent, names.CALIBRATION_EVENT, qos.EVENT)

    def tell_idle(self):
        """Make known that nothing is on."""
        self._states.publish(convert.state_message(Phase.IDLE, '', '', 0, 0, 'ready',
                                                   self._node.now().to_msg()))

    def tell(self, job):
        """Publish the state of a job."""
        sequence = job.sequence
        self._told = self._node.seconds()
        state = convert.state_message(
            sequence.phase, job.run_id, job.order, sequence.done, sequence.programme.total,
            sequence.describe(), self._node.now().to_msg())
        self._states.publish(state)
        if job.goal is not None and job.goal.is_active:
            job.goal.publish_feedback(Calibrate.Feedback(state=state))

    def tell_progress(self, job, rate):
        """Publish the state unless that was done less than 1/rate ago; rate: Hz."""
        if self._node.seconds() - self._told >= 1.0 / rate:
            self.tell(job)

    def refused(self, request, words):
        """Publish that a request came and was refused."""
        for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.REJECTED):
            self._publish(request, kind, words)

    def accepted(self, job):
        """Publish that a request came and was accepted."""
        for kind in (CalibrationEvent.REQUESTED, CalibrationEvent.ACCEPTED):
            self._publish(job.request, kind, f'run {job.run_id}', job)

    def resumed(self, job):
        """Publish that the job goes on in a new log."""
        self._publish(job.request, CalibrationEvent.ACCEPTED, f'run {job.run_id} goes on from {job.resumes}', job)

    def cancel_requested(self, job):
        """Publish that the client wants the job cancelled."""
        self._publish(job.request, CalibrationEvent.CANCEL_REQUESTED, 'cancel requested', job)

    def ended(self, job):
        """Publish how the job has ended."""
        sequence = job.sequence
        self._publish(job.request, _END_EVENTS[sequence.phase], sequence.text, job)

    def _publish(self, request, kind, text, job=None):
        goal = job.goal if job else None
        self._events.publish(CalibrationEvent(
            header=Header(stamp=self._node.now().to_msg()), run_id=job.run_id if job else '',
            kind=kind, origin=request.origin, order=job.order if job else request.order,
            goal_id=bytes(goal.goal_id.uuid).hex() if goal else '', seed=request.seed,
            options=request.options, settings=job.settings if job else '',
            resumes=job.resumes if job else '', text=text))
