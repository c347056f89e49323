# SPDX-License-Identifier: Apache-2.0
"""The pictures of a trend: texts that can be read over weeks and years, lines that are told apart in grey."""

import datetime

import numpy as np
import pytest
from figure_texts import faults, texts_of

from rosette_ros.core.records import CURVES
from rosette_ros.core.trend import Event, Forecast, TimeSeries, control_chart
from rosette_ros.presentation.plots.trend_plots import charts_over_time, events_over_time, ranges_over_time

RUNS = 20
TOLERANCES = {'ctx': 5e-6, 'ctz': 1234.5e-6, 'crz': 2e-6}


def chart(shift=0.0):
    """Return the control chart of noise that is shifted after half of the runs, in standard deviations."""
    values = np.random.default_rng(1).standard_normal(RUNS) + shift * (np.arange(RUNS) >= RUNS // 2)
    return control_chart(1e-6 * values, np.full(RUNS, 1e-6), 1)


@pytest.fixture(params=[(1 / 24, '2024-01-01'), (1, '2023-12-20'), (7, '2024-03-03'), (30, '2024-01-01'),
                        (56.2, '2024-01-01'), (365.25, '2004-01-01')])
def dates(request):
    """Runs every hour to every year; some end at a new year."""
    step, first = request.param
    begin = datetime.datetime.fromisoformat(first)
    return [begin + datetime.timedelta(days=step * run) for run in range(RUNS)]


def test_every_text_can_be_read(dates):
    """Years at the edge, tolerances beyond the axis, panels beside each other."""
    event = Event(10, 10, 10, ())
    charts = [(f'{curve}, peak to valley', chart(20 * (curve == 'crz'))) for curve in CURVES]
    series = TimeSeries('table', 'crz, 2 per turn', 1e-6 * np.ones((RUNS, 1)), 1e-6 * np.ones((RUNS, 1)))
    ones = np.full((RUNS, 6), 1e-6)
    made = {
        'ranges': ranges_over_time(dates, ones, 0.2 * ones, TOLERANCES, [event], {
            'ctz': Forecast(1e-6, 1e-9, 1e-9, 1e3, 1e3, 1e2)}),
        'summary': charts_over_time(dates, charts, 2),
        'harmonics': charts_over_time(dates, charts, 3),
        'control_chart': events_over_time(dates, series, chart(20), 'crz, 2 per turn, cos', [event])}
    assert {name: found for name, one in made.items() if (found := faults(one))} == {}
    assert any('tolerance 1234.5 µm, not drawn' in text for text, _, _ in texts_of(made['ranges']))


def test_the_charts_are_told_apart_in_grey():
    """By their lines: EWMA, CUSUM, limits and alarms."""
    dates = [datetime.datetime(2024, 1, 1 + run) for run in range(RUNS)]
    panel = charts_over_time(dates, [('crz', chart(20))], 1).axes[0]
    assert len({line.get_linestyle() for line in panel.lines}) == len({line.get_label() for line in panel.lines}) == 4
