# SPDX-License-Identifier: Apache-2.0
"""Effects of the rotary table: its zero, its axis, its bearing, its drive."""

import numpy as np

from rosette_ros.core.effects.effect import (
    Bracket,
    Effect,
    Motion,
    Quantity,
    Searched,
    Setting,
    TurningEffect,
    grid,
    per_axis,
)
from rosette_ros.core.effects.factored_effect import (
    Drift,
    FactoredEffect,
    LaggedTemperature,
    RunFunction,
    Step,
    Temperature,
    WarmUp,
)
from rosette_ros.core.effects.run_functions import axial_tilts, tangential, travel, unit
from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.records import Floats, Run


class TableAngle(FactoredEffect, TurningEffect):
    """The table's angle is another one than its encoder shows."""

    def directions(self, run: Run) -> Floats:
        return run.radius * tangential(run.alpha)[None]


class AxisTilt(FactoredEffect):
    """The table axis tilts in the machine; quantities: about one axis, without its letter."""

    acts = 0, 1

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(one for quantity in super().amplitudes(run, setting) for one in per_axis('xy', quantity))

    def directions(self, run: Run) -> Floats:
        return np.moveaxis(axial_tilts(run), -1, 0)

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion:
        tilt = self.course(run, setting).T @ amplitudes.reshape(-1, 2)
        return Motion(np.hstack([tilt, np.zeros((run.size, 1))]))


class TableBacklash(TurningEffect):
    name = 'table_backlash'
    plain = 'backlash of the table'
    meaning = 'The angle at which the table stops depends on the sense in which it turned.'
    look = 'Worm gear, clamping, friction between drive and encoder.'
    formula = '1/2 b approach R e_t'
    source = 'ISO 230-2 (reversal error: from the positive sense less from the negative)'
    depends_on = ('approach',)
    quantities: tuple[Quantity, ...] = (Quantity('b', 'rad', 'reversal error of the table angle'),)
    carries = 'all'

    def columns(self, run: Run, setting: Setting) -> Floats:
        return (0.5 * run.radius * run.approach[:, None] * tangential(run.alpha))[..., None]


