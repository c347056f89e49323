# SPDX-License-Identifier: Apache-2.0
"""What is received of a cell, from plain values: in whatever order it arrives."""

from types import SimpleNamespace

import numpy as np
import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import Answer, CalibrationProgress, Phase, Target
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.live_state import CellState, CellView, Fault, Health, ReadingPlace


def messages(n=4, run_id='a'):
    """Return the run, its targets and its answers, in the table frame; all are 5 µm from the expected centre."""
    run = Machine(MachineConfig().changed(plate={'balls': n})).run(plan(n, 'row'))
    targets, answers = [], []
    for k in range(run.size):
        place = {'run_id': run_id, 'seq': k + 1, 'table_position': int(run.table_position[k]), 'ball': int(run.ball[k]),
                 'cmm_position': int(run.cmm_position[k]), 'table_angle': float(run.table_angle[k]), 'approach': 1,
                 'frame_id': 'table', 'stamp_ns': int(1e9 * run.time[k])}
        targets.append(Target(**place, attempt=1, session=1, phase=Phase.RUN, balls=n, radius=run.radius,
                              centre=tuple(run.centre[k] + [3e-6, 0, 4e-6])))
        answers.append(Answer(**place, status=0, text='', table_travel=float(run.table_travel[k]),
                              centre=tuple(run.centre[k]), form_error=0.0, temperature=20.0))
    return run, targets, answers


@pytest.mark.parametrize('late', [0, 1, 5])
def test_a_run_grows_with_its_answers(late):
    """Answers may be received before their targets."""
    run, targets, answers = messages()
    state = CellState()
    for k, answer in enumerate(answers):
        for target in targets[max(0, k - late):k - late + 1]:
            state.add_target(target)
        state.add_answer(answer)
    for target in targets[len(targets) - late:]:
        state.add_target(target)
    assert (state.run_id, state.balls, len(state.cells)) == ('a', 4, 16)
    # all 5 µm are how plate and table lie: 4 µm its height, 3 µm the place of the axis
    assert list(state.cells.values()) == pytest.approx([0.0] * 16, abs=1e-9)
    assert np.array_equal(state.part_of_run().centre, run.centre)


def test_the_plan_view_fills():
    """The current target is waited for until its answer counts; an answer without a ball centre is a failure."""
    _, targets, answers = messages()
    state = CellState()
    assert state.view() == CellView(0, None, False, frozenset(), frozenset())
    for target, answer in zip(targets[:3], (answers[0], answers[1]._replace(status=1))):
        state.add_target(target)
        assert state.view().is_waiting
        state.add_answer(answer)
    view = state.view()
    assert (view.balls, view.target, view.is_waiting) == (4, targets[1], True)
    assert view.done == {ReadingPlace(1, 1, 1)} and view.failed == {ReadingPlace(1, 2, 2)}
    state.add_answer(answers[1])
    both = frozenset({ReadingPlace(1, 1, 1), ReadingPlace(1, 2, 2)})
    assert state.view() == CellView(4, targets[1], False, both, frozenset())


def test_nothing_received_is_no_run():
    """Neither before the first target nor before the first answer."""
    state = CellState()
    with pytest.raises(InvalidData, match='expected probe targets of phase RUN, found none'):
        state.part_of_run()
    state.add_target(messages()[1][0])
    with pytest.raises(InvalidData, match="expected ball centres of run 'a', found none that counts"):
        state.part_of_run()
    assert (state.balls, state.cells) == (4, {})


def test_a_new_run_replaces_the_old_one():
    """Its first target does; late answers of the old one change nothing that is shown."""
    state = CellState()
    for run_id in 'abcde':
        _, targets, answers = messages(run_id=run_id)
        for target, answer in zip(targets[:3], answers):
            state.add_target(target)
            state.add_answer(answer)
        assert (state.run_id, len(state.cells), state.motions, state.verdict) == (run_id, 3, None, None)
        state.set_motions(SimpleNamespace(run_id=run_id))
        state.set_verdict(run_id, object())
        state.set_motions(SimpleNamespace(run_id='another'))
        assert state.motions.run_id == run_id
    state.add_answer(messages(run_id='d')[2][3])
    assert (state.run_id, len(state.cells)) == ('e', 3)


def test_a_plate_of_too_many_balls_is_not_drawn():
    """Whatever number a target contains."""
    state = CellState()
    state.add_target(messages()[1][0]._replace(balls=10_000))
    assert (state.balls, state.cells) == (0, {})


def test_warnings_and_faults_are_listed():
    """The newest first; how a run ends is its state, and a ball without reading is told by the sequencer."""
    state = CellState()
    _, targets, answers = messages()
    state.add_target(targets[0])
    state.add_answer(answers[0]._replace(status=1, text='no contact'))
    state.add_fault('1', 'sequencer: no contact; asking again', Health.WARNING)
    state.add_fault('2', 'recorder: the disk is full')
    state.progress = CalibrationProgress('a', Phase.CANCELLED, 'row', 1, 16, 'by the user')
    assert list(state.faults) == [Fault('2', 'recorder: the disk is full', Health.FAULT),
                                  Fault('1', 'sequencer: no contact; asking again', Health.WARNING)]
    assert state.cells == {}


@pytest.mark.parametrize(('phase', 'running'), [
    (Phase.IDLE, False), (Phase.REPEATABILITY, True), (Phase.EVALUATION, True), (Phase.DONE, False),
    (Phase.CANCELLED, False), (77, False)])
def test_a_calibration_is_running_between_idle_and_its_end(phase, running):
    """A phase that does not exist is none."""
    assert CalibrationProgress('a', phase).is_running is running


def test_a_node_that_reports_nothing_is_silent():
    """After a while, whatever it reported last."""
    state = CellState()
    state.set_health('cmm', 0, 'fine', 10.0)
    state.set_health('sequencer', 1, 'waits', 13.0)
    assert [(one.name, one.level) for one in state.health(12.0)] == [('cmm', 'healthy'), ('sequencer', 'warning')]
    assert [(one.name, one.level) for one in state.health(15.0)] == [('cmm', 'silent'), ('sequencer', 'warning')]
    assert state.health(15.0)[0].sentence == 'nothing received for 5 s'
