# SPDX-License-Identifier: Apache-2.0
"""What the evaluator says in /diagnostics of the runs that it has evaluated."""

import numpy as np
from rosette_msgs.msg import BallCentre, ProbeTarget, RunState

from rosette_ros.core.scheme import plan
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
                            table_travel=float(run.table_travel[row]), temperature=20.0)
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
            for target, answer in messages(run_id, rounded):
                node._on_target(target)
                node._on_answer(answer)
            node._on_state(RunState(run_id=run_id, phase=RunState.PHASE_EVALUATION, done=N * N))
            level, sentence, _ = node.health()
            assert level == (WARN if rounded else OK)
            assert sentence.startswith(f'run {run_id} is evaluated, 16 ball centres')
            assert ('; readings are rounded to 1 µm' in sentence) == rounded
        node.destroy_node()


def test_a_resumed_run_that_lacks_answers_again_is_told_again(ros, monkeypatch):
    """Until it failed it is told once; the same run, resumed, is another matter."""
    with ros('-p', 'patience_s:=10.0'):
        node, now, told = Evaluator(), [0.0], []
        monkeypatch.setattr(node, 'seconds', lambda: now[0])
        monkeypatch.setattr(node, '_report_failure', lambda run_id, lacks: told.append((now[0], run_id)))
        for start in (0.0, 100.0):
            now[0] = start
            node._on_state(RunState(run_id='a', phase=RunState.PHASE_EVALUATION, done=5))
            for late in (20.0, 30.0):
                now[0] = start + late
                node.wake()
            node._on_state(RunState(run_id='a', phase=RunState.PHASE_FAILED))
        assert told == [(20.0, 'a'), (120.0, 'a')]
        node.destroy_node()
