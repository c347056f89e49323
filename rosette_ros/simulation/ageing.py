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

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.core.records import Run
from rosette_ros.core.scheme import plan
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.simulation.machine import Machine
from rosette_ros.simulation.machine_config import MAX_BYTES, MachineConfig, machine_config
from rosette_ros.simulation.motion import MachineState
from rosette_ros.simulation.setting_types import NotNegative, Positive, Settings, complaint

YEAR = 365.25
_READINGS = 10_000_000
"""Random numbers of a run begin so many readings after those of the run before."""


class MachineChange(Settings):
    """What is set from a day on; until_day: numbers change evenly until then."""

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
                machine_config(_merged(values, change.set, 1.0), f'changes.{number}.set')
                values = _merged(values, change.set, share)
        values['climate']['start_degC'] += self.seasons_K * float(np.sin(2 * np.pi * day / YEAR))
        return machine_config(values, f'day {day:g}')

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
    values = read_yaml(path, 'an ageing script', MAX_BYTES, InvalidConfig)
    if not isinstance(values, dict):
        raise InvalidConfig(f'{path}: wanted a mapping of settings, got {values!r:.60}')
    try:
        script = AgeingScript.model_validate(values)
    except ValidationError as error:
        raise InvalidConfig(complaint(error, str(path), AgeingScript)) from error
    for change in script.changes:
        script.config(change.day)
    return script


def _merged(values: Any, new: Any, share: float) -> Any:
    """Return values in which those of `new` are set, numbers by a share of the way."""
    if isinstance(values, dict) and isinstance(new, dict):
        return {**values, **{name: _merged(values.get(name), one, share) for name, one in new.items()}}
    if isinstance(values, float) and isinstance(new, int | float):
        return values + share * (new - values)
    return new
