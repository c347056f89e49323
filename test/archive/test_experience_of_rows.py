# SPDX-License-Identifier: Apache-2.0
"""The experience of a cell from what the rows of its runs keep."""

import datetime

import numpy as np
import pytest

from rosette_ros.analysis import analyse, find
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import evaluation_row, heading
from rosette_ros.archive.stored_causes import causes_of_text, causes_text, experience_of_cell
from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.joint.run_causes import causes_in
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig

DRIFT = [{'kind': 'frame_drift', 'rate_um_per_h': [2.0, 0.0, 1.2]}]


@pytest.fixture(scope='module')
def measured():
    """Return a run of a cell that drifts, the Diagnosis of it, and what it says of causes."""
    run = Machine(MachineConfig().changed(seed=1, plate={'balls': 6}, hidden=DRIFT)).run(plan(6, 'interleaved', 1))
    return run, find(run), causes_in(search_of(run))


@pytest.fixture(scope='module')
def rows(measured):
    """Return rows of three runs of cell a, table T1, that say the same."""
    run, found, causes = measured
    row = evaluation_row(analyse(run), found, cell='a', causes=causes_text(causes))
    return [{**heading(f'{one}' * 64, f'/logs/{one}', '', Model(), datetime.datetime.now(datetime.UTC), f'run {one}'),
             **row, 'table_serial': 'T1'} for one in (1, 2, 3)]


def test_a_text_keeps_what_a_run_says(measured):
    """Hypotheses, probabilities and shapes, to the decimals that are kept."""
    *_, causes = measured
    got = causes_of_text(causes_text(causes))
    assert got.hypotheses == causes.hypotheses and got.silent == causes.silent
    assert np.abs(got.p - causes.p).max() < 0.01
    assert got.shapes.keys() == causes.shapes.keys()


def test_experience_of_rows(rows, tmp_path):
    """Of the cell by its name or that of its table; nothing is searched."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    archive.add(rows)
    for question in ({'cell': 'a'}, {'table': 'T1'}, {'cell': 'a', 'table': 'T1'}):
        taught = experience_of_cell(archive, **question)
        assert taught.runs == 3 and taught.table == 'T1' and taught.cell == 'a'
        assert taught.by_name['frame_drift'].again > 0.9


def test_rows_that_teach_nothing_are_refused(rows, tmp_path):
    """Too few, and of several tables."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    archive.add([*rows[:2], {**rows[2], 'table_serial': 'T2'}])
    with pytest.raises(InvalidData, match='expected at least two runs of table T2 .* of causes, found 1 run'):
        experience_of_cell(archive, table='T2')
    with pytest.raises(InvalidData, match='archive: cell: expected one of a, found .b.'):
        experience_of_cell(archive, cell='b')
    with pytest.raises(InvalidData, match='archive: table: expected one of T1, T2, found .T3.'):
        experience_of_cell(archive, table='T3')
    with pytest.raises(InvalidData, match='expected runs of one table, found T1, T2 in cell a; name one with --table'):
        experience_of_cell(archive, cell='a')
    assert experience_of_cell(archive, table='T1').runs == 2
