# SPDX-License-Identifier: Apache-2.0
"""Years of a simulated cell by a script: wear that grows, a plate exchanged, a collision, seasons of temperature.

    machine: {plate: {balls: 12}}          settings of the machine at first (machine.yaml)
    every_days: 7
    runs: 156
    order: random
    seasons_K: 3                           amplitude of the temperature over a year
    changes:
    - {day: 0, until_day: 1095, set: {table: {rotation_urad: 0.45}}}    grows evenly from what it was
    - {day: 430, set: {plate: {number: 2}}}                             from this day on
"""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from rosette_ros.core.errors import InvalidConfig, RosetteError
from rosette_ros.core.records import Run
from rosette_ros.core.scheme import plan
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.simulation.machine import Machine
from rosette_ros.simulation.machine_config import MAX_BYTES, MachineConfig, machine_config
from rosette_ros.simulation.motion import MachineState
from rosette_ros.simulation.setting_types import NotNegative, Positive, Settings, checked

YEAR = 365.25
_READINGS = 10_000_000
"""Random numbers of a run begin so many readings after those of the run before."""


class MachineChange(Settings):
    """What is set from a day on; until_day: real numbers, in lists too, change evenly until then."""

    day: NotNegative
    until_day: NotNegative | None = None
    set: dict[str, Any]

    @model_validator(mode='after')
    def _ends_later(self) -> Self:
        if self.until_day is not None and self.until_day <= self.day:
            raise ValueError(f'until_day: wanted a day after {self.day:g}, got {self.until_day:g}')
        return self


class AgeingScript(Settings):
    """The script; every line is optional."""

    machine: dict[str, Any] = Field(default_factory=dict)
    every_days: Positive = 7.0
    runs: Annotated[int, Field(ge=1, le=100_000)] = 156
    order: str = 'random'
    seasons_K: NotNegative = Field(0.0, description='amplitude of the temperature over a year')
    changes: Annotated[tuple[MachineChange, ...], Field(strict=False)] = ()

    @model_validator(mode='after')
    def _changes_in_order(self) -> Self:
        days = [0.0, *(change.day for change in self.changes)]
        for number, (before, day) in enumerate(itertools.pairwise(days), 1):
            if not before <= day <= self.days[-1]:
                raise ValueError(f'changes.{number}: wanted a day from {before:g}, that of the change before, to '
                                 f'{self.days[-1]:g}, that of the last run, got {day:g}')
        return self

    @property
    def days(self) -> list[float]:
        """The day of each run, the first is 0."""
        return [self.every_days * number for number in range(self.runs)]

    def config(self, day: float) -> MachineConfig:
        """Return the configuration of the machine at a day; raises InvalidConfig where a change makes none."""
        values = machine_config(self.machine, 'machine').model_dump()
        for number, change in enumerate(self.changes, 1):
            if day >= change.day:
                end = change.day if change.until_day is None else change.until_day
                share = 1.0 if day >= end else (day - change.day) / (end - change.day)
                where = f'changes.{number}.set'
                values = _between(values, machine_config(_merged(values, change.set), where).model_dump(), share, where)
        values['climate']['start_degC'] += self._season(day)
        return machine_config(values, f'day {day:g}')

    def _season(self, day: float) -> float:
        """Return how much warmer it is at a day than on average over the year, K."""
        return self.seasons_K * float(np.sin(2 * np.pi * day / YEAR))

    def telling_days(self) -> Iterator[float]:
        """Yield the first day, those of the changes, and the days of the warmest and the coldest run after each."""
        every = self.days
        for begin, end in itertools.pairwise([0.0, *(change.day for change in self.changes), np.inf]):
            days = [day for day in every if begin <= day < end]
            yield from (begin, *(pick(days, key=self._season) for pick in (max, min) if days))

    def iter_runs(self) -> Iterator[tuple[float, Run]]:
        """Yield day and Run of every calibration; its noise is that of its number."""
        for number, day in enumerate(self.days):
            config = self.config(day)
            fresh = Machine(config).state
            state = MachineState(**{**vars(fresh), 'readings': number * _READINGS})
            yield day, Machine(config, state).run(plan(config.plate.balls, self.order, seed=number),
                                                  run_id=f'day_{day:06.1f}')


def read_ageing(path: Path | str) -> AgeingScript:
    """Return the script of a YAML file; raises InvalidConfig where a setting of it is wrong, on any day."""
    script = checked(AgeingScript, read_yaml(path, 'an ageing script', MAX_BYTES, InvalidConfig), str(path))
    try:
        for day in script.telling_days():
            plan(script.config(day).plate.balls, script.order)
    except RosetteError as error:
        raise InvalidConfig(f'{path}: {error}') from error
    return script


def _merged(values: Any, new: Any) -> Any:
    """Return values in which those of `new` are set."""
    if isinstance(values, dict) and isinstance(new, dict):
        return {**values, **{name: _merged(values.get(name), one) for name, one in new.items()}}
    return new


def _between(old: Any, new: Any, share: float, where: str) -> Any:
    """Return a share of the way from old settings to new ones; raises InvalidConfig where there is no way between."""
    if share == 1.0 or old == new:
        return new
    if isinstance(old, float) and isinstance(new, float):
        return old + share * (new - old)
    if isinstance(old, dict) and isinstance(new, dict) and old.keys() == new.keys():
        return {name: _between(old[name], one, share, f'{where}.{name}') for name, one in new.items()}
    if isinstance(old, tuple) and isinstance(new, tuple):
        pairs = itertools.zip_longest(old, new)
        return tuple(_between(_flat(one) if before is None else before, _flat(before) if one is None else one, share,
                              f'{where}.{number}') for number, (before, one) in enumerate(pairs, 1))
    raise InvalidConfig(f'{where}: wanted a number that changes evenly until until_day, got {old!r:.40} before and '
                        f'{new!r:.40} after; leave until_day out, or begin with what is to grow')


def _flat(item: Any) -> Any:
    """Return what an item of a list is before it is there: one without amplitude, where it has one."""
    return {**item, 'amplitude': 0.0} if isinstance(item, dict) and 'amplitude' in item else None
