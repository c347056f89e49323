# SPDX-License-Identifier: Apache-2.0
"""Where readings are missing, the way of table and CMM is told by what is recorded, and by nothing else."""

import itertools

import numpy as np
import pytest

from rosette_ros.core.diagnosis.diagnosis import diagnose, find
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan, travel_sense
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.simulation import MachineConfig
from rosette_ros.simulation.machine import Machine

REVERSAL = {'kind': 'cmm_reversal', 'value_um': (0.8, -0.6, 0)}
CAGE = {'kind': 'asynchronous_motion', 'order': 0.5, 'radial_um': 2.0}


def measured(order, n=8, seed=3, hidden=(), turning='forward'):
    """Return a run of the simulated machine."""
    return Machine(MachineConfig().changed(seed=seed, plate={'balls': n}, hidden=list(hidden))).run(
        plan(n, order, seed, turning))


def some(run, share=0.2, seed=1):
    """Return the rows that are left where a share is lost."""
    return np.sort(np.random.default_rng(seed).permutation(run.size)[round(share * run.size):])


def as_table(run, rows):
    """Return the run of a table of which only some rows are left."""
    lines = format_csv(run).strip().split('\n')
    head = len(lines) - run.size
    return parse_csv('\n'.join([*lines[:head], *(lines[head + row] for row in rows)]).encode())


def test_in_a_known_order_nothing_of_the_way_is_lost():
    """Travel and senses of what is left of a table are those of the complete run."""
    for order, turning in itertools.product(('row', 'diagonal', 'column', 'sensitive'), ('forward', 'alternate')):
        run = measured(order, turning=turning)
        rows = some(run)
        left = as_table(run, rows)
        assert left.unrecorded == ()
        assert np.array_equal(left.cmm_sense, run.cmm_sense[rows])
        assert np.ptp(left.table_travel - run.table_travel[rows]) < 1e-9


def test_a_run_that_was_parted_keeps_its_way_and_a_table_of_it_tells_it():
    """What the complete run knew is kept by its parts, and written where the rows would not tell."""
    run = measured('random')
    part = run.take(some(run))
    again = parse_csv(format_csv(part).encode())
    assert part.unrecorded == again.unrecorded == ()
    assert np.array_equal(again.cmm_sense, run.cmm_sense[some(run)])
    assert np.allclose(again.table_travel, part.table_travel)
    assert 'cmm_sense' not in format_csv(run)


def test_whole_balls_or_positions_that_are_left_out_are_no_gaps():
    """A reduced plan goes straight from ball to ball."""
    made = plan(12, 'diagonal', cmm_positions=(1, 2, 4, 6, 9, 10))
    run = Run(12, 0.1825, made.table_position, made.ball, made.centres(0.1825))
    assert run.unrecorded == ()
    assert np.array_equal(run.cmm_sense[:, 0], travel_sense(np.cos(run.alpha), 1e-6))


@pytest.mark.parametrize(('hidden', 'name'), [(REVERSAL, 'cmm_reversal'), (CAGE, 'asynchronous_motion')])
def test_what_is_not_recorded_is_not_judged_and_said(hidden, name):
    """Of a shuffled table with rows left out no name is made, where the whole record gives the right one."""
    run = measured('random', 6, hidden=[hidden])
    rows = some(run, 0.1)
    assert find(run.take(rows)).missing == (name,)
    lost = as_table(run, rows)
    assert lost.unrecorded == ('table_travel', 'cmm_sense')
    found = diagnose(lost)
    assert name not in found.missing
    words = {'cmm_reversal': 'from which side the CMM came to the others',
             'asynchronous_motion': 'how far the table turned meanwhile'}[name]
    assert dict(found.unavailable)[name] == f'readings are missing, and the run does not record {words}'
    with pytest.raises(NotDeterminable, match=f'{name} cannot be judged: readings are missing, and the run does not'):
        diagnose(lost, Model().with_effect(name))
    assert fit(lost).rank == 12 * 6 - 13
