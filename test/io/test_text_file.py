# SPDX-License-Identifier: Apache-2.0
"""Files are written as a whole or not at all, under names that nobody else has."""

import errno
import os
import resource
import shutil
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from rosette_ros.archive.run_adding import find_logs
from rosette_ros.cli.main import main
from rosette_ros.core.run.errors import CellError, InvalidData
from rosette_ros.io.ball_centre_table import read_csv
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_writer import LogWriter, whole_log
from rosette_ros.io.open_run import open_run
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.text_file import give_name, path_of, write_text
from rosette_ros.presentation.plots.plot_style import save

TABLE = Path(__file__).parents[1] / 'golden' / 'tables' / 'table_clean_n6_row.csv'


READERS = '''
import sys
from pathlib import Path
from rosette_ros.core.run.errors import RosetteError
from rosette_ros.dme.stop_mark import StopMark
from rosette_ros.io import budget_file, identity_file, log_reader, model_file, plan_file, plate_file
from rosette_ros.presentation.report import provenance, verification
from rosette_ros.simulation import envelope
from rosette_ros.simulation.machine import load_machine

for path in map(Path, sys.argv[1:]):
    for read in (budget_file.read_budget, identity_file.read_identity, model_file.read_model, plan_file.read_plan,
                 plate_file.read_plate, provenance.digest, verification.read_maker, envelope.open_envelope,
                 load_machine, log_reader.read_log):
        try:
            print(read.__name__, read(path))
        except RosetteError as error:
            print(error)
    settings = path.with_name(f'cmm_{path.name}')
    settings.with_name(f'{settings.name}.stopped').symlink_to(path)
    print(StopMark(settings).read())
'''


