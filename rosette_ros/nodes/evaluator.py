# SPDX-License-Identifier: Apache-2.0
"""The evaluator: turns a finished run into six error motions, with the same code as offline.

It says at once what the model lacks, and answers questions about the last runs: see Questions.
"""

import sys

from rosette_msgs.msg import BallCentre, ProbeTarget, RunState
from tf2_msgs.msg import TFMessage

from rosette_ros.core.errors import RosetteError, plain
from rosette_ros.core.model import Model
from rosette_ros.data.assemble import MACHINE_FRAME, TABLE_FRAME
from rosette_ros.data.model_file import read_model
from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.analyst import Analyst
from rosette_ros.nodes.gathering import Gathering
from rosette_ros.nodes.questions import Questions
from rosette_ros.nodes.recorder_link import Recalls
from rosette_ros.nodes.results import Results
from rosette_ros.nodes.runner import ERROR, OK, CellNode, run_node
from rosette_ros.nodes.sequence import short_frame
from rosette_ros.nodes.settings import Wanted

WANTED = (
    Wanted('quiet_s', 1.0, 'a run of which no state is told is evaluated when all its balls are '
           'in and nothing more has come for so long, s of wall time', 0.01, 3600.0),
    Wanted('patience_s', 10.0, 'how long missing messages are waited for before that is reported, '
           's of wall time', 0.01, 3600.0),
    Wanted('model', '', 'model file (YAML) to start with; empty: the base model', read_only=True),
    Wanted('diagnose_after_run', True, 'whether a run is diagnosed as soon as it is evaluated, so '
           'that the diagnosis is in its log'),
    Wanted('diagnose_most_balls', 36, 'plates with more balls are diagnosed on request only: it '
           'takes its time', 0, 1000),
)


RECALL_AFTER, RECALL_PERIOD, RECALL_TIMEOUT = 0.3, 2.0, 60.0
"""Pieces that are missing for so long are asked for, again after so long, and waited for so long, s."""

_NOTHING_ON = (RunState.PHASE_IDLE, RunState.PHASE_DONE, RunState.PHASE_CANCELLED,
               RunState.PHASE_FAILED)


