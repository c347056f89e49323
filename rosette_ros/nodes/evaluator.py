# SPDX-License-Identifier: Apache-2.0
"""The evaluator: turns a finished run into six error motions, with the same code as offline."""

import sys

from rclpy.serialization import deserialize_message
from rosette_msgs.msg import BallCentre, ErrorMotions, Model, ProbeTarget, RunState
from tf2_msgs.msg import TFMessage

from rosette_ros.analysis import analyse
from rosette_ros.core.errors import RosetteError
from rosette_ros.core.model import Model as CoreModel
from rosette_ros.data.assemble import MACHINE_FRAME, TABLE_FRAME
from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.ears import IDLE_REST, REST, ListeningNode
from rosette_ros.nodes.gathering import Gathering
from rosette_ros.nodes.runner import ERROR, OK, run_node
from rosette_ros.nodes.sequence import short_frame
from rosette_ros.nodes.settings import Wanted

WANTED = (
    Wanted('quiet_s', 1.0, 'a run of which no state is told is evaluated when all its balls are '
           'in and nothing more has come for so long, s of wall time', 0.01, 3600.0),
    Wanted('patience_s', 10.0, 'how long missing messages are waited for before that is reported, '
           's of wall time', 0.01, 3600.0),
)


_NOTHING_ON = (RunState.PHASE_IDLE, RunState.PHASE_DONE, RunState.PHASE_CANCELLED,
               RunState.PHASE_FAILED)


class Evaluator(ListeningNode):
    """Listens from its start on; publishes error motions when a run is complete."""

    def __init__(self):
        """Stand up the interfaces and publish the model in use."""
        super().__init__(names.EVALUATOR, WANTED)
        self._model = CoreModel()
        self._gathering = Gathering()
        self._level, self._last = OK, 'no run yet'
        self._complained = set()
        self._motions = self.create_publisher(ErrorMotions, names.ERROR_MOTIONS, qos.RESULT)
        self._models = self.create_publisher(Model, names.MODEL, qos.RESULT)
        self._handlers = {}
        for name, message_class, profile, handle in (
                (names.PROBE_TARGET, ProbeTarget, qos.COLLECT_LATCHED, self._on_target),
                (names.BALL_CENTRE, BallCentre, qos.COLLECT, self._on_answer),
                (names.TF_STATIC, TFMessage, qos.COLLECT_LATCHED, self._on_frames),
                (names.RUN_STATE, RunState, qos.COLLECT_LATCHED, self._on_state)):
            topic = self.resolve_topic_name(name)
            self.ears.listen(topic, message_class, profile)
            self._handlers[topic] = message_class, handle
        self._models.publish(convert.model_message(self._model, self.now().to_msg()))

    def hear(self, heard):
        """Hand every message to its handler; evaluate what has become complete."""
        for _, topic, data, _ in heard:
            message_class, handle = self._handlers[topic]
            handle(deserialize_message(data, message_class))
        if heard:
            self._evaluate_ready()

    def _on_target(self, message):
        self._gathering.add_target(convert.target_row(message), self.seconds())

    def _on_answer(self, message):
        self._gathering.add_answer(convert.answer_row(message), self.seconds())

    def _on_frames(self, message):
        for transform in message.transforms:
            if (short_frame(transform.header.frame_id) == MACHINE_FRAME
                    and short_frame(transform.child_frame_id) == TABLE_FRAME):
                self._gathering.add_frame(convert.nanoseconds(transform.header.stamp),
                                          convert.frame_record(transform.transform))

    def _on_state(self, message):
        self.rest = IDLE_REST if message.phase in _NOTHING_ON else REST
        if message.phase == RunState.PHASE_IDLE:
            return
        if message.phase in (RunState.PHASE_CANCELLED, RunState.PHASE_FAILED):
            self._gathering.forget(message.run_id)
        elif message.phase == RunState.PHASE_EVALUATION:
            self._gathering.expect(message.run_id, message.done, self.seconds())
        else:
            self._gathering.note_state(message.run_id, self.seconds(),
                                       message.phase == RunState.PHASE_DONE)

    def wake(self):
        """Evaluate what has become complete; report what does not."""
        self._evaluate_ready()
        for run_id, lacks in self._gathering.late(self.seconds(), self.parameters['patience_s']):
            if run_id not in self._complained:
                self._complained.add(run_id)
                self._report_failure(run_id, lacks)

    def _evaluate_ready(self):
        for run_id in self._gathering.ready(self.seconds(), self.parameters['quiet_s']):
            try:
                run = self._gathering.to_run(run_id)
                report = analyse(run, self._model)
            except RosetteError as error:
                self._report_failure(run_id, str(error))
            else:
                self._publish(run, report)

    def _publish(self, run, report):
        stamp = self.now().to_msg()
        self._models.publish(convert.model_message(self._model, stamp, report))
        self._motions.publish(convert.error_motions_message(run, report, stamp, TABLE_FRAME))
        self._level, self._last = OK, f'run {run.run_id} is evaluated, {run.size} ball centres'
        self.get_logger().info(self._last)

    def _report_failure(self, run_id, words):
        self._level, self._last = ERROR, f'run {run_id} could not be evaluated: {words}'
        self.get_logger().error(self._last)

    def health(self):
        """Say what became of the last run."""
        return self._level, self._last, {'model': self._model}


def main(args=None):
    """Run the evaluator; returns the exit code."""
    return run_node(names.EVALUATOR, Evaluator, args)


if __name__ == '__main__':
    sys.exit(main())
