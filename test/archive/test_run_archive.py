# SPDX-License-Identifier: Apache-2.0
"""Archives on the disk: rows come back bit for bit, several writers lose nothing, what is no archive is refused."""

import datetime
import errno
import json
import os
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rosette_ros.analysis import analyse, find
from rosette_ros.archive import run_archive
from rosette_ros.archive.run_archive import MARK, RunArchive
from rosette_ros.archive.run_row import SCHEMA, evaluation_row, heading, table_of
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io import text_file
from rosette_ros.presentation.report.provenance import open_source

LOG = Path(__file__).parents[1] / 'golden' / 'logs' / 'log_left_out_n7_column'
NOON = datetime.datetime(2026, 4, 12, 12, tzinfo=datetime.UTC)


@pytest.fixture(scope='module')
def row():
    """Return the row of a golden log."""
    run, source = open_source(LOG)
    return {**heading('ab' * 32, '/logs/a', 's', Model(), NOON, run.run_id),
            **evaluation_row(analyse(run), find(run), source, 'rosette')}


@pytest.fixture
def archive(tmp_path):
    """Return an empty archive."""
    return RunArchive(tmp_path / 'archive', make=True)


def test_a_row_comes_back_to_the_last_bit(archive, row):
    """Every column of the schema is filled, and reads as it was written."""
    assert set(row) == set(SCHEMA.names)
    archive.add([row])
    table = archive.read_rows()
    assert table.equals(table_of([row]))
    assert {name: value for name, value in table.to_pylist()[0].items() if value != row[name]} == {}


def test_an_empty_archive_has_no_rows(archive):
    """Of the same columns."""
    assert archive.read_rows(['run_id', 'ctx_m']).to_pydict() == {'run_id': [], 'ctx_m': []}


@pytest.mark.parametrize('kind', ['pipe', 'socket', 'device'])
def test_what_is_no_file_among_the_parts_is_named_and_left_out(archive, row, kind, caplog, monkeypatch):
    """Nothing waits for the other end of a pipe; it is named once."""
    archive.add([row])
    monkeypatch.chdir(archive.folder / 'parts')  # the path of a socket is short
    path = archive.folder / 'parts' / f'{kind}.parquet'
    if kind == 'pipe':
        os.mkfifo(path)
    elif kind == 'socket':
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    else:
        path.symlink_to('/dev/zero')
    assert [path for path in archive.parts if path.stem == kind] == []
    assert archive.read_rows().num_rows == 1
    assert archive.join_small() == ''
    assert [one.getMessage() for one in caplog.records] == [
        f'{path}: left out: expected a file, found a device or a pipe']


def test_of_two_rows_of_a_run_the_later_counts(archive, row):
    """Under one model; another model, another run of the same log are further rows."""
    later = NOON + datetime.timedelta(1)
    archive.add([{**row, 'added_at': later, 'version': '2'}])
    archive.add([{**row, 'version': '1'}, {**row, 'model_hash': 'm'}, {**row, 'run_id': 'other'}])
    found = archive.read_rows(['run_id', 'model_hash', 'version']).to_pylist()
    assert [(one['run_id'] == 'other', one['model_hash'] == 'm') for one in found].count((False, False)) == 1
    assert sorted(one['version'] for one in found) == sorted(['2', row['version'], row['version']])


def test_a_problem_counts_until_the_file_is_read(archive, row):
    """A log that was still being written is no problem when it is whole."""
    bad = heading('cd' * 32, '/logs/a', 's', Model(), NOON, problem='truncated')
    archive.add([bad])
    assert archive.read_rows(['problem']).to_pydict() == {'problem': ['truncated']}
    archive.add([{**row, 'added_at': NOON + datetime.timedelta(1)}])
    assert archive.read_rows(['problem']).to_pydict() == {'problem': ['']}


def test_several_writers_lose_nothing(archive, row, monkeypatch):
    """Also while one of them joins small files and others read."""
    monkeypatch.setattr(run_archive, 'MOST_SMALL', 3)

    def write(writer):
        own = RunArchive(archive.folder, make=True)
        for count in range(4):
            own.add([{**row, 'run_id': f'{writer}.{count}'}])
            own.join_small()
            assert own.read_rows(['run_id']).num_rows > count
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(write, range(3)))
    assert set(archive.read_rows(['run_id']).column(0).to_pylist()) == {f'{a}.{b}' for a in range(3) for b in range(4)}
    assert len(archive.parts) <= 8


