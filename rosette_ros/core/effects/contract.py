# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a name, its physics as columns, and what it means for an engineer.

To add an effect, write a class with `columns` and, where something has to be searched, `settings`;
then put an instance of it in the table of names in library.py. Nothing else changes.
"""

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from rosette_ros.core.errors import InvalidModel


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect: its name, SI unit and, in words, what it is."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Searched(Quantity):
    """A nonlinear parameter that is found by search.

    kind: `scale` (positive, refined on a logarithmic scale), `phase` (refined on a linear scale),
    `instant` (a moment between two readings, found exactly by trying all) or `choice` (one of a few
    values, never refined).
    """

    kind: str = 'choice'

    def unfit(self, value):
        """Return what was wanted in place of a value, or an empty string where the value can be."""
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if self.kind == 'choice':
            return '' if number or isinstance(value, str) else 'a number or a word'
        wanted = f'a {"positive " if self.kind == "scale" else ""}number ({self.unit})'
        fits = number and np.isfinite(value) and (self.kind != 'scale' or value > 0)
        return '' if fits else wanted


class Setting(dict):
    """The values of the searched parameters of an effect, by name; hashable."""

    def __hash__(self):
        """Return a hash of the items, in any order."""
        return hash(frozenset(self.items()))


@dataclass(frozen=True)
class Effect:
    """One physical effect; subclasses give `columns` and what they need of the rest.

    name: fixed name in files, messages and on screen; meaning: a plain sentence; look: where to
    look in the cell; formula: the form added to p; depends_on: quantities of a reading it needs;
    source: where it comes from; carries: what of it a later run of the same cell shares, `all`
    (settings and amplitudes), `shape` (settings; phases or sizes differ) or `nothing` (an event).
    """

    name: str = ''
    meaning: str = ''
    look: str = ''
    formula: str = ''
    source: str = ''
    depends_on: tuple[str, ...] = ()
    searched: tuple[Searched, ...] = field(default=())
    carries: str = 'shape'

    def unavailable(self, run):
        """Return why the effect cannot be judged on this run, or an empty string."""
        if 'temperature' in self.depends_on and not np.all(np.isfinite(run.temperature)):
            return 'the run has no temperatures'
        if 'approach' in self.depends_on and not np.any(run.approach):
            return 'the run does not say in which sense the table moved'
        return ''

    def settings(self, run):
        """Return the settings to try on this run, a tuple of Setting; () means nothing to try."""
        return (Setting(),)

    def amplitudes(self, run, setting):
        """Return the Quantity of each column."""
        raise NotImplementedError

    def columns(self, run, setting):
        """Return the displacement of every reading per unit of each amplitude, (N, 3, q), m/unit."""
        raise NotImplementedError

    def blocks(self, run, settings):
        """Return the columns of many settings with as many amplitudes each, (b, q, N, 3).

        The same as `columns` one by one; an effect with many settings may do it at once.
        """
        return np.stack([np.moveaxis(self.columns(run, setting), -1, 0) for setting in settings])

    def factors(self, run, settings):
        """Return the Factors of settings (factored.py) where columns are such products, else None."""
        return None

    def width(self, run, setting):
        """Return the number of columns of a setting."""
        return len(self.amplitudes(run, setting))

    def independent_settings(self, run):
        """Return how many settings count as separate chances in the search, at least 1."""
        return max(1, len(self.settings(run)))

    def brackets(self, run, setting):
        """Return where to refine each continuous parameter of a setting found on the grid.

        By name: a pair (low, high) to refine within, or an array of values to try. A positive scale
        is refined by half as much again to either side, an instant among those beside it.
        """
        out = {}
        for parameter in self.searched:
            value = setting.get(parameter.name)
            if parameter.kind == 'scale':
                out[parameter.name] = (value / 1.6, value * 1.6)
            elif parameter.kind == 'instant':
                out[parameter.name] = self.instants(run, setting)
        return out

    def instants(self, run, setting):
        """Return the instants between readings that the grid has left out beside a setting."""
        every = between_readings(run, most=run.size)
        tried = between_readings(run)
        if every.size == tried.size:
            return np.zeros(0)
        near = np.argsort(np.abs(tried - setting['t0']))[:3]
        return every[(every >= tried[near].min()) & (every <= tried[near].max())]

    def check_setting(self, setting):
        """Raise InvalidModel unless the setting gives searched parameters values that can be."""
        known = {parameter.name: parameter for parameter in self.searched}
        for name, value in setting.items():
            if name not in known:
                raise InvalidModel(
                    f'effect {self.name}: wanted settings among '
                    f'{", ".join(known) or "none"}, got {name!r}')
            wanted = known[name].unfit(value)
            if wanted:
                raise InvalidModel(f'effect {self.name}: {name}: wanted {wanted}, got {value!r}')


EMPTY = MappingProxyType({})


def seconds(run):
    """Return the time of each reading since the first, (N,), s."""
    return run.time - run.time[0]


def duration(run):
    """Return the time from the first reading to the last, s; 1 where no time passes."""
    return float(np.ptp(run.time)) or 1.0


def unit(axis, size):
    """Return a unit displacement along axis 0, 1 or 2 for every reading, (size, 3)."""
    out = np.zeros((size, 3))
    out[:, axis] = 1.0
    return out


def radial(angle):
    """Return the radial unit vectors at azimuths (N,), shape (N, 3)."""
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def tangential(angle):
    """Return the tangential unit vectors at azimuths (N,), shape (N, 3)."""
    return np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


def logarithmic_grid(low, high, size):
    """Return `size` values from low to high in equal ratios."""
    return np.geomspace(low, high, size)


def between_readings(run, most=120):
    """Return instants midway between readings, thinned to at most `most`, and in pauses, s since the first."""
    time = np.unique(seconds(run))
    middle = 0.5 * (time[1:] + time[:-1])
    if middle.size > most:
        middle = middle[np.linspace(0, middle.size - 1, most).round().astype(int)]
    told = seconds(run)
    pauses = [0.5 * (told[first] + told[first - 1]) for first in run.pauses]
    return np.union1d(middle, pauses) if pauses else middle
