# SPDX-License-Identifier: Apache-2.0
"""Free courses: a motion of a body that depends on what a run records by any function, without a physical name.

A function of one variable is a Gaussian process on its cosines or waves (Solin and Sarkka 2020), one of two variables
the product of both: a column each, and the prior variance of its amplitude. They compete with the named effects. One
that wins is no cause: it tells on what the readings depend and which body moves.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.effect import Effect, Factors, Quantity, Searched, Setting
from rosette_ros.core.run.errors import InvalidModel
from rosette_ros.core.run.records import Bools, Floats, Ints, Run

NAME = 'free'
TIMES, OF = ' × ', ' | '
MOST, MOST_OF_TWO = 48, 24
"""Functions of a course at most, of one variable and of two: more would describe single readings."""
LEAST = 1e-3
"""Prior variance of a function, over that of the first, below which it is left out: 3 % of its size."""
BORDER = 0.25
"""Share of the range of a variable by which its cosines go on at either end, so that they are free there."""
STANDS_STILL = 1e-3
"""Change of a variable, over its size, that is rounding or the clock's, and no variable."""
WALK, EACH = 'rough', 'each'
MATERN = {'slow': (0.6, 2), 'middle': (0.2, 2), 'quick': (0.07, 2), WALK: (0.3, 1)}
"""Length over the range, and smoothness, of the processes of a variable: 2 once differentiable, 1 a random walk."""
PAUSES = 0.05
"""Range of the logarithm of the pauses between readings from which on they are a variable."""
ALONE = frozenset(('touches', 'cmm memory', 'table memory'))
"""Variables of which no products are made."""
MEMORY = {'short': 0.5, 'middle': 0.75, 'long': 0.9}
"""Share of what earlier moves left that is there at the next reading, by kind."""
WAVES = {'smooth': 1.5, EACH: np.inf}
"""Waves per turn at which the size of a process of an angle has fallen to a half; each value by itself."""


@dataclass(frozen=True, eq=False)
class Variable:
    """What a run records of its readings: values of it (N,) in a unit, functions of it (K, N), and their prior
    variances (K,) by kind of process."""

    name: str
    unit: str
    values: Floats
    functions: Floats
    kinds: dict[str, Floats]

    @property
    def pairs(self) -> tuple[str, ...]:
        """The kinds of process of which products are made: the smoothest, and every ball by itself."""
        if self.name == 'time':  # events and cycles, too, may have a place
            return tuple(one for one in ('slow', 'quick', WALK) if one in self.kinds)
        return tuple(self.kinds)[:2 if self.name == 'ball' else 1]

    @property
    def of_place(self) -> tuple[str, ...]:
        """The kinds of process at one place, which has few readings: the smoothest and the roughest."""
        return tuple(dict.fromkeys((next(iter(self.kinds)), *self.kinds)[::max(len(self.kinds), 1)]))


def _ordinary(name: str, unit: str, values: Floats, kinds: tuple[str, ...], known: Bools | bool = True,
              ) -> list[Variable]:
    """Return a variable on a line, by cosines that reach beyond its range; none where it hardly changes.

    known: whether it is, of each reading (N,): where it is not it moves as the others do on average."""
    values = np.where(known, values, np.median(values[np.broadcast_to(known, values.shape)]))
    if np.ptp(values) <= STANDS_STILL * np.abs(values).max():
        return []
    u = (values - values.min()) / (np.ptp(values) or 1.0)
    order = np.arange(1, min(MOST, max(3, np.unique(values).size - 1)) + 1)
    angle = np.pi * order / (1 + 2 * BORDER)
    functions = _where_known(np.cos(angle[:, None] * (u + BORDER)), known)
    return [Variable(name, unit, values, functions, {
        kind: (1 + (angle * length)**2 / (2 * order - 1))**-float(order) for kind in kinds
        for length, order in [MATERN[kind]]})]


def _where_known(functions: Floats, known: Bools | bool) -> Floats:
    """Return functions (K, N) of what is not known of some readings: there they have their mean over the others."""
    known = np.broadcast_to(known, functions.shape[1:])
    return functions if known.all() else np.where(known, functions - functions[:, known].mean(axis=1, keepdims=True), 0)


