# SPDX-License-Identifier: Apache-2.0
"""Years of a simulated cell: wear that grows, a plate exchanged, a collision, seasons of temperature."""

import numpy as np

from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import machine_config
from rosette_ros.simulation.machine import Machine
from rosette_ros.simulation.motion import MachineState

YEAR = 365.25
_READINGS = 10_000_000
"""Random numbers of a run begin so many readings after those of the run before."""


def years(settings, runs, every_days=7.0, seasons=0.0):
    """Yield day and Run of every calibration; its noise is that of its number.

    settings: function of the day that returns those of the machine, as in machine.yaml; seasons: amplitude of the
    temperature over a year, K."""
    for number in range(runs):
        day = every_days * number
        climate = {'start_degC': 20.0 + seasons * float(np.sin(2 * np.pi * day / YEAR))}
        config = machine_config({'climate': climate, **settings(day)}, f'day {day:g}')
        state = MachineState(**{**vars(Machine(config).state), 'readings': number * _READINGS})
        yield day, Machine(config, state).run(plan(config.plate.balls, 'random', seed=number),
                                              run_id=f'day_{day:06.1f}')
