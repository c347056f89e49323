# SPDX-License-Identifier: Apache-2.0
"""An evaluator that is slow, or never says which readings follow: asked once, waited for, seen to hang, restarted."""

import pytest
from slow_evaluator import SECONDS_EACH

from rosette_ros.cell.client import CellClient, HangDetector
from rosette_ros.io.log_reader import read_log
from rosette_ros.nodes import names

pytestmark = pytest.mark.long

N = 4
GOAL = {'until_probability': 0.95, 'until_uncertainty': 1e-9, 'most_readings': 2}
OPTIONS = 'limits.evaluation_timeout_s: 5.0\nlimits.attempts: {}'


def slow_cell(cell_of, monkeypatch, seconds, **evaluator):
    """Return a Cell whose evaluator takes so long for each block, and has these parameters."""
    monkeypatch.setenv(SECONDS_EACH, str(seconds))
    cell = cell_of(N, params={'evaluator': evaluator})
    cell._modules[names.EVALUATOR] = 'slow_evaluator'
    return cell


def test_a_late_answer_counts(cell_of, domain_id, monkeypatch):
    """It was thrown away after the time of an evaluation, and asked again."""
    with slow_cell(cell_of, monkeypatch, 6.0) as cell, CellClient(domain_id) as client:
        outcome = client.calibrate(check=cell.check, options=OPTIONS.format(20), **GOAL)
        asked = cell.processes[names.EVALUATOR].text().count('asked for the next readings')
    assert outcome.success, outcome.message
    assert 'did not answer' not in outcome.message
    assert asked == outcome.message.count('settled') + (read_log(outcome.log).to_run().size - N * N) // 2


def test_an_evaluator_that_never_answers_is_seen_by_its_work(cell_of, domain_id, monkeypatch, wait_until):
    """Its process lives, and a thread of it said so for ever: the run ends with the results that were published, no
    other one begins, and the supervisor restarts it."""
    with slow_cell(cell_of, monkeypatch, 1e5, longest_work_s=15.0) as cell, HangDetector(cell) as detector, \
            CellClient(domain_id) as client:
        wait_until(lambda: all(monitor.process for monitor in detector._monitors))
        outcome = client.calibrate(check=cell.check, options=OPTIONS.format(2), **GOAL)
        assert outcome.success and outcome.message == (
            'error motions are published; without the drift check, not settled: the evaluator did not answer within '
            '10 s (limits.attempts times limits.evaluation_timeout_s)')
        assert outcome.error_motions is not None and read_log(outcome.log).to_run().size == N * N
        sequencer = cell.processes[names.SEQUENCER]
        wait_until(lambda: 'no evaluator' in sequencer.text())
        restarted = {}
        wait_until(lambda: restarted.update(cell.restart_failed(detector.hanging())) or restarted)
        assert list(restarted) == [names.EVALUATOR] and 'published no status for 20 s' in restarted[names.EVALUATOR]
        said = len(sequencer.text())
        wait_until(lambda: names.COMPLETE in sequencer.text()[said:])
        assert client.calibrate(check=cell.check).success
