# SPDX-License-Identifier: Apache-2.0
"""Adding logs: only what is new, damaged logs are rows, and a cluster gives the plain loop's rows, bit for bit."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import dask
import fsspec
import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from plain_loop import PlainLoop

from benchmarks.archive_logs import made_run, make_logs
from rosette_ros.analysis import analyse, judge
from rosette_ros.archive import run_adding
from rosette_ros.archive.engines import DaskEngine
from rosette_ros.archive.run_adding import add_logs, find_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import STATED
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidConfig, InvalidData
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.json_output import CURVE_KEYS
from rosette_ros.words.verdict_words import verdict_text

pytestmark = pytest.mark.long

BALLS = 5
CREEP = Model().with_effect('plate_creep')


@pytest.fixture(scope='module')
def logs(tmp_path_factory):
    """Return a folder with three logs."""
    folder = tmp_path_factory.mktemp('logs')
    make_logs(folder, range(3), BALLS)
    return folder


@pytest.fixture(scope='module')
def filled(logs, tmp_path_factory):
    """Return an archive to which they were added by a plain loop."""
    archive = RunArchive(tmp_path_factory.mktemp('filled') / 'archive', make=True)
    added = add_logs(archive, find_logs([str(logs)]), PlainLoop())
    assert (added.found, added.new, added.copies, added.evaluated, added.problems) == (3, 3, 0, 3, 0)
    return archive


@pytest.fixture
def archive(filled, tmp_path):
    """Return a copy of it."""
    return RunArchive(shutil.copytree(filled.folder, tmp_path / 'archive'))


class NoEngine:
    """Nothing may be evaluated."""

    def results(self, function, items):
        """See Engine."""
        assert list(items) == []
        return iter(())


def rows(archive, *without):
    """Return all rows as text that tells every bit, without some columns."""
    return [{key: repr(value) for key, value in row.items() if key not in ('added_at', *without)}
            for row in archive.read_rows().to_pylist()]


def test_a_row_says_what_evaluate_says(logs, filled):
    """Curves and uncertainties to the last bit; the verdict; the truth within four U."""
    path = sorted(logs.iterdir())[0]
    [row] = filled.read_rows(where='path = ?', values=(str(path),)).to_pylist()
    run = open_run(path)
    fit = analyse(run)
    for place, key in enumerate(CURVE_KEYS):
        assert row[key] == fit.error_motions.values[:, place].tolist()
        assert row[f'U_{key}'] == (2 * fit.error_motions.u[:, place]).tolist()
    assert row['verdict'] == verdict_text(judge(run)).sentence
    assert (row['n'], row['readings'], row['plan'], row['simulated'], row['run_id']) == (
        BALLS, BALLS**2, 'as measured', True, 'run_000000')
    assert row['measured_at'] is None  # its times count from zero
    noise = 0.5e-6
    assert np.abs(np.array(row['ctz_m']) - fit.error_motions['ctz']).max() < noise


def test_what_is_known_is_not_read_again(logs, archive):
    """Neither in its place nor as a copy; another model is new."""
    files = len(archive.parts)
    assert add_logs(archive, find_logs([str(logs)]), NoEngine()).new == 0
    assert len(archive.parts) == files
    assert add_logs(archive, find_logs([str(logs)])[:1], PlainLoop(), CREEP).new == 1
    assert archive.read_rows().num_rows == 4


@pytest.mark.parametrize('share', [0, 0.5])
def test_rows_of_a_damaged_part_are_restored_by_adding_again(logs, archive, share):
    """Its logs are not known any more, and are evaluated as new ones; the others are not."""
    before = rows(archive)
    one = add_logs(archive, find_logs([str(logs)])[:1], PlainLoop(), CREEP)
    assert (one.new, archive.read_rows().num_rows) == (1, 4)
    broken = archive.parts[0]  # of some of the three logs
    lost = pq.read_metadata(broken).num_rows
    broken.write_bytes(broken.read_bytes()[:int(share * broken.stat().st_size)])
    again = RunArchive(archive.folder)
    assert again.read_rows().num_rows == 4 - lost
    assert add_logs(again, find_logs([str(logs)]), PlainLoop()).new == lost
    assert [row for row in rows(again) if row['model_hash'] == before[0]['model_hash']] == before


def test_what_was_stated_stays_under_another_model(logs, tmp_path):
    """Table, day and tolerances of a log that states none itself; a plain addition takes what the log states."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    found = find_logs([str(logs)])
    stated = Identity({'table.serial': 'RT-7', 'measured.begin': '2026-05-04', 'measured.end': '2026-05-05'})
    add_logs(archive, found[:2], PlainLoop(), identity=stated)
    add_logs(archive, found[:2], PlainLoop(), CREEP, keep_identity=True)
    assert {tuple(row.values()) for row in archive.read_rows(STATED, 'model_hash = ?', (CREEP.hash,)).to_pylist()} == {
        tuple(row.values()) for row in archive.read_rows(STATED, 'model_hash = ?', (Model().hash,)).to_pylist()}
    assert archive.read_rows(where="table_serial = 'RT-7'").num_rows == 4
    assert add_logs(archive, found[2:], PlainLoop(), CREEP, keep_identity=True).evaluated == 1, 'known by no row'


