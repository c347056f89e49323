# SPDX-License-Identifier: Apache-2.0
"""The causes of a cell: rates that are integrated, sizes and constants in common, events, runs that say nothing."""

import math

import numpy as np
import pytest

from rosette_ros.core.diagnosis.log_evidence import SIZES
from rosette_ros.core.joint.cell_diagnosis import CellRun, diagnose_cell, refuse_unlike
from rosette_ros.core.joint.cell_rates import COMES_AGAIN, CellRates
from rosette_ros.core.joint.run_causes import CauseShape, RunCauses
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
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
    by_chance = (1 - 2 * COMES_AGAIN * PRIOR) * np.prod(1 + elsewhere / (1 - elsewhere) * factor)
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


def test_constants_are_those_of_all_runs_together():
    """Where the runs agree the law is likelier, and its constant better known than by one."""
    same = [run_of({WARMUP: shape(1000, 1.0)}, **{WARMUP: 3.0}) for _ in range(6)]
    other = [run_of({WARMUP: shape(150 * 2.3**k, 0.3)}, **{WARMUP: 3.0}) for k in range(6)]
    assert CellRates(same).again(WARMUP) > CellRates(other).again(WARMUP)
    values, p = CellRates(same).common(WARMUP, 'tau')
    mean = p @ np.log(values)
    assert math.exp(mean) == pytest.approx(1000, rel=0.05)
    assert np.sqrt(p @ (np.log(values) - mean)**2) < 0.6


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
    with pytest.raises(InvalidData, match='b: expected coordinates in the unit of a, found a plate whose radius'):
        refuse_unlike([('a', run), ('b', run.replace(centre=1e3 * run.centre, radius=1e3 * run.radius))])
    with pytest.raises(InvalidData, match='expected runs of a table about one axis'):
        refuse_unlike([('a', run), ('b', measured(1, placement={'axis': (1.0, 0.0, 0.0)}))])
