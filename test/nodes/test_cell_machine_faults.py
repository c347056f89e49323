# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated cell over DDS: no wrong curve without a flag, held against the truth."""

import numpy as np
import pytest
import yaml

from rosette_ros.analysis import analyse, diagnose
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import Cell
from rosette_ros.cli.hidden_demo import compare, write_machine
from rosette_ros.io.log_reader import read_log
from rosette_ros.simulation import MachineConfig

pytestmark = pytest.mark.long

N = 6
REPEATS = 4
FIRST = REPEATS + 2 * N
"""Targets before the run: repeatability check and alignment."""
CONFIG = MachineConfig().changed(seed=11, plate={'balls': N})
PARAMS = {'sequencer': {'plate.balls': N, 'repeats': REPEATS, 'limits.answer_timeout_s': 0.4,
                        'limits.attempts': 2,
                        'table.origin_m': [1e-3 * float(x) for x in CONFIG.placement.origin_mm]}}


@pytest.fixture(scope='module')
def faulty_cell(module_domain_id, tmp_path_factory):
    """Yield a function that runs a calibration of one cell with some faults and returns its Outcome."""
    folder = tmp_path_factory.mktemp('faults')
    machine = folder / 'machine.yaml'
    write_machine(CONFIG, machine)
    with Cell(module_domain_id, machine=machine, params=PARAMS, log_dir=folder / 'logs') as cell, \
            CellClient(module_domain_id) as client:
        def run(faults):
            write_machine(CONFIG.changed(faults=faults), machine)
            return cell, client.calibrate(check=cell.check)
        yield run


def off_the_truth(outcome, faults):
    """Return the rms of (curve - truth) / u of a log, its Run and its Fit."""
    log = read_log(outcome.log)
    run = log.to_run()
    fit = analyse(run)
    return compare(fit, CONFIG.changed(faults=faults), log.frame_of(run.run_id)).rms, run, fit


ASKED_AGAIN = {
    'silent': ('no answer within 0.4 s', {}), 'wrong_seq': ('not used: answer to seq', {}),
    'wrong_run': ("not used: answer to run 'another_run'", {}),
    'not_a_number': ('expected finite numbers', {}), 'infinite': ('expected finite numbers', {}),
    'failed': ('the CMM reports: the stylus did not trigger', {}),
    'wrong_ball': ('expected table position, ball, CMM position', {}),
    'neighbour': (' mm of the target', {}),
    'late': ('no answer within 0.4 s', {'late_s': 0.6}),
    'twice': ('not used: answer to seq', {}), 'again': ('not used: answer to seq', {}),
    'clock_back': ('', {}), 'table_short': ('', {'short_urad': 400.0})}


@pytest.mark.parametrize('kind', ASKED_AGAIN)
def test_the_curves_are_true_whatever_goes_wrong(faulty_cell, kind):
    """The ball is asked for again, or the fault does no harm; every ball counts once."""
    words, settings = ASKED_AGAIN[kind]
    faults = [{'kind': kind, 'at': [FIRST + 5, FIRST + 20], **settings}]
    cell, outcome = faulty_cell(faults)
    assert outcome.success, outcome.message
    assert words in cell.processes['sequencer'].text()
    rms, run, fit = off_the_truth(outcome, faults)
    assert run.size == N * N
    assert rms < 1.8, 'the six curves are true within their uncertainties (36 numbers)'
    assert np.array_equal(fit.error_motions.values, outcome.error_motions.values)
    if kind == 'table_short':
        assert np.abs(run.angle_deviation).max() == pytest.approx(400e-6, rel=1e-3)


def test_a_ball_that_fails_for_good_is_left_out_and_told(faulty_cell):
    """Two balls of the run never answer well: it goes on without them, says so, and is true."""
    faults = [{'kind': 'failed', 'at': [FIRST + 9, FIRST + 30], 'always': True}]
    cell, outcome = faulty_cell(faults)
    assert outcome.success, outcome.message
    assert '2 left out: table position ' in outcome.message
    assert 'the stylus did not trigger; left out, 2 of at most 3' in cell.processes['sequencer'].text()
    rms, run, _ = off_the_truth(outcome, faults)
    assert run.size == N * N - 2
    assert rms < 1.8


def test_a_cell_in_which_nothing_works_ends_in_words(faulty_cell):
    """Every answer fails: the run ends at its first target, the log is kept."""
    _, outcome = faulty_cell([{'kind': 'failed', 'share': 1.0}])
    assert not outcome.success
    assert 'asked 2 times, last: the CMM reports: the stylus did not trigger' in outcome.message
    assert len(read_log(outcome.log).answers) == 2


def test_an_outlier_is_kept_and_shown(faulty_cell):
    """50 um off in one ball centre: nothing is dropped; the diagnosis names the reading."""
    faults = [{'kind': 'outlier', 'at': [FIRST + 12], 'size_um': 50.0}]
    _, outcome = faulty_cell(faults)
    assert outcome.success
    rms, run, fit = off_the_truth(outcome, faults)
    assert run.size == N * N
    assert fit.lack_of_fit_p < 1e-6
    assert rms < 2.5, 'the uncertainties have grown with the residual'
    found = diagnose(run)
    assert found.missing == ('outlier',)
    assert found.candidates[0].setting['reading'] == 12
    with_it = found.final
    assert np.abs(with_it.residual).max() < 1e-6


def test_all_faults_together_in_a_share_of_the_answers(faulty_cell, tmp_path):
    """A bad day: what comes out is true, or is refused in words, and the log is whole."""
    faults = [{'kind': kind, 'share': 0.02} for kind in (
        'silent', 'late', 'twice', 'again', 'wrong_seq', 'wrong_run', 'not_a_number', 'infinite',
        'failed', 'wrong_ball')]
    _, outcome = faulty_cell(faults)
    log = read_log(outcome.log)
    assert log.problems == ()
    if not outcome.success:
        assert 'asked 2 times' in outcome.message
        return
    rms, run, _ = off_the_truth(outcome, faults)
    assert rms < 1.8
    assert run.size >= N * N - 3
    assert yaml.safe_load((outcome.log / 'metadata.yaml').read_text())


def test_a_cmm_that_crashes_in_the_middle_is_waited_for(faulty_cell, module_domain_id):
    """It dies after an answer and before one, is started again, and goes on: pauses are marked, curves are true."""
    faults = [{'kind': 'silent', 'at': [FIRST + 21]}, {'kind': 'crash', 'at': [FIRST + 9, FIRST + 21]}]
    cell, _ = faulty_cell([])
    write_machine(CONFIG.changed(faults=faults), cell.machine)
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(check=cell.restart_failed)
    assert outcome.success, outcome.message
    output = cell.processes['cmm'].output.read_text(errors='replace')
    assert output.count('the CMM crashes, as its configuration wants it') == 2
    assert 'the run continues in session 3' in cell.processes['sequencer'].text()
    rms, run, _ = off_the_truth(outcome, faults)
    assert run.size == N * N
    assert len(run.pauses) == 2
    assert rms < 1.8


def test_a_machine_file_that_was_spoilt_is_told_in_words(faulty_cell, module_domain_id):
    """The file is read again for every run; what is wrong with it is the reason of every failure."""
    cell, outcome = faulty_cell([{'kind': 'failed', 'share': 1.0}])
    path = cell.machine
    path.write_text('plate: {balls: many}\n')
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(check=cell.check)
    assert not outcome.success
    assert 'balls' in outcome.message
    assert "'many'" in outcome.message
