# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: N815 (the unit kelvin is a capital letter)
"""The configuration of the simulated cell: units in the names, every range checked.

Millimetres, micrometres and degrees stand here only, where a person reads and writes them.
"""

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field, ValidationError, model_validator

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.machine.complaints import complaint
from rosette_ros.machine.faults import FaultList
from rosette_ros.machine.hidden import KINDS, HiddenDraw, HiddenList
from rosette_ros.machine.settings import (
    NotNegative,
    Number,
    Positive,
    Seed,
    Settings,
    Vector,
)

_LONGEST = 65536
_MOST_BRACKETS = 500
"""Reading YAML takes time with the square of nested brackets."""
_BAD_VALUE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What the constructors of YAML raise besides YAMLError, such as for `!!int ""` or 2001-13-45."""


class PlateSettings(Settings):
    """The ball plate: an uncalibrated one within usual tolerances."""

    balls: Annotated[int, Field(ge=3, le=720, description='n, also of table positions')] = 12
    circle_radius_mm: Positive = 182.5
    ball_radius_mm: Annotated[float, Field(gt=2.0, le=50.0)] = 7.5
    deviation_um: NotNegative = Field(20.0, description='sd of each ball coordinate')


class ClampingSettings(Settings):
    """How a person clamped the plate: sizes; directions are drawn from the seed."""

    eccentricity_mm: Annotated[float, Field(ge=0, le=2)] = 0.2
    tilt_mrad: Annotated[float, Field(ge=0, le=10)] = 0.2
    turn_mrad: Annotated[float, Field(ge=-10, le=10)] = Field(
        0.3, description='ball 1 is off the x axis by this angle')
    height_mm: Annotated[float, Field(ge=-5, le=5)] = 0.1
    plate_turn_deg: Number = Field(
        0.0, description='whole ball pitches: the plate was put on turned, the ball next to +x is '
                         'counted as ball 1')


class PlacementSettings(Settings):
    """Where the table stands in the CMM."""

    origin_mm: Vector = Field((350.0, 260.0, -300.0), description='roughly known, machine frame')
    origin_error_mm: Annotated[float, Field(ge=0, le=2)] = Field(
        0.3, description='how far the true origin is off; the direction is drawn')
    axis_tilt_mrad: Annotated[float, Field(ge=0, le=10)] = Field(
        0.2, description='table axis against machine z; the direction is drawn')


class TableSettings(Settings):
    """The rotary table: peak values of its six smooth error curves, and its correction tables."""

    translation_um: NotNegative = Field(0.05, description='peak of ctx, cty, ctz')
    rotation_urad: NotNegative = Field(0.3, description='peak of crx, cry, crz')
    harmonics: Annotated[int, Field(ge=1, le=360)] = 5
    fine_orders: Annotated[tuple[Annotated[int, Field(ge=1, le=10000)], ...],
                           Field(strict=False, description='extra harmonics, e.g. above n/2')] = ()
    fine_share: Annotated[float, Field(ge=0, le=1)] = Field(
        0.2, description='amplitude of each extra harmonic as a share of the peak')
    axial_correction: bool = True
    axial_raw_um: NotNegative = Field(0.5, description='peak of the ctz correction table')
    angular_correction: bool = True
    angular_raw_urad: NotNegative = Field(2.0, description='peak of the crz correction table')
    positioning_urad: NotNegative = Field(
        0.0, description='sd of the stopping angle; the encoder shows where it stopped')


class CmmSettings(Settings):
    """The coordinate measuring machine: peak volumetric errors of the uncorrected axes."""

    correction: bool = True
    residual_share: Annotated[float, Field(ge=0, le=1)] = Field(
        0.05, description='share of the errors that the correction leaves')
    scale_ppm: NotNegative = 5.0
    squareness_urad: NotNegative = 10.0
    straightness_um: NotNegative = 1.5
    volume_mm: Positive = Field(1000.0, description='edge of the working volume')
    reversal_deadband_mm: Positive = Field(
        1.0, description='a shorter move of an axis does not change the side it leans on')


class ProbingSettings(Settings):
    """Twenty touches on five horizontal circles, and how well a ball centre repeats."""

    repeatability_um: NotNegative = Field(0.1, description='sd of each ball-centre coordinate')
    touch_share: Annotated[float, Field(ge=0, le=1)] = Field(
        0.8, description='share of the touches in the sd of the worst coordinate; the rest is the '
                         'positioning of the CMM')
    circles: Annotated[int, Field(ge=2, le=20)] = 5
    points_per_circle: Annotated[int, Field(ge=3, le=50)] = 4
    below_pole_mm: Positive = Field(1.0, description='height of the top circle below the pole')
    below_equator_mm: NotNegative = Field(1.0, description='lowest circle below the equator')
    tip_radius_mm: Positive = 2.5


class ClimateSettings(Settings):
    """Temperature at the plate."""

    start_degC: Annotated[float, Field(ge=0, le=50)] = 20.0
    drift_K_per_h: Number = 0.05
    daily_K: NotNegative = Field(0.1, description='amplitude of the daily cycle')
    cycle_K: NotNegative = Field(0.02, description='amplitude of the air conditioning')
    cycle_min: Positive = Field(18.0, description='period of the air conditioning')
    sensor_K: NotNegative = Field(0.002, description='sd of the thermometer')


class TimingSettings(Settings):
    """How long things take: a ball 20 to 60 s."""

    table_speed_deg_per_s: Positive = 10.0
    table_settle_s: NotNegative = 2.0
    cmm_speed_mm_per_s: Positive = 60.0
    cmm_settle_s: NotNegative = 1.0
    touch_s: Positive = 1.2
    jitter_s: NotNegative = Field(0.3, description='sd of the waiting before a ball')


class MachineConfig(Settings):
    """The whole simulated cell.

    `hidden` is a list of effects, or a mapping `{seed: N}` that draws them (then `hidden_draw`).
    """

    seed: Seed = 1
    plate: PlateSettings = PlateSettings()
    clamping: ClampingSettings = ClampingSettings()
    placement: PlacementSettings = PlacementSettings()
    table: TableSettings = TableSettings()
    cmm: CmmSettings = CmmSettings()
    probing: ProbingSettings = ProbingSettings()
    climate: ClimateSettings = ClimateSettings()
    timing: TimingSettings = TimingSettings()
    hidden: HiddenList = ()
    hidden_draw: HiddenDraw | None = None
    faults: FaultList = ()

    @model_validator(mode='before')
    @classmethod
    def _seed_of_hidden(cls, values):
        """Take `hidden: {seed: N}` as the order to draw."""
        if isinstance(values, dict) and isinstance(values.get('hidden'), dict):
            return {**values, 'hidden': (), 'hidden_draw': values['hidden']}
        return values

    @model_validator(mode='after')
    def _parts_fit(self):
        """Refuse a plate turn that is no whole number of pitches, and circles off the ball."""
        pitches = self.clamping.plate_turn_deg * self.plate.balls / 360
        if abs(pitches - round(pitches)) > 1e-9:
            raise ValueError(
                f'clamping.plate_turn_deg: wanted a multiple of {360 / self.plate.balls:.6g} deg '
                f'(one ball pitch), got {self.clamping.plate_turn_deg:g}')
        reach = max(self.probing.below_pole_mm, self.probing.below_equator_mm)
        if reach >= self.plate.ball_radius_mm:
            raise ValueError(
                'probing: wanted circles on the ball, less than plate.ball_radius_mm = '
                f'{self.plate.ball_radius_mm:g} from pole and equator, got {reach:g}')
        for kind in self.hidden_draw.kinds if self.hidden_draw else ():
            if kind not in KINDS:
                raise ValueError(f'hidden.kinds: wanted some of {", ".join(KINDS)}, got {kind!r}')
        for place, effect in enumerate(self.hidden):
            ball = getattr(effect, 'ball', None)
            if ball is not None and ball > self.plate.balls:
                raise ValueError(f'hidden.{place + 1}.ball: wanted 1..{self.plate.balls}, '
                                 f'got {ball}')
        return self

    @property
    def radius(self):
        """Nominal radius of the circle of ball centres, m."""
        return self.plate.circle_radius_mm * 1e-3

    def changed(self, **groups):
        """Return a checked copy in which single settings of groups differ.

        >>> MachineConfig().changed(seed=7, plate={'balls': 6}).plate.balls
        6
        """
        values = self.model_dump()
        for name, value in groups.items():
            nested = isinstance(value, dict) and isinstance(values.get(name), dict)
            values[name] = {**values[name], **value} if nested else value
        return machine_config(values, 'changed configuration')


def machine_config(values, source='machine configuration'):
    """Return the MachineConfig of a mapping as read from YAML.

    Raises InvalidConfig: which key of `source`, what was wanted, what came.
    """
    if not isinstance(values, dict):
        raise InvalidConfig(f'{source}: wanted a mapping of settings, got {values!r:.60}')
    try:
        return MachineConfig.model_validate(values)
    except ValidationError as error:
        raise InvalidConfig(complaint(error, source, MachineConfig)) from error


def load_machine(path):
    """Return the MachineConfig of a YAML file; what is not in it has its default.

    Raises InvalidConfig where the file cannot be read or a setting is wrong.
    """
    try:
        with Path(path).open(encoding='utf-8') as file:
            text = file.read(_LONGEST + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidConfig(f'{path}: wanted a readable YAML file, got: {error}') from error
    brackets = text.count('[') + text.count('{')
    if len(text) > _LONGEST or brackets > _MOST_BRACKETS:
        raise InvalidConfig(f'{path}: wanted at most {_LONGEST} characters and {_MOST_BRACKETS} '
                            'opening brackets, got more; this is no description of a machine')
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.SafeLoader)):
            raise InvalidConfig(f'{path}: wanted plain YAML, got an alias (*name); write it out')
        values = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, *_BAD_VALUE) as error:
        raise InvalidConfig(
            f'{path}: wanted YAML, got: {" ".join(str(error).split())}') from error
    return machine_config({} if values is None else values, str(path))


def quiet(**groups):
    """Return a cell without any error or noise, in which single settings differ: for tests."""
    silent = {
        'plate': {'deviation_um': 0.0},
        'clamping': {'eccentricity_mm': 0.0, 'tilt_mrad': 0.0, 'turn_mrad': 0.0, 'height_mm': 0.0},
        'placement': {'origin_mm': (0.0, 0.0, 0.0), 'origin_error_mm': 0.0, 'axis_tilt_mrad': 0.0},
        'table': {'translation_um': 0.0, 'rotation_urad': 0.0},
        'cmm': {'scale_ppm': 0.0, 'squareness_urad': 0.0, 'straightness_um': 0.0},
        'probing': {'repeatability_um': 0.0},
        'climate': {'drift_K_per_h': 0.0, 'daily_K': 0.0, 'cycle_K': 0.0, 'sensor_K': 0.0},
        'timing': {'jitter_s': 0.0},
    }
    return machine_config(silent, 'quiet cell').changed(**groups)
