# SPDX-License-Identifier: Apache-2.0
"""The errors of a table over time with their U, tolerances and changes, and the control chart of what moved most."""

import datetime
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from rosette_ros.core.records import CURVES, Floats
from rosette_ros.core.trend import Chart, Event, Forecast
from rosette_ros.presentation.formatting import CURVE_UNITS
from rosette_ros.presentation.plots import plot_style as style

Dates = Sequence[datetime.datetime]


def ranges_over_time(dates: Dates, values: Floats, expanded: Floats, tolerances: Mapping[str, float],
                     events: Sequence[Event], forecasts: Mapping[str, Forecast]) -> Figure:
    """Return a figure of the six errors (peak to valley), (m, 6) with U, over the dates."""
    made = style.figure(6.0)
    panels = style.panels(made, 3, 2)
    made.subplots_adjust(0.075, 0.06, 0.975, 0.95, 0.2, 0.42)
    when = date2num(list(dates))
    for place, curve in enumerate(CURVES):
        panel = panels[place % 3, place // 3]
        y, spread = 1e6 * values[:, place], 1e6 * expanded[:, place]
        panel.fill_between(when, y - spread, y + spread, color=style.AFTER, alpha=0.2, linewidth=0)
        panel.plot(when, y, color=style.AFTER, linewidth=1.0, marker='o', markersize=2.5)
        top = float(np.max(y + spread))
        if curve in tolerances:
            limit = 1e6 * tolerances[curve]
            panel.axhline(limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED)
            top = max(top, min(limit, 3 * top))
        if curve in forecasts:
            one = forecasts[curve]
            ahead = np.array([0.0, 0.15 * (np.ptp(when) or 1.0)])
            panel.plot(when[-1] + ahead, y[-1] + 1e6 * one.slope * ahead, color=style.GREY, linewidth=1.0,
                       linestyle=':')
        _mark(panel, when, [event for event in events if any(step.series.name.startswith(curve)
                                                             for step in event.steps)])
        panel.set_ylim(0, 1.1 * top)
        style.title(panel, f'{curve}, {CURVE_UNITS[place]}, peak to valley')
        _time_axis(panel)
    return made


def events_over_time(dates: Dates, chart: Chart, name: str, events: Sequence[Event]) -> Figure:
    """Return the control chart of one component: deviations, EWMA with its limits, CUSUM of both senses."""
    made = style.figure(3.6)
    panels = style.panels(made, 2, 1)
    made.subplots_adjust(0.075, 0.1, 0.975, 0.92, 0.2, 0.45)
    when = date2num(list(dates))
    above, below = panels[:, 0]
    above.plot(when, chart.z, color=style.GREY, linewidth=0, marker='o', markersize=2.5, label='deviation')
    above.plot(when, chart.ewma, color=style.AFTER, linewidth=1.4, label='EWMA')
    for sign in (-1, 1):
        above.plot(when, sign * chart.ewma_limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED)
    style.title(above, f'{name}: deviation from the runs before, in standard deviations; EWMA and its limits')
    below.plot(when, chart.high, color=style.AFTER, linewidth=1.4)
    below.plot(when, -chart.low, color=style.COLOURS[2], linewidth=1.4)
    for sign in (-1, 1):
        below.axhline(sign * chart.cusum_limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED)
    style.title(below, 'CUSUM upwards and downwards, and its limits')
    for panel in (above, below):
        _mark(panel, when, events)
        _time_axis(panel)
    return made


def charts_over_time(dates: Dates, charts: Sequence[tuple[str, Chart]], columns: int) -> Figure:
    """Return small control charts side by side, by the quantity's name: EWMA and the larger CUSUM in units of their
    limits, of each component; beyond ± 1 a chart leaves its limits."""
    names = list(dict.fromkeys(name for name, _ in charts))
    rows = -(-len(names) // columns)
    made = style.figure(0.4 + 0.95 * rows)
    panels = style.panels(made, rows, columns)
    made.subplots_adjust(0.05, 0.35 / (0.4 + 0.95 * rows), 0.985, 1 - 0.25 / (0.4 + 0.95 * rows), 0.3, 0.75)
    when = date2num(list(dates))
    for place, name in enumerate(names):
        panel = panels[place // columns, place % columns]
        own = [chart for other, chart in charts if other == name]
        for chart in own:
            above = chart.high >= chart.low
            panel.plot(when, chart.ewma / chart.ewma_limit, color=style.AFTER, linewidth=1.0)
            panel.plot(when, np.where(above, chart.high, -chart.low) / chart.cusum_limit, color=style.COLOURS[2],
                       linewidth=1.0)
            for alarm in chart.alarms[:1]:
                panel.axvline(when[alarm], color=style.BEFORE, linewidth=1.0, linestyle=':')
        for sign in (-1, 1):
            panel.axhline(sign, color=style.BEFORE, linewidth=0.8, linestyle=style.DASHED)
        most = max(1.2, *(float(np.max(np.abs(panel.get_lines()[line].get_ydata()))) for line in range(2 * len(own))))
        panel.set_ylim(-1.1 * most, 1.1 * most)
        style.title(panel, name)
        _time_axis(panel, 5)
    for place in range(len(names), rows * columns):
        panels[place // columns, place % columns].set_visible(False)
    return made


def _mark(panel: Axes, when: Floats, events: Sequence[Event]) -> None:
    for event in events:
        panel.axvspan(when[event.earliest - 1], when[event.latest], color=style.BEFORE, alpha=0.35, linewidth=0)


def _time_axis(panel: Axes, most: int = 6) -> None:
    style.scale(panel)
    locator = AutoDateLocator(minticks=2, maxticks=most)
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))