def test_a_join_killed_before_it_removes_files_repeats_no_row(archive, row, monkeypatch):
    """The joined file and those that it is made of are there."""
    monkeypatch.setattr(run_archive, 'MOST_SMALL', 1)
    for count in range(3):
        archive.add([{**row, 'run_id': f'{count}'}])
    monkeypatch.setattr(Path, 'unlink', lambda path, missing_ok=False: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        archive.join_small()
    assert archive.read_rows(['run_id']).column(0).to_pylist() == ['0', '1', '2']


def test_a_full_disk_leaves_what_was_there(archive, row, monkeypatch):
    """One line says so, and no part of a file stays."""
    archive.add([row])

    def full(file):
        raise OSError(errno.ENOSPC, 'No space left on device')
    monkeypatch.setattr(text_file.os, 'fsync', full)
    with pytest.raises(InvalidData, match='cannot be written: No space left on device'):
        archive.add([{**row, 'run_id': 'other'}])
    assert archive.read_rows(['run_id']).num_rows == len(list((archive.folder / 'parts').iterdir())) == 1


@pytest.mark.parametrize(('text', 'words'), [
    (json.dumps({'schema': 'rosette-archive/2'}), "expected an archive of rosette-archive/1, found "
                                                  "'rosette-archive/2'"),
    ('[]', 'expected JSON with "schema": "rosette-archive/1"'),
    (None, f'expected an archive, found a folder without {MARK}')])
def test_what_is_no_archive_is_refused(archive, text, words):
    """Of a newer version, damaged, or something else."""
    mark = archive.folder / MARK
    mark.unlink()
    if text is not None:
        mark.write_text(text)
    with pytest.raises(InvalidData) as error:
        RunArchive(archive.folder)
    assert words in str(error.value)


def test_a_folder_of_other_files_is_not_made_an_archive(tmp_path):
    """It may be a folder of logs that was named in the wrong place."""
    (tmp_path / 'run.csv').touch()
    with pytest.raises(InvalidData, match='expected an archive or an empty folder, found a folder of other files'):
        RunArchive(tmp_path, make=True)


@pytest.mark.parametrize('damage', [lambda data: b'', lambda data: data[:len(data) // 2],
                                    lambda data: data[:4] + b'\xff' * (len(data) // 2) + data[4 + len(data) // 2:]])
def test_a_damaged_part_is_named_and_the_others_stay(archive, row, damage, caplog):
    """Cut to nothing, to half, overwritten in the middle; it is named once, with the remedy; adding goes on."""
    broken = archive.add([row])
    archive.add([{**row, 'run_id': 'other', 'log_sha256': 'cd' * 32}])
    broken.write_bytes(damage(broken.read_bytes()))
    found = RunArchive(archive.folder)
    for _ in range(2):
        assert [one['run_id'] for one in found.read_rows().to_pylist()] == ['other']
    told, = (record.getMessage() for record in caplog.records)
    assert told.startswith(f'{broken}: left out, as it is damaged (')
    assert f'`rosette archive add LOGS --into {archive.folder}` restores them, then delete this file' in told
    found.add([row])
    assert found.join_small() == '' and found.read_rows().num_rows == 2


def emptied(table, name):
    return table.set_column(table.column_names.index(name), name, pa.nulls(len(table), table.schema.field(name).type))


def dated(table, moment):
    moments = pa.array([moment] * len(table), table.schema.field('added_at').type)
    return table.set_column(table.column_names.index('added_at'), 'added_at', moments)


@pytest.mark.parametrize(('change', 'words'), [
    (lambda table: table.set_column(table.column_names.index('effects'), 'effects', pa.array(['boo'] * len(table))),
     'its column effects is string, not '),
    (lambda table: table.set_column(table.column_names.index('added_at'), 'added_at', pa.array(['zzz'] * len(table))),
     'its column added_at is string, not timestamp'),
    (lambda table: table.drop_columns(['problem']), 'it has no column problem'),
    (lambda table: emptied(table, 'run_id'), 'its column run_id is empty in 1 row'),
    (lambda table: emptied(table, 'added_at'), 'its column added_at is empty in 1 row'),
    (lambda table: dated(table, datetime.datetime(9999, 1, 1, tzinfo=datetime.UTC)), 'its rows were added on a day'),
    (lambda table: dated(table, datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=2)),
     'its rows were added on a day that has not come')])
def test_a_part_with_another_type_of_a_column_is_named(archive, row, change, words, caplog):
    """By column and type, or what is in it: it would stand before a sound row of the same run. The others stay."""
    other = archive.add([row])
    archive.add([{**row, 'run_id': 'other', 'log_sha256': 'cd' * 32}])
    pq.write_table(change(pq.read_table(other)), other)
    assert RunArchive(archive.folder).read_rows(('run_id',)).to_pylist() == [{'run_id': 'other'}]
    assert f'{other}: left out, as it is damaged ({words}' in caplog.text
