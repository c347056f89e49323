# SPDX-License-Identifier: Apache-2.0
"""Reduced runs over DDS: the goal chooses the places, the curves are true, what was not touched is not measured."""

import numpy as np
import pytest

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.core.errors import CellError
from rosette_ros.core.records import remove_gauge
from rosette_ros.io.log_reader import read_log
from rosette_ros.simulation import Machine, load_machine

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
    ({'cmm_positions': '3'}, '3 of 6 CMM positions or balls do not determine the curves; wanted at least 4'),
    ({'cmm_positions': 'most'}, 'wanted how many (6), a share (50 %) or which (1, 4, 6, 9)'),
    ({'balls_in_use': '1, 7, 2, 3'}, 'balls in use: wanted different ones of 1..6')])
def test_what_determines_nothing_is_refused_before_it_is_measured(client, goal, words):
    """The goal is refused in words."""
    with pytest.raises(CellError) as caught:
        client.calibrate(**goal)
    assert words in str(caught.value)
