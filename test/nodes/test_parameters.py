# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes: declared with their meaning, refused in words."""

from pathlib import Path

import pytest
import rclpy
import yaml
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.nodes import base_node, evaluator, recorder, sequencer, simulated_cmm
from rosette_ros.nodes.base_node import CellNode

CELL_YAML = Path(__file__).parents[2] / 'config' / 'cell.yaml'
WANTED = (Wanted('plate.balls', 12, 'number of balls', 3, 1000),
          Wanted('plate.radius_m', 0.1, 'radius, m', 0.001, 10.0),
          Wanted('order', 'row', 'order of measurement', choices=('row', 'column')),
          Wanted('origin', (0.0, 0.0, 0.0), 'origin, m', -1.0, 1.0),
          Wanted('machine', '', 'file', read_only=True))


class Example(CellNode):
    """A node with one parameter of each kind."""

    def __init__(self):
        super().__init__('example', WANTED)


@pytest.fixture
def example(ros):
    """Return a function that makes the node with parameters from the command line."""
    made = []

    def make(*settings):
        args = [part for setting in settings for part in ('-p', setting)]
        context = ros(*args)
        context.__enter__()
        made.append((context, None))
        node = Example()
        made[-1] = (context, node)
        return node

    yield make
    for context, node in made:
        if node is not None:
            node.destroy_node()
        context.__exit__(None, None, None)


def test_defaults_and_overrides(example):
    """What is given on the command line holds, whole numbers too where a number is wanted."""
    node = example('plate.balls:=6', 'plate.radius_m:=1', 'origin:=[0.5, 0.0, 1.0]')
    assert node.parameters['plate.balls'] == 6
    assert node.parameters['plate.radius_m'] == 1.0
    assert node.parameters['origin'] == (0.5, 0.0, 1.0)
    assert node.parameters['order'] == 'row'


@pytest.mark.parametrize(('setting', 'words'), [
    ('plate.balls:=2', r'node example: parameter: plate.balls: expected a whole number in 3 \.\. 1000'
                       r' \(number of balls\), found 2'),
    ('plate.balls:=twelve', "found 'twelve'"),
    ('plate.radius_m:=.nan', r'expected a number in 0\.001 \.\. 10 .* found nan'),
    ('order:=circle', "order: expected one of row, column .* found 'circle'"),
    ('origin:=[1.0, 2.0]', 'expected a list of 3 numbers'),
    ('plate.bals:=6', "node example: parameter: expected one of .*, found 'plate.bals'; did you mean 'plate.balls'"),
])
def test_wrong_override_is_refused_in_words(example, setting, words):
    """The node does not start."""
    with pytest.raises(InvalidConfig, match=words):
        example(setting)


@pytest.mark.parametrize(('name', 'value', 'words'), [
    ('plate.balls', 2, 'plate.balls out of range. Min: 3, Max: 1000, value: 2'),
    ('order', 'circle', 'expected one of row, column'),
    ('origin', [0.0, 0.0, 5.0], 'expected a list of 3 numbers in -1'),
    ('machine', 'other.yaml', 'read-only'),
    ('plate.balls', 'many', "expected 'Type.INTEGER' got 'Type.STRING'"),
])
def test_wrong_setting_at_run_time_is_refused_in_words(example, name, value, words):
    """The old value stays."""
    node = example()
    before = node.parameters[name]
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert words in result.reason
    assert node.parameters[name] == before


def test_right_setting_at_run_time_is_taken(example):
    """Parameters can be changed between runs."""
    node = example()
    (result,) = node.set_parameters([Parameter('plate.balls', value=24)])
    assert result.successful
    assert node.parameters['plate.balls'] == 24


def test_descriptors_tell_type_range_and_meaning(example):
    """What tools such as rqt show."""
    node = example()
    balls = node.describe_parameter('plate.balls')
    assert balls.type == ParameterType.PARAMETER_INTEGER
    assert (balls.integer_range[0].from_value, balls.integer_range[0].to_value) == (3, 1000)
    assert balls.description == 'number of balls'
    radius = node.describe_parameter('plate.radius_m')
    assert radius.floating_point_range[0].to_value == 10.0
    assert node.describe_parameter('order').additional_constraints == 'one of row, column'
    assert node.describe_parameter('machine').read_only


NODES = {'sequencer': (*sequencer.CALIBRATION, *sequencer.CELL, base_node.AUTOSTART),
         'cmm': simulated_cmm.WANTED, 'evaluator': evaluator.WANTED,
         'recorder': recorder.WANTED}


def flat(mapping, prefix=''):
    for name, value in mapping.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


@pytest.mark.parametrize('name', NODES)
def test_cell_yaml_holds_every_parameter_at_its_default(name):
    """The file that a user edits shows all there is, and nothing else."""
    content = yaml.safe_load(CELL_YAML.read_text(encoding='utf-8'))
    given = dict(flat(content[f'/**/{name}']['ros__parameters']))
    given.pop('use_sim_time', None)
    defaults = {wanted.name: wanted.default for wanted in NODES[name]}
    assert {key: tuple(value) if isinstance(value, list) else value
            for key, value in given.items()} == defaults


def test_cell_yaml_is_read_by_the_nodes(ros):
    """The file works as a params file in a namespace."""
    with ros('--params-file', str(CELL_YAML), '-r', '__ns:=/rosette'):
        node = sequencer.Sequencer()
        assert node.get_parameter('use_sim_time').value is True
        assert node.parameters['limits.search_m'] == 0.02
        assert node.get_fully_qualified_name() == '/rosette/sequencer'
        node.destroy_node()
    assert not rclpy.ok()
