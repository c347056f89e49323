# SPDX-License-Identifier: Apache-2.0
"""Effects of the measuring machine's moves and of single readings."""

from collections.abc import Sequence

import numpy as np

from rosette_ros.core.effects.effect import Bracket, Effect, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.run_functions import (
    cmm_axes,
    cmm_axes_names,
    cmm_senses,
    last_move,
    radial,
    tangential,
    unit,
)
from rosette_ros.core.records import Floats, Run

UNKNOWN = 'unknown'
FIRST_SENSES = {UNKNOWN: (0, 0), '++': (1, 1), '+-': (1, -1), '-+': (-1, 1), '--': (-1, -1)}
"""Senses of the two axes before they have moved, by the word for them."""

FIRST_MOVES = np.linspace(-np.pi, np.pi, 8, endpoint=False)
"""Directions that are tried for a move that is not recorded, rad."""


class CmmReversal(Effect):
    name = 'cmm_reversal'
    plain = 'reversal error of the CMM'
    meaning = "The position of the CMM's axes depends on the side from which they approach."
    look = 'Guideways, friction, drives and scales of the CMM; always approach from one side.'
    formula = "1/2 r_x sense_x, 1/2 r_y sense_y along the CMM's own axes; y and z about a table along x"
    source = 'ISO 230-2 (reversal error: from the positive sense less from the negative)'
    depends_on = ('cmm_sense',)
    quantities = per_axis('xy', Quantity('r', 'm', 'reversal error of'))  # of an upright table
    carries = 'all'
    searched = (Searched('first', '', 'sense of the two axes before they first moved in the run'),)

    def settings(self, run: Run) -> tuple[Setting, ...]:
        """Try both senses of each axis, and none, for the readings before it first moves."""
        known = np.all(cmm_senses(run) != 0)
        return grid(first=(UNKNOWN,) if known else FIRST_SENSES)

    def independent_settings(self, run: Run) -> int:
        """A few readings look alike."""
        return 1

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        """Return the reversal errors of the two axes that go to and fro; the third comes down to every ball."""
        one = self.quantities[0]
        return per_axis(cmm_axes_names(run), Quantity(one.name[:-2], one.unit, one.meaning[:-2]))

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return half the sense of the last move along each of the two axes, (N, 3, 2).

        Before an axis has moved, its sense is not in the records: it is searched, unknown counts zero.
        """
        out = np.zeros((run.size, 3, 2))
        firsts = FIRST_SENSES[setting.word('first', UNKNOWN)]
        for place, (sense, axis, first) in enumerate(zip(cmm_senses(run), cmm_axes(run), firsts, strict=True)):
            out[:, :, place] = 0.5 * np.where(sense == 0, first, sense)[:, None] * axis
        return out


class CmmReversalPosition(CmmReversal):
    name = 'cmm_reversal_position'
    plain = 'reversal error of the CMM that grows along the axis'
    meaning = "The reversal error of the CMM's axes grows along the axis."
    look = 'Screws, belts and friction of the drives: lost motion that differs along the travel.'
    formula = '1/2 r_x sense_x x/R, 1/2 r_y sense_y y/R'
    source = 'ISO 230-2 (reversal error at each position)'
    quantities = per_axis('xy', Quantity('r', 'm', 'reversal error at R less that in the middle of'))

    def columns(self, run: Run, setting: Setting) -> Floats:
        return super().columns(run, setting) * (radial(run.alpha) @ cmm_axes(run).T)[:, None]


class ProbeApproach(Effect):
    name = 'probe_approach'
    plain = 'probing error by direction of approach'
    meaning = 'The ball centre depends on the direction from which the probe came.'
    look = 'Lobing and hysteresis of the probe head, bent or loose stylus, clearance moves; come from one direction.'
    formula = 'c u or (a cos(m theta) + b sin(m theta)) u, theta the direction of the last move, u along, across or z'
    source = 'ISO 10360-5 (probing error by direction)'
    carries = 'all'
    searched = (Searched('lobes', '1', 'm, lobes of the probe around its axis'),
                Searched('part', '', 'along the move, across it, or along z'),
                Searched('theta0', 'rad', 'direction of the move to the first ball, which is not recorded', 'phase'))

    def unavailable(self, run: Run) -> str:
        """Where readings are missing, moves between them are not those that the CMM made."""
        return '' if run.is_gapless else 'where readings are missing the last move of the CMM is not known'

    def settings(self, run: Run) -> tuple[Setting, ...]:
        first = FIRST_MOVES.tolist()
        return (*grid(lobes=(0, 2, 3, 4), part=('along', 'across'), theta0=first),
                *grid(lobes=(1, 2, 3, 4), part=('z',), theta0=first))

    def independent_settings(self, run: Run) -> int:
        """The direction of one move changes one reading."""
        return 12

    def brackets(self, run: Run, setting: Setting) -> dict[str, Bracket]:
        """Refine the direction of the first move as far as the next one that is tried, to either side."""
        theta, step = setting.number('theta0'), FIRST_MOVES[1] - FIRST_MOVES[0]
        return {'theta0': (theta - step, theta + step)}

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(Quantity(name, 'm', 'deviation') for name in (('a', 'b') if setting.whole('lobes') else ('c',)))

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return the deviations, (N, 3, q), which are 0 before the first move where theta0 is not given."""
        theta, known = last_move(run)
        if 'theta0' in setting:
            theta, known = np.where(known[:, 0], theta, setting.number('theta0')), np.ones_like(known)
        along = known * {'along': radial(theta), 'across': tangential(theta), 'z': unit(2, run.size)}[
            setting.word('part')]
        angle = setting.number('lobes') * theta
        waves = [np.cos(angle), np.sin(angle)][:self.width(run, setting)]
        return np.stack([wave[:, None] * along for wave in waves], axis=-1)


class Outlier(Effect):
    name = 'outlier'
    plain = 'single wrong reading'
    meaning = 'A single ball centre is wrong.'
    look = 'Dirt on the ball or stylus, a false trigger; measure that ball again.'
    formula = 'd for one reading'
    source = 'GUM 3.4.7 (blunders)'
    quantities = per_axis('xyz', Quantity('d', 'm', 'deviation along'))
    carries = 'nothing'
    repeatable = True
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
