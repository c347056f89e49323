# SPDX-License-Identifier: Apache-2.0
"""Free forms: any smooth function of what a reading depends on, without a physical name.

They compete with the named effects in the search, and stand beside every claim to test its shape. One that wins is no
cause: it tells in words what the residual depends on, and its course is shown. A model file may keep one as a term.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.effect import Effect, Quantity, Searched, Setting, grid
from rosette_ros.core.effects.run_functions import duration, seconds, temperature_change
from rosette_ros.core.records import Bools, Floats, Run

AXES = ('x', 'y', 'z', 'xy', 'xz', 'yz', 'xyz')
ANGLES = {'CMM position': 'alpha', 'table angle': 'phi', 'ball': 'beta'}
HIGHEST = 8


@dataclass(frozen=True, eq=False)
class Course:
    """What a free form is a function of: its name, unit, and value at each reading, (N,); where: the readings, (N,)."""

    name: str
    unit: str
    values: Floats
    where: Bools


class FreeForm(Effect):
    """Scalars of the reading along every one of some axes of the machine.

    words: what it depends on, with the values of a setting in braces; grid: the settings to try; scalars: what each
    axis follows, (m, N); course: what it is shown over.
    """

    look = 'What the residual depends on, in the cell.'
    source = 'no physics: splines, waves and cosines'

    def __init__(self, name: str, words: str, searched: Sequence[Searched], grid: Callable[[Run], Iterable[Setting]],
                 scalars: Callable[[Run, Setting], Sequence[Floats]],
                 course: Callable[[Run, Setting], Course], depends_on: tuple[str, ...] = ()) -> None:
        self.name, self.words, self.depends_on = name, words, depends_on
        self.meaning = f'A free form: the residual {words.format_map(_Blanks())}.'
        self.formula = 'any function, as a sum of smooth ones'
        self.grid, self.scalars, self.course = grid, scalars, course
        self.searched = (*searched, Searched('axes', '', 'axes of the machine'))

    def describe(self, setting: Setting) -> str:
        """Return what the shape depends on, in words."""
        axes = ' and '.join(setting.word('axes'))
        words = {name: f'{value:g}' if isinstance(value, float) else value for name, value in setting.items()}
        return f'it {self.words.format(**words)}, in {axes}'.replace('(-', '(−').replace('x and y and z', 'x, y and z')

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return tuple(self.grid(run))

    def width(self, run: Run, setting: Setting) -> int:
        return len(setting.word('axes')) * len(self.scalars(run, setting))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(Quantity(f'c{k + 1}_{axis}', 'm', f'amplitude along {axis}')
                     for axis in setting.word('axes') for k in range(len(self.scalars(run, setting))))

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return every scalar along every axis, (N, 3, q)."""
        scalars = np.asarray(self.scalars(run, setting), dtype=float)
        axes = ['xyz'.index(axis) for axis in setting.word('axes')]
        out = np.zeros((run.size, 3, len(axes), len(scalars)))
        for place, axis in enumerate(axes):
            out[:, axis, place] = scalars.T
        return out.reshape(run.size, 3, -1)


class _Blanks(dict[str, str]):
    def __missing__(self, key: str) -> str:
        return f'({key})'


def _waves(angle: Floats, order: int) -> list[Floats]:
    """Return cos and sin of an order, or cos alone where sin is zero everywhere."""
    c, s = np.cos(order * angle), np.sin(order * angle)
    return [c] if np.abs(s).max() < 1e-9 else [c, s]


def cosines(values: Floats, count: int) -> list[Floats]:
    """Return cos(pi k u) of values (N,) scaled to u from 0 to 1, for k = 1 .. count."""
    low, span = values.min(), np.ptp(values) or 1.0
    return [np.cos(np.pi * k * (values - low) / span) for k in range(1, count + 1)]


def counts(most: int) -> list[int]:
    """Return how many functions are tried where at most so many can be told apart."""
    return [count for count in (2, 4, 8, 16, 32) if count <= most] or [max(most, 1)]


def _all(run: Run) -> Bools:
    return np.ones(run.size, dtype=bool)


def _over_time(run: Run, setting: Setting) -> Course:
    return Course('time', 's', seconds(run), _all(run))


def _over_angle(run: Run, setting: Setting) -> Course:
    name = setting.word('of', 'CMM position')
    return Course({'phi': 'table angle', 'beta': 'azimuth of the ball', 'alpha': 'CMM position'}[ANGLES[name]], 'rad',
                  getattr(run, ANGLES[name]), _all(run))


def _own(run: Run, setting: Setting) -> Bools:
    return np.asarray(run.ball == setting.whole('ball'))


