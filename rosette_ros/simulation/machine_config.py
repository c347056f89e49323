# SPDX-License-Identifier: Apache-2.0
"""The configuration of the simulated cell: units in the names, every range checked.

Each part has its settings beside it (cell_parts, motion, probing, faults, hidden). Millimetres, micrometres and degrees
stand in settings only, where a person reads and writes them.
"""

from os.path import expanduser
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.simulation import cell_parts
from rosette_ros.simulation.faults import FaultList
from rosette_ros.simulation.hidden import HiddenDraw, HiddenList
from rosette_ros.simulation.motion import TimingSettings
from rosette_ros.simulation.probing import ProbingSettings
from rosette_ros.simulation.setting_types import Axis, Number, Seed, Settings, Vector, checked

MAX_BYTES = 65536


class PlacementSettings(Settings):
    """Where the table stands in the CMM."""

    origin_mm: Vector = Field((350.0, 260.0, -300.0), description='roughly known, machine frame')
    axis: Axis = Field((0.0, 0.0, 1.0), description='direction of the table axis, machine frame, of any length')
    azimuth_deg: Number = Field(0.0, description='of ball 1 at table angle 0, about the axis (docs/real-cmm.md)')
    origin_error_mm: Annotated[float, Field(ge=0, le=2)] = Field(
        0.3, description='distance of the true origin; the direction is drawn')
    axis_tilt_mrad: Annotated[float, Field(ge=0, le=10)] = Field(
        0.2, description='table axis relative to `axis`; the direction is drawn')


class MachineConfig(Settings):
    """The whole simulated cell; hidden: a list of effects, or `{seed: N}`, which draws them (then `hidden_draw`)."""

    seed: Seed = 1
    plate: cell_parts.PlateSettings = cell_parts.PlateSettings()
    clamping: cell_parts.ClampingSettings = cell_parts.ClampingSettings()
    placement: PlacementSettings = PlacementSettings()
    table: cell_parts.TableSettings = cell_parts.TableSettings()
    cmm: cell_parts.CmmSettings = cell_parts.CmmSettings()
    probing: ProbingSettings = ProbingSettings()
    climate: cell_parts.ClimateSettings = cell_parts.ClimateSettings()
    timing: TimingSettings = TimingSettings()
    hidden: HiddenList = ()
    hidden_draw: HiddenDraw | None = None
    faults: FaultList = ()

    @model_validator(mode='before')
    @classmethod
    def _seed_of_hidden(cls, values: Any) -> Any:
        if isinstance(values, dict) and isinstance(values.get('hidden'), dict):
            return {**values, 'hidden': (), 'hidden_draw': values['hidden']}
        return values

    @model_validator(mode='after')
    def _parts_fit(self) -> Self:
        pitches = self.clamping.plate_turn_deg * self.plate.balls / 360
        if abs(pitches - round(pitches)) > 1e-9:
            raise ValueError(
                f'clamping.plate_turn_deg: wanted a multiple of {360 / self.plate.balls:.6g} deg '
                f'(one ball pitch), got {self.clamping.plate_turn_deg:g}')
        reach = max(self.probing.below_pole_mm, self.probing.below_equator_mm)
        if reach >= self.plate.ball_radius_mm:
            raise ValueError('probing: wanted circles on the ball, less than plate.ball_radius_mm = '
                             f'{self.plate.ball_radius_mm:g} from pole and equator, got {reach:g}')
        for place, effect in enumerate(self.hidden):
            ball = getattr(effect, 'ball', None)
            if ball is not None and ball > self.plate.balls:
                raise ValueError(f'hidden.{place + 1}.ball: wanted 1..{self.plate.balls}, got {ball}')
        return self

    @property
    def radius(self) -> float:
        """Nominal radius of the circle of ball centres, m."""
        return self.plate.circle_radius_mm * 1e-3

    def changed(self, **groups: Any) -> 'MachineConfig':
        """Return a checked copy in which single settings of groups differ.

        >>> MachineConfig().changed(seed=7, plate={'balls': 6}).plate.balls
        6
        """
        values = self.model_dump()
        for name, value in groups.items():
            nested = isinstance(value, dict) and isinstance(values.get(name), dict)
            values[name] = {**values[name], **value} if nested else value
        return machine_config(values, 'changed configuration')


def machine_config(values: Any, source: str = 'machine configuration') -> MachineConfig:
    """Return the configuration of a mapping as read from YAML; raise InvalidConfig, naming `source` and the key."""
    return checked(MachineConfig, values, source)


def load_machine(path: Path | str) -> MachineConfig:
    """Return the configuration of a YAML file, the rest by default; raises InvalidConfig where a setting is wrong."""
    values = read_yaml(path, 'a machine file', MAX_BYTES, InvalidConfig)
    config = machine_config({} if values is None else values, str(path))
    if file := config.table.correction_file:
        config = config.changed(table={'correction_file': str(Path(path).absolute().parent / expanduser(file))})
    return config
