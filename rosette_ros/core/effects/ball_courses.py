# SPDX-License-Identifier: Apache-2.0
"""Courses of single balls, of places on the plate and of single readings."""

from collections.abc import Hashable, Sequence
from typing import ClassVar

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.courses import ONE_BALL, STANDING, TRAVELLING, Along, values
from rosette_ros.core.effects.effect import Bracket, Course, Quantity, Searched, Setting, grid
from rosette_ros.core.effects.motions import BALL, last_moves
from rosette_ros.core.effects.run_functions import duration, seconds
from rosette_ros.core.run.records import Floats, Ints, Run


class OneBall(Course):
    """Functions of the readings of one ball, zero at the others; an event."""

    searched: ClassVar[tuple[Searched, ...]] = (ONE_BALL,)
    variables: ClassVar[tuple[str, ...]] = ('ball', 'time')
    depends_on = ('time',)
    carries = 'nothing'

    def kind(self, setting: Setting) -> Hashable:
        return setting.whole('ball')

    def at(self, run: Run, setting: Setting) -> Ints | None:
        return np.flatnonzero(run.ball == setting.whole('ball'))

    def own(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the times of the readings of the ball of settings, (n,), s."""
        return np.asarray(seconds(run)[run.ball == settings[0].whole('ball')])


class BallStep(OneBall):
    """H(t - t0) for one ball, at moments between its own readings; neighbours look alike."""

    searched = (ONE_BALL, Searched('t0', 's', 'moment of the slip, since the first reading', 'instant'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return tuple(Setting(ball=ball, t0=float(t0)) for ball in run.balls
                     for t0 in on.thinned(on.midway(seconds(run)[run.ball == ball]), 40))


    def instants(self, run: Run, setting: Setting, name: str) -> Floats:
        """Return the instants between that ball's readings around a setting."""
        middle = on.midway(self.own(run, [setting]))
        return on.beside(middle, setting.number(name), 1.5 * middle.size / 40)

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return (self.own(run, settings) > values(settings, 't0'))[:, None].astype(float)


class BallCreep(OneBall):
    """1 - exp(-(t - t0)/tau) for one ball from t0 on, 1 at the end of the run; from steps to steady creep."""

    searched = (ONE_BALL, Searched('t0', 's', 'moment at which it begins, since the first reading', 'phase'),
                Searched('tau', 's', 'time constant; steady where it exceeds the run', 'scale'))

    def settings(self, run: Run) -> tuple[Setting, ...]:
        end = duration(run)
        return grid(ball=run.balls, t0=(0.0, *(end * np.arange(1, 5) / 6).tolist()),
                    tau=(end * np.array([0.05, 0.15, 0.45, 5.0])).tolist())

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        t0, tau, end = setting.number('t0'), setting.number('tau'), duration(run)
        return {'t0': (max(t0 - end / 6, 0.0), t0 + end / 6), 'tau': (tau / 3, min(3 * tau, 5 * end))}

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        t0, tau = (values(settings, name) for name in ('t0', 'tau'))
        since, end = (np.maximum(time - t0, 0) for time in (self.own(run, settings), seconds(run)[-1:]))
        return np.asarray(np.expm1(-since / tau) / np.expm1(-np.maximum(end, 1e-9) / tau))[:, None]


class BallSeats(OneBall):
    """H(t - t0) - H(t - t1) for one ball, two or more of its readings apart, or 1/2 approach where that changes."""

    searched = (ONE_BALL, Searched('motion', '', 'there and back, or by sense'),
                Searched('t0', 's', 'moment at which it moved, since the first reading', 'instant'),
                Searched('t1', 's', 'moment at which it came back', 'instant'))
    variables = ('ball', 'time', 'table sense')

    def settings(self, run: Run) -> tuple[Setting, ...]:
        sense = np.ptp(run.approach) > 0
        out = []
        for ball in run.balls:
            middle = on.thinned(on.midway(seconds(run)[run.ball == ball]), 14)
            out += [Setting(ball=ball, motion='pulse', t0=float(t0), t1=float(t1)) for place, t0 in enumerate(middle)
                    for t1 in middle[place + 2:]]
            out += [Setting(ball=ball, motion='sense')] if sense else []
        return tuple(out)


    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {} if setting.word('motion') == 'sense' else super().brackets(run, setting)

    def instants(self, run: Run, setting: Setting, name: str) -> Floats:
        middle = on.midway(self.own(run, [setting]))
        return on.beside(middle, setting.number(name), 1.5 * middle.size / 14)

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        senses = np.array([[setting.word('motion', 'pulse') == 'sense'] for setting in settings])
        time, (t0, t1) = self.own(run, settings), (values(settings, name) for name in ('t0', 't1'))
        sense = 0.5 * run.approach[run.ball == settings[0].whole('ball')]
        return np.where(senses, sense, (time > t0) & (time <= t1))[:, None]


class EachBall(Course):
    """1 for one ball, or for each by its own amounts; each ball is a chance, and all of them."""

    searched = (BALL,)
    variables: ClassVar[tuple[str, ...]] = ('ball',)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(ball=(*run.balls, 0))

    def functions(self, run: Run) -> Floats:
        """Return what it is for a ball, (m, N)."""
        return np.ones((1, run.size))

    def kind(self, setting: Setting) -> Hashable:
        return setting.whole('ball')

    def at(self, run: Run, setting: Setting) -> Ints | None:
        ball = setting.whole('ball')
        return np.flatnonzero(run.ball == ball) if ball else None

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        at, functions = self.at(run, settings[0]), self.functions(run)
        if at is not None:
            return np.asarray(functions[None, :, at])
        own = run.ball == np.array(run.balls)[:, None]
        return np.asarray((own[:, None] * functions).reshape(1, -1, run.size))

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        ball = setting.whole('ball')
        return tuple(Quantity(f'{one.name}_{each}', one.unit, f'{one.meaning} of ball {each}')
                     for each in ([ball] if ball else run.balls) for one in super(EachBall, self).amplitudes(
                         run, setting, given, along))


class GravityInPlate(EachBall):
    """cos(phi) and sin(phi) for one ball or for each: gravity turns in the plate."""

    variables = ('ball', 'table angle')

    def functions(self, run: Run) -> Floats:
        return np.stack([np.cos(run.phi), np.sin(run.phi)])


class EachForm(EachBall):
    """1 for one ball or for each; settings and names are those of its form."""

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return (Setting(),)

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        ball = setting.whole('ball')
        return tuple(amplitude for each in ([ball] if ball else run.balls) for one in given for amplitude in along(
            Quantity(f'{one.name}_{each}', one.unit, f'{one.meaning} of ball {each}')))


class PlateWaves(Course):
    """(cos, sin)(p phi) (cos, sin)(m beta), or (cos, sin)(m beta +- p phi); every setting is a chance.

    Up to three waves per turn of the table with up to six around the plate.
    """

    searched = (Searched('p', '1', 'waves per turn of the table'), Searched('m', '1', 'waves around the plate'),
                Searched('wave', '', 'standing on the plate, or travelling as a load that turns against or with it'))
    variables = ('table angle', 'ball')

    def settings(self, run: Run) -> tuple[Setting, ...]:
        top = (run.n - 1) // 2
        every = grid(p=range(1, min(3, top) + 1), m=range(min(6, top) + 1))
        return tuple(Setting({**one, 'wave': wave}) for one in every for wave in (STANDING, *TRAVELLING)
                     if wave == STANDING or one['m'])

    def kind(self, setting: Setting) -> Hashable:
        """Whether there are four functions."""
        return bool(setting.whole('m')) and setting.word('wave', STANDING) == STANDING

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        names = ('cc', 'sc', 'cs', 'ss') if self.kind(setting) else ('c', 's')
        return super().amplitudes(run, setting, tuple(
            Quantity(name, one.unit, one.meaning) for one in given for name in names), along)

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        turns, around = (values(settings, name) * angle for name, angle in (('p', run.phi), ('m', run.beta)))
        if self.kind(settings[0]):
            return np.stack([wave(turns) * other(around) for other in (np.cos, np.sin) for wave in (np.cos, np.sin)],
                            axis=1)
        sense = np.array([[TRAVELLING.get(setting.word('wave', STANDING), 1)] for setting in settings])
        return np.stack([np.cos(around + sense * turns), np.sin(around + sense * turns)], axis=1)


class Lobes(Course):
    """1 or cos and sin of m theta, theta the direction of the last move of the CMM, for m lobes of the probe."""

    searched = (Searched('lobes', '1', 'm, lobes of the probe around its axis'),
                Searched('theta0', 'rad', 'direction of the move to the first ball, which is not recorded', 'phase'))
    variables = ('cmm direction',)

    def unavailable(self, run: Run) -> str:
        """Where readings are missing, moves between them are not those that the CMM made."""
        return '' if run.is_gapless else 'where readings are missing the last move of the CMM is not known'

    def kind(self, setting: Setting) -> Hashable:
        """Whether there are two functions."""
        return bool(setting.whole('lobes'))

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        return super().amplitudes(run, setting, tuple(
            Quantity(name, one.unit, one.meaning) for one in given
            for name in (('a', 'b') if self.kind(setting) else ('c',))), along)

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        angle = np.array([setting.whole('lobes') * last_moves(run, setting.get('theta0'))[0] for setting in settings])
        return np.stack([np.cos(angle), np.sin(angle)] if self.kind(settings[0]) else [np.cos(angle)], axis=1)


class OneReading(Course):
    """1 for one reading, 0 for all others; each reading is a chance."""

    searched = (Searched('reading', '1', 'number of the reading'),)
    variables = ('reading',)
    carries = 'nothing'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return grid(reading=range(1, run.size + 1))

    def kind(self, setting: Setting) -> Hashable:
        return setting.whole('reading')

    def at(self, run: Run, setting: Setting) -> Ints | None:
        return np.array([setting.whole('reading') - 1])

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        return np.ones((len(settings), 1, 1))
