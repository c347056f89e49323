# SPDX-License-Identifier: Apache-2.0
"""Runs with effects and noise of their own, evaluated as one: known curves and sizes are found again."""

import functools

import numpy as np
import pytest

from benchmarks.bench_joint import drawn_runs, hidden_in, hidden_run, joined
from benchmarks.blind.runs import SIGMA, Plan, situation, visible_part
from rosette_ros.analysis import find
from rosette_ros.core.joint.conclusion import JointOutcome, conclude
from rosette_ros.core.joint.explained_runs import visible_of
from rosette_ros.core.joint.joint_evaluation import evaluate_jointly
from rosette_ros.core.joint.knowledge import JointRemark
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.uncertainty.stated_environment import LABORATORY
from rosette_ros.words.joint_words import note_words

pytestmark = pytest.mark.usefixtures('shared_searches')

KINDS = {'frame_drift': 'interleaved', 'plate_warp': 'diagonal', 'cmm_reversal': 'interleaved'}
"""Effects of different bodies and variables, each with the order of its run."""
STRENGTH = 25.0


@functools.cache
def three():
    """Return plan, displacements, run and true curves of three runs of one machine with different effects."""
    out = []
    for kind, order in KINDS.items():
        made, rng = Plan(7, order, 3), np.random.default_rng([8, len(out)])
        shift = hidden_in(made, kind, rng, STRENGTH)
        run, truth = hidden_run(made, shift, 'white', rng)
        out.append((made, shift, run.replace(run_id=kind), truth))
    return tuple(out)


@functools.cache
def together(environment=None):
    """Return the JointResult of these three runs."""
    return evaluate_jointly([Readings.of(run) for _, _, run, _ in three()], {'by_sense': False}, environment)


def test_known_curves_and_effects_are_found_with_different_effects_in_each_run():
    """Each run keeps its own; what is removed is what was hidden. A plate that warped in one run is not that of the
    others, and is not shared."""
    result = together()
    assert [[one.name for one in own] for own in result.effects] == [[kind] for kind in KINDS]
    conclusion = conclude(result)
    assert (conclusion.outcome, conclusion.items) == (JointOutcome.IN_PART, ('plate',))
    assert result.lack_of_fit_p > 0.01
    ((_, motions),) = result.curves
    error = (remove_gauge(motions.values) - three()[0][3]) / motions.u
    assert 0.6 < np.sqrt(np.mean(error**2)) < 1.4 and np.mean(np.abs(error) <= 2) > 0.9
    for (_, shift, run, _), (effect,) in zip(three(), result.effects, strict=True):
        off = visible_part(run, effect.displacement - shift)
        assert np.linalg.norm(off) < 5 * SIGMA < 0.25 * np.linalg.norm(visible_part(run, shift))
    assert all(0.7 < result.probability(place, own[0].name) <= 1 for place, own in enumerate(result.effects))


def test_u_is_smaller_than_that_of_each_run():
    """By about the square root of the number of runs."""
    ((_, motions),) = together().curves
    for _, _, run, _ in three():
        alone = find(run).final.error_motions
        assert np.mean(motions.u / alone.u) < 0.75


def test_what_a_run_brings_is_said():
    """By its title, in a note of every interface."""
    said = [note_words(one) for one in together().notes if one.kind is JointRemark.EFFECTS]
    assert said[0] == 'frame_drift: in its model: linear probe drift' and len(said) == 3


@pytest.mark.parametrize(('noise', 'seed'), [('white', 5), ('ar_0.6', 0)])
def test_one_run_gives_what_it_gives_alone(noise, seed):
    """Effects, noise and explanations: the same least squares; but the explanations of one run have a sigma each, those
    of several runs that of the likeliest."""
    (kind,), (run,), _ = drawn_runs(seed, 7, 1, noise)
    alone = find(run).final
    result = evaluate_jointly([Readings.of(run)], {'by_sense': False})
    assert kind and (result.solution.beside.is_plain == (noise == 'white'))
    ((_, motions),) = result.curves
    off = remove_gauge(motions.values) - remove_gauge(alone.error_motions.values)
    assert np.abs(off / alone.error_motions.u).max() < 0.05
    assert motions.u == pytest.approx(alone.error_motions.u, rel=0.05 if noise == 'white' else 0.15)
    assert result.rms == pytest.approx(alone.rms, rel=0.03)


