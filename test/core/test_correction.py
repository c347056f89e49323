# SPDX-License-Identifier: Apache-2.0
"""Corrections: between the measured angles, taken off by the simulated machine, and whether that is noticed."""

from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import TWO_PI, rotate_z, rotation_matrix
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.table.correction import Correction
from rosette_ros.core.table.correction_check import Effectiveness, check_correction
from rosette_ros.io.correction_file import format_correction
from rosette_ros.simulation import Machine, MachineConfig

N = 12
LARGE = {'translation_um': 1.0, 'rotation_urad': 8.0, 'harmonics': 4}


def measured(seed=1, noise=0.1, table=(), **changed):
    """Return the Machine and the error motions of a run of it."""
    machine = Machine(MachineConfig().changed(seed=seed, plate={'balls': N}, probing={'repeatability_um': noise},
                                              table={**LARGE, **dict(table)}, **changed))
    return machine, fit(machine.run(plan(N, 'diagonal'))).error_motions


def corrected(tmp_path, correction, **settings):
    """Return the error motions of the machine that takes a correction off."""
    path = tmp_path / 'correction.yaml'
    path.write_text(format_correction(correction))
    return measured(table={'correction_file': str(path)}, **settings)[1]


@pytest.fixture(scope='module')
def before():
    """Return the error motions of a table before its correction."""
    return measured()[1]


