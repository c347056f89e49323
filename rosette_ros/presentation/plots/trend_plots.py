# SPDX-License-Identifier: Apache-2.0
"""The errors of a table over time with their U, tolerances and changes."""

import datetime
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.records import CURVES, Floats
from rosette_ros.core.trend import Event, Forecast
from rosette_ros.presentation.formatting import curve_scales
from rosette_ros.presentation.plots import plot_style as style

Dates = Sequence[datetime.datetime]
MOST_ROOM = 5.0
"""A tolerance is drawn where it is at most so many times as large as what was measured, else the title tells it."""


def ranges_over_time(dates: Dates, values: Floats, expanded: Floats, tolerances: Mapping[str, float],
                     events: Sequence[Event], forecasts: Mapping[str, Forecast]) -> Figure:
    """Return a figure of the ranges of the six error motions, (m, 6) with U, over the dates."""
    made, panels = style.figure(6.0, 3, 2)
    when = date2num(list(dates))
    for place, curve in enumerate(CURVES):
        panel = panels[place % 3, place // 3]
        factor, unit = curve_scales()[place]
        y, spread = factor * values[:, place], factor * expanded[:, place]
        panel.fill_between(when, y - spread, y + spread, color=style.AFTER, alpha=0.2, linewidth=0,
                           label=f'± U (k = {COVERAGE_FACTOR})')
        panel.plot(when, y, color=style.AFTER, linewidth=1.0, marker='o', markersize=2.5, label='error of a run')
        top = float(np.max(y + spread))
        words = f'{curve}, range'
        if curve in tolerances:
            limit = factor * tolerances[curve]
            if limit > MOST_ROOM * top:
                words += f'; tolerance {limit:.6g} {unit}, not drawn'
            else:
                panel.axhline(limit, color=style.BEFORE, linewidth=1.0, linestyle=style.DASHED, label='tolerance')
                top = max(top, limit)
        if curve in forecasts:
            one = forecasts[curve]
            ahead = np.array([0.0, 0.15 * (np.ptp(when) or 1.0)])
            panel.plot(when[-1] + ahead, factor * (one.level + one.slope * ahead), color=style.GREY, linewidth=1.0,
                       linestyle=':', label='forecast')
        _mark(panel, when, [event for event in events if any(step.series.name.startswith(curve)
                                                             for step in event.steps)])
        panel.set(ylim=(0, 1.1 * top), ylabel=unit)
        panel.set_title(words)
        _time_axis(panel)
    style.legend_of(made, panels.flat)
    return made


def _mark(panel: Axes, when: Floats, events: Sequence[Event]) -> None:
    for event in events:
        panel.axvspan(when[event.earliest - 1], when[event.latest], color=style.BEFORE, alpha=0.35, linewidth=0,
                      label='change between these runs')


def _time_axis(panel: Axes) -> None:
    style.scale(panel)
    locator = AutoDateLocator(minticks=2, maxticks=6)
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    panel.xaxis.set_tick_params(pad=6)
