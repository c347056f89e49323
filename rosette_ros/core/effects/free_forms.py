# SPDX-License-Identifier: Apache-2.0
"""Free forms: any smooth function of what a reading depends on, without a physical name.

They compete with the named effects in the search, and stand beside every claim to test its shape. One that wins is no
cause: it tells in words what the residual depends on, and its course is shown. A model file may keep one as a term.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import Effect, Factors, Quantity, Searched, Setting, grid
from rosette_ros.core.effects.run_functions import duration, seconds
from rosette_ros.core.records import Bools, Floats, Run

AXES = ('x', 'y', 'z', 'xy', 'xz', 'yz', 'xyz')
TURNING = ('plate xy', 'radial', 'tangential')
"""Directions that turn: with the plate, or with the place of the ball."""
ANGLES = {'CMM position': 'alpha', 'table angle': 'phi', 'ball': 'beta'}
HIGHEST = 8
MOST_OF_BALL = 16
"""Functions of time for one ball: on a plate of 12 or 18 balls they are any move between its readings."""


@dataclass(frozen=True, eq=False)
class FreeCourse:
    """What a free form is a function of, and how: along each direction the sum of amplitude x carrier x basis.

    name, unit: of the variable; values: of it at each reading, (N,); basis: functions of it, (m, N); carriers: what
    multiplies them, (N,), by its name.
    """

    name: str
    unit: str
    values: Floats
    basis: Sequence[Floats]
    carriers: Mapping[str, Floats] = field(default_factory=dict)

    def carried(self) -> list[Floats]:
        """Return the carriers, or one where there are none."""
        return list(self.carriers.values()) or [np.ones(self.values.size)]

    @property
    def where(self) -> Bools:
        """Readings that it moves, (N,)."""
        return np.asarray(np.any(np.array(self.carried()) != 0, axis=0))


class FreeForm(Effect):
    """Carriers times functions of a variable along some directions.

    words: what it depends on, with the values of a setting in braces; grid: the settings to try; course: of a setting.
    Its setting `axes` are axes of the table frame (`xz`), which stands still, or one of TURNING.
    """

    look = 'What the residual depends on, in the cell.'
    source = 'no physics: powers, waves and cosines'

    def __init__(self, name: str, words: str, searched: Sequence[Searched], grid: Callable[[Run], Iterable[Setting]],
                 course: Callable[[Run, Setting], FreeCourse], depends_on: tuple[str, ...] = ()) -> None:
        self.name, self.words, self.depends_on = name, words, depends_on
        self.meaning = f'A free form: the residual {words.format_map(_Blanks())}.'
        self.formula = 'any function, as a sum of smooth ones'
        self.grid, self.course = grid, course
        self.searched = (*searched, Searched('axes', '', 'axes of the table frame, of the plate, radial or tangential'))

    def describe(self, setting: Setting, of: str = '', axis_open: str = '', instead: str = '') -> str:
        """Return what the shape depends on, in words; of: whose x, y and z are meant, as of `axes_words`; axis_open:
        another axis along which it may be, too; instead: how it compares with effects that it replaces, in words."""
        frame, _, axes = setting.word('axes').rpartition(' ')
        along = ' and '.join(axes).replace('x and y and z', 'x, y and z')
        where = {'radial': 'in the radial direction', 'tangential': 'in the tangential direction'}.get(
            axes, f"along the plate's {along}" if frame else f'in {along}{of}')
        where += f', perhaps in {axis_open} too, which this order hardly shows' if axis_open else ''
        words = {name: f'{float(f"{value:.4g}"):g}' if isinstance(value, float) else value
                 for name, value in setting.items()}
        return f'it {self.words.format(**words)}, {where}'.replace('(-', '(−') + f', {instead}' * bool(instead)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return tuple(self.grid(run))

    def width(self, run: Run, setting: Setting) -> int:
        return len(directions(setting.word('axes'))) * len(_functions(self, run, _without_axes(setting)))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        count = len(_functions(self, run, _without_axes(setting)))
        return tuple(Quantity(f'c{k + 1}_{axis}', 'm', f'amplitude along {axis}')
                     for axis in directions(setting.word('axes')) for k in range(count))

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return every basis function of every carrier along every direction, (N, 3, q)."""
        scalars, units = _functions(self, run, _without_axes(setting)), unit_vectors(run, setting.word('axes'))
        return np.asarray((units[:, :, :, None] * scalars.T[:, None, None]).reshape(run.size, 3, -1))

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        """Return the Factors of settings by their number of functions."""
        every = list(map(_without_axes, settings))
        functions = {each: _functions(self, run, each) for each in dict.fromkeys(every)}
        axes = list(dict.fromkeys(axis for setting in settings for axis in _single(setting.word('axes'))))
        units = np.stack([unit_vectors(run, axis)[..., 0] for axis in axes])
        out = []
        for count in sorted({len(one) for one in functions.values()}):
            waves = {each: one for each, one in functions.items() if len(one) == count}
            number = {each: place for place, each in enumerate(waves)}
            pairs = [(setting, number[each]) for setting, each in zip(settings, every) if each in number]
            out.append(Factors([setting for setting, _ in pairs], np.stack(list(waves.values())), units, tuple(
                (v, tuple(map(axes.index, _single(setting.word('axes'))))) for setting, v in pairs)))
        return out


