# SPDX-License-Identifier: Apache-2.0
"""rosette import, export and info: data in and out without a number changing."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from simulated import simulated_table

CURVES = ('ctx_m', 'cty_m', 'ctz_m', 'crx_rad', 'cry_rad', 'crz_rad')


def evaluation(rosette, path):
    """Return the JSON of an evaluation."""
    return json.loads(rosette('evaluate', path, '--json').out)


def assert_same_curves(one, other):
    """Within 1e-15 m and 1e-14 rad, uncertainties too."""
    for curve in CURVES:
        limit = 1e-15 if curve.endswith('_m') else 1e-14
        np.testing.assert_allclose(other[curve], one[curve], rtol=0, atol=limit)
        np.testing.assert_allclose(other['u'][curve], one['u'][curve], rtol=0, atol=limit)


@pytest.mark.parametrize(('n', 'order'), [(6, 'diagonal'), (5, 'random')])
def test_import_and_export_change_nothing(rosette, make_table, tmp_path, n, order):
    """Table, log, table again: the curves of all three agree."""
    table, log, again = make_table(n, order, seed=n), tmp_path / 'log', tmp_path / 'again.csv'
    before = evaluation(rosette, table)
    assert rosette('import', table, '-o', log).code == 0
    assert_same_curves(before, evaluation(rosette, log))
    assert rosette('export', log, '-o', again).code == 0
    assert_same_curves(before, evaluation(rosette, again))
    assert evaluation(rosette, again)['run_id'] == f'test_{order}_{n}'


def test_the_own_export_survives_a_spreadsheet_with_decimal_commas(rosette, tmp_path):
    """Split at its commas: numbers of 15 digits with decimal commas, also where they have exponents."""
    table, saved = simulated_table('drift', 6, 'diagonal'), tmp_path / 'saved.csv'

    def cell(text):
        try:
            return f'{float(text):.15g}'.replace('.', ',').upper()
        except ValueError:
            return text
    rows = [line.split(',') for line in table.read_text().splitlines()]
    lines = [';'.join([row[0], *map(cell, map(str.strip, row[1:]))]) for row in rows]
    assert any('E-' in line for line in lines if line.startswith('# table_axis'))
    saved.write_text('\r\n'.join(lines), encoding='utf-8-sig')
    before, after = evaluation(rosette, table), evaluation(rosette, saved)
    for curve in CURVES:
        np.testing.assert_allclose(after[curve], before[curve], rtol=0, atol=1e-12)


def test_export_to_the_standard_output(rosette, make_table):
    """With - as the name, the table and nothing else."""
    out = rosette('export', make_table(), '-o', '-').out
    assert out.startswith('# schema: rosette-ball-centres/1\n')
    assert len(out.splitlines()[-36:]) == 36


def test_a_log_is_never_overwritten(rosette, refused, make_table, tmp_path):
    """Not even by the same table."""
    table, log = make_table(), tmp_path / 'log'
    rosette('import', table, '-o', log)
    before = {path.name: path.read_bytes() for path in log.iterdir()}
    assert str(log) in refused('import', table, '-o', log)
    assert {path.name: path.read_bytes() for path in log.iterdir()} == before


def test_info_of_an_imported_log(rosette, make_table, tmp_path):
    """For a person and as JSON."""
    log = tmp_path / 'log'
    rosette('import', make_table(7), '-o', log)
    facts = json.loads(rosette('info', log, '--json').out)
    assert facts['kind'] == 'log'
    assert facts['messages'] == 98
    assert {topic['name']: topic['messages'] for topic in facts['topics']} == {
        '/rosette/probe_target': 49, '/rosette/ball_centre': 49}
    [run] = facts['runs']
    assert run['run_id'] == 'test_diagonal_7'
    assert run['n'] == 7
    assert run['phases'] == {'run': {'asked': 49, 'answered': 49}}
    assert run['duration_s'] == pytest.approx(48 * 40.0)
    assert run['temperature_range_C'] == [20.0, 20.0]
    assert run['repeatability_m'] == pytest.approx(1e-7)
    out = rosette('info', log).out
    assert '1970' not in out
    for words in ('7 balls on R = 182.5 mm', 'run 49 of 49', '98 in 2 topics, 32 min, no date', '0.1000 µm',
                  'BallCentre'):
        assert words in out


def test_info_says_what_is_doubtful(rosette, make_table, tmp_path):
    """Rounded coordinates, of a table and of the log made of it, for a person and as JSON."""
    def to_micrometres(lines):
        rows = (line.split(',') for line in lines[5:])
        short = ([*row[:5], *(f'{float(cell):.3f}' for cell in row[5:8]), *row[8:]] for row in rows)
        return [*lines[:5], *map(','.join, short)]

    table = make_table(edit=to_micrometres)
    rosette('import', table, '-o', tmp_path / 'log')
    for path in (table, tmp_path / 'log'):
        [run] = json.loads(rosette('info', path, '--json').out)['runs']
        rounded, still = sorted(run['remarks'])
        assert rounded.startswith('readings are rounded to 1 µm') and still.startswith('the temperature is 20 °C')
        assert 'Doubtful' in rosette('info', path).out
        for verb in ('evaluate', 'diagnose'):
            assert 'readings are rounded to 1 µm' in ' '.join(rosette(verb, path).out.split())


def test_info_of_a_table(rosette, make_table):
    """No topics, the rest as for a log."""
    facts = json.loads(rosette('info', make_table(6), '--json').out)
    assert facts['kind'] == 'table'
    assert facts['topics'] == []
    assert facts['runs'][0]['completeness'] == 1.0


def test_a_log_that_was_cut_off(rosette, make_table, tmp_path):
    """What is whole is read, and info says that the end is missing."""
    log = tmp_path / 'log'
    rosette('import', make_table(8), '-o', log)
    [file] = log.glob('*.mcap')
    cut = tmp_path / 'cut.mcap'
    data = file.read_bytes()
    cut.write_bytes(data[:len(data) * 9 // 10])
    facts = json.loads(rosette('info', cut, '--json').out)
    assert facts['truncated'] is True
    assert 0 < facts['runs'][0]['phases']['run']['answered'] <= 64
    assert 'the log ends in the middle' in rosette('info', cut).out


def test_faulty_logs(refused, tmp_path):
    """Empty file, empty folder, something else with the name of a log."""
    empty, folder, other = tmp_path / 'e.mcap', tmp_path / 'folder', tmp_path / 'o.mcap'
    empty.touch()
    folder.mkdir()
    other.write_bytes(b'x' * 1000)
    for verb in ('evaluate', 'info', 'replay'):
        assert f'{empty}: is empty' in refused(verb, empty)
        assert f'{folder}: expected a log directory with .mcap files, found none' in refused(
            verb, folder)
        assert str(other) in refused(verb, other)


def test_a_log_of_which_nothing_is_left(rosette, refused, tmp_path):
    """Only its first bytes: no log."""
    stump = tmp_path / 'stump.mcap'
    stump.write_bytes(b'\x89MCAP0\r\n' + b'\1' * 40)
    assert f'{stump}: is not an MCAP file' in refused('evaluate', stump)
    assert 'is not an MCAP file' in refused('info', stump)


def merged(target, *logs, profile='ros2'):
    """Write the messages of several logs into one file, by the mcap library."""
    with open(target, 'wb') as stream:
        writer = Writer(stream)
        writer.start(profile=profile)
        for log in logs:
            [file] = log.glob('*.mcap')
            with open(file, 'rb') as source:
                channels = {}
                for schema, channel, message in make_reader(source).iter_messages():
                    if channel.id not in channels:
                        known = writer.register_schema(schema.name, schema.encoding, schema.data)
                        channels[channel.id] = writer.register_channel(
                            channel.topic, channel.message_encoding, known, channel.metadata)
                    writer.add_message(channels[channel.id], message.log_time, message.data,
                                       message.publish_time)
        writer.finish()
    return target


def test_a_log_with_two_runs_asks_which(rosette, refused, make_table, tmp_path):
    """The line names both; --run-id chooses."""
    for n in (6, 7):
        rosette('import', make_table(n, name=f'{n}.csv'), '-o', tmp_path / f'log{n}')
    both = merged(tmp_path / 'both.mcap', tmp_path / 'log6', tmp_path / 'log7')
    line = refused('evaluate', both)
    assert f'{both}: expected one run, found 2: test_diagonal_6, test_diagonal_7' in line
    got = json.loads(rosette('evaluate', both, '--run-id', 'test_diagonal_7', '--json').out)
    assert_same_curves(evaluation(rosette, tmp_path / 'log7'), got)
    assert "expected run 'noon', found test_diagonal_6, test_diagonal_7" in refused(
        'export', both, '-o', tmp_path / 'x.csv', '--run-id', 'noon')
    runs = json.loads(rosette('info', both, '--json').out)['runs']
    assert [run['run_id'] for run in runs] == ['test_diagonal_6', 'test_diagonal_7']


def test_logs_of_something_else(rosette, refused, make_table, tmp_path):
    """Another profile, and a log in which nothing was measured."""
    rosette('import', make_table(), '-o', tmp_path / 'log')
    other = merged(tmp_path / 'other.mcap', tmp_path / 'log', profile='ros1')
    nothing = merged(tmp_path / 'nothing.mcap')
    for verb in ('evaluate', 'replay'):
        line = refused(verb, other)
        assert str(other) in line
        assert "'ros1'" in line
        line = refused(verb, nothing)
        assert str(nothing) in line


def test_messages_name_the_file_that_was_given(refused, tmp_path):
    """A path with spaces, on one line."""
    path = Path(tmp_path / 'my run.csv')
    path.write_text('a,b\n1,2\n')
    assert f'{path}: expected "# schema: rosette-ball-centres/1"' in refused('evaluate', path)
