# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: exact rigid bodies, real touches, and effects that it hides.

It shares no effect code with the library of named effects: what it hides must be found from
physics.
"""

from rosette_ros.machine.config import MachineConfig, load_machine, machine_config, quiet
from rosette_ros.machine.machine import Machine
from rosette_ros.machine.readings import Alignment, BallNotFound, Reading, Readings

__all__ = ['Alignment', 'BallNotFound', 'Machine', 'MachineConfig', 'Reading', 'Readings',
           'load_machine', 'machine_config', 'quiet']
