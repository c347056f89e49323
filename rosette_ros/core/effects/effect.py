# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a motion (which body moves along what) times a course (what it depends on), and its words.

The displacement of a reading is the sum of amplitude x w(reading) x e(reading) over the functions w of the course and
the directions e of the motion. Everything else follows from these two. To add an effect, write an entry in library.py;
docs/adding-an-effect.md shows one.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, product
from typing import Any, ClassVar

import numpy as np

from rosette_ros.core.effects.run_functions import BodyMotion, beside, between_readings, seconds
from rosette_ros.core.run.axes import UPRIGHT, tilt
from rosette_ros.core.run.errors import InvalidModel
from rosette_ros.core.run.number_limits import is_number, is_size
from rosette_ros.core.run.records import Floats, Ints, Run

UNRECORDED = {
    'table_travel': 'readings are missing, and the run does not record how far the table turned meanwhile',
    'cmm_sense': 'readings are missing, and the run does not record from which side the CMM came to the others'}
"""Why an effect of what a run does not record cannot be judged."""
LEAST_KNOWN = 0.5
"""Share of readings with a temperature below which nothing is judged by it."""
Bracket = tuple[float, float] | Floats
"""Where to refine a parameter: between two values, or one of an array of values."""


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect: its name, SI unit and, in words, what it is."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Searched(Quantity):
    """A nonlinear parameter that is found by search.

    kind: `scale` (positive, refined on a logarithmic scale), `phase` (refined on a linear scale), `instant` (a moment
    between two readings, found exactly by trying all) or `choice` (one of a few values, never refined).
    """

    kind: str = 'choice'

    def wanted_for(self, value: object) -> str:
        """Return what is wanted in place of a value, or an empty string where the value can be."""
        if self.kind == 'choice':
            return '' if isinstance(value, (int, float, str)) and not isinstance(value, bool) else 'a number or a word'
        if is_size(value) if self.kind == 'scale' else is_number(value):
            return ''
        return f'a {"positive " if self.kind == "scale" else ""}number ({self.unit})'


def per_axis(axes: str, one: Quantity) -> tuple[Quantity, ...]:
    """Return a quantity for each of some axes; the meaning of `one` ends before the letter of the axis."""
    return tuple(Quantity(f'{one.name}_{axis}', one.unit, f'{one.meaning} {axis}') for axis in axes)


class Setting(dict[str, float | str]):
    """The values of the searched parameters of an effect, by name; hashable."""

    def __hash__(self) -> int:  # type: ignore[override]  # a setting is never changed
        if not hasattr(self, '_hash'):
            self._hash = hash(frozenset(self.items()))
        return self._hash

    def number(self, name: str) -> float:
        """Return a value that is a number."""
        return float(self[name])

    def whole(self, name: str) -> int:
        """Return a value that is a whole number, such as that of a ball."""
        return int(self[name])

    def word(self, name: str, default: str = '') -> str:
        """Return a value that is a word."""
        return str(self.get(name, default))


def grid(**values: Iterable[float | str]) -> tuple[Setting, ...]:
    """Return a Setting for each combination of values of searched parameters, the last one changing first."""
    return tuple(Setting(zip(values, each)) for each in product(*values.values()))


@dataclass(frozen=True, eq=False)
class Factors:
    """Columns of some settings as products w_vm(reading) e_d(reading).

    waves: (v, m, N), or (v, m, n) of the readings `at`, (n,), beside which they are zero; directions: (D, N, 3);
    of_setting: for each setting its v and the numbers d of its directions. The columns of a setting, in any order, are
    w_v1 e_d1, w_v1 e_d2 ... w_v2 e_d1 ...
    """

    settings: Sequence[Setting]
    waves: Floats
    directions: Floats
    of_setting: tuple[tuple[int, tuple[int, ...]], ...]
    at: Ints | None = None


class _ByValue:
    """Equal by type and attributes."""

    name: str = ''

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((type(self), self.name))


