# SPDX-License-Identifier: Apache-2.0
"""Effects of the ball plate: it creeps, slips, grows, warps; its balls move or are not round."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import Effect, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.factored_effect import FactoredEffect, Step
from rosette_ros.core.effects.run_functions import plate_axes, seconds
from rosette_ros.core.records import Floats, Run


class PlateCreep(Effect):
    name = 'plate_creep'
    plain = 'creep of the plate'
    meaning = 'The plate slides slowly on the table.'
    look = 'Clamps, wax or magnets that hold the plate; forces of cables on the plate.'
    formula = 'R_z(phi) d t'
    source = 'physics of clamping'
    depends_on = ('time',)
    quantities = per_axis('xy', Quantity('d', 'm/s', "creep rate along the plate's"))
    carries = 'all'

    def columns(self, run: Run, setting: Setting) -> Floats:
        return seconds(run)[:, None, None] * plate_axes(run)[..., :2]


class PlateSlip(FactoredEffect):
    name = 'plate_slip'
    plain = 'slip of the plate'
    meaning = 'At one moment the whole plate slipped on the table.'
    look = 'Clamps; a collision with the plate; acceleration of the table.'
    formula = '(R_z(phi) d + gamma R e_t) H(t - t0)'
    source = 'physics of clamping'
    depends_on = ('time',)
    quantities = (*per_axis('xy', Quantity('d', 'm', "shift along the plate's")),
                  Quantity('gamma', 'rad', 'turn about z'))
    carries = 'nothing'
    searched = (Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'),)
    function = Step()

    def directions(self, run: Run) -> Floats:
        """Return shifts along the plate's x and y and a turn about z, (3, N, 3)."""
        turn = run.radius * on.tangential(run.alpha)[None]
        return np.concatenate([np.moveaxis(plate_axes(run)[..., :2], -1, 0), turn])

    def which(self, setting: Setting) -> tuple[int, ...]:
        return 0, 1, 2


