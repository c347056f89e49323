# SPDX-License-Identifier: Apache-2.0
"""Pages with examples run as they stand."""

import csv
import doctest
import re
from pathlib import Path

import pytest

import rosette_ros.presentation.formatting
from rosette_ros.cli.main import main
from rosette_ros.core.effects.library import EFFECTS

DOCS = Path(__file__).parents[1] / 'docs'


@pytest.mark.usefixtures('sketched')
@pytest.mark.parametrize('name', ['adding-an-effect.md', 'python.md'])
def test_a_page_runs(name, tmp_path, monkeypatch):
    """Every example gives what stands below it; files go to an empty folder."""
    monkeypatch.chdir(tmp_path)
    known = dict(EFFECTS)
    result = doctest.testfile(str(DOCS / name), module_relative=False, optionflags=doctest.ELLIPSIS)
    for added in EFFECTS.keys() - known:  # by the page, for its own process
        del EFFECTS[added]
    assert result.attempted > 10
    assert result.failed == 0


def test_the_example_of_the_units_runs():
    """In the docstring."""
    assert doctest.testmod(rosette_ros.presentation.formatting).failed == 0


def plans(capsys, balls, *words):
    """Return what `rosette plan --csv` says of plans, by plan."""
    capsys.readouterr()
    assert main(['plan', *words, '--balls', str(balls), '--radius-mm', '182.5', '--csv']) == 0
    return {row['plan']: row for row in csv.DictReader(capsys.readouterr().out.splitlines())}


def test_the_table_of_plans_is_that_of_the_command(capsys):
    """Readings, time, relative u and effects shown of each plan on the page."""
    page = (DOCS / 'measuring.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| [^|]+ \| `([\w:%]+)`[^|]* \| (\d+), ([\d.]+) h \| ([\d.]+) \| (\d+)', page, re.MULTILINE)
    assert len(rows) == 6
    found = plans(capsys, 12, *(name for name, *_ in rows))
    assert rows == [(name, one['readings'], f'{float(one["duration_h"]):.2f}',
                     f'{float(one["relative_uncertainty"]):.2f}', one['effects_shown']) for name, one in found.items()]


@pytest.mark.parametrize('n', [12, 24, pytest.param(36, marks=pytest.mark.long)])
def test_the_table_of_reduced_plans_is_that_of_the_command(n, capsys):
    """The uncertainty of the best places, relative to that of a complete run."""
    page = (DOCS / 'measuring.md').read_text(encoding='utf-8').partition('| n | 2/3')[2]
    cells, = re.findall(rf'^\| {n} ' + r'\| ([\d.]*) ?' * 4 + r'\|$', page, re.MULTILINE)
    wanted = {f'diagonal:{round(n * share)}': cell for share, cell in zip((2/3, 1/2, 1/3, 1/4), cells) if cell}
    found = plans(capsys, n, *wanted)
    assert {name: f'{float(one["relative_uncertainty"]):.2f}' for name, one in found.items()} == wanted
