# SPDX-License-Identifier: Apache-2.0
"""Effects of the ball plate: it creeps, slips, grows, warps; its balls move or are not round."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import (
    Effect,
    Quantity,
    Searched,
    Setting,
    between_readings,
    radial,
    seconds,
    tangential,
)
from rosette_ros.core.effects.factored import FactoredEffect


def plate_axes(run):
    """Return unit vectors of the plate's x, y, z in the table frame, (N, 3, 3), last is the axis."""
    out = np.zeros((run.size, 3, 3))
    out[:, :, 0] = radial(run.phi)
    out[:, :, 1] = tangential(run.phi)
    out[:, 2, 2] = 1.0
    return out


@dataclass(frozen=True)
class PlateCreep(Effect):
    """The plate slides steadily on the table: R_z(phi) d t."""

    name: str = 'plate_creep'
    meaning: str = 'The plate slides slowly on the table.'
    look: str = 'Clamps, wax or magnets that hold the plate; forces of cables on the plate.'
    formula: str = 'R_z(phi) d t'
    source: str = 'physics of clamping'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'all'

    def amplitudes(self, run, setting):
        """Return the rates in the plate's frame."""
        return tuple(Quantity(f'd_{axis}', 'm/s', f'creep rate along the plate\'s {axis}')
                     for axis in 'xy')

    def columns(self, run, setting):
        """Return R_z(phi) t per axis of the plate, (N, 3, 2), s."""
        return seconds(run)[:, None, None] * plate_axes(run)[..., :2]