@pytest.mark.parametrize('count', [9, 12])
def test_the_curves_are_met_and_known_between(count):
    """At the angles measured exactly; between them too for errors of harmonics below n/2."""
    rng = np.random.default_rng(count)
    orders = np.arange(1, (count + 1) // 2)
    cosine, sine = 1e-6 * rng.standard_normal((2, orders.size, 6))

    def truth(angle):
        phase = np.multiply.outer(angle, orders)
        return np.cos(phase) @ cosine + np.sin(phase) @ sine

    angle = TWO_PI * np.arange(count) / count + 1e-5 * rng.standard_normal(count)
    motions = ErrorMotions(angle, truth(angle), np.full((count, 6), 1e-8))
    correction = Correction(motions, motions)
    np.testing.assert_allclose(correction.errors(angle), motions.values, atol=1e-18)
    fine = np.linspace(-7, 14, 300)
    np.testing.assert_allclose(correction.errors(fine), truth(fine), atol=1e-15)
    step = 1e-3
    bend = (truth(fine + step) - 2 * truth(fine) + truth(fine - step)) / step**2
    assert (np.abs(bend).max(axis=0) <= 1.001 * correction.curvature()).all()


@pytest.mark.parametrize('count', [6, 9, 12])
@pytest.mark.parametrize('share', [0.05, 0.4, 0.5])
def test_the_curves_of_a_run_between_the_steps_are_met(count, share):
    """At half pitches cos(n/2 angle) is zero: the highest wave counts from the first position."""
    rng = np.random.default_rng(count)
    angle = TWO_PI * (np.arange(count) + share) / count + 1e-6 * rng.standard_normal(count)
    motions = ErrorMotions(angle, 1e-7 * rng.standard_normal((count, 6)), np.full((count, 6), 1e-8))
    correction = Correction(motions, motions)
    np.testing.assert_allclose(correction.errors(angle), motions.values, atol=1e-18)
    assert np.abs(correction.errors(np.linspace(0, 7, 500))).max() < 1e-6


@pytest.mark.parametrize('count', [6, 8])
@pytest.mark.parametrize('share', [0.25, 0.4, 0.5, 0.75])
def test_the_highest_wave_counts_from_the_first_position(count, share):
    """cos n/2 (angle - first angle), between the positions too: a sine beside it would be zero at all of them."""
    angle = TWO_PI * (np.arange(count) + share) / count
    motions = ErrorMotions(angle, np.tile(1e-6 * (-1.0)**np.arange(count)[:, None], 6), np.full((count, 6), 1e-8))
    fine = np.linspace(0, 7, 50)
    wanted = 1e-6 * np.cos(count / 2 * (fine - angle[0]))
    np.testing.assert_allclose(Correction(motions, motions).errors(fine), np.tile(wanted[:, None], 6), atol=1e-15)


def test_only_what_is_wanted_is_taken_off_in_each_sense(before):
    """Other errors are 0; a table that knows both senses of turning gives each its own curves."""
    back = replace(before, values=-before.values)
    correction = Correction(before, back, ('ctz', 'crz'))
    left = correction.left
    assert np.abs(left['ctz']).max() < 1e-15 and np.abs(left['crz']).max() < 1e-15
    np.testing.assert_array_equal(left['ctx'], before['ctx'])
    np.testing.assert_array_equal(left.u, before.u)
    got = correction.errors(before.angle)
    assert np.flatnonzero(np.abs(got).max(axis=0)).tolist() == [2, 5]
    np.testing.assert_allclose(correction.errors(before.angle, -1), -got, atol=1e-18)


def test_the_bound_of_the_bend_holds_in_both_senses(before):
    """Of each error the larger one, whichever sense bends it more; errors of mixed units are not added."""
    small, large = (replace(before, values=before.values * np.repeat(by, 3)) for by in ((1.0, 9.0), (5.0, 1.0)))
    alone = [Correction(one, one).curvature() for one in (small, large)]
    np.testing.assert_allclose(Correction(small, large).curvature(), np.maximum(*alone))
    assert (alone[0] < alone[1]).tolist() == [True] * 3 + [False] * 3


def test_senses_known_at_different_angles_go_together():
    """Each sense has the harmonics of its own angles; the bound of the bend is that of both."""
    many, few = (ErrorMotions(TWO_PI * np.arange(count) / count, 1e-7 * np.random.default_rng(count).standard_normal(
        (count, 6)), np.full((count, 6), 1e-8)) for count in (12, 6))
    both, alone = Correction(many, few), [Correction(one, one).curvature() for one in (many, few)]
    np.testing.assert_array_equal(both.curvature(), np.maximum(*alone))
    np.testing.assert_allclose(both.errors(few.angle, -1), few.values, atol=1e-18)
    assert both.harmonics == 3


def test_pose_and_point_are_one_body(before):
    """The pose in the turned frame and a point of the table in the fixed one describe the same place, in each sense."""
    correction = Correction(before, replace(before, values=-2 * before.values))
    angle, point = 2.1, np.array([0.2, -0.1, 0.05])
    for sense in (1, -1):
        shift, turn = correction.pose(angle, sense)
        body = rotate_z(angle, rotation_matrix(turn) @ point + shift)
        np.testing.assert_allclose(correction.point(angle, point, sense), body, atol=1e-10)


@pytest.mark.parametrize(('sense', 'factor'), [(1, 1.0), (-1, -2.0)])
def test_a_pose_is_turned_back_by_the_angle(sense, factor):
    """At 90 degrees the x axis of the table is the y axis of the machine: c = (1, 2, 3) stands at (2, -1, 3) there, and
    the point (1, 0, 0) is at (0, 1, 0), which the rotation (4, 5, 6) moves by (-6, 0, 4)."""
    curves = 1e-6 * np.array([1.0, 2, 3, 4, 5, 6])
    forward, back = (ErrorMotions(TWO_PI * np.arange(6) / 6, np.tile(by * curves, (6, 1)), np.full((6, 6), 1e-8))
                     for by in (1.0, -2.0))
    correction = Correction(forward, back)
    shift, turn = correction.pose(np.pi / 2, sense)
    np.testing.assert_allclose(shift, factor * 1e-6 * np.array([2.0, -1, 3]), atol=1e-18)
    np.testing.assert_allclose(turn, factor * 1e-6 * np.array([5.0, -4, 6]), atol=1e-18)
    moved = correction.point(np.pi / 2, [1.0, 0, 0], sense) - [0, 1, 0]
    np.testing.assert_allclose(moved, factor * 1e-6 * np.array([1.0 - 6, 2, 3 + 4]), atol=1e-15)


def test_angles_that_determine_no_harmonics_are_refused(before):
    """Too few, or with a gap; values that are not known."""
    few = ErrorMotions(before.angle[:4], before.values[:4], before.u[:4])
    gap = ErrorMotions(before.angle[:9], before.values[:9], before.u[:9])
    unknown = replace(before, values=np.where(before.values == before.values[3], np.nan, before.values))
    for motions, words in ((few, 'expected error motions at 5 equally spaced angles or more, found 4 with gaps up to '
                                 '270'),
                           (gap, 'found 9 with gaps up to 120 deg'), (unknown, 'expected finite error motions')):
        with pytest.raises(InvalidData, match=words):
            Correction(motions, motions)


def test_a_corrected_table_is_error_free_without_noise(tmp_path):
    """Errors of harmonics that the run determines fall from micrometres to below 2 nm and 0.02 microradian."""
    first = measured(noise=0.0)[1]
    after = corrected(tmp_path, Correction(first, first), noise=0.0)
    assert np.abs(first.values[:, 2]).max() > 0.5e-6
    assert (np.abs(after.values).max(axis=0) < [2e-9] * 3 + [2e-8] * 3).all()


def test_what_was_promised_is_confirmed(tmp_path):
    """20 machines with noise: of every corrected error only noise is left, no other one changes, in 19 or more."""
    good = 0
    for seed in range(20):
        first = measured(seed)[1]
        correction = Correction(first, first, ('ctz', 'crz'))
        check = check_correction(first, corrected(tmp_path, correction, seed=seed), correction)
        results = {one.curve: one.result for one in check.errors}
        good += check.level == 'good'
        assert {results[curve] for curve in ('ctz', 'crz')} <= {Effectiveness.VANISHED, Effectiveness.REMAINS}
        for one in check.errors:
            if one.curve in ('ctz', 'crz'):
                assert abs(one.gain - 1) < 4 * one.u_gain
    assert good >= 19


def test_mistakes_are_told_apart(before, tmp_path):
    """A wrong sign, a moved origin, a correction that is not applied, one of another table."""
    correction = Correction(before, before)

    def moved(shift, sign=1):
        return Correction(*[replace(before, values=sign * correction.errors(before.angle - shift))] * 2)

    def check(applied, promised=correction):
        return check_correction(before, corrected(tmp_path, applied), promised)

    right = check(correction)
    assert right.sentence == 'The correction did what it promised: of ctx, cty, ctz, crx, cry, crz only noise is left.'
    wrong_sign = check(moved(0, -1))
    assert wrong_sign.sentence.startswith('The correction was applied with the wrong sign: ctx (was added instead of')
    assert {one.result for one in wrong_sign.errors} == {Effectiveness.WRONG_SIGN}
    beside = check(moved(np.deg2rad(7.5)))
    assert beside.sentence.startswith('The correction did not do what it promised: ctx (')
    not_applied = check_correction(before, measured(seed=1)[1], correction)
    assert {one.result for one in not_applied.errors} == {Effectiveness.NOT_APPLIED}
    off = 'Check that the correction is loaded and switched on'
    assert not_applied.action.startswith(off)
    some = check(replace(correction, corrected=('ctz', 'crz')))
    assert {one.result for one in some.errors} == {Effectiveness.NOT_APPLIED, Effectiveness.VANISHED}
    assert not some.action.startswith(off)
    other = measured(seed=5)[1]
    foreign = check(Correction(other, other), Correction(other, other))
    assert foreign.sentence.startswith('The correction does not describe the table as it was before')
    assert [one.level for one in (wrong_sign, beside, not_applied, foreign)] == ['bad'] * 4


@pytest.mark.parametrize('degrees', [-120.0, 90.0, 180.0])
def test_a_correction_at_other_angles_has_no_wrong_sign(before, tmp_path, degrees):
    """Some waves of it are added there, others taken off; what to check is said."""
    correction = Correction(before, before)
    applied = Correction(*[replace(before, values=correction.errors(before.angle - np.deg2rad(degrees)))] * 2)
    found = check_correction(before, corrected(tmp_path, applied), correction)
    assert found.sentence.startswith('The correction did not do what it promised: ctx (')
    assert 'zero and sense of the angle as the run' in found.action


def test_what_a_large_uncertainty_hides_is_not_confirmed(before, tmp_path):
    """Curves of a model that does not fit: neither a correction that worked nor one that was never applied is told."""
    rough = replace(before, u=100 * before.u)
    correction = Correction(before, before)
    for after in (corrected(tmp_path, correction), before):
        check = check_correction(rough, replace(after, u=100 * after.u), correction)
        assert {one.result for one in check.errors} == {Effectiveness.UNDECIDED}
        assert check.level == 'doubtful'
        assert check.sentence == ('It cannot be told whether the correction did what it promised: in ctx, cty, ctz, '
                                  'crx, cry, crz the errors after it agree within their uncertainty with those '
                                  'expected, and with those before.')
        assert 'under a model that fits' in check.action


def test_an_error_within_its_uncertainty_is_nothing_to_correct():
    """A table without errors: its curves are noise, before and after."""
    settings = {'translation_um': 0.0, 'rotation_urad': 0.0}
    first, second = (measured(seed=3, table=settings, timing={'jitter_s': jitter})[1] for jitter in (0.3, 0.4))
    correction = Correction(first, first, CURVES)
    noise = replace(second, values=second.values - correction.errors(second.angle))
    check = check_correction(first, noise, correction)
    assert {one.result for one in check.errors} <= {Effectiveness.NOISE, Effectiveness.UNDECIDED}
    assert check.sentence.startswith(('There was nothing to correct', 'It cannot be told'))


def test_the_table_of_a_correction_is_told_by_both_uncertainties(before):
    """A correction of a rough run of the same table is of that table; if it were as precise as the run, not."""
    rng = np.random.default_rng(4)
    rough = replace(before, values=before.values + 10 * before.u * rng.standard_normal(before.u.shape),
                    u=10 * before.u)
    after = replace(before, values=before.values - rough.values)

    def p_of_table(motions):
        return check_correction(before, after, Correction(motions, motions)).p_of_table
    assert p_of_table(rough) > 0.01
    assert p_of_table(replace(rough, u=before.u)) < 1e-6


def test_other_angles_are_refused(before):
    """Two runs that do not share their angles cannot be compared."""
    correction = Correction(before, before)
    turned = replace(before, angle=before.angle + 0.1)
    with pytest.raises(InvalidData, match='verify: expected two runs at the same angles of the table, found 12 angles'):
        check_correction(before, turned, correction)
