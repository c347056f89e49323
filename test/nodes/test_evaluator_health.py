# SPDX-License-Identifier: Apache-2.0
"""What the evaluator says in /diagnostics of the runs that it has evaluated."""

import numpy as np
from builtin_interfaces.msg import Time
from rosette_msgs.msg import BallCentre, ProbeTarget, RunState

from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import answer_of, target_of
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.nodes import conversions
from rosette_ros.nodes.base_node import OK, WARN
from rosette_ros.nodes.evaluator import Evaluator
from rosette_ros.simulation import Machine, MachineConfig

N = 4


def messages(run_id, rounded):
    """Yield targets and answers of a run in the table frame; rounded: to 1 µm."""
    run = Machine(MachineConfig().changed(seed=1, plate={'balls': N})).run(plan(N, 'diagonal'))
    centre = np.round(run.centre, 6) if rounded else run.centre
    for row in range(run.size):
        common = {'run_id': run_id, 'seq': row + 1, 'table_position': int(run.table_position[row]),
                  'ball': int(run.ball[row]), 'approach': int(run.approach[row])}
        target = ProbeTarget(**common, attempt=1, session=1, phase=ProbeTarget.PHASE_RUN, balls=N, radius=run.radius,
                             table_angle=float(run.phi[row]))
        answer = BallCentre(**common, table_angle=float(run.table_angle[row]),
                            table_travel=float(run.table_travel[row]), temperature=20.0 + 0.1 * (row % 2))
        answer.centre.x, answer.centre.y, answer.centre.z = map(float, centre[row])
        for message in (target, answer):
            message.header.frame_id = 'table'
            message.header.stamp.sec = 1000 + 40 * row
        yield target, answer


def test_a_run_in_doubt_is_a_warning_and_the_next_sound_one_is_none(ros):
    """In either order, in one process."""
    with ros():
        node = Evaluator()
        for run_id, rounded in (('sound', False), ('doubtful', True), ('sound again', False), ('doubtful', True)):
            answers = RunAnswers(run_id)
            for target, answer in messages(run_id, rounded):
                answers.add_target(target_of(target))
                answers.add_answer(answer_of(answer))
            node._on_run(conversions.run_message(answers, [], Time()))
            node._on_state(RunState(run_id=run_id, phase=RunState.PHASE_EVALUATION, done=N * N))
            level, sentence, _ = node.health()
            assert level == (WARN if rounded else OK)
            assert sentence.startswith(f'run {run_id} is evaluated, 16 ball centres')
            assert ('; readings are rounded to 1 µm' in sentence) == rounded
        node.destroy_node()
