# SPDX-License-Identifier: Apache-2.0
"""The causes of a cell: rates that are integrated, events, runs that say nothing; what is stated holds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.diagnosis.log_evidence import SIZES
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.joint.cell_diagnosis import CellRun, diagnose_cell, refuse_unlike
from rosette_ros.core.joint.cell_rates import COMES_AGAIN, CellRates
from rosette_ros.core.joint.run_causes import CauseShape, RunCauses, causes_in
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.sight.priors import SEARCHED, log_found
from rosette_ros.simulation import Machine, MachineConfig

PRIOR = 0.01
DRIFT, CREEP, SLIP, WARMUP = 'frame_drift', 'plate_creep', 'plate_slip', 'frame_warmup'


def run_of(shapes=None, silent=(), **log_bf):
    """Return what a run says of which single causes change the evidence by so much."""
    names = tuple(log_bf)
    prior = math.log(PRIOR)
    return RunCauses(((), *((name,) for name in names)), np.array([0.0, *(prior + log_bf[name] for name in names)]),
                     dict.fromkeys(names, prior), frozenset(silent), shapes or {})


def test_one_cause_has_the_probability_of_the_integral():
    """p(property | runs) by a fine sum over the rate, the only cause that there is."""
    values = [3.0, 2.5, -1.0, 4.0]
    rates = CellRates([run_of(**{DRIFT: value}) for value in values])
    rho = (np.arange(20000) + 0.5) / 20000
    factor = np.exp(np.array(values))
    elsewhere = PRIOR * (1 - COMES_AGAIN)
    as_property = 2 * COMES_AGAIN * PRIOR * np.mean(np.prod(1 - rho[:, None] + rho[:, None] * factor, axis=1))
    by_chance = (1 - 2 * COMES_AGAIN * PRIOR) * np.prod(1 - elsewhere + elsewhere * factor)
    assert rates.again(DRIFT) == pytest.approx(as_property / (as_property + by_chance), abs=0.01)


def test_what_is_weak_in_every_run_is_found_by_all_of_them():
    """By itself each run would leave it at 17 %."""
    runs = [run_of(**{DRIFT: 3.0}) for _ in range(6)]
    rates = CellRates(runs)
    assert max(one.alone[DRIFT] for one in runs) < 0.2
    assert rates.again(DRIFT) > 0.95
    assert min(rates.p(k, DRIFT) for k in range(6)) > 0.95
    assert rates.rate(DRIFT) > 0.8


def test_what_was_there_once_is_nearly_as_likely_as_by_itself():
    """The prior of what comes now and then is half of that of a cause."""
    runs = [run_of(**{CREEP: 8.0 if k == 2 else -3.0}) for k in range(6)]
    rates = CellRates(runs)
    assert rates.again(CREEP) < 0.3
    assert rates.p(2, CREEP) > 0.95 * runs[2].alone[CREEP]
    assert rates.p(0, CREEP) < 0.01


def test_an_event_does_not_come_again():
    """Whatever the runs say, and each keeps the probability that it has by itself."""
    runs = [run_of(**{SLIP: 4.0}) for _ in range(5)]
    rates = CellRates(runs)
    assert rates.again(SLIP) == 0
    assert rates.p(0, SLIP) == pytest.approx(runs[0].alone[SLIP], abs=0.01)


def test_a_run_that_cannot_show_it_says_nothing():
    """It is not counted as a run without it."""
    shown = [run_of(**{DRIFT: 3.0}) for _ in range(3)]
    blind, empty = run_of(silent=[DRIFT]), run_of(**{DRIFT: -5.0})
    alone = CellRates(shown).rate(DRIFT)
    assert CellRates([*shown, blind, blind]).rate(DRIFT) == pytest.approx(alone, abs=1e-6)
    assert CellRates([*shown, empty, empty]).rate(DRIFT) < 0.75 * alone


def test_look_alikes_share_what_the_runs_say():
    """Of two laws that go equally in all runs each may be the property, not both."""
    rates = CellRates([run_of(**{DRIFT: 4.0, WARMUP: 4.0}) for _ in range(6)])
    assert rates.again(DRIFT) == pytest.approx(0.5, abs=0.05)
    assert rates.again(WARMUP) == pytest.approx(0.5, abs=0.05)
    assert rates.again_of([DRIFT, WARMUP]) > 0.99


def shape(tau, width):
    """Return a CauseShape of 64 sigma whose time constant is known to a share."""
    values = np.geomspace(100, 10000, 15)
    line = -(np.log(values / tau) / width)**2 / 2
    sizes = np.where(SIZES == 64.0, 0.0, -30.0)
    return CauseShape(1e-8, sizes - np.log(np.mean(np.exp(sizes))), {
        'tau': (tuple(values.tolist()), line - np.log(np.mean(np.exp(line))))})


def test_constants_and_sizes_are_those_of_all_runs_that_have_it():
    """The constant is better known than by one; a run that has not the cause says nothing of either."""
    runs = [run_of({WARMUP: shape(1000, 1.0)}, **{WARMUP: 6.0}) for _ in range(6)]
    without = run_of({WARMUP: shape(9000, 0.1)}, **{WARMUP: -9.0})
    rates = CellRates([*runs, without])
    values, p = rates.constants(WARMUP)['tau']
    mean = p @ np.log(values)
    assert math.exp(mean) == pytest.approx(1000, rel=0.05)
    assert np.sqrt(p @ (np.log(values) - mean)**2) < 0.6
    size, spread = rates.size(WARMUP)
    assert size == pytest.approx(64e-8) and spread < 0.01


# What is stated holds: cells whose runs are drawn, without any search

CAUSES = DRIFT, CREEP, 'table_backlash', 'plate_warp'
OFTEN = 0.2
"""Prior of each in a run."""
ALIKE = np.array([[1.0, 0, 0, 0], [0.9, 0.19**0.5, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""Directions of what each does to four readings: those of two laws are alike."""
SIZE = 2.5
"""What each does, in units of the noise of a reading."""


