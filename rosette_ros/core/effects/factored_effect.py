# SPDX-License-Identifier: Apache-2.0
"""Effects that follow a function of the readings along some directions: any function goes with any directions."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from rosette_ros.core.effects.effect import Bracket, Effect, Factors, Quantity, Searched, Setting, grid
from rosette_ros.core.effects.run_functions import (
    between_readings,
    duration,
    lagged,
    seconds,
    temperature_change,
    temperature_waves,
)
from rosette_ros.core.records import Floats, Run

SHORTEST = 3
"""Readings that something which passes has at least: fewer are wrong readings."""


def shortest(run: Run, moments: Floats) -> Floats:
    """Return the time from each moment (m,) to the SHORTEST-th reading after it, (m,), s, infinite where none is."""
    later = np.append(np.sort(seconds(run)), np.full(SHORTEST, np.inf))
    return np.asarray(later[np.searchsorted(later, moments, side='right') + SHORTEST - 1] - moments)


class RunFunction(ABC):
    """How an effect develops in a run: m functions of the reading, with `searched` parameters.

    A subclass gives `at` and, where there are parameters, the settings to try of them, how many of these count as
    separate chances, and where to refine if not as Effect.brackets does; depends_on, carries: of every such effect.
    """

    searched: tuple[Searched, ...] = ()
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'shape'

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(type(self))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return (Setting(),)

    def chances(self, run: Run) -> float:
        return 1

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {}

    def gaps(self, run: Run) -> tuple[Quantity, ...]:
        """Return the amplitudes of the functions behind those of every run."""
        return ()

    @abstractmethod
    def at(self, run: Run, values: Floats) -> Floats:
        """Return the functions at each reading, (v, m, N), for values of what is searched, (v, 1 or more)."""


class Drift(RunFunction):
    """t."""

    carries = 'all'

    def at(self, run: Run, values: Floats) -> Floats:
        return np.tile(seconds(run), (len(values), 1, 1))


class WarmUp(RunFunction):
    """1 - exp(-t/tau); time constants from a fiftieth of the run to the whole of it, of which neighbours look alike."""

    searched = (Searched('tau', 's', 'time constant', 'scale'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(tau=np.geomspace(duration(run) / 50, duration(run), 14).tolist())

    def chances(self, run: Run) -> float:
        return 5

    def at(self, run: Run, values: Floats) -> Floats:
        return -np.expm1(-seconds(run) / values)[:, None]


class Temperature(RunFunction):
    """T - T0; nothing to try where the temperature stands still.

    unit, along: of the amplitudes by which the temperature may have gone another way in gaps of its record.
    """

    depends_on = ('temperature',)
    carries = 'all'

    def __init__(self, unit: str, along: str = '') -> None:
        self.unit, self.along = unit, along

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return (Setting(),) if np.any(temperature_change(run)) else ()

    def at(self, run: Run, values: Floats) -> Floats:
        return np.tile(temperature_waves(run), (len(values), 1, 1))

    def gaps(self, run: Run) -> tuple[Quantity, ...]:
        return tuple(Quantity(f'gap{k}', self.unit, f'way {k} in gaps of the record{self.along}')
                     for k in range(1, len(temperature_waves(run))))


class Cycle(RunFunction):
    """cos and sin of 2 pi t/P; `fewest` to a quarter of the readings' number of cycles, at most 100, a chance for each.

    Refined by half a cycle to either side. What did not come again in the run is any curve in time, no cycle.
    """

    searched = (Searched('period', 's', 'period', 'scale'),)
    fewest = 2.0

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(period=(duration(run) / np.arange(self.fewest, min(run.size / 4, 100) + 0.25, 0.5)).tolist())

    def chances(self, run: Run) -> float:
        return max(1, int(min(run.size / 4, 100)))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        cycles = duration(run) / setting.number('period')
        return {'period': (duration(run) / (cycles + 0.5), duration(run) / max(cycles - 0.5, self.fewest))}

    def at(self, run: Run, values: Floats) -> Floats:
        angle = 2 * np.pi * seconds(run) / values
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


class Step(RunFunction):
    """H(t - t0); moments between readings, of which neighbours look alike.

    One reading before or after is a wrong reading. event: what happened at that moment."""

    carries = 'nothing'

    def __init__(self, event: str) -> None:
        self.searched = (Searched('t0', 's', f'moment of the {event}, since the first reading', 'instant'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(t0=between_readings(run)[1:-1].tolist())

    def chances(self, run: Run) -> float:
        return max(1, min(run.size, 200) // 4)

    def at(self, run: Run, values: Floats) -> Floats:
        return (seconds(run) > values).astype(float)[:, None]


class Pulse(RunFunction):
    """H(t - t0) - H(t - t1); moments between readings, lengths in steps of a third, of which neighbours look alike."""

    searched = (Searched('t0', 's', 'moment of the shift, since the first reading', 'instant'),
                Searched('t1', 's', 'moment of the return, since the first reading', 'instant'))
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        instants = between_readings(run)
        lengths = np.unique(np.geomspace(SHORTEST, max(instants.size - 1, SHORTEST), 12).astype(int))
        return tuple(Setting(t0=float(instants[start]), t1=float(instants[start + length])) for length in lengths
                     for start in range(0, instants.size - length, max(1, length // 4)))

    def chances(self, run: Run) -> float:
        return max(1, min(run.size, 200))

    def at(self, run: Run, values: Floats) -> Floats:
        since = seconds(run) > values[..., None]
        return np.asarray(since[:, :1] * 1.0 - since[:, 1:])


class Recovery(RunFunction):
    """H(t - t0) exp(-(t - t0)/tau); moments between readings, five time constants up to a third of the run.

    Each has SHORTEST readings at least.
    """

    searched = (Searched('t0', 's', 'moment of the shift, since the first reading', 'instant'),
                Searched('tau', 's', 'time constant of its way back', 'scale'))
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        moments = between_readings(run, 60)
        return tuple(Setting(t0=float(t0), tau=float(tau)) for t0, least in zip(moments, shortest(run, moments))
                     for tau in np.geomspace(duration(run) / 40, duration(run) / 3, 5) if tau >= least)

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        tau, least = setting.number('tau'), float(shortest(run, np.array([setting.number('t0')]))[0])
        return {'tau': (max(tau / 1.6, least), max(tau * 1.6, least))}

    def chances(self, run: Run) -> float:
        return max(1, min(run.size, 200) // 2)

    def at(self, run: Run, values: Floats) -> Floats:
        since = seconds(run) - values[:, :1]
        return np.where(since > 0, np.exp(-np.maximum(since, 0) / values[:, 1:]), 0.0)[:, None]


class Onset(RunFunction):
    """max(0, t - t0); sixteen moments; a steady drift is simpler, so that each has to stand against more."""

    searched = (Searched('t0', 's', 'moment at which it begins, since the first reading', 'phase'),)
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(t0=np.linspace(0, duration(run), 18)[1:-1].tolist())

    def chances(self, run: Run) -> float:
        return 32

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        t0, beside = setting.number('t0'), duration(run) / 17
        return {'t0': (max(t0 - beside, 0.0), t0 + beside)}

    def at(self, run: Run, values: Floats) -> Floats:
        return np.maximum(seconds(run) - values, 0)[:, None]


class Curve(RunFunction):
    """t and t^2."""

    def chances(self, run: Run) -> float:
        return 4

    def at(self, run: Run, values: Floats) -> Floats:
        return np.tile(seconds(run) ** np.array([[1], [2]]), (len(values), 1, 1))


class LaggedTemperature(Temperature):
    """T as a part of the machine with a time constant follows it; from a fiftieth of the run to the whole of it.

    To follow at once is simpler.
    """

    searched = WarmUp.searched

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(tau=np.geomspace(duration(run) / 50, duration(run), 10).tolist()) if super().settings(run) else ()

    def chances(self, run: Run) -> float:
        return 20

    def at(self, run: Run, values: Floats) -> Floats:
        return np.array([_behind_temperature(run, float(tau)) for tau in values[:, 0]])


@lru_cache(maxsize=64)
def _behind_temperature(run: Run, tau: float) -> Floats:
    """Return the waves of the temperature behind it by a time constant, which several effects have, (m, N)."""
    return np.array([lagged(seconds(run), wave, tau) for wave in temperature_waves(run)])


@lru_cache(maxsize=32)
def _directions(effect: 'FactoredEffect', run: Run) -> Floats:
    """Return the directions of an effect; refining its parameters asks for them again and again."""
    return effect.directions(run)


class FactoredEffect(Effect, ABC):
    """An effect whose columns are f(reading; value) e(reading): the search is quick.

    function: f, its parameters are the last searched ones; chosen: what else is searched, and choices: its settings, by
    which `which` chooses among `directions`; acts: the numbers of the directions where nothing else is searched;
    simpler: how many times as much a setting has to stand against, as another explanation is simpler.
    """

    function: RunFunction
    acts: tuple[int, ...] = (0,)
    chosen: tuple[Searched, ...] = ()
    choices: tuple[Setting, ...] = (Setting(),)
    simpler: int = 1

    def __init__(self, name: str = '', function: RunFunction | None = None, *quantities: Quantity,
                 **facts: str | bool | int) -> None:
        """Make the effect that a class is, or one of a family: its name, function and amplitudes.

        facts: what else Effect has, by name; amplitudes that are not given are those of the family. Raises TypeError
        for a fact that no effect has.
        """
        if unknown := [fact for fact in facts if not hasattr(type(self), fact)]:
            raise TypeError(f'{name}: wanted facts of {type(self).__name__}, got {", ".join(unknown)}')
        own = {'name': name, 'function': function, 'quantities': quantities or self.quantities} if function else {}
        vars(self).update(own, **facts)
        self.searched = (*self.chosen, *self.function.searched)
        self.depends_on, self.carries = self.function.depends_on, self.function.carries

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return (*self.quantities, *self.function.gaps(run))

    @abstractmethod
    def directions(self, run: Run) -> Floats:
        """Return the directions in which the effect can act, (D, N, 3)."""

    def which(self, setting: Setting) -> tuple[int, ...]:
        """Return the numbers of the directions in which a setting acts."""
        return self.acts

    def settings(self, run: Run) -> tuple[Setting, ...]:
        values = self.function.settings(run)
        return tuple(Setting({**choice, **value}) for choice in self.choices for value in values)

    def independent_settings(self, run: Run) -> int:
        return self.simpler * max(1, int(len(self.choices) * self.function.chances(run)))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {**super().brackets(run, setting), **self.function.brackets(run, setting)}

    def _values(self, setting: Setting) -> tuple[float, ...]:
        """Return the values of the function's parameters; one that counts nothing where it has none."""
        names = [one.name for one in self.function.searched] or ['']
        return tuple([float(setting.get(name, 0.0)) for name in names])

    def course(self, run: Run, setting: Setting) -> Floats:
        """Return the functions of a setting at each reading, (m, N)."""
        return np.asarray(self.function.at(run, np.array([self._values(setting)]))[0])

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        """Return the Factors of many settings, their columns in the order of these; each value is worked out once."""
        every = [self._values(setting) for setting in settings]
        values = {value: place for place, value in enumerate(dict.fromkeys(every))}
        waves = self.function.at(run, np.array(list(values)))
        return [Factors(settings, waves, _directions(self, run), tuple(
            (values[value], self.which(setting)) for value, setting in zip(every, settings)))]

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the columns of settings that share their number of directions, (b, q, N, 3)."""
        factors, = self.factors(run, settings)
        wave, which = (np.array(each) for each in zip(*factors.of_setting))
        out: Floats = factors.waves[wave][:, :, None, :, None] * factors.directions[which][:, None]
        return out.reshape(len(settings), -1, run.size, 3)
