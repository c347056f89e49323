# SPDX-License-Identifier: Apache-2.0
"""Reduced runs over DDS: the goal chooses the places, the curves are true, what was not touched is not measured."""

from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.reduced_sets import relative_uncertainty
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase
from rosette_ros.io.plan_file import MeasuringPlan, format_plan
from rosette_ros.simulation import Machine, load_machine

pytestmark = pytest.mark.long

N = 6


@pytest.fixture(scope='module')
def client(module_domain_id, tmp_path_factory, make_cell):
    """Yield the client of a cell with a machine without noise."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, silent=True) as cell, \
            CellClient(module_domain_id) as client:
        client.machine = Machine(load_machine(cell.machine))
        yield client


@pytest.mark.parametrize('goal, readings, balls, positions', [
    ({'order': 'there_and_back'}, 48, N, 4), ({'order': 'row', 'cmm_positions': '5'}, 30, N, 5),
    ({'order': 'interleaved', 'cmm_positions': 'fewest'}, 24, N, 4),
    ({'order': 'random', 'balls_in_use': '1, 2, 3, 5'}, 24, 4, N),
    ({'order': 'column', 'cmm_positions': '67 %'}, 24, N, 4)])
def test_curves_of_a_reduced_run(client, goal, readings, balls, positions):
    """The nodes give the true curves within a nanometre and 10 nrad, in the log as in the result."""
    outcome = client.calibrate(**goal)
    log = read_log(outcome.log)
    run = log.to_run()
    assert (run.size, np.unique(run.ball).size, np.unique(run.cmm_position).size) == (readings, balls, positions)
    fit = analyse(run)
    assert np.array_equal(fit.error_motions.values, outcome.error_motions.values)
    truth = remove_gauge(client.machine.table_truth())
    assert np.abs(outcome.error_motions.values - truth)[:, :3].max() < 1e-9
    assert np.abs(outcome.error_motions.values - truth)[:, 3:].max() < 1e-8
    assert np.count_nonzero(np.isnan(fit.plate[:, 0])) == N - balls
    assert np.count_nonzero(np.isnan(fit.cmm[:, 0])) == N - positions


@pytest.mark.parametrize('goal, words', [
    ({'cmm_positions': '3'}, '3 of 6 CMM positions or balls do not determine the curves; expected at least 4'),
    ({'cmm_positions': 'most'}, 'expected how many (6), a share (50 %), fewest or which (1, 5, 7, 10)'),
    ({'balls_in_use': '1, 7, 2, 3'}, 'balls in use: expected different ones of 1..6')])
def test_what_determines_nothing_is_refused_before_it_is_measured(client, goal, words):
    """The goal is refused in words."""
    with pytest.raises(CellError) as caught:
        client.calibrate(**goal)
    assert words in str(caught.value)


def test_a_plan_file_with_a_pause(client):
    """Readings that no order has, touches and a pause: asked as planned, resumed from the log alone, true curves."""
    scheme = replace(plan(N, 'random', 4), order='mine', touches=np.where(np.arange(N * N) % 5, 20, 8),
                     session=1 + np.arange(N * N) // 20)
    part = replace(scheme, **{name: getattr(scheme, name)[:33] for name in (
        'table_position', 'ball', 'approach', 'touches', 'session', 'wait')})
    first = client.calibrate(plan=format_plan(MeasuringPlan(part, 0.1825)))
    assert first.paused and not (first.success or first.cancelled) and first.run_id.endswith('_mine')
    second = client.calibrate(resume=str(first.log))
    assert second.success and not second.paused
    log = read_log(second.log)
    run = log.to_run()
    assert np.array_equal(run.ball, part.ball) and np.array_equal(run.session, part.session)
    asked = {target.seq: target.touches for target in log.targets if target.phase == Phase.RUN}
    assert list(asked.values()) == part.touches.tolist()
    away = np.abs(second.error_motions.values - remove_gauge(client.machine.table_truth()))
    assert away[:, :3].max() < 1e-9 and away[:, 3:].max() < 1e-8


def test_plans_that_contradict_themselves_are_refused(client):
    """In one line, before anything is measured."""
    with pytest.raises(CellError, match='plan: does not determine the curves: expected at least 3 different balls '):
        client.calibrate(plan='# schema: rosette-plan/1\n# balls: 6\n# radius_mm: 182.5\ntable_position,ball\n1,1\n')
    with pytest.raises(CellError, match='goal: plan: expected the lines of a file, found .no_such_plan.csv'):
        client.calibrate(plan='no_such_plan.csv')


PLATE = 'schema: rosette-plate/1\nazimuth_deg: [0, 60, 120, 240]\nradius_mm: 182.5\n'


def test_a_plate_of_another_pitch(client):
    """Four balls on steps of six table positions: only they are asked for, in the alignment too; true curves."""
    outcome = client.calibrate(plate=PLATE, balls=N)
    log = read_log(outcome.log)
    assert {target.ball for target in log.targets} == {1, 2, 3, 5}
    assert sum(target.phase == Phase.ALIGNMENT for target in log.targets) == N + 4
    assert log.to_run().size == 4 * N
    assert any('rosette-plate/1' in event.settings for event in log.events)
    away = np.abs(outcome.error_motions.values - remove_gauge(client.machine.table_truth()))
    assert away[:, :3].max() < 1e-9 and away[:, 3:].max() < 1e-8
    with pytest.raises(CellError, match='ball 2: expected it within 1 mm of a multiple of 60 deg, the step of 6 table'):
        client.calibrate(plate=PLATE.replace('60', '50'), balls=N)


def test_penalties_of_good_sets(domain_id, cell_of):
    """12 balls at 8, 6 and 4 CMM positions: uncertainty of the curves relative to a complete run, within 1 %."""
    with cell_of(12), CellClient(domain_id) as client:
        for places, wanted in (('1, 2, 4, 5, 7, 8, 10, 11', 1.26), ('1, 2, 4, 6, 9, 10', 1.52), ('1, 5, 7, 10', 2.27)):
            outcome = client.calibrate(order='diagonal', cmm_positions=places)
            fit = analyse(read_log(outcome.log).to_run())
            variance = (outcome.error_motions.u / fit.sigma)**2
            assert relative_uncertainty(variance, fit.mean_radius) == pytest.approx(wanted, rel=0.01)