def _angle(name: str, values: Floats, top: int, kinds: tuple[str, ...] = tuple(WAVES)) -> Variable:
    """Return a variable on a circle, by its waves up to an order."""
    order = np.repeat(np.arange(1, top + 1), 2)
    phase = order[:, None] * values
    functions = np.where(np.arange(2 * top)[:, None] % 2, np.sin(phase), np.cos(phase))
    seen = np.abs(functions).max(axis=1) > 1e-9
    order = order[seen]
    return Variable(name, 'rad', np.mod(values, 2 * np.pi), functions[seen],
                    {kind: 1 / (1 + (order / WAVES[kind])**4) for kind in kinds})


def _with(one: Variable, kind: str, functions: Floats) -> Variable:
    """Return a variable with one more kind of process, of functions (K, N) of its own."""
    kinds = {word: np.append(variance, np.zeros(len(functions))) for word, variance in one.kinds.items()}
    kinds[kind] = np.append(np.zeros(len(one.functions)), np.ones(len(functions)))
    return replace(one, functions=np.concatenate([one.functions, functions]), kinds=kinds)


@lru_cache(maxsize=2)
def variables(run: Run) -> tuple[Variable, ...]:
    """Return the variables that a run records and that change in it."""
    time, psi, top = on.seconds(run), on.travel(run), run.n // 2
    step = np.diff(time)
    gap = np.concatenate([[np.median(step) if step.size else 0.0], step])
    found = [*_ordinary('time', 's', time, tuple(MATERN)), _angle('table angle', run.phi, top),
             _angle('CMM position', run.alpha, top), _angle('ball', run.beta, top)]
    later = np.arange(run.size) > 0  # nobody knows what was before the first reading
    move = np.diff(psi, prepend=psi[:1])
    turned = np.abs(move) > 1e-9
    moved = np.maximum.accumulate(np.where(turned, np.arange(run.size), 0))
    has_turned = np.logical_or.accumulate(turned)
    if 'table_travel' not in run.unrecorded:
        if np.ptp(psi) > 2.4 * np.pi:  # of one turn it is the table angle
            found += _ordinary('travel', 'rad', psi, ('slow', 'middle', 'quick'))
        size = np.abs(move[moved])
        if np.unique(np.round(size[has_turned], 6)).size > 1:
            found += _ordinary('move size', 'rad', move[moved], ('slow', 'middle'), has_turned)
            found += [replace(one, kinds={f'in either sense {kind}': variance for kind, variance in one.kinds.items()})
                      for one in _ordinary('move size', 'rad', size, ('slow', 'middle'), has_turned)]
        if has_turned.any():
            found += _ordinary('time since move', 's', np.log1p(time - time[moved] + gap[moved]), ('slow', 'middle'),
                               has_turned)
    if np.ptp(np.log1p(gap)) > PAUSES:
        found += _ordinary('pause', 's', np.log1p(gap), ('slow', 'middle'), later)
    if np.any(run.approach) and np.ptp(run.approach) > 0:
        sense: Floats = run.approach.astype(float)
        found.append(Variable('table sense', '', sense, sense[None], {'sense': np.ones(1)}))
    found += _ordinary('touches', '1', np.log1p(np.arange(run.size)), ('slow',))
    if run.is_gapless:
        theta, known = on.last_move(run)
        spot = on.radial(run.alpha)
        moves = np.diff(spot, axis=0, prepend=spot[:1])
        waves = _angle('cmm direction', theta, min(4, top), ('smooth',))
        waves = replace(waves, functions=_where_known(waves.functions, known[:, 0]))
        found.append(_with(waves, 'smooth by length', _where_known(moves[:, :2].T, known[:, 0])))
        turns = np.diff(on.radial(run.phi)[:, :2], axis=0, prepend=on.radial(run.phi[:1])[:, :2]).T
        sides = np.stack([np.cos(theta), np.sin(theta)]) * known[:, 0]
        for word, keep in MEMORY.items():
            left = on.leaky_sum(sides, keep)
            found.append(_with(Variable('cmm memory', '', left[0], left, {word: np.ones(2)}), f'{word} by length',
                               on.leaky_sum(moves[:, :2].T, keep)))
            left = on.leaky_sum(turns, keep)
            found.append(Variable('table memory', '', left[0], left, {word: np.ones(2)}))
        way = np.linalg.norm(moves, axis=1)
        last = np.maximum.accumulate(np.where(way > 1e-9, np.arange(run.size), 0))
        if np.unique(np.round(way[last][known[:, 0]], 6)).size > 1:
            found += _ordinary('cmm distance', '1', way[last], ('slow', 'middle'), known[:, 0])
    senses = on.cmm_senses(run)
    if np.isfinite(senses).all() and np.ptp(senses, axis=1).any():
        found.append(Variable('cmm sense', '', senses[0], senses, {'sense': np.ones(len(senses))}))
    change = on.temperature_change(run)
    if np.isfinite(change).all() and np.ptp(change) > 0:
        found += _ordinary('temperature', 'K', change, ('slow', 'middle'))
    return tuple(found)


