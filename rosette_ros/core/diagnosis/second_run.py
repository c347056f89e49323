# SPDX-License-Identifier: Apache-2.0
"""Is what one run taught true in another run that had no part in it?

Effects learnt on run A keep their settings (time constant, period, order ...) on run B; nothing is searched there.
Their amplitudes are fitted to B, which shows whether the shape is there, under the noise that B has beside them: what
wanders is no drift that has come again. Where physics demands that they stay the same from run to run they are also
taken from A as they are, which asks for everything at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.base_terms import f_test
from rosette_ros.core.diagnosis.cross_validation import cross_validation_rms
from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.diagnosis.log_evidence import NOISELESS
from rosette_ros.core.diagnosis.noise_hypotheses import noise_beside
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.model.least_squares import HIDDEN_SHARE, Fit, FittedEffect, Parameter, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import UNLIKELY, Floats, Run
from rosette_ros.core.run.same_readings import in_common, is_once_more
from rosette_ros.core.sight.bank import CauseFamily, columns_of, sensitivity
from rosette_ros.core.sight.limits import DETECTABLE

Learnt = tuple[Effect, FittedEffect]
"""An effect and how it was fitted to run A."""


class CheckOutcome(StrEnum):
    """What a second run says of an effect that was learnt on the first one."""

    CONFIRMED = 'confirmed'
    NOT_SEEN = 'not seen'
    HIDDEN = 'hidden'
    TOO_WEAK = 'too weak'
    EVENT = 'event'
    NOT_JUDGED = 'not judged'


@dataclass(frozen=True, eq=False)
class CheckedEffect:
    """One effect of run A on run B.

    carries: as of Effect; outcome: confirmed, not seen, hidden (by B's order), too weak (the size learnt on A would not
    show in B), event (nothing that comes again) or not judged; unavailable: why the effect cannot be judged on B;
    strength: of the size learnt above the noise of B, in its standard deviations; visible_fraction: in B; p:
    probability that noise in B does as well; rms and error of the cross-validation in B without and with it, m, all
    other checked effects being there; learnt, found: its parameters in A and B; same_size: whether the amplitudes agree
    within their uncertainties, None where they need not.
    """

    name: str
    setting: Setting
    carries: str
    outcome: CheckOutcome
    unavailable: str = ''
    strength: float = float('nan')
    visible_fraction: float = float('nan')
    p: float = float('nan')
    rms_without: float = float('nan')
    rms_with: float = float('nan')
    cross_validation_without: float = float('nan')
    cross_validation_with: float = float('nan')
    learnt: tuple[Parameter, ...] = ()
    found: tuple[Parameter, ...] = ()
    same_size: bool | None = None


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Run B with and without what run A taught.

    before, after: fit of B; carried: fit of B less the effects that carry over with the amplitudes of A, None without
    any; cross_validation_*: their errors of the cross-validation, m; confirmed: whether all effects that B can judge
    are confirmed, None where it can judge none.
    """

    before: Fit
    after: Fit
    carried: Fit | None
    cross_validation_before: float
    cross_validation_after: float
    cross_validation_carried: float
    effects: tuple[CheckedEffect, ...]
    confirmed: bool | None


def refuse_same(run: Run, searched: Run) -> None:
    """Raise InvalidData where a run has the readings of the searched one, under whatever name."""
    here, there = (one.centre[np.argsort(one.cells, kind='stable')] for one in (run, searched))
    if is_once_more(here, there):
        raise InvalidData(f'{run.source}: expected another run as a check, found {in_common(here, there)} of '
                          f'{min(run.size, searched.size)} readings that are those of {searched.source}, in which the '
                          'effects were found; measure again')