def _ball_grid(run: Run) -> Iterable[Setting]:
    tried = {'time': {min(2, run.n - 2), min(8, run.n - 2)}, 'table angle': {min(4, (run.n - 1) // 2)}}
    return (one for of, each in tried.items()
            for one in grid(ball=range(1, run.n + 1), of=(of,), count=sorted(each), axes=('z', 'xy', 'xyz')))


def _ball(run: Run, setting: Setting) -> list[Floats]:
    """Return cosines of the time of the ball's own readings, or waves of the table angle for them."""
    own, count = _own(run, setting), setting.whole('count')
    if setting.word('of', 'time') == 'time':
        time = np.where(own, seconds(run), seconds(run)[own].min(initial=np.inf))
        return [own * one for one in cosines(np.clip(time, None, seconds(run)[own].max(initial=0)), count)]
    return [own * one for order in range(1, count + 1) for one in _waves(run.phi, order)]


def _ball_course(run: Run, setting: Setting) -> Course:
    by_time = setting.word('of', 'time') == 'time'
    return Course('time' if by_time else 'table angle', 's' if by_time else 'rad',
                  seconds(run) if by_time else run.phi, _own(run, setting))


def _growing_grid(run: Run) -> Iterator[Setting]:
    """Yield every angle and order with t, but for what named effects have, and low orders with curves of time."""
    named = {('CMM position', 1, 'z'), ('ball', 2, 'z'), ('ball', 3, 'z')}
    for of in ANGLES:
        for order in range(1, min(run.n // 2, HIGHEST) + 1):
            for axes in ('z', 'xy'):
                if (of, order, axes) not in named:
                    yield Setting(of=of, order=order, count=0, axes=axes)
                if order <= 3:
                    yield from (Setting(of=of, order=order, count=k, axes=axes) for k in (4, 8))


def _growing(run: Run, setting: Setting) -> list[Floats]:
    """Return cos(m angle) and sin(m angle) times t, or times cosines of t."""
    count, waves = setting.whole('count'), _waves(getattr(run, ANGLES[setting.word('of')]), setting.whole('order'))
    courses = cosines(seconds(run), count) if count else [seconds(run) / duration(run) - 0.5]
    return [course * wave for course in courses for wave in waves]


def _product_grid(run: Run) -> Iterable[Setting]:
    """Return all products of low orders, off the base model's lines."""
    top = min((run.n - 1) // 2, 5)
    return (Setting(p=p, q=q, axes=axes) for axes in ('z', 'xy')
            for p in range(1, top + 1) for q in range(-top, top + 1) if q)


def _temperature(run: Run, setting: Setting) -> list[Floats]:
    """Return powers of the temperature, scaled to [-1, 1]."""
    change = temperature_change(run)
    u = 2 * (change - change.min()) / np.ptp(change) - 1
    return [u**power for power in range(1, setting.whole('count') + 1)]


_COUNT = Searched('count', '1', 'number of functions')
_OF = Searched('of', '', 'of what it is a function')
_ORDER = Searched('order', '1', 'waves per turn')

FREE_FORMS: dict[str, FreeForm] = {one.name: one for one in (
    FreeForm('free_time', 'changes with time along a curve', (_COUNT,),
             lambda run: grid(axes=AXES, count=counts(run.size // 4)),
             lambda run, setting: cosines(seconds(run), setting.whole('count')), _over_time, ('time',)),
    FreeForm('free_temperature', 'follows the temperature along a curve', (_COUNT,),
             lambda run: grid(axes=AXES, count=(3,)) if np.ptp(run.temperature) > 0 else (), _temperature,
             lambda run, setting: Course('temperature', 'K', temperature_change(run), _all(run)), ('temperature',)),
    FreeForm('free_ball', 'is of ball {ball} alone and changes with {of}',
             (Searched('ball', '1', 'number of the ball'), _OF, _COUNT), _ball_grid, _ball, _ball_course, ('time',)),
    FreeForm('free_growth', 'is a product of time and {of} ({order} waves per turn)', (_OF, _ORDER, _COUNT),
             _growing_grid, _growing, _over_time, ('time',)),
    FreeForm('free_product', 'is a product of table angle ({p} waves) and CMM position ({q} waves)',
             (Searched('p', '1', 'waves per turn of the table'), Searched('q', '1', 'waves of the CMM position')),
             _product_grid,
             lambda run, setting: _waves(setting.whole('p') * run.phi + setting.whole('q') * run.alpha, 1),
             _over_angle),
    FreeForm('free_reversal', 'depends on the sense of the last table move and on the {of} ({order} waves)',
             (_OF, _ORDER),
             lambda run: grid(axes=('z', 'xy'), of=('CMM position', 'table angle'), order=range(4)),
             lambda run, setting: [run.approach * wave for wave in _waves(
                 getattr(run, ANGLES[setting.word('of')]), setting.whole('order'))], _over_angle, ('approach',)),
    FreeForm('free_sense', 'depends on the sense of the last CMM move and on the CMM position ({order} waves)',
             (_ORDER,),
             lambda run: grid(axes=('z', 'xy'), order=range(3)),
             lambda run, setting: [run.cmm_sense[:, axis] * wave for axis in (0, 1)
                                   for wave in _waves(run.alpha, setting.whole('order'))],
             _over_angle, ('cmm_sense',)))}
"""By name."""
