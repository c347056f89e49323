# SPDX-License-Identifier: Apache-2.0
"""The page of several runs as one."""

import functools

import numpy as np
import pytest

from rosette_ros.analysis import evaluate_jointly
from rosette_ros.core.joint.cell_diagnosis import diagnose_cell, searched
from rosette_ros.core.joint.conclusion import JointOutcome, conclude
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.identity_file import Identity
from rosette_ros.presentation.cell_results import causes_of_runs
from rosette_ros.presentation.joint_results import joint_json, joint_rows
from rosette_ros.presentation.plots.cell_plots import causes_against_runs
from rosette_ros.presentation.report.joint_page import joint_html, joint_pictures, joint_tables
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.result_words import conclusion_text


@functools.cache
def simulated_run(order='random', seed=1):
    """Return a run of six balls."""
    return Machine(MachineConfig().changed(seed=seed, plate={'balls': 6})).run(plan(6, order, seed), run_id=order)


def joint(*runs, **declared):
    """Return the JointResult of Runs."""
    return evaluate_jointly(list(map(Readings.of, runs)), declared)


@pytest.mark.usefixtures('sketched')
def test_the_page_shows_curves_reversal_knowledge_and_tests():
    """Six curves of both senses, the six reversal curves with their means, p of each sharing."""
    result = joint(simulated_run('there_and_back'), simulated_run('diagonal'))
    assert list(joint_pictures(result)) == ['curves', 'reversal']
    page = joint_html(result, command='rosette report A B --joint')
    for words in (' in a laboratory environment', 'the reversal of all six curves, with its means',
                  'conditions of validity</h2>', 'once-per-turn part of (ctx, cty): eccentricity', 'p-value',
                  'Means of the reversal curves',
                  'error motions of the table', 'the readings are those of a simulated CMM',
                  'rosette report A B --joint'):
        assert words in page, words
    tables = {table.name: table for table in joint_tables(result, Identity())}
    assert len(tables['means'].rows) == 6
    mean = [float(value) for value in tables['means'].columns[1].values]
    assert np.allclose(mean, result.reversals[0].mean)
    assert len(tables['plate'].rows) == 6


@pytest.mark.usefixtures('sketched')
def test_the_conclusion_follows_the_tests():
    """Good where all agrees; doubtful where something is not shared; bad where a declaration is contradicted."""
    first, other = (simulated_run('diagonal', seed) for seed in (1, 2))
    assert conclude(joint(first, simulated_run())).level == 'good'
    part = conclude(joint(first, other))
    assert part.outcome is JointOutcome.IN_PART
    assert 'The 2 runs fit one model without: ' in conclusion_text(part).sentence
    bad = conclude(joint(first, other, plate=('1', '1'), clamping=('1', '2'), table=('1', '2')))
    assert (bad.level, bad.outcome) == ('bad', JointOutcome.CONTRADICTED) and 'plate' in bad.items
    assert 'contradict what was declared the same: ball centre deviations' in conclusion_text(bad).sentence
    unknown = conclude(joint(first.replace(repeatability=None)))
    assert conclusion_text(conclude(joint(first))).sentence.startswith('The run fits one model')
    assert dict(joint_rows(joint(first)))['Known'] == 'beyond what one run knows: nothing; it is one run'
    one = joint_json(joint(first, other, plate=('1', '2')))['tests']
    assert all((test['f'] is None) == (test['p'] is None) for test in one)
    assert (unknown.level, unknown.outcome) == ('doubtful', JointOutcome.UNKNOWN)


@functools.cache
def drifting_cell():
    """Return two runs of a machine whose probe drifts, and what they say of their cell."""
    hidden = [{'kind': 'frame_drift', 'rate_um_per_h': [2.5, 0.0, 1.5]}]
    runs = [Machine(MachineConfig().changed(seed=seed, plate={'balls': 6}, hidden=hidden)).run(
        plan(6, order, seed), run_id=order) for seed, order in ((1, 'random'), (2, 'interleaved'))]
    return runs, diagnose_cell([searched(run.run_id, run, Model()) for run in runs])


@pytest.mark.usefixtures('sketched')
def test_the_page_shows_causes_against_runs():
    """In words, as dots with their sizes, and in a table with U; nothing of it where the runs are of no one cell."""
    runs, cell = drifting_cell()
    result = joint(*runs)
    page = joint_html(result, cell=cell)
    for words in ('Causes against runs', 'The probe moves with time', 'id="figure-causes"', 'The causes in each run'):
        assert words in page, words
    assert 'Causes against runs' not in joint_html(result)
    assert 'cell_runs' in [table.name for table in joint_tables(result, Identity(), cell)]


def test_dots_are_those_of_the_table():
    """The same record as in the studio: probability in the cell, size and U of each run that has the cause."""
    _, cell = drifting_cell()
    found = causes_of_runs(cell)
    assert found.causes[0] == 'linear probe drift' and found.runs == ('random', 'interleaved')
    dots = [one for one in found.dots if one.cause == 0]
    for dot, each in zip(dots, cell.properties[0].in_runs, strict=True):
        assert (dot.probability, dot.size, dot.u) == (each.p, each.size, each.u) and each.p > 0.9
    panel = causes_against_runs(found).axes[0]
    assert next(one.get_text() for one in panel.get_yticklabels()) == 'linear probe drift'
    named = panel.collections[-1]
    assert np.allclose(np.asarray(named.get_offsets())[:, 0], [one.run + 1 for one in found.dots if one.size])
    assert np.allclose(np.asarray(named.get_array()), [1e6 * one.size for one in found.dots if one.size])
    assert len(panel.texts) == len(named.get_offsets()) and ' ± ' in panel.texts[0].get_text()
