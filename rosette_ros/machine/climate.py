# SPDX-License-Identifier: Apache-2.0
"""The temperature at the plate: slow drift, the day, the air conditioning."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.machine.streams import part_generator

_DAY = 86400.0


@dataclass(frozen=True, eq=False)
class Climate:
    """Temperature at power-on [°C], rate [K/s], amplitudes [K], paces [rad/s], phases [rad]."""

    start: float
    rate: float
    amplitude: np.ndarray
    pace: np.ndarray
    phase: np.ndarray

    def warming(self, time):
        """Return the temperature against that at power-on at times (...) [s], same shape, K."""
        warming = self.rate * time
        for amplitude, pace, phase in zip(self.amplitude, self.pace, self.phase, strict=True):
            warming = warming + amplitude * (np.sin(pace * time + phase) - np.sin(phase))
        return warming


def build_climate(settings, seed):
    """Return the Climate of ClimateSettings."""
    return Climate(settings.start_degC, settings.drift_K_per_h / 3600.0,
                   np.array([settings.daily_K, settings.cycle_K]),
                   TWO_PI / np.array([_DAY, 60.0 * settings.cycle_min]),
                   part_generator(seed, 'climate').uniform(0, TWO_PI, 2))
