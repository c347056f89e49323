# SPDX-License-Identifier: Apache-2.0
"""The configuration: the file shipped holds the defaults, and what is wrong is reported in one line."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from ideal_cell import ideal_cell
from pydantic import ValidationError

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.simulation import MachineConfig, load_machine, machine_config

SHIPPED = Path(__file__).parents[2] / 'config' / 'machine.yaml'
DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [1, 2, 3]}


def test_shipped_file_holds_every_default():
    """config/machine.yaml names every setting, with its default."""
    values = yaml.safe_load(SHIPPED.read_text())
    config = load_machine(SHIPPED)
    assert config == MachineConfig()
    dumped = config.model_dump()
    del dumped['hidden_draw']
    assert values.keys() == dumped.keys()
    for group in values:
        if isinstance(values[group], dict):
            assert values[group].keys() == dumped[group].keys()


@pytest.mark.parametrize(('values', 'words'), [
    ({'plate': {'bals': 3}}, r"plate.bals: expected 'balls', found 'bals'"),
    ({'colour': 3}, r"colour: expected one of .*clamping.*, found 'colour'"),
    ({'plate': {'balls': '12'}}, r"plate.balls: expected a whole number, found '12'"),
    ({'plate': {'balls': 2}}, r'plate.balls: expected greater than or equal to 3, found 2'),
    ({'plate': 3}, r'plate: expected a mapping of settings, found 3'),
    ({'probing': {'repeatability_um': float('nan')}},
     r'probing.repeatability_um: expected a finite number, found nan'),
    ({'probing': {'repeatability_um': -1}}, r'expected greater than or equal to 0, found -1'),
    ({'cmm': {'correction': 1}}, r'cmm.correction: expected true or false, found 1'),
    ({'placement': {'origin_mm': [1, 'a', 3]}},
     r"placement.origin_mm.2: expected a number, found 'a'"),
    ({'clamping': {'plate_turn_deg': 10.0}},
     r'clamping.plate_turn_deg: expected a multiple of 30 deg \(one ball pitch\), found 10'),
    ({'probing': {'below_pole_mm': 9.0}}, r'expected circles on the ball, less than .* = 7.5'),
    ({'hidden': 3}, r'hidden: expected a list, found 3'),
    ({'hidden': [3]}, r'hidden.1: expected a mapping with a `kind`, found 3'),
    ({'hidden': [{'x': 1}]}, r"hidden.1: expected an effect with its `kind`, found \{'x': 1\}"),
    ({'hidden': [DRIFT, {'kind': 'drift'}]},
     r"hidden.2: expected kind: one of 'frame_drift', .*, found 'drift'"),
    ({'hidden': [{'kind': 'frame_drift', 'rate': 3}]},
     r"hidden.1.rate: expected one of kind, rate_um_per_h, found 'rate' \(and 1 more\)"),
    ({'hidden': [{'kind': 'frame_drift'}]},
     r'hidden.1.rate_um_per_h: expected a value, found nothing'),
    ({'hidden': [{'kind': 'ball_slip', 'ball': 13, 'shift_um': [1, 2, 3], 'at_h': 1}]},
     r'hidden.1.ball: expected 1..12, found 13'),
    ({'hidden': {'seed': -1}}, r'hidden.seed: expected greater than or equal to 0, found -1'),
    ({'hidden': {'sed': 1}}, r"hidden.sed: expected 'seed', found 'sed'"),
    ({'hidden': {'seed': 1, 'kinds': ['drift']}},
     r"hidden.kinds.1: expected one of frame_drift, .*, found 'drift'"),
    ({'hidden': {'seed': 1, 'fewest': 3, 'most': 2}},
     r'hidden: fewest: expected at most most = 2, found 3'),
    ({'faults': [{'kind': 'slow'}]}, r"faults.1.kind: expected one of silent, late, .*, crash, found 'slow'"),
    ([1], r'expected a mapping of settings, found \[1\]'),
])
def test_wrong_settings_are_reported_in_one_line(values, words):
    """File, key, what was wanted, what came."""
    with pytest.raises(InvalidConfig, match=r'^cell.yaml: .*' + words) as caught:
        machine_config(values, 'cell.yaml')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('text', 'words'), [
    ('plate: [', 'expected YAML, found text that is none: '),
    ('!!python/object/apply:os.system ["true"]',
     'expected YAML, found text that is none: line 1, column 1: could not determine a cons'),
    ('a: &a [1]\nb: *a', r'line 2: expected plain YAML, found an alias \(\*name\); write it out'),
    ('[' * 60000, 'line 1: expected at most 20 levels of nesting, found more'),
    ('#' * 70000, 'expected a machine file of at most 65536 bytes, found more'),
])
def test_wrong_files_are_reported_in_one_line(tmp_path, text, words):
    """A file that is no YAML, or wants to run code, is refused."""
    path = tmp_path / 'cell.yaml'
    path.write_text(text)
    with pytest.raises(InvalidConfig, match=f'cell.yaml: {words}') as caught:
        load_machine(path)
    assert '\n' not in str(caught.value)


def test_missing_file_and_empty_file(tmp_path):
    """No file is an error, an empty one holds the defaults."""
    with pytest.raises(InvalidConfig, match='none.yaml: expected a machine file that can be read, found No such'):
        load_machine(tmp_path / 'none.yaml')
    (tmp_path / 'empty.yaml').write_text('')
    assert load_machine(tmp_path / 'empty.yaml') == MachineConfig()


def test_configuration_is_frozen():
    """A configuration cannot be changed, only copied with changes."""
    config = MachineConfig()
    with pytest.raises(ValidationError, match='frozen'):
        config.seed = 3
    changed = config.changed(seed=3, plate={'balls': 6}, hidden=[DRIFT])
    assert (changed.seed, changed.plate.balls, changed.plate.ball_radius_mm) == (3, 6, 7.5)
    assert config == MachineConfig()
    assert changed.changed(hidden={'seed': 4}).hidden_draw.seed == 4


@given(st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(['seed', 'plate', 'balls', 'hidden', 'kind', 'frame_drift', 'cmm']),
        inner, max_size=3), max_leaves=6))
def test_nonsense_is_refused_in_words(values):
    """Whatever stands in a file, it is a configuration or one line of complaint."""
    try:
        answer = machine_config(values, 'cell.yaml')
    except InvalidConfig as error:
        answer = str(error)
    complaint = isinstance(answer, str) and answer.startswith('cell.yaml: ')
    assert isinstance(answer, MachineConfig) or (complaint and '\n' not in answer)


def test_ideal_cell_takes_changes():
    """An ideal cell has neither errors nor noise but those asked for."""
    cell = ideal_cell(table={'rotation_urad': 0.3})
    assert cell.table.rotation_urad == 0.3
    assert cell.table.translation_um == 0.0
    assert cell.probing.repeatability_um == 0.0
