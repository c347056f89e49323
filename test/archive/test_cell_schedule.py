# SPDX-License-Identifier: Apache-2.0
"""When a cell calibrates itself and who holds it: over restarts, beside wrong clocks, in words."""

from datetime import UTC, datetime, timedelta

import pytest

from rosette_ros.archive.cell_schedule import CellSchedule
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import SCHEMA, heading
from rosette_ros.core.errors import CellError, InvalidData
from rosette_ros.core.model.model import Model

NOON = datetime(2026, 4, 12, 12, tzinfo=UTC)
HOUR = timedelta(hours=1)


@pytest.fixture
def archive(tmp_path):
    """Return an empty archive."""
    return RunArchive(tmp_path / 'archive', make=True)


def add_run(archive, when, cell='rosette', table='T', problem=''):
    """Add the row of a run."""
    archive.add([{**dict.fromkeys(SCHEMA.names), **heading(f'{when} {cell} {table}', 'p', 's', Model(), NOON, 'r',
                                                           problem=problem),
                  'measured_at': when, 'cell': cell, 'table_serial': table}])


def test_the_last_run_of_the_cell_counts(archive):
    """Not those of other cells and tables, nor problems, nor runs that a wrong clock dated ahead."""
    schedule = CellSchedule(archive, 'rosette', 'T', every=3600)
    assert schedule.due(NOON) == NOON
    for when, cell, table, problem in ((NOON - 3 * HOUR, 'rosette', 'T', ''), (NOON - HOUR, 'cell2', 'T', ''),
                                       (NOON - HOUR, 'rosette', 'other', ''), (NOON + HOUR, 'rosette', 'T', ''),
                                       (NOON - HOUR, 'rosette', 'T', 'truncated')):
        add_run(archive, when, cell, table, problem)
    assert schedule.due(NOON) == NOON - 2 * HOUR
    assert CellSchedule(archive, 'rosette', every=3600).due(NOON) == NOON
    assert CellSchedule(archive, 'rosette', 'T').due(NOON) is None


def test_an_attempt_counts_after_a_restart(archive):
    """What fails is not repeated before its time."""
    CellSchedule(archive, 'a/b', every=3600).attempt(NOON)
    assert CellSchedule(archive, 'a/b', every=3600).due(NOON) == NOON + HOUR
    assert CellSchedule(archive, 'other', every=3600).due(NOON) == NOON


def test_a_hold_outlives_a_restart(archive):
    """One at a time; who holds it may say why anew, and alone releases it."""
    schedule = CellSchedule(archive, 'rosette')
    schedule.take('Ada', 'cleans', NOON)
    schedule.take('Ada', 'measures', NOON + HOUR)
    again = CellSchedule(archive, 'rosette')
    assert str(again.hold) == 'Ada holds the cell since 2026-04-12 12:00 UTC: measures'
    for refused in (lambda: again.take('Ben', '', NOON), lambda: again.release('Ben')):
        with pytest.raises(CellError, match='Ada holds the cell since .*; Ada has to release it'):
            refused()
    again.release('Ada')
    assert CellSchedule(archive, 'rosette').hold is None


@pytest.mark.parametrize('text', ['', '[]', '{"schema": "rosette-cell/2"}', '{"schema": "rosette-cell/1"}',
                                  '{"schema": "rosette-cell/1", "attempted": "soon", "hold": null}'])
def test_a_wrong_file_is_refused(archive, text):
    """A hold that cannot be read may be one."""
    schedule = CellSchedule(archive, 'rosette')
    schedule.attempt(NOON)
    schedule.path.write_text(text)
    with pytest.raises(InvalidData, match='wanted JSON with "schema": "rosette-cell/1", times and a hold'):
        CellSchedule(archive, 'rosette')
