# SPDX-License-Identifier: Apache-2.0
"""Whether a correction did what it promised: the errors before it, after it, and what is left of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.records import CURVES, ErrorMotions, Floats, Run, remove_gauge
from rosette_ros.core.table.correction import Correction
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import peak_to_valley

GAUGED = {'ctx': 2, 'cty': 2, 'crx': 2, 'cry': 2}
"""Degrees of freedom that the gauge takes of a curve: its mean, and half of a once-per-turn part of two curves."""
SIGNIFICANT = 0.05 / len(CURVES)
"""A curve whose noise alone is larger with less probability is no noise; six curves are looked at."""
SURE = 4.0
"""Standard deviations beyond which a sign is told."""


class Effectiveness(StrEnum):
    """What became of an error after its correction."""

    VANISHED = 'only noise is left'
    REMAINS = 'a part remains'
    NOT_APPLIED = 'was not taken off'
    WRONG_SIGN = 'was added instead of taken off'
    UNDECIDED = 'U is too large to tell'
    NOISE = 'noise before and after'
    SAME = 'not corrected, unchanged'
    CHANGED = 'not corrected, but changed'


GOOD = (Effectiveness.VANISHED, Effectiveness.NOISE, Effectiveness.SAME)


@dataclass(frozen=True)
class CorrectedError:
    """One error before and after a correction; m or rad.

    before, promised, after: ranges, as measured before, expected after, and measured after; expanded: U (k = 2)
    of a point of the curve after, with that of the correction; gain, u_gain: the part of the correction that was taken
    off, 1 where all of it was, NaN where the curve is not corrected; p: chance that noise alone leaves as much;
    unchanged: whether noise alone explains how far it is from the one before.
    """

    curve: str
    before: float
    promised: float
    after: float
    expanded: float
    gain: float
    u_gain: float
    p: float
    unchanged: bool
    result: Effectiveness

    @property
    def level(self) -> Level:
        """How it is emphasised."""
        if self.result is Effectiveness.UNDECIDED:
            return Level.DOUBTFUL
        return Level.GOOD if self.result in GOOD else Level.BAD


@dataclass(frozen=True)
class CorrectionCheck:
    """Whether a correction did what it promised.

    p_of_table: chance that the correction describes the table as it was before; contradictions: of what runs and
    correction state, in words.
    """

    errors: tuple[CorrectedError, ...]
    p_of_table: float
    contradictions: tuple[str, ...] = ()

    @property
    def level(self) -> Level:
        """Good where every error did what was promised, doubtful where U hides whether some did."""
        every = {one.level for one in self.errors}
        if Level.BAD in every or self.p_of_table < SIGNIFICANT or self.contradictions:
            return Level.BAD
        return Level.DOUBTFUL if Level.DOUBTFUL in every else Level.GOOD

    @property
    def _is_turned(self) -> bool:
        """Whether a wrong sign explains it: at other angles some waves are added too, but parts of others remain."""
        results = {one.result for one in self.errors}
        return Effectiveness.WRONG_SIGN in results and Effectiveness.REMAINS not in results

    @property
    def sentence(self) -> str:
        """What became of the errors."""
        lacking = [f'{one.curve} ({one.result})' for one in self.errors if one.level is Level.BAD]
        hidden = [one.curve for one in self.errors if one.result is Effectiveness.UNDECIDED]
        vanished = [one.curve for one in self.errors if one.result is Effectiveness.VANISHED]
        if self.contradictions:
            return f'The correction is not of this table: {"; ".join(self.contradictions)}.'
        if self.p_of_table < SIGNIFICANT:
            return ('The correction does not describe the table as it was before: it was made of another table, or of '
                    'another state of it.')
        if self._is_turned:
            return f'The correction was applied with the wrong sign: {", ".join(lacking)}.'
        if lacking:
            return f'The correction did not do what it promised: {", ".join(lacking)}.'
        if hidden:
            return (f'It cannot be told whether the correction did what it promised: in {", ".join(hidden)} the errors '
                    'after it agree within their uncertainty with those expected, and with those before.')
        if not vanished:
            return 'There was nothing to correct: no corrected error was larger than its noise.'
        rest = ', the rest is unchanged' if len(vanished) < len(self.errors) else ''
        return f'The correction did what it promised: of {", ".join(vanished)} only noise is left{rest}.'

    @property
    def action(self) -> str:
        """What to do."""
        if self.contradictions or self.p_of_table < SIGNIFICANT:
            return 'Make the correction of the last run of this table: rosette correct RUN.'
        if self._is_turned:
            return 'The errors of the file are to be taken off, not added: turn the sign where the table is loaded.'
        if self.level is Level.DOUBTFUL:
            return ('Evaluate both runs under a model that fits them, which makes U smaller (rosette diagnose, --model '
                    'FILE), or measure with less noise.')
        if self.level is Level.GOOD:
            return 'Calibrate again when the table, its bearing or its load has changed.'
        if all(one.unchanged for one in self.errors):
            return 'Check that the correction is loaded and switched on, then measure the run after it again.'
        return ('Check that the controller has the whole correction, and zero and sense of the angle as the run; then '
                'compare the model with the run after it: rosette diagnose AFTER.')


def backward_share(run: Run) -> Floats:
    """Return the share of the readings at each table position to which the table turned in its negative sense, (n,)."""
    place = run.table_position - 1
    return np.bincount(place, run.approach < 0, run.n) / np.maximum(np.bincount(place, minlength=run.n), 1)


def check_correction(before: ErrorMotions, after: ErrorMotions, correction: Correction,
                     contradictions: Sequence[str] = (),
                     backward: tuple[Floats | float, Floats | float] = (0.0, 0.0)) -> CorrectionCheck:
    """Return the CorrectionCheck of two runs, one before and one after a correction was put to work.

    With the curves b before, a after and c of the correction: a = b - g c, and g = 1 where it did what it promised; the
    variance of a point of a - (b - c) is u_a^2 + u_b^2 then. The correction is of the table before where b - c is
    noise of u_b^2 + u_c^2, or 0 (the same run). All are freed of what no run can know. contradictions: see
    CorrectionCheck; backward: as of backward_share, before and after: a run is compared with the mean of both senses
    that it measured, and where the run after is in another sense, the reversal that the correction states is added to
    b. Raises InvalidData where the angles of the runs differ.
    """
    if before.angle.size != after.angle.size or np.abs(
            np.angle(np.exp(1j * (before.angle - after.angle)))).max() > 0.01 * TWO_PI / before.angle.size:
        first, second = (f'{one.angle.size} angles from {np.rad2deg(one.angle[0]):.4g}°' for one in (before, after))
        raise InvalidData(f'verify: expected two runs at the same angles of the table, found {first} before and '
                          f'{second} '
                          'after the correction; measure both with the same balls and table offset')
    whole = replace(correction, corrected=CURVES)
    reversal = _in_senses(whole, before.angle, backward[1]) - _in_senses(whole, before.angle, backward[0])
    before, after = (replace(one, values=remove_gauge(one.values + added, before.angle))
                     for one, added in ((before, reversal), (after, 0.0)))
    taken = remove_gauge(_in_senses(correction, before.angle, backward[1]), before.angle)
    variance, share = before.u**2 + after.u**2, float(np.mean(backward[0]))
    own = ((1 - share) * correction.forward.u**2).mean(axis=0) + (share * correction.backward.u**2).mean(axis=0)
    same_run = np.abs(taken - before.values)[:, [curve in correction.corrected for curve in CURVES]].max(initial=0)
    found = tuple(_corrected(place, before.values[:, place], after.values[:, place], taken[:, place],
                             variance[:, place], float(own[place]), curve in correction.corrected)
                  for place, curve in enumerate(CURVES))
    differs = [_p(before.values[:, place] - taken[:, place], before.u[:, place]**2 + own[place], curve)
               for place, curve in enumerate(CURVES) if curve in correction.corrected]
    return CorrectionCheck(found, 1.0 if same_run < 1e-12 else min(differs, default=1.0), tuple(contradictions))


def _in_senses(correction: Correction, angle: Floats, backward: Floats | float) -> Floats:
    """Return the errors of a correction as a run finds them that comes to angles in both senses, (m, 6).

    backward: share of the readings that came in the negative sense of the table, 0 or 1 in one sense.
    """
    share = np.broadcast_to(backward, angle.shape)[:, None]
    return (1 - share) * correction.errors(angle) + share * correction.errors(angle, -1)


def _corrected(place: int, before: Floats, after: Floats, taken: Floats, variance: Floats, own: float,
               is_corrected: bool) -> CorrectedError:
    curve = CURVES[place]
    promised = before - taken
    expanded = COVERAGE_FACTOR * float(np.sqrt(variance.max()))
    size = float(np.sum(taken**2 / variance))
    gain = float(np.sum(taken * (before - after) / variance) / size) if size > 0 else float('nan')
    u_gain = size**-0.5 if size > 0 else float('nan')
    p, unchanged = _p(after - promised, variance, curve), _p(after - before, variance, curve) >= SIGNIFICANT
    if not is_corrected:
        result = Effectiveness.SAME if p >= SIGNIFICANT else Effectiveness.CHANGED
    elif _p(taken, np.full(taken.size, own), curve) >= SIGNIFICANT:
        result = Effectiveness.NOISE if p >= SIGNIFICANT else Effectiveness.REMAINS
    elif p >= SIGNIFICANT:
        result = Effectiveness.UNDECIDED if unchanged else Effectiveness.VANISHED
    elif gain < -SURE * u_gain and abs(gain + 1) < SURE * u_gain:
        result = Effectiveness.WRONG_SIGN
    else:
        result = Effectiveness.NOT_APPLIED if abs(gain) < SURE * u_gain else Effectiveness.REMAINS
    spans = peak_to_valley(np.stack([before, promised, after], axis=-1)).tolist()
    return CorrectedError(curve, spans[0], spans[1], spans[2], expanded, gain, u_gain, p, unchanged, result)


def _p(difference: Floats, variance: Floats, curve: str) -> float:
    """Return the chance that noise alone makes a curve as large as `difference`, (n,)."""
    dof = difference.size - GAUGED.get(curve, 1)
    return float(scipy.special.chdtrc(dof, np.sum(difference**2 / variance) * dof / difference.size))
