# SPDX-License-Identifier: Apache-2.0
"""Node parameters: declared with type, range and meaning, refused in words."""

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.nodes.settings import Wanted, unknown_name

_TYPES = {bool: ParameterType.PARAMETER_BOOL, int: ParameterType.PARAMETER_INTEGER,
          float: ParameterType.PARAMETER_DOUBLE, str: ParameterType.PARAMETER_STRING,
          tuple: ParameterType.PARAMETER_DOUBLE_ARRAY}
_OWN = ('use_sim_time', 'start_type_description_service')
"""Parameters that every rclpy node declares for itself."""


class Parameters:
    """The declared parameters of one node.

    The node must have been made with automatically_declare_parameters_from_overrides, so that a
    misspelt name in a file or on the command line is seen and refused.
    """

    def __init__(self, node, wanted: tuple[Wanted, ...]):
        """Declare all; raises InvalidConfig for a wrong value or an unknown name."""
        self._node = node
        self._wanted = {one.name: one for one in wanted}
        self._where = f'node {node.get_name()}: parameter'
        given = node.get_parameters_by_prefix('')
        for name in given:
            if name not in self._wanted and name not in _OWN and 'qos_overrides' not in name:
                raise InvalidConfig(unknown_name(self._where, name, self._wanted))
        for one in wanted:
            self._declare(one, given)
        node.add_on_set_parameters_callback(self._check)

    def __getitem__(self, name):
        """Return the present value."""
        value = self._node.get_parameter(name).value
        return self._wanted[name].check(value, self._where)

    def values(self, wanted):
        """Return name to value for some of the parameters."""
        return {one.name: self[one.name] for one in wanted}

    def _declare(self, one, given):
        value = one.default
        if one.name in given:
            value = one.check(_plain(given[one.name].value), self._where)
            self._node.undeclare_parameter(one.name)
        self._node.declare_parameter(one.name, value, descriptor(one), ignore_override=True)

    def _check(self, parameters):
        for parameter in parameters:
            if parameter.name in self._wanted:
                try:
                    self._wanted[parameter.name].check(_plain(parameter.value), self._where)
                except InvalidConfig as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def descriptor(one):
    """Return the ParameterDescriptor of a setting."""
    made = ParameterDescriptor(
        name=one.name, type=_TYPES[type(one.default)], description=one.text,
        additional_constraints=one.wanted(), read_only=one.read_only)
    if one.low is not None and isinstance(one.default, int):
        made.integer_range = [IntegerRange(from_value=int(one.low), to_value=int(one.high))]
    elif one.low is not None and isinstance(one.default, float):
        made.floating_point_range = [FloatingPointRange(from_value=float(one.low),
                                                        to_value=float(one.high))]
    return made


def _plain(value):
    """Return arrays of parameters as lists."""
    return list(value) if hasattr(value, 'typecode') else value
