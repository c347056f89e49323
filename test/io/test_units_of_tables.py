# SPDX-License-Identifier: Apache-2.0
"""Counts of readings are no minutes, and readings whose unit is in doubt are concluded nothing from."""

import json
import re

import numpy as np
import pytest

from rosette_ros.cli.main import main
from rosette_ros.core.run.records import Run, in_time
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import format_csv


@pytest.fixture
def warming(tmp_path):
    """Return a function that writes a run whose machine warms up and whose plate slips, with or without times."""
    scheme, rng = plan(6, 'row'), np.random.default_rng(2)
    count = np.arange(36)
    centre = scheme.centres(0.1825) + rng.normal(0, 1e-7, (36, 3))
    centre += 8e-7 * (1 - np.exp(-count / 10))[:, None] * [1.0, 0.6, -0.4]
    turned = 2 * np.pi * (scheme.table_position - 1) / 6
    centre[14:] += 2e-6 * np.stack([np.cos(turned), np.sin(turned), 0 * turned], axis=1)[14:]

    def write(name, factor=1.0, pace=None):
        run = Run(6, 0.1825 / factor, scheme.table_position, scheme.ball, centre / factor, approach=scheme.approach,
                  **({} if pace is None else {'time': pace * count}))
        text = format_csv(run)
        if pace is None:
            text = re.sub('time_s', 'no', text)
        (tmp_path / name).write_text(text)
        return tmp_path / name
    return write


MINUTES = re.compile(r'[^\w](min|minutes|h|hours)\b')


def test_counts_are_never_printed_as_minutes(warming, tmp_path, capsys):
    """Of a table without times and of the log that is made of it; with times as before."""
    counted, timed = warming('counted.csv'), warming('timed.csv', pace=31.0)
    assert main(['import', str(counted), '-o', str(tmp_path / 'log')]) == 0
    capsys.readouterr()
    for path, is_timed in ((counted, False), (tmp_path / 'log', False), (timed, True)):
        for verb in ('evaluate', 'diagnose', 'compare', 'info'):
            assert main([verb, str(path)]) == 0
            shown = capsys.readouterr().out
            shown = shown[shown.find('\n'):]
            assert bool(MINUTES.search(shown)) == is_timed, (verb, MINUTES.findall(shown), shown)
            if verb == 'diagnose':
                assert is_timed or 't0 13.5 readings' in shown
    assert main(['diagnose', str(counted), '--json']) == 0
    units = set(re.findall(r'"unit": "([^"]*)"', capsys.readouterr().out))
    assert 'reading' in units and not {one for one in units if re.search(r'\bs\b', one)}
    assert [in_time(one, 'reading') for one in ('s', 'm/s', 'm/s^2', 'm', '1/s')] == [
        'reading', 'm/reading', 'm/reading^2', 'm', '1/reading']


def test_a_table_in_inches_under_names_of_mm_is_doubted_first(warming, capsys, tmp_path):
    """Where radius and readings do not contradict each other; no certificate is made, of its log neither."""
    path = warming('inch.csv', 25.4, 31.0)
    assert main(['import', str(path), '-o', str(tmp_path / 'log')]) == 0
    capsys.readouterr()
    for one in (path, tmp_path / 'log'):
        assert main(['evaluate', str(one), '--json']) == 0
        told = json.loads(capsys.readouterr().out)
        assert told['level'] == 'doubtful'
        assert told['verdict'].startswith('A circle of ball centres of R = 7.18504 mm is beyond any plate of balls; ')
        assert main(['evaluate', str(one)]) == 0
        shown = capsys.readouterr().out
        assert 'NOT JUDGED, THE UNIT OF THE READINGS IS IN DOUBT' in shown
        assert 'Causes' not in shown and 'averaged' not in shown
        assert 'Correct the unit, and evaluate again.' in shown and told['action'].endswith('evaluate again.')
        assert main(['certificate', str(one), '-o', str(tmp_path / 'c.xml')]) == 2
        assert 'expected readings whose unit is sure for a certificate, found: a circle' in capsys.readouterr().err
    right = warming('mm.csv', 1.0, 31.0)
    text = right.read_text().replace('radius_mm: 182.5', 'radius_mm: 7.185')
    right.write_text(text)
    assert main(['evaluate', str(right)]) == 2
    assert 'this is inch, of 25.4 mm: write radius_inch, or millimetres' in capsys.readouterr().err
