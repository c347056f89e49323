# SPDX-License-Identifier: Apache-2.0
"""What runs of simulated machines share, whether the data allow it, and what became known."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.core.joint.joint_evaluation import evaluate_jointly, found_turn
from rosette_ros.core.joint.knowledge import JointRemark
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import CURVES, remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.joint_words import note_words, part_words

pytestmark = pytest.mark.usefixtures('shared_searches')

BACKLASH = {'kind': 'table_backlash', 'width_urad': 2.0}


def config(seed=1, n=8, **groups):
    """Return a small cell."""
    return MachineConfig().changed(seed=seed, plate={'balls': n}, **groups)


@functools.cache
def measured(seed=1, n=8, order='diagonal', turn=0.0, noise=0, hidden='', sense=1, cmm=''):
    """Return (machine, readings) of one run; noise: its own draws; sense: in which the table always turns."""
    groups = {'clamping': {'plate_turn_deg': turn}}
    if hidden:
        groups['hidden'] = [BACKLASH]
    if cmm:
        groups['cmm'] = {'straightness_um': 5.0}
    machine = Machine(config(seed, n, **groups))
    for _ in range(noise):
        machine.align()
    scheme = plan(n, order, turning='forward' if sense > 0 else 'clockwise')
    made, alignment, _ = machine.calibrate(scheme, run_id=f'{order}{noise}')
    return machine, Readings.of(made, alignment.frame)


def joint(*runs, **declared):
    """Return the JointResult of readings."""
    return evaluate_jointly([run for _, run in runs], declared)


def test_a_run_alone_says_what_it_hides():
    """Thirteen combinations, ten in the curves, and nothing that is known beyond."""
    result = joint(measured())
    assert (result.solution.hidden.shape[1], result.solution.hidden_in_curves) == (13, 10)
    assert (result.tests, part_words(result.knowledge.known)) == ((), ())
    assert len(result.knowledge.hidden) == 8


def test_there_and_back_gives_six_reversal_curves_with_means():
    """A backlash of 2 µrad in crz, within its uncertainty, and no other reversal."""
    result = joint(measured(order='there_and_back', n=12, hidden='backlash'))
    assert [one.sense for one, _ in result.curves] == [1, -1]
    assert 'the reversal of all six curves, with its means' in part_words(result.knowledge.known)
    (reversal,) = result.reversals
    assert reversal.p < 1e-6
    assert all(reversal.is_known)
    error = (reversal.mean - [0, 0, 0, 0, 0, 2e-6]) / reversal.u_mean
    assert np.abs(error).max() < 3
    assert reversal.u_mean[CURVES.index('crz')] < 1e-7


def test_two_logs_of_both_senses_share_their_frame_and_give_the_means():
    """Each has a table frame of its own in the machine frame: readings are compared in the first one."""
    result = joint(measured(hidden='backlash'), measured(hidden='backlash', sense=-1, noise=1))
    assert result.sharing.frame == ('1', '1')
    assert {test.item for test in result.tests} == {'table', 'plate', 'clamping', 'cmm', 'frame', 'sense'}
    assert not any(test.is_contradicted for test in result.tests if test.item != 'sense')
    (reversal,) = result.reversals
    assert reversal.mean[5] == pytest.approx(2e-6, abs=4 * reversal.u_mean[5])


def test_the_reversal_is_that_of_the_angles_that_both_runs_have():
    """Its sign is that of the effect table_backlash; where a run lacks an angle, the others count; a note says so."""
    forward, (machine, back) = measured(order='row', hidden='backlash'), measured(
        order='row', hidden='backlash', sense=-1, noise=1)
    kept = back.table_position != 1
    some = replace(back, **{name: getattr(back, name)[kept] for name in (
        'table_position', 'ball', 'centre', 'angle_deviation', 'approach')})
    assert np.all(back.approach == -1) and np.all(forward[1].approach == 1)
    whole, result = joint(forward, (machine, back)), joint(forward, (machine, some))
    assert (whole.notes, whole.reversals[0].motions.angle.size) == ((), 8)
    (reversal,) = result.reversals
    assert np.rad2deg(reversal.motions.angle) == pytest.approx(45 * np.arange(1, 8))
    assert reversal.mean[5] == pytest.approx(2e-6, abs=4 * reversal.u_mean[5]) and reversal.u_mean[5] < 1e-7
    assert [*map(note_words, result.notes)] == [
        'table counter-clockwise: no reversal at 0 deg, where nothing was measured clockwise']


def test_without_the_frames_the_means_of_the_reversal_are_not_known():
    """Tables in the table frame do not say where it was; a person may declare it."""
    pair = [run.__class__(**{**vars(run), 'frame': None}) for _, run in (
        measured(hidden='backlash'), measured(hidden='backlash', sense=-1, noise=1))]
    result = evaluate_jointly(pair)
    assert result.sharing.frame == ('1', '2')
    assert not any(result.reversals[0].is_known)
    assert 'reversal: mean of crz' in part_words(result.knowledge.hidden)
    assert part_words(result.knowledge.known) == ('the reversal of all six curves, but for its means',)
    assert JointRemark.FRAMES_APART in {note.kind for note in result.notes}
    assert all(evaluate_jointly(pair, {'frame': ('1', '1')}).reversals[0].is_known)


def test_means_that_are_known_only_together_are_taken_out():
    """One reading in the other sense joins two frames: it tells sums of means, which no mean may have in part."""
    (machine, first), (_, second) = measured(hidden='backlash'), measured(hidden='backlash', sense=-1, noise=1)
    one = (np.arange(second.size) == np.argmax(second.table_position == 1)) * 2
    result = evaluate_jointly([replace(first, frame=None), replace(second, frame=None, approach=second.approach + one)])
    assert result.solution.known_together > 0
    (reversal,) = result.reversals
    assert reversal.is_known.count(False) >= 4
    unknown = ~np.array(reversal.is_known)
    means = np.array([motions.values.mean(axis=0)[unknown] for _, motions in result.curves])
    assert np.abs(means).max() < 1e-15
    assert np.abs(reversal.motions.values.mean(axis=0)[unknown]).max() < 1e-15
    truth = remove_gauge(machine.table_truth(frame=first.frame))
    for _, motions in result.curves:
        error = ((motions.values - motions.values.mean(axis=0) - truth) / motions.u)[:, unknown]
        assert np.sqrt(np.mean(error**2)) < 1.4


@pytest.mark.parametrize('turn', [0.0, 90.0, 225.0])
def test_the_turn_of_a_plate_shows_in_its_deviations(turn):
    """Whole pitches, from the distances between the balls; another plate shows none."""
    (_, first), (_, second) = measured(), measured(turn=turn, noise=1)
    assert np.rad2deg(found_turn(first, second)) == pytest.approx(turn, abs=1e-9)
    assert found_turn(first, measured(seed=2)[1]) == 0


@pytest.mark.parametrize(('balls', 'turn'), [
    ((1, 2, 4, 8, 9), 0.0), ((1, 3, 4, 6, 8, 9, 10), 0.0), ((1, 3, 4, 6, 8, 9, 10), 90.0)])
def test_the_turn_of_some_balls_is_not_guessed(balls, turn):
    """Where a turn brings one or two balls to measured places, no distances are left that could differ."""
    pitches = round(turn / 30)
    found = []
    for angle, used in ((0.0, balls), (turn, sorted((ball - 1 + pitches) % 12 + 1 for ball in balls))):
        run = Machine(config(n=12, clamping={'plate_turn_deg': angle})).run(plan(12, balls=used))
        noise = 1e-7 * np.random.default_rng(round(angle)).standard_normal(run.centre.shape)
        found.append(Readings.of(run.replace(centre=run.centre + len(found) * noise)))
    assert np.rad2deg(found_turn(*found)) == pytest.approx(turn, abs=1e-9)


def test_a_turned_plate_is_one_plate():
    """Its placement is free, its deviations are shared, and the curves agree with the truth."""
    (machine, first), (_, second) = measured(), measured(turn=90.0, noise=1)
    result = evaluate_jointly([first, second])
    assert result.sharing.clamping[0] != result.sharing.clamping[1]
    assert result.solution.model.unknowns == 12 * 8 + 6
    assert not any(test.is_contradicted for test in result.tests)
    assert 'turned by 90° against diagonal0' in note_words(result.notes[0])
    ((_, motions),) = result.curves
    error = (motions.values - remove_gauge(machine.table_truth(frame=first.frame))) / motions.u
    assert np.sqrt(np.mean(error**2)) < 1.4


@pytest.mark.parametrize(('second', 'item'), [
    ({'seed': 2}, 'plate'), ({'cmm': 'bent'}, 'cmm'), ({'turn': 360.0}, None)])
def test_what_the_data_contradict_is_not_shared(second, item):
    """Another plate or another CMM is found by the test; the same ones are not suspected."""
    result = joint(measured(), measured(noise=1, **second))
    contradicted = [test.item for test in result.tests if test.is_contradicted]
    assert (item in contradicted) if item else contradicted == []
    assert not any(test.is_used for test in result.tests if test.is_contradicted)
    assert result.lack_of_fit_p > 1e-3


def test_runs_of_different_cells_have_no_common_curves():
    """Table, plate and CMM differ: a mean of two tables is refused; of the same table it is tested, and given."""
    first, again, rng = measured()[1], measured(noise=1)[1], np.random.default_rng(4)
    angle, place = again.angle[again.table_position - 1], (again.table_position + again.ball - 2) % 8
    plate, cmm = 2e-6 * rng.standard_normal((2, 8, 3))
    other = replace(again, centre=again.centre + rotate_z(angle, plate[again.ball - 1]) + cmm[place])
    same = evaluate_jointly([first, other])
    assert {test.item: test.is_used for test in same.tests if test.p is not None} == {
        'table': True, 'plate': False, 'cmm': False}
    moved = replace(other, centre=other.centre + 2e-6 * np.cos(2 * angle)[:, None] * np.eye(3)[2])
    with pytest.raises(NotDeterminable, match='contradict all of it: .* error motions of .*; diagnose each run alone'):
        evaluate_jointly([first, moved])


def test_a_declaration_is_used_and_judged():
    """Two plates that are declared one: it is done, and the test says that it is wrong."""
    result = joint(measured(), measured(seed=2, noise=1), plate=('1', '1'), clamping=('1', '2'))
    test = next(test for test in result.tests if test.item == 'plate')
    assert (test.is_used, test.is_contradicted) == (True, True)
    assert 'plate' in result.declared
    assert result.lack_of_fit_p < 1e-6


def test_a_seat_that_reproduces_gives_what_turns_once():
    """The tilt against the face of the seat becomes known, by trust: of its three parts only the height is tested."""
    result = joint(measured(), measured(turn=90.0, noise=1), seat='plane')
    assert 'once-per-turn part of (crx, cry): tilt' in part_words(result.knowledge.known)
    assert result.solution.hidden_in_curves == 8
    assert next(test for test in result.tests if test.item == 'seat').dof == 1


def test_a_calibrated_cmm_gives_the_scale():
    """And the machine frame; that the deviations are zero is tested."""
    result = joint(measured(), cmm_is_calibrated=True)
    assert {'radial scale of plate and CMM', 'mean of ctx and cty'} <= {*part_words(result.knowledge.known)}
    assert [(test.item, test.is_contradicted) for test in result.tests] == [('calibrated CMM', True)]


def test_too_few_readings_are_refused():
    """Nothing would be left to judge them by."""
    _, run = measured()
    few = np.arange(run.size) % 5 == 0
    short = Readings(run.plate, run.angle, *(values[few] for values in (
        run.table_position, run.ball, run.centre, run.angle_deviation, run.approach)))
    with pytest.raises(NotDeterminable, match='leave -?[0-9]+ degrees of freedom; measure more balls or share more'):
        evaluate_jointly([short])


def test_contradictions_are_refused_in_one_line():
    """Plates of different sizes declared one; a run that is given twice; a table without common positions."""
    (_, first), (_, other) = measured(n=6), measured()
    with pytest.raises(InvalidData, match=r'diagonal0 and diagonal0: plate: expected one plate, as declared, found 6 '
                                          r'and 8 '
                       'balls; declare the plates separate'):
        evaluate_jointly([first, other], {'plate': ('1', '1')})
    with pytest.raises(InvalidData, match='expected different runs, found the same ball centres in both; leave one '
                                          'out'):
        evaluate_jointly([first, first])
    (_, five) = measured(n=5)
    with pytest.raises(NotDeterminable, match='1 table angles, 0 balls, 1 CMM positions in common, which does not join '
                       'them; missing: two table angles of the same table, three balls of the same plate, or three C'):
        evaluate_jointly([first, five])


def test_runs_without_noise_in_other_orders_are_two_runs():
    """All their ball centres are the same, but not in the same order as those of a run that was resumed."""
    machine = Machine(MachineConfig().changed(plate={'balls': 6}, probing={'repeatability_um': 0.0}))
    runs = [Readings.of(machine.run(plan(6, order), run_id=order)) for order in ('diagonal', 'row')]
    off = runs[0].centre[:, None] - runs[1].centre
    assert np.abs(off).max(axis=2).min(axis=1).max() < 1e-12
    assert evaluate_jointly(runs).rms < 1e-9


def test_u_rests_on_residuals_and_repeatability():
    """Degrees of freedom of both, where both tell sigma."""
    (_, one), (_, other) = measured(), measured(noise=1)
    result = evaluate_jointly([one, other])
    assert result.sigma_source == 'residuals and repeatability'
    assert result.sigma_dof == result.solution.dof + one.repeatability_dof + other.repeatability_dof


def test_a_run_and_its_continuation_are_refused():
    """The second log begins with the readings of the first; so has a table of it, whose frame is not known."""
    _, whole = measured()
    begun = replace(whole, source='begun', **{name: getattr(whole, name)[:40] for name in (
        'table_position', 'ball', 'centre', 'angle_deviation', 'approach')})
    table = replace(whole, source='table', frame=None, centre=whole.centre + 1e-16)
    for runs in ([begun, whole], [whole, begun], [begun, table]):
        with pytest.raises(InvalidData, match='begun: expected another run than .*, found 40 of its 40 ball centres '
                                              'there, '
                           'too, as where a run was resumed; leave it out'):
            evaluate_jointly(runs)
    with pytest.raises(InvalidData, match='found the same ball centres in both; leave one out'):
        evaluate_jointly([whole, table])


@pytest.mark.parametrize('kind', ['turned', 'senses'])
def test_normalised_errors_of_simulated_runs(kind):
    """Over 2 machines the errors of the curves are as large as their uncertainties say: 0.8 to 1.2."""
    errors = []
    for seed in range(2):
        second = {'turn': 120.0} if kind == 'turned' else {'sense': -1}
        (machine, first), (_, other) = measured(seed, 6), measured(seed, 6, noise=1, **second)
        result = evaluate_jointly([first, other])
        truth = remove_gauge(machine.table_truth(frame=first.frame))
        errors += [(motions.values - truth) / motions.u for _, motions in result.curves]
        errors += [one.motions.values / one.motions.u for one in result.reversals]
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2


def test_runs_without_noise_have_that_which_no_readings_lack():
    """What their orders hide is then all of U in an environment; it was a matrix that is not positive definite."""
    machine = Machine(config(n=6, probing={'repeatability_um': 0.0}, table={'positioning_urad': 0.0}))
    runs = [Readings.of(machine.run(plan(6, order, 1))) for order in ('interleaved', 'diagonal')]
    result = evaluate_jointly(runs)
    assert result.sigma >= 1e-10
    assert result.unseen is not None and result.unseen.whole > 1e-8
