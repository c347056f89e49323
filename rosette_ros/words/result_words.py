# SPDX-License-Identifier: Apache-2.0
"""What a second run says of effects that were learnt on a first one, in words."""

from rosette_ros.core.diagnosis.second_run import CONFIRMED, NOT_SEEN, CheckedEffect, CrossCheck
from rosette_ros.core.diagnosis.verdict import noise_facts
from rosette_ros.core.number_words import micrometres
from rosette_ros.words.noise_words import noise_words


def check_words(check: CrossCheck) -> str:
    """Return what the second run confirms, and how its residual changes."""
    parts = list(map(_checked, check.effects))
    if any(one.outcome == CONFIRMED for one in check.effects):
        parts.append(f'The residual of this run falls from {micrometres(check.before.rms)} to '
                     f'{micrometres(check.after.rms)}.')
    if check.carried is not None:
        parts.append('With the amplitudes of the first run, and none fitted, the residual is '
                     f'{micrometres(check.carried.rms)}.')
    if words := '; '.join(noise_words(noise_facts(check.after))):
        parts.append(f'The noise of this run, which all this takes into account, is not white and equal: {words}.')
    return ' '.join(parts) or 'Nothing was learnt, so there is nothing to check.'


def _checked(one: CheckedEffect) -> str:
    if one.outcome == CONFIRMED:
        size = {True: ', with the same size', False: ', with another size', None: ''}[one.same_size]
        return f'{one.name} is confirmed{size}.'
    return f'{one.name} {"is not seen" if one.outcome == NOT_SEEN else "cannot be checked"}: {one.reason}.'
