# SPDX-License-Identifier: Apache-2.0
"""Errors of the curves in units of their stated uncertainty, over 20 simulated machines: 0.8 to 1.2 for every plan.

Runs both ways and plates turned by whole pitches are in test_joint_evaluation.py, plates off the steps of the table in
test/io/test_plate_tables.py.
"""

import numpy as np
import pytest

from rosette_ros.core.joint.joint_evaluation import evaluate_jointly
from rosette_ros.core.joint.readings import Plate, Readings
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.joint_words import part_words

SEEDS = 20
FINE = {'fine_orders': (4, 5), 'fine_share': 0.5}
PLANS = {
    'CMM positions': (9, {'order': 'diagonal', 'cmm_positions': (1, 2, 4, 7, 9)}),
    'balls': (9, {'order': 'random', 'balls': (1, 3, 4, 7, 8)}),
    'there and back': (8, {'order': 'there_and_back'}),
    'rows there and back': (7, {'order': 'row_there_and_back'}),
    'irregular plate': (18, {'order': 'diagonal', 'balls': (1, 4, 6, 9, 11, 16)})}


def machine(seed, n, **groups):
    """Return a small cell."""
    return Machine(MachineConfig().changed(seed=seed, plate={'balls': n}, table=FINE, **groups))


def size(errors):
    """Return the root mean square of normalised errors."""
    return np.sqrt(np.mean(np.square(errors)))


@pytest.mark.parametrize('name', PLANS)
def test_reduced_plans(name):
    """Fitted with white noise, as it is."""
    n, words = PLANS[name]
    scheme, errors = plan(n, **words), []
    for seed in range(SEEDS):
        cell = machine(seed, n)
        run, alignment, _ = cell.calibrate(scheme)
        motions = fit(run, Model()).error_motions
        errors.append((motions.values - remove_gauge(cell.table_truth(frame=alignment.frame))) / motions.u)
    assert 0.8 < size(errors) < 1.2


def measured(cell, positions, places, run_id):
    """Return readings of six balls at places of twelve, at six table positions of twelve, in any clamping."""
    frame = cell.align().frame
    i, j = (one.ravel() for one in np.meshgrid(positions, places, indexing='ij'))
    azimuth = 2 * np.pi / 12 * (i + j)
    aim = frame.to_outer(cell.radius * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1))
    centre = frame.to_inner(cell.measure_many(i + 1, j + 1, np.ones(i.size), aim).centre)
    plate = Plate(np.arange(6) * np.pi / 3, np.full(6, cell.radius), np.zeros(6))
    return Readings(plate, 2 * np.pi / 12 * np.asarray(positions), np.repeat(np.arange(6), 6) + 1,
                    np.tile(np.arange(6), 6) + 1, centre, np.zeros(36), np.ones(36), frame=frame, run_id=run_id)


def test_half_pitches():
    """Table positions and clampings at half pitches, four runs of 6 machines: all 12 positions, harmonics up to 6."""
    errors = []
    even, odd = np.arange(0, 12, 2), np.arange(1, 12, 2)
    for seed in range(6):
        first, turned = machine(seed, 12), machine(seed, 12, clamping={'plate_turn_deg': 30.0})
        turned.align()  # else its noise is that of the first
        runs = [measured(cell, positions, places, f'{number}') for number, (cell, places, positions) in enumerate(
            (cell, places, positions) for cell, places in ((first, even), (turned, odd)) for positions in (even, odd))]
        result = evaluate_jointly(runs, {'turn': (0.0, 0.0, np.pi / 6, np.pi / 6), 'clamping': ('a', 'a', 'b', 'b')})
        ((one, motions),) = result.curves
        truth = remove_gauge(first.table_truth(one.angle, runs[0].frame), one.angle)
        errors.append((motions.values - truth) / motions.u)
        assert result.solution.hidden_in_curves == 10
    assert 'harmonics up to 6, at 12 table angles' in part_words(result.knowledge.known)
    assert 0.8 < size(errors) < 1.2
