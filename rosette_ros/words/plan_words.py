# SPDX-License-Identifier: Apache-2.0
"""Plans side by side, in words."""

from collections.abc import Callable, Mapping, Sequence

from rosette_ros.core.planning.plan_comparison import Outlook, PlanRemark, better
from rosette_ros.core.run.errors import counted
from rosette_ros.words.effect_words import names

MOST_LISTED_EFFECTS = 8


def better_words(plans: Sequence[Outlook]) -> tuple[str, ...]:
    """Return in sentences which of several plans is better in which respect."""
    return tuple(_SAYS[one.kind](**one.numbers) for one in better(plans))


def _best(what: str, form: Callable[[float], str], value: float, best: Sequence[str],
          others: Sequence[tuple[str, float]]) -> str:
    if not others:
        return f'{what}: all alike ({form(value)}).'
    rest = '; '.join(f'{name} {form(one)}' for name, one in others)
    return f'{what}: best {"is" if len(best) == 1 else "are"} {_listed(best)} ({form(value)}); {rest}.'


def _left_out(plan: str, number: int, what: str) -> str:
    return f'{plan} does not measure the deviations of {counted(number, what)}.'


def _listed(every: Sequence[str]) -> str:
    more = len(every) - MOST_LISTED_EFFECTS
    return f'{", ".join(every[:MOST_LISTED_EFFECTS])} and {more} more' if more > 0 else names(every)


_SAYS: Mapping[str, Callable[..., str]] = {
    PlanRemark.UNCERTAINTY: lambda **numbers: _best(
        'Uncertainty of the curves, relative to a complete run', '{:.2f}'.format, **numbers),
    PlanRemark.TIME: lambda **numbers: _best('Time', lambda seconds: f'{seconds / 3600:.2f} h', **numbers),
    PlanRemark.EFFECTS: lambda judged, **numbers: _best(
        f'Effects shown well, of {judged}', '{:.0f}'.format, **numbers),
    PlanRemark.SHOWN_BY_ONE: lambda plan, effects: f'Only {plan} shows {_listed(effects)} well.',
    PlanRemark.SHOWN_BY_NONE: lambda effects: f'None shows {_listed(effects)} well.',
    PlanRemark.BALL_PLACES_LEFT_OUT: lambda plan, number: _left_out(plan, number, 'ball place'),
    PlanRemark.CMM_POSITIONS_LEFT_OUT: lambda plan, number: _left_out(plan, number, 'CMM position')}
