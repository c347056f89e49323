# SPDX-License-Identifier: Apache-2.0
"""Node parameters: declared with type, range and meaning, refused in words."""

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from rosette_ros.calibration.settings import Value, Wanted
from rosette_ros.core.run.errors import InvalidConfig, unknown
from rosette_ros.nodes.names import NODES

_OWN = ('use_sim_time', 'start_type_description_service')  # what every rclpy node declares for itself


class Parameters:
    """The declared parameters of one node.

    The node must have been made with automatically_declare_parameters_from_overrides, so that a misspelt name in a file
    or on the command line is seen and refused."""

    def __init__(self, node: Node, wanted: Iterable[Wanted]) -> None:
        self._node = node
        self._wanted = {one.name: one for one in wanted}
        self._where = f'node {node.get_name()}: parameter'
        given = node.get_parameters_by_prefix('')
        for name in given:
            if name not in self._wanted and name not in _OWN and 'qos_overrides' not in name:
                raise InvalidConfig(f'{self._where}: {unknown(name, self._wanted)}')
        for name, one in self._wanted.items():
            value = one.default
            if name in given:
                value = one.check(_plain(given[name].value), self._where)
                node.undeclare_parameter(name)
            node.declare_parameter(name, value, _descriptor(one), ignore_override=True)
        node.add_on_set_parameters_callback(self._check)

    def __getitem__(self, name: str) -> Any:
        return self._wanted[name].check(_plain(self._node.get_parameter(name).value), self._where)

    def values(self, wanted: Iterable[Wanted]) -> dict[str, Value]:
        """Return name to value for some of the parameters."""
        return {one.name: self[one.name] for one in wanted}

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name in self._wanted:
                try:
                    self._wanted[parameter.name].check(_plain(parameter.value), self._where)
                except InvalidConfig as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def refuse_unknown_sections(arguments: Sequence[str], node: Node) -> None:
    """Raise InvalidConfig where a parameter file in the arguments has a section that is none of a node of the cell.

    ROS ignores such a section without a word."""
    names_here = [f'{node.get_namespace().rstrip("/")}/{name}' for name in (*NODES, node.get_name())]
    for path in (after for flag, after in pairwise(arguments) if flag == '--params-file'):
        with open(path, encoding='utf-8') as stream:
            content = yaml.safe_load(stream)
        for section, _ in sections(content):
            pattern = re.escape(section).replace(r'/\*\*', '(/[^/]+)*').replace(r'\*', '[^/]+')
            if not any(re.fullmatch(pattern, name) for name in names_here):
                near = difflib.get_close_matches(section.rpartition('/')[2], NODES, 1, 0.3) or NODES
                raise InvalidConfig(
                    f'{path}: section {section[1:]!r}: expected the name of a node in the namespace '
                    f'{node.get_namespace()}, found one that belongs to none; did you mean /**/{near[0]}?')


def sections(content: Any, before: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the full name of the nodes, with wildcards, and the parameters of each section of a parameter file."""
    for key, value in content.items() if isinstance(content, dict) else ():
        name = f'{before}/{str(key).strip("/")}'
        if isinstance(value, dict):
            yield from [(name, value['ros__parameters'])] if 'ros__parameters' in value else sections(value, name)


def _descriptor(one: Wanted) -> ParameterDescriptor:
    """Return what tools show of a setting; the type is that of its default."""
    made = ParameterDescriptor(
        name=one.name, description=one.text, additional_constraints=one.wanted(), read_only=one.read_only)
    if one.is_bounded and isinstance(one.default, int):
        made.integer_range = [IntegerRange(from_value=int(one.low), to_value=int(one.high))]
    elif one.is_bounded and isinstance(one.default, float):
        made.floating_point_range = [FloatingPointRange(from_value=float(one.low), to_value=float(one.high))]
    return made


def _plain(value: Any) -> Any:
    return list(value) if hasattr(value, 'typecode') else value