@lru_cache(maxsize=2)
def motions(run: Run) -> dict[str, Floats]:
    """Return the directions (d, N, 3) in which bodies can move the balls, of unit length at the balls, by words."""
    along, z = on.along_machine(run), on.unit(2, run.size)
    plate = np.moveaxis(on.plate_axes(run), -1, 0)
    waves = {name: np.stack([np.sin(angle), -np.cos(angle)])[..., None] * z
             for name, angle in (('frame', run.alpha), ('plate', run.beta))}
    scales = on.cmm_axes(run)
    place = on.radial(run.alpha) @ scales.T  # of the two axes of the CMM across the table axis
    first, second, shear = (sum(place[:, i, None] * scales[j] for i, j in some)
                            for some in (((0, 0),), ((1, 1),), ((0, 1), (1, 0))))
    return {
        'frame along z': along[2:], 'frame along x': along[:1], 'frame along y': along[1:2],
        'frame along x and y': along[:2], 'frame along x, y and z': along,
        'plate along its x and y': plate[:2], 'plate along its x, y and z': plate,
        'plate growing': on.radial(run.alpha)[None], 'table or plate turning': on.tangential(run.alpha)[None],
        'table axis tilting': waves['frame'], 'plate tilting': waves['plate'], 'plate distorting': on.oval(run),
        'first scale of the CMM': first[None], 'second scale of the CMM': second[None],
        'squareness of the CMM': shear[None], 'scales and squareness of the CMM': np.stack([first, second, shear])}


def moving_bodies(run: Run) -> dict[str, Floats]:
    """Return the directions (d, N, 3) of each body that can move the balls, all that it has."""
    return {name.partition(' along ')[0]: directions for name, directions in motions(run).items()}


PARTS = {
    'frame': 'frame', 'plate': 'plate', 'plate growing': 'plate', 'plate tilting': 'plate', 'plate distorting': 'plate',
    'table or plate turning': 'table', 'table axis tilting': 'table', 'first scale of the CMM': 'CMM',
    'second scale of the CMM': 'CMM', 'squareness of the CMM': 'CMM', 'scales and squareness of the CMM': 'CMM'}
"""The part of the cell of which a body is a motion."""
BODIES_OF = {part: [*PARTS.values()].count(part) for part in PARTS.values()}
"""How many bodies are motions of each part."""
PLAIN = ('frame along z', 'frame along x and y', 'plate growing', 'table or plate turning', 'table axis tilting',
         'first scale of the CMM', 'second scale of the CMM', 'squareness of the CMM')
"""Motions of courses of two variables."""
OF_BALL = ('frame along z', 'plate along its x and y', 'plate along its x, y and z')
OF_PLACE = {'ball': OF_BALL, 'CMM position': ('frame along z', 'frame along x and y', 'frame along x, y and z'),
            'table angle': ('frame along z', 'frame along x and y', 'frame along x, y and z')}
"""Motions at one ball, one CMM position or one table angle."""
PLACES = tuple(OF_PLACE)
"""The variables that say where a reading was taken: angles."""


