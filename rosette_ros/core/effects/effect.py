# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a name, its physics as columns, and what it means for an engineer.

To add an effect, write a class with `quantities`, `columns` and, where something has to be searched, `settings`;
then put an instance of it into the table of names in library.py. The diagnosis knows effects by name in three places,
docs/adding-an-effect.md lists them: free forms beside a claim, claims on one variable, and look-alikes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from rosette_ros.core.axes import UPRIGHT, tilt
from rosette_ros.core.effects.run_functions import beside, between_readings, tangential, unit
from rosette_ros.core.errors import InvalidModel
from rosette_ros.core.records import Floats, Run

UNRECORDED = {
    'table_travel': 'readings are missing, and the run does not record how far the table turned meanwhile',
    'cmm_sense': 'readings are missing, and the run does not record from which side the CMM came to the others'}
"""Why an effect of what a run does not record cannot be judged."""
LARGEST = float(np.finfo(float).max)
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
        if (isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST
                and (self.kind != 'scale' or value > 0)):
            return ''
        return f'a {"positive " if self.kind == "scale" else ""}number ({self.unit})'


def per_axis(axes: str, one: Quantity) -> tuple[Quantity, ...]:
    """Return a quantity for each of some axes; the meaning of `one` ends before the letter of the axis."""
    return tuple(Quantity(f'{one.name}_{axis}', one.unit, f'{one.meaning} {axis}') for axis in axes)


class Setting(dict[str, float | str]):
    """The values of the searched parameters of an effect, by name; hashable."""

    def __hash__(self) -> int:  # type: ignore[override]  # a setting is never changed
        return hash(frozenset(self.items()))

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

    waves: (v, m, N); directions: (D, N, 3); of_setting: for each setting its v and the numbers d of its directions. The
    columns of a setting, in any order, are w_v1 e_d1, w_v1 e_d2 ... w_v2 e_d1 ...
    """

    settings: Sequence[Setting]
    waves: Floats
    directions: Floats
    of_setting: tuple[tuple[int, tuple[int, ...]], ...]


@dataclass(frozen=True, eq=False)
class Motion:
    """What effects do to the plate as a body: rotation vector (N, 3), rad, growth (N,), shift on the table (N, 3), m.

    beyond: what the shift is beyond first order in the amplitudes, (N, 3), m.
    """

    rotation: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    growth: Floats = field(default_factory=lambda: np.zeros(1))
    shift: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    beyond: Floats = field(default_factory=lambda: np.zeros((1, 3)))

    def __add__(self, other: 'Motion') -> 'Motion':
        return Motion(self.rotation + other.rotation, self.growth + other.growth, self.shift + other.shift,
                      self.beyond + other.beyond)


class Effect:
    """One physical effect; subclasses give `columns` and what they need of the rest.

    name: fixed name in files, messages and on screen; plain: the same in words; meaning: a plain sentence; look: where
    to look in the cell; formula: the form added to p; source: where it comes from; depends_on: quantities of a reading
    it needs; searched: its nonlinear parameters; quantities: its amplitudes, where all settings have the same; carries:
    what of it a later run of the same cell shares, `all` (settings and amplitudes), `shape` (settings; phases or sizes
    differ) or `nothing` (an event); needs_tilt: whether only a table with an axis that is not vertical has it;
    repeatable: whether a run can have it more than once.
    """

    name: str = ''
    plain: str = ''
    meaning: str = ''
    look: str = ''
    formula: str = ''
    source: str = ''
    depends_on: tuple[str, ...] = ()
    searched: tuple[Searched, ...] = ()
    quantities: tuple[Quantity, ...] = ()
    carries: str = 'shape'
    needs_tilt: bool = False
    repeatable: bool = False

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((type(self), self.name))

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
        return self.quantities

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return the displacement of every reading per unit of each amplitude, (N, 3, q), m/unit."""
        return np.moveaxis(self.blocks(run, [setting])[0], 0, -1)

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the columns of many settings with as many amplitudes each, (b, q, N, 3).

        The same as `columns` one by one; an effect with many settings may write it in place of `columns`, all at once.
        """
        return np.stack([np.moveaxis(self.columns(run, setting), -1, 0) for setting in settings])

    def factors(self, run: Run, settings: Sequence[Setting]) -> Sequence[Factors]:
        """Return the Factors of settings where columns are such products, else none; each setting is in one."""
        return ()

    @property
    def moves_plate(self) -> bool:
        """Whether it may move the plate as a body."""
        return type(self).motion is not Effect.motion

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion | None:
        """Return the Motion of amplitudes (q,) whose linear part the columns are; None where it does not
        move the plate as a body."""
        return None

    def width(self, run: Run, setting: Setting) -> int:
        """Return the number of columns of a setting."""
        return len(self.amplitudes(run, setting))

    def independent_settings(self, run: Run) -> int:
        """Return how many settings count as separate chances in the search, at least 1."""
        return max(1, len(self.settings(run)))

    def chances(self, run: Run, settings: Sequence[Setting]) -> list[float]:
        """Return the numbers of separate chances against which settings have to stand, those of all as a rule."""
        return [self.independent_settings(run)] * len(settings)

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        """Return where to refine each continuous parameter of a setting found on the grid.

        A positive scale is refined by half as much again to either side, an instant among those beside it.
        """
        out: dict[str, Bracket] = {}
        for parameter in self.searched:
            if parameter.kind == 'scale':
                value = setting.number(parameter.name)
                out[parameter.name] = (value / 1.6, value * 1.6)
            elif parameter.kind == 'instant':
                out[parameter.name] = self.instants(run, setting, parameter.name)
        return out

    def instants(self, run: Run, setting: Setting, name: str = 't0') -> Floats:
        """Return the instants between readings beside that of a setting, as far as the next ones of the grid."""
        every = between_readings(run, most=run.size)[1:-1]
        return beside(every, setting.number(name), 1.5 * every.size / between_readings(run).size)

    def check_setting(self, setting: Setting) -> None:
        """Raise InvalidModel unless the setting gives searched parameters values that can be."""
        known = {parameter.name: parameter for parameter in self.searched}
        for name, value in setting.items():
            if name not in known:
                words = ', '.join(known) or 'none'
                raise InvalidModel(f'effect {self.name}: wanted settings among {words}, got {name!r}')
            if wanted := known[name].wanted_for(value):
                raise InvalidModel(f'effect {self.name}: {name}: wanted {wanted}, got {value!r}')


class TurningEffect(Effect):
    """An effect that turns the plate about the table axis and does nothing else."""

    def motion(self, run: Run, setting: Setting, amplitudes: Floats) -> Motion | None:
        shift = self.columns(run, setting) @ amplitudes
        turn = np.sum(shift * tangential(run.alpha), axis=1) / run.radius
        return Motion(turn[:, None] * unit(2, run.size))