def test_a_copy_counts_once(logs, archive, tmp_path):
    """Under another name, as a file instead of a directory, touched, or through a URL."""
    copy = shutil.copytree(sorted(logs.iterdir())[0], tmp_path / 'more' / 'copied')
    shutil.copy(next(copy.glob('*.mcap')), tmp_path / 'more' / 'other_name.mcap')
    os.utime(next(copy.glob('*.mcap')))
    added = add_logs(archive, find_logs([f'file://{tmp_path}/more']), PlainLoop())
    assert (added.found, added.copies, added.new) == (2, 2, 0)


def test_another_version_evaluates_again(logs, archive, monkeypatch):
    """The newer row counts, there are not more."""
    for module in ('run_adding', 'run_row'):
        monkeypatch.setattr(f'rosette_ros.archive.{module}.__version__', 'new')
    assert add_logs(archive, find_logs([str(logs)])[:1], PlainLoop()).new == 1
    assert sorted(archive.read_rows(('version',)).column(0).to_pylist()) == ['0.1.0', '0.1.0', 'new']


def test_an_identity_names_the_devices(logs, tmp_path):
    """For logs that state none."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    stated = Identity({'table.serial': 'T 7', 'place.name': 'Hall 3', 'measured.begin': '2026-04-12'})
    add_logs(archive, find_logs([str(logs)])[:1], PlainLoop(), identity=stated)
    [row] = archive.read_rows().to_pylist()
    assert (row['table_serial'], row['place'], f'{row["measured_at"]:%Y-%m-%d}') == ('T 7', 'Hall 3', '2026-04-12')


def test_damaged_and_foreign_files_are_rows(logs, tmp_path):
    """One line each; a log that is whole later is no problem any more."""
    folder = tmp_path / 'bad'
    folder.mkdir()
    whole = next(sorted(logs.iterdir())[0].glob('*.mcap')).read_bytes()
    (folder / 'corrupt.mcap').write_bytes(b'\x89MCAP0\r\n' + bytes(1000))
    (folder / 'truncated.mcap').write_bytes(whole[:len(whole) // 3])
    (folder / 'foreign.csv').write_text('name,price\nbolt,3\n')
    (folder / 'empty.mcap').touch()
    (folder / 'notes.txt').write_text('no log at all')
    archive = RunArchive(tmp_path / 'archive', make=True)
    added = add_logs(archive, find_logs([str(folder)]), PlainLoop())
    assert (added.found, added.problems) == (4, 4)
    found = {Path(row['path']).name: row['problem'] for row in archive.read_rows().to_pylist()}
    assert set(found) == {'corrupt.mcap', 'truncated.mcap', 'foreign.csv', 'empty.mcap'}
    assert all(words and '\n' not in words and str(folder) not in words for words in found.values())
    assert 'is empty' in found['empty.mcap']
    assert 'expected' in found['foreign.csv'] and 'is not an MCAP file' in found['corrupt.mcap']
    (folder / 'truncated.mcap').write_bytes(whole)
    assert add_logs(archive, find_logs([str(folder)]), PlainLoop()).evaluated == 1
    assert sorted(row['problem'] == '' for row in archive.read_rows().to_pylist()) == [False] * 3 + [True]


def test_a_log_whose_files_are_gone_is_a_row(logs, tmp_path):
    """Its metadata is still there and says that it was one."""
    lost = Path(shutil.copytree(min(path for path in logs.iterdir() if path.is_dir()), tmp_path / 'logs' / 'lost'))
    for path in lost.glob('*.mcap'):
        path.unlink()
    archive = RunArchive(tmp_path / 'archive', make=True)
    added = add_logs(archive, find_logs([str(tmp_path / 'logs')]), PlainLoop())
    assert (added.found, added.problems) == (1, 1)
    [row] = archive.read_rows(('path', 'problem')).to_pylist()
    assert row['path'] == str(lost)
    assert 'metadata.yaml: names run_000000_0.mcap, which is missing' in row['problem']


def test_a_file_that_cannot_be_read_is_tried_again(archive, tmp_path, monkeypatch):
    """It may be mounted tomorrow."""
    (tmp_path / 'gone').mkdir()
    write_csv(made_run(9, BALLS), tmp_path / 'gone' / 'a.csv')
    found = find_logs([str(tmp_path / 'gone')])
    (tmp_path / 'gone' / 'a.csv').rename(tmp_path / 'a.csv')
    for _ in range(2):
        assert add_logs(archive, found, PlainLoop()).problems == 1
    [row] = archive.read_rows(where="problem <> ''").to_pylist()
    assert row['problem'].startswith('expected a log that can be read, found: No such file')
    (tmp_path / 'a.csv').rename(tmp_path / 'gone' / 'a.csv')
    assert add_logs(archive, found, PlainLoop()).evaluated == 1
    assert archive.read_rows(where="problem <> ''").num_rows == 0


def test_logs_behind_a_url(logs, archive, tmp_path):
    """What fsspec knows is read as files are."""
    memory = fsspec.filesystem('memory')
    write_csv(made_run(10, BALLS), tmp_path / 'a.csv')
    memory.pipe('/cell/a.csv', (tmp_path / 'a.csv').read_bytes())
    for path in sorted(logs.iterdir())[1].iterdir():
        memory.pipe(f'/cell/run/{path.name}', path.read_bytes())
    added = add_logs(archive, find_logs(['memory://cell']), PlainLoop())
    assert (added.found, added.copies, added.evaluated) == (2, 1, 1)
    [row] = archive.read_rows(where="starts_with(path, 'memory')").to_pylist()
    assert (row['path'], row['n']) == ('memory:///cell/a.csv', BALLS)
    with pytest.raises(InvalidData, match='nosuch://x: expected a folder of logs, or a log, found: Protocol not known'):
        find_logs(['nosuch://x'])
    with pytest.raises(InvalidData, match='expected a folder of logs, or a log, found: no such file or folder'):
        find_logs([str(tmp_path / 'nothing')])


def test_loose_files_are_logs_of_their_own(logs, tmp_path):
    """Those that rosbag2 has numbered are parts of one, whatever their folder is called; the oldest may be gone."""
    for log in logs.iterdir():
        shutil.copy(next(log.glob('*.mcap')), tmp_path / f'{log.name}.mcap')
    (tmp_path / 'run').mkdir()
    for part in range(2):
        shutil.copy(tmp_path / f'run_00000{part}.mcap', tmp_path / 'run' / f'rolling_{part + 9}.mcap')
    found = find_logs([str(tmp_path), str(tmp_path / 'run')])
    assert sorted((Path(log.path).name, len(log.files)) for log in found) == [
        ('run', 2), *((f'run_00000{number}.mcap', 1) for number in range(3))]


def test_what_is_no_log_is_passed_over(logs, tmp_path):
    """Pipes, devices, links without an end, hidden files, trash; a packed log is a row that says how to unpack it."""
    for name in ('pipe.mcap', '.Trash-1000/x.mcap', '__MACOSX/._x.csv', '$RECYCLE.BIN/x.csv', '._x.csv',
                 '$Recycle.Bin/y.csv', '#recycle/x.mcap', '@eaDir/x.csv', '~$x.csv'):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text('x')
    (tmp_path / 'pipe.mcap').unlink()
    os.mkfifo(tmp_path / 'pipe.mcap')
    for name, target in (('device.mcap', '/dev/zero'), ('none.mcap', 'nowhere'), ('loop.mcap', 'loop.mcap'),
                         ('up', '.'), ('linked.mcap', next(logs.glob('*/*.mcap')))):
        (tmp_path / name).symlink_to(target)
    (tmp_path / 'packed').mkdir()
    (tmp_path / 'packed' / 'x_0.mcap.zstd').write_bytes(b'x')
    assert [Path(log.path).name for log in find_logs([str(tmp_path)])] == [tmp_path.name, 'packed']
    with pytest.raises(InvalidData, match='pipe.mcap: expected a folder of logs, or a log, found a device, a pipe'):
        find_logs([str(tmp_path / 'pipe.mcap')])


def test_two_colons_in_a_name_are_no_chain_of_urls(logs, tmp_path, monkeypatch):
    """By its absolute and its relative path; content is identified there, too."""
    shutil.copytree(logs, tmp_path / 'shift::night')
    monkeypatch.chdir(tmp_path)
    for place in ('shift::night', str(tmp_path / 'shift::night')):
        found = find_logs([place])
        assert len(found) == 3 and not [problem for _, digest, problem in run_adding.digests(found) if problem]


def test_an_interruption_keeps_what_is_done(logs, tmp_path):
    """And the next addition does the rest."""
    archive = RunArchive(tmp_path / 'archive', make=True)

    def interrupt(added, left):
        if left == 1:
            raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        add_logs(archive, find_logs([str(logs)]), PlainLoop(), on_progress=interrupt)
    assert archive.read_rows().num_rows == 2
    assert add_logs(archive, find_logs([str(logs)]), PlainLoop()).new == 1


def test_a_read_only_archive_is_refused_before_anything_is_evaluated(logs, archive, monkeypatch):
    """In one line."""
    real = os.open

    def read_only(path, flags, *mode, **more):
        if flags & os.O_CREAT:
            raise OSError(30, 'Read-only file system')
        return real(path, flags, *mode, **more)
    monkeypatch.setattr(os, 'open', read_only)
    with pytest.raises(InvalidData, match='expected an archive that can be written, found: Read-only file system'):
        add_logs(archive, find_logs([str(logs)]), NoEngine(), CREEP)


def test_an_error_of_the_program_is_a_row(logs, tmp_path, monkeypatch):
    """It ends the evaluation of one log only."""
    monkeypatch.setattr(run_adding, 'find', lambda run, model: 1 / 0)
    archive = RunArchive(tmp_path / 'archive', make=True)
    assert add_logs(archive, find_logs([str(logs)])[:1], PlainLoop()).problems == 1
    assert archive.read_rows(('problem',)).to_pydict() == {'problem': [
        "an error of the program, please report it: division by zero"]}


def test_no_scheduler_is_told_in_one_line(logs, archive, monkeypatch):
    """After ten seconds; here after less."""
    monkeypatch.setattr('rosette_ros.archive.engines.PATIENCE', 0.5)
    with (DaskEngine(f'tcp://127.0.0.1:{free_port()}') as engine,
          pytest.raises(InvalidConfig, match='expected a Dask scheduler such as tcp://host:8786, found: ')):
        add_logs(archive, find_logs([str(logs)]), engine, CREEP)


@pytest.mark.parametrize('address', ['foo', 'tcp', '/tmp/scheduler'])
def test_a_scheduler_without_a_port_is_told_in_one_line(address):
    with pytest.raises(InvalidConfig, match=f'--scheduler {address}: expected the address of a Dask scheduler such as '
                                            'tcp://host:8786, found one without a port'):
        DaskEngine(address)


@pytest.mark.filterwarnings('error::UserWarning')
def test_a_second_cluster_on_this_computer_is_nothing_to_warn_of():
    """Both have ports of their own."""
    with DaskEngine(workers=1) as first, DaskEngine(workers=1) as second:
        assert [engine.client.submit(abs, -1).result() for engine in (first, second)] == [1, 1]


def test_processes_of_this_computer_listen_on_loopback_only(logs, filled, tmp_path):
    """Scheduler and worker; their rows are those of the plain loop, to the last bit."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    own, listening = psutil.Process(), set()

    def look(added, left):
        for process in (own, *own.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                listening.update(one.laddr.ip for one in process.net_connections('inet')
                                 if one.status == psutil.CONN_LISTEN)
    before = {one.laddr.ip for one in own.net_connections('inet') if one.status == psutil.CONN_LISTEN}
    with DaskEngine(workers=1) as engine:
        add_logs(archive, find_logs([str(logs)]), engine, on_progress=look)
    assert listening - before == {'127.0.0.1'} - before
    assert rows(archive) == rows(filled)


def test_a_killed_worker_costs_time_only(logs, filled, tmp_path):
    """Two workers of a scheduler, one killed in the middle: the rows of the plain loop, to the last bit."""
    more = shutil.copytree(logs, tmp_path / 'logs')
    make_logs(more, range(3, 6), BALLS)
    file = tmp_path / 'scheduler.json'
    dask, common = [sys.executable, '-m', 'dask'], ['--no-dashboard', '--scheduler-file', str(file)]
    started = [subprocess.Popen([*dask, 'scheduler', '--host', '127.0.0.1', '--port', '0', *common], cwd=tmp_path)]
    try:
        started += [subprocess.Popen([*dask, 'worker', '--no-nanny', '--nthreads', '1', *common], cwd=tmp_path)
                    for _ in range(2)]
        while not file.exists() or not file.read_text().endswith('}'):
            assert started[0].poll() is None
            time.sleep(0.1)
        address = json.loads(file.read_text())['address']
        archive = RunArchive(tmp_path / 'archive', make=True)

        def kill(added, left):
            if added.new == 2:
                started[1].send_signal(signal.SIGKILL)
        with DaskEngine(address) as engine:
            engine.client.wait_for_workers(2, timeout=300)
            added = add_logs(archive, find_logs([str(more)]), engine, on_progress=kill)
        assert (added.evaluated, added.problems, started[1].wait(60)) == (6, 0, -signal.SIGKILL)
    finally:
        for process in started:
            process.kill()
            process.wait()
    plain = RunArchive(tmp_path / 'plain', make=True)
    add_logs(plain, find_logs([str(more)]), PlainLoop())
    for one, other in zip(rows(archive), rows(plain), strict=True):
        assert {key: (value, other[key]) for key, value in one.items() if value != other[key]} == {}
    assert rows(plain, 'path', 'stamp')[:3] == rows(filled, 'path', 'stamp')


def free_port():
    """Return a port on which nothing listens."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


def test_settings_of_dask_that_are_none_are_told_in_one_line():
    """They come from the environment or a file of another program."""
    with dask.config.set({'distributed.comm.timeouts.connect': 'abc'}), DaskEngine(workers=1) as engine, pytest.raises(
            InvalidConfig, match="Dask: expected workers on this computer, found none: .*'Invalid time unit: abc"):
        _ = engine.client
