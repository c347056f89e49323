# SPDX-License-Identifier: Apache-2.0
"""The picture of a trend: texts that can be read over weeks and years."""

import datetime

import numpy as np
import pytest
from figure_texts import faults, texts_of

from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.trend import Event, Forecast, Shift, TimeSeries
from rosette_ros.presentation.trend_results import changes_of_curves, ranges_over_time

RUNS = 20


def changed(run, *curves):
    """Return a change of the second wave of curves before a run."""
    none = np.zeros((RUNS, 2))
    size, u = np.array([3e-6, 0.0]), np.array([1e-7, 1e-7])
    return Event(run, run, run, tuple(Shift(TimeSeries('table', f'{curve}, 2 per turn', none, none, 'm', curve, 2),
                                            size, u, 0.0) for curve in curves))


TOLERANCES = {'ctx': Tolerance(5e-6, '5', 'µm'), 'ctz': Tolerance(1234.5e-6, '1.2345', 'mm'),
              'crz': Tolerance(2e-6, '2', 'µrad')}


@pytest.fixture(params=[
    (1 / 24, '2024-01-01'), (1, '2023-12-20'), pytest.param((7, '2024-03-03'), marks=pytest.mark.long),
    (30, '2024-01-01'), pytest.param((56.2, '2024-01-01'), marks=pytest.mark.long), (365.25, '2004-01-01')])
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


@pytest.mark.parametrize('events', [[changed(10, 'crz')], [changed(5, 'ctx', 'crz'), changed(12, 'ctz', 'crz')],
                                    [changed(9, *CURVES)]])
def test_what_changed_is_drawn_as_a_curve(dates, events):
    """A panel for each curve that changed, a line for each change, in the unit of the curve, with U."""
    made = changes_of_curves(events, dates)
    assert faults(made) == []
    shown = [panel for panel in made.axes if panel.get_visible()]
    wanted = [curve for curve in CURVES if any(curve in event.curves for event in events)]
    assert [panel.get_title('left')[:3] for panel in shown] == wanted
    for panel, curve in zip(shown, wanted, strict=True):
        assert panel.get_ylabel() == ('µm' if curve[1] == 't' else 'µrad')
        lines = [line for line in panel.lines if len(line.get_xdata()) > 2]
        assert len(lines) == sum(curve in event.curves for event in events) == len(panel.collections)
        assert max(lines[0].get_ydata()) == pytest.approx(3.0)