def test_nothing_waits_for_a_pipe(tmp_path):
    """Or a device, in the place of a file of settings, a table, a log: refused at once, in a line each."""
    os.mkfifo(tmp_path / 'pipe.yaml')
    (tmp_path / 'device.yaml').symlink_to('/dev/zero')
    done = subprocess.run([sys.executable, '-c', READERS, tmp_path / 'pipe.yaml', tmp_path / 'device.yaml'],
                          capture_output=True, text=True, timeout=300, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 2 * 11
    assert all('a device or a pipe' in one for one in lines), done.stdout


def content(folder):
    """Return the bytes of every file in a folder by its name."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize(('text', 'path'), [
    ('file:///a/sp%20dir/x.csv', '/a/sp dir/x.csv'), ('file://localhost/%C3%B6', '/ö'), ('file:/a%2Bb', '/a+b'),
    ('~/a%20b', '/home/me/a%20b'), ('a%20b', 'a%20b'), ('file://nas/a%20b', 'file://nas/a%20b'), ('~me', '~me')])
def test_an_address_is_decoded(monkeypatch, text, path):
    """What a file manager copies is one; a path is none, and stays as it is."""
    monkeypatch.setenv('HOME', '/home/me')
    assert path_of(text) == path


def test_a_replaced_file_keeps_its_mode_and_the_link_to_it(tmp_path):
    """A model of mode 600 stays private, and a link in a project points on to the file elsewhere."""
    (tmp_path / 'far').mkdir()
    file, link = tmp_path / 'far' / 'model.yaml', tmp_path / 'model.yaml'
    file.write_text('old')
    file.chmod(0o600)
    link.symlink_to(file)
    write_text(link, 'new', force=True)
    assert link.is_symlink()
    assert (file.read_text(), stat.S_IMODE(file.stat().st_mode)) == ('new', 0o600)
    umask = os.umask(0o027)
    try:
        write_text(tmp_path / 'other', 'new')
    finally:
        os.umask(umask)
    assert stat.S_IMODE((tmp_path / 'other').stat().st_mode) == 0o640


def test_names_of_others(tmp_path, monkeypatch):
    """A folder that is called as the home of the user; a name that is no UTF-8, which no archive can hold."""
    monkeypatch.chdir(tmp_path)
    folder = Path('./~')
    folder.mkdir()
    shutil.copy(TABLE, folder / 'a.csv')
    assert open_run(folder / 'a.csv').n == 6
    name = tmp_path / os.fsdecode(b'a\xff.csv')
    shutil.copy(TABLE, name)
    write_text('report', f'of {name.name}')
    assert Path('report').read_text() == 'of a?.csv'
    with pytest.raises(InvalidData, match='expected a name in UTF-8, found another one; rename it'):
        find_logs([str(tmp_path)])


def test_files_with_names_that_a_writer_might_take_stay(tmp_path):
    """Strangers beside the table, and what a link among them points to."""
    (tmp_path / 'precious').write_text('mine')
    for name in (f'.a.csv.{os.getpid()}', 'a.csv.part', '.a.csv.part', 'metadata.yaml.part'):
        (tmp_path / name).symlink_to(tmp_path / 'precious')
    before = content(tmp_path)
    write_text(tmp_path / 'a.csv', 'x')
    with LogWriter(tmp_path, 'log'):
        pass
    assert content(tmp_path).items() >= before.items()
    assert sorted({*content(tmp_path)} - {*before}) == ['a.csv', 'log_0.mcap', 'metadata.yaml']


def test_a_file_that_comes_in_between_is_not_replaced(tmp_path, monkeypatch):
    """It was not there when the writer looked; on file systems without hard links too."""
    path, fsync = tmp_path / 'a.csv', os.fsync
    monkeypatch.setattr(os, 'fsync', lambda file: (fsync(file), path.write_text('theirs')))
    with pytest.raises(InvalidData, match='exists already; take another name or use force=True'):
        write_text(path, 'ours')
    monkeypatch.undo()

    def refuse(*_):
        raise OSError(errno.EPERM, 'Operation not permitted')

    monkeypatch.setattr(os, 'link', refuse)
    with pytest.raises(InvalidData, match='exists already'):
        write_text(path, 'ours')
    (tmp_path / 'b').write_text('ours')
    with pytest.raises(FileExistsError):
        give_name(tmp_path / 'b', path)
    assert content(tmp_path) == {'a.csv': b'theirs', 'b': b'ours'}
    give_name(tmp_path / 'b', tmp_path / 'c')
    assert content(tmp_path) == {'a.csv': b'theirs', 'c': b'ours'}


@pytest.mark.parametrize('words', [('export', TABLE, '-o', 'a.csv'), ('report', TABLE, '-o', 'a.csv')])
def test_a_full_disk_leaves_the_old_files_and_no_part_of_new_ones(tmp_path, monkeypatch, capsys, sketched, words):
    """With --force, while no file may have more than 300 bytes."""
    (tmp_path / 'a.csv').write_text('old')
    before = content(tmp_path)
    monkeypatch.chdir(tmp_path)
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, most[1]))
    try:
        code = main([*map(str, words), '--force'])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    assert code == 2
    assert 'cannot be written: File too large' in capsys.readouterr().err
    assert content(tmp_path) == before


def test_a_figure_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    """Figures are written by the same function."""
    def refuse(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    path = tmp_path / 'a.png'
    path.write_text('old')
    monkeypatch.setattr(os, 'fsync', refuse)
    with pytest.raises(InvalidData, match='cannot be written: No space left on device'):
        save(Figure(), path, force=True)
    assert content(tmp_path) == {'a.png': b'old'}


def test_a_log_that_fails_takes_back_its_own_files_alone(tmp_path):
    """Strangers whose names begin as those of a log's files stay."""
    for name in ('metadata.yaml.bak', 'log_0.mcap.zst', 'log_1.mcap.old'):
        (tmp_path / name).write_text('mine')
    before = content(tmp_path)
    with pytest.raises(KeyError), whole_log(tmp_path, 'log'):
        raise KeyError
    assert content(tmp_path) == before


def test_two_imports_at_once_leave_one_whole_log(tmp_path, library, monkeypatch):
    """Both found an empty folder: the later one is refused, and the log of the earlier one stays as it is."""
    run, prepare, folder = read_csv(TABLE), LogWriter._prepare_directory, tmp_path / 'log'

    def overtaken(writer):
        is_new = prepare(writer)
        monkeypatch.undo()
        write_log(run, folder, library)
        before.update(content(folder))
        return is_new

    before = {}
    monkeypatch.setattr(LogWriter, '_prepare_directory', overtaken)
    with pytest.raises(InvalidData, match='holds a log already'):
        write_log(run, folder, library)
    assert content(folder) == before != {}
    for attempt in range(8):
        ends, folder = [], tmp_path / str(attempt)

        def import_it(folder=folder, ends=ends):
            try:
                ends.append(write_log(run, folder, library))
            except (InvalidData, CellError) as error:
                ends.append(str(error))

        threads = [threading.Thread(target=import_it) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert ends.count(folder) == 1, ends
        assert all('holds a log already' in str(end) for end in ends if end != folder)
        assert read_log(folder).problems == ()
        assert sorted(content(folder)) == [f'{attempt}_0.mcap', 'metadata.yaml']


def test_a_first_file_that_cannot_be_opened_is_said(tmp_path, monkeypatch):
    """In words, and the folder goes again."""
    def refuse(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(os, 'open', refuse)
    with pytest.raises(CellError, match='cannot begin the log: No space left on device; make room'):
        LogWriter(tmp_path / 'log', 'log')
    assert not (tmp_path / 'log').exists()
