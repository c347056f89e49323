# SPDX-License-Identifier: Apache-2.0
"""Effects of the rotary table: its zero, its axis, its bearing, its drive."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import (
    Effect,
    Quantity,
    Searched,
    Setting,
    logarithmic_grid,
    seconds,
    tangential,
    unit,
)
from rosette_ros.core.effects.factored import FactoredEffect


def axial_tilts(run):
    """Return z per unit tilt about x and about y at the ball, (N, 3, 2), m/rad."""
    out = np.zeros((run.size, 3, 2))
    out[:, 2, 0] = run.radius * np.sin(run.alpha)
    out[:, 2, 1] = -run.radius * np.cos(run.alpha)
    return out


@dataclass(frozen=True)
class TableZeroDrift(Effect):
    """The table's zero turns steadily: omega t R e_t."""

    name: str = 'table_zero_drift'
    meaning: str = "The table's angle drifts steadily against its encoder."
    look: str = 'Encoder mount, coupling between encoder and table, heat of the torque motor.'
    formula: str = 'omega t R e_t'
    source: str = 'ISO 230-3 (distortion caused by rotary motion)'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'all'

    def amplitudes(self, run, setting):
        """Return the rate."""
        return (Quantity('omega', 'rad/s', 'rate of turn of the zero'),)

    def columns(self, run, setting):
        """Return t R e_t, (N, 3, 1), m s."""
        return (run.radius * seconds(run)[:, None] * tangential(run.alpha))[..., None]


@dataclass(frozen=True)
class AxisTiltDrift(Effect):
    """The axis tilts steadily: z = R (theta_x sin alpha - theta_y cos alpha) t."""

    name: str = 'axis_tilt_drift'
    meaning: str = 'The table axis tilts steadily in the machine.'
    look: str = 'Foundation, levelling feet, one-sided heat on the machine bed.'
    formula: str = 'R (theta_x sin alpha - theta_y cos alpha) t along z'
    source: str = 'ISO 230-3 (thermal distortion)'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'all'

    def amplitudes(self, run, setting):
        """Return the tilt rates."""
        return tuple(Quantity(f'theta_{axis}', 'rad/s', f'tilt rate about {axis}')
                     for axis in 'xy')

    def columns(self, run, setting):
        """Return t times the lever of each tilt, (N, 3, 2), m s."""
        return seconds(run)[:, None, None] * axial_tilts(run)


@dataclass(frozen=True)
class TableBacklash(Effect):
    """The table stops short by half the backlash: 1/2 b approach R e_t."""

    name: str = 'table_backlash'
    meaning: str = 'The table stops at another angle when it comes from the other side.'
    look: str = 'Worm gear, clamping, friction between drive and encoder.'
    formula: str = '1/2 b approach R e_t'
    source: str = 'ISO 230-2 (reversal value B)'
    depends_on: tuple[str, ...] = ('approach',)
    carries: str = 'all'

    def amplitudes(self, run, setting):
        """Return the backlash."""
        return (Quantity('b', 'rad', 'reversal value of the table angle'),)

    def columns(self, run, setting):
        """Return 1/2 approach R e_t, (N, 3, 1), m."""
        return (0.5 * run.radius * run.approach[:, None] * tangential(run.alpha))[..., None]


_MOTIONS = {'radial': (0, 1), 'axial': (2,), 'tilt': (3, 4), 'all': (0, 1, 2, 3, 4)}