def _places(run: Run) -> dict[str, Ints]:
    """Return the number of the place of each reading by its variable."""
    return {'ball': run.ball, 'CMM position': run.cmm_position, 'table angle': run.table_position}


class FreeEffect(Effect):
    """Any function of one or two variables times a motion of a body."""

    name = NAME
    plain = 'motion that depends on what the run records, without a name'
    meaning = 'A body moves with what the run records, by a law that is not in the library.'
    look = 'What the readings depend on, in the cell.'
    formula = 'any function, as a sum of cosines or waves'
    source = 'Solin and Sarkka (2020), Hilbert space methods for Gaussian processes'
    repeatable = True
    searched = (Searched('of', '', 'variables, one or two, or a variable at one place'),
                Searched('kind', '', 'how quickly it changes with them'),
                Searched('along', '', 'which body moves along what'))

    def __reduce__(self) -> str:
        """Return the name by which another process finds the one object of this class."""
        return 'FREE'

    def families(self, run: Run) -> Iterator[tuple[str, tuple[Setting, ...]]]:
        """Yield the variables, with the body that moves, and the settings of each; of one place all bodies together."""
        for name, some in self._of_variables(run):
            if name.startswith('one '):
                yield name, some
                continue
            bodies: dict[str, list[Setting]] = {}
            for one in some:
                bodies.setdefault(one.word('along').partition(' along ')[0], []).append(one)
            yield from ((f'{name}{OF}{body}', tuple(each)) for body, each in bodies.items())

    def _of_variables(self, run: Run) -> Iterator[tuple[str, tuple[Setting, ...]]]:
        """Yield the variables and the settings of each set of variables; two of the same functions are one."""
        distinct: dict[bytes, Variable] = {}
        for one in variables(run):
            distinct.setdefault(one.functions.tobytes(), one)
        every = list(distinct.values())
        single: dict[str, list[Setting]] = {}
        for one in every:
            single.setdefault(one.name, []).extend(
                self._setting(one.name, kind, along) for kind in one.kinds for along in motions(run)
                if kind != WALK or not along.startswith('frame'))  # a frame that walks at random is a kind of noise
        yield from ((name, tuple(dict.fromkeys(some))) for name, some in single.items())
        pairs: dict[str, list[Setting]] = {}
        for one, other in combinations(every, 2):
            if one.name != other.name and ALONE.isdisjoint((one.name, other.name)):
                kinds = [(a, b) for a in one.pairs for b in other.pairs
                         if other.name in OF_PLACE or a not in ('quick', WALK) or one.name != 'time']
                pairs.setdefault(one.name + TIMES + other.name, []).extend(
                    self._setting(one.name + TIMES + other.name, f'{a}, {b}', along)
                    for a, b in kinds for along in PLAIN)
        yield from ((name, tuple(dict.fromkeys(some))) for name, some in pairs.items())
        alone: dict[str, list[Setting]] = {}
        for place, number in _places(run).items():
            for one in every:
                if one.name not in (*OF_PLACE, *ALONE) or (place, one.name) == ('ball', 'table angle'):
                    alone.setdefault(f'one {place}{TIMES}{one.name}', []).extend(
                        self._setting(f'{place} {k}{TIMES}{one.name}', kind, along)
                        for k in np.unique(number).tolist() for kind in one.of_place
                        if kind != EACH  # of one place that is the scatter of its readings
                        and _moves_several(run, f'{place} {k}{TIMES}{one.name}', kind) for along in OF_PLACE[place])
        yield from ((name, tuple(dict.fromkeys(some))) for name, some in alone.items() if some)

    @staticmethod
    def _setting(of: str, kind: str, along: str) -> Setting:
        return Setting(of=of, kind=kind, along=along)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return tuple(setting for _, some in self.families(run) for setting in some)

    def course(self, run: Run, setting: Setting) -> tuple[Floats, Floats]:
        """Return the functions (k, N) of a setting and their prior variances (k,), the largest 1."""
        functions, variance, at = _course(run, setting.word('of'), setting.word('kind'))
        if at is None:
            return functions, variance
        every = np.zeros((len(functions), run.size))
        every[:, at] = functions
        return every, variance

    def variances(self, run: Run, setting: Setting) -> Floats:
        variance = _course(run, setting.word('of'), setting.word('kind'))[1]
        return np.repeat(variance, len(motions(run)[setting.word('along')]))

    @staticmethod
    def variables_of(setting: Setting) -> frozenset[str]:
        """Return the variables on which a setting depends."""
        return frozenset(place_of(name)[0] for name in setting.word('of').split(TIMES))

    def moved(self, setting: Setting) -> frozenset[str]:
        where, number = place_of(setting.word('of').split(TIMES)[0])
        return frozenset([f'ball {number}' if where == 'ball' and number else
                          setting.word('along').partition(' along ')[0]])

    def driven_by(self, setting: Setting) -> frozenset[str]:
        where, number = place_of(setting.word('of').split(TIMES)[0])
        return self.variables_of(setting) - ({where} if where == 'ball' and number else set())

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        directions = len(motions(run)[setting.word('along')])
        count = len(self.variances(run, setting)) // directions
        return tuple(Quantity(f'c{k + 1}_{d + 1}', 'm', f'amplitude of function {k + 1} along direction {d + 1}')
                     for k in range(count) for d in range(directions))

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        return [Factors([one], self.course(run, one)[0][None], motions(run)[one.word('along')],
                        ((0, tuple(range(len(motions(run)[one.word('along')])))),)) for one in settings]

    def columns(self, run: Run, setting: Setting) -> Floats:
        functions, directions = self.course(run, setting)[0], motions(run)[setting.word('along')]
        return np.moveaxis((functions[:, None, :, None] * directions).reshape(-1, run.size, 3), 0, -1)