class _Factor(_ByValue):
    """What motion and course have in common: a part of the settings, and what a run has to record.

    searched: the parameters that it reads; variables: what of a reading it depends on; depends_on: what of it the run
    has to record.
    """

    searched: ClassVar[tuple[Searched, ...]] = ()
    variables: ClassVar[tuple[str, ...]] = ()
    depends_on: ClassVar[tuple[str, ...]] = ()

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Return the settings to try of it on a run; () means nothing to try."""
        return (Setting(),)



class Motion(_Factor):
    """Which body moves along what.

    body: `frame`, `table axis`, `plate`, `ball`, `CMM` or `reading`; axes: letters of its directions in the names of
    amplitudes, none for a single direction; like: bodies of the motions without a name (free.py) that move the balls
    alike, where body is none of them; stated: the number of an environment that says how far it moves. Each direction
    has a key, its part: its place among them as a rule.
    """

    stated: str
    body: str = ''
    axes: str = ''
    like: tuple[str, ...] = ()

    def moved(self, setting: Setting) -> frozenset[str]:
        """Return what moves, in the words of motions without a name; of one ball or reading with its number."""
        for place in ('ball', 'reading'):
            if setting.get(place):
                return frozenset([f'{place} {setting[place]}'])
        return frozenset(self.like or (self.body,))

    def __init_subclass__(cls) -> None:
        """Refuse a motion that no number of an environment is stated for."""
        if not hasattr(cls, 'stated') and 'stated' not in cls.__annotations__:
            raise TypeError(f'motion {cls.__name__}: expected stated, the number of an environment by which it moves, '
                            'found none; give it one of stated_environment.KINDS')

    def parts(self, run: Run, setting: Setting) -> Sequence[Any]:
        """Return the keys of the directions in which a setting acts."""
        return range(max(1, len(self.axes)))

    def direction(self, run: Run, part: Any) -> Floats:
        """Return the displacement of every reading along a direction, (N, 3), m per unit of amplitude and function."""
        raise NotImplementedError

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        """Return the amplitude along each direction from that of a function, which the entry gives."""
        return per_axis(self.axes, one) if self.axes else (one,)

    def goes_with(self, setting: Setting) -> bool:
        """Return whether a setting of motion and course is tried."""
        return True

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        """Return where to refine its continuous parameters."""
        return {}

    def of_body(self, run: Run, setting: Setting, moved: Floats) -> BodyMotion | None:
        """Return the BodyMotion of the functions times amplitudes along each direction, (d, N); None where the
        plate does not move as a body."""
        return None


class Course(_Factor):
    """What an effect depends on: m functions of the reading.

    carries: what of it a later run of the same cell shares, `all` (settings and amplitudes), `shape` (settings; phases
    or sizes differ) or `nothing` (an event).
    """

    carries: str = 'all'

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the functions of settings of one kind at the readings of `at`, (v, m, n)."""
        raise NotImplementedError

    def kind(self, setting: Setting) -> Hashable:
        """Return what settings share that have as many functions at the same readings."""
        return None

    def at(self, run: Run, setting: Setting) -> Ints | None:
        """Return the readings at which the functions of a setting are not zero, (n,); None for all."""
        return None

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...],
                   along: Callable[[Quantity], tuple[Quantity, ...]]) -> tuple[Quantity, ...]:
        """Return the amplitudes from those of each function, which the entry gives, and what the motion makes of
        one."""
        return tuple(chain(*map(along, given)))

    def unavailable(self, run: Run) -> str:
        """Return why it is not known in a run, or an empty string."""
        return ''

    def most(self, setting: Setting) -> float:
        """Return the largest amplitude that physics allows, SI."""
        return float('inf')

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        """Return where to refine its continuous parameters: a positive scale by half as much again to either side, an
        instant among those beside it."""
        out: dict[str, Bracket] = {}
        for parameter in self.searched:
            if parameter.kind == 'scale':
                value = setting.number(parameter.name)
                out[parameter.name] = (value / 1.6, value * 1.6)
            elif parameter.kind == 'instant':
                out[parameter.name] = self.instants(run, setting, parameter.name)
        return out

    def instants(self, run: Run, setting: Setting, name: str) -> Floats:
        """Return the instants between readings beside that of a setting, as far as the next ones of the grid."""
        every = between_readings(run, most=run.size)[1:-1]
        return beside(every, setting.number(name), 1.5 * every.size / between_readings(run).size)

    def variances(self, setting: Setting) -> Floats | None:
        """Return the prior variances of the functions of a setting, (m,), the largest 1; None where they are alike."""
        return None

    def moments(self, run: Run, setting: Setting) -> dict[str, Floats]:
        """Return for each instant the times of the readings of `at`: any between two of them gives the same waves."""
        at = self.at(run, setting)
        times = np.unique(seconds(run) if at is None else seconds(run)[at])
        return {one.name: times for one in self.searched if (one.kind, one.unit) == ('instant', 's')
                and one.name in setting and times[0] <= setting.number(one.name) < times[-1]}


