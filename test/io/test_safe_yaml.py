# SPDX-License-Identifier: Apache-2.0
"""Numbers and paths as a person writes them in YAML."""

import pytest

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.io.plan_file import read_plan
from rosette_ros.io.plate_file import read_plate
from rosette_ros.io.safe_yaml import parse_yaml
from rosette_ros.simulation import load_machine


@pytest.mark.parametrize(('text', 'wanted'), [
    ('[0.35, 0.26, 0]', [0.35, 0.26, 0.0]), ('[1, 2.5]', [1.0, 2.5]), ('- 1\n- 2.0\n', [1.0, 2.0]), ('[1, 2]', [1, 2]),
    ('[true, 1.0]', [True, 1.0]), ('[1, 2.0, a]', [1, 2.0, 'a']),
    ('{a: [[0, 0.5], [1, 2]]}', {'a': [[0.0, 0.5], [1, 2]]})])
def test_whole_numbers_beside_floats_are_floats(text, wanted):
    """Only in a list of numbers, of which one at least is a float."""
    assert repr(parse_yaml(text.encode(), 'x', InvalidConfig)) == repr(wanted)


def test_the_home_of_the_user_is_found_in_every_file(tmp_path, monkeypatch):
    """By the paths of files, and by paths in them."""
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'plate.yaml').write_text('{schema: rosette-plate/1, azimuth_deg: [0, 90.5, 180], radius_mm: 100}')
    (tmp_path / 'plan.yaml').write_text('{schema: rosette-plan/1, balls: 5, radius_mm: 100, order: row}')
    (tmp_path / 'machine.yaml').write_text('{table: {correction_file: ~/correction.yaml}}')
    assert read_plate('~/plate.yaml').balls == 3
    assert read_plan('~/plan.yaml').scheme.n == 5
    assert load_machine('~/machine.yaml').table.correction_file == str(tmp_path / 'correction.yaml')
