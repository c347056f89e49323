# SPDX-License-Identifier: Apache-2.0
"""Trends for people and programs: changes with their dates, when tolerances are reached, the next calibration."""

import datetime
from collections.abc import Mapping, Sequence

from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.errors import counted
from rosette_ros.core.records import SI_UNITS
from rosette_ros.core.trend import LEAST_LINE, Event, Forecast, Shift
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.table_format import Table, words

Dates = Sequence[datetime.datetime]
YEAR = 365.25  # days
MOST_TOLD = 4
"""Quantities of a change that the table names."""


def events_table(events: Sequence[Event], dates: Dates, runs: Sequence[str],
                 exchanged: Sequence[Mapping[str, tuple[str, str]]]) -> Table:
    """Return the changes: between which runs, what has changed, by how much.

    exchanged: for each change the devices with another serial number from then on."""
    return Table('events', 'Changes' if events else 'No change', (
        words('between', 'between', [f'{dates[event.earliest - 1]:%Y-%m-%d} and {dates[event.latest]:%Y-%m-%d}'
                                     for event in events]),
        words('run', 'first run after it', [runs[event.run] for event in events]),
        words('what', 'what', [text.names(event.owners) for event in events]),
        words('exchanged', 'serial number', ['; '.join(f'{device}: {old or "-"} → {new or "-"}'
                                                       for device, (old, new) in one.items()) for one in exchanged]),
        words('by', 'by (new − old)', [_told(event) for event in events])),
        note='Size in units of its expanded uncertainty U (k = 2), with its value where it is one number; that scatter '
             'alone shows a change has a probability of at most 0.2 %, counting all quantities and runs.'
        if events else '')


def _told(event: Event) -> str:
    told = [f'{step.series.name} {size_words(step)}' for step in event.steps[:MOST_TOLD]]
    rest = len(event.steps) - MOST_TOLD
    return ', '.join(told) + (f' and {rest} more' if rest > 0 else '')


def residual_words(course: tuple[float, float]) -> str:
    """Return in a sentence from where to where the residual has moved, m, and what that means."""
    before, after = course
    moved = ('grew', 'more', 'less well') if after > before else ('fell', 'less', 'better')
    return (f'The residual {moved[0]} from {1e6 * before:.3g} µm to {1e6 * after:.3g} µm, and U with it: readings '
            f'scatter {moved[1]}, or the model fits them {moved[2]}. Nothing of the table follows from that.')


def too_few_words(runs: Mapping[str, int]) -> list[str]:
    """Return in a sentence for each curve with a tolerance why there is no forecast. runs: since its last change."""
    return [f'{curve}: {counted(count, "run")} since its last change, {LEAST_LINE} at different times wanted for a '
            'forecast.' for curve, count in runs.items()]


def size_words(step: Shift) -> str:
    """Return the size of a step in units of its U, with sign and U in brackets where the quantity has one number."""
    words_of_u = f'{step.strength / COVERAGE_FACTOR:.1f} U'
    if step.size.size > 1:
        return words_of_u
    factor, unit = text.scale_of(step.series.unit)
    expanded = COVERAGE_FACTOR * factor * float(step.u[0])
    places = text.decimals(expanded)
    return f'{words_of_u} ({text.signed(factor * float(step.size[0]), places)} ± {text.fixed(expanded, places)} {unit})'


def slope_words(one: Forecast, curve: str) -> str:
    """Return the slope of a curve with its U, per year."""
    factor, unit = text.scale_of(SI_UNITS[curve])
    year = factor * YEAR
    return f'{year * one.slope:+.3f} ± {COVERAGE_FACTOR * year * one.slope_u:.3f} {unit}'


def forecast_table(forecasts: Mapping[str, Forecast], tolerances: Mapping[str, float],
                   last: datetime.datetime) -> Table:
    """Return when each error reaches its tolerance, and the proposed interval."""
    curves = list(forecasts)
    made = [forecasts[curve] for curve in curves]
    return Table('forecast', 'When tolerances are reached', (
        words('error', 'error motion', curves),
        words('slope', 'per year', [slope_words(one, curve) for curve, one in zip(curves, made)]),
        words('expected', 'expected', [
            _date(last, one.expected, 'reached' if one.level >= tolerances[curve] else 'within U')
            for curve, one in zip(curves, made)]),
        words('soonest', 'not before (95 %)', [_date(last, one.soonest, 'now') for one in made]),
        words('interval', 'next calibration within', [f'{one.interval:.0f} d' for one in made])),
        note='The tolerance less U (guard band, ISO 14253-1), by straight lines through the curves since their last '
             'change; within U: neither conformity nor '
             'non-conformity can be proven; the interval is between half and twice the '
             'present one (ILAC-G24, control chart).')


def _date(last: datetime.datetime, ahead: float, passed: str) -> str:
    if ahead <= 0:
        return passed
    return 'not in sight' if ahead > 36525 else f'{last + datetime.timedelta(days=ahead):%Y-%m-%d}'