def drawn_cell(rng, runs=6):
    """Return a cell drawn from the hierarchical model: what its runs say exactly, which causes are properties, which
    each run has, which the next one has."""
    again = rng.uniform(size=4) < 2 * COMES_AGAIN * OFTEN
    rate = np.where(again, rng.uniform(size=4), OFTEN * (1 - COMES_AGAIN))
    there = rng.uniform(size=(runs + 1, 4)) < rate
    sets = (np.arange(16)[:, None] >> np.arange(4) & 1).astype(bool)
    odds = math.log(OFTEN / (1 - OFTEN))
    said = []
    for one in there[:-1]:
        reading = SIZE * one @ ALIKE + rng.normal(size=4)
        off = reading - SIZE * sets @ ALIKE
        said.append(RunCauses(tuple(tuple(name for name, has in zip(CAUSES, row) if has) for row in sets),
                              -(off**2).sum(axis=1) / 2 + odds * sets.sum(axis=1), dict.fromkeys(CAUSES, odds)))
    return said, again, there


def test_stated_probabilities_hold():
    """Of causes in runs, of properties and of the next run, in each bin within its sampling error of 3.5 sigma; what
    the runs of one cell miss together counts once."""
    rng, stated = np.random.default_rng(5), {'in a run': [], 'property': [], 'next run': []}
    for _ in range(120):
        said, again, there = drawn_cell(rng)
        rates = CellRates(said)
        stated['property'].append(([rates.again(name) for name in CAUSES], again))
        stated['next run'].append(([rates.rate(name) for name in CAUSES], there[-1]))
        in_runs = [one.of_each(p) for one, p in zip(said, rates.posteriors)]
        stated['in a run'].append(([each[name] for each in in_runs for name in CAUSES], there[:-1].reshape(-1)))
    for what, cells in stated.items():
        p, true = (np.array([one[k] for one in cells], dtype=float) for k in (0, 1))
        for low, high in ((0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.97), (0.97, 1.01)):
            own = (p >= low) & (p < high)
            off = np.where(own, p - true, 0).sum(axis=1)
            error = max(math.sqrt(off @ off), math.sqrt(np.where(own, p * (1 - p), 0).sum()))
            assert abs(off.sum()) < 3.5 * error + 1e-9, (what, low, off.sum() / own.sum())