def cross_check(run: Run, model: Model, learnt: Sequence[Learnt]) -> CrossCheck:
    """Return the CrossCheck on run B of effects that were learnt on another one; model: of B without them.

    Raises NotDeterminable where B does not determine the model.
    """
    before = fit(run, model, choose_settings(run, model))
    refused = [_refusal(effect, fitted, before) for effect, fitted in learnt]
    usable = [pair for pair, words in zip(learnt, refused) if words is None]
    after = _with(before, usable)
    if after.rms >= NOISELESS and (noise := noise_beside(after).found()[0].noise).kinds:
        before = fit(run, model, choose_settings(run, model, noise), noise)
        after = _with(before, usable)

    error, error_with = cross_validation_rms(before), cross_validation_rms(after)
    carried = _carried(before, usable)
    judged = iter(_judge(before, after, usable, error_with))
    effects = tuple(next(judged) if words is None else
                    CheckedEffect(effect.name, fitted.setting, effect.carries, *words, learnt=fitted.parameters)
                    for (effect, fitted), words in zip(learnt, refused))
    judged_ones = [one.outcome for one in effects if one.outcome in (CheckOutcome.CONFIRMED, CheckOutcome.NOT_SEEN)]
    confirmed = all(one is CheckOutcome.CONFIRMED for one in judged_ones) if judged_ones else None
    return CrossCheck(before, after, carried, error, error_with,
                      cross_validation_rms(carried) if carried else float('nan'),
                      effects, confirmed)


def _refusal(effect: Effect, fitted: FittedEffect, before: Fit) -> tuple[CheckOutcome, str] | None:
    if effect.carries == 'nothing':
        return CheckOutcome.EVENT, ''
    reason = effect.unavailable(before.run)
    if reason:
        return CheckOutcome.NOT_JUDGED, reason
    if not _visible_share(effect, fitted.setting, before) >= HIDDEN_SHARE:
        return CheckOutcome.HIDDEN, ''
    return None


def _visible_share(effect: Effect, setting: Setting, before: Fit) -> float:
    rows = before.joint.residual(columns_of(CauseFamily(effect, effect.name, (setting,)), before.run, setting))
    return sensitivity(rows)


def _with(before: Fit, pairs: Sequence[Learnt]) -> Fit:
    """Return the fit with the effects of some pairs more, at the settings of A."""
    terms = [Term(effect, fitted.setting) for effect, fitted in pairs]
    model = replace(before.model, terms=(*before.model.terms, *terms), repeated=True)
    return fit(before.run, model, (*before.settings, *(term.fixed for term in terms)), before.noise)


def _carried(before: Fit, pairs: Sequence[Learnt]) -> Fit | None:
    """Return the fit of the run less what carries over with A's amplitudes, None without any."""
    moved = [_displacement(before.run, *pair) for pair in pairs if pair[0].carries == 'all']
    if not moved:
        return None
    run = before.run
    run = run.replace(centre=run.centre - sum(moved), written_steps=run.steps)
    return fit(run, before.model, before.settings, before.noise)


def _displacement(run: Run, effect: Effect, fitted: FittedEffect) -> Floats:
    columns = effect.columns(run, fitted.setting)
    return np.asarray(columns @ np.array([parameter.value for parameter in fitted.parameters[:columns.shape[-1]]]))


def _judge(before: Fit, after: Fit, pairs: Sequence[Learnt], error_with: float) -> list[CheckedEffect]:
    """Return the CheckedEffect of each pair, judged by leaving it out of all."""
    out = []
    for place, (effect, fitted) in enumerate(pairs):
        without = _with(before, [*pairs[:place], *pairs[place + 1:]])
        p, error_without = f_test(without, after), cross_validation_rms(without)
        found = after.effects[len(before.effects) + place]

        moved = after.joint.space.residual(_displacement(before.run, effect, fitted)[None])
        strength = float(np.linalg.norm(moved)) / after.sigma
        outcome = (CheckOutcome.CONFIRMED if p < UNLIKELY / len(pairs) and error_with < error_without else
                   CheckOutcome.TOO_WEAK if strength < DETECTABLE else CheckOutcome.NOT_SEEN)

        same = _same_size(fitted, found) if effect.carries == 'all' and outcome is CheckOutcome.CONFIRMED else None
        share = _visible_share(effect, fitted.setting, before)
        out.append(CheckedEffect(effect.name, fitted.setting, effect.carries, outcome, '', strength, share, p,
                                 without.rms, after.rms, error_without, error_with, fitted.parameters,
                                 found.parameters, same))
    return out


def _same_size(learnt: FittedEffect, found: FittedEffect) -> bool:
    """Return whether amplitudes of two runs agree: chi square of their differences, 1 %."""
    squares = [(a.value - b.value)**2 / (a.u**2 + b.u**2) for a, b in zip(learnt.parameters, found.parameters)
               if a.name == b.name and np.isfinite(a.u + b.u) and a.u + b.u > 0]
    return bool(scipy.special.chdtrc(max(len(squares), 1), sum(squares)) > UNLIKELY)
