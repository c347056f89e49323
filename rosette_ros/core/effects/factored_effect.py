# SPDX-License-Identifier: Apache-2.0
"""Effects that follow a function of the readings along some directions: any function goes with any directions."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.effects.effect import Bracket, Effect, Factors, Setting, grid
from rosette_ros.core.effects.run_functions import between_readings, duration, seconds, temperature_change
from rosette_ros.core.records import Floats, Run


class RunFunction:
    """How an effect develops in a run: m functions of the reading, with at most one searched parameter.

    A subclass gives `at` and, where there is a parameter, the settings to try of it, how many of them count as separate
    chances, and where to refine it if not as Effect.brackets does.
    """

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return (Setting(),)

    def chances(self, run: Run) -> float:
        return 1

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {}

    def at(self, run: Run, values: Floats) -> Floats:
        """Return the functions at each reading, (v, m, N), for values (v, 1) of the parameter, zero without one."""
        raise NotImplementedError


class Drift(RunFunction):
    """t."""

    def at(self, run: Run, values: Floats) -> Floats:
        return np.tile(seconds(run), (len(values), 1, 1))


class WarmUp(RunFunction):
    """1 - exp(-t/tau); time constants from a fiftieth of the run to the whole of it, of which neighbours look alike."""

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(tau=np.geomspace(duration(run) / 50, duration(run), 14).tolist())

    def chances(self, run: Run) -> float:
        return 5

    def at(self, run: Run, values: Floats) -> Floats:
        return -np.expm1(-seconds(run) / values)[:, None]


class Temperature(RunFunction):
    """T - T0; nothing to try where the temperature stands still."""

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return (Setting(),) if np.ptp(run.temperature) else ()

    def at(self, run: Run, values: Floats) -> Floats:
        return np.tile(temperature_change(run), (len(values), 1, 1))


class Cycle(RunFunction):
    """cos and sin of 2 pi t/P; one cycle in the run up to a quarter of the readings, at most 100, a chance for each.

    Refined by half a cycle to either side, up to one in the run: a period cannot be told from less, which is any curve.
    """

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(period=(duration(run) / np.arange(1.0, min(run.size / 4, 100) + 0.25, 0.5)).tolist())

    def chances(self, run: Run) -> float:
        return max(1, int(min(run.size / 4, 100)))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        cycles = duration(run) / setting.number('period')
        return {'period': (duration(run) / (cycles + 0.5), duration(run) / max(cycles - 0.5, 1.0))}

    def at(self, run: Run, values: Floats) -> Floats:
        angle = 2 * np.pi * seconds(run) / values
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


class Step(RunFunction):
    """H(t - t0); moments between readings, of which neighbours look alike."""

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(t0=between_readings(run).tolist())

    def chances(self, run: Run) -> float:
        return max(1, min(run.size, 200) // 4)

    def at(self, run: Run, values: Floats) -> Floats:
        return (seconds(run) > values).astype(float)[:, None]


class FactoredEffect(Effect):
    """An effect whose columns are f(reading; value) e(reading): the search is quick.

    function: f, its parameter is the last searched one; choices: settings of what else is searched, by which `which`
    chooses among `directions`.
    """

    function: RunFunction
    choices: tuple[Setting, ...] = (Setting(),)

    def directions(self, run: Run) -> Floats:
        """Return the directions in which the effect can act, (D, N, 3)."""
        raise NotImplementedError

    def which(self, setting: Setting) -> tuple[int, ...]:
        """Return the numbers of the directions in which a setting acts."""
        raise NotImplementedError

    def settings(self, run: Run) -> tuple[Setting, ...]:
        values = self.function.settings(run)
        return tuple(Setting({**choice, **value}) for choice in self.choices for value in values)

    def independent_settings(self, run: Run) -> int:
        return max(1, int(len(self.choices) * self.function.chances(run)))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {**super().brackets(run, setting), **self.function.brackets(run, setting)}

    def factors(self, run: Run, settings: Sequence[Setting]) -> Factors:
        """Return the Factors of many settings; each value is worked out once."""
        name = self.searched[-1].name if self.searched else ''
        found = [setting.get(name, 0.0) for setting in settings]
        every = [0.0 if isinstance(value, str) else value for value in found]
        values = {value: place for place, value in enumerate(dict.fromkeys(every))}
        waves = self.function.at(run, np.array(list(values), dtype=float)[:, None])
        return Factors(waves, self.directions(run), tuple(
            (values[value], self.which(setting)) for value, setting in zip(every, settings)))

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the columns of settings that share their number of directions, (b, q, N, 3)."""
        factors = self.factors(run, settings)
        wave, which = (np.array(each) for each in zip(*factors.of_setting))
        out: Floats = factors.waves[wave][:, :, None, :, None] * factors.directions[which][:, None]
        return out.reshape(len(settings), -1, run.size, 3)
