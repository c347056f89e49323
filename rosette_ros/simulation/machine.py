# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: a table, a plate, a CMM and what they hide, reading after reading.

A ball in the plate's frame is carried through exact rigid bodies: clamped plate, turning table with its error motions,
tilted axis, machine frame. Each of its touches is made at its own time on a real sphere, the CMM adds its errors, and
the least-squares sphere gives the centre.

Each part has its settings beside it (cell_parts, motion, probing, faults, hidden_kinds), with units in the names and
every range checked. Millimetres, micrometres and degrees stand in settings only, where a person reads and writes them.
"""

import math
from dataclasses import replace
from os.path import expanduser
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from rosette_ros.core.run.axes import nearest_axis, taught_frame, unit_axis, words
from rosette_ros.core.run.errors import InvalidConfig, InvalidPlan
from rosette_ros.core.run.geometry import TWO_PI, Frame, nominal_angles, rotate_z, rotation_matrix, table_frame
from rosette_ros.core.run.records import Floats, Ints, Run
from rosette_ros.core.run.scheme import Scheme, nominal_places
from rosette_ros.core.run.touches import fit_spheres
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.simulation import cell_parts, probing
from rosette_ros.simulation.faults import FaultList
from rosette_ros.simulation.hidden_effect import Situation, acting
from rosette_ros.simulation.hidden_kinds import HiddenDraw, HiddenList, draw_hidden
from rosette_ros.simulation.motion import MachineState, Moment, Moves, TimingSettings, moves
from rosette_ros.simulation.probing import BallNotFound, BallReading, BallReadings, ProbingSettings
from rosette_ros.simulation.random_streams import part_generator, standard_normal
from rosette_ros.simulation.setting_types import Axis, Number, Seed, Settings, Vector, checked

MAX_BYTES = 65536  # of a machine file
STEEPEST = 0.5
"""A ball is reached from directions up to 60 degrees from the axis; then plate and stem are in the way."""
NEXT, LAST = [1, 2, 0], [2, 0, 1]
"""Of each coordinate the one after it, and the one before it."""


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
                f'clamping.plate_turn_deg: expected a multiple of {360 / self.plate.balls:.6g} deg '
                f'(one ball pitch), found {self.clamping.plate_turn_deg:g}')
        reach = max(self.probing.below_pole_mm, self.probing.below_equator_mm)
        if reach >= self.plate.ball_radius_mm:
            raise ValueError('probing: expected circles on the ball, less than plate.ball_radius_mm = '
                             f'{self.plate.ball_radius_mm:g} from pole and equator, found {reach:g}')
        for place, effect in enumerate(self.hidden):
            ball = getattr(effect, 'ball', None)
            if ball is not None and ball > self.plate.balls:
                raise ValueError(f'hidden.{place + 1}.ball: expected 1..{self.plate.balls}, found {ball}')
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


class Alignment(NamedTuple):
    """Before a run: table frame in the machine frame, sd of a coordinate, m, and its dof, both None if not measured."""

    frame: Frame
    repeatability: float | None = None
    dof: int | None = None


class Machine:
    """A cell that measures balls one after the other; state: where another machine stood, default: just switched on."""

    def __init__(self, config: MachineConfig, state: MachineState | None = None) -> None:
        self.config, self.n, self.radius = config, config.plate.balls, config.radius
        rough = 1e-3 * np.array(config.placement.origin_mm)
        self.rough_frame = taught_frame(rough, config.placement.axis, np.deg2rad(config.placement.azimuth_deg))
        self.true_frame = _true_frame(config, self.rough_frame)
        self.table = cell_parts.RotaryTable(config.table, config.seed)
        self.plate = cell_parts.BallPlate(config.plate, config.clamping, config.seed)
        self.cmm = cell_parts.VolumetricErrors(config.cmm, rough, config.seed)
        self.climate = cell_parts.Climate(config.climate, config.seed)
        self.pattern = probing.TouchPattern(config.probing, 1e-3 * config.plate.ball_radius_mm)
        self.hidden = config.hidden
        if config.hidden_draw is not None:
            self.hidden += draw_hidden(config.hidden_draw, _expected_situation(config, self.pattern.size))
        self._acting = acting(self.hidden)
        self._angles = nominal_angles(self.n)
        self._nominal = nominal_places(self.n, self.radius, 1, np.arange(1, self.n + 1))
        self.state = state or MachineState(0.0, 0, 0, 0, 0.0, self.rough_frame.to_outer(self._nominal[0]),
                                         np.zeros(3), 0)

    @property
    def time(self) -> float:
        """Simulated time since power-on, at the end of the last reading, s."""
        return self.state.time

    def stand(self, seconds: float) -> None:
        """Let so much time pass, not below 0, in which nothing moves, s."""
        self.state = replace(self.state, time=self.state.time + max(seconds, 0.0))

    def measure(self, table_position: int, ball: int, approach: int = 1, aim: ArrayLike | None = None,
                short: float = 0.0, touches: int = 0, pole: ArrayLike | None = None,
                table_offset: float = 0.0) -> BallReading[int, float]:
        """Measure one ball now and return its reading; the simulated time advances.

        table_position, ball: one-based; approach: sense in which the table turns to get there, +1 or -1, 0 is taken as
        +1; aim: (3,) where the ball is expected, machine frame, m (default: the nominal place by the roughly known
        origin); short: angle by which the table, if it moves, stops before its place, rad; touches: of the ball, one of
        TOUCHES, 0 as configured; pole: (3,) direction in the machine from which the ball is probed (default: the table
        axis as roughly known); table_offset: angle of table position 1, rad. Raises InvalidPlan for indices out of
        range or other touches, and BallNotFound where the aim is off or the plate is in the way; then the state stays
        as it was.
        """
        aims = None if aim is None else np.asarray(aim, dtype=float)[None, :]
        return self.measure_many([table_position], [ball], [approach], aims, short, touches, pole,
                                 table_offset)[0]

    def measure_many(self, table_position: ArrayLike, ball: ArrayLike, approach: ArrayLike, aim: Floats | None = None,
                     short: float = 0.0, touches: int = 0, pole: ArrayLike | None = None,
                     table_offset: float = 0.0, wait: Floats | float = 0.0) -> BallReadings:
        """Measure N balls in order and return their readings, equal to N calls of `measure` bit by bit.

        table_position, ball, approach: (N,); aim: (N, 3) machine frame, m; short, touches, pole, table_offset: as
        `measure`; wait: (N,) or of each, s for which the machine stands still before. Raises as `measure`.
        """
        table_position, ball = self._checked(table_position, 'table position'), self._checked(ball, 'ball')
        if aim is None:
            aim = self.rough_frame.turned(table_offset).to_outer(self._nominal[(table_position + ball - 2) % self.n])
        pattern = self.pattern.of(touches).towards(self._reachable(pole))
        draws = standard_normal(self.config.seed, self.state.readings + np.arange(ball.size), pattern.size + 6)
        timing, approach = self.config.timing, np.asarray(approach)
        made = moves(
            self.state, timing, self.n, np.asarray(table_position - 1 + table_offset * self.n / TWO_PI, dtype=float),
            approach, np.asarray(aim),
            wait=timing.jitter_s * np.abs(draws[:, -6]) + wait,
            stop=1e-6 * self.config.table.positioning_urad * draws[:, -5] - short * np.where(approach < 0, -1, 1),
            touches=pattern.size, deadband=1e-3 * self.config.cmm.reversal_deadband_mm,
            free=nearest_axis(self.rough_frame.rotation[:, 2]))
        moment = self._moment(made, table_position, ball, pattern.size, table_offset)
        centre, form, point = self._probe(moment, made.cmm, draws, pattern)
        self.state = made.last_state(self.state)
        sensor = self.config.climate.sensor_K * draws[:, -4]
        return BallReadings(
            table_position=table_position, ball=ball, time=moment.time.sum(-1) / pattern.size,
            began=made.began, ended=made.ended, table_angle=moment.angle[:, 0] % TWO_PI,
            table_travel=moment.travel[:, 0], approach=made.approach, centre=centre,
            form_error=form, temperature=self.climate.start + moment.warming[:, -1] + sensor, touch_point=point,
            touch_normal=np.broadcast_to(pattern.direction @ pattern.axes.T, point.shape), touch_time=moment.time)

    def align(self, repeats: int = 10, table_offset: float = 0.0) -> Alignment:
        """Measure ball 1 `repeats` times, then at every table position (the axis), then every ball (the plane)."""
        one, every = np.ones(self.n, dtype=int), np.arange(1, self.n + 1)
        sigma, dof = self._repeat(repeats, table_offset)
        axis, plane = (self.measure_many(at, ball, one, table_offset=table_offset) for at, ball in (
            (every, one), (one, every)))
        return Alignment(table_frame(axis.centre, plane.centre), sigma, dof)

    def run(self, scheme: Scheme, repeats: int = 10, align: bool = True, run_id: str = '') -> Run:
        """Measure a whole Scheme and return its Run, as the cell would after its alignment.

        Times count from the first reading of the run. repeats: readings of the repeatability check, fewer than two
        leave the Run without repeatability; align: whether the table frame is found by measuring, else it is the true
        one. Raises InvalidPlan where the scheme is for another number of balls.
        """
        return self.calibrate(scheme, repeats, align, run_id)[0]

    def calibrate(self, scheme: Scheme, repeats: int = 10, align: bool = True,
                  run_id: str = '') -> tuple[Run, Alignment, BallReadings]:
        """Return what `run` returns, the alignment, and the readings in the machine frame."""
        if scheme.n != self.n:
            raise InvalidPlan(f'scheme: expected one for the {self.n} balls of this plate, found one for {scheme.n}')
        offset = scheme.table_offset
        alignment = self.align(repeats, offset) if align else Alignment(
            self.true_frame.turned(offset), *self._repeat(repeats, offset))
        aim = alignment.frame.to_outer(nominal_places(self.n, self.radius, scheme.table_position, scheme.ball))
        readings = self.measure_many(scheme.table_position, scheme.ball, scheme.approach, aim, table_offset=offset,
                                     wait=scheme.wait)
        run = Run(
            n=self.n, radius=self.radius, table_position=readings.table_position, ball=readings.ball,
            centre=alignment.frame.to_inner(readings.centre), table_angle=readings.table_angle - offset,
            time=readings.time - readings.time[0], temperature=readings.temperature, approach=readings.approach,
            table_travel=readings.table_travel, repeatability=alignment.repeatability, repeatability_dof=alignment.dof,
            run_id=run_id, repeats=scheme.repeats, simulated=True, rotation=alignment.frame.rotation,
            table_offset=offset)
        return run, alignment, readings

    def table_truth(self, angle: ArrayLike | None = None, frame: Frame | None = None) -> Floats:
        """Return the true six curves, repeatable errors only, (m, 6), m and rad, as in core.records.ErrorMotions.

        angle: (m,) rad (default: the nominal ones); frame: the table frame they are wanted in (default: the true one).
        """
        angle = self._angles if angle is None else np.asarray(angle, dtype=float)
        return self.table.curves(angle, self.true_frame, frame or self.true_frame)

    def maker_table(self, angle: Floats | None = None) -> Floats:
        """Return the correction tables of the maker, zero where there is none, (m, 6)."""
        return self.table.maker(self._angles if angle is None else angle)

    def plate_truth(self, frame: Frame | None = None) -> Floats:
        """Return the true plate deviations P_j in a table frame, clamping included, (n, 3), m."""
        between = cell_parts.frame_between(self.true_frame, frame or self.true_frame)
        return between.to_outer(self.plate.on_table(np.arange(1, self.n + 1))) - self._nominal

    def cmm_truth(self, frame: Frame | None = None) -> Floats:
        """Return the true CMM deviations M_k in a table frame, (n, 3), m."""
        frame = frame or self.true_frame
        return self.cmm.error(frame.to_outer(self._nominal)) @ frame.rotation

    def _repeat(self, repeats: int, table_offset: float) -> tuple[float, int] | tuple[None, None]:
        """Return sigma and degrees of freedom of `repeats` readings of ball 1, or None twice."""
        if repeats < 1:
            return None, None
        one = np.ones(repeats, dtype=int)
        centre = self.measure_many(one, one, one, table_offset=table_offset).centre
        if repeats < 2 or self.config.probing.repeatability_um == 0:
            return None, None
        dof = 3 * (repeats - 1)
        return float(np.sqrt(((centre - centre.mean(axis=0))**2).sum() / dof)), dof

    def _checked(self, index: ArrayLike, what: str) -> Ints:
        index = np.asarray(index)
        bad = (index < 1) | (index > self.n)
        if bad.any():
            raise InvalidPlan(f'{what}: expected 1..{self.n}, found {index[bad][0]}')
        return index.astype(np.int64)

    def _reachable(self, pole: ArrayLike | None) -> Floats:
        """Return the pole from which balls are probed; raises BallNotFound where the plate is in the way."""
        axis = self.rough_frame.rotation[:, 2]
        if pole is None:
            return axis
        pole = unit_axis(pole)
        if pole @ axis < STEEPEST:
            raise BallNotFound(f'expected a pole on the free side of the plate, about along {words(axis)}, found '
                               f'{words(pole)}; check the axis of the table (table.axis)')
        return pole

    def _moment(self, made: Moves, table_position: Ints, ball: Ints, touches: int, table_offset: float) -> Moment:
        touch = self.config.timing.touch_s * np.arange(1, touches + 1)
        time = made.arrived[:, None] + touch
        return Moment(
            time=time, began=made.began[:, None], ended=made.ended[:, None], warming=self.climate.warming(time),
            table_position=table_position[:, None], ball=ball[:, None], azimuth=self._angles[ball - 1][:, None],
            angle=(self._angles[table_position - 1] + table_offset + made.stop)[:, None],
            travel=(made.steps * (TWO_PI / self.n) + made.stop)[:, None],
            turned=np.multiply(made.turned, TWO_PI / self.n)[:, None], approach=made.approach[:, None],
            cmm_sense=made.cmm_sense[:, None, :], gravity=-self.true_frame.rotation[2])

    def _sum(self, hook: str, moment: Moment) -> Floats | float:
        """Return the sum of one hook over the hidden effects; 0.0 where none has it."""
        return sum((act(moment) for act in self._acting[hook]), start=0.0)

    def ball_centres(self, moment: Moment) -> Floats:
        """Return the true ball centres in the machine frame, (N, 1 or Q, 3), m."""
        centre = self.plate.on_table(moment.ball, self._sum('plate_growth', moment))
        centre = centre + self._sum('ball_shift', moment)
        plate_turn = self._sum('plate_turn', moment)
        if isinstance(plate_turn, np.ndarray):
            centre = rotate_z(plate_turn, centre)
        centre = centre + self._sum('plate_shift', moment)
        error = self.table.error(moment.angle, moment.approach)
        centre = rotate_z(moment.angle + self._sum('table_turn', moment), centre)
        centre = rotated(error[..., 3:] + self._sum('table_tilt', moment), centre)
        centre = centre + error[..., :3] + self._sum('table_shift', moment)
        tilt = self._sum('axis_tilt', moment)
        if isinstance(tilt, np.ndarray):
            centre = rotated(tilt, centre)
        return self.true_frame.to_outer(centre) + self._sum('frame_shift', moment)

    def touched(self, moment: Moment, centre: Floats, aim: Floats, direction: Floats, draws: Floats,
                pattern: probing.TouchPattern) -> Floats:
        """Return what the CMM shows of the tip's centre at each touch, without its positioning noise, (N, Q, 3), m.

        The tip touches on its way inwards along lines aim + s u. centre: those of ball_centres; aim: (N, 1, 3), m;
        direction: u, (Q, 3); draws: standard normal numbers (N, Q); pattern: which touches these are. NaN where a line
        misses the ball.
        """
        reach = pattern.radius + pattern.tip
        way = probing.contact(aim, direction, centre, reach)
        if self._acting['surface']:
            outward = (aim + way[..., None] * direction - centre) / reach
            form = sum(act(moment, outward @ pattern.axes, pattern) for act in self._acting['surface'])
            way = probing.contact(aim, direction, centre, reach + form)
        touch = way + self._noise_factor(moment) * (pattern.touch_noise * draws)
        point = aim + touch[..., None] * direction
        return np.asarray(point + self.cmm.error(point) + self._sum('probe_shift', moment))

    def positioning(self, moment: Moment, draws: Floats, pattern: probing.TouchPattern) -> Floats:
        """Return the positioning noise of readings, alike for all touches of one, (N, 3), m; draws: (N, 3)."""
        noise = self._noise_factor(moment) * (pattern.position_noise * draws)
        return np.asarray(np.vecdot(noise[:, None, :], pattern.axes))

    def _noise_factor(self, moment: Moment) -> Floats:
        return math.prod((act(moment) for act in self._acting['noise_factor']), start=np.ones((1, 1)))

    def _probe(self, moment: Moment, aim: Floats, draws: Floats,
               pattern: probing.TouchPattern) -> tuple[Floats, Floats, Floats]:
        """Return the found centres (N, 3), form errors (N,) and touches (N, Q, 3), m."""
        centre, aim = self.ball_centres(moment), aim[:, None, :]
        _refuse_far(moment, centre - aim, 0.5 * (pattern.radius + pattern.tip))
        direction = pattern.direction @ pattern.axes.T
        point = self.touched(moment, centre, aim, direction, draws[:, :pattern.size], pattern)
        found, positioning = fit_spheres(point), self.positioning(moment, draws[:, -3:], pattern)
        return found.centre + positioning, found.form, point + positioning[:, None, :]


def _refuse_far(moment: Moment, off: Floats, reach: float) -> None:
    far = np.sqrt(np.vecdot(off, off)).max(axis=-1)
    if not (far <= reach).all():
        bad = np.flatnonzero(~(far <= reach))
        raise BallNotFound(
            f'table position {moment.table_position[bad[0], 0]}, ball {moment.ball[bad[0], 0]}: expected a ball within '
            f'{1e3 * reach:.3g} mm of the aim, its centre is {1e3 * far[bad[0]]:.4g} mm away; check the frame of the '
            'target and the alignment')


def _true_frame(config: MachineConfig, rough: Frame) -> Frame:
    """Return the frame of the bearing: origin on the axis at the nominal height of the balls."""
    rng = part_generator(config.seed, 'placement')
    off = rng.standard_normal(3)
    off = 1e-3 * config.placement.origin_error_mm * off / np.linalg.norm(off)
    to = rng.uniform(0, TWO_PI)
    tilt = 1e-3 * config.placement.axis_tilt_mrad * np.array([np.cos(to), np.sin(to), 0.0])
    return Frame(rough.rotation @ rotation_matrix(tilt), rough.origin + off)


def _expected_situation(config: MachineConfig, touches: int) -> Situation:
    """Return the situation of a complete run, a ball counted with one step of table or CMM; touches: Q per ball."""
    n, timing = config.plate.balls, config.timing
    pitch = 2e3 * config.radius * np.sin(np.pi / n)
    table = 360.0 / n / timing.table_speed_deg_per_s + timing.table_settle_s
    cmm = pitch / timing.cmm_speed_mm_per_s + timing.cmm_settle_s
    ball_h = (touches * timing.touch_s + max(table, cmm) + 0.8 * timing.jitter_s) / 3600.0
    before = config.hidden_draw.readings_before if config.hidden_draw else None
    before = 2 * n + 10 if before is None else before
    return Situation(balls=n, radius=config.radius, start_h=float(before * ball_h),
                     duration_h=float(n * n * ball_h), sigma_um=config.probing.repeatability_um)


def rotated(vector: Floats, points: Floats) -> Floats:
    """Return points (N, ., 3) rotated by rotation vectors (N, ., 3), rad.

        p' = p + sinc(a) w x p + sinc(a/2)^2 / 2 w x (w x p),  a = |w|,  sinc(a) = sin(a) / a

    Source: Rodrigues' formula, exact down to no rotation at all, without matrices: the live cell measures one ball at a
    time, where the number of array operations is the cost.
    """
    # The sine of the smallest angle is that angle: no rotation needs no case of its own.
    angle = np.maximum(np.sqrt(np.vecdot(vector, vector)), 1e-300)[..., None]
    half = np.sin(0.5 * angle) / (0.5 * angle)
    once = _cross(vector, points)
    return points + (np.sin(angle) / angle) * once + (0.5 * half * half) * _cross(vector, once)


def _cross(one: Floats, other: Floats) -> Floats:
    """Return one x other, (..., 3), as np.cross, which takes five times as long for one vector."""
    return np.asarray(one[..., NEXT] * other[..., LAST] - one[..., LAST] * other[..., NEXT])
