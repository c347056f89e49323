# SPDX-License-Identifier: Apache-2.0
"""What an operator configures for a CMM with an I++ DME server: a YAML file of the schema rosette-dme/1."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from rosette_ros.core.run.axes import taught_frame
from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.core.run.geometry import TWO_PI, Floats, Frame, radial
from rosette_ros.core.run.touches import TOUCHES, USUAL
from rosette_ros.dme.wire import PORT, NotDme, format_value
from rosette_ros.io.safe_yaml import of_schema, read_yaml
from rosette_ros.simulation import MachineConfig
from rosette_ros.simulation.setting_types import Axis, NotNegative, Number, Pair, Positive, Settings, Vector, checked

SCHEMA = 'rosette-dme/1'
MOST_BYTES = 65536
Name = Annotated[str, Field(max_length=200)]


class ServerSettings(Settings):
    """Where the I++ server listens; nothing else is ever connected."""

    host: Annotated[str, Field(min_length=1, max_length=253)] = '127.0.0.1'
    port: Annotated[int, Field(gt=0, lt=65536)] = PORT


class TimeoutSettings(Settings):
    """The protocol has no time-outs; after these the command is aborted, and a person has to look."""

    connect_s: Positive = 5.0
    ack_s: Positive = Field(5.0, description='until the server acknowledges a command')
    command_s: Positive = Field(60.0, description='until a command has ended; more than the longest move')
    abort_s: Positive = Field(2.0, description='until AbortE has ended')


class ToolSettings(Settings):
    """The probe."""

    name: Name = Field('', description='as the server lists it; empty: the tool in use')
    change: bool = Field(False, description='true: ChangeTool, which moves the machine; false: SetTool')
    tip_radius_mm: Positive = 2.5
    tip_tolerance_mm: Positive = Field(0.1, description='by which the server may say something else')

    @field_validator('name')
    @classmethod
    def _can_be_sent(cls, value: str) -> str:
        try:
            format_value(value)
        except NotDme as error:
            raise ValueError(str(error)) from error
        return value


class MotionSettings(Settings):
    """How the machine moves and touches; the server is asked what it has made of each."""

    speed_mm_s: Positive | None = Field(None, description='of moves; empty: as the machine has it')
    touch_speed_mm_s: Positive | None = Field(None, description='of touches; empty: as the machine has it')
    dry_run_speed_mm_s: Positive = Field(10.0, description='of moves in a dry run')
    approach_mm: Positive = Field(3.0, description='distance from the surface at which a touch begins')
    search_mm: Positive = Field(3.0, description='how far behind the nominal surface it is searched')
    retract_mm: Positive = Field(3.0, description='how far the tip goes back after a touch')


class BallSettings(Settings):
    """A ball and the shaft on which it stands."""

    radius_mm: Positive = 15.0
    radius_tolerance_mm: Positive = Field(0.2, description='by which the fitted radius may differ')
    shaft_radius_mm: NotNegative = 5.0
    shaft_length_mm: Positive = Field(40.0, description='from the ball centre to the plate')
    touches: int = Field(USUAL, description='of a ball for which none are asked')
    below_pole_mm: Positive = Field(1.0, description='height of the top circle below the pole')
    below_equator_mm: NotNegative = Field(1.0, description='lowest circle below the equator')


class PathSettings(Settings):
    """How far the tip stays away from everything that it does not touch."""

    stand_off_mm: Positive = Field(10.0, description='from the surface of the ball between two touches')
    clearance_mm: Positive = Field(60.0, description='height of the clearance plane over the ball centres')
    box_low_mm: Vector = Field(description='the tip centre is never sent below, machine coordinates')
    box_high_mm: Vector = Field(description='the tip centre is never sent above')


class DmeTableSettings(Settings):
    """Where the rotary table stands with its balls, and how it is turned."""

    origin_mm: Vector = Field((350.0, 260.0, -300.0), description='centre of the ball centres, machine coordinates')
    axis: Axis = Field((0.0, 0.0, 1.0), description='direction of the axis to the free side of the plate')
    azimuth_deg: Number = Field(0.0, description='of ball 1 at table angle 0, as of table.azimuth_deg of the sequencer')
    radius_mm: Positive = 182.5
    balls: Annotated[int, Field(ge=3, le=720)] = 12
    azimuths_deg: Annotated[tuple[Number, ...], Field(min_length=3, max_length=720, strict=False)] | None = Field(
        None, description='of the balls on the plate where they have no equal pitch')
    search_mm: Positive = Field(20.0, description='how far a target may be from there')
    turn: Literal['goto', 'align', 'none'] = Field('goto', description='by GoTo(R()), AlignPart(), or not at all')
    sign: Literal[-1, 1] = Field(1, description='-1: R counts clockwise about the axis')
    zero_deg: Number = Field(0.0, description='R where the table angle is 0')
    reading: Literal['modulo', 'cumulative'] = Field('modulo', description='whether R starts again after a turn')
    limits_deg: Pair | None = Field(None, description='least and greatest R where the table cannot turn on and on')
    overrun_deg: Positive = Field(10.0, description='how far before its place a table with limits turns back')
    tolerance_deg: Positive = Field(0.05, description='by which R may differ from what was commanded')

    @model_validator(mode='after')
    def _can_turn(self) -> Self:
        if self.limits_deg and self.limits_deg[1] - self.limits_deg[0] < 359.999:
            raise ValueError(f'limits_deg: expected a whole turn between them, found {list(self.limits_deg)}')
        return self

    @property
    def frame(self) -> Frame:
        """The table frame as taught, m."""
        return taught_frame(1e-3 * np.array(self.origin_mm), self.axis, np.deg2rad(self.azimuth_deg))

    def balls_at(self, table_angle: float) -> Floats:
        """Return where the balls are at a table angle, rad, in the table frame as taught, (n, 3), m."""
        azimuth = TWO_PI * np.arange(self.balls) / self.balls if self.azimuths_deg is None else np.deg2rad(
            self.azimuths_deg)
        return 1e-3 * self.radius_mm * radial(azimuth + table_angle)


class DmeSettings(Settings):
    """The whole file; only the box of allowed positions has no default."""

    schema_name: Literal['rosette-dme/1'] = Field(alias='schema')
    server: ServerSettings = ServerSettings()
    timeouts: TimeoutSettings = TimeoutSettings()
    tool: ToolSettings = ToolSettings()
    motion: MotionSettings = MotionSettings()
    ball: BallSettings = BallSettings()
    path: PathSettings
    table: DmeTableSettings = DmeTableSettings()
    temperature_sensor: Name = Field('', description='as the server calls the one at the plate; empty: the first one')
    dry_run: bool = Field(False, description='all moves slowly above the plate, no touch')
    simulated: bool = Field(False, description='there is no real machine behind the server; the logs say so')

    @model_validator(mode='after')
    def _parts_fit(self) -> Self:
        for name in ('approach_mm', 'retract_mm'):
            if getattr(self.motion, name) > self.path.stand_off_mm:
                raise ValueError(f'motion.{name}: expected at most path.stand_off_mm = {self.path.stand_off_mm:g}, '
                                 'found '
                                 f'{getattr(self.motion, name):g}')
        if self.ball.touches not in TOUCHES:
            raise ValueError(f'ball.touches: expected one of {", ".join(map(str, TOUCHES))}, found {self.ball.touches}')
        if max(self.ball.below_pole_mm, self.ball.below_equator_mm) >= self.ball.radius_mm:
            raise ValueError('ball: expected circles on the ball, less than ball.radius_mm from pole and equator')
        least = self.ball.radius_mm + self.tool.tip_radius_mm + self.path.stand_off_mm
        if self.path.clearance_mm < least:
            raise ValueError('path.clearance_mm: expected at least ball radius, tip radius and stand-off, '
                             f'{least:g}, found {self.path.clearance_mm:g}')
        for axis, low, high in zip('xyz', self.path.box_low_mm, self.path.box_high_mm):
            if low >= high:
                raise ValueError(f'path.box: expected box_low_mm below box_high_mm along {axis}, found {low:g} and '
                                 f'{high:g}')
        return self


def dme_settings(values: Any, source: str = 'settings') -> DmeSettings:
    """Return the settings of a mapping as read from YAML; raises InvalidConfig, naming `source` and the key."""
    return checked(DmeSettings, of_schema(values, SCHEMA, source, InvalidConfig), source)


def load_dme_settings(path: str | Path) -> DmeSettings:
    """Return the settings of a file; raises InvalidConfig where one is wrong or missing."""
    return dme_settings(read_yaml(path, 'a settings file of an I++ CMM', MOST_BYTES, InvalidConfig), str(path))


def sequencer_parameters(settings: DmeSettings) -> dict[str, Any]:
    """Return the parameters of the sequencer that the settings decide: the table as taught, plates of equal pitch."""
    table = settings.table
    taught = {'table.origin_m': [1e-3 * value for value in table.origin_mm], 'table.axis': list(table.axis),
              'table.azimuth_deg': table.azimuth_deg}
    plate = {'plate.balls': table.balls, 'plate.radius_m': 1e-3 * table.radius_mm}
    return taught | (plate if table.azimuths_deg is None else {})


def client_settings(config: MachineConfig, port: int, sign: int = 1, cumulative: bool = False) -> dict[str, object]:
    """Return the settings, as a mapping, that fit a simulated machine behind a server on this computer."""
    place, plate, tip = config.placement, config.plate, config.probing.tip_radius_mm
    half = plate.circle_radius_mm + 100.0
    low, high = ([value + sign * half for value in place.origin_mm] for sign in (-1.0, 1.0))
    return {
        'schema': 'rosette-dme/1', 'simulated': True, 'server': {'host': '127.0.0.1', 'port': port},
        'tool': {'name': 'Probe1', 'tip_radius_mm': tip},
        'ball': {'radius_mm': plate.ball_radius_mm, 'shaft_radius_mm': 0.35 * plate.ball_radius_mm,
                 'shaft_length_mm': 4.0 * plate.ball_radius_mm, 'below_pole_mm': config.probing.below_pole_mm,
                 'below_equator_mm': config.probing.below_equator_mm},
        'path': {'box_low_mm': low, 'box_high_mm': high,
                 'clearance_mm': max(60.0, plate.ball_radius_mm + tip + 30.0)},
        'table': {'origin_mm': list(place.origin_mm), 'axis': list(place.axis), 'azimuth_deg': place.azimuth_deg,
                  'radius_mm': plate.circle_radius_mm, 'balls': plate.balls, 'sign': sign,
                  'reading': 'cumulative' if cumulative else 'modulo'}}