def bodies_beside(name: str) -> int:
    """Return how many bodies are motions of the same part of the cell as that of a family, itself included."""
    return BODIES_OF.get(PARTS.get(name.partition(OF)[2], ''), 1)


def place_of(name: str) -> tuple[str, int]:
    """Return the variable of a place such as 'ball 7' or 'one ball' and its number, 0 where it has none."""
    variable, _, number = name.removeprefix('one ').rpartition(' ')
    return (variable, int(number)) if number.isdigit() else (name.removeprefix('one '), 0)


@lru_cache(maxsize=2048)
def _course(run: Run, of: str, kind: str) -> tuple[Floats, Floats, Ints | None]:
    """Return functions (k, N) and variances (k,), at one place the functions at its readings alone, and these."""
    names, kinds = of.split(TIMES), kind.split(', ')
    parts = []
    for name, own in zip(names[-len(kinds):], kinds):
        same = [v for v in variables(run) if v.name == name]
        one = next((v for v in same if own in v.kinds), None)
        if one is None:
            known = dict.fromkeys(each for v in same for each in v.kinds)
            raise InvalidModel(f'{run.source}: effect {NAME}: kind of {name}: expected one of {", ".join(known)}, '
                               f'found {own!r}')
        keep = one.kinds[own] > LEAST * one.kinds[own].max()
        parts.append((one.functions[keep], one.kinds[own][keep]))
    functions, variance = parts[0]
    if len(parts) == 2:
        other, more = parts[1]
        both = variance[:, None] * more
        a, b = np.unravel_index(np.argsort(-both, axis=None, kind='stable')[:MOST_OF_TWO], both.shape)
        functions, variance = functions[a] * other[b], both[a, b]
    at = None
    if len(kinds) < len(names):
        place, number = place_of(names[0])
        at = np.flatnonzero(_places(run)[place] == number)
        functions, variance = functions[:run.n - 1, at], variance[:run.n - 1]
        # each ball, CMM position and table position has a constant deviation
        functions = functions - functions.mean(axis=1, keepdims=True)
    keep = variance > LEAST * variance.max()
    functions, variance = functions[keep][:MOST], variance[keep][:MOST]
    functions.setflags(write=False)
    return functions, variance / variance.max(), at


def _moves_several(run: Run, of: str, kind: str) -> bool:
    """Return whether no reading has most of the displacement of a course: else it is a wrong reading."""
    functions, variance, _ = _course(run, of, kind)
    size = variance @ functions**2
    return bool(size.max() < 0.5 * size.sum())


FREE = FreeEffect()
