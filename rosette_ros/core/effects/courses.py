# SPDX-License-Identifier: Apache-2.0
"""Courses: what an effect depends on, as functions of the reading. Any of them goes with any motion."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import LEAST_KNOWN, Bracket, Course, Quantity, Searched, Setting, grid
from rosette_ros.core.effects.run_functions import between_readings, duration, seconds, temperature_change
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.records import Floats, Run

SHORTEST = 3
"""Readings that something which passes has at least: fewer are wrong readings."""
FEWEST_CYCLES = 2.0
"""Cycles in a run at least: what did not come again is any curve in time."""
OVERTONES = 3
"""Harmonics of what is periodic, the first one included."""
TAU = Searched('tau', 's', 'time constant', 'scale')
ONE_BALL = Searched('ball', '1', 'number of the ball')
STANDING, TRAVELLING = 'standing', {'against': -1, 'with': 1}
"""Senses in which a load turns in the frame of the plate, beside the table's."""
TURNED, UNWRAPPED = 'turned', 'unwrapped'
Along = Callable[[Quantity], tuple[Quantity, ...]]


def values(settings: Sequence[Setting], name: str) -> Floats:
    """Return the values of a parameter, (v, 1); one that counts nothing where it has none."""
    return np.array([[float(setting.get(name, 0.0))] for setting in settings])


def shortest(run: Run, moments: Floats) -> Floats:
    """Return the time from each moment (m,) to the SHORTEST-th reading after it, (m,), s, infinite where none is."""
    later = np.append(np.sort(seconds(run)), np.full(SHORTEST, np.inf))
    return np.asarray(later[np.searchsorted(later, moments, side='right') + SHORTEST - 1] - moments)


def _repeated(functions: Floats, settings: Sequence[Setting]) -> Floats:
    """Return functions (m, N) that settings do not change, (v, m, N)."""
    return np.tile(functions, (len(settings), 1, 1))


class Constant(Course):
    """1: the directions of the motion say it all."""

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return np.ones((len(settings), 1, run.size))


class InTime(Course):
    """Functions of time."""

    variables = depends_on = ('time',)
    carries = 'shape'


class Drift(InTime):
    """t."""

    carries = 'all'

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return _repeated(seconds(run)[None], settings)


class Curve(InTime):
    """t and t^2."""

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return _repeated(seconds(run) ** np.array([[1], [2]]), settings)


class WarmUp(InTime):
    """1 - exp(-t/tau); time constants from a fiftieth of the run to the whole of it, of which neighbours look alike."""

    searched = (TAU,)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(tau=np.geomspace(duration(run) / 50, duration(run), 14).tolist())

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return -np.expm1(-seconds(run) / values(settings, 'tau'))[:, None]


EXPANSION, LONGEST = 3e-5, 1.5
"""Thermal expansion, 1/K, and length, m, of a part of a machine that are hardly ever exceeded: zinc, a portal."""


@dataclass(frozen=True)
class Temperature(Course):
    """T - T0; nothing to try where the temperature stands still.

    unit, along: of the amplitudes by which the temperature may have gone another way in gaps of its record.
    """

    unit: str
    along: str = ''
    variables = depends_on = ('temperature',)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return (Setting(),) if np.any(temperature_change(run)) else ()

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return _repeated(on.temperature_waves(run), settings)

    def most(self, setting: Setting) -> float:
        return EXPANSION * (LONGEST if self.unit == 'm' else 1.0)

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        gaps = [Quantity(f'gap{k}', self.unit, f'way {k} in gaps of the record{self.along}')
                for k in range(1, len(on.temperature_waves(run)))]
        return super().amplitudes(run, setting, (*given, *gaps), along)


@dataclass(frozen=True)
class LaggedTemperature(Temperature):
    """T as a part of the machine with a time constant follows it; from a fiftieth of the run to the whole of it."""

    searched = (TAU,)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(tau=np.geomspace(duration(run) / 50, duration(run), 10).tolist()) if super().settings(run) else ()

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return np.array([_behind_temperature(run, float(tau)) for tau in values(settings, 'tau')[:, 0]])


