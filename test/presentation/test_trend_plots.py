# SPDX-License-Identifier: Apache-2.0
"""The picture of a trend: texts that can be read over weeks and years."""

import datetime

import numpy as np
import pytest
from figure_texts import faults, texts_of

from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.table.trend import Event, Forecast
from rosette_ros.presentation.trend_results import ranges_over_time

RUNS = 20
TOLERANCES = {'ctx': Tolerance(5e-6, '5', 'µm'), 'ctz': Tolerance(1234.5e-6, '1.2345', 'mm'),
              'crz': Tolerance(2e-6, '2', 'µrad')}


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
    ones = np.full((RUNS, 6), 1e-6)
    made = ranges_over_time(dates, ones, 0.2 * ones, TOLERANCES, [event], {
        'ctz': Forecast(1e-6, 1e-9, 1e-9, 1e3, 1e3, 1e2)})
    assert faults(made) == []
    assert any('tolerance 1.2345 mm, not drawn' in text for text, _, _ in texts_of(made))
