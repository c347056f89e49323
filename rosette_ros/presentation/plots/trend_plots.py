# SPDX-License-Identifier: Apache-2.0
"""The errors of a table over time with their U, tolerances and changes, and the control chart of what moved most."""

import datetime
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.records import CURVES, Floats
from rosette_ros.core.trend import Chart, Event, Forecast, TimeSeries
from rosette_ros.presentation.formatting import CURVE_UNITS
from rosette_ros.presentation.plots import plot_style as style

Dates = Sequence[datetime.datetime]
MOST_ROOM = 5.0
"""A tolerance is drawn where it is at most so many times as large as what was measured, else the title tells it."""
FARTHEST = 4.0
"""Control charts show so many times their limits: a plate that was exchanged lies far beyond."""


def ranges_over_time(dates: Dates, values: Floats, expanded: Floats, tolerances: Mapping[str, float],
                     events: Sequence[Event], forecasts: Mapping[str, Forecast]) -> Figure:
    """Return a figure of the six errors (peak to valley), (m, 6) with U, over the dates."""
    made = style.figure(6.0, left=0.088, bottom=0.06, right=0.975, top=0.95, wspace=0.2, hspace=0.42)
    panels = style.panels(made, 3, 2)
    when = date2num(list(dates))
    for place, curve in enumerate(CURVES):
        panel = panels[place % 3, place // 3]
        y, spread = 1e6 * values[:, place], 1e6 * expanded[:, place]
        panel.fill_between(when, y - spread, y + spread, color=style.AFTER, alpha=0.2, linewidth=0,
                           label=f'± U (k = {COVERAGE_FACTOR})')
        panel.plot(when, y, color=style.AFTER, linewidth=1.0, marker='o', markersize=2.5, label='error of a run')
        top = float(np.max(y + spread))
        words = f'{curve}, peak to valley'
        if curve in tolerances:
            limit = 1e6 * tolerances[curve]
            if limit > MOST_ROOM * top:
                words += f'; tolerance {limit:.6g} {CURVE_UNITS[place]}, not drawn'
            else:
                panel.axhline(limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED, label='tolerance')
                top = max(top, limit)
        if curve in forecasts:
            one = forecasts[curve]
            ahead = np.array([0.0, 0.15 * (np.ptp(when) or 1.0)])
            panel.plot(when[-1] + ahead, 1e6 * (one.level + one.slope * ahead), color=style.GREY, linewidth=1.0,
                       linestyle=':', label='forecast')
        _mark(panel, when, [event for event in events if any(step.series.name.startswith(curve)
                                                             for step in event.steps)])
        panel.set(ylim=(0, 1.1 * top), ylabel=CURVE_UNITS[place])
        style.title(panel, words, fontsize=style.TEXT)
        _time_axis(panel)
    style.legend_of(made, panels.flat)
    return made


def events_over_time(dates: Dates, series: TimeSeries, chart: Chart, name: str, events: Sequence[Event]) -> Figure:
    """Return the control chart of one component of a quantity, in the runs that have it: deviations, EWMA with its
    limits, CUSUM of both senses. dates: of all runs; name: of the component."""
    made = style.figure(3.6, left=0.075, bottom=0.1, right=0.975, top=0.92, wspace=0.2, hspace=0.45)
    panels = style.panels(made, 2, 1)
    every = date2num(list(dates))
    when = every[np.all(np.isfinite(series.values), axis=1)]
    above, below = panels[:, 0]
    edge = FARTHEST * float(np.max(chart.ewma_limit))
    above.plot(when, chart.z, color=style.GREY, linewidth=0, marker='o', markersize=2.5, label='deviation of a run')
    if np.any(far := np.abs(chart.z) > edge):
        above.plot(when[far], np.clip(chart.z[far], -edge, edge), color=style.GREY, linewidth=0, marker='D',
                   markersize=4, label='deviation beyond the axis')
    above.plot(when, chart.ewma, color=style.AFTER, linewidth=1.4, label='EWMA')
    for sign in (-1, 1):
        above.plot(when, sign * chart.ewma_limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED,
                   label='limit of EWMA, of CUSUM')
    _scale_to(above, [chart.z, chart.ewma, chart.ewma_limit], edge)
    style.title(above, f'{name}: deviation from the runs before, in standard deviations')
    below.plot(when, chart.high, color=style.COLOURS[2], linewidth=1.4, label='CUSUM upwards')
    below.plot(when, -chart.low, color=style.COLOURS[3], linewidth=1.4, label='CUSUM downwards')
    for sign in (-1, 1):
        below.axhline(sign * chart.cusum_limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED)
    _scale_to(below, [chart.high, chart.low, np.array([chart.cusum_limit])], FARTHEST * chart.cusum_limit)
    style.title(below, 'sum of the deviations beyond the allowance, in standard deviations')
    for panel in (above, below):
        _mark(panel, every, events)
        _time_axis(panel)
    style.legend_of(made, panels.flat)
    return made


def charts_over_time(dates: Dates, charts: Sequence[tuple[str, Chart]], columns: int) -> Figure:
    """Return small control charts side by side, by the quantity's name: EWMA and the larger CUSUM in units of their
    limits, of each component (cos, then sin); beyond ± 1 a chart leaves its limits, beyond ± FARTHEST its panel."""
    names = list(dict.fromkeys(name for name, _ in charts))
    rows = -(-len(names) // columns)
    height = 0.4 + rows
    made = style.figure(height, left=0.05, bottom=0.42 / height, right=0.975, top=1 - 0.25 / height, wspace=0.3,
                        hspace=0.95)
    panels = style.panels(made, rows, columns)
    when = date2num(list(dates))
    for place, name in enumerate(names):
        panel = panels[place // columns, place % columns]
        own = [chart for other, chart in charts if other == name]
        for part, chart in enumerate(own):
            above, which = chart.high >= chart.low, (', cos', ', sin')[part] * (len(own) > 1)
            panel.plot(when, chart.ewma / chart.ewma_limit, color=(style.AFTER, style.COLOURS[4])[part],
                       linewidth=1.0, label=f'EWMA over its limit{which}')
            panel.plot(when, np.where(above, chart.high, -chart.low) / chart.cusum_limit,
                       color=style.COLOURS[2 + part], linewidth=1.2, linestyle='-.',
                       label=f'larger CUSUM over its limit{which}')
            for alarm in chart.alarms[:1]:
                panel.axvline(when[alarm], color=style.BEFORE, linewidth=1.0, linestyle=':', label='first run beyond')
        for sign in (-1, 1):
            panel.axhline(sign, color=style.BEFORE, linewidth=0.8, linestyle=style.DASHED, label='limit')
        _scale_to(panel, [np.array([1.2]), *(np.max(np.abs([one.ewma / one.ewma_limit, one.high / one.cusum_limit,
                                                            one.low / one.cusum_limit]), 0) for one in own)], FARTHEST)
        style.title(panel, name)
        _time_axis(panel, 5)
    for place in range(len(names), rows * columns):
        panels[place // columns, place % columns].set_visible(False)
    style.legend_of(made, panels.flat)
    return made


def _scale_to(panel: Axes, shown: Sequence[Floats], most: float) -> None:
    """Set the y axis to both sides of zero, as far as what is shown, but no farther than `most`."""
    edge = 1.1 * min(most, max(float(np.max(np.abs(values))) for values in shown))
    panel.set_ylim(-edge, edge)


def _mark(panel: Axes, when: Floats, events: Sequence[Event]) -> None:
    for event in events:
        panel.axvspan(when[event.earliest - 1], when[event.latest], color=style.BEFORE, alpha=0.35, linewidth=0,
                      label='change between these runs')


def _time_axis(panel: Axes, most: int = 6) -> None:
    style.scale(panel)
    locator = AutoDateLocator(minticks=2, maxticks=most)
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    panel.xaxis.set_tick_params(pad=6)
    panel.xaxis.offsetText.set_fontsize(style.SMALL)
