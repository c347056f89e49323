# SPDX-License-Identifier: Apache-2.0
"""Effects of the machine frame: the probe moves against the table."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import (
    Quantity,
    Searched,
    Setting,
    between_readings,
    duration,
    logarithmic_grid,
    seconds,
    unit,
)
from rosette_ros.core.effects.factored import FactoredEffect

AXES = ('xyz', 'x', 'y', 'z')
_AXES = Searched('axes', '', 'which axes move: all three together or one alone')


def _per_axis(axes, name, unit, meaning):
    return tuple(Quantity(f'{name}_{axis}', unit, f'{meaning} along {axis}') for axis in axes)


@dataclass(frozen=True)
class FrameEffect(FactoredEffect):
    """The machine frame moves along one axis or all three, by functions of time or temperature."""

    def directions(self, run):
        """Return the unit vectors of x, y, z, (3, N, 3)."""
        return np.stack([unit(axis, run.size) for axis in range(3)])

    def which(self, setting):
        """Return the axes of a setting."""
        return tuple('xyz'.index(axis) for axis in setting['axes'])


@dataclass(frozen=True)
class FrameDrift(FrameEffect):
    """Linear drift d t of the probe against the table, machine frame."""

    name: str = 'frame_drift'
    meaning: str = 'The probe drifts steadily against the table, in the frame of the machine.'
    look: str = ('Temperature of the hall and of the quill, time since switching on, draughts; '
                 'let the machine soak or measure faster.')
    formula: str = 'd t'
    source: str = 'ISO 230-3 (drift over a stated period); GUM F.1.1.2'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'all'
    searched: tuple[Searched, ...] = (_AXES,)

    def settings(self, run):
        """Try all axes together and each alone."""
        return tuple(Setting(axes=axes) for axes in AXES)

    def amplitudes(self, run, setting):
        """Return the drift rates."""
        return _per_axis(setting['axes'], 'd', 'm/s', 'drift rate')

    def scalars(self, run, values):
        """Return t, s."""
        return np.tile(seconds(run), (len(values), 1, 1))


@dataclass(frozen=True)
class FrameWarmup(FrameEffect):
    """Exponential approach d (1 - exp(-t/tau)) of the probe against the table."""

    name: str = 'frame_warmup'
    meaning: str = 'The probe moves against the table as the machine warms up, and settles.'
    look: str = 'Drives, spindle and controller since switching on; start after a warm-up cycle.'
    formula: str = 'd (1 - exp(-t/tau))'
    source: str = 'ISO 230-3 (warm-up of the structure)'
    depends_on: tuple[str, ...] = ('time',)
    searched: tuple[Searched, ...] = (_AXES, Searched('tau', 's', 'time constant', 'scale'))

    def settings(self, run):
        """Try time constants from a fiftieth of the run to the whole of it."""
        taus = logarithmic_grid(duration(run) / 50, duration(run), 14)
        return tuple(Setting(axes=axes, tau=float(tau)) for axes in AXES for tau in taus)

    def independent_settings(self, run):
        """Neighbouring time constants look alike."""
        return 4 * 5

    def amplitudes(self, run, setting):
        """Return the final displacements."""
        return _per_axis(setting['axes'], 'd', 'm', 'final displacement')

    def scalars(self, run, values):
        """Return 1 - exp(-t/tau)."""
        return -np.expm1(-seconds(run) / values)[:, None]


@dataclass(frozen=True)
class FrameTemperature(FrameEffect):
    """Displacement d (T - T0) that follows the measured temperature."""

    name: str = 'frame_temperature'
    meaning: str = 'The probe moves against the table with the measured temperature.'
    look: str = 'Air conditioning, sunlight, doors; the scales and the quill expand.'
    formula: str = 'd (T - T0)'
    source: str = 'ISO 230-3 (environmental temperature variation error)'
    depends_on: tuple[str, ...] = ('temperature',)
    carries: str = 'all'
    searched: tuple[Searched, ...] = (_AXES,)

    def settings(self, run):
        """Try all axes together and each alone; nothing where the temperature stands still."""
        if np.ptp(run.temperature) == 0:
            return ()
        return tuple(Setting(axes=axes) for axes in AXES)

    def amplitudes(self, run, setting):
        """Return the displacements per kelvin."""
        return _per_axis(setting['axes'], 'd', 'm/K', 'displacement per kelvin')

    def scalars(self, run, values):
        """Return T - T0, T0 the first temperature, K."""
        return np.tile(run.temperature - run.temperature[0], (len(values), 1, 1))


@dataclass(frozen=True)
class FrameCycle(FrameEffect):
    """Periodic displacement a cos(2 pi t/P) + b sin(2 pi t/P)."""

    name: str = 'frame_cycle'
    meaning: str = 'The probe swings against the table with a fixed period in time.'
    look: str = 'Air conditioning that switches, cooling units, hydraulic or compressed air cycles.'
    formula: str = 'a cos(2 pi t/P) + b sin(2 pi t/P)'
    source: str = 'ISO 230-3 (environmental temperature variation error)'
    depends_on: tuple[str, ...] = ('time',)
    searched: tuple[Searched, ...] = (_AXES, Searched('period', 's', 'period', 'scale'))

    def settings(self, run):
        """Try one cycle in the run up to a quarter of the readings, at most 100 cycles."""
        most = min(run.size / 4, 100)
        cycles = np.arange(1.0, most + 0.25, 0.5)
        periods = duration(run) / cycles
        return tuple(Setting(axes=axes, period=float(p)) for axes in AXES for p in periods)

    def brackets(self, run, setting):
        """Refine the period within half a cycle to either side, up to one cycle in the run.

        Less than one cycle is any curve: a period cannot be told from it.
        """
        cycles = duration(run) / setting['period']
        low, high = duration(run) / (cycles + 0.5), duration(run) / max(cycles - 0.5, 1.0)
        return {'period': (low, high)}

    def independent_settings(self, run):
        """Count one chance for each whole number of cycles."""
        return 4 * max(1, int(min(run.size / 4, 100)))

    def amplitudes(self, run, setting):
        """Return the cosine and sine amplitudes."""
        axes = setting['axes']
        return (_per_axis(axes, 'a', 'm', 'cosine amplitude')
                + _per_axis(axes, 'b', 'm', 'sine amplitude'))

    def scalars(self, run, values):
        """Return cosine and sine of 2 pi t/P."""
        angle = 2 * np.pi * seconds(run) / values
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class FrameStep(FrameEffect):
    """A step d H(t - t0) of the probe against the table."""

    name: str = 'frame_step'
    meaning: str = 'At one moment the probe jumped against the table and stayed there.'
    look: str = 'A collision, a probe that was changed or requalified, a re-homed axis.'
    formula: str = 'd H(t - t0)'
    source: str = 'physics of probe requalification'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'nothing'
    searched: tuple[Searched, ...] = (
        _AXES, Searched('t0', 's', 'moment of the step, since the first reading', 'instant'))

    def settings(self, run):
        """Try moments between readings."""
        return tuple(Setting(axes=axes, t0=float(t0)) for axes in AXES
                     for t0 in between_readings(run))

    def independent_settings(self, run):
        """Neighbouring moments look alike."""
        return 4 * max(1, min(run.size, 200) // 4)

    def amplitudes(self, run, setting):
        """Return the size of the step."""
        return _per_axis(setting['axes'], 'd', 'm', 'step')

    def scalars(self, run, values):
        """Return H(t - t0)."""
        return (seconds(run) > values).astype(float)[:, None]


FRAME_EFFECTS = (FrameDrift(), FrameWarmup(), FrameTemperature(), FrameCycle(), FrameStep())
