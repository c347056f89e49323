# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated cell: what each makes of an answer, drawn alike from the same seed."""

from types import SimpleNamespace

import pytest

from rosette_ros.simulation import MachineConfig
from rosette_ros.simulation.faults import distort, strikes


def answer(**changes):
    """Return an answer with the fields of a BallCentre that faults change."""
    fields = {'run_id': 'a', 'seq': 7, 'ball': 3, 'status': 0, 'text': '', 'STATUS_OK': 0, 'STATUS_FAILED': 1}
    return SimpleNamespace(**fields | changes, centre=SimpleNamespace(x=0.0, y=0.0, z=0.0))


def struck_by(*kinds, **settings):
    """Return the strikes of faults that strike always."""
    faults = MachineConfig().changed(faults=[{'kind': kind, 'share': 1.0, **settings} for kind in kinds]).faults
    return strikes(faults, seed=1, seq=7, attempt=1)


@pytest.mark.parametrize(('kind', 'changes'), [
    ('wrong_seq', {'seq': 8}), ('wrong_run', {'run_id': 'another_run'}), ('wrong_ball', {'ball': 4}),
    ('failed', {'status': 1, 'text': 'the stylus did not trigger'}),
    ('neighbour', {}), ('table_short', {}), ('clock_back', {}), ('crash', {}),
])
def test_changed_fields(kind, changes):
    """Exactly one answer at once, with exactly these fields changed; the one given stays."""
    given = answer()
    [(got, due)] = distort(given, struck_by(kind), None, now=5.0)
    assert due is None
    assert (got, given) == (answer(**changes), answer())


def test_changed_coordinates():
    """NaN, infinity, and an outlier of the size configured."""
    assert distort(answer(), struck_by('not_a_number'), None, 0.0)[0][0].centre.y != 0
    assert distort(answer(), struck_by('infinite'), None, 0.0)[0][0].centre.z == float('inf')
    centre = distort(answer(), struck_by('outlier', size_um=40.0), None, 0.0)[0][0].centre
    assert (centre.x**2 + centre.y**2 + centre.z**2)**0.5 == pytest.approx(40e-6)
    assert distort(answer(status=1), struck_by('outlier'), None, 0.0)[0][0] == answer(status=1)


def test_delivery():
    """Nothing, late, twice, the answer before again; several faults act one after the other."""
    assert distort(answer(), struck_by('silent'), None, 5.0) == []
    assert distort(answer(), struck_by('late', late_s=2.0), None, 5.0) == [(answer(), 7.0)]
    assert distort(answer(), struck_by('twice'), None, 5.0) == [(answer(), None)] * 2
    before = answer(seq=6)
    assert distort(answer(), struck_by('again'), before, 5.0) == [(before, None), (answer(), None)]
    assert distort(answer(), struck_by('again'), None, 5.0) == [(answer(), None)]
    assert distort(answer(), struck_by('twice', 'wrong_seq'), None, 5.0) == [(answer(), None), (answer(seq=8), None)]


def test_which_answers_are_struck():
    """Those of `at` at their first attempt, or always; a share of the others, the same for the same seed."""
    listed = [{'kind': 'silent', 'at': [4]}, {'kind': 'late', 'at': [4], 'always': True},
              {'kind': 'crash', 'share': 0.1}]
    faults = MachineConfig().changed(faults=listed).faults
    kinds = [[strike.fault.kind for strike in strikes(faults, 1, 4, attempt)] for attempt in (1, 2)]
    assert kinds[0][:2] == ['silent', 'late']
    assert kinds[1][0] == 'late'
    crashes = [seq for seq in range(5, 1005) if strikes(faults, 1, seq, 1)]
    assert len(crashes) == pytest.approx(100, abs=40)
    assert crashes == [seq for seq in range(5, 1005) if strikes(faults, 1, seq, 1)]
