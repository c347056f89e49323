# SPDX-License-Identifier: Apache-2.0
"""Between the steps of 360°/n in a live cell: runs at half pitches, and plates with a ball off the equal pitch."""

import numpy as np
import pytest
from rosette_msgs.srv import EvaluateJointly

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase
from rosette_ros.io.plan_file import MeasuringPlan, format_plan
from rosette_ros.simulation import Machine, load_machine
from rosette_ros.words.reading_words import notes_of

pytestmark = pytest.mark.long

N, HALF = 6, np.pi / 6
FINE = {'fine_orders': [4, 5], 'fine_share': 1.0, 'translation_um': 0.5, 'rotation_urad': 3.0}
"""A table whose errors have harmonics that six positions cannot tell from lower ones."""
MOVED = (0, 30, 60, 90, 130, *range(150, 360, 30))
PLATE = f'schema: rosette-plate/1\nazimuth_deg: {[*MOVED]}\nradius_mm: 182.5\n'
FINER = {'fine_orders': [11, 13, 17], 'fine_share': 1.0, 'translation_um': 0.5, 'rotation_urad': 3.0}


def without(waves, curves):
    """Return curves at equally spaced angles, (n, 6), without some harmonics."""
    spectrum = np.fft.rfft(curves, axis=0)
    spectrum[list(waves)] = 0
    return np.fft.irfft(spectrum, len(curves), axis=0)


def jointly(domain_id, make_peer, wait_until, *run_ids):
    """Return the evaluator's joint evaluation of runs."""
    peer = make_peer(domain_id)
    asked = peer.node.create_client(EvaluateJointly, 'evaluator/evaluate_jointly')
    peer.start()
    assert asked.wait_for_service(20.0)
    future = asked.call_async(EvaluateJointly.Request(run_ids=run_ids))
    wait_until(future.done)
    peer.stop()
    answer = future.result()
    assert answer.success, answer.message
    return answer.evaluation


def test_runs_at_half_pitches(domain_id, cell_of, make_peer, wait_until):
    """By the goal and by a plan file: measured there, true curves; with an ordinary run harmonics above n/2."""
    shifted = format_plan(MeasuringPlan(plan(N, 'row').shifted(30.0), 0.1825))
    with cell_of(N, silent=True, groups={'table': FINE}) as cell, CellClient(domain_id) as client:
        machine = Machine(load_machine(cell.machine))
        first, half, planned = (client.calibrate(**goal) for goal in (
            {'order': 'diagonal'}, {'order': 'diagonal', 'table_offset': HALF}, {'plan': shifted}))
        with pytest.raises(CellError, match=r'table offset: expected 0 to below 60 deg, the step of 6 table positions'):
            client.calibrate(table_offset=2 * HALF)
        found = jointly(domain_id, make_peer, wait_until, first.run_id, half.run_id)
    for outcome in (half, planned):
        log = read_log(outcome.log)
        run = log.to_run()
        asked = [target for target in log.targets if target.phase == Phase.RUN]
        assert {round(np.rad2deg(target.table_angle)) for target in asked} == set(range(30, 360, 60))
        assert run.table_offset == pytest.approx(HALF, abs=1e-12) and run.size == N * N
        assert any('table position 1 is at 30 deg' in note for note in notes_of(run))
        motions = analyse(run).error_motions
        assert np.array_equal(motions.values, outcome.error_motions.values)
        assert np.rad2deg(motions.angle) == pytest.approx(np.arange(30, 360, 60))
        # The run's own frame is turned by the offset.
        frame = log.frame_of(run.run_id).turned(HALF)
        away = np.abs(remove_gauge(motions.values) - remove_gauge(machine.table_truth(motions.angle, frame)))
        assert away[:, :3].max() < 1e-9 and away[:, 3:].max() < 1e-8
    (curves,) = found.curves
    assert np.rad2deg(curves.angle) == pytest.approx(np.arange(0, 360, 30))
    assert any('harmonics up to 6 except 6, at 12 table angles' in words for words in found.known)
    values = np.stack([getattr(curves, name) for name in ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')], axis=-1)
    frame = read_log(first.log).frame_of(first.run_id)
    truth = machine.table_truth(np.array(curves.angle), frame)
    away = np.abs(without((0, 1, 6), values) - without((0, 1, 6), truth))
    assert away[:, :3].max() < 1e-9 and away[:, 3:].max() < 1e-8
    fine = np.abs(np.fft.rfft(values, axis=0))[4:6] / 6
    assert fine.min() > 0.2e-6


def test_an_irregular_plate_shows_harmonics_above_half_its_balls(domain_id, cell_of, make_peer, wait_until):
    """36 table positions, 12 balls, one of them 10 degrees off, harmonics 11, 13 and 17; joined with a second run."""
    with cell_of(36, silent=True, groups={'table': FINER}) as cell, CellClient(domain_id) as client:
        machine = Machine(load_machine(cell.machine))
        runs = [client.calibrate(plate=PLATE, balls=36, order=order) for order in ('diagonal', 'column')]
        found = jointly(domain_id, make_peer, wait_until, *(one.run_id for one in runs))
    log = read_log(runs[0].log)
    run = log.to_run()
    assert run.size == 432 and run.balls == tuple(azimuth // 10 + 1 for azimuth in MOVED)
    truth = remove_gauge(machine.table_truth(frame=log.frame_of(run.run_id)))
    away = np.abs(runs[0].error_motions.values - truth)
    assert away[:, :3].max() < 1e-9 and away[:, 3:].max() < 1e-8
    amplitude = np.abs(np.fft.rfft(truth[:, 2]))[[11, 13, 17]] / 18
    assert amplitude == pytest.approx(0.5e-6, rel=0.01)
    (curves,) = found.curves
    assert len(curves.angle) == 36 and found.hidden_in_curves == 10
    assert np.abs(np.array(curves.ctz) - np.mean(curves.ctz) - truth[:, 2]).max() < 1e-9
