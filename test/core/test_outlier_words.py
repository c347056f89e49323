# SPDX-License-Identifier: Apache-2.0
"""A wrong reading is named by its place, time, axis and size wherever the verdict stands."""

import numpy as np
import pytest

from rosette_ros.analysis import diagnose, judge
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig


@pytest.mark.parametrize('wrong', [{23: (0.0, -5e-6, 0.0)}, {30: (4e-6, 0.0, 0.0), 50: (0.0, 0.0, 6e-6)}])
def test_the_verdict_names_wrong_readings(wrong):
    """One or two of 64 readings, 40 to 60 times the noise of 0.1 µm off, which is the most that the size may err by."""
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': 8})).run(plan(8, 'random', 1))
    centre = np.array(run.centre)
    for row, shift in wrong.items():
        centre[row] += shift
    run = run.replace(centre=centre)
    verdict = judge(run)
    assert verdict.outcome == Outcome.NAMED
    assert verdict == diagnose(run).verdict
    for row, shift in wrong.items():
        axis = int(np.argmax(np.abs(shift)))
        begin = (f'reading {row + 1}, table position {run.table_position[row]}, ball {run.ball[row]}, after '
                 f'{run.time[row] / 60:.1f} min, ')
        assert begin in verdict.sentence
        size, unit, along, name, *_ = verdict.sentence.split(begin)[1].split()
        assert (unit, along, name[0]) == ('µm', 'along', 'xyz'[axis])
        assert float(size.replace('−', '-')) == pytest.approx(1e6 * shift[axis], abs=0.5)
    assert 'measure the wrong readings again' in verdict.action
