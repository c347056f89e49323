# SPDX-License-Identifier: Apache-2.0
"""A wrong reading is named by its place, time, axis and size wherever the verdict stands."""

import numpy as np
import pytest

from rosette_ros.core.diagnosis.diagnosis import diagnose, find, judge
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.verdict_words import unexplained_words, verdict_text

pytestmark = pytest.mark.long


def measured(n=8, order='random', hidden=(), shifts=None):
    """Return a run of the machine with shifts (row: vector, m) of single readings."""
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': n}, hidden=list(hidden))).run(plan(n, order, 1))
    centre = np.array(run.centre)
    for row, shift in (shifts or {}).items():
        centre[row] += shift
    return run.replace(centre=centre)


def test_the_verdict_names_wrong_readings():
    """One or two of 64 readings, 40 to 60 times the noise of 0.1 µm off, which is the most that the size may err by."""
    for wrong in ({23: (0.0, -5e-6, 0.0)}, {30: (4e-6, 0.0, 0.0), 50: (0.0, 0.0, 6e-6)}):
        run = measured(shifts=wrong)
        verdict = judge(run)
        assert verdict.outcome == Outcome.NAMED and verdict == diagnose(run).verdict
        told = {one.number: (one.axis, one.size) for one in verdict.outliers}
        for row, shift in wrong.items():
            axis = int(np.argmax(np.abs(shift)))
            assert told.pop(row + 1) == ('xyz'[axis], pytest.approx(shift[axis], abs=0.5e-6))
        assert not told
        assert 'measure the wrong readings again' in verdict_text(verdict).action


def test_two_of_one_size_are_named_however_large():
    """The first one of two takes half of what is left: two wrong readings, a ball that slips and a wrong reading, and
    two balls that slip are no noise of the balls."""
    told = {}
    for size in (3e-6, 1e-4):
        found = diagnose(measured(shifts={20: (size, 0, 0), 47: (0, -size, 0)}))
        are = {one.number for one in found.verdict.outliers} == {21, 48}
        told['readings', size] = (found.missing == ('outlier',) and are and found.final.rms < 2e-7 and max(
            one.visible_fraction for one in found.candidates) <= 1) or (found.missing, unexplained_words(found.verdict))
    for size in (1.0, 100.0):
        first = {'kind': 'ball_slip', 'ball': 3, 'shift_um': [size, 0.0, 0.0], 'at_h': 0.4}
        for second in ({'kind': 'outlier', 'shift_um': [0.0, size, 0.0], 'at_h': 0.6},
                       {'kind': 'ball_slip', 'ball': 7, 'shift_um': [0.0, size, 0.0], 'at_h': 0.5}):
            found = find(measured(10, 'sensitive', (first, second)))
            told[second['kind'], size] = (set(found.missing) == {'ball_slip', second['kind']}
                                          and found.final.rms < 2e-7) or (
                found.missing, unexplained_words(found.verdict))
    assert set(told.values()) == {True}, told


def test_many_wrong_readings_are_told_as_wrong():
    """More of them than effects are looked for: most are listed, and no other reading is."""
    found = diagnose(measured(10, shifts={row: 2e-5 * np.eye(3)[row % 3] for row in range(4, 100, 12)}))
    told = {one.number for one in (*found.verdict.outliers, *found.verdict.wrong)}
    assert len(told) >= 5 and told <= {row + 1 for row in range(4, 100, 12)}, told
    assert 'measure the wrong readings again' in verdict_text(found.verdict).action
    assert max(candidate.visible_fraction for candidate in found.candidates) <= 1


def test_a_repeatability_that_is_too_large_is_told():
    """100 µm in place of 0.1 µm, and twice as much as the readings show; not what chance may be."""
    run = measured()
    verdict = judge(run.replace(repeatability=1e-4))
    assert verdict.outcome == Outcome.FITS
    assert 'The stated repeatability is 10' in verdict_text(verdict).sentence
    assert 'measure the repeatability again, and check its unit' in verdict_text(verdict).action.lower()
    assert 'check its unit' in verdict_text(judge(run.replace(repeatability=2.5e-7))).action
    assert 'check its unit' not in verdict_text(judge(run.replace(repeatability=1.3e-7))).action


def test_a_wrong_reading_is_no_shift_that_goes_back_at_once():
    """Of two wrong readings, 4 and 2 µm off, none is a shift whose way back is shorter than three readings."""
    rng = np.random.default_rng(18)
    run = measured()
    centre = run.centre + rng.normal(0, 0.2e-6, run.centre.shape)
    for size in (4e-6, 2e-6):
        centre[rng.integers(5, 61), rng.integers(3)] += size
    kept = np.setdiff1d(np.arange(64), rng.choice(64, 3, replace=False))
    found = find(run.replace(centre=centre, repeatability=0.2e-6).take(kept))
    assert 'frame_recovery' not in found.missing


def test_a_shift_that_goes_back_has_three_readings():
    """At every setting that is tried, and as far as it is refined."""
    run = measured()
    recovery, time = EFFECTS['frame_recovery'], run.time - run.time[0]
    for setting in recovery.settings(run)[::7]:
        bracket, since = recovery.brackets(run, setting), time - setting['t0']
        for tau in (setting['tau'], bracket['tau'][0]):
            assert np.count_nonzero((since > 0) & (since <= tau + 1e-6)) >= 3
        for t0 in bracket['t0']:
            assert np.count_nonzero((time > t0) & (time <= t0 + setting['tau'] + 1e-6)) >= 3