@dataclass(frozen=True)
class PlateSlip(FactoredEffect):
    """At one moment the plate slipped: R_z(phi) d H(t - t0) and a turn about z."""

    name: str = 'plate_slip'
    meaning: str = 'At one moment the whole plate slipped on the table.'
    look: str = 'Clamps; a collision with the plate; acceleration of the table.'
    formula: str = '(R_z(phi) d + gamma R e_t) H(t - t0)'
    source: str = 'physics of clamping'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'nothing'
    searched: tuple[Searched, ...] = (
        Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'),)

    def settings(self, run):
        """Try moments between readings."""
        return tuple(Setting(t0=float(t0)) for t0 in between_readings(run))

    def independent_settings(self, run):
        """Neighbouring moments look alike."""
        return max(1, min(run.size, 200) // 4)

    def amplitudes(self, run, setting):
        """Return shift and turn."""
        return (Quantity('d_x', 'm', "shift along the plate's x"),
                Quantity('d_y', 'm', "shift along the plate's y"),
                Quantity('gamma', 'rad', 'turn about z'))

    def directions(self, run):
        """Return shifts along the plate's x and y and a turn about z, (3, N, 3)."""
        turn = run.radius * tangential(run.alpha)[None]
        return np.concatenate([np.moveaxis(plate_axes(run)[..., :2], -1, 0), turn])

    def which(self, setting):
        """Return all three."""
        return 0, 1, 2

    def scalars(self, run, values):
        """Return H(t - t0)."""
        return (seconds(run) > values)[:, None].astype(float)


@dataclass(frozen=True)
class PlateExpansion(Effect):
    """The plate grows: epsilon R e_r with time or with temperature."""

    name: str = 'plate_expansion'
    meaning: str = 'The plate grows or shrinks.'
    look: str = 'Temperature of the plate: handling, lamps, soaking time, warm table top.'
    formula: str = 'epsilon R e_r (t or T - T0)'
    source: str = 'ISO 1 and ISO 10360 (thermal expansion)'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'all'
    searched: tuple[Searched, ...] = (Searched('driver', '', 'what it grows with'),)

    def settings(self, run):
        """Try time and, where it was recorded and changes, temperature."""
        drivers = ['time']
        if np.all(np.isfinite(run.temperature)) and np.ptp(run.temperature) > 0:
            drivers.append('temperature')
        return tuple(Setting(driver=driver) for driver in drivers)

    def amplitudes(self, run, setting):
        """Return the relative growth per second or per kelvin."""
        unit = {'time': '1/s', 'temperature': '1/K'}[setting['driver']]
        return (Quantity('epsilon', unit, 'relative growth'),)

    def columns(self, run, setting):
        """Return R e_r times time or temperature, (N, 3, 1)."""
        driver = {'time': seconds(run), 'temperature': run.temperature - run.temperature[0]}
        return (run.radius * driver[setting['driver']][:, None] * radial(run.alpha))[..., None]


@dataclass(frozen=True)
class PlateWarp(Effect):
    """The plate warps like a saddle: z = (a cos m beta + b sin m beta) t, m = 2 or 3."""

    name: str = 'plate_warp'
    meaning: str = 'The plate bends like a saddle as time goes by.'
    look: str = 'Uneven temperature of the plate, over-tight clamps, stress in the material.'
    formula: str = '(a cos(m beta) + b sin(m beta)) t along z'
    source: str = 'physics of plates'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'all'
    searched: tuple[Searched, ...] = (Searched('order', '1', 'waves around the plate'),)

    def settings(self, run):
        """Try saddles of two and three waves."""
        return tuple(Setting(order=order) for order in (2, 3))

    def amplitudes(self, run, setting):
        """Return the rates."""
        return (Quantity('a', 'm/s', 'cosine rate'), Quantity('b', 'm/s', 'sine rate'))

    def columns(self, run, setting):
        """Return t cos and t sin along z, (N, 3, 2), s."""
        angle = setting['order'] * run.beta
        out = np.zeros((run.size, 3, 2))
        out[:, 2, 0], out[:, 2, 1] = seconds(run) * np.cos(angle), seconds(run) * np.sin(angle)
        return out


@dataclass(frozen=True)
class BallSlip(Effect):
    """One ball moved on the plate at t0: R_z(phi) d H(t - t0) for ball j alone."""

    name: str = 'ball_slip'
    meaning: str = 'One ball moved on the plate at one moment.'
    look: str = 'The joint of that ball: glue, thread, magnet; a collision of the stylus.'
    formula: str = 'R_z(phi) d H(t - t0) for one ball'
    source: str = 'physics of the artefact'
    depends_on: tuple[str, ...] = ('time',)
    carries: str = 'nothing'
    searched: tuple[Searched, ...] = (
        Searched('ball', '1', 'number of the ball'),
        Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'))

    def settings(self, run):
        """Try every ball, at moments between its own readings."""
        time = seconds(run)
        settings = []
        for ball in range(1, run.n + 1):
            own = np.unique(time[run.ball == ball])
            middle = 0.5 * (own[1:] + own[:-1])
            if middle.size > 40:
                middle = middle[np.linspace(0, middle.size - 1, 40).round().astype(int)]
            settings += [Setting(ball=ball, t0=float(t0)) for t0 in middle]
        return tuple(settings)

    def instants(self, run, setting):
        """Return the instants between that ball's readings around a setting."""
        own = np.unique(seconds(run)[run.ball == setting['ball']])
        middle = 0.5 * (own[1:] + own[:-1])
        near = np.argsort(np.abs(middle - setting['t0']))[:5]
        return middle[near] if middle.size > 40 else np.zeros(0)

    def independent_settings(self, run):
        """Neighbouring moments of one ball look alike."""
        return max(1, run.n * min(run.n, 40) // 2)

    def amplitudes(self, run, setting):
        """Return the shift in the plate's frame."""
        return tuple(Quantity(f'd_{axis}', 'm', f"shift along the plate's {axis}")
                     for axis in 'xyz')

    def columns(self, run, setting):
        """Return the shift of that ball after t0, (N, 3, 3)."""
        return np.moveaxis(self.blocks(run, [setting])[0], 0, -1)

    def blocks(self, run, settings):
        """Return the shifts of many balls and moments, (b, 3, N, 3)."""
        ball = np.array([setting['ball'] for setting in settings])[:, None]
        t0 = np.array([setting['t0'] for setting in settings])[:, None]
        moved = (run.ball == ball) & (seconds(run) > t0)
        return moved[:, None, :, None] * np.moveaxis(plate_axes(run), -1, 0)


@dataclass(frozen=True)
class BallForm(Effect):
    """A ball is not round: its form is seen from a turning side, harmonics m = 2..5 of phi."""

    name: str = 'ball_form'
    meaning: str = 'A ball is not round, so its centre seems to move as the table turns it.'
    look: str = 'Grade and damage of the ball, dirt on it, number and place of the touches.'
    formula: str = 'a (cos(m phi + psi), -sin(m phi + psi)) in x, y and c cos(m phi + psi_z) in z'
    source: str = 'Kniel et al. (2019), section 2.1: the form must be as accurate as possible'
    depends_on: tuple[str, ...] = ()
    carries: str = 'all'
    searched: tuple[Searched, ...] = (
        Searched('ball', '1', 'number of the ball, 0 for all balls'),
        Searched('harmonic', '1', 'm, waves per turn, 0 for m = 2 to 5 together'),
        Searched('part', '', 'which part: in the plane (xy), along z, or both'))

    def settings(self, run):
        """Try each ball with each harmonic and with all, then all balls with each harmonic."""
        harmonics = [m for m in (2, 3, 4, 5) if m < run.n]
        one = [Setting(ball=ball, harmonic=m, part='both')
               for ball in range(1, run.n + 1) for m in [*harmonics, 0]]
        return tuple(one + [Setting(ball=0, harmonic=m, part=part) for m in harmonics
                            for part in ('both', 'xy', 'z')])

    def independent_settings(self, run):
        """Each ball is a chance for each harmonic."""
        return 5 * run.n

    def _kept(self, setting):
        return {'both': slice(0, 4), 'xy': slice(0, 2), 'z': slice(2, 4)}[setting.get('part', 'both')]

    def _pairs(self, run, setting):
        balls = [setting['ball']] if setting['ball'] else range(1, run.n + 1)
        harmonics = [setting['harmonic']] if setting['harmonic'] else [
            m for m in (2, 3, 4, 5) if m < run.n]
        return [(ball, m) for ball in balls for m in harmonics]

    def amplitudes(self, run, setting):
        """Return cosine and sine amplitudes, in the plane and along z, for each ball and m."""
        return tuple(
            Quantity(f'{name}_{ball}_{m}', 'm', f'{what} of ball {ball}, m = {m}')
            for ball, m in self._pairs(run, setting)
            for name, what in (('a', 'cosine in the plane'), ('b', 'sine in the plane'),
                               ('az', 'cosine along z'), ('bz', 'sine along z'))[self._kept(setting)])

    def width(self, run, setting):
        """Return the number of amplitudes."""
        kept = self._kept(setting)
        return len(self._pairs(run, setting)) * (kept.stop - kept.start)

    def columns(self, run, setting):
        """Return the apparent shift per amplitude, (N, 3, q)."""
        pairs = self._pairs(run, setting)
        out = np.zeros((run.size, 3, len(pairs), 4))
        for place, (ball, m) in enumerate(pairs):
            own = run.ball == ball
            c, s = np.cos(m * run.phi[own]), np.sin(m * run.phi[own])
            out[own, 0, place, 0], out[own, 1, place, 0] = c, -s
            out[own, 0, place, 1], out[own, 1, place, 1] = -s, -c
            out[own, 2, place, 2], out[own, 2, place, 3] = c, s
        return out[..., self._kept(setting)].reshape(run.size, 3, -1)


PLATE_EFFECTS = (PlateCreep(), PlateSlip(), PlateExpansion(), PlateWarp(), BallSlip(), BallForm())