def axes_words(run: Run) -> str:
    """Return whose axes x, y and z of a free form are, in words, where they are not along those of the machine."""
    return '' if np.array_equal(on.along_machine(run)[:, 0], np.eye(3)) else ' of the table'


def _without_axes(setting: Setting) -> Setting:
    return Setting({name: value for name, value in setting.items() if name != 'axes'})


@lru_cache(maxsize=8)
def _functions(form: FreeForm, run: Run, setting: Setting) -> Floats:
    """Return every basis function of every carrier, (m, N), which settings that differ in their axes share."""
    course = form.course(run, setting)
    return np.array([carrier * one for carrier in course.carried() for one in course.basis])


def directions(axes: str) -> list[str]:
    """Return the names of the directions of a setting's axes."""
    return [axes] if axes in TURNING[1:] else list(axes.rpartition(' ')[2])


def _single(axes: str) -> list[str]:
    """Return a setting's axes one by one, each as axes of a setting."""
    frame = axes.rpartition(' ')[0]
    return [f'{frame} {axis}'.strip() for axis in directions(axes)]


@lru_cache(maxsize=16)
def unit_vectors(run: Run, axes: str) -> Floats:
    """Return the unit vectors of a setting's axes in the table frame, (N, 3, d)."""
    if axes in TURNING[1:]:
        return (on.radial if axes == 'radial' else on.tangential)(run.alpha)[:, :, None]
    frame, _, letters = axes.rpartition(' ')
    places = ['xyz'.index(axis) for axis in letters]
    every = on.plate_axes(run) if frame else np.broadcast_to(np.eye(3), (run.size, 3, 3))
    return every[:, :, places]


class _Blanks(dict[str, str]):
    def __missing__(self, key: str) -> str:
        return f'({key})'


def waves(angle: Floats, order: int) -> list[Floats]:
    """Return cos and sin of an order, or cos alone where sin is zero everywhere."""
    c, s = np.cos(order * angle), np.sin(order * angle)
    return [c] if np.abs(s).max() < 1e-9 else [c, s]


def _wave_carriers(angle: Floats, order: int, of: str) -> dict[str, Floats]:
    """Return the waves by their names, none for order 0."""
    return dict(zip((f'cos {order} × {of}', f'sin {order} × {of}'), waves(angle, order))) if order else {}


def curves(run: Run, count: int, ball: int = 0) -> list[Floats]:
    """Return functions of time that make up any smooth curve, orthonormal over the readings, (N,) each.

    Of u, from 0 to 1 over them: u, u^2, and cos(pi k u) for as many k as there are left; without constant. ball: whose
    readings count, zero at others; 0 for all balls.
    """
    found = _smooth(run, count, ball)
    out = np.zeros((count, run.size))
    out[:len(found), run.ball == ball if ball else slice(None)] = found
    return list(out)


@lru_cache(maxsize=512)
def _smooth(run: Run, count: int, ball: int) -> Floats:
    """Return the values of `curves` at the readings that count; a search asks for them once for each direction."""
    own = seconds(run)[run.ball == ball] if ball else seconds(run)
    if not own.size:
        return np.zeros((count, 0))
    u = (own - own.min()) / (np.ptp(own) or 1.0)
    raw = [np.ones_like(u), u, u**2, *(np.cos(np.pi * k * u) for k in range(1, count))]
    return np.asarray(np.linalg.qr(np.array(raw[:count + 1]).T)[0].T[1:] * np.sqrt(own.size))


def counts(most: int) -> list[int]:
    """Return how many functions are tried where at most so many can be told apart."""
    return [count for count in (2, 4, 8, 16, 32) if count <= most] or [max(most, 1)]


