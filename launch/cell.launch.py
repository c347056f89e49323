# SPDX-License-Identifier: Apache-2.0
"""Starts a calibration cell: ros2 launch rosette_ros cell.launch.py [simulate:=false] ..."""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from rosette_ros.nodes import environment, names

PACKAGE = 'rosette_ros'
CONFIG = Path(get_package_share_directory(PACKAGE)) / 'config' / 'cell.yaml'


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow once their values are known."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'namespace',
                default_value=names.NAMESPACE,
                description='Namespace of the whole cell; in any other one than the default the cell also has '
                '/tf_static, /tf and /clock of its own',
            ),
            DeclareLaunchArgument(
                'config', default_value=str(CONFIG), description='YAML file with the parameters of the nodes'
            ),
            DeclareLaunchArgument(
                'simulate',
                default_value='true',
                choices=['true', 'false'],
                description='Whether to start the simulated CMM; false where a real one takes its place',
            ),
            DeclareLaunchArgument(
                'machine',
                default_value='',
                description='YAML file that describes the simulated machine; empty: as the config says',
            ),
            DeclareLaunchArgument(
                'use_sim_time',
                default_value=LaunchConfiguration('simulate'),
                choices=['true', 'false'],
                description='Whether the nodes follow /clock; by default when the CMM is simulated, which publishes it',
            ),
            DeclareLaunchArgument(
                'log_dir',
                default_value='',
                description='Folder in which every run gets a folder of its own; empty: as the config says',
            ),
            *(SetEnvironmentVariable(name, value) for name, value in environment.added(os.environ).items()),
            OpaqueFunction(function=cell),
        ]
    )


def cell(context: LaunchContext) -> list[Node]:
    """Return the nodes, who listens first; the end of one ends the cell."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    def node(executable: str, name: str, **parameters: object) -> Node:
        return Node(
            package=PACKAGE,
            executable=executable,
            name=name,
            namespace=given('namespace'),
            parameters=[given('config'), {key: value for key, value in parameters.items() if value != ''}],
            remappings=names.remappings(given('namespace')),
            ros_arguments=['--enclave', names.enclave(given('namespace'), name)],
            output='screen',
            emulate_tty=True,
            on_exit=Shutdown(reason=f'node {name} has ended'),
        )

    use_sim_time = given('use_sim_time') == 'true'
    nodes = [
        node('recorder', 'recorder', use_sim_time=use_sim_time, log_dir=given('log_dir')),
        node('evaluator', 'evaluator', use_sim_time=use_sim_time),
        node('sequencer', 'sequencer', use_sim_time=use_sim_time),
    ]
    if given('simulate') == 'true':
        nodes.insert(2, node('simulated_cmm', 'cmm', machine=given('machine')))
    return nodes
