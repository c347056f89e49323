# SPDX-License-Identifier: Apache-2.0
"""Folders of runs, and commands that work as they are printed."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from simulated import simulated_table
from terminal import Terminal

from rosette_ros.analysis import analyse, conformity_of, judge
from rosette_ros.invocation import program
from rosette_ros.io.log_reader import runs_in
from rosette_ros.io.open_run import open_run
from rosette_ros.words.verdict_words import verdict_text

GOLDEN = Path(__file__).parents[1] / 'golden' / 'logs'


@pytest.fixture
def folder(tmp_path):
    """Return a folder with two tables, the second newer, and a file that is no run."""
    for age, (name, source) in enumerate((('clean', simulated_table()), ('drift', simulated_table('drift')))):
        path = tmp_path / f'{name}.csv'
        path.write_bytes(source.read_bytes())
        os.utime(path, (1e9 + age, 1e9 + age))
    (tmp_path / 'notes.txt').write_text('none')
    return tmp_path


def test_runs_are_listed_with_their_verdicts(rosette, folder):
    """Newest first, as evaluate judges each."""
    found = json.loads(rosette('runs', folder, '--json').out)['runs']
    assert [Path(one['path']).name for one in found] == ['drift.csv', 'clean.csv']
    for one in found:
        assert one['verdict'] == verdict_text(judge(open_run(one['path']))).sentence
        assert (one['n'], one['readings'], one['problem']) == (6, 36, '')
        assert one['residual_m'] == pytest.approx(analyse(open_run(one['path'])).rms, rel=1e-12)
    lines = rosette('runs', folder).out.splitlines()
    assert '2 runs' in lines[0]
    [drift] = [line for line in lines if 'drift.csv' in line]
    assert 'effect found' in drift and f'{1e6 * found[0]["residual_m"]:.3f}' in drift
    assert 'most likely linear probe drift' in ' '.join(rosette('runs', folder, '--long').out.split())


def test_a_run_stays_where_it_began_whatever_is_done_in_its_folder(rosette, tmp_path):
    """A report beside the log of the older one, and its file copied later; a table without a date goes by its file."""
    for name in ('log_left_out_n7_column', 'log_clean_n6_diagonal'):  # the second began first
        shutil.copytree(GOLDEN / name, tmp_path / name)
    (tmp_path / 'log_clean_n6_diagonal' / 'report.html').write_text('later')
    for file in tmp_path.glob('*/*.mcap'):
        os.utime(file, (2e9 + ('clean' in str(file)),) * 2)
    os.utime(tmp_path / 'log_clean_n6_diagonal', (3e9, 3e9))
    shutil.copy(simulated_table(), tmp_path / 'table.csv')
    os.utime(tmp_path / 'table.csv', (1e9, 1e9))
    found = json.loads(rosette('runs', tmp_path, '--json').out)['runs']
    assert [Path(one['path']).name for one in found] == ['log_left_out_n7_column', 'log_clean_n6_diagonal', 'table.csv']
    assert found[0]['begun'] > found[1]['begun'] and found[2]['begun'] is None
    assert [path.name for path in runs_in(tmp_path)][-1] == 'table.csv'
    later, earlier = tmp_path / 'log_left_out_n7_column', tmp_path / 'log_clean_n6_diagonal'
    for when, folder in ((2e9, later), (1.9e9, earlier)):
        for file in folder.glob('*.mcap'):
            os.utime(file, (when, when))
    assert [path.name for path in runs_in(tmp_path)][:2] == [later.name, earlier.name], 'not by the time of the folder'


def test_a_file_that_is_no_run_is_told_on_request(rosette, folder):
    """The others are judged."""
    (folder / 'broken.csv').write_text('nothing')
    found = {Path(one['path']).name: one for one in json.loads(rosette('runs', folder, '--json').out)['runs']}
    assert found['broken.csv']['verdict'] is None and 'broken.csv' in found['broken.csv']['problem']
    assert found['clean.csv']['verdict'] and not found['broken.csv']['is_run']
    assert 'broken' not in rosette('runs', folder).out and 'broken' in rosette('runs', folder, '--long').out


def test_a_run_of_a_cell_is_one_line(rosette, tmp_path):
    """When, of which table, in which order, its residual, whether it keeps its tolerances."""
    shutil.copytree(GOLDEN / 'log_clean_n6_diagonal', tmp_path / 'log')
    found = json.loads(rosette('runs', tmp_path, '--json').out)['runs'][0]
    run = open_run(tmp_path / 'log')
    assert (found['n'], found['readings'], found['run_id']) == (run.n, run.size, run.run_id)
    assert found['residual_m'] == pytest.approx(analyse(run).rms, rel=1e-6) and found['conformity'] is None
    fitted, verdict = analyse(open_run(simulated_table())), verdict_text(judge(open_run(simulated_table())))
    assert conformity_of(fitted, verdict, {'ctx': 1.0, 'crz': 1.0}) in ('conforms', 'not decidable')
    assert conformity_of(fitted, None, {'ctx': 1.0, 'crz': 1e-9}) == 'does not conform'


def test_a_cancelled_run_is_told_as_that(rosette, tmp_path):
    """With its balls and how many centres it has; the error that it cannot be evaluated is no verdict."""
    shutil.copytree(GOLDEN / 'log_broken_off_n6_row', tmp_path / 'log')
    found = json.loads(rosette('runs', tmp_path, '--json').out)['runs'][0]
    assert (found['problem'], found['verdict']) == ('6 balls, cancelled after 23 of 36', None)
    assert '6 balls on R = 182.5 mm, cancelled after 23 of 36' in rosette('info', tmp_path / 'log').out


@pytest.mark.parametrize(('answers', 'measured'), [(0, 0), (20, 0), (24, 2)])
def test_a_run_cancelled_at_its_begin_is_told_as_that(rosette, tmp_path, answers, measured):
    """Before its first reading, too: no error of many words, nothing about places that were still to come."""
    left = answers
    (source,) = (GOLDEN / 'log_broken_off_n6_row').glob('*.mcap')
    (tmp_path / 'log').mkdir()
    with open(source, 'rb') as stream, open(tmp_path / 'log' / 'log_0.mcap', 'wb') as target:
        writer, channels = Writer(target), {}
        writer.start(profile='ros2')
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(channel.topic, 'cdr', writer.register_schema(
                    schema.name, schema.encoding, schema.data), dict(channel.metadata))
            is_answer = channel.topic.endswith('ball_centre')
            if not is_answer or left > 0:
                writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
            left -= is_answer
        writer.finish()
    found = json.loads(rosette('runs', tmp_path, '--json').out)['runs'][0]
    assert (found['problem'], found['n'], found['readings'], found['verdict']) == (
        f'6 balls, cancelled after {measured} of 36', 6, measured, None)
    out = rosette('info', tmp_path / 'log').out
    assert f'cancelled after {measured} of 36' in out and 'expected' not in out and 'not measured' not in out


def test_a_folder_of_runs_is_no_run(refused, folder, tmp_path):
    """They are named."""
    assert (f'{folder}: expected a run, found a folder of 2: drift.csv, clean.csv; name one of them (rosette runs '
            'lists '
            'them)') in refused('evaluate', folder)
    assert 'expected a folder of runs that can be read, found No such file' in refused('runs', tmp_path / 'none')


def test_what_is_no_run_is_passed_over(rosette, refused, folder):
    """Pipes, links without an end, loops, hidden files, trash, folders that hold no log; none ends the verb."""
    os.mkfifo(folder / 'pipe.mcap')
    for name, target in (('none.csv', 'nowhere'), ('loop.mcap', 'loop.mcap'), ('up', '.'), ('device.csv', '/dev/zero')):
        (folder / name).symlink_to(target)
    for name in ('.Trash-1000/x_0.mcap', '__MACOSX/x_0.mcap', 'several/a.mcap', 'several/b.mcap', '._clean.csv'):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text('x')
    (folder / 'pipes').mkdir()
    os.mkfifo(folder / 'pipes' / 'x_0.mcap')
    os.mkfifo(folder / 'pipes' / 'metadata.yaml')
    os.mkfifo(folder / 'pipes' / 'x_1.mcap.zstd')
    found = json.loads(rosette('runs', folder, '--json').out)['runs']
    assert [Path(one['path']).name for one in found] == ['drift.csv', 'clean.csv']
    assert 'found a folder of 2: drift.csv, clean.csv' in refused('evaluate', folder)
    assert 'expected a log directory with .mcap files, found none in it' in refused('info', folder / 'pipes')
    assert 'found a device or a pipe' in refused('info', folder / 'pipe.mcap')
    assert 'found a folder of 2: drift.csv, clean.csv' in refused('info', folder)
    assert 'several: expected a run, found a folder of 2: ' in refused('info', folder / 'several')


def test_the_home_of_the_user_is_found_in_every_option(rosette, folder, monkeypatch):
    """A shell expands `~/` where it begins a word only."""
    monkeypatch.setenv('HOME', str(folder))
    (folder / 'model.yaml').write_text('{schema: rosette-model/1, effects: [frame_drift]}')
    assert 'frame_drift' in rosette('evaluate', '~/drift.csv', '--model=~/model.yaml').out
    for home in ('~', '~/'):
        assert len(json.loads(rosette('runs', home, '--json').out)['runs']) == 2


def test_evaluate_says_what_to_add_where_the_model_fails(rosette, folder):
    """And only there."""
    assert f'{program()} add frame_drift --model model.yaml --run {folder / "drift.csv"}' in rosette(
        'evaluate', folder / 'drift.csv').out
    assert 'rosette add' not in rosette('evaluate', folder / 'clean.csv').out


def test_a_printed_command_runs_where_a_path_has_spaces(rosette, folder):
    """A shell takes it as one word."""
    spaced = (folder / 'drift.csv').rename(folder / "the operator's [run] 1.csv")
    [printed] = [line.strip() for line in rosette('evaluate', spaced).out.splitlines() if 'rosette add ' in line]
    assert shlex.split(printed)[1:] == ['add', 'frame_drift', '--model', 'model.yaml', '--run', str(spaced)]


def test_the_program_is_called_as_it_is_found(monkeypatch):
    """By its path where the name does not find it, by its name where it does; what is printed runs."""
    own = Path(sys.prefix) / 'bin' / 'rosette'
    monkeypatch.setenv('PATH', '/usr/bin:/bin')
    monkeypatch.chdir('/')
    assert program() in (str(own), str(own).removeprefix('/'))
    monkeypatch.chdir(own.parent)
    assert program() == './rosette'
    assert subprocess.run(f'{program()} --version', shell=True, check=False, capture_output=True).returncode == 0
    monkeypatch.chdir(own.parents[2])
    assert program() == '.venv/bin/rosette'
    monkeypatch.setenv('PATH', f'{own.parent}:/usr/bin:/bin')
    assert program() == 'rosette'


def test_the_shell_finds_rosette_and_ros(refused, tmp_path):
    """One command in it; a command that is not there is refused."""
    def shell(*words):
        return subprocess.run([sys.executable, '-m', 'rosette_ros.cli.main', 'shell', *words], check=False, text=True,
                              capture_output=True, env={**os.environ, 'PATH': '/usr/bin:/bin'}).stdout.strip()
    assert shell('python', '-c', 'import rclpy, rosette_msgs, sys; print(sys.prefix)') == sys.prefix
    home = tmp_path / 'home'
    home.mkdir()
    (home / '.bashrc').write_text('PATH=/usr/bin:/bin\necho greeting\n')  # as pyenv or conda put theirs before ours
    with Terminal(sys.executable, '-m', 'rosette_ros.cli.main', 'shell', SHELL='/bin/bash', HOME=str(home)) as typed:
        typed.wait_for('greeting')
        typed.type('command -v python; exit\r')
        assert typed.end() == 0
    assert str(Path(sys.prefix) / 'bin' / 'python') in typed.screen.splitlines()
    assert shell('sh', '-c', 'command -v rosette') == str(Path(sys.prefix) / 'bin' / 'rosette')
    assert "found 'no-such-command', which is not found" in refused('shell', 'no-such-command')
