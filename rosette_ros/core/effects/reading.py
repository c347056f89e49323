# SPDX-License-Identifier: Apache-2.0
"""Effects of the measuring machine's moves and of single readings."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import Effect, Quantity, Searched, Setting

UNKNOWN = 'unknown'
FIRST_SENSES = {UNKNOWN: (0, 0), '++': (1, 1), '+-': (1, -1), '-+': (-1, 1), '--': (-1, -1)}
"""Senses of x and y before they have moved, by the word for them."""


@dataclass(frozen=True)
class CmmReversal(Effect):
    """The CMM stands elsewhere when it comes from the other side: 1/2 r sense, per axis."""

    name: str = 'cmm_reversal'
    meaning: str = "The CMM's axes stand at another place when they come from the other side."
    look: str = 'Guideways, friction, drives and scales of the CMM; approach always from one side.'
    formula: str = '1/2 r_x sense_x, 1/2 r_y sense_y'
    source: str = 'ISO 230-2 (reversal value B)'
    depends_on: tuple[str, ...] = ('cmm_sense',)
    carries: str = 'all'
    searched: tuple[Searched, ...] = (
        Searched('first', '', 'sense of x and y before they first moved in the run'),)

    def settings(self, run):
        """Try both senses of each axis, and none, for the readings before it first moves."""
        if not np.any(run.cmm_sense[:, :2] == 0):
            return (Setting(first=UNKNOWN),)
        return tuple(Setting(first=first) for first in FIRST_SENSES)

    def independent_settings(self, run):
        """A few readings look alike."""
        return 1

    def amplitudes(self, run, setting):
        """Return the reversal values of x and y; z comes down to every ball."""
        return tuple(Quantity(f'r_{axis}', 'm', f'reversal value of {axis}') for axis in 'xy')

    def columns(self, run, setting):
        """Return half the sense of the last move per axis, (N, 3, 2).

        Before an axis has moved, its sense is not in the records: it is searched, unknown counts zero.
        """
        out = np.zeros((run.size, 3, 2))
        for axis, first in enumerate(FIRST_SENSES[setting.get('first', UNKNOWN)]):
            sense = run.cmm_sense[:, axis]
            out[:, axis, axis] = 0.5 * np.where(sense == 0, first, sense)
        return out


@dataclass(frozen=True)
class Outlier(Effect):
    """One ball centre alone is wrong."""

    name: str = 'outlier'
    meaning: str = 'One ball centre alone is wrong.'
    look: str = 'Dirt on the ball or stylus, a false trigger; measure that ball again.'
    formula: str = 'd for one reading'
    source: str = 'GUM 3.4.7 (blunders)'
    depends_on: tuple[str, ...] = ()
    carries: str = 'nothing'
    searched: tuple[Searched, ...] = (Searched('reading', '1', 'number of the reading'),)

    def settings(self, run):
        """Try every reading."""
        return tuple(Setting(reading=reading) for reading in range(1, run.size + 1))

    def amplitudes(self, run, setting):
        """Return its deviation."""
        return tuple(Quantity(f'd_{axis}', 'm', f'deviation along {axis}') for axis in 'xyz')

    def columns(self, run, setting):
        """Return the unit displacements of that reading, (N, 3, 3)."""
        return np.moveaxis(self.blocks(run, [setting])[0], 0, -1)

    def blocks(self, run, settings):
        """Return the unit displacements of many readings, (b, 3, N, 3)."""
        out = np.zeros((len(settings), 3, run.size, 3))
        reading = np.array([setting['reading'] for setting in settings]) - 1
        for axis in range(3):
            out[np.arange(len(settings)), axis, reading, axis] = 1.0
        return out


READING_EFFECTS = (CmmReversal(), Outlier())
