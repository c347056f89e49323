# SPDX-License-Identifier: Apache-2.0
"""Is what one run taught true in another run that had no part in it?

Effects learnt on run A keep their settings (time constant, period, order ...) on run B; nothing is
searched there. Their amplitudes are fitted to B, which says whether the shape is there. Where physics
says that they stay the same from run to run they are also taken from A as they are, which asks for
everything at once.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special

from rosette_ros.core.atoms import Projection, whiten
from rosette_ros.core.diagnosis import INVISIBLE, held_out_rms
from rosette_ros.core.effects.contract import Setting
from rosette_ros.core.fit import Fit, FittedEffect, fit
from rosette_ros.core.model import Model, Term
from rosette_ros.core.settings import choose_settings
from rosette_ros.core.visibility import DETECTABLE

SURE = 0.01
"""Chance of noise doing as well below which an effect is confirmed, over all that are checked."""
CONFIRMED, NOT_SEEN, HIDDEN, TOO_WEAK, EVENT, NOT_JUDGED = (
    'confirmed', 'not seen', 'hidden', 'too weak', 'event', 'not judged')


@dataclass(frozen=True, eq=False)
class CheckedEffect:
    """One effect of run A on run B.

    carries: as of Effect; outcome: CONFIRMED, NOT_SEEN, HIDDEN (by B's order), TOO_WEAK (the size
    learnt on A would not show in B), EVENT (nothing that comes again) or NOT_JUDGED; reason: in
    words; visible_fraction: in B; p: chance that noise in B does as well; rms and held-out error in
    B without and with it, m, all other checked effects being there; learnt, found: its Parameters
    in A and B; same_size: whether the amplitudes agree within their uncertainties, None where they
    need not.
    """

    name: str
    setting: Setting
    carries: str
    outcome: str
    reason: str
    visible_fraction: float = float('nan')
    p: float = float('nan')
    rms_without: float = float('nan')
    rms_with: float = float('nan')
    held_out_without: float = float('nan')
    held_out_with: float = float('nan')
    learnt: tuple = ()
    found: tuple = ()
    same_size: bool | None = None


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Run B with and without what run A taught.

    before, after: Fit of B; carried: Fit of B from which the effects that carry over were taken
    off with the amplitudes of A, None where none does; held_out_*: error in left-out readings, m;
    confirmed: whether all effects that B can judge are confirmed, None where it can judge none.
    """

    before: Fit
    after: Fit
    carried: Fit | None
    held_out_before: float
    held_out_after: float
    held_out_carried: float
    effects: tuple[CheckedEffect, ...]
    confirmed: bool | None
    text: str


def cross_check(run, model, learnt):
    """Return the CrossCheck on a run of effects that were learnt on another one.

    run: Run B; model: what B is described by without them; learnt: pairs (Effect, FittedEffect).

    Raises NotDeterminable where B cannot tell what the model asks.
    """
    before = fit(run, model, choose_settings(run, model))
    refused = [_refusal(run, effect, fitted, before) for effect, fitted in learnt]
    usable = [pair for pair, words in zip(learnt, refused) if words is None]
    after = _with(before, usable)
    held = [held_out_rms(run, _pinned(one)) for one in (before, after)]
    carried = _carried(before, usable)
    judged = iter(_judge(before, after, usable, held[1]))
    effects = tuple(next(judged) if words is None else _unjudged(effect, fitted, words)
                    for (effect, fitted), words in zip(learnt, refused))
    outcomes = [entry.outcome for entry in effects if entry.outcome in (CONFIRMED, NOT_SEEN)]
    confirmed = all(outcome == CONFIRMED for outcome in outcomes) if outcomes else None
    held_carried = held_out_rms(run, _pinned(carried)) if carried else float('nan')
    return CrossCheck(before, after, carried, *held, held_carried, effects, confirmed,
                      _text(effects, before, after, carried))


def _refusal(run, effect, fitted, before):
    """Return (outcome, words) where an effect cannot be judged on a run, else None."""
    if effect.carries == 'nothing':
        return EVENT, 'an event of the run it was learnt on, which need not come again'
    reason = effect.unavailable(run)
    if reason:
        return NOT_JUDGED, reason
    if not _visible_share(effect, fitted.setting, before) >= INVISIBLE:
        return HIDDEN, 'the order of measurement hides it'
    return None


def _visible_share(effect, setting, before):
    block = np.moveaxis(effect.columns(before.run, setting), -1, 0)
    project = Projection(before.joint, before.run.size)
    return float(whiten(block[None], project)[2][0])


def _unjudged(effect, fitted, words):
    return CheckedEffect(effect.name, fitted.setting, effect.carries, *words,
                         learnt=fitted.parameters)