class Evaluator(CellNode):
    """Listens from its start on; publishes error motions when a run is complete."""

    is_patient = True

    def __init__(self):
        """Stand up the interfaces and publish the model in use."""
        super().__init__(names.EVALUATOR, WANTED)
        path = self.parameters['model']
        self._analyst = Analyst(read_model(path) if path else Model())
        self._gathering = Gathering()
        self._level, self._last = OK, 'no run yet'
        self._complained = set()
        self._is_busy = False
        self._recorder = Recalls(self)
        self._recalled = {}
        self._results = Results(self)
        self._questions = Questions(self, self._analyst, self._results)
        self.on(names.PROBE_TARGET, ProbeTarget, self._on_target, qos.COLLECT_LATCHED)
        self.on(names.BALL_CENTRE, BallCentre, self._on_answer, qos.COLLECT)
        self.on(names.TF_STATIC, TFMessage, self._on_frames, qos.COLLECT_LATCHED)
        self.on(names.RUN_STATE, RunState, self._on_state, qos.COLLECT_LATCHED)
        self._results.tell_model(self._analyst.model)

    @property
    def is_busy(self):
        """Whether a run is on."""
        return self._is_busy

    def hear(self, heard):
        """Hand every message to its handler; evaluate what has become complete."""
        super().hear(heard)
        if heard:
            self._evaluate_ready()

    def _on_target(self, message):
        self._gathering.add_target(convert.target_row(message), self.seconds())

    def _on_answer(self, message):
        self._gathering.add_answer(convert.answer_row(message), self.seconds())

    def _on_frames(self, message):
        for stamp_ns, frame in self._frames_in(message.transforms):
            self._gathering.add_frame(stamp_ns, frame)

    def _frames_in(self, transforms):
        """Return (stamp in ns, Frame) of the table frames among transforms; what is none is told."""
        frames = []
        for one in filter(_is_table, transforms):
            try:
                frames.append((convert.nanoseconds(one.header.stamp), convert.frame_record(one.transform)))
            except RosetteError as error:
                self.get_logger().error(f'{names.TF_STATIC}: not used: {error}')
        return frames

    def _on_state(self, message):
        self._is_busy = message.phase not in _NOTHING_ON
        if message.phase == RunState.PHASE_IDLE:
            self._gathering.end_all()
            return
        if message.phase in (RunState.PHASE_CANCELLED, RunState.PHASE_FAILED):
            self._gathering.forget(message.run_id)
            self._recalled.pop(message.run_id, None)
        elif message.phase == RunState.PHASE_EVALUATION:
            self._gathering.expect(message.run_id, message.done, self.seconds())
        else:
            self._gathering.note_state(message.run_id, self.seconds(),
                                       message.phase == RunState.PHASE_DONE)

    def wake(self):
        """Evaluate what has become complete; report what does not."""
        now = self.seconds()
        self._recorder.tick(now)
        self._evaluate_ready()
        self._recall(now)
        for run_id, lacks in self._gathering.late(self.seconds(), self.parameters['patience_s']):
            if run_id not in self._complained:
                self._complained.add(run_id)
                self._report_failure(run_id, lacks)

    def _recall(self, now):
        """Ask the recorder for what this node has not heard itself, again and again while it is lacking."""
        for run_id in self._gathering.lacking():
            asked = self._recalled.setdefault(run_id, now - RECALL_PERIOD + RECALL_AFTER)
            if now - asked >= RECALL_PERIOD and self._recorder.is_there:
                self._recalled[run_id] = now
                self._recorder.recall(run_id, RECALL_TIMEOUT, self._on_recalled)

    def _on_recalled(self, recalled):
        if not recalled.success:
            self.get_logger().warning(f'pieces of a run are missing and not recalled: {plain(recalled.message)}')
            return
        frames = self._frames_in(recalled.frames)
        self._gathering.recall(
            recalled.run_id, [convert.target_row(one) for one in recalled.targets],
            [convert.answer_row(one) for one in recalled.answers], frames, self.seconds())
        self.get_logger().info(plain(f'run {recalled.run_id}: recalled {len(recalled.answers)} answers from its log'))
        self._evaluate_ready()

    def _evaluate_ready(self):
        for run_id in self._gathering.ready(self.seconds(), self.parameters['quiet_s']):
            try:
                run = self._gathering.to_run(run_id)
                report = self._analyst.evaluate(run)
            except RosetteError as error:
                self._report_failure(run_id, str(error))
            else:
                self._publish(run, report)

    def _publish(self, run, report):
        """Make the results known: the error motions last, since they end the run and its log."""
        self._diagnose(run)
        self._results.tell(report)
        self._level, self._last = OK, plain(f'run {run.run_id} is evaluated, {run.size} ball centres')
        self.get_logger().info(self._last)

    def _diagnose(self, run):
        """Publish the diagnosis of a run that has just been evaluated, where that is wanted."""
        if not self.parameters['diagnose_after_run']:
            return
        if run.n > self.parameters['diagnose_most_balls']:
            self.get_logger().info(f'run {run.run_id} has {run.n} balls: it is diagnosed when '
                                   f'{names.DIAGNOSE} is called')
            return
        try:
            self.get_logger().info(self._questions.diagnose(run.run_id).verdict)
        except RosetteError as error:
            self.get_logger().warning(f'run {run.run_id} could not be diagnosed: {error}')

    def _report_failure(self, run_id, words):
        self._level, self._last = ERROR, plain(f'run {run_id} could not be evaluated: {words}')
        self.get_logger().error(self._last)

    def health(self):
        """Say what became of the last run."""
        return self._level, self._last, {'model': self._analyst.model}


def _is_table(transform):
    return (short_frame(transform.header.frame_id) == MACHINE_FRAME
            and short_frame(transform.child_frame_id) == TABLE_FRAME)


def main(args=None):
    """Run the evaluator; returns the exit code."""
    return run_node(names.EVALUATOR, Evaluator, args)


if __name__ == '__main__':
    sys.exit(main())
