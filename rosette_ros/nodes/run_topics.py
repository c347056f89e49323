# SPDX-License-Identifier: Apache-2.0
"""What the sequencer publishes of a run: targets, table frame, states, events, the whole run."""

from collections.abc import Sequence

from geometry_msgs.msg import TransformStamped
from rosette_msgs.msg import CalibrationEvent, ProbeTarget, Run, RunState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from rosette_ros.calibration.goal import Job, Request
from rosette_ros.core.run.geometry import Frame
from rosette_ros.io.messages import MACHINE_FRAME, TABLE_FRAME, Phase, Target
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import CellNode


class RunTopics:
    """The publishers of a run."""

    def __init__(self, node: CellNode) -> None:
        """Take the node that publishes."""
        self._node = node
        self._states = node.create_publisher(RunState, names.RUN_STATE, qos.STATE)
        self._events = node.create_publisher(CalibrationEvent, names.CALIBRATION_EVENT, qos.EVENT)
        self._targets = node.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET)
        self._runs = node.create_publisher(Run, names.RUN, qos.RESULT)
        self._frames = node.create_publisher(TFMessage, names.TF_STATIC, qos.RESULT)

    def _header(self) -> Header:
        return Header(stamp=self._node.now().to_msg())

    def target(self, target: Target) -> None:
        """Publish what the CMM is asked for."""
        self._targets.publish(conversions.target_message(target))

    def frame(self, frame: Frame, stamp_ns: int) -> Sequence[TransformStamped]:
        """Publish the table frame in the machine frame, found at a ROS time, ns; return it as transforms."""
        found = conversions.frame_message(frame, MACHINE_FRAME, TABLE_FRAME, conversions.time_message(stamp_ns))
        self._frames.publish(found)
        return list(found.transforms)

    def ready(self) -> None:
        """Publish that no run has begun yet."""
        self._node.say(self._states, RunState(header=self._header(), phase=int(Phase.IDLE), text='ready'))

    def state(self, job: Job) -> RunState:
        """Publish how far a run is, and return it."""
        sequence = job.sequence
        state = RunState(header=self._header(), run_id=job.run_id, phase=int(sequence.phase), order=job.order,
                         done=sequence.done, total=sequence.plan.total, text=sequence.describe())
        self._node.say(self._states, state)
        return state

    def run(self, job: Job) -> None:
        """Publish all targets and answers of a run, and its table frames."""
        self._node.say(self._runs, conversions.run_message(job.sequence.answers, job.frames, self._node.now().to_msg()))

    def event(self, request: Request, kind: int, text: str, job: Job | None = None) -> None:
        """Publish what became of a request; kind: a constant of CalibrationEvent."""
        self._events.publish(conversions.event_message(self._header(), request, kind, text, job))