@lru_cache(maxsize=64)
def _behind_temperature(run: Run, tau: float) -> Floats:
    """Return the waves of the temperature behind it by a time constant, which several effects have, (m, N)."""
    return np.array([on.lagged(seconds(run), wave, tau) for wave in on.temperature_waves(run)])


class TimeOrTemperature(Course):
    """t or, where it was recorded and changes, T - T0; the unit of the amplitude is for one of what drives it."""

    searched = (Searched('driver', '', 'what it grows with'),)
    variables = ('time', 'temperature')
    depends_on = ('time',)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        changes = np.mean(np.isfinite(run.temperature)) >= LEAST_KNOWN and np.any(temperature_change(run))
        return grid(driver=('time', 'temperature') if changes else ('time',))

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        drivers = {'time': seconds, 'temperature': temperature_change}
        return np.array([[drivers[setting.word('driver')](run)] for setting in settings])

    def most(self, setting: Setting) -> float:
        return EXPANSION if setting.word('driver') == 'temperature' else float('inf')

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        unit = {'time': '1/s', 'temperature': '1/K'}[setting.word('driver')]
        return super().amplitudes(run, setting, tuple(Quantity(one.name, unit, one.meaning) for one in given), along)


class Cycle(InTime):
    """cos and sin of 2 pi t/P; two to a quarter of the readings' number of cycles, at most 100, a chance for each.

    Refined by half a cycle to either side.
    """

    searched = (Searched('period', 's', 'period', 'scale'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(period=(duration(run) / np.arange(FEWEST_CYCLES, min(run.size / 4, 100) + 0.25, 0.5)).tolist())

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        cycles = duration(run) / setting.number('period')
        return {'period': (duration(run) / (cycles + 0.5), duration(run) / max(cycles - 0.5, FEWEST_CYCLES))}

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        angle = 2 * np.pi * seconds(run) / values(settings, 'period')
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


class Periodic(Cycle):
    """A period of any shape: cos and sin of 2 pi k t/P, k = 1 to 3, the k-th of 1/k of the size of the first.

    Two cycles to as many as there are readings for two in each period of the last harmonic."""

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(period=(duration(run) / np.arange(FEWEST_CYCLES, run.size / (2 * OVERTONES) + 0.1, 0.5)).tolist())

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        angle = 2 * np.pi * seconds(run) / values(settings, 'period')
        order = np.arange(1, OVERTONES + 1)[:, None]
        return np.concatenate([wave(order * angle[:, None]) for wave in (np.cos, np.sin)], axis=1)

    def variances(self, setting: Setting) -> Floats:
        return np.tile(1 / np.arange(1, OVERTONES + 1)**2, 2)


@dataclass(frozen=True)
class Step(InTime):
    """H(t - t0); moments between readings, of which neighbours look alike.

    Fewer than SHORTEST readings before or after are wrong readings. event: what happened at that moment."""

    event: str
    carries = 'nothing'

    @property
    def searched(self) -> tuple[Searched, ...]:  # type: ignore[override]
        return (Searched('t0', 's', f'moment of the {self.event}, since the first reading', 'instant'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(t0=_well_inside(run, between_readings(run)).tolist())

    def instants(self, run: Run, setting: Setting, name: str) -> Floats:
        """Return the instants beside that of a setting that leave readings enough."""
        return _well_inside(run, super().instants(run, setting, name))

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return (seconds(run) > values(settings, 't0')).astype(float)[:, None]


def _well_inside(run: Run, moments: Floats) -> Floats:
    """Return the moments that have SHORTEST readings at least before and after them."""
    before = np.searchsorted(np.sort(seconds(run)), moments, side='right')
    return moments[np.minimum(before, run.size - before) >= SHORTEST]


class Pulse(InTime):
    """H(t - t0) - H(t - t1); moments between readings, lengths in steps of a third, of which neighbours look alike."""

    searched = (Searched('t0', 's', 'moment of the shift, since the first reading', 'instant'),
                Searched('t1', 's', 'moment of the return, since the first reading', 'instant'))
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        instants = between_readings(run)
        lengths = np.unique(np.geomspace(SHORTEST, max(instants.size - 1, SHORTEST), 12).astype(int))
        return tuple(Setting(t0=float(instants[start]), t1=float(instants[start + length])) for length in lengths
                     for start in range(0, instants.size - length, max(1, length // 2)))

    def instants(self, run: Run, setting: Setting, name: str) -> Floats:
        """Return the instants beside that of a setting that leave the pulse readings enough."""
        other, found = setting.number('t1' if name == 't0' else 't0'), super().instants(run, setting, name)
        return found[np.abs(found - other) > shortest(run, np.minimum(found, other))]

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        begun, over = (seconds(run) > values(settings, name) for name in ('t0', 't1'))
        return np.asarray(begun * 1.0 - over)[:, None]


class Recovery(InTime):
    """H(t - t0) exp(-(t - t0)/tau); moments between readings, five time constants up to a third of the run.

    Each has SHORTEST readings at least.
    """

    searched = (Searched('t0', 's', 'moment of the shift, since the first reading', 'instant'),
                Searched('tau', 's', 'time constant of its way back', 'scale'))
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        moments = between_readings(run, 40)
        return tuple(Setting(t0=float(t0), tau=float(tau)) for t0, least in zip(moments, shortest(run, moments))
                     for tau in np.geomspace(duration(run) / 40, duration(run) / 3, 4) if tau >= least)

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        tau, least = setting.number('tau'), float(shortest(run, np.array([setting.number('t0')]))[0])
        return {**super().brackets(run, setting), 'tau': (max(tau / 1.6, least), max(tau * 1.6, least))}

    def instants(self, run: Run, setting: Setting, name: str) -> Floats:
        """Return the instants beside that of a setting from which the way back has readings enough."""
        found, tau = super().instants(run, setting, name), setting.number('tau')
        return found[tau >= shortest(run, found)]

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        since = seconds(run) - values(settings, 't0')
        return np.where(since > 0, np.exp(-np.maximum(since, 0) / values(settings, 'tau')), 0.0)[:, None]


class Onset(InTime):
    """max(0, t - t0); sixteen moments."""

    searched = (Searched('t0', 's', 'moment at which it begins, since the first reading', 'phase'),)
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(t0=np.linspace(0, duration(run), 18)[1:-1].tolist())

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        t0, beside = setting.number('t0'), duration(run) / 17
        return {'t0': (max(t0 - beside, 0.0), t0 + beside)}

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return np.maximum(seconds(run) - values(settings, 't0'), 0)[:, None]


class TableSense(Course):
    """Half the sense of the table's last move, 1/2 approach."""

    variables: ClassVar[tuple[str, ...]] = ('table sense',)
    depends_on = ('approach',)

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return _repeated(0.5 * run.approach[None].astype(float), settings)


class TableSenseByAngle(TableSense):
    """Half that sense times cos and sin of m phi; up to four waves."""

    variables = ('table sense', 'table angle')
    searched = (Searched('order', '1', 'm, waves per turn of the table'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(order=range(1, min(4, (run.n - 1) // 2) + 1))

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        angle = values(settings, 'order') * run.phi
        return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1) * (0.5 * run.approach))


class EncoderLines(Course):
    """cos and sin of L theta at the actual angle theta, for whole numbers L of periods per turn.

    The actual angles at one table position must differ by some spread: L shows by the periods within it, in steps of
    0.4, and by its remainder in a division by n. Each setting is a chance.
    """

    searched = (Searched('lines', '1', 'L, periods of the encoder per turn of the table', 'instant'),)
    variables = ('encoder',)

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

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        angle = values(settings, 'lines') * (run.phi + run.angle_deviation)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


class TableOrder(Course):
    """cos and sin of nu Psi; orders from 0.1 to 5 per turn in steps of half the resolution, of which each is a chance.

    At least two cycles in the run, but for cages of bearings: less is any curve in time, and less beside a whole turn
    any curve in the frame of the plate; and one beside more whole turns, as less is a synchronous motion that changes.
    Refined by half a resolution to either side.
    """

    searched = (Searched('nu', '1', 'cycles per turn of the table', 'phase'),)
    variables = ('travel',)
    depends_on = ('table_travel',)
    carries = 'shape'

    def _turns(self, run: Run) -> float:
        return max(float(np.ptp(run.table_travel)) / TWO_PI, 1.0)

    def _beside(self, run: Run, whole: Floats) -> Floats:
        """Return how far an order has to be from whole numbers (m,), (m,)."""
        turns = self._turns(run)
        return np.where(whole > 1, min(1 / turns, 0.3), max(0.1, min(FEWEST_CYCLES / turns, 0.35)))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        turns = self._turns(run)
        orders = np.arange(0.5 / turns, min(run.n / 2, 5.0, max(1.2, 750 / turns)), 0.5 / turns)
        nearest = np.round(orders)
        return grid(nu=orders[np.abs(orders - nearest) > self._beside(run, nearest) - 1e-9].tolist())

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        nu, half = setting.number('nu'), 0.5 / self._turns(run)
        whole = math.floor(nu) + np.arange(2.0)
        low, high = (whole + self._beside(run, whole) * [1, -1]).tolist()
        return {'nu': (max(nu - half, low), min(nu + half, high))}

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        waves = np.empty((len(settings), 2, run.size))  # hundreds of megabytes for a large plate: no copy
        angle = np.multiply(values(settings, 'nu'), on.travel(run), out=waves[:, 1])
        np.cos(angle, out=waves[:, 0])
        np.sin(angle, out=angle)
        return waves


class Play(Course):
    """Play (hysteresis) of the table's travel: it follows a turn until the play w is used up, and stays.

    Psi - c, over w, where c is the last centre, moved by no more than keeps |Psi - c| <= w/2 (a play operator). From
    more than the smallest move, as what that uses up goes by the sense alone, to the whole of the travel; where it
    stood at the first reading is searched. Nothing to try where the table turns one way only.
    """

    searched = (Searched('width', 'rad', 'w, turn that uses up the play', 'scale'),
                Searched('start', '', 'share of the play that is used up in forward sense at the first reading'))
    variables = ('table memory',)
    depends_on = ('table_travel',)
    carries = 'shape'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        move = np.diff(on.travel(run))
        move = move[np.abs(move) > 1e-9]
        if not ((move > 0).any() and (move < 0).any()):
            return ()
        least, most = 1.5 * np.abs(move).min(), np.ptp(on.travel(run))
        return grid(width=np.geomspace(least, most, 8).tolist(), start=(0.0, 0.5, 1.0)) if least < most else ()

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        psi, half = on.travel(run), values(settings, 'width')[:, 0] / 2
        out = np.empty((len(settings), run.size))
        centre = psi[0] + half * (1 - 2 * values(settings, 'start')[:, 0])
        for reading, angle in enumerate(psi):
            centre = np.clip(centre, angle - half, angle + half)
            out[:, reading] = (angle - centre) / (2 * half)
        return out[:, None]


class TableHeat(Course):
    """1 - exp(-Psi/Psi0), from a fiftieth of the turned angle to the whole of it, of which neighbours look alike.

    Where the table turned both ways, the angle may be the one that was turned, which is what friction sees, or the
    unwrapped one.
    """

    searched = (Searched('angle', '', 'which angle warms it: turned in either sense, or unwrapped'),
                Searched('psi0', 'rad', 'angle after which 63 % are reached', 'scale'))
    variables = ('travel',)
    depends_on = ('table_travel',)
    carries = 'shape'

    def _travelled(self, run: Run, angle: str) -> Floats:
        if angle == UNWRAPPED:
            return np.abs(on.travel(run))
        return np.cumsum(np.abs(np.diff(run.table_travel, prepend=run.table_travel[:1])))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        turned = self._travelled(run, TURNED)
        if turned[-1] == 0:
            return ()
        one_sense = np.allclose(self._travelled(run, UNWRAPPED), turned)
        return grid(angle=(TURNED,) if one_sense else (TURNED, UNWRAPPED),
                    psi0=np.geomspace(turned[-1] / 50, turned[-1], 14).tolist())

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        angle = np.array([self._travelled(run, setting.word('angle', TURNED)) for setting in settings])
        return -np.expm1(-angle / values(settings, 'psi0'))[:, None]
