# SPDX-License-Identifier: Apache-2.0
"""Numbers and paths as a person writes them in YAML."""

import re

import pytest
import yaml

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.io.identity_file import format_identity, parse_identity, read_identity
from rosette_ros.io.model_file import read_model
from rosette_ros.io.plan_file import read_plan
from rosette_ros.io.plate_file import read_plate
from rosette_ros.io.safe_yaml import PlainDumper, parse_yaml
from rosette_ros.simulation import load_machine

IDENTITY = 'schema: rosette-identity/1\ntable: {serial: "12E4"}'


@pytest.mark.parametrize(('text', 'wanted'), [
    ('[0.35, 0.26, 0]', [0.35, 0.26, 0.0]), ('[1, 2.5]', [1.0, 2.5]), ('- 1\n- 2.0\n', [1.0, 2.0]), ('[1, 2]', [1, 2]),
    ('[true, 1.0]', [True, 1.0]), ('[1, 2.0, a]', [1, 2.0, 'a']),
    ('{a: [[0, 0.5], [1, 2]]}', {'a': [[0.0, 0.5], [1, 2]]})])
def test_whole_numbers_beside_floats_are_floats(text, wanted):
    """Only in a list of numbers, of which one at least is a float."""
    assert repr(parse_yaml(text.encode(), 'x', InvalidConfig)) == repr(wanted)


@pytest.mark.parametrize(('text', 'wanted'), [
    ('13e-2', 0.13), ('2e1', 20.0), ('1e-6', 1e-6), ('-1.5E+3', -1500.0), ('.5e1', 5.0), ('5.e0', 5.0),
    ('1.0e-6', 1e-6), ('"2e1"', '2e1'), ('e1', 'e1'), ('2e', '2e'), ('1e5a', '1e5a'), ('1e', '1e'),
    ('12', 12), ('0', 0), ('-0.0', -0.0), ('0.0010', 0.001), ('0815', '0815'), ('1:3a', '1:3a'),
    ('.inf', float('inf'))])
def test_numbers_with_exponents_are_numbers(text, wanted):
    """As people write them; in quotes they are text, and are written so."""
    assert repr(parse_yaml(text.encode(), 'x', InvalidConfig)) == repr(wanted)
    again = yaml.dump([wanted], Dumper=PlainDumper)
    assert repr(parse_yaml(again.encode(), 'x', InvalidConfig)) == repr([wanted])


@pytest.mark.parametrize('text', [
    '010', '1:30', '0x10', '0b11', '1_000', '-07', '+0x1F', '1:30.5', '1_0.5', '-1:20:30'])
def test_numbers_that_mean_another_one_are_refused(text):
    """YAML 1.1 reads 8, 90, 16, 3 and 1000 of the first ones; a list and a nested value name their line, too."""
    for place in (text, f'[1.5, {text}]', f'a:\n  b: {text}'):
        with pytest.raises(InvalidConfig, match=rf'x: line \d: expected a number in decimal digits, without leading '
                           rf'zeros, found {re.escape(repr(text))}; write a text in quotes'):
            parse_yaml(place.encode(), 'x', InvalidConfig)
        assert repr(text) in repr(parse_yaml(place.replace(text, f'"{text}"').encode(), 'x', InvalidConfig))


def test_every_file_takes_exponents(tmp_path):
    """Machine, plan, model; a serial number 12E4 stays a text from file to file."""
    files = {
        'machine': 'plate: {deviation_um: 2e1}', 'model': 'effects: [{name: frame_warmup, tau: 6e2}]',
        'plan': '{schema: rosette-plan/1, balls: 5, radius_mm: 1e2, order: row}', 'identity': IDENTITY}
    for name, text in files.items():
        (tmp_path / f'{name}.yaml').write_text(text)
    assert load_machine(tmp_path / 'machine.yaml').plate.deviation_um == 20
    assert read_plan(tmp_path / 'plan.yaml').radius == 0.1
    assert read_model(tmp_path / 'model.yaml').terms[0].fixed == {'tau': 600.0}
    identity = read_identity(tmp_path / 'identity.yaml')
    assert parse_identity(format_identity(identity).encode(), 'x')['table.serial'] == identity['table.serial'] == '12E4'


def test_the_home_of_the_user_is_found_in_every_file(tmp_path, monkeypatch):
    """By the paths of files, and by paths in them."""
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'plate.yaml').write_text('{schema: rosette-plate/1, azimuth_deg: [0, 90.5, 180], radius_mm: 100}')
    (tmp_path / 'plan.yaml').write_text('{schema: rosette-plan/1, balls: 5, radius_mm: 100, order: row}')
    (tmp_path / 'machine.yaml').write_text('{table: {correction_file: ~/correction.yaml}}')
    assert read_plate('~/plate.yaml').balls == 3
    assert read_plan('~/plan.yaml').scheme.n == 5
    assert load_machine('~/machine.yaml').table.correction_file == str(tmp_path / 'correction.yaml')