@pytest.mark.parametrize('runs', [6, 60])
def test_no_more_is_stated_than_the_counts_support(runs):
    """Where each run says for certain whether it has a cause, the rate is that of Laplace's rule, at most."""
    for count in (1, runs // 2, runs):
        rates = CellRates([run_of(**{DRIFT: 30.0 if k < count else -30.0}) for k in range(runs)])
        rule = (count + 1) / (runs + 2)
        assert rates.rate(DRIFT) < rule + 1e-6
        if count > 1:
            assert rates.rate(DRIFT) == pytest.approx(rule, rel=0.02)


def test_what_a_law_has_to_find_it_has_to_find_in_each_run():
    """A law with a constant to find has the rate of one without, and is rarer in what each run says of it."""
    machine = Machine(MachineConfig().changed(seed=1, plate={'balls': 6}))
    run = machine.run(plan(6, 'interleaved', 1))
    causes = causes_in(search_of(run))
    assert causes.log_prior['frame_temperature_lag'] == pytest.approx(causes.log_prior['frame_temperature'])
    families = {one.name: one for one in search_of(run).readings.bank.families}
    assert log_found(families['frame_temperature']) == 0
    for name in ('frame_temperature', 'frame_temperature_lag'):
        assert causes.log_prior[name] + log_found(families[name]) == pytest.approx(families[name].log_prior)
    assert log_found(families['frame_temperature_lag']) == -SEARCHED


def test_causes_of_one_statement_are_told_together():
    """Two laws by which the probe moves with time are one cause of the cell; a slip of one run is told as such."""
    laws, slip = {DRIFT: 4.0, WARMUP: 4.0, SLIP: -4.0}, {DRIFT: -3.0, WARMUP: -3.0, SLIP: 9.0}
    runs = [CellRun(f'run {k}', run_of(**(slip if k == 3 else laws))) for k in range(6)]
    found = diagnose_cell(runs)
    cause, = found.properties
    assert {name for name, _ in cause.laws} == {DRIFT, WARMUP} and cause.bodies == ('frame',)
    assert cause.variables == ('time',) and cause.expected > 4.8
    once, = found.once
    assert once.name == SLIP and once.in_runs[3].p > 0.9
    assert found.level is Level.BAD and replace(found, properties=()).level is Level.DOUBTFUL
    assert replace(found, properties=(), once=()).level is Level.GOOD


def measured(seed, order='interleaved', **changes):
    """Return a run of a machine of 6 balls."""
    machine = Machine(MachineConfig().changed(seed=seed, plate={'balls': 6}, **changes))
    return machine.run(plan(6, order, seed))


def test_runs_that_do_not_belong_together_are_refused():
    """The same run twice, one in another unit, a table about another axis, a single run."""
    run = measured(1)
    with pytest.raises(InvalidData, match='expected several runs of a cell, found 1'):
        refuse_unlike([('a', run)])
    with pytest.raises(InvalidData, match='a and b: expected different runs, found the same ball centres'):
        refuse_unlike([('a', run), ('b', run)])
    with pytest.raises(InvalidData, match='begun and b: expected different runs, found the same ball centres'):
        refuse_unlike([('begun', run.take(list(range(30)))), ('b', run)])
    with pytest.raises(InvalidData, match='b: expected coordinates in the unit of a, found a plate whose radius'):
        refuse_unlike([('a', run), ('b', run.replace(centre=1e3 * run.centre, radius=1e3 * run.radius))])
    with pytest.raises(InvalidData, match='expected runs of a table about one axis'):
        refuse_unlike([('a', run), ('b', measured(1, placement={'axis': (1.0, 0.0, 0.0)}))])