def _with(before, pairs):
    """Return the Fit with the effects of some pairs more, at the settings of A."""
    model = before.model
    terms = tuple(Term(effect, Setting(fitted.setting)) for effect, fitted in pairs)
    settings = tuple(fitted.setting for _, fitted in pairs)
    return fit(before.run, Model(model.base, (*model.terms, *terms), repeated=True),
               (*before.settings, *settings))


def _pinned(fitted):
    """Return a fit whose settings are taken as known, for the error in left-out readings."""
    terms = tuple(Term(term.effect, Setting(setting))
                  for term, setting in zip(fitted.model.terms, fitted.settings))
    values = {name: getattr(fitted, name) for name in fitted.__dataclass_fields__}
    return Fit(**{**values, 'model': Model(fitted.model.base, terms, repeated=True)})


def _carried(before, pairs):
    """Return the Fit of the run less what carries over with A's amplitudes, None without any."""
    carrying = [pair for pair in pairs if pair[0].carries == 'all']
    if not carrying:
        return None
    run = before.run
    moved = sum(_displacement(run, effect, fitted) for effect, fitted in carrying)
    return fit(run.replace(centre=run.centre - moved), before.model, before.settings)


def _displacement(run, effect, fitted: FittedEffect):
    """Return what an effect of A does to the readings of a run, (N, 3), m."""
    columns = effect.columns(run, fitted.setting)
    amplitude = [parameter.value for parameter in fitted.parameters[:columns.shape[-1]]]
    return columns @ np.array(amplitude)


def _judge(before, after, pairs, held_with):
    """Return the CheckedEffect of each pair, judged by leaving it out of all."""
    own = len(before.effects)
    out = []
    for place, (effect, fitted) in enumerate(pairs):
        without = _with(before, pairs[:place] + pairs[place + 1:])
        extra = after.rank - without.rank
        p = _f_test(without, after, extra)
        held_without = held_out_rms(before.run, _pinned(without))
        found = after.effects[own + place]
        flat = after.joint.space.residual(_displacement(before.run, effect, fitted)[None])
        strength = float(np.linalg.norm(flat)) / after.sigma
        outcome, reason = CONFIRMED, 'it is there'
        if not (p < SURE / len(pairs) and held_with < held_without):
            outcome, reason = NOT_SEEN, 'the error in readings left out does not fall with it'
            if strength < DETECTABLE:
                outcome, reason = TOO_WEAK, (f'at the size learnt it stands {strength:.1f} sigma '
                                             'above the noise here, too little to tell')
        same = _same_size(fitted, found) if effect.carries == 'all' else None
        out.append(CheckedEffect(
            effect.name, fitted.setting, effect.carries, outcome, reason,
            _visible_share(effect, fitted.setting, before), p, without.rms, after.rms,
            held_without, held_with, fitted.parameters, found.parameters,
            same if outcome == CONFIRMED else None))
    return out


def _f_test(without, after, extra):
    if extra <= 0:
        return 1.0
    left = after.rms**2 * after.dof
    fall = without.rms**2 * without.dof - left
    return float(special.fdtrc(extra, after.dof, max(fall, 0.0) / extra / (left / after.dof)))


def _same_size(learnt, found):
    """Return whether amplitudes of two runs agree: chi square of their differences, 1 %."""
    count = min(len(learnt.parameters), len(found.parameters))
    pairs = list(zip(learnt.parameters[:count], found.parameters[:count]))
    chi = sum((a.value - b.value)**2 / (a.u**2 + b.u**2) for a, b in pairs
              if a.name == b.name and np.isfinite(a.u + b.u) and a.u + b.u > 0)
    return bool(special.chdtrc(max(count, 1), chi) > SURE)


def _text(effects, before, after, carried):
    parts = []
    for entry in effects:
        if entry.outcome == CONFIRMED:
            size = {True: ', at the size that was learnt', False: ', with another size',
                    None: ''}[entry.same_size]
            parts.append(f'{entry.name} is confirmed{size}.')
        elif entry.outcome == NOT_SEEN:
            parts.append(f'{entry.name} is not seen: {entry.reason}.')
        else:
            parts.append(f'{entry.name} cannot be checked: {entry.reason}.')
    if any(entry.outcome == CONFIRMED for entry in effects):
        parts.append(f'The residual of this run falls from {before.rms * 1e6:.3g} um to '
                     f'{after.rms * 1e6:.3g} um.')
    if carried is not None:
        parts.append(f'With the amplitudes as they were learnt and nothing fitted it is '
                     f'{carried.rms * 1e6:.3g} um.')
    return ' '.join(parts) or 'Nothing was learnt, so there is nothing to check.'