def test_a_time_constant_is_one_of_the_machine():
    """Two warm-ups of different sizes: one time constant, known better than by either run; amplitudes their own."""
    made, runs = Plan(6, 'interleaved', 4), []
    clean, machine = made.measure()
    hours = situation(clean, machine)
    tau = 0.25 * hours.duration_h
    for place in range(2):
        rng = np.random.default_rng([9, place])
        shift = hidden_in(made, 'frame_warmup', rng, 30.0, time_constant_h=tau, from_h=0.98 * hours.start_h)
        runs.append(hidden_run(made, shift, 'white', rng)[0].replace(run_id=f'run {place + 1}'))
    result = evaluate_jointly([Readings.of(run) for run in runs], {'by_sense': False})
    assert [[one.name for one in own] for own in result.effects] == [['frame_warmup']] * 2
    one, other = (next(p for p in own[0].parameters if p.name == 'tau') for own in result.effects)
    assert (one.value, one.u) == (other.value, other.u)
    assert abs(one.value - 3600 * tau) < 4 * one.u
    solution = result.solution
    assert solution.dof == 3 * solution.model.size - solution.rank  # the rank has the time constant
    alone = [next(p for p in find(run).final.effects[0].parameters if p.name == 'tau') for run in runs]
    assert one.u < min(p.u for p in alone)
    sizes = [np.array([p.value for p in own[0].parameters if p.name.startswith('d')]) for own in result.effects]
    assert np.abs(sizes[0] - sizes[1]).max() > 3 * one.u * np.abs(sizes).max() / one.value


def test_runs_with_correlated_noise_are_joined():
    """Their common curves are off by about what their U says; each run brings its own kind."""
    _, runs, truth = drawn_runs(2, 8, 2, 'ar_0.6', clean=True)
    result = evaluate_jointly([Readings.of(run) for run in runs], {'by_sense': False})
    assert [run.noise.kinds for run in result.solution.beside.runs] == [('wander',)] * 2
    ((_, motions),) = result.curves
    assert 0.6 < np.sqrt(np.mean(((remove_gauge(motions.values) - truth) / motions.u)**2)) < 1.5


@pytest.mark.long
def test_u_covers_the_curves_of_runs_with_different_effects():
    """A few machines of the benchmark: U contains the truth, and is at most 0.65 times that of one run."""
    every = [joined(seed, 6) for seed in range(2)]
    assert np.mean([np.abs(one.ratio) <= 1 for one in every]) > 0.9
    assert np.mean([one.u_ratio for one in every]) < 0.65


def test_runs_without_effects_are_as_they_were():
    """Nothing is beside the base model, and no note speaks of it."""
    _, runs, _ = drawn_runs(1, 6, 2, 'white', clean=True)
    result = evaluate_jointly([Readings.of(run) for run in runs], {'by_sense': False})
    assert result.effects == ((), ()) and result.solution.beside.is_plain
    assert not [one for one in result.notes if one.kind in (JointRemark.EFFECTS, JointRemark.NOISE)]


def test_an_environment_adds_what_the_orders_hide():
    """With effects in the runs, too; what is found has left the environment."""
    result = together(LABORATORY)
    ((_, plain),), ((_, wide),) = together().curves, result.curves
    assert np.mean(wide.u / plain.u) > 1
    assert result.unseen is not None and result.unseen.whole > result.unseen.alone


def test_a_hypothesis_of_which_too_little_is_seen_keeps_its_prior():
    """Its probability less what the run alone says of its effects; these leave the solution."""
    beside = together().solution.beside
    seen = visible_of(beside, lambda place, rows: 0.0, 0.05)
    for run, before in zip(seen.runs, beside.runs, strict=True):
        for one, whole in zip(run.hypotheses, before.hypotheses, strict=True):
            assert not one.effects and one.probability == whole.probability
            assert one.log_bf(SIGMA) == whole.log_bf(SIGMA)
