# SPDX-License-Identifier: Apache-2.0
"""Starts the table corrector: ros2 launch rosette_ros table_corrector.launch.py correction:=FILE [joint:=...] ..."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rosette_ros.nodes import names
from rosette_ros.nodes.table_corrector import WANTED


def generate_launch_description() -> LaunchDescription:
    """Declare an argument for each parameter of the node, and start it; without `correction` it ends with an error."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='', description='Namespace of joint_states and of the node'),
        *(DeclareLaunchArgument(one.name, default_value=str(one.default), description=one.text) for one in WANTED),
        Node(package='rosette_ros', executable=names.TABLE_CORRECTOR, name=names.TABLE_CORRECTOR,
             namespace=LaunchConfiguration('namespace'), output='screen', emulate_tty=True,
             parameters=[{one.name: ParameterValue(LaunchConfiguration(one.name), value_type=type(one.default))
                          for one in WANTED}]),
    ])
