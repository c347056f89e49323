# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: exact rigid bodies, real touches, and effects that it hides.

It shares no effect code with the library of named effects: what it hides must be found from physics.
"""

from rosette_ros.simulation.machine import Alignment, Machine, MachineConfig, load_machine, machine_config
from rosette_ros.simulation.probing import BallNotFound, BallReading, BallReadings

__all__ = ['Alignment', 'BallNotFound', 'BallReading', 'BallReadings', 'Machine', 'MachineConfig', 'load_machine',
           'machine_config']
