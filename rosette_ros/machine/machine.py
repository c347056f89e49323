# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: a table, a plate, a CMM and what they hide, reading after reading.

A ball in the plate's frame is carried through exact rigid bodies: clamped plate, turning table
with its error motions, tilted axis, machine frame. Each of its touches is made at its own time on
a real sphere, the CMM adds its errors, and the least-squares sphere gives the centre.
"""

import numpy as np

from rosette_ros.core.alignment import table_frame
from rosette_ros.core.errors import InvalidPlan
from rosette_ros.core.geometry import TWO_PI, Frame, nominal_angles, rotation_matrix
from rosette_ros.core.records import Run
from rosette_ros.machine.climate import build_climate
from rosette_ros.machine.cmm import build_cmm
from rosette_ros.machine.hidden import acting, draw_hidden
from rosette_ros.machine.moment import Moment
from rosette_ros.machine.motion import State, travel, travel_angle
from rosette_ros.machine.plate import build_plate, nominal_balls
from rosette_ros.machine.probing import build_pattern, contact, fit_spheres, noise_sizes
from rosette_ros.machine.readings import Alignment, BallNotFound, Readings
from rosette_ros.machine.rigid import spun, turned
from rosette_ros.machine.situation import expected_situation
from rosette_ros.machine.streams import part_generator, standard_normal
from rosette_ros.machine.table import build_table
from rosette_ros.machine.truth import cmm_deviations, plate_deviations, table_curves

_REACH_SHARE = 0.5
"""A ball whose centre is farther from the aim than this share of its radius is not found."""


class Machine:
    """A cell that measures balls and keeps its state from reading to reading.

    config: MachineConfig; state: where an earlier machine of the same configuration stood, to go
    on from there (default: just switched on, ball 1 under the probe).
    """

    def __init__(self, config, state=None):
        """Build the parts of the cell from their seeds."""
        self.config = config
        self.n = config.plate.balls
        self.radius = config.radius
        rough = 1e-3 * np.array(config.placement.origin_mm)
        self.rough_frame = Frame(np.eye(3), rough)
        self.true_frame = _true_frame(config, rough)
        self.table = build_table(config.table, config.seed)
        self.plate = build_plate(config.plate, config.clamping, config.seed)
        self.cmm = build_cmm(config.cmm, rough, config.seed)
        self.climate = build_climate(config.climate, config.seed)
        self.pattern = build_pattern(config.probing, 1e-3 * config.plate.ball_radius_mm)
        self.noise = noise_sizes(config.probing, self.pattern)
        self.hidden = config.hidden
        if config.hidden_draw is not None:
            situation = expected_situation(config, self.pattern.size)
            self.hidden = self.hidden + draw_hidden(config.hidden_draw, situation)
        self._acting = acting(self.hidden)
        self._angles = nominal_angles(self.n)
        self._nominal = nominal_balls(self.n, self.radius)
        self.state = state or State(0.0, 0, 0, 0, 0.0, self.rough_frame.to_outer(self._nominal[0]),
                                    np.zeros(3), 0)

    @property
    def time(self):
        """Simulated time since power-on, at the end of the last reading, s."""
        return self.state.time

    def measure(self, table_position, ball, approach=1, aim=None, short=0.0):
        """Measure one ball now and return its Reading; the machine's time goes on.

        table_position, ball: one-based; approach: sense in which the table turns to get there, +1
        or -1, 0 is taken as +1; aim: (3,) where the ball is expected, machine frame, m (default:
        the nominal place by the roughly known origin); short: angle by which the table, if it moves,
        stops before its place, rad.

        Raises InvalidPlan for indices out of range and BallNotFound where the aim is off; then
        the state stays as it was.
        """
        return self.measure_many([table_position], [ball], [approach],
                                 None if aim is None else np.asarray(aim, dtype=float)[None, :],
                                 short)[0]

    def measure_many(self, table_position, ball, approach, aim=None, short=0.0):
        """Measure N balls in order and return Readings, equal to N calls of `measure` bit by bit.

        table_position, ball, approach: (N,); aim: (N, 3) machine frame, m; short: as `measure`. Raises
        as `measure`.
        """
        table_position = self._checked(table_position, 'table position')
        ball = self._checked(ball, 'ball')
        if aim is None:
            aim = self.rough_frame.to_outer(
                self._nominal[(table_position + ball - 2) % self.n])
        draws = standard_normal(self.config.seed, self.state.readings + np.arange(ball.size),
                                self.pattern.size + 6)
        timing = self.config.timing
        journey = travel(
            self.state, timing, self.n, table_position, np.asarray(approach), np.asarray(aim),
            wait=timing.jitter_s * np.abs(draws[:, -6]),
            stop=1e-6 * self.config.table.positioning_urad * draws[:, -5]
            - short * np.where(np.asarray(approach) < 0, -1, 1),
            touches=self.pattern.size,
            deadband=1e-3 * self.config.cmm.reversal_deadband_mm)
        moment = self._moment(journey, table_position, ball)
        centre, form = self._probe(moment, journey.cmm, draws)
        self.state = journey.last_state(self.state)
        sensor = self.config.climate.sensor_K * draws[:, -4]
        return Readings(
            table_position=table_position, ball=ball, time=moment.time.sum(-1) / self.pattern.size,
            began=journey.began, ended=journey.ended, table_angle=moment.angle[:, 0] % TWO_PI,
            table_travel=moment.travel[:, 0], approach=journey.approach, centre=centre,
            form_error=form, temperature=self.climate.start + moment.warming[:, -1] + sensor)

    def align(self, repeats=10):
        """Measure what precedes a run and return the Alignment found.

        Ball 1 is measured `repeats` times at table position 1, then at every table position (the
        axis), then every ball at table position 1 (the plane).
        """
        one, every = np.ones(self.n, dtype=int), np.arange(1, self.n + 1)
        sigma, dof = self._repeat(repeats)
        axis = self.measure_many(every, one, one)
        plane = self.measure_many(one, every, one)
        return Alignment(table_frame(axis.centre, plane.centre), sigma, dof)

    def run(self, scheme, repeats=10, align=True, run_id=''):
        """Measure a whole Scheme and return its Run, as the cell would after its alignment.

        Times count from the first reading of the run. repeats: readings of the repeatability
        check, fewer than two leave the Run without repeatability; align: whether the table frame
        is found by measuring, else it is the true one.

        Raises InvalidPlan where the scheme is for another number of balls.
        """
        return self.calibrate(scheme, repeats, align, run_id)[0]

    def calibrate(self, scheme, repeats=10, align=True, run_id=''):
        """Return what `run` returns, the Alignment, and the Readings in the machine frame."""
        if scheme.n != self.n:
            raise InvalidPlan(f'scheme: wanted one for the {self.n} balls of this plate, '
                              f'got one for {scheme.n}')
        alignment = (self.align(repeats) if align
                     else Alignment(self.true_frame, *self._repeat(repeats)))
        aim = alignment.frame.to_outer(scheme.centres(self.radius))
        readings = self.measure_many(scheme.table_position, scheme.ball, scheme.approach, aim)
        run = Run(
            n=self.n, radius=self.radius, table_position=readings.table_position,
            ball=readings.ball, centre=alignment.frame.to_inner(readings.centre),
            table_angle=readings.table_angle, time=readings.time - readings.time[0],
            temperature=readings.temperature, approach=readings.approach,
            table_travel=readings.table_travel, repeatability=alignment.repeatability,
            repeatability_dof=alignment.dof, run_id=run_id)
        return run, alignment, readings

    def table_truth(self, angle=None, frame=None):
        """Return the true six curves, repeatable errors only, (m, 6), m and rad.

        angle: (m,) rad (default: the n nominal angles); frame: the table frame they are wanted in
        (default: the true one). Order and signs as in core.records.ErrorMotions; compare with
        results after `remove_gauge`.
        """
        angle = self._angles if angle is None else np.asarray(angle, dtype=float)
        return table_curves(self.table.error(angle), angle, self.true_frame,
                            frame or self.true_frame)

    def maker_table(self, angle=None):
        """Return the correction tables of the maker, zero where there is none, (m, 6)."""
        return self.table.maker(self._angles if angle is None else angle)

    def plate_truth(self, frame=None):
        """Return the true plate deviations P_j in a table frame, clamping included, (n, 3), m."""
        on_table = self.plate.on_table(np.arange(1, self.n + 1))
        return plate_deviations(on_table, self._nominal, self.true_frame,
                                frame or self.true_frame)

    def cmm_truth(self, frame=None):
        """Return the true CMM deviations M_k in a table frame, (n, 3), m."""
        return cmm_deviations(self.cmm, self._nominal, frame or self.true_frame)

    def _repeat(self, repeats):
        """Return sigma and degrees of freedom of `repeats` readings of ball 1, or None twice."""
        if repeats < 1:
            return None, None
        one = np.ones(repeats, dtype=int)
        centre = self.measure_many(one, one, one).centre
        if repeats < 2 or self.config.probing.repeatability_um == 0:
            return None, None
        dof = 3 * (repeats - 1)
        return float(np.sqrt(((centre - centre.mean(axis=0))**2).sum() / dof)), dof

    def _checked(self, index, what):
        index = np.asarray(index)
        bad = (index < 1) | (index > self.n)
        if bad.any():
            raise InvalidPlan(f'{what}: wanted 1..{self.n}, got {index[bad][0]}')
        return index.astype(np.int64)

    def _moment(self, journey, table_position, ball):
        """Return the Moment of all touches of a Journey."""
        touch = self.config.timing.touch_s * np.arange(1, self.pattern.size + 1)
        time = journey.arrived[:, None] + touch
        angle = travel_angle(journey.steps, self.n, journey.stop)[:, None]
        return Moment(
            balls=self.n, radius=self.radius, time=time, began=journey.began[:, None],
            ended=journey.ended[:, None], warming=self.climate.warming(time),
            table_position=table_position[:, None], ball=ball[:, None],
            angle=self._angles[table_position - 1][:, None] + journey.stop[:, None],
            travel=angle, turned=journey.turned[:, None] * (TWO_PI / self.n),
            approach=journey.approach[:, None], cmm_sense=journey.cmm_sense[:, None, :])

    def _sum(self, hook, moment):
        """Return the sum of one hook over the hidden effects that use it; 0.0 where none does."""
        hooks = self._acting[hook]
        return sum([act(moment) for act in hooks]) if hooks else 0.0

    def ball_centres(self, moment):
        """Return the true ball centres in the machine frame, (N, 1 or Q, 3), m."""
        centre = self.plate.on_table(moment.ball, self._sum('plate_growth', moment))
        centre = centre + self._sum('ball_shift', moment)
        plate_turn = self._sum('plate_turn', moment)
        if np.ndim(plate_turn):
            centre = spun(plate_turn, centre)
        centre = centre + self._sum('plate_shift', moment)
        error = self.table.error(moment.angle)
        centre = spun(moment.angle + self._sum('table_turn', moment), centre)
        centre = turned(error[..., 3:] + self._sum('table_tilt', moment), centre)
        centre = centre + error[..., :3] + self._sum('table_shift', moment)
        tilt = self._sum('axis_tilt', moment)
        if np.ndim(tilt):
            centre = turned(tilt, centre)
        return self.true_frame.to_outer(centre) + self._sum('frame_shift', moment)

    def _probe(self, moment, aim, draws):
        """Return the found centres (N, 3) and form errors (N,), m."""
        centre, aim = self.ball_centres(moment), aim[:, None, :]
        pattern, reach = self.pattern, self.pattern.radius + self.pattern.tip
        _refuse_far(moment, centre - aim, _REACH_SHARE * reach)
        direction = pattern.direction
        way = contact(aim, direction, centre, reach)
        if self._acting['surface']:
            outward = (aim + way[..., None] * direction - centre) / reach
            form = sum(act(moment, outward, pattern) for act in self._acting['surface'])
            way = contact(aim, direction, centre, reach + form)
        factor = np.ones((1, 1))
        for act in self._acting['noise_factor']:
            factor = factor * act(moment)
        touch = way + factor * (self.noise.touch * draws[:, :pattern.size])
        point = aim + touch[..., None] * direction
        point = point + self.cmm.error(point) + self._sum('probe_shift', moment)
        found, form = fit_spheres(point)
        return found + factor * (self.noise.position * draws[:, -3:]), form


def _refuse_far(moment, off, reach):
    far = np.sqrt(np.vecdot(off, off)).max(axis=-1)
    if not (far <= reach).all():
        bad = np.flatnonzero(~(far <= reach))
        raise BallNotFound(
            f'table position {moment.table_position[bad[0], 0]}, ball {moment.ball[bad[0], 0]}: '
            f'wanted a ball within {1e3 * reach:.3g} mm of the aim, its centre is '
            f'{1e3 * far[bad[0]]:.4g} mm away; check the frame of the target and the alignment')


def _true_frame(config, rough):
    """Return the frame of the bearing: origin on the axis at the nominal height of the balls."""
    rng = part_generator(config.seed, 'placement')
    off = rng.standard_normal(3)
    off = 1e-3 * config.placement.origin_error_mm * off / np.linalg.norm(off)
    to = rng.uniform(0, TWO_PI)
    tilt = 1e-3 * config.placement.axis_tilt_mrad * np.array([np.cos(to), np.sin(to), 0.0])
    return Frame(rotation_matrix(tilt), rough + off)
