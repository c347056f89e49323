# SPDX-License-Identifier: Apache-2.0
"""Trends as tables, picture and page: changes with their dates, when tolerances are reached, the next calibration."""

import datetime
from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from rosette_ros.core.run.errors import counted
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import CURVES, SI_UNITS, Floats
from rosette_ros.core.table.trend import LEAST_LINE, Event, Forecast, Shift
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import Conformity
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.identity_words import simulated_words
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.presentation.report.page_parts import PAGES, inline_svgs
from rosette_ros.presentation.report.provenance import software
from rosette_ros.presentation.table_format import Table, words
from rosette_ros.words.effect_words import decimals, fixed, names, scale_of, tolerance_words

Dates = Sequence[datetime.datetime]
YEAR = 365.25  # days
MOST_TOLD = 4
"""Quantities of a change that the table names."""
MOST_ROOM = 5.0
"""A tolerance is drawn where it is at most so many times as large as what was measured, else the title tells it."""


def events_table(events: Sequence[Event], dates: Dates, runs: Sequence[str],
                 exchanged: Sequence[Mapping[str, tuple[str, str]]]) -> Table:
    """Return the changes: between which runs, what has changed, by how much.

    exchanged: for each change the devices with another serial number from then on."""
    return Table('events', 'Changes' if events else 'No change', (
        words('between', 'between', [between_words(event, dates) for event in events]),
        words('run', 'first run after it', [runs[event.run] for event in events]),
        words('what', 'what', [names(event.owners) for event in events]),
        words('exchanged', 'serial number', ['; '.join(f'{device}: {old or "-"} → {new or "-"}'
                                                       for device, (old, new) in one.items()) for one in exchanged]),
        words('by', 'by (new − old)', [_told(event) for event in events])),
        note='With U (k = 2); of a wave the change of its amplitude and phase together, of a place how far it moved. '
             'That scatter alone shows a change has a probability of at most 0.2 %, counting all quantities and runs.'
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
    """Return the size of a step with its U: with its sign where the quantity is one number, else its length."""
    (factor, unit), (size, u) = scale_of(step.series.unit), step.amount
    expanded = COVERAGE_FACTOR * factor * u
    places = decimals(expanded)
    said = text.signed(factor * size, places) if step.size.size == 1 else fixed(factor * size, places)
    return f'{said} ± {fixed(expanded, places)} {unit}'.rstrip()


def slope_words(one: Forecast, curve: str) -> str:
    """Return the slope of a curve with its U, per year."""
    factor, unit = scale_of(SI_UNITS[curve])
    year = factor * YEAR
    return f'{year * one.slope:+.3f} ± {COVERAGE_FACTOR * year * one.slope_u:.3f} {unit}'


def forecast_table(forecasts: Mapping[str, Forecast], decided: Mapping[str, Conformity],
                   last: datetime.datetime) -> Table:
    """Return when each error reaches its tolerance, and the proposed interval; decided: on the last run, by curve."""
    curves = list(forecasts)
    made = [forecasts[curve] for curve in curves]
    return Table('forecast', 'When tolerances are reached', (
        words('error', 'error motion', curves),
        words('slope', 'per year', [slope_words(one, curve) for curve, one in zip(curves, made)]),
        words('expected', 'expected', [
            _date(last, one.expected, 'now' if decided[curve] is Conformity.CONFORMS else decided[curve].value)
            for curve, one in zip(curves, made)]),
        words('soonest', 'not before (95 %)', [_date(last, one.soonest, 'now') for one in made]),
        words('interval', 'next calibration within', [f'{one.interval:.0f} d' for one in made])),
        note='The tolerance less U (guard band, ISO 14253-1), by straight lines through the curves since their last '
             'change; not decidable: neither conformity nor non-conformity can be proven; the interval is between '
             'half and twice the present one (ILAC-G24, control chart).')


def _date(last: datetime.datetime, ahead: float, passed: str) -> str:
    if ahead <= 0:
        return passed
    return 'not in sight' if ahead > 36525 else f'{last + datetime.timedelta(days=ahead):%Y-%m-%d}'


def ranges_over_time(dates: Dates, values: Floats, expanded: Floats, tolerances: Mapping[str, Tolerance],
                     events: Sequence[Event], forecasts: Mapping[str, Forecast]) -> Figure:
    """Return a figure of the ranges of the six error motions, (m, 6) with U, over the dates."""
    made, panels = style.figure(6.0, 3, 2)
    when = date2num(list(dates))
    for place, curve in enumerate(CURVES):
        panel = panels[place % 3, place // 3]
        factor, unit = text.curve_scales()[place]
        y, spread = factor * values[:, place], factor * expanded[:, place]
        panel.fill_between(when, y - spread, y + spread, color=style.AFTER, alpha=0.2, linewidth=0,
                           label=f'± U (k = {COVERAGE_FACTOR})')
        panel.plot(when, y, color=style.AFTER, linewidth=1.0, marker='o', markersize=2.5, label='error of a run')
        top = float(np.max(y + spread))
        words = f'{curve}, range'
        if curve in tolerances:
            limit = factor * tolerances[curve]
            if limit > MOST_ROOM * top:
                words += f'; tolerance {tolerance_words(tolerances[curve])}, not drawn'
            else:
                panel.axhline(limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED, label='tolerance')
                top = max(top, limit)
        if curve in forecasts:
            one = forecasts[curve]
            ahead = np.array([0.0, 0.15 * (np.ptp(when) or 1.0)])
            panel.plot(when[-1] + ahead, factor * (one.level + one.slope * ahead), color=style.GREY, linewidth=1.0,
                       linestyle=':', label='forecast')
        for event in events:
            if curve in event.curves:
                panel.axvspan(when[event.earliest - 1], when[event.latest], color=style.BEFORE, alpha=0.35, linewidth=0,
                              label='change between these runs')
        panel.set(ylim=(0, 1.1 * top), ylabel=unit)
        panel.set_title(words)
        _time_axis(panel)
    style.legend_of(made, panels.flat)
    return made


def changes_of_curves(events: Sequence[Event], dates: Dates) -> Figure:
    """Return a figure of what changed of the error motions at the events, new less old, against the table angle.

    A panel for each curve that changed at all, with a band of U (k = 2); a line for each change of it."""
    changed = [curve for curve in CURVES if any(curve in event.curves for event in events)]
    made, panels = style.figure(0.4 + 1.9 * -(-len(changed) // 2), -(-len(changed) // 2), 2)
    angle = np.deg2rad(np.linspace(0, 360, 181))
    for panel, curve in zip_longest(panels.flat, changed):
        if curve is None:
            panel.set_visible(False)
            continue
        factor, unit = text.curve_scales()[CURVES.index(curve)]
        for place, event in enumerate(events):
            if curve in event.curves:
                value, u = event.difference(curve, angle)
                colour = style.look_of(place)['color']
                panel.fill_between(np.rad2deg(angle), factor * (value - COVERAGE_FACTOR * u),
                                   factor * (value + COVERAGE_FACTOR * u), color=colour, alpha=0.2, linewidth=0)
                panel.plot(np.rad2deg(angle), factor * value, color=colour, linewidth=1.3,
                           label=f'{between_words(event, dates)}, with U (k = {COVERAGE_FACTOR})')
        panel.axhline(0, color=style.INK, linewidth=0.8)
        panel.set(xlim=(0, 360), ylabel=unit, xlabel='table angle in degrees')
        panel.set_title(f'{curve}, new − old')
        style.scale(panel, {degrees: f'{degrees}' for degrees in range(0, 361, 90)})
    style.legend_of(made, panels.flat)
    return made


def between_words(event: Event, dates: Dates) -> str:
    """Return between which dates a change lies."""
    return f'{dates[event.earliest - 1]:%Y-%m-%d} and {dates[event.latest]:%Y-%m-%d}'


def _time_axis(panel: Axes) -> None:
    style.scale(panel)
    locator = AutoDateLocator(minticks=2, maxticks=6)
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    panel.xaxis.set_tick_params(pad=6)


def trend_html(serial: str, model_hash: str, dates: Dates, sentences: Sequence[str], tables: Sequence[Table],
               pictures: Mapping[str, Figure], command: str = '', simulated: Sequence[str] = ()) -> str:
    """Return the trend of a table as one HTML text. sentences: what it says;
    tables: changes, forecast; pictures: by name; simulated: names of the runs that were."""
    return PAGES.get_template('trend.html.j2').render(
        serial=serial, model_hash=model_hash, dates=dates, sentences=sentences,
        tables={table.name: table for table in tables}, pictures=inline_svgs(pictures), command=command,
        simulated=simulated_words(simulated, len(dates)), software=software(), k=COVERAGE_FACTOR,
        iso=text.iso_range(None),
        numbers={name: place for place, name in enumerate(pictures, 1)},
        running=f'Table {serial or "without serial number"}, {len(dates)} runs{" (SIMULATED)" * bool(simulated)}')
