# SPDX-License-Identifier: Apache-2.0
"""What an order of measurement shows and what to measure next, in words."""

from collections.abc import Sequence

from rosette_ros.core.planning.advice import AS_MEASURED, Advice, OrderAdvice
from rosette_ros.core.run.errors import counted
from rosette_ros.core.sight.visibility import GOOD_SHARE, strongest_first
from rosette_ros.words.motion_words import titles

SAME_TIME = 0.1
"""Difference of durations below which two orders take the same time."""


def advice_words(advice: Advice) -> str:
    """Return an advice in sentences."""
    present, best = advice.present, advice.best
    own = 'The order of this run' if present.label == AS_MEASURED else f'Order {present.label}'
    hidden = [name for name in advice.weak if present.shares[name].hidden]
    weak = [name for name in advice.weak if name not in hidden]
    parts = [] if advice.weak else [f'{own} shows every effect of the library.']
    if hidden:
        parts.append(f'{own} cannot show {titles(strongest_first(present.run, hidden))}.')
    if weak:
        every = titles(strongest_first(present.run, weak))
        parts.append(f'Low sensitivity (share not absorbed {_shares(present, weak)}): {every}.')
    if best is not present:
        more = sum(best.share(name) >= GOOD_SHARE > present.share(name) for name in advice.wanted)
        what = counted(more, 'more effect') if more else f'more of {titles([best.worst_effect])}'
        parts.append(f'Order {best.label} shows {what} in {_time(best.duration / present.duration - 1)}.')
    if never := [name for name in advice.wanted if best.shares[name].hidden]:
        parts.append(f'No order shows {titles(never)}: repeat balls after turning the table the other way, or '
                     'check it with another instrument.')
    return ' '.join(parts)


def _shares(order: OrderAdvice, every: Sequence[str]) -> str:
    """Return between which percentages the sensitivity to effects lies."""
    shares = sorted(100 * order.share(name) for name in every)
    return ' to '.join(dict.fromkeys(f'{one:.0f} %' for one in (shares[0], shares[-1])))


def _time(longer: float) -> str:
    if abs(longer) < SAME_TIME:
        return 'the same time'
    return f'{100 * abs(longer):.0f} % {"more" if longer > 0 else "less"} time'