@dataclass(frozen=True)
class AsynchronousMotion(FactoredEffect):
    """Motion that repeats every 1/nu turns of the table: cos and sin of nu Psi, nu not whole."""

    name: str = 'asynchronous_motion'
    meaning: str = ('The axis moves with a period that is no whole part of a turn: it does not come '
                    'back after one turn.')
    look: str = 'Cage and rolling elements of the bearing (about 0.4 per turn), belt or worm drive.'
    formula: str = '(radial x, y; axial z; tilt) cos(nu Psi), sin(nu Psi)'
    source: str = 'ISO 230-7 (asynchronous error motion)'
    depends_on: tuple[str, ...] = ('table_travel',)
    searched: tuple[Searched, ...] = (
        Searched('motion', '', 'radial, axial, tilt, or all of them'),
        Searched('nu', '1', 'cycles per turn of the table', 'phase'))

    def _orders(self, run):
        turns = max(np.ptp(run.table_travel) / (2 * np.pi), 1.0)
        highest = min(run.n / 2, 5.0, max(1.2, 750 / turns))
        step = 0.5 / turns
        orders = np.arange(max(0.1, step), highest, step)
        # Within half a resolution of a whole number it is synchronous: the base model's.
        return orders[np.abs(orders - np.round(orders)) > 0.4 / turns], turns

    def settings(self, run):
        """Try orders from 0.1 to 5 per turn in steps of half the resolution."""
        orders, _ = self._orders(run)
        return tuple(Setting(motion=motion, nu=float(nu))
                     for motion in ('radial', 'axial', 'tilt', 'all') for nu in orders)

    def brackets(self, run, setting):
        """Refine the order within half a resolution to either side."""
        half = 0.5 / max(np.ptp(run.table_travel) / (2 * np.pi), 1.0)
        return {'nu': (setting['nu'] - half, setting['nu'] + half)}

    def independent_settings(self, run):
        """Count one chance for each resolved order."""
        return max(1, 4 * self._orders(run)[0].size // 2)

    def amplitudes(self, run, setting):
        """Return cosine and sine amplitudes of each motion."""
        motions = {'radial': ('x', 'y'), 'axial': ('z',), 'tilt': ('rx', 'ry'),
                   'all': ('x', 'y', 'z', 'rx', 'ry')}[setting['motion']]
        return tuple(Quantity(f'{part}_{motion}', 'rad' if motion[0] == 'r' else 'm',
                              f'{name} amplitude of {motion}')
                     for part, name in (('a', 'cosine'), ('b', 'sine')) for motion in motions)

    def directions(self, run):
        """Return x, y, z and what tilts about x and y do at the ball, (5, N, 3)."""
        axes = [unit(axis, run.size) for axis in range(3)]
        return np.stack([*axes, *np.moveaxis(axial_tilts(run), -1, 0)])

    def which(self, setting):
        """Return the directions of a motion."""
        return _MOTIONS[setting['motion']]

    def scalars(self, run, values):
        """Return cos(nu Psi) and sin(nu Psi)."""
        angle = values * (run.table_travel - run.table_travel[0])
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


TURNED, UNWRAPPED = 'turned', 'unwrapped'


@dataclass(frozen=True)
class TableWarmup(Effect):
    """Axial growth a (1 - exp(-Psi/Psi0)) with the turned angle."""

    name: str = 'table_warmup'
    meaning: str = 'The table grows along its axis as turning warms the bearing, and settles.'
    look: str = 'Bearing friction and preload, torque motor; turn the table warm before measuring.'
    formula: str = 'a (1 - exp(-Psi/Psi0)) along z'
    source: str = 'ISO 230-3 (thermal distortion caused by rotating components)'
    depends_on: tuple[str, ...] = ('table_travel',)
    searched: tuple[Searched, ...] = (
        Searched('angle', '', 'which angle warms it: turned in either sense, or unwrapped'),
        Searched('psi0', 'rad', 'angle after which 63 % are reached', 'scale'))

    def _warming(self, run, angle):
        """Return the angle that warms the bearing at each reading, (N,), rad."""
        if angle == UNWRAPPED:
            return np.abs(run.table_travel - run.table_travel[0])
        return np.cumsum(np.abs(np.diff(run.table_travel, prepend=run.table_travel[:1])))

    def settings(self, run):
        """Try angles from a fiftieth of the turned angle to the whole of it.

        Where the table turned both ways, the angle may be the one that was turned, which is what
        friction sees, or the unwrapped one.
        """
        turned = self._warming(run, TURNED)
        if turned[-1] == 0:
            return ()
        kinds = [TURNED]
        if not np.allclose(self._warming(run, UNWRAPPED), turned):
            kinds.append(UNWRAPPED)
        return tuple(Setting(angle=kind, psi0=float(psi0)) for kind in kinds
                     for psi0 in logarithmic_grid(turned[-1] / 50, turned[-1], 14))

    def independent_settings(self, run):
        """Neighbouring angles look alike."""
        return 5

    def amplitudes(self, run, setting):
        """Return the final growth."""
        return (Quantity('a', 'm', 'final axial growth'),)

    def columns(self, run, setting):
        """Return 1 - exp(-Psi/Psi0) along z, (N, 3, 1)."""
        warming = self._warming(run, setting.get('angle', TURNED))
        return (-np.expm1(-warming / setting['psi0'])[:, None] * unit(2, run.size))[..., None]


TABLE_EFFECTS = (TableZeroDrift(), AxisTiltDrift(), TableBacklash(), AsynchronousMotion(),
                 TableWarmup())