class TableBacklashAngle(TableBacklash):
    name = 'table_backlash_angle'
    plain = 'backlash that depends on the table angle'
    meaning = 'The backlash of the table differs from angle to angle.'
    look = 'Worm gear: wear, eccentricity and mesh; unequal friction or load around the table.'
    formula = '1/2 approach R e_t (b_c cos(m phi) + b_s sin(m phi))'
    source = 'ISO 230-2 (reversal error at each position)'
    repeatable = True
    quantities = (Quantity('bc', 'rad', 'cosine of the reversal error'), Quantity('bs', 'rad', 'sine'))
    searched = (Searched('order', '1', 'm, waves per turn of the table'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try up to four waves."""
        return grid(order=range(1, min(4, (run.n - 1) // 2) + 1))

    def columns(self, run: Run, setting: Setting) -> Floats:
        angle, half = setting.number('order') * run.phi, super().columns(run, setting)[..., 0]
        return np.stack([np.cos(angle)[:, None] * half, np.sin(angle)[:, None] * half], axis=-1)


class EncoderLines(RunFunction):
    """cos and sin of L theta at the actual angle theta, for whole numbers L of periods per turn.

    The actual angles at one table position must differ by some spread: L shows by the periods within it, in steps of
    0.4, and by its remainder in a division by n. Each setting is a chance.
    """

    searched = (Searched('lines', '1', 'L, periods of the encoder per turn of the table', 'instant'),)
    depends_on = ()
    carries = 'all'

    def _step(self, run: Run) -> float:
        """Return the step of L in whole multiples of n."""
        return max(np.round(0.4 * TWO_PI / np.ptp(run.angle_deviation) / run.n), 1.0) * run.n

    def settings(self, run: Run) -> tuple[Setting, ...]:
        if np.ptp(run.angle_deviation) < 1e-6:
            return ()
        step = self._step(run)
        coarse = np.arange(step, min(2e5, run.size * step / 2, 2000 / run.n * step), step)
        return grid(lines=(coarse[:, None] + np.arange(run.n)).reshape(-1).tolist())

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        step, lines = self._step(run), setting.number('lines')
        beside = lines + np.unique(np.round(np.linspace(-0.5, 0.5, 15) * step / run.n)) * run.n
        return {'lines': beside[beside > 0]}

    def chances(self, run: Run) -> float:
        return max(1, len(self.settings(run)))

    def at(self, run: Run, values: Floats) -> Floats:
        angle = values * (run.phi + run.angle_deviation)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


_MOTIONS = {'radial': (0, 1), 'axial': (2,), 'tilt': (3, 4), 'all': (0, 1, 2, 3, 4)}
_MOTION_NAMES = ('x', 'y', 'z', 'rx', 'ry')


class TableOrder(RunFunction):
    """cos and sin of nu Psi; orders from 0.1 to 5 per turn in steps of half the resolution, of which each is a chance.

    At least two cycles in the run, but for cages of bearings: less is any curve in time, and less beside a whole turn
    any curve in the frame of the plate. Refined by half a resolution to either side.
    """

    searched = (Searched('nu', '1', 'cycles per turn of the table', 'phase'),)
    depends_on = ('table_travel',)

    def _turns(self, run: Run) -> float:
        return max(float(np.ptp(run.table_travel)) / TWO_PI, 1.0)

    def _least(self, run: Run) -> float:
        """Return how far an order has to be from 0 and 1."""
        return max(0.1, min(2 / self._turns(run), 0.35))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        turns, least = self._turns(run), self._least(run)
        orders = np.arange(max(least, 0.5 / turns), min(run.n / 2, 5.0, max(1.2, 750 / turns)), 0.5 / turns)
        # Within half a resolution of a whole number it is synchronous: the base model's.
        beside = np.where(orders < 1.5, max(least - 1e-9, 0.4 / turns), 0.4 / turns)
        return grid(nu=orders[np.abs(orders - np.round(orders)) > beside].tolist())

    def chances(self, run: Run) -> float:
        return len(self.settings(run)) / 2

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        nu, half, least = setting.number('nu'), 0.5 / self._turns(run), self._least(run)
        low, high = (least, 1 - least) if nu < 1 else (1 + least if nu < 1.5 else 0.0, np.inf)
        return {'nu': (max(nu - half, low), min(nu + half, high))}

    def at(self, run: Run, values: Floats) -> Floats:
        waves = np.empty((len(values), 2, run.size))  # hundreds of megabytes for a large plate: no copy
        angle = np.multiply(values, travel(run), out=waves[:, 1])
        np.cos(angle, out=waves[:, 0])
        np.sin(angle, out=angle)
        return waves


class AsynchronousMotion(FactoredEffect):
    name = 'asynchronous_motion'
    plain = 'asynchronous error motion of the axis'
    meaning = 'The axis moves at no integer multiple of its rotation frequency: the motion does not repeat every turn.'
    look = 'Cage and rolling elements of the bearing (about 0.4 per turn), belt or worm drive.'
    formula = '(radial x, y; axial z; tilt) cos(nu Psi), sin(nu Psi)'
    source = 'ISO 230-7 (asynchronous error motion)'
    repeatable = True
    chosen = (Searched('motion', '', 'radial, axial, tilt, or all of them'),)
    function = TableOrder()
    choices = grid(motion=_MOTIONS)

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        """Return cosine and sine amplitudes of each motion."""
        motions = [_MOTION_NAMES[place] for place in self.which(setting)]
        return tuple(Quantity(f'{part}_{motion}', 'rad' if motion[0] == 'r' else 'm', f'{name} amplitude of {motion}')
                     for part, name in (('a', 'cosine'), ('b', 'sine')) for motion in motions)

    def directions(self, run: Run) -> Floats:
        """Return x, y, z and what tilts about x and y do at the ball, (5, N, 3)."""
        axes = [unit(axis, run.size) for axis in range(3)]
        return np.stack([*axes, *np.moveaxis(axial_tilts(run), -1, 0)])

    def which(self, setting: Setting) -> tuple[int, ...]:
        return _MOTIONS[setting.word('motion')]

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion | None:
        if 3 not in self.which(setting):
            return None
        tilt = self.course(run, setting).T @ amplitudes.reshape(2, -1)[:, -2:]
        return Motion(np.hstack([tilt, np.zeros((run.size, 1))]))


TURNED, UNWRAPPED = 'turned', 'unwrapped'


class TableWarmup(Effect):
    name = 'table_warmup'
    plain = 'axial growth of the table'
    meaning = 'The table grows along its axis as turning warms the bearing, and settles.'
    look = 'Bearing friction and preload, torque motor; warm the table up by turning it before measuring.'
    formula = 'a (1 - exp(-Psi/Psi0)) along z'
    source = 'ISO 230-3 (thermal distortion caused by rotating components)'
    depends_on = ('table_travel',)
    quantities = (Quantity('a', 'm', 'final axial growth'),)
    searched = (Searched('angle', '', 'which angle warms it: turned in either sense, or unwrapped'),
                Searched('psi0', 'rad', 'angle after which 63 % are reached', 'scale'))

    def _travelled(self, run: Run, angle: str) -> Floats:
        if angle == UNWRAPPED:
            return np.abs(travel(run))
        return np.cumsum(np.abs(np.diff(run.table_travel, prepend=run.table_travel[:1])))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try angles from a fiftieth of the turned angle to the whole of it.

        Where the table turned both ways, the angle may be the one that was turned, which is what
        friction sees, or the unwrapped one.
        """
        turned = self._travelled(run, TURNED)
        if turned[-1] == 0:
            return ()
        one_sense = np.allclose(self._travelled(run, UNWRAPPED), turned)
        return grid(angle=(TURNED,) if one_sense else (TURNED, UNWRAPPED),
                    psi0=np.geomspace(turned[-1] / 50, turned[-1], 14).tolist())

    def independent_settings(self, run: Run) -> int:
        """Neighbouring angles look alike."""
        return 5

    def columns(self, run: Run, setting: Setting) -> Floats:
        growth = -np.expm1(-self._travelled(run, setting.word('angle', TURNED)) / setting.number('psi0'))
        return (growth[:, None] * unit(2, run.size))[..., None]


TABLE_EFFECTS: tuple[Effect, ...] = (
    TableAngle('table_zero_drift', Drift(), Quantity('omega', 'rad/s', 'rate of turn of the zero'),
        plain="drift of the table's angle",
        meaning="The table's angle drifts steadily relative to its encoder.",
        look='Encoder mount, coupling between encoder and table, heat of the torque motor.',
        formula='omega t R e_t',
        source='ISO 230-3 (distortion caused by rotary motion)'),
    TableAngle('table_zero_warmup', WarmUp(), Quantity('omega', 'rad', 'final turn of the zero'),
        plain="warm-up of the table's angle",
        meaning="The table's angle drifts relative to its encoder while the table warms up, and settles.",
        look='Encoder mount, coupling, heat of the torque motor; a plate that turns on the table until it rests.',
        formula='omega R e_t (1 - exp(-t/tau))',
        source='ISO 230-3 (distortion caused by rotary motion)'),
    TableAngle('table_zero_temperature', Temperature('rad'),
        Quantity('omega', 'rad/K', 'turn of the zero per kelvin'),
        plain="table's angle follows the temperature",
        meaning="The table's angle moves relative to its encoder with the measured temperature.",
        look='Encoder mount and coupling, air conditioning, sunlight on one side of the table.',
        formula='omega R e_t (T - T0)',
        source='ISO 230-3 (environmental temperature variation error)'),
    TableAngle('table_zero_lag', LaggedTemperature('rad'),
        Quantity('omega', 'rad/K', 'turn of the zero per kelvin'),
        plain="table's angle behind the temperature",
        meaning="The table's angle moves relative to its encoder with the measured temperature, but later.",
        look='Housing of the table and encoder mount, whose heat capacity is large; sunlight on one side of the table.',
        formula="omega R e_t T', where tau dT'/dt = T - T0 - T'",
        source='ISO 230-3 (environmental temperature variation error)'),
    TableAngle('table_zero_step', Step('jump'), Quantity('omega', 'rad', 'jump of the angle'),
        plain="jump of the table's angle",
        meaning="At one moment the table's angle jumped relative to its encoder.",
        look='Encoder: lost counts, referencing again, a coupling that slipped; a collision.',
        formula='omega R e_t H(t - t0)',
        source='physics of incremental encoders'),
    AxisTilt('axis_tilt_drift', Drift(), Quantity('theta', 'rad/s', 'tilt rate about'),
        plain="drift of the table's tilt",
        meaning='The table axis tilts steadily in the machine.',
        look='Foundation, levelling feet, one-sided heat on the machine bed.',
        formula='R (theta_x sin alpha - theta_y cos alpha) t along z',
        source='ISO 230-3 (thermal distortion)'),
    AxisTilt('axis_tilt_warmup', WarmUp(), Quantity('theta', 'rad', 'final tilt about'),
        plain="warm-up of the table's tilt",
        meaning='The table axis tilts in the machine while the machine warms up, and settles.',
        look='One-sided heat on the machine bed, coolant, time since switching on; start after a warm-up cycle.',
        formula='R (theta_x sin alpha - theta_y cos alpha) (1 - exp(-t/tau)) along z',
        source='ISO 230-3 (thermal distortion)'),
    AxisTilt('axis_tilt_temperature', Temperature('rad', ' about'),
        Quantity('theta', 'rad/K', 'tilt per kelvin about'),
        plain="table's tilt follows the temperature",
        meaning='The table axis tilts in the machine with the measured temperature.',
        look='Air conditioning, sunlight or a wall on one side of the machine bed; layers of warm air.',
        formula='R (theta_x sin alpha - theta_y cos alpha) (T - T0) along z',
        source='ISO 230-3 (environmental temperature variation error)'),
    AxisTilt('axis_tilt_lag', LaggedTemperature('rad', ' about'),
        Quantity('theta', 'rad/K', 'tilt per kelvin about'),
        plain="table's tilt behind the temperature",
        meaning='The table axis tilts in the machine with the measured temperature, but later.',
        look='Machine bed and columns, whose heat capacity is large; sunlight or a wall on one side of them.',
        formula="R (theta_x sin alpha - theta_y cos alpha) T' along z, where tau dT'/dt = T - T0 - T'",
        source='ISO 230-3 (environmental temperature variation error)'),
    AxisTilt('axis_tilt_step', Step('tilt'), Quantity('theta', 'rad', 'tilt about'),
        plain="sudden tilt of the table's axis",
        meaning='At one moment the table axis tilted in the machine, and stayed so.',
        look='Levelling feet and foundation that settle, a load set on the machine bed, a collision.',
        formula='R (theta_x sin alpha - theta_y cos alpha) H(t - t0) along z',
        source='physics of machine beds'),
    TableBacklash(), TableBacklashAngle(),
    TableAngle('encoder_interpolation', EncoderLines(), Quantity('a', 'rad', 'cosine amplitude'),
        Quantity('b', 'rad', 'sine amplitude'),
        plain='interpolation error of the encoder',
        meaning="The table's angle has an error that repeats with every period of its encoder.",
        look='Amplitudes, offsets and phase of the encoder signals; dirt on the graduation; interpolation electronics.',
        formula='R e_t (a cos(L theta) + b sin(L theta)), theta the actual angle of the table',
        source='ISO 230-2 (positioning); interpolation error of incremental encoders',
        repeatable=True),
    AsynchronousMotion(), TableWarmup())
"""In the order of tables and pages."""
