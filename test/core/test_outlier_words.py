# SPDX-License-Identifier: Apache-2.0
"""A wrong reading is named by its place, time, axis and size wherever the verdict stands."""

import numpy as np
import pytest

from rosette_ros.analysis import diagnose, judge
from rosette_ros.core.diagnosis.diagnosis import find
from rosette_ros.core.diagnosis.verdict import Level, Outcome
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.verdict_words import verdict_text


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
    assert {one.number - 1 for one in verdict.outliers} == set(wrong)
    text = verdict_text(verdict)
    for row, shift in wrong.items():
        axis = int(np.argmax(np.abs(shift)))
        begin = (f'reading {row + 1}, table position {run.table_position[row]}, ball {run.ball[row]}, after '
                 f'{run.time[row] / 60:.1f} min, ')
        assert begin in text.sentence
        size, unit, along, name, *_ = text.sentence.split(begin)[1].replace(';', ' ').replace(')', ' ').split()
        assert (unit, along, name[0]) == ('µm', 'along', 'xyz'[axis])
        assert float(size.replace('−', '-')) == pytest.approx(1e6 * shift[axis], abs=0.5)
    assert 'measure the wrong readings again' in text.action


@pytest.mark.parametrize('size', [3e-6, 1e-4, 1e-3])
def test_two_of_one_size_are_named_however_large(size):
    """The first one of two takes half of what is left; the fall that both make is no less than that of many."""
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': 8})).run(plan(8, 'random', 1))
    centre = np.array(run.centre)
    centre[20, 0] += size
    centre[47, 1] -= size
    found = diagnose(run.replace(centre=centre))
    assert found.missing == ('outlier',)
    assert {one.number for one in found.verdict.outliers} == {21, 48}
    assert found.final.rms < 2 * run.repeatability
    assert max(candidate.visible_fraction for candidate in found.candidates) <= 1


@pytest.mark.parametrize('size_um', [1.0, 100.0])
def test_two_effects_of_one_size_are_named_however_large(size_um):
    """One ball that slips and one wrong reading, and two balls that slip, are no noise of the balls."""
    for second in ({'kind': 'outlier', 'shift_um': [0.0, size_um, 0.0], 'at_h': 0.6},
                   {'kind': 'ball_slip', 'ball': 7, 'shift_um': [0.0, size_um, 0.0], 'at_h': 0.5}):
        hidden = [{'kind': 'ball_slip', 'ball': 3, 'shift_um': [size_um, 0.0, 0.0], 'at_h': 0.4}, second]
        run = Machine(MachineConfig().changed(seed=3, plate={'balls': 10}, hidden=hidden)).run(plan(10, 'sensitive'))
        found = find(run)
        assert set(found.missing) == {one['kind'] for one in hidden}
        assert found.final.rms < 2 * run.repeatability


def test_many_wrong_readings_are_told_as_wrong():
    """More of them than effects are looked for: no noise is 200 times as large as the others."""
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': 10})).run(plan(10, 'random', 1))
    centre, rows = np.array(run.centre), range(4, 100, 12)
    for row in rows:
        centre[row, row % 3] += 2e-5
    found = diagnose(run.replace(centre=centre))
    assert (found.verdict.outcome, found.verdict.level) == (Outcome.SCATTERS, Level.DOUBTFUL)
    assert (len(found.verdict.wrong), found.verdict.more_wrong) == (4, 4)
    text = verdict_text(found.verdict)
    assert 'off by more than 30 times the scatter of the others: reading ' in text.sentence
    assert '; 4 more.' in text.sentence
    assert 'measure the wrong readings again' in text.action
    assert max(candidate.visible_fraction for candidate in found.candidates) <= 1


def test_a_repeatability_that_is_too_large_is_told():
    """100 µm in place of 0.1 µm, and twice as much as the readings show; not what chance may be."""
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': 8})).run(plan(8, 'random', 1))
    verdict = judge(run.replace(repeatability=1e-4))
    assert verdict.outcome == Outcome.FITS
    text = verdict_text(verdict)
    assert ' times the stated repeatability of 100 µm (p > 0.99)' in text.sentence
    assert 'The stated repeatability is 10' in text.sentence
    assert 'measure the repeatability again, and check its unit' in text.action.lower()
    assert judge(run.replace(repeatability=2.5e-7)).too_large > 2
    assert not judge(run.replace(repeatability=1.3e-7)).too_large


def test_a_wrong_reading_is_no_shift_that_goes_back_at_once():
    """Of two wrong readings, 4 and 2 µm off, none is a shift whose way back is shorter than three readings."""
    rng = np.random.default_rng(18)
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': 8})).run(plan(8, 'random', 1))
    centre = run.centre + rng.normal(0, 0.2e-6, run.centre.shape)
    for size in (4e-6, 2e-6):
        centre[rng.integers(5, 61), rng.integers(3)] += size
    kept = np.setdiff1d(np.arange(64), rng.choice(64, 3, replace=False))
    found = find(run.replace(centre=centre, repeatability=0.2e-6).take(kept))
    assert 'frame_recovery' not in found.missing


def test_a_shift_that_goes_back_has_three_readings():
    """At every setting that is tried, and as far as it is refined."""
    run = Machine(MachineConfig().changed(seed=3, plate={'balls': 8})).run(plan(8, 'random', 1))
    recovery, time = EFFECTS['frame_recovery'], run.time - run.time[0]
    for setting in recovery.settings(run)[::7]:
        bracket, since = recovery.brackets(run, setting), time - setting['t0']
        for tau in (setting['tau'], bracket['tau'][0]):
            assert np.count_nonzero((since > 0) & (since <= tau + 1e-6)) >= 3
        for t0 in bracket['t0']:
            assert np.count_nonzero((time > t0) & (time <= t0 + setting['tau'] + 1e-6)) >= 3
