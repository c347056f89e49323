# SPDX-License-Identifier: Apache-2.0
"""Runs whose table positions lie between the steps from angle 0: measured, written, read, joined."""

from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.core.joint.joint_evaluation import evaluate_jointly
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.errors import InvalidData, InvalidPlan
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.plan_file import MeasuringPlan, format_plan, parse_plan
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.io.run_to_log import write_log
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.joint_words import part_words
from rosette_ros.words.reading_words import notes_of

N = 7
STEP = 360 / N
FINE = {'fine_orders': (4, 5, 6), 'fine_share': 1.0}
ONE_NANOMETRE, TEN_NANORADIANS = 1e-9, 1e-8


def cell(seed=1, silent=True):
    """Return a small cell whose table errors have harmonics above n/2."""
    quiet = {'probing': {'repeatability_um': 0.0}} if silent else {}
    return Machine(MachineConfig().changed(seed=seed, plate={'balls': N}, table=FINE, **quiet))


@pytest.mark.parametrize('share', [0.25, 0.5])
def test_curves_between_the_steps(share):
    """The table stands there, the curves are the true ones at those angles, in axes turned by the offset."""
    machine, scheme = cell(), plan(N, 'sensitive').shifted(share * STEP)
    run, alignment, read = machine.calibrate(scheme)
    assert np.rad2deg(read.table_angle) % STEP == pytest.approx(share * STEP, abs=1e-9)
    motions = fit(run).error_motions
    assert np.rad2deg(motions.angle) == pytest.approx(STEP * (np.arange(N) + share))
    away = np.abs(motions.values - remove_gauge(machine.table_truth(motions.angle, alignment.frame)))
    assert away[:, :3].max() < ONE_NANOMETRE and away[:, 3:].max() < TEN_NANORADIANS


def test_half_pitches_know_harmonics_above_half_the_positions():
    """Two runs of a plate that stays clamped: errors in units of their uncertainty, over 2 machines: 0.8 to 1.2.

    The harmonic that is equal to the number of balls changes its sign from run to run, as a frame does: not known."""
    errors = []
    for seed in range(2):
        machine, runs = cell(seed, silent=False), []
        for offset in (0.0, STEP / 2):
            run, alignment, _ = machine.calibrate(plan(N, 'diagonal').shifted(offset), run_id=f'{offset:.0f}')
            runs.append((run, alignment.frame.turned(-np.deg2rad(offset))))
        result = evaluate_jointly([Readings.of(run, frame) for run, frame in runs])
        ((one, motions),) = result.curves
        assert result.solution.hidden_in_curves == 16
        truth = machine.table_truth(one.angle, runs[0][1])
        spectrum, true = np.fft.rfft(motions.values, axis=0), np.fft.rfft(truth, axis=0)
        for wave in (0, 1, N):
            spectrum[wave] = true[wave] = 0
        away = np.fft.irfft(spectrum - true, 2 * N, axis=0)
        errors.append(away / motions.u)
    assert f'harmonics up to {N} except {N}, at {2 * N} table angles' in part_words(result.knowledge.known)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2


def test_a_plan_file_says_where_position_1_is():
    """It is read as it was written."""
    made = MeasuringPlan(plan(N, 'row').shifted(12.5), 0.1825)
    again = parse_plan(format_plan(made).encode(), 'plan').scheme
    assert again.table_offset == made.scheme.table_offset and np.array_equal(again.ball, made.scheme.ball)


@pytest.mark.parametrize('degrees', [STEP, -1.0, np.nan])
def test_an_offset_is_less_than_a_step(degrees):
    """More of it is another position."""
    with pytest.raises(InvalidPlan, match='table offset: expected 0 to below 51.4286 deg, the step of 7 table '
                                          'positions'):
        plan(N).shifted(degrees)


def test_an_offset_that_the_angles_deny_is_refused():
    """A heading of 20 deg over angles that begin at 0; which is wrong is not known."""
    run, *_ = cell().calibrate(plan(N, 'diagonal'), run_id='whole')
    text = format_csv(run).replace('# balls:', '# table_offset_deg: 20\n# balls:')
    with pytest.raises(InvalidData, match=r'table_angle_deg: expected about 20, as "# table_offset_deg: 20" says, '
                                          r'found 0'):
        parse_csv(text.encode())


def test_tables_and_logs_keep_the_offset(tmp_path, library):
    """The same curves from a run, from its table, and from its log, which state physical angles and places."""
    run, alignment, read = cell().calibrate(plan(N, 'diagonal').shifted(20.0), run_id='half')
    text = format_csv(run)
    assert '# table_offset_deg: 20.0\n' in text
    assert '# table_offset_deg: 20.0\n' in format_csv(run.replace(table_offset=round(run.table_offset, 12)))
    table = parse_csv(text.encode())
    again = read_log(write_log(run, tmp_path / 'half', library)).to_run()
    wanted = fit(run).error_motions
    for other in (table, again):
        assert other.table_offset == pytest.approx(np.deg2rad(20), abs=1e-11)
        assert any('table position 1 is at 20 deg' in note for note in notes_of(other))
        assert np.abs(other.rotation - run.rotation).max() < 1e-12
        got = fit(other).error_motions
        assert np.abs(got.values - wanted.values).max() < 1e-12 and np.abs(got.angle - wanted.angle).max() < 1e-11
    first = text.splitlines()[-N * N].split(',')
    assert float(first[4]) == pytest.approx(20.0, abs=0.01)
    place = alignment.frame.turned(-np.deg2rad(20)).to_inner(read.centre)[0]
    assert [1e-3 * float(one) for one in first[5:8]] == pytest.approx(place.tolist(), abs=1e-12)


def test_targets_that_are_no_steps_of_one_table_are_refused():
    """In one line with the angles."""
    made = plan_calibration(plan(4, 'row').shifted(10.0), 0.1, Frame.identity())
    answers = RunAnswers('mixed')
    for index in range(made.alignments + 10, made.total - 1):
        target = made.target(index)._replace(run_id='mixed', stamp_ns=index)
        answers.add_target(target._replace(table_angle=target.table_angle + 0.1 * (index % 2)))
    with pytest.raises(InvalidData, match='table_angle: expected targets at steps of 360 deg / 4, found 1'):
        RunAssembly(answers, 'log')._table_offset(answers.targets)


def test_runs_are_turned_back_for_a_joint_evaluation():
    """Places, frame and angles of the readings are those of angle 0."""
    machine, scheme = cell(), plan(N, 'row').shifted(20.0)
    run, alignment, _ = machine.calibrate(scheme)
    made = Readings.of(run, alignment.frame.turned(-scheme.table_offset))
    assert np.rad2deg(made.angle) == pytest.approx(20 + STEP * np.arange(N))
    assert np.linalg.norm(made.centre - scheme.centres(machine.radius), axis=1).max() < 1e-3
    assert np.allclose(made.frame.rotation, made.rotation, atol=1e-12)
    assert replace(scheme, table_offset=0.0).table_angle[0] == 0
