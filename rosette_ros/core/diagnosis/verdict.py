# SPDX-License-Identifier: Apache-2.0
"""The one decision whether a model fits a run, and the words for it: every interface prints these as they stand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from rosette_ros.core.number_words import micrometres, multiple
from rosette_ros.core.records import ROUNDED, Floats, Run, resolution_of

if TYPE_CHECKING:  # nodes and clients pass a verdict on: they start faster without what makes a fit
    from rosette_ros.core.model.least_squares import Fit
    from rosette_ros.core.model.noise import Noise

UNLIKELY = 0.01
"""Probability of lack of fit below which readings scatter more than stated.

The chi square test (F test where the repeatability has degrees of freedom) gives the probability that noise of the
stated repeatability leaves as much. At 5 % one sound run of twenty would be refused, too many where a cell measures
every day; at 1e-6 a repeatability stated a third too small would pass on a plate of 6 balls. At 1 % a run of 12 balls
(301 degrees of freedom) is refused from 1.10 times the stated repeatability, one of 6 balls (49) from 1.24 times.
"""
SMALLEST_P = 1e-6
CERTAIN = 4
"""An effect in the model is there where a parameter is so many times its standard uncertainty: by chance 6e-5."""
COARSE = 0.5
"""Step of the readings, over the residual, from which on it is told."""
WRONG = 30.0
"""Residual, over the scatter of all along its axis, beyond which a reading is wrong: no noise of a machine is so."""
MOST_WRONG = 4
"""Wrong readings that are listed."""
TOO_LARGE = 2.0, 1e-3
"""Stated repeatability over the residual, and probability of one as small, from which on it is told."""
OTHER_UNIT = 100.0
"""Ratio of the repeatability of axes from which on a wrong unit is the likelier cause."""
WANDERING = 0.85
"""Correlation from reading to reading above which noise is told as a wander of the frame."""
UNEQUAL = 1.3
"""Ratio of the noise of axes from which on it is told beside what is larger."""
_LOOK_AT = 'check the probe and the slide of {}; weights follow what was found'


class Outcome(StrEnum):
    """What a run decides about a model."""

    FITS = 'fits'
    NAMED = 'named effect missing'
    UNNAMED = 'unnamed effect missing'
    SCATTERS = 'scatters more than stated'
    DOUBTFUL_READINGS = 'fits, readings in doubt'
    NOISE = 'fits with other noise'
    NO_REPEATABILITY = 'cannot be said: no repeatability'
    NOT_DETERMINABLE = 'not determinable'


class Level(StrEnum):
    """How an outcome is shown."""

    GOOD = 'good'
    DOUBTFUL = 'doubtful'
    BAD = 'bad'


LEVELS = {
    Outcome.FITS: Level.GOOD, Outcome.DOUBTFUL_READINGS: Level.DOUBTFUL, Outcome.NAMED: Level.BAD,
    Outcome.UNNAMED: Level.BAD, Outcome.SCATTERS: Level.DOUBTFUL, Outcome.NO_REPEATABILITY: Level.DOUBTFUL,
    Outcome.NOISE: Level.DOUBTFUL, Outcome.NOT_DETERMINABLE: Level.BAD}


@dataclass(frozen=True)
class Verdict:
    """The outcome, one sentence for a person, what to do next; limits: what the run cannot tell, a sentence each.

    Messages do not carry limits."""

    outcome: Outcome
    sentence: str
    action: str
    limits: tuple[str, ...] = field(default=(), compare=False)

    @property
    def level(self) -> Level:
        """How the outcome is shown."""
        return LEVELS[self.outcome]

    @property
    def model_fails(self) -> bool:
        """Whether the model, with the stated repeatability, is refuted."""
        return self.outcome in (Outcome.NAMED, Outcome.UNNAMED, Outcome.SCATTERS)


@dataclass(frozen=True)
class Conclusion:
    """What several runs say together: level, one sentence, and what to do."""

    level: Level
    sentence: str
    action: str

    @property
    def model_fails(self) -> bool:
        """Whether the model is refuted."""
        return self.level is Level.BAD


def left_over(final: 'Fit', shapes: str = '') -> str:
    """Return what no named effect explains of a fit, in words, empty where nothing is; shapes: found by the search."""
    p = final.lack_of_fit_p
    return shapes if shapes or p is None or p >= UNLIKELY else _beside_repeatability(final)


def decide(fit: 'Fit', final: 'Fit', missing: Sequence[str] = (), shapes: str = '', look_alikes: Sequence[str] = (),
           hidden: Sequence[str] = (), misfits: Sequence[str] = ()) -> Verdict:
    """Return the Verdict on a model.

    fit: of the model as given; final: with all named effects that the search claims, `missing`; shapes: as of
    `left_over`; look_alikes: effects that would look like a claimed one; hidden: effects that the order of measurement
    cannot show; misfits: in what the rest is not noise as it was estimated, in words.
    """
    left, rms, wrong = left_over(final, shapes), micrometres(fit.rms), wrong_readings(final)
    basis = ('' if fit.run.repeatability is not None else
             '; the repeatability is not known, so this is judged by the structure of the residual alone')
    limits = []
    action = [f'check the readings: {remark}' for remark in fit.run.remarks
              if not (final.noise.resolution and remark.startswith(ROUNDED))]  # said with the noise
    if missing:
        names, it = ' and '.join(missing), 'it' if len(missing) == 1 else 'them'
        more = '' if not left else (f'; something is left that no named effect explains: {left}' if shapes else
                                    f'; beside {it} the readings scatter more than stated: {left}')
        outcome = Outcome.NAMED
        outliers = outlier_words(final, len(fit.effects))
        which = f' ({"; ".join(outliers)})' if outliers else ''
        sentence = (f'The model lacks {names}{which}: with {it} the residual falls from {rms} to '
                    f'{micrometres(final.rms)}{more}{basis}.')
        commands = ', '.join(f'rosette add {name} --model FILE' for name in missing)
        action.append(f'check {names} in the cell or add {it} to the model: {commands}')
        if outliers:
            action.append('measure the wrong readings again')
        if look_alikes:
            alike = f'{" and ".join(look_alikes)} would look nearly the same'
            action.append(f'in this order {alike}')
            limits.append(f'In this order of measurement {alike} as {names}.')
    elif shapes:
        outcome, sentence = Outcome.UNNAMED, f'Something is missing that no named effect explains: {left}{basis}.'
        action.append('look at the residual maps, and check the cell for what the residual depends on')
    elif left:
        outcome, sentence = Outcome.SCATTERS, f'The readings scatter more than stated: {left}.'
        action.append('measure the repeatability again, check the resolution of the coordinates, and look at the '
                      'residual maps')
    elif basis:
        outcome = Outcome.NO_REPEATABILITY
        sentence = ('It cannot be said whether the model fits, as the repeatability is not known; no structure is '
                    f'found in the residual of {rms}.')
        action.append('measure the repeatability')
    elif fit.run.remarks or wrong:
        outcome = Outcome.DOUBTFUL_READINGS
        sentence = f'The model fits readings that are in doubt: {_beside_repeatability(fit)}.'
    else:
        outcome, sentence = Outcome.FITS, f'The model fits: {_beside_repeatability(fit)}.'
    if wrong:
        sentence += (f' Wrong readings, more than {WRONG:.0f} times as far off as the others scatter: '
                     f'{"; ".join(wrong)}.')
        action.append('measure the wrong readings again')
    known, (ratio, p_small) = final.run.repeatability, TOO_LARGE
    if known and known > ratio * final.rms > 0 and final.p_of_small < p_small:
        sentence += (f' The stated repeatability is {multiple(known / final.rms)} times what the readings show: '
                     'uncertainties that rest on it are too large.')
        action.append('measure the repeatability again, and check its unit')
    present = [f'{one.name} ({micrometres(one.rms)} rms)' for one in fit.effects
               if any(abs(part.value) > CERTAIN * part.u for part in one.parameters)]
    if present:
        action.append(f'look in the cell for the cause of what the model only describes, {" and ".join(present)}, or '
                      'keep it in the model')
    said, advice, is_other = _of_noise(final, () if missing or shapes else misfits)
    sentence, outcome = sentence + said, Outcome.NOISE if is_other and outcome == Outcome.FITS else outcome
    action += advice
    if 'table_motions' not in fit.model.base:
        sentence += ' The model has no error motions of the table: their curves are zero by assumption.'
        action.append('add table_motions to the model')
    if hidden:
        action.append(f'measure next in an order that shows {", ".join(hidden)} (rosette advise)')
        limits.append(f'This order of measurement cannot show {", ".join(hidden)}.')
    text = '; '.join(action) or 'nothing needs to be done'
    return Verdict(outcome, sentence, f'{text[0].upper()}{text[1:]}.', tuple(limits))


def _of_noise(final: 'Fit', misfits: Sequence[str]) -> tuple[str, list[str], bool]:
    """Return what the noise of a fit is like, in sentences, what to do, and whether it is not white and equal."""
    sentence, action, noise = '', list[str](), noise_words(final.noise, final.sigma, final.run)
    if noise:
        sentence += f' The noise is not white and equal: {"; ".join(words for words, _ in noise)}.'
        action += [advice for _, advice in noise]
    step = resolution_of(final.run.centre)
    if COARSE * final.rms < step and not final.noise.resolution and not any(
            remark.startswith(ROUNDED) for remark in final.run.remarks):
        share = 100 * (step / final.rms)**2 / 12
        sentence += (f' The readings are rounded to {micrometres(step)}, which makes {share:.0f} % of the variance of '
                     'what is left.')
    if misfits:
        sentence += f' What is left is no noise of that kind: {"; ".join(misfits)}.'
        action.append('look at the residual maps (rosette report)')
    return sentence, action, bool(noise or misfits)


def outlier_words(final: 'Fit', known: int) -> list[str]:
    """Return which readings are wrong, in words, of the outliers in a fit behind so many effects."""
    run, found = final.run, []
    for effect in final.effects[known:]:
        if effect.name == 'outlier':
            row = effect.setting.whole('reading') - 1
            largest = max(effect.parameters, key=lambda one: abs(one.value))
            minutes, size = (run.time[row] - run.time[0]) / 60, micrometres(largest.value)
            found.append(f'reading {row + 1}, table position {run.table_position[row]}, ball {run.ball[row]}, after '
                         f'{minutes:.1f} min, {size} along {largest.name.removeprefix("d_")}')
    return found


def wrong_readings(final: 'Fit') -> list[str]:
    """Return the readings that are farther off than noise can be, in words, the farthest first."""
    run, size = final.run, np.abs(final.residual)
    # 1.4826 times the median is the standard deviation of normal noise; a third of a step, more than that of rounding
    scatter = np.maximum(1.4826 * np.median(size, axis=0), resolution_of(run.centre) / 3)
    if final.noise.resolution or not np.all(scatter > 0):
        return []
    off = size / scatter
    rows = np.flatnonzero(np.any(off > WRONG, axis=1))
    rows = rows[np.argsort(-off[rows].max(axis=1), kind='stable')]
    found = [f'reading {row + 1}, table position {run.table_position[row]}, ball {run.ball[row]}, '
             f'{micrometres(size[row, axis])} along {"xyz"[axis]}'
             for row, axis in zip(rows[:MOST_WRONG], off[rows].argmax(axis=1))]
    return found + ([f'{len(rows) - MOST_WRONG} more'] if len(rows) > MOST_WRONG else [])


def not_determinable(reason: str, added: Sequence[str] = ()) -> Verdict:
    """Return the Verdict on a run from which the model cannot be determined.

    reason: that of the error, in one line; added: the effects in the model beside its base.
    """
    remove = f', or remove {" and ".join(added)} from the model' if added else ''
    return Verdict(Outcome.NOT_DETERMINABLE, reason, f'Measure the missing balls{remove}.')


def noise_words(noise: 'Noise', sigma: float, run: Run) -> list[tuple[str, str]]:
    """Return in what the noise of a run is other than white and equal, each with what to do; sigma: its size, m."""
    out = []
    if noise.resolution:
        out.append((f'the readings are rounded to {micrometres(noise.resolution)}',
                    'export the coordinates with more digits'))
    out += _unequal_axes((noise.axes**2 + noise.wander * (noise.phi < 1))**0.5, bool(noise.wander.any()))
    if noise.tail:
        out.append((f'single {noise.tail}s stand out more than normal noise allows (Student, {noise.tail_dof:g} '
                    'degrees of freedom)', 'clean balls and stylus; the readings that stand out count less'))
    if noise.by:
        typical, (where, *alike) = sorted(noise.factors)[noise.factors.size // 2], noise.noisiest(run)
        same = f' (in this order that may as well be {" or ".join(alike)})' if alike else ''
        out.append((f'{where} scatters {noise.factors.max() / typical:.1f} times as much as the others{same}',
                    f'look at {where}'))
    if noise.wander.any():
        axis = int(noise.wander.argmax())
        step, white = noise.wander[axis], noise.axes[axis]**2
        if noise.phi == 1:
            words = f'the frame wanders: random walk of {micrometres(sigma * (step * run.size)**0.5)} over the run'
        elif noise.phi > WANDERING:
            readings = 1 / (1 - noise.phi)
            words = f'the frame wanders by {micrometres(sigma * step**0.5)} within about {readings:.0f} readings'
        else:
            words = f'neighbouring readings are correlated {noise.phi * step / (step + white):.1f}'
        out.append((words, 'look for draughts, vibration and temperature of the frame, or measure faster'))
    return out


def _unequal_axes(size: Floats, wanders: bool) -> list[tuple[str, str]]:
    """Return which axes repeat worse than others, and what to do; size: of the noise along x, y, z."""
    x, y, z = size
    if x == y:
        ratio = max(z / x, x / z)
        if z == x or (wanders and ratio < UNEQUAL):
            return []
        return [(f'z repeats {ratio:.1f} times {"worse" if z > x else "better"} than x and y',
                 _LOOK_AT.format('z' if z > x else 'x and y') if ratio < OTHER_UNIT else
                 'check that z has the unit of x and y')]
    best, *others = size.argsort()
    worse = sorted(place for place in others if place == others[-1] or size[place] >= UNEQUAL * size[best])
    ratios = ' and '.join(f'{"xyz"[place]} repeats {size[place] / size[best]:.1f} times' for place in worse)
    return [(f'{ratios} worse than {"xyz"[best]}', _LOOK_AT.format(' and '.join('xyz'[place] for place in worse)))]


def _beside_repeatability(fit: 'Fit') -> str:
    """Return how large the residual is beside the stated repeatability; empty where none is."""
    known, p = fit.run.repeatability, fit.lack_of_fit_p
    if known is None or p is None:
        return ''
    ratio, quietest = fit.rms / known, fit.noise.quietest
    part = f', that of its quietest part {multiple(quietest * ratio)} times' if quietest < 0.5 else ''
    return (f'the residual of {micrometres(fit.rms)} is {multiple(ratio)} times the stated repeatability of '
            f'{micrometres(known)}{part} ({p_words(p)}), and no structure is found in it')


def p_value(p: float) -> str:
    """Return a probability with two significant digits: '<1e−6', '4.2e−5', '0.37', '>0.99'; '–' where it is none."""
    if not math.isfinite(p):
        return '–'
    if p < SMALLEST_P or p > 0.995:
        return '>0.99' if p > 0.995 else '<1e−6'
    return f'{p:.2g}' if p >= 1e-4 else f'{p:.1e}'.replace('e-0', 'e−')


def p_words(p: float) -> str:
    """Return a probability as an equation: 'p = 0.37', 'p < 1e−6'."""
    return f'p = {p_value(p)}'.replace('= <', '< ').replace('= >', '> ')
