# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG003, N815 (every effect is drawn alike; the unit kelvin is a capital letter)
"""What moves the table against the probe: drift, warm-up, temperature, cycles, steps."""

from typing import Literal

import numpy as np

from rosette_ros.machine.hidden.base import HiddenEffect, along, drawn_time, drawn_vector
from rosette_ros.machine.settings import NotNegative, Positive, Vector

TWO_PI = 2 * np.pi


class FrameDrift(HiddenEffect):
    """The table drifts steadily against the probe: rate * t."""

    kind: Literal['frame_drift'] = 'frame_drift'
    rate_um_per_h: Vector

    def frame_shift(self, moment):
        """Return rate * t."""
        return along(self.rate_um_per_h, moment.hours)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that moves by about `size_um` during the run."""
        return cls(rate_um_per_h=drawn_vector(rng, size_um / situation.duration_h))


class FrameWarmup(HiddenEffect):
    """Something was switched on too late: amplitude * (1 - exp(-(t - from) / tau))."""

    kind: Literal['frame_warmup'] = 'frame_warmup'
    amplitude_um: Vector
    time_constant_h: Positive
    from_h: NotNegative = 0.0

    def frame_shift(self, moment):
        """Return amplitude * (1 - exp(-(t - from) / tau)), nothing before."""
        since = np.maximum(moment.hours - self.from_h, 0.0)
        return along(self.amplitude_um, -np.expm1(-since / self.time_constant_h))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that begins just before the run, over a tenth to half of it."""
        return cls(amplitude_um=drawn_vector(rng, size_um), from_h=0.95 * situation.start_h,
                   time_constant_h=situation.duration_h * float(rng.uniform(0.1, 0.5)))


class FrameTemperature(HiddenEffect):
    """The machine's frame follows the room: coefficient * (T - T at power-on)."""

    kind: Literal['frame_temperature'] = 'frame_temperature'
    coefficient_um_per_K: Vector

    def frame_shift(self, moment):
        """Return coefficient * warming."""
        return along(self.coefficient_um_per_K, moment.warming)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that moves by about `size_um` for a warming of 0.1 K."""
        return cls(coefficient_um_per_K=drawn_vector(rng, size_um / 0.1))


class FrameCycle(HiddenEffect):
    """Air conditioning or coolant: cosine * cos(2 pi t / P) + sine * sin(2 pi t / P)."""

    kind: Literal['frame_cycle'] = 'frame_cycle'
    cosine_um: Vector
    sine_um: Vector = (0.0, 0.0, 0.0)
    period_min: Positive

    def frame_shift(self, moment):
        """Return the periodic shift."""
        phase = TWO_PI * moment.time / (60.0 * self.period_min)
        return along(self.cosine_um, np.cos(phase)) + along(self.sine_um, np.sin(phase))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one with three to twelve periods in the run."""
        return cls(cosine_um=drawn_vector(rng, size_um), sine_um=drawn_vector(rng, size_um),
                   period_min=60 * situation.duration_h / float(rng.uniform(3, 12)))


class FrameStep(HiddenEffect):
    """Somebody bumped into it, or the probe was requalified: a step at one time."""

    kind: Literal['frame_step'] = 'frame_step'
    step_um: Vector
    at_h: NotNegative

    def frame_shift(self, moment):
        """Return the step from its time on."""
        return along(self.step_um, moment.hours >= self.at_h)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one in the middle of the run."""
        return cls(step_um=drawn_vector(rng, size_um),
                   at_h=drawn_time(rng, situation))
