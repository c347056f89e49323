# SPDX-License-Identifier: Apache-2.0
"""The six errors in a line each: parts of known curves, the decision rule, what scatters from run to run."""

import numpy as np
import pytest

from rosette_ros.analysis import analyse, evaluate_jointly
from rosette_ros.core.diagnosis.verdict import Outcome, Verdict
from rosette_ros.core.joint.conclusion import Conclusion, JointOutcome
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.joint.run_to_run import joint_lines
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.uncertainty.error_summary import (
    Conformity,
    conformity,
    difference,
    doubt_of,
    error_lines,
    fit_lines,
    once_per_turn,
)
from rosette_ros.simulation import Machine, MachineConfig

pytestmark = pytest.mark.usefixtures('shared_searches')


def motions_of(curve, u=0.0):
    """Return error motions with one curve (n,) in all six places."""
    values = np.tile(np.asarray(curve)[:, None], (1, 6))
    return ErrorMotions(nominal_angles(len(curve)), values, np.full(values.shape, u))


def simulated(order='random', seed=1, n=8, **changes):
    """Return a run of a simulated machine."""
    return Machine(MachineConfig().changed(seed=seed, plate={'balls': n}, **changes)).run(plan(n, order, seed),
                                                                                          run_id=f'{order}_{seed}')


def test_a_curve_is_split_into_once_per_turn_and_the_rest():
    """3 cos θ + 2 sin 2θ + 5 at 12 angles: peak to valley 6 of the first part; the extremes of the second at 45°."""
    angle = nominal_angles(8)
    line = error_lines(motions_of(5 + 3 * np.cos(angle - 1) + 2 * np.sin(2 * angle)))[2]
    assert line.once_per_turn == pytest.approx(6)
    assert line.residual == pytest.approx(4)
    assert once_per_turn(5 + 3 * np.cos(angle - 1), angle) == pytest.approx(3 * np.exp(1j))
    assert (line.curve, line.name) == ('ctz', 'EZC')


def test_three_points_have_no_parts():
    """A mean and a wave fit any three points."""
    assert np.isnan(error_lines(motions_of([0, 1, 3]))[0].once_per_turn)


def test_differences_have_the_uncertainty_of_both():
    """3 and 4 make 5, at the same angles only."""
    one, other = motions_of([1.0, 2, 0, 5], 3.0), motions_of([0.0, 4, 0, 1], 4.0)
    less = difference(one, other)
    np.testing.assert_array_equal(less['ctx'], [1, -2, 0, 4])
    np.testing.assert_array_equal(less.u, 5)
    assert difference(one, motions_of([0.0, 1, 2])) is None
    assert difference(one, ErrorMotions(one.angle + 1e-3, one.values, one.u)) is None


@pytest.mark.parametrize(('value', 'expanded', 'said'), [
    (0.8, 0.2, Conformity.CONFORMS), (0.8, 0.3, Conformity.UNDECIDED), (1.1, 0.2, Conformity.UNDECIDED),
    (1.3, 0.2, Conformity.FAILS), (0.8, np.inf, Conformity.UNDECIDED), (0.8, np.nan, Conformity.UNDECIDED)])
def test_the_guard_band_is_u(value, expanded, said):
    """ISO 14253-1 for a tolerance of 1."""
    assert conformity(value, expanded, 1.0) is said


def test_nothing_is_decided_where_the_model_is_refuted():
    """U does not contain what the model lacks."""
    bad = Verdict(Outcome.UNNAMED)
    [line, *others] = error_lines(motions_of([0, 1, 0, 0]), tolerances={'ctx': 100.0}, doubt=doubt_of(bad))
    assert (line.conformity, others[0].conformity) == (Conformity.UNDECIDED, None)
    assert 'does not fit the readings' in line.doubt
    assert not doubt_of(Verdict(Outcome.FITS)) and not doubt_of(None)
    assert doubt_of(Conclusion(JointOutcome.REFUTED)) and not doubt_of(Conclusion(JointOutcome.IN_PART))


@pytest.mark.parametrize('share', [1.0, 0.7])
def test_u_of_a_range_is_that_of_repeated_runs(share):
    """Differences of two points of the curves of noise alone: at most u, and not less than 0.7 of it."""
    run, rng = simulated(), np.random.default_rng(5)
    run = run.take(np.sort(rng.permutation(run.size)[:round(share * run.size)]))
    found = analyse(run)
    noise = found.sigma * rng.normal(size=(3000, run.size, 3))
    curves = found.joint.space.described(noise)[0].curves
    high, low = [0, 1, 2, 3, 4, 5], [4, 2, 7, 6, 5, 0]
    spread = (curves[:, high, range(6)] - curves[:, low, range(6)]).std(axis=0)
    stated = found.sigma * np.sqrt(found.joint.difference_cofactor(high, low))
    assert np.all(spread < 1.05 * stated) and np.all(spread > 0.6 * stated)
    assert all(line.u_range <= 2 * line.u_point for line in fit_lines(found))


def test_u_of_a_range_is_no_more_than_any_correlation_makes_it():
    """Three table positions: the bound of a complete run is 2.45 times that of a point, the sum of both 2 times."""
    lines = fit_lines(analyse(Machine(MachineConfig().changed(plate={'balls': 3})).run(plan(3, 'diagonal'))))
    assert all(line.u_range == pytest.approx(2 * line.u_point) for line in lines[2:3])
    assert all(line.u_range <= 2 * line.u_point * (1 + 1e-12) for line in lines)


def test_several_runs_tell_the_asynchronous_part():
    """What one run has in addition at one angle is its width; two sound runs differ by noise."""
    first, other = simulated('diagonal'), simulated('random')
    lines = joint_lines(evaluate_jointly([Readings.of(first), Readings.of(other)]))[0][2]
    assert all(line.asynchronous < 2.5 * line.u_asynchronous for line in lines)
    lifted = other.centre + np.where(other.table_position == 3, 5e-6, 0.0)[:, None] * [0, 0, 1]
    runs = [Readings.of(first), Readings.of(other.replace(centre=lifted))]
    assert len(joint_lines(evaluate_jointly(runs))) == 2  # taken for two tables, unless it is declared as one
    [(_, _, lines)] = joint_lines(evaluate_jointly(runs, {'table': ('1', '1')}))
    # 5 µm less its mean over 8 angles
    assert lines[2].asynchronous == pytest.approx(5e-6 * 7 / 8, abs=3 * lines[2].u_asynchronous)
    assert lines[2].range == pytest.approx(2.5e-6, abs=0.6e-6)
    single = joint_lines(evaluate_jointly([Readings.of(first)]))[0][2]
    assert single[0].asynchronous is None
