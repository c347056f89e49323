# SPDX-License-Identifier: Apache-2.0
"""Starts a calibration cell: ros2 launch rosette_ros cell.launch.py [simulate:=false] ..."""

import os
import time
from collections.abc import Callable
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, Substitution
from launch.actions import DeclareLaunchArgument, GroupAction, SetEnvironmentVariable, Shutdown
from launch.conditions import IfCondition
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node, SetParameter, SetParametersFromFile, SetRemap

from rosette_ros.cell.supervisor import CHECK_PERIOD, FAILURES_WITHIN, MOST_FAILURES, added_environment
from rosette_ros.nodes import names

PACKAGE = 'rosette_ros'
CONFIG = Path(get_package_share_directory(PACKAGE)) / 'config' / 'cell.yaml'


class Namespace(Substitution):
    """The argument `namespace` without the slashes around it."""

    def perform(self, context: LaunchContext) -> str:
        """Return the text."""
        return LaunchConfiguration('namespace').perform(context).strip('/')


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the nodes, those that only subscribe first."""
    in_other_namespace = IfCondition(NotEqualsSubstitution(Namespace(), names.NAMESPACE))
    return LaunchDescription([
        DeclareLaunchArgument(
            'namespace', default_value=names.NAMESPACE,
            description='Namespace of the whole cell; in any other one than the default the cell also has /tf_static, '
            '/tf and /clock of its own'),
        DeclareLaunchArgument(
            'config', default_value=str(CONFIG), description='YAML file with the parameters of the nodes'),
        DeclareLaunchArgument(
            'simulate', default_value='true', choices=['true', 'false'],
            description='Whether to start the simulated CMM; false where a real one takes its place'),
        DeclareLaunchArgument(
            'machine', default_value='',
            description='YAML file that describes the simulated machine; empty: as the config says'),
        DeclareLaunchArgument(
            'settings', default_value='',
            description='Settings file of a CMM with an I++ DME server, which then takes part (with simulate:=false)'),
        DeclareLaunchArgument(
            'use_sim_time', default_value=LaunchConfiguration('simulate'), choices=['true', 'false'],
            description='Whether the nodes follow /clock; by default when the CMM is simulated, which publishes it'),
        DeclareLaunchArgument(
            'log_dir', default_value='',
            description='Folder in which every run gets a folder of its own; empty: as the config says'),
        *(SetEnvironmentVariable(name, value) for name, value in added_environment(os.environ).items()),
        *(SetRemap(name, name.lstrip('/'), condition=in_other_namespace) for name in names.OF_A_DOMAIN),
        node('recorder', 'recorder', 'use_sim_time', 'log_dir'),
        node('evaluator', 'evaluator', 'use_sim_time'),
        node('simulated_cmm', 'cmm', 'machine', condition=IfCondition(LaunchConfiguration('simulate'))),
        node('dme_cmm', 'cmm', 'settings',
             condition=IfCondition(NotEqualsSubstitution(LaunchConfiguration('settings'), ''))),
        node('sequencer', 'sequencer', 'use_sim_time'),
    ])


def node(executable: str, name: str, *arguments: str, condition: IfCondition | None = None) -> GroupAction:
    """Return the actions that start a node and restart it when it has failed.

    arguments: launch arguments that are parameters of the node; those that are not empty win over the config.
    """
    return GroupAction([
        SetParametersFromFile(LaunchConfiguration('config')),
        *(SetParameter(argument, LaunchConfiguration(argument),
                       condition=IfCondition(NotEqualsSubstitution(LaunchConfiguration(argument), '')))
          for argument in arguments),
        Node(package=PACKAGE, executable=executable, name=name, namespace=Namespace(),
             ros_arguments=['--enclave', ['/', Namespace(), '/', name]], output='screen', emulate_tty=True,
             respawn=True, respawn_delay=CHECK_PERIOD, on_exit=end_of(name)),
    ], condition=condition)


def end_of(name: str) -> Callable[[ProcessExited, LaunchContext], list[Shutdown] | None]:
    """Return what follows the end of a node: that of the cell, where it ends too often, as with `rosette cell`."""
    ends: list[float] = []

    def on_exit(event: ProcessExited, context: LaunchContext) -> list[Shutdown] | None:
        ends.append(time.monotonic())
        recent = [one for one in ends if ends[-1] - one < FAILURES_WITHIN]
        if len(recent) < MOST_FAILURES:
            return None
        return [Shutdown(reason=f'node {name} has ended {len(recent)} times within {FAILURES_WITHIN:g} s')]

    return on_exit
