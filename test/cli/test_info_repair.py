# SPDX-License-Identifier: Apache-2.0
"""rosette info --repair: a log that was cut short becomes a whole one beside it."""

import json

import pytest


@pytest.fixture
def cut_log(rosette, make_table, tmp_path):
    """Return a log without its end, as after a kill -9."""
    assert rosette('import', make_table(), '-o', tmp_path / 'log').code == 0
    path = next((tmp_path / 'log').glob('*.mcap'))
    data = path.read_bytes()
    path.write_bytes(data[:data.rindex(b'\x0f\x04\0\0\0\0\0\0\0')])
    return tmp_path / 'log'


def test_a_repaired_log_is_told_and_evaluates_the_same(rosette, cut_log):
    """What was wrong, where the new log is, that the old one was not touched."""
    answer = rosette('info', cut_log, '--repair')
    assert answer.code == 0
    assert 'ends in the middle' in ' '.join(answer.out.split())
    assert f'{cut_log}_repaired' in answer.out.replace('\n', '')
    assert 'was not touched' in answer.out
    old, new = (json.loads(rosette('evaluate', path, '--json').out)
                for path in (cut_log, f'{cut_log}_repaired'))
    assert old['ctx_m'] == new['ctx_m']


def test_json_tells_the_new_log(rosette, cut_log, tmp_path):
    """One object about what was written."""
    facts = json.loads(rosette('info', cut_log, '--repair', '-o', tmp_path / 'new', '--json').out)
    assert facts['path'] == str(tmp_path / 'new')
    assert facts['truncated'] is False


def test_nothing_is_written_where_nothing_is_to_repair(refused, rosette, make_table, tmp_path):
    """A whole log, a table, an output without a repair."""
    rosette('import', make_table(), '-o', tmp_path / 'whole')
    assert 'is whole; there is nothing to repair' in refused('info', tmp_path / 'whole', '--repair')
    assert 'got a ball-centre table' in refused('info', make_table(), '--repair')
    assert 'add --repair' in refused('info', tmp_path / 'whole', '-o', tmp_path / 'x')
    assert not (tmp_path / 'whole_repaired').exists()
