# SPDX-License-Identifier: Apache-2.0
"""rosette archive: what a person reads of bad logs, bad archives and a full disk."""

import contextlib
import json
import resource
import sys
import time

import pytest
from plain_loop import PlainLoop

from benchmarks.archive_logs import make_logs
from rosette_ros.archive.run_archive import MARK, PARTS, RunArchive
from rosette_ros.cli import archive
from rosette_ros.core.model.model import Model
from rosette_ros.invocation import program
from rosette_ros.io.model_file import write_model

BALLS = 5


@pytest.fixture
def in_this_process(monkeypatch):
    """Let logs be evaluated without processes of their own."""
    monkeypatch.setattr(archive, 'engine_of', lambda *_: contextlib.nullcontext(PlainLoop()))


@pytest.fixture
def logs(tmp_path):
    """Return a folder with a sound log, a corrupt, a truncated and a foreign file."""
    folder = tmp_path / 'logs'
    [whole] = make_logs(folder, range(1), BALLS)
    data = next(whole.glob('*.mcap')).read_bytes()
    for name, content in (('corrupt.mcap', b'\x89MCAP0\r\n' + bytes(1000)), ('truncated.mcap', data[:len(data) // 3]),
                          ('foreign.csv', b'name,price\nbolt,3\n')):
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture
def small_files(monkeypatch):
    """Let no file grow beyond some bytes, as on a full disk; byte code would be cut, and stay so."""
    monkeypatch.setattr(sys, 'dont_write_bytecode', True)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (512, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_logs_that_cannot_be_read_are_counted_and_listed(logs, in_this_process, rosette, tmp_path):
    """The sound one is added; each of the others has a line that says what was wanted."""
    archive = tmp_path / 'my archive'
    made = rosette('archive', 'add', logs, '--into', archive)
    assert made.code == 1
    assert made.out == (f"4 logs found: 0 known, 0 copies, 4 new\n1 evaluated, 3 not: {program()} archive query "
                        f"'{archive}' --problems\n")
    told = rosette('archive', 'query', archive, '--problems', '--json')
    problems = {row['path'].rpartition('/')[2]: row['problem'] for row in json.loads(told.out)['rows']}
    assert set(problems) == {'corrupt.mcap', 'truncated.mcap', 'foreign.csv'}
    assert all('expected' in words for words in problems.values())
    again = rosette('archive', 'add', logs, '--into', archive, '--json')
    counts = json.loads(again.out)
    assert (again.code, counts['found'], counts['new']) == (0, 4, 0), 'the same content is not read again'


@pytest.mark.parametrize(('mark', 'words'), [
    ('{"schema": "rosette-archive/2"}', "expected an archive of rosette-archive/1, found 'rosette-archive/2'; use a "
                                        'version of rosette that knows it'),
    ('{', 'expected JSON with "schema": "rosette-archive/1", found something else')])
def test_another_archive_is_refused(logs, in_this_process, refused, tmp_path, mark, words):
    """A newer one, and one whose mark is damaged; nothing is written."""
    archive = tmp_path / 'archive'
    (archive / PARTS).mkdir(parents=True)
    (archive / MARK).write_text(mark)
    model = tmp_path / 'model.yaml'
    write_model(Model().with_effect('frame_drift'), model)
    for verb in (('add', logs, '--into', archive), ('query', archive), ('reanalyse', archive, '--model', model)):
        assert words in refused('archive', *verb)
    assert list((archive / PARTS).iterdir()) == []


def test_a_full_disk_is_one_line_and_loses_nothing(logs, in_this_process, rosette, refused, tmp_path, small_files):
    """The archive stays as it was; once there is place again, the same command goes on."""
    archive = tmp_path / 'archive'
    line = refused('archive', 'add', logs, '--into', archive)
    assert str(archive) in line and 'File too large' in line
    assert RunArchive(archive).parts == []
    resource.setrlimit(resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)[1:] * 2)
    assert '1 evaluated' in rosette('archive', 'add', logs, '--into', archive).out


def test_an_archive_elsewhere_is_refused_before_any_work(logs, in_this_process, rosette, refused, tmp_path,
                                                         monkeypatch):
    """By every verb alike, and nothing is made here; what is here is found by any of its names."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('HOME', str(tmp_path))
    before = sorted(tmp_path.iterdir())
    for place in ('s3://bucket/plant', 'gs:', 'gs://bucket', 'nas:/plant', 'file://nas/plant', 'memory://x',
                  'C:\\plant', 'user@host:plant'):
        for verb in (('add', 'nowhere', '--into', place), ('query', place)):
            assert f'{place}: expected a folder of this computer as archive, found a place elsewhere' in refused(
                'archive', *verb)
    assert sorted(tmp_path.iterdir()) == before
    for place in ('~/home [1]', f'file://{tmp_path}/url*', f'file://{tmp_path}/sp%20dir', f'{tmp_path}/a?b',
                  './with:colon', "it's"):
        assert '1 evaluated' in rosette('archive', 'add', logs, '--into', place).out
        assert json.loads(rosette('archive', 'query', place, '--json').out)['rows'], place
    assert {'home [1]', 'url*', 'sp dir', 'a?b', 'with:colon', "it's"} < {path.name for path in tmp_path.iterdir()}


def test_no_archive_is_made_among_other_files(logs, in_this_process, refused, tmp_path):
    """And a question to a folder that is none names the command that makes one."""
    assert 'expected an archive or an empty folder, found a folder of other files' in refused(
        'archive', 'add', logs, '--into', logs)
    assert 'rosette archive add FOLDER --into' in refused('archive', 'query', tmp_path)


def test_an_archive_is_no_folder_of_logs(logs, in_this_process, rosette, refused, tmp_path):
    """It is said, and no further archive is made."""
    archive, other = tmp_path / 'archive', tmp_path / 'other'
    assert rosette('archive', 'add', logs, '--into', archive).code == 1
    assert refused('archive', 'add', archive, '--into', other) == (
        f'rosette: {archive}: expected a folder of logs, or a log, found an archive\n')
    assert not other.exists()


@pytest.mark.parametrize(('sql', 'words'), [
    ('selec * from runs', 'syntax error at or near "selec"'), ('select * from run', 'Did you mean "runs"?'),
    ('select ctx_range from runs', 'Candidate bindings: "ctx_m"')])
def test_wrong_sql_is_told_what_exists(logs, in_this_process, rosette, refused, tmp_path, sql, words):
    """What DuckDB says, the tables, and how to see their columns; no traceback."""
    archive = tmp_path / 'archive'
    rosette('archive', 'add', logs, '--into', archive)
    line = refused('archive', 'query', archive, sql)
    assert line.startswith(f'rosette: {archive}: ') and words in line
    assert ('; there are the views runs, effects, curves, deviations: --columns explains the columns of runs, the SQL '
            '"DESCRIBE curves" lists those of another one') in line
    assert 'angle_rad' in rosette('archive', 'query', archive, 'DESCRIBE curves').out


@pytest.mark.parametrize('statement', ["COPY (SELECT 1) TO '{file}'", "SELECT 1; COPY (SELECT 1) TO '{file}'",
                                       'DROP VIEW runs', "ATTACH '{file}'"])
def test_a_question_changes_nothing(logs, in_this_process, rosette, refused, tmp_path, statement):
    """SQL that writes is refused, whatever stands before it."""
    archive, file = tmp_path / 'archive', tmp_path / 'file.csv'
    rosette('archive', 'add', logs, '--into', archive)
    words = refused('archive', 'query', archive, statement.format(file=file))
    assert 'expected a question (SELECT ...), found ' in words
    assert not file.exists()
    assert json.loads(rosette('archive', 'query', archive, 'SELECT count(*) AS runs FROM runs', '--json').out)['rows']


def test_times_do_not_depend_on_where_the_computer_is(rosette, tmp_path, monkeypatch):
    """Those without a zone stay as they are, others are those of UTC."""
    RunArchive(tmp_path, make=True)
    monkeypatch.setenv('TZ', 'America/New_York')
    time.tzset()
    sql = "SELECT TIMESTAMP '2024-01-01 00:00:00' AS naive, TIMESTAMPTZ '2024-01-01 00:00:00+00' AS utc"
    told = rosette('archive', 'query', tmp_path, sql, '--csv').out
    monkeypatch.undo()
    time.tzset()
    assert told.splitlines()[1] == '2024-01-01 00:00:00,2024-01-01 00:00:00'