class PlateExpansion(Effect):
    name = 'plate_expansion'
    plain = 'expansion of the plate'
    meaning = 'The plate grows or shrinks.'
    look = 'Temperature of the plate: handling, lamps, soaking time, warm table top.'
    formula = 'epsilon R e_r (t or T - T0)'
    source = 'ISO 1 and ISO 10360 (thermal expansion)'
    depends_on = ('time',)
    carries = 'all'
    searched = (Searched('driver', '', 'what it grows with'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try time and, where it was recorded and changes, temperature."""
        changes = np.all(np.isfinite(run.temperature)) and np.ptp(run.temperature) > 0
        return grid(driver=('time', 'temperature') if changes else ('time',))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        unit = {'time': '1/s', 'temperature': '1/K'}[setting.word('driver')]
        return (Quantity('epsilon', unit, 'relative growth'),)

    def columns(self, run: Run, setting: Setting) -> Floats:
        driver = {'time': seconds, 'temperature': on.temperature_change}[setting.word('driver')](run)
        return (run.radius * driver[:, None] * on.radial(run.alpha))[..., None]


class PlateWarp(Effect):
    name = 'plate_warp'
    plain = 'warping of the plate'
    meaning = 'The plate warps into a saddle with time.'
    look = 'Uneven temperature of the plate, over-tight clamps, stress in the material.'
    formula = '(a cos(m beta) + b sin(m beta)) t along z'
    source = 'physics of plates'
    depends_on = ('time',)
    quantities = (Quantity('a', 'm/s', 'cosine rate'), Quantity('b', 'm/s', 'sine rate'))
    carries = 'all'
    searched = (Searched('order', '1', 'waves around the plate'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try saddles of two and three waves."""
        return grid(order=(2, 3))

    def columns(self, run: Run, setting: Setting) -> Floats:
        angle = setting.number('order') * run.beta
        out = np.zeros((run.size, 3, 2))
        out[:, 2, 0], out[:, 2, 1] = seconds(run) * np.cos(angle), seconds(run) * np.sin(angle)
        return out


class BallSlip(Effect):
    name = 'ball_slip'
    plain = 'slip of one ball'
    meaning = 'At one moment one ball moved on the plate.'
    look = 'The joint of that ball: glue, thread, magnet; a collision of the stylus.'
    formula = 'R_z(phi) d H(t - t0) for one ball'
    source = 'physics of the artefact'
    depends_on = ('time',)
    quantities = per_axis('xyz', Quantity('d', 'm', "shift along the plate's"))
    carries = 'nothing'
    searched = (Searched('ball', '1', 'number of the ball'),
                Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try every ball, at moments between its own readings."""
        time = seconds(run)
        return tuple(Setting(ball=ball, t0=float(t0)) for ball in range(1, run.n + 1)
                     for t0 in on.thinned(on.midway(time[run.ball == ball]), 40))

    def instants(self, run: Run, setting: Setting) -> Floats:
        """Return the instants between that ball's readings around a setting."""
        middle = on.midway(seconds(run)[run.ball == setting.whole('ball')])
        near = np.argsort(np.abs(middle - setting.number('t0')))[:5]
        beside: Floats = middle[near]
        return beside if middle.size > 40 else np.zeros(0)

    def independent_settings(self, run: Run) -> int:
        """Neighbouring moments of one ball look alike."""
        return max(1, run.n * min(run.n, 40) // 2)

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the shifts of many balls and moments, (b, 3, N, 3)."""
        ball = np.array([setting.whole('ball') for setting in settings])[:, None]
        t0 = np.array([setting.number('t0') for setting in settings])[:, None]
        moved = (run.ball == ball) & (seconds(run) > t0)
        return np.asarray(moved[:, None, :, None] * np.moveaxis(plate_axes(run), -1, 0))


class BallForm(Effect):
    name = 'ball_form'
    plain = 'form deviation of the balls'
    meaning = 'A ball is not round, so its measured centre moves as the table turns it.'
    look = 'Grade and damage of the ball, dirt on it, number and place of the touches.'
    formula = 'a (cos(m phi + psi), -sin(m phi + psi)) in x, y and c cos(m phi + psi_z) in z'
    source = 'Kniel et al. (2019), section 2.1: the form must be as accurate as possible'
    carries = 'all'
    searched = (Searched('ball', '1', 'number of the ball, 0 for all balls'),
                Searched('harmonic', '1', 'm, waves per turn, 0 for m = 2 to 5 together'),
                Searched('part', '', 'which part: in the plane (xy), along z, or both'))
    quantities: tuple[Quantity, ...] = (
        Quantity('a', 'm', 'cosine in the plane'), Quantity('b', 'm', 'sine in the plane'),
        Quantity('az', 'm', 'cosine along z'), Quantity('bz', 'm', 'sine along z'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try each ball with each harmonic and with all, then all balls with each harmonic."""
        harmonics = self._harmonics(run)
        return (*grid(ball=range(1, run.n + 1), harmonic=[*harmonics, 0], part=('both',)),
                *grid(ball=(0,), harmonic=harmonics, part=('both', 'xy', 'z')))

    def independent_settings(self, run: Run) -> int:
        """Each ball is a chance for each harmonic."""
        return 5 * run.n

    def _harmonics(self, run: Run) -> list[int]:
        return [m for m in (2, 3, 4, 5) if m < run.n]

    def _kept(self, setting: Setting) -> 'slice[int, int, None]':
        return {'both': slice(0, 4), 'xy': slice(0, 2), 'z': slice(2, 4)}[setting.word('part', 'both')]

    def _pairs(self, run: Run, setting: Setting) -> list[tuple[int, int]]:
        ball, harmonic = setting.whole('ball'), setting.whole('harmonic')
        balls, orders = [ball] if ball else range(1, run.n + 1), [harmonic] if harmonic else self._harmonics(run)
        return [(one, m) for one in balls for m in orders]

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        """Return cosine and sine amplitudes, in the plane and along z, for each ball and m."""
        return tuple(Quantity(f'{part.name}_{ball}_{m}', 'm', f'{part.meaning} of ball {ball}, m = {m}')
                     for ball, m in self._pairs(run, setting) for part in self.quantities[self._kept(setting)])

    def width(self, run: Run, setting: Setting) -> int:
        return len(self._pairs(run, setting)) * len(range(4)[self._kept(setting)])

    def columns(self, run: Run, setting: Setting) -> Floats:
        pairs = self._pairs(run, setting)
        out = np.zeros((run.size, 3, len(pairs), 4))
        for place, (ball, m) in enumerate(pairs):
            own = run.ball == ball
            c, s = np.cos(m * run.phi[own]), np.sin(m * run.phi[own])
            out[own, 0, place, 0], out[own, 1, place, 0] = c, -s
            out[own, 0, place, 1], out[own, 1, place, 1] = -s, -c
            out[own, 2, place, 2], out[own, 2, place, 3] = c, s
        return out[..., self._kept(setting)].reshape(run.size, 3, -1)
