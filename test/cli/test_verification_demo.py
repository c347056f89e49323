# SPDX-License-Identifier: Apache-2.0
"""rosette demo --verification: six runs over real nodes, and what each condition changed."""

import csv
import re

import pytest
import yaml

from rosette_ros.analysis import analyse
from rosette_ros.api.documents import verification_of
from rosette_ros.cli import demo
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.report.verification import PAPER

pytestmark = pytest.mark.long

BALLS = 8


def test_verification_over_real_nodes(rosette, tmp_path, domain_id):
    """One cell, six logs, a maker's table, a page; conditions are in the files and in the readings."""
    answer = rosette('demo', '--verification', '--balls', BALLS, '-o', tmp_path, '--domain', domain_id)
    assert answer.code == 0, answer.err
    runs = sorted(path for path in tmp_path.iterdir() if path.is_dir())
    assert len(runs) == 6
    machines = [yaml.safe_load((run / 'machine.yaml').read_text()) for run in runs]
    assert [one['clamping']['plate_turn_deg'] for one in machines] == [0.0, 90.0, 0.0, 0.0, 0.0, 0.0]
    assert [one['cmm']['correction'] for one in machines] == [True, True, False, False, True, True]
    assert [one['table']['axial_correction'] for one in machines] == [True, True, True, False, True, True]
    assert [one['table']['angular_correction'] for one in machines] == [True, True, True, True, False, True]
    spans = [analyse(open_run(run)).error_motions.values.max(axis=0) for run in runs]
    assert spans[3][2] > 3 * max(spans[place][2] for place in (0, 1, 2, 4, 5))
    assert spans[4][5] > 3 * max(spans[place][5] for place in (0, 1, 2, 3, 5))
    [maker], [page] = tmp_path.glob('*_maker.csv'), tmp_path.glob('*.html')
    verification = verification_of(runs, maker)
    assert verification.agrees
    assert all(found < 2 * paper for found, paper in zip(verification.overall, PAPER, strict=True))
    assert 'reproduce within' in ' '.join(re.sub('<[^>]*>', '', page.read_text(encoding='utf-8')).split())
    with open(maker, encoding='utf-8', newline='') as stream:
        assert len(list(csv.DictReader(stream))) == 72


@pytest.mark.parametrize(('words', 'said'), [
    (('--verification', '--hidden', '3'), '--verification and --hidden exclude each other; choose one'),
    (('--verification', '--dme'), '--verification and --dme exclude each other; choose one'),
    (('--verification', '--keep'), '--verification and --keep exclude each other; choose one'),
    (('--verification', '--open'), '--open goes with --hidden only; leave it out'),
    (('--open',), '--open goes with --hidden only; leave it out')])
def test_what_has_no_meaning_is_refused(refused, tmp_path, monkeypatch, words, said):
    """One line, before a cell is started."""
    monkeypatch.setattr(demo, 'in_cell', lambda: pytest.fail('started a cell'))
    monkeypatch.setattr(demo, 'verify_method', lambda _: pytest.fail('started a cell'))
    assert said in refused('demo', *words, '-o', tmp_path / 'runs')
    assert list(tmp_path.iterdir()) == []
