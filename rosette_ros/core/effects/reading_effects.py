# SPDX-License-Identifier: Apache-2.0
"""Effects of the measuring machine's moves and of single readings."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.effects.effect import Effect, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.records import Floats, Run

UNKNOWN = 'unknown'
FIRST_SENSES = {UNKNOWN: (0, 0), '++': (1, 1), '+-': (1, -1), '-+': (-1, 1), '--': (-1, -1)}
"""Senses of x and y before they have moved, by the word for them."""


class CmmReversal(Effect):
    name = 'cmm_reversal'
    plain = 'reversal error of the CMM'
    meaning = "The position of the CMM's axes depends on the side from which they approach."
    look = 'Guideways, friction, drives and scales of the CMM; always approach from one side.'
    formula = '1/2 r_x sense_x, 1/2 r_y sense_y'
    source = 'ISO 230-2 (reversal value B)'
    depends_on = ('cmm_sense',)
    quantities = per_axis('xy', Quantity('r', 'm', 'reversal value of'))  # z comes down to every ball
    carries = 'all'
    searched = (Searched('first', '', 'sense of x and y before they first moved in the run'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try both senses of each axis, and none, for the readings before it first moves."""
        known = np.all(run.cmm_sense[:, :2] != 0)
        return grid(first=(UNKNOWN,) if known else FIRST_SENSES)

    def independent_settings(self, run: Run) -> int:
        """A few readings look alike."""
        return 1

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return half the sense of the last move per axis, (N, 3, 2).

        Before an axis has moved, its sense is not in the records: it is searched, unknown counts zero.
        """
        out = np.zeros((run.size, 3, 2))
        for axis, first in enumerate(FIRST_SENSES[setting.word('first', UNKNOWN)]):
            sense = run.cmm_sense[:, axis]
            out[:, axis, axis] = 0.5 * np.where(sense == 0, first, sense)
        return out


class Outlier(Effect):
    name = 'outlier'
    plain = 'single wrong reading'
    meaning = 'A single ball centre is wrong.'
    look = 'Dirt on the ball or stylus, a false trigger; measure that ball again.'
    formula = 'd for one reading'
    source = 'GUM 3.4.7 (blunders)'
    quantities = per_axis('xyz', Quantity('d', 'm', 'deviation along'))
    carries = 'nothing'
    searched = (Searched('reading', '1', 'number of the reading'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try every reading."""
        return grid(reading=range(1, run.size + 1))

    def blocks(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the unit displacements of many readings, (b, 3, N, 3)."""
        out = np.zeros((len(settings), 3, run.size, 3))
        reading = np.array([setting.whole('reading') for setting in settings]) - 1
        for axis in range(3):
            out[np.arange(len(settings)), axis, reading, axis] = 1.0
        return out
