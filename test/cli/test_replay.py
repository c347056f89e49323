# SPDX-License-Identifier: Apache-2.0
"""rosette replay: what it expects, and how it reports a difference."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosette_ros.cli.console import console
from rosette_ros.cli.replay import LogPlayer, difference, expected_motions, show
from rosette_ros.core.run.errors import CellError, InvalidData
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_run import LogRun, PublishedMotions
from rosette_ros.io.messages import Phase, Target
from rosette_ros.io.run_answers import RunAnswers


@pytest.fixture
def motions():
    """Some curves."""
    values = 1e-7 * np.random.default_rng(1).standard_normal((6, 6))
    return ErrorMotions(nominal_angles(6), values, np.full((6, 6), 2e-8))


def test_equal_is_equal_to_the_last_bit(motions):
    """And one bit is a difference."""
    assert difference(motions, motions, True) == ''
    values = motions.values.copy()
    values[3, 1] = np.nextafter(values[3, 1], 1)
    changed = ErrorMotions(motions.angle, values, motions.u)
    assert 'µm and 0 µrad off' in difference(changed, motions, True)


def test_uncertainties_count_where_the_graph_can_know_them(motions):
    """The repeatability of an imported table does not travel."""
    other = ErrorMotions(motions.angle, motions.values, 2 * motions.u)
    assert difference(other, motions, True) == 'other uncertainties than'
    assert difference(other, motions, False) == ''


def test_other_angles_are_reported_first(motions):
    """Curves at other angles cannot be compared."""
    other = ErrorMotions(motions.angle + 1e-9, motions.values, motions.u)
    assert difference(other, motions, True) == 'other table angles than'


@pytest.mark.parametrize(('logged', 'diagnosed', 'same'), [
    ('all explanations averaged', True, 'result'), ('as modelled', False, 'modelled'), ('', True, 'modelled')])
def test_the_result_is_compared_where_the_log_has_one(motions, logged, diagnosed, same, capsys):
    """Else the curves as modelled: of a log from before, or of a run in which nothing was looked for."""
    other = ErrorMotions(motions.angle, 2 * motions.values, motions.u)
    published = PublishedMotions('r', other if logged == 'all explanations averaged' else motions, logged, motions,
                                 diagnosed, 'base', 1.0, 1e-7)
    log = LogRun(Path('log'), (), {'r': RunAnswers('r')}, error_motions=[published])
    log.runs['r'].add_target(Target('r', 1, 1, 1, Phase.RUN, 6, 0.1, 1, 1, 1, 0.0, 0, (0.0, 0.0, 0.0), 'table', 0))
    [expected] = expected_motions(log).values()
    now = PublishedMotions('r', other, 'all explanations averaged', motions, True, 'base', 1.0, 1e-7)
    assert not show(console(), 'r', now, expected)
    assert (now.which if same == 'result' else 'as modelled') in capsys.readouterr().out
    changed = now._replace(**{'motions' if same == 'result' else 'modelled': ErrorMotions(
        motions.angle, 3 * motions.values, motions.u)})
    assert show(console(), 'r', changed, expected)


def test_an_imported_table_is_expected_as_evaluated(rosette, make_table, tmp_path):
    """Nothing was published in it."""
    rosette('import', make_table(), '-o', tmp_path / 'log')
    [(run_id, expected)] = expected_motions(read_log(tmp_path / 'log')).items()
    assert run_id == 'test_diagonal_6'
    assert expected.source == 'of rosette evaluate'
    assert not expected.with_u


def test_a_table_is_no_log(refused, make_table):
    """What can be replayed is a log; a table is imported first."""
    path = make_table()
    assert str(path) in refused('replay', path)


def test_an_incomplete_import_cannot_be_replayed(rosette, make_table, tmp_path):
    """Too little for an evaluation: reported before anything is published."""
    table = make_table(edit=lambda lines: ['# balls: 6', *lines[:15]])
    rosette('import', table, '-o', tmp_path / 'log')
    with pytest.raises(InvalidData, match='expected all 36 ball centres, .* found 10; try rosette evaluate'):
        expected_motions(read_log(tmp_path / 'log'))


def test_messages_of_another_version_are_not_replayed(rosette, make_table, tmp_path):
    """An evaluator would wait for what it cannot read."""
    assert rosette('import', make_table(), '-o', tmp_path / 'log').code == 0
    topics = [replace(one, hash='RIHS01_0') if one.name.endswith('probe_target') else one
              for one in read_log(tmp_path / 'log').topics]
    with pytest.raises(CellError, match='/rosette/probe_target: was recorded with another version of rosette_msgs/'):
        LogPlayer(topics)