def _time(run: Run, setting: Setting) -> FreeCourse:
    return FreeCourse('time', 's', seconds(run), curves(run, setting.whole('count')))


def _ball_grid(run: Run) -> Iterable[Setting]:
    tried = {'time': {min(most, run.n - 2) for most in (2, 5, MOST_OF_BALL)}, 'table angle': {min(4, (run.n - 1) // 2)}}
    return (one for of, each in tried.items() for one in grid(
        ball=run.balls, of=(of,), count=sorted(each),
        axes=('z', 'plate xy', 'plate xyz') if of == 'time' else ('z', 'xy', 'xyz')))


def _ball(run: Run, setting: Setting) -> FreeCourse:
    """Return curves over the time of the ball's own readings, or waves of the table angle for them."""
    own, count = run.ball == setting.whole('ball'), setting.whole('count')
    carriers = {f'ball {setting.whole("ball")}': own.astype(float)}
    if setting.word('of', 'time') == 'table angle':
        return FreeCourse('table angle', 'rad', run.phi, [one for order in range(1, count + 1)
                                                      for one in waves(run.phi, order)], carriers)
    return FreeCourse('time', 's', seconds(run), curves(run, count, setting.whole('ball')), carriers)


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


def _growing(run: Run, setting: Setting) -> FreeCourse:
    """Return cos(m angle) and sin(m angle) times t, or times curves of t."""
    of, count, time = setting.word('of'), setting.whole('count'), seconds(run)
    return FreeCourse('time', 's', time, curves(run, count) if count else [time / duration(run) - 0.5],
                  _wave_carriers(getattr(run, ANGLES[of]), setting.whole('order'), of))


def _product_grid(run: Run) -> Iterable[Setting]:
    """Return all products of low orders, off the base model's lines."""
    top = min((run.n - 1) // 2, 5)
    return (Setting(p=p, q=q, axes=axes) for axes in ('z', 'xy')
            for p in range(1, top + 1) for q in range(-top, top + 1) if q)


def _product(run: Run, setting: Setting) -> FreeCourse:
    angle = setting.whole('p') * run.phi + setting.whole('q') * run.alpha
    return FreeCourse('sum of the waves', 'rad', np.mod(angle, 2 * np.pi), waves(angle, 1))


def _temperature(run: Run, setting: Setting) -> FreeCourse:
    """Return powers of the temperature, scaled to [-1, 1]."""
    change = on.temperature_change(run)
    span = np.ptp(change)
    u = 2 * (change - change.min()) / span - 1 if span > 0 else np.zeros(run.size)
    return FreeCourse('temperature', 'K', change, [u**power for power in range(1, setting.whole('count') + 1)])


def _sided(run: Run, setting: Setting, carriers: Mapping[str, Floats]) -> FreeCourse:
    """Return waves of an angle of one order for each sense."""
    of = setting.word('of', 'CMM position')
    angle, order = getattr(run, ANGLES[of]), setting.whole('order')
    return FreeCourse(of, 'rad', angle, waves(angle, order) if order else [np.ones(run.size)], carriers)


def _senses(run: Run) -> dict[str, Floats]:
    return {f'sense of {axis}': sense for axis, sense in zip(on.cmm_axes_names(run), on.cmm_senses(run))}


def _travel(run: Run, setting: Setting) -> FreeCourse:
    """Return harmonics of nu cycles per turn of the travel, alike everywhere or by waves of the CMM position."""
    return _periodic('phase of the travel', setting.number('nu') * on.travel(run), setting,
                     _wave_carriers(run.alpha, int(setting.get('order', 0)), 'CMM position'))


def _unsteady(run: Run, setting: Setting) -> FreeCourse:
    """Return a cycle in time whose size and phase change along curves: about `count` / 2 cycles more or fewer."""
    time, period = seconds(run), setting.number('period')
    angle = 2 * np.pi * time / period
    return FreeCourse('time', 's', time, [np.ones(run.size), *curves(run, setting.whole('count'))],
                  {'cos of the cycle': np.cos(angle), 'sin of the cycle': np.sin(angle)})


def _lines(run: Run, setting: Setting) -> FreeCourse:
    """Return harmonics of the periods of the encoder at the actual angle."""
    return _periodic('phase in a period of the encoder', setting.number('lines') * (run.phi + run.angle_deviation),
                     setting, {})


def _periodic(name: str, angle: Floats, setting: Setting, carriers: Mapping[str, Floats]) -> FreeCourse:
    return FreeCourse(name, 'rad', np.mod(angle, 2 * np.pi), [
        one for order in range(1, setting.whole('count') + 1) for one in waves(angle, order)], carriers)


def _approach(run: Run, setting: Setting) -> FreeCourse:
    """Return waves of the direction of the last move of the CMM."""
    theta, known = on.last_move(run)
    return _periodic('direction of the last move', theta, setting, {'': known[:, 0].astype(float)})


def _each_ball(run: Run, setting: Setting) -> FreeCourse:
    """Return waves of the table angle, for every ball of its own."""
    orders = [setting.whole('order')] if setting.whole('order') else range(1, min(3, (run.n - 1) // 2) + 1)
    return FreeCourse('table angle', 'rad', run.phi, [one for order in orders for one in waves(run.phi, order)],
                  {f'ball {ball}': (run.ball == ball).astype(float) for ball in range(1, run.n + 1)})


_COUNT = Searched('count', '1', 'number of functions')
_OF = Searched('of', '', 'of what it is a function')
_ORDER = Searched('order', '1', 'waves per turn')

FREE_FORMS: dict[str, FreeForm] = {one.name: one for one in (
    FreeForm('free_time', 'changes with time along a curve', (_COUNT,),
             lambda run: grid(axes=(*AXES, *TURNING), count=counts(run.size // 4)), _time, ('time',)),
    FreeForm('free_temperature', 'follows the temperature along a curve', (_COUNT,),
             lambda run: grid(axes=AXES, count=(3,)) if np.any(on.temperature_change(run)) else (), _temperature,
             ('temperature',)),
    FreeForm('free_ball', 'is of ball {ball} alone and changes with {of}',
             (Searched('ball', '1', 'number of the ball'), _OF, _COUNT), _ball_grid, _ball, ('time',)),
    FreeForm('free_growth', 'is a product of time and {of} ({order} waves per turn)', (_OF, _ORDER, _COUNT),
             _growing_grid, _growing, ('time',)),
    FreeForm('free_product', 'is a product of table angle ({p} waves) and CMM position ({q} waves)',
             (Searched('p', '1', 'waves per turn of the table'), Searched('q', '1', 'waves of the CMM position')),
             _product_grid, _product),
    FreeForm('free_reversal', 'depends on the sense of the last table move and on the {of} ({order} waves)',
             (_OF, _ORDER),
             lambda run: (*grid(axes=('z', 'xy'), of=('CMM position', 'table angle'), order=range(4)),
                          *grid(axes=TURNING[1:], of=('table angle',), order=range(4))),
             lambda run, setting: _sided(run, setting, {'sense of the table': run.approach.astype(float)}),
             ('approach',)),
    FreeForm('free_sense', 'depends on the sense of the last CMM move and on the CMM position ({order} waves)',
             (_ORDER,), lambda run: grid(axes=('z', 'xy'), order=range(3)),
             lambda run, setting: _sided(run, setting, _senses(run)), ('cmm_sense',)),
    FreeForm('free_approach', 'depends on the direction of the last move of the CMM',
             (_COUNT,), lambda run: grid(axes=('z', 'xy', 'xyz'), count=(2, 4)) if run.is_gapless else (), _approach),
    FreeForm('free_travel', 'repeats {nu} times per turn of travel of the table',
             (Searched('nu', '1', 'cycles per turn', 'phase'), _COUNT, _ORDER),
             lambda run: grid(nu=(0.43,), count=(3,), order=(0, 1), axes=('xy', 'z')), _travel, ('table_travel',)),
    FreeForm('free_cycle', 'repeats in time, about every {period} s, in a size or at intervals that change',
             (Searched('period', 's', 'period', 'scale'), _COUNT),
             lambda run: grid(period=(duration(run) / 10,), count=(2, 4, 8), axes=AXES), _unsteady, ('time',)),
    FreeForm('free_line', 'repeats with every period of the encoder ({lines} per turn)',
             (Searched('lines', '1', 'periods per turn', 'scale'), _COUNT),
             lambda run: grid(lines=(36000.0,), count=(3,), axes=('tangential',)), _lines),
    FreeForm('free_balls', 'is of every ball by itself and changes with the table angle', (_ORDER,),
             lambda run: grid(order=range(min(3, (run.n - 1) // 2) + 1), axes=('z', 'radial', 'tangential', 'xy')),
             _each_ball))}
"""By name."""
BESIDE_CLAIMS = ('free_travel', 'free_cycle', 'free_line', 'free_balls')
"""Those that are not searched, only set beside claims."""
SEARCHED_FORMS = tuple(one for name, one in FREE_FORMS.items() if name not in BESIDE_CLAIMS)
