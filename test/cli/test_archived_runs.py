# SPDX-License-Identifier: Apache-2.0
"""Runs of an archive where several runs are taken: --archive with the options of archive query, archived_runs."""

import json

import pytest
from plain_loop import PlainLoop

import rosette_ros
from rosette_ros.archive.run_adding import add_logs, find_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.simulation import Machine, MachineConfig

DRIFT = [{'kind': 'frame_drift', 'rate_um_per_h': [2.0, 0.0, 1.2]}]


@pytest.fixture(scope='module')
def plant(tmp_path_factory):
    """Return an archive with two runs of table T1, which drifts, and one of table T2."""
    folder = tmp_path_factory.mktemp('plant')
    archive = RunArchive(folder / 'archive', make=True)
    for seed in (1, 2, 3):
        table, run = 'T1' if seed < 3 else 'T2', folder / f'run{seed}.csv'
        write_csv(Machine(MachineConfig().changed(seed=seed, plate={'balls': 6}, hidden=DRIFT)).run(
            plan(6, 'interleaved', seed), run_id=f'run {seed}'), run)
        who = f'schema: rosette-identity/1\ntable: {{serial: {table}}}\nmeasured: {{begin: 2026-04-0{seed}}}\n'
        add_logs(archive, find_logs([str(run)]), PlainLoop(), identity=parse_identity(who.encode()))
    return folder / 'archive'


def test_runs_are_those_that_are_asked_for(plant):
    """By the words of archive query, the earliest first; each once."""
    runs = rosette_ros.archived_runs(plant, table='T1')
    assert [one.run.run_id for one in runs] == ['run 1', 'run 2']
    assert [one.run.run_id for one in rosette_ros.archived_runs(plant, since='2026-04-02', until='2026-04-03')] == [
        'run 2']
    assert len(rosette_ros.archived_runs(RunArchive(plant))) == 3
    with pytest.raises(rosette_ros.RosetteError, match='expected runs that are asked for, found none; rosette archive'):
        rosette_ros.archived_runs(plant, table='T9')


def test_verbs_take_them_in_place_of_runs(rosette, refused, plant, tmp_path):
    """A cell is diagnosed, and runs are evaluated as one, by a question."""
    found = json.loads(rosette('diagnose', '--archive', plant, '--table', 'T1', '--json').out)
    assert found['runs'] == ['run 1', 'run 2'] and found['causes'][0]['kind'] == 'property'
    beside = json.loads(rosette('evaluate', '--joint', plant.parent / 'run3.csv', '--archive', plant, '--table', 'T1',
                                '--since', '2026-04-02', '--json').out)
    assert [one['run_id'] for one in beside['runs']] == ['run 3', 'run 2']
    written = rosette('correct', '--joint', '--archive', plant, '--table', 'T1', '-o', tmp_path / 'c.yaml')
    assert written.code == 0, written.err
    assert 'expected one RUN, found 2; --joint' in refused('evaluate', '--archive', plant, '--table', 'T1')
    assert 'expected --archive ARCHIVE with what an archive is asked for' in refused('diagnose', '--table', 'T1')
    for verb in ('diagnose', 'evaluate'):
        assert 'expected RUN or --archive ARCHIVE, found neither' in refused(verb)