class Effect(_ByValue):
    """What a model may have as a term, and a diagnosis may search: settings, amplitudes and columns, and its words.

    name: fixed name in files, messages and on screen; plain: the same in words; meaning: a plain sentence; look: where
    to look in the cell; formula: the form added to p; source: where it comes from; depends_on: quantities of a reading
    it needs; searched: its nonlinear parameters; carries: as of Course; needs_tilt: whether only a table with an axis
    that is not vertical has it; repeatable: whether a run can have it more than once; variables: what of a reading it
    depends on; body: what moves.
    """

    name: str = ''
    plain: str = ''
    meaning: str = ''
    look: str = ''
    formula: str = ''
    source: str = ''
    depends_on: tuple[str, ...] = ()
    searched: tuple[Searched, ...] = ()
    carries: str = 'shape'
    needs_tilt: bool = False
    repeatable: bool = False
    variables: tuple[str, ...] = ()
    body: str = ''

    @property
    def constants(self) -> tuple[Searched, ...]:
        """What is searched and a constant of the machine, the same in each of its runs: time constants, periods,
        numbers of balls and harmonics; no moments and phases, none of an event."""
        if self.carries == 'nothing':
            return ()
        return tuple(one for one in self.searched if one.unit and (one.kind == 'scale' or one.unit not in ('s', 'rad')))

    def can_be_in(self, run: Run) -> bool:
        """Return whether the cell of a run can have the effect at all."""
        return not self.needs_tilt or tilt(run.rotation) > UPRIGHT

    def unavailable(self, run: Run) -> str:
        """Return why the effect cannot be judged on this run, or an empty string."""
        if not self.can_be_in(run):
            return ('the run does not say how the table axis stands in the machine' if run.rotation is None else
                    'the table axis is vertical: gravity does not turn in the plate')
        if 'temperature' in self.depends_on and np.mean(np.isfinite(run.temperature)) < LEAST_KNOWN:
            return f'the run has {"too few" if np.isfinite(run.temperature).any() else "no"} temperatures'
        if 'approach' in self.depends_on and not np.any(run.approach):
            return 'the run does not say in which sense the table moved'
        return next((UNRECORDED[name] for name in run.unrecorded if name in self.depends_on), '')

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Return the settings to try on this run; () means nothing to try."""
        return (Setting(),)

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        """Return the Quantity of each column."""
        return ()

    def variances(self, run: Run, setting: Setting) -> Floats:
        """Return the prior variances of the amplitudes relative to one another, (q,)."""
        return np.ones(self.width(run, setting))

    def moved(self, setting: Setting) -> frozenset[str]:
        """Return what moves, in the words of motions without a name; of one ball or reading with its number."""
        return frozenset([self.body])

    def driven_by(self, setting: Setting) -> frozenset[str]:
        """Return the variables with which it moves; the ball is none where one ball moves."""
        return frozenset(self.variables)

    @property
    def is_limited(self) -> bool:
        """Whether physics limits its amplitudes."""
        return type(self).most is not Effect.most

    def most(self, setting: Setting) -> float:
        """Return the largest amplitude that physics allows, SI."""
        return float('inf')

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return the displacement of every reading per unit of each amplitude, (N, 3, q), m/unit."""
        return np.moveaxis(self.blocks(run, [setting])[0], 0, -1)

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the columns of many settings with as many amplitudes each, (b, q, N, 3)."""
        return np.stack([np.moveaxis(self.columns(run, setting), -1, 0) for setting in settings])

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        """Return the Factors of settings; each setting is in one."""
        return ()

    @property
    def moves_plate(self) -> bool:
        """Whether it may move the plate as a body."""
        return False

    def body_motion(self, run: Run, setting: Setting, amplitudes: Floats) -> BodyMotion | None:
        """Return the BodyMotion of amplitudes (q,) whose linear part the columns are; None where it does not
        move the plate as a body."""
        return None

    def width(self, run: Run, setting: Setting) -> int:
        """Return the number of columns of a setting."""
        return len(self.amplitudes(run, setting))

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        """Return where to refine each continuous parameter of a setting found on the grid."""
        return {one.name: (setting.number(one.name) / 1.6, setting.number(one.name) * 1.6)
                for one in self.searched if one.kind == 'scale'}

    def moments(self, run: Run, setting: Setting) -> dict[str, Floats]:
        """Return for each instant of a setting the rising times, s since the first reading, that it lies between."""
        return {}

    def check_setting(self, setting: Setting) -> None:
        """Raise InvalidModel unless the setting gives searched parameters values that can be."""
        known = {parameter.name: parameter for parameter in self.searched}
        for name, value in setting.items():
            if name not in known:
                words = ', '.join(known) or 'none'
                raise InvalidModel(f'effect {self.name}: expected settings among {words}, found {name!r}')
            if wanted := known[name].wanted_for(value):
                raise InvalidModel(f'effect {self.name}: {name}: expected {wanted}, found {value!r}')


@lru_cache(maxsize=64)
def _direction(motion: Motion, run: Run, part: Any) -> Floats:
    """Return a direction of a motion; refining parameters asks for it again and again."""
    return motion.direction(run, part)


class PhysicalEffect(Effect):
    """Motion x course, an entry of the library: all else is derived."""

    def __init__(self, name: str, motion: Motion, course: Course, *quantities: Quantity, meaning: str, plain: str = '',
                 look: str = '', formula: str = '', source: str = '', needs_tilt: bool = False,
                 repeatable: bool = False) -> None:
        """Make the effect of a name; quantities: the amplitude of each function, as far as the motion has it named."""
        self.name, self.motion, self.course, self.quantities = name, motion, course, quantities
        self.meaning, self.plain, self.look, self.formula, self.source = meaning, plain, look, formula, source
        self.needs_tilt, self.repeatable = needs_tilt, repeatable
        own = {one.name for one in motion.searched}
        self.searched = (*motion.searched, *(one for one in course.searched if one.name not in own))
        self.depends_on = (*motion.depends_on, *course.depends_on)
        self.variables = tuple(dict.fromkeys((*course.variables, *motion.variables)))
        self.carries, self.body = course.carries, motion.body

    def unavailable(self, run: Run) -> str:
        return super().unavailable(run) or self.course.unavailable(run)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        every = product(self.motion.settings(run), self.course.settings(run))
        both = (Setting({**choice, **value}) for choice, value in every)
        return tuple(setting for setting in both if self.motion.goes_with(setting))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return self.course.amplitudes(run, setting, self.quantities,
                                      lambda one: self.motion.amplitudes(run, setting, one))

    @property
    def is_limited(self) -> bool:
        return type(self.course).most is not Course.most

    def most(self, setting: Setting) -> float:
        return self.course.most(setting)

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        """Return the Factors of settings by their kind; each function and direction is worked out once."""
        parts = [self.motion.parts(run, setting) for setting in settings]
        number = {part: k for k, part in enumerate(dict.fromkeys(chain(*parts)))}
        directions = np.array([_direction(self.motion, run, part) for part in number]).reshape(-1, run.size, 3)
        names = [one.name for one in self.course.searched]
        out = []
        for places in self._kinds(settings):
            keys = [tuple([settings[place].get(name) for name in names]) for place in places]
            values = dict(zip(reversed(keys), reversed(places)))
            wave = {key: v for v, key in enumerate(values)}
            out.append(Factors(
                [settings[place] for place in places],
                self.course.waves(run, [settings[place] for place in values.values()]), directions,
                tuple((wave[key], tuple([number[part] for part in parts[place]])) for key, place in zip(keys, places)),
                self.course.at(run, settings[places[0]])))
        return out

    def variances(self, run: Run, setting: Setting) -> Floats:
        own = self.course.variances(setting)
        return super().variances(run, setting) if own is None else np.repeat(own, self.width(run, setting) // own.size)

    def moved(self, setting: Setting) -> frozenset[str]:
        return self.motion.moved(setting)

    def driven_by(self, setting: Setting) -> frozenset[str]:
        driver = setting.get('driver')
        return frozenset([str(driver)] if driver else self.variables) - ({'ball'} if setting.get('ball') else set())

    def _kinds(self, settings: Sequence[Setting]) -> Iterable[list[int]]:
        """Return the places of the settings of each kind."""
        places = defaultdict[Hashable, list[int]](list)
        for place, setting in enumerate(settings):
            places[self.course.kind(setting)].append(place)
        return places.values()

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        factors = self.factors(run, settings)
        out = np.zeros((len(settings), factors[0].waves.shape[1] * len(factors[0].of_setting[0][1]), run.size, 3))
        for one, places in zip(factors, self._kinds(settings)):
            wave, which = (np.array(each, dtype=int) for each in zip(*one.of_setting))
            at = slice(None) if one.at is None else one.at
            made = one.waves[wave][:, :, None, :, None] * one.directions[:, at][which][:, None]
            for place, block in zip(places, made):
                out[place][:, at] = block.reshape(out.shape[1], -1, 3)
        return out

    @property
    def moves_plate(self) -> bool:
        return type(self.motion).of_body is not Motion.of_body

    def body_motion(self, run: Run, setting: Setting, amplitudes: Floats) -> BodyMotion | None:
        if not self.moves_plate:
            return None
        waves = self.course.waves(run, [setting])[0]
        return self.motion.of_body(run, setting, amplitudes.reshape(len(waves), -1).T @ waves)


    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        return {**self.course.brackets(run, setting), **self.motion.brackets(run, setting)}

    def moments(self, run: Run, setting: Setting) -> dict[str, Floats]:
        return self.course.moments(run, setting)
