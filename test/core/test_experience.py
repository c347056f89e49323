# SPDX-License-Identifier: Apache-2.0
"""Experience of a cell as the prior of its next run."""

import functools

import numpy as np
import pytest

from rosette_ros.core.diagnosis.diagnosis import known_of, search_of
from rosette_ros.core.diagnosis.log_evidence import State
from rosette_ros.core.diagnosis.run_search import RunEvidence
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.joint.cell_diagnosis import experience_of
from rosette_ros.core.joint.cell_rates import CellRates
from rosette_ros.core.joint.run_causes import causes_in
from rosette_ros.core.model.experience import Experience, KnownCause
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.motion_words import missing_words

KNOWN = Experience((KnownCause('frame_drift', 0.9, 0.99, 7.0, 9),), runs=9)


def measured(rate, seed=1, n=8):
    """Return a run of a machine whose probe drifts at a rate, um per h."""
    hidden = [{'kind': 'frame_drift', 'rate_um_per_h': [rate, 0.0, 0.6 * rate]}] if rate else []
    machine = Machine(MachineConfig().changed(seed=seed, plate={'balls': n}, hidden=hidden))
    return machine.run(plan(n, 'interleaved', seed))


@functools.cache
def known(rate, seed, experience):
    """Return what is known of such a run with experience."""
    return known_of(measured(rate, seed), Model(experience=experience))


def test_a_weak_cause_that_the_cell_has_is_likelier_and_told_with_its_part():
    """The probability of this run alone is that without experience, and the verdict says so."""
    before, after = (known(0.5, 5, learnt).search.posterior for learnt in (None, KNOWN))
    assert after.of('frame_drift') > before.of('frame_drift')
    assert after.alone.of('frame_drift') == pytest.approx(before.of('frame_drift'), abs=0.05)
    strong = known(2.0, 1, KNOWN).found.verdict.missing
    drift, = [one for one in strong if one.name == 'frame_drift']
    assert drift.learnt is KNOWN.causes[0]
    assert '[in 7 of 9 earlier runs; this run alone: 9' in missing_words(drift)


def test_a_cause_that_the_cell_never_had_is_found_as_before():
    """Experience of another cause changes its log evidence by nothing."""
    other = Experience((KnownCause('plate_warp', 0.5, 0.9, 5.0, 9),))
    before, after = (known(2.0, 1, learnt).search.posterior for learnt in (None, other))
    key = ('frame_drift',), ()
    assert after.log_evidence(key) == before.log_evidence(key)


def test_experience_says_that_a_cause_is_there_not_how_often():
    """A second one of the same is no likelier beside the first than it was: it was told as "2 times"."""
    run = measured(2.0)
    gained = []
    for model in (Model(), Model(experience=KNOWN)):
        evidence = RunEvidence(run, model).white
        offer = next(one for one in evidence.empty.offers() if one.family.name == 'frame_drift')
        member = evidence.member(offer.family, offer.setting, offer.volume)
        gained.append([State(evidence, [member] * count).log_evidence for count in (1, 2)])
    (one, two), (known, known_twice) = gained
    assert known - one > 1
    assert known_twice - known == pytest.approx(two - one)


def test_no_experience_changes_nothing():
    """Not even the name of the model."""
    assert Model(experience=KNOWN).hash == Model().hash and Model().experience is None


def test_a_run_teaches_what_it_says_alone():
    """Searched with experience or without it, a run says the same, and keeps the same text: nothing is learnt twice."""
    for rate in (0.5, 0.0):
        before, after = (causes_in(known(rate, 5, learnt).search) for learnt in (None, KNOWN))
        said, likely = (dict(zip(one.hypotheses, one.log_evidence - one.log_evidence.max())) for one in (before, after))
        assert before.alone['frame_drift'] == pytest.approx(after.alone['frame_drift'], abs=0.02)
        assert all(value == pytest.approx(likely[names], abs=0.1) for names, value in said.items() if value > -4)
        for name, prior in before.log_prior.items():
            assert after.log_prior.get(name, prior) == pytest.approx(prior)


def test_what_runs_teach():
    """Three runs of a cell that drifts: its rate, and in how many runs it was."""
    runs = [causes_in(known(2.0, seed, None).search) for seed in (1, 2, 3)]
    taught = experience_of(CellRates(runs), 'cell1', 'T1')
    drift = taught.by_name['frame_drift']
    assert drift.again > 0.9 and drift.expected > 2.9 and drift.judged == 3 and 0.5 < drift.rate < 1
    assert taught.runs == 3 and (taught.cell, taught.table) == ('cell1', 'T1')
    sizes = [one.rms for seed in (1, 2, 3) for one in known(2.0, seed, None).found.final.effects
             if one.name == 'frame_drift']
    assert drift.size == pytest.approx(np.sqrt(np.mean(np.square(sizes))), rel=0.25) and drift.spread < 0.5


@pytest.mark.parametrize('name', ['table_zero_drift', 'plate_warp'])
def test_the_size_of_a_cause_is_its_displacement_in_the_runs(name):
    """Of one amplitude or two, and far above the noise: rms over all coordinates, as the curves have it in U."""
    runs = []
    for seed in (1, 2, 3):
        run = measured(0.0, seed, 6)
        moved = EFFECTS[name].columns(run, next(iter(EFFECTS[name].settings(run)))).sum(axis=-1)
        runs.append(causes_in(search_of(run.replace(centre=run.centre + 4e-7 * moved / np.sqrt(np.mean(moved**2))))))
    size, spread = CellRates(runs).size(name)
    assert size == pytest.approx(4e-7, rel=0.35) and spread < 0.6
