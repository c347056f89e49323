# SPDX-License-Identifier: Apache-2.0
"""Effects of single balls: they slip, creep, change seats, stand off or are not round."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import Bracket, Effect, Factors, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.run_functions import duration, plate_axes, seconds
from rosette_ros.core.records import Floats, Run


class _BallMotion(Effect, ABC):
    """An effect that moves one ball on the plate, by a function of the reading along each axis of the plate."""

    depends_on = ('time',)
    carries = 'nothing'
    repeatable = True
    source = 'physics of the artefact'

    @abstractmethod
    def courses(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the function of many settings at each reading, (b, N)."""

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return np.asarray(self.courses(run, settings)[:, None, :, None] * np.moveaxis(plate_axes(run), -1, 0))

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        return [Factors(settings, self.courses(run, settings)[:, None] * 1.0, np.moveaxis(plate_axes(run), -1, 0),
                        tuple((place, (0, 1, 2)) for place in range(len(settings))))]


class BallSlip(_BallMotion):
    name = 'ball_slip'
    plain = 'slip of one ball'
    meaning = 'At one moment one ball moved on the plate.'
    look = 'The joint of that ball: glue, thread, magnet; a collision of the stylus.'
    formula = 'R_z(phi) d H(t - t0) for one ball'
    quantities = per_axis('xyz', Quantity('d', 'm', "shift along the plate's"))
    searched = (Searched('ball', '1', 'number of the ball'),
                Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try every ball, at moments between its own readings."""
        time = seconds(run)
        return tuple(Setting(ball=ball, t0=float(t0)) for ball in run.balls
                     for t0 in on.thinned(on.midway(time[run.ball == ball]), 40))

    def chances(self, run: Run, settings: Sequence[Setting]) -> list[float]:
        """A move before the last reading of a ball or after its first one is told apart from an outlier by nothing."""
        time = {ball: seconds(run)[run.ball == ball] for ball in range(1, run.n + 1)}
        own = [time[setting.whole('ball')] for setting in settings]
        after = [np.count_nonzero(one > setting.number('t0')) for one, setting in zip(own, settings)]
        usual = self.independent_settings(run)
        return [usual if 1 < number < one.size - 1 else 6 * run.size for number, one in zip(after, own)]

    def instants(self, run: Run, setting: Setting, name: str = 't0') -> Floats:
        """Return the instants between that ball's readings around a setting."""
        middle = on.midway(seconds(run)[run.ball == setting.whole('ball')])
        return on.beside(middle, setting.number(name), 1.5 * middle.size / 40)

    def independent_settings(self, run: Run) -> int:
        """Neighbouring moments of one ball look alike."""
        return max(1, len(run.balls) * min(run.n, 40) // 2)

    def courses(self, run: Run, settings: Sequence[Setting]) -> Floats:
        ball = np.array([setting.whole('ball') for setting in settings])[:, None]
        t0 = np.array([setting.number('t0') for setting in settings])[:, None]
        return np.asarray((run.ball == ball) & (seconds(run) > t0))


class BallCreep(_BallMotion):
    name = 'ball_creep'
    plain = 'creep of one ball'
    meaning = 'One ball moves gradually on the plate, steadily or ever more slowly.'
    look = 'The joint of that ball: glue that creeps, a thread or magnet that settles; heat of a hand.'
    formula = 'R_z(phi) d (1 - exp(-(t - t0)/tau)) for one ball from t0 on, d reached at the end of the run'
    quantities = per_axis('xyz', Quantity('d', 'm', "displacement at the end of the run along the plate's"))
    searched = (Searched('ball', '1', 'number of the ball'),
                Searched('t0', 's', 'moment at which it begins, since the first reading', 'phase'),
                Searched('tau', 's', 'time constant; steady where it exceeds the run', 'scale'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try every ball, from five moments on, from steps to steady creep."""
        end = duration(run)
        return grid(ball=run.balls, t0=(0.0, *(end * np.arange(1, 5) / 6).tolist()),
                    tau=(end * np.array([0.05, 0.15, 0.45, 5.0])).tolist())

    def independent_settings(self, run: Run) -> int:
        """Neighbouring moments and time constants look alike."""
        return 16 * len(run.balls)

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        t0, tau, end = setting.number('t0'), setting.number('tau'), duration(run)
        return {'t0': (max(t0 - end / 6, 0.0), t0 + end / 6), 'tau': (tau / 3, min(3 * tau, 5 * end))}

    def courses(self, run: Run, settings: Sequence[Setting]) -> Floats:
        ball, t0, tau = (np.array([setting.number(name) for setting in settings])[:, None]
                         for name in ('ball', 't0', 'tau'))
        since = np.maximum(seconds(run) - t0, 0)
        course = np.expm1(-since / tau) / np.expm1(-np.maximum(since[:, -1:], 1e-9) / tau)
        return np.asarray(course * (run.ball == ball))


class BallRattle(_BallMotion):
    name = 'ball_rattle'
    plain = 'one ball between two seats'
    meaning = 'One ball changes between two seats: it moved and came back, or sits by the sense of the last table move.'
    look = 'The joint of that ball: a loose thread, a magnet with dirt under it, cracked glue.'
    formula = 'R_z(phi) d for one ball between t0 and t1, or 1/2 R_z(phi) d approach'
    quantities = per_axis('xyz', Quantity('d', 'm', "distance of the seats along the plate's"))
    searched = (Searched('ball', '1', 'number of the ball'), Searched('motion', '', 'there and back, or by sense'),
                Searched('t0', 's', 'moment at which it moved, since the first reading', 'instant'),
                Searched('t1', 's', 'moment at which it came back', 'instant'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try every ball: two or more readings apart, and by the sense of the table where it is known and changes."""
        sense = np.ptp(run.approach) > 0
        out = []
        for ball in run.balls:
            middle = on.thinned(on.midway(seconds(run)[run.ball == ball]), 14)
            out += [Setting(ball=ball, motion='pulse', t0=float(t0), t1=float(t1)) for place, t0 in enumerate(middle)
                    for t1 in middle[place + 2:]]
            out += [Setting(ball=ball, motion='sense')] if sense else []
        return tuple(out)

    def independent_settings(self, run: Run) -> int:
        return len(run.balls) * min(run.n, 14)**2 // 4

    def chances(self, run: Run, settings: Sequence[Setting]) -> list[float]:
        usual = self.independent_settings(run)
        return [len(run.balls) if setting.word('motion') == 'sense' else usual for setting in settings]

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        if setting.word('motion') == 'sense':
            return {}
        middle = on.midway(seconds(run)[run.ball == setting.whole('ball')])
        return {name: on.beside(middle, setting.number(name), 1.5 * middle.size / 14) for name in ('t0', 't1')}

    def courses(self, run: Run, settings: Sequence[Setting]) -> Floats:
        senses = np.array([setting.word('motion', 'pulse') == 'sense' for setting in settings])[:, None]
        ball, t0, t1 = (np.array([float(setting.get(name, 0.0)) for setting in settings])[:, None]
                        for name in ('ball', 't0', 't1'))
        seat = np.where(senses, 0.5 * run.approach, (seconds(run) > t0) & (seconds(run) <= t1))
        return np.asarray(seat * (run.ball == ball))


class _EachBall(Effect):
    """An effect of one ball, or of each by its own amounts."""

    carries = 'all'
    searched = (Searched('ball', '1', 'number of the ball, 0 for all balls, each by its own amount'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try each ball, then all."""
        return grid(ball=(*run.balls, 0))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(Quantity(f'{one.name}_{ball}', 'm', f'{one.meaning} of ball {ball}')
                     for ball in _balls(run, setting) for one in self.quantities)


class BallMachineOffset(_EachBall):
    name = 'ball_machine_offset'
    plain = 'offset of a ball fixed in the machine'
    meaning = 'A ball stands off by an amount that does not turn with the plate: its direction is fixed in the machine.'
    look = 'The stem of that ball: bending under gravity or probing force; probing from one side, a magnetic ball.'
    formula = 'd along x and y of the machine for one ball'
    source = 'physics of stems and probing'
    repeatable = True
    quantities: tuple[Quantity, ...] = per_axis('xy', Quantity('d', 'm', "offset along the machine's"))

    def columns(self, run: Run, setting: Setting) -> Floats:
        own = (run.ball[:, None] == np.array(_balls(run, setting)))[:, None, :, None] * np.eye(3)[:, None, :2]
        return np.asarray(own.reshape(run.size, 3, -1))


class BallSag(_EachBall):
    name = 'ball_sag'
    plain = 'sag of the balls'
    meaning = 'Balls sag under gravity as the plate turns about an axis that is not vertical.'
    look = ('Stems and arms that carry the balls, loose seats; measure with the axis vertical. Stems that bend alike '
            'to all sides look like ball_machine_offset, waves around the plate like plate_support.')
    formula = 'R_z(phi) (c cos(phi) + s sin(phi)) for one ball, or for each'
    source = 'physics of beams under their weight: gravity turns in the plate'
    needs_tilt = True
    quantities: tuple[Quantity, ...] = (
        *per_axis('xyz', Quantity('c', 'm', "cosine amplitude along the plate's")),
        *per_axis('xyz', Quantity('s', 'm', "sine amplitude along the plate's")))

    def columns(self, run: Run, setting: Setting) -> Floats:
        waves = np.stack([np.cos(run.phi), np.sin(run.phi)])
        moved = np.moveaxis(waves[:, :, None, None] * plate_axes(run), 0, 2).reshape(run.size, 3, 1, 6)
        own = run.ball[:, None] == np.array(_balls(run, setting))
        return np.asarray((own[:, None, :, None] * moved).reshape(run.size, 3, -1))


class BallForm(Effect):
    name = 'ball_form'
    plain = 'form deviation of the balls'
    meaning = 'A ball is not round, so its measured centre moves as the table turns it.'
    look = 'Grade and damage of the ball, dirt on it, number and place of the touches.'
    formula = 'a (cos(m phi + psi), -sin(m phi + psi)) in x, y and c cos(m phi + psi_z) in z'
    source = 'Kniel et al. (2019), section 2.1: the form must be as accurate as possible'
    carries = 'all'
    repeatable = True
    searched = (Searched('ball', '1', 'number of the ball, 0 for all balls'),
                Searched('harmonic', '1', 'm, waves per turn, 0 for m = 2 to 5 together'),
                Searched('part', '', 'which part: in the plane (xy), along z, or both'))
    quantities: tuple[Quantity, ...] = (
        Quantity('a', 'm', 'cosine in the plane'), Quantity('b', 'm', 'sine in the plane'),
        Quantity('az', 'm', 'cosine along z'), Quantity('bz', 'm', 'sine along z'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try each ball with each harmonic and with all, then all balls with each harmonic."""
        harmonics = self._harmonics(run)
        return (*grid(ball=run.balls, harmonic=[*harmonics, 0], part=('both',)),
                *grid(ball=(0,), harmonic=harmonics, part=('both', 'xy', 'z')))

    def independent_settings(self, run: Run) -> int:
        """Each ball is a chance for each harmonic."""
        return 5 * len(run.balls)

    def _harmonics(self, run: Run) -> list[int]:
        return [m for m in (2, 3, 4, 5) if m < run.n]

    def _kept(self, setting: Setting) -> 'slice[int, int, None]':
        return {'both': slice(0, 4), 'xy': slice(0, 2), 'z': slice(2, 4)}[setting.word('part', 'both')]

    def _pairs(self, run: Run, setting: Setting) -> list[tuple[int, int]]:
        harmonic = setting.whole('harmonic')
        orders = [harmonic] if harmonic else self._harmonics(run)
        return [(one, m) for one in _balls(run, setting) for m in orders]

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


def _balls(run: Run, setting: Setting) -> Sequence[int]:
    """Return the numbers of the balls of a setting, 0 for all."""
    return [setting.whole('ball')] if setting.whole('ball') else run.balls
