# SPDX-License-Identifier: Apache-2.0
"""What was heard of a cell, from plain values: in whatever order it comes."""

import numpy as np
import pytest

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.scheme import plan
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.web.cell_state import CellState, Progress


def messages(n=4, run_id='a'):
    """Return rows of targets with expected centres, and rows of answers, of a run in the table frame."""
    run = Machine(MachineConfig().changed(plate={'balls': n})).run(plan(n, 'row'))
    targets, answers = [], []
    for k in range(run.size):
        place = {'run_id': run_id, 'seq': k + 1, 'table_position': int(run.table_position[k]),
                 'ball': int(run.ball[k]), 'stamp_ns': int(1e9 * run.time[k])}
        row = {**place, 'attempt': 1, 'session': 1, 'phase': 3, 'balls': n, 'radius': run.radius}
        targets.append((row, run.centre[k] + [3e-6, 0, 4e-6]))
        answers.append({**place, 'status': 0, 'frame_id': 'table', 'table_angle': run.table_angle[k],
                        'table_travel': run.table_travel[k], 'approach': 1, 'centre': tuple(run.centre[k]),
                        'form_error': 0.0, 'temperature': 20.0, 'text': ''})
    return run, targets, answers


@pytest.mark.parametrize('late', [0, 1, 5])
def test_a_run_grows_as_answers_come(late):
    """Answers may come before their targets."""
    run, targets, answers = messages()
    state = CellState()
    for k, answer in enumerate(answers):
        for target in targets[max(0, k - late):k - late + 1]:
            state.hear_target(*target)
        state.hear_answer(answer, '12:00:00')
    for target in targets[len(targets) - late:]:
        state.hear_target(*target)
    assert len(state.cells) == 16
    assert list(state.cells.values()) == pytest.approx([5e-6] * 16, rel=1e-3)
    assert np.array_equal(state.part_of_run().centre, run.centre)


def test_nothing_is_no_run():
    """And says so in words."""
    with pytest.raises(InvalidData):
        CellState().part_of_run()


def test_a_new_run_replaces_the_old_one():
    """Cells and curves of the old run go."""
    state = CellState()
    for run_id in ('a', 'b'):
        _, targets, answers = messages(run_id=run_id)
        for target, answer in zip(targets[:3], answers):
            state.hear_target(*target)
            state.hear_answer(answer, '')
        assert (state.run_id, len(state.cells), state.motions) == (run_id, 3, None)
        state.hear_motions(run_id, object())


def test_faults_are_told_in_words():
    """Failed readings, refusals, ends that are none; the newest first."""
    state = CellState()
    _, targets, answers = messages()
    state.hear_target(*targets[0])
    state.hear_answer({**answers[0], 'status': 1, 'text': 'no contact'}, '1')
    state.hear_rejection('busy', '2')
    state.hear_progress(Progress('a', 'FAILED', 'row', 1, 16, 'gave up'), '3')
    state.hear_progress(Progress('a', 'FAILED', 'row', 1, 16, 'gave up'), '4')
    assert list(state.faults) == [
        ('3', 'run a failed: gave up'), ('2', 'calibration refused: busy'),
        ('1', 'table position 1, ball 1 could not be measured: no contact')]
    assert not state.progress.is_running
    assert state.cells == {}


def test_a_node_that_says_nothing_is_silent():
    """After a while, whatever it said last."""
    state = CellState()
    state.hear_health('cmm', 0, 'fine', 10.0)
    state.hear_health('sequencer', 1, 'waits', 13.0)
    assert [(one.name, one.level) for one in state.health(12.0)] == [('cmm', 'healthy'), ('sequencer', 'warning')]
    assert [(one.name, one.level) for one in state.health(15.0)] == [('cmm', 'silent'), ('sequencer', 'warning')]
