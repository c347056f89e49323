# SPDX-License-Identifier: Apache-2.0
"""Trends: changes of known date and size are found, histories without one show none, forecasts are right."""

import numpy as np
import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.table.trend import (
    LEAST_RUNS,
    Event,
    Shift,
    TimeSeries,
    course,
    find_events,
    forecast,
    harmonics,
)

WEEK = 7.0


def history(seed, runs=80, changes=(), many=24, season=2.0, wear=3.0, scatter=1.0):
    """Return (days, series, temperature) with u = 1: seasons by temperature, wear, changes of (series, run, size)."""
    rng = np.random.default_rng(seed)
    days = WEEK * np.arange(runs)
    temperature = 20 + season * np.sin(2 * np.pi * days / 365) + 0.05 * rng.standard_normal(runs)
    made = []
    for place in range(many):
        values = scatter * rng.standard_normal((runs, 2)) + 0.5 * (temperature[:, None] - 20)
        values += wear * days[:, None] / days[-1]
        for which, run, size in changes:
            if which == place:
                values[run:] += size * np.array([0.6, 0.8])
        owner = 'table' if place < many // 2 else 'plate'
        made.append(TimeSeries(owner, f'series {place}', values, np.ones((runs, 2))))
    return days, made, temperature


def cut(series, runs):
    """Return the series as they were known after so many runs."""
    return [TimeSeries(one.owner, one.name, one.values[:runs], one.u[:runs]) for one in series]


def test_wear_and_seasons_are_no_change():
    """20 histories with a slope of three standard uncertainties and 2 K of seasons."""
    assert sum(len(find_events(*history(seed))) for seed in range(20)) == 0


def test_a_change_of_3_u_is_found_within_three_runs():
    """U has k = 2, so 6 standard uncertainties: date and owner, of at least 19 in 20."""
    found = 0
    for seed in range(20):
        at = 20 + 3 * seed
        days, series, temperature = history(seed, changes=[(3, at, 6.0)])
        events = find_events(days[:at + 3], cut(series, at + 3), temperature[:at + 3])
        found += len(events) == 1 and abs(events[0].run - at) <= 1 and events[0].owners == ('table',)
    assert found >= 19


def test_the_difference_of_a_curve_is_the_sum_of_its_waves_that_changed():
    """Of 3 cos 2a + 4 sin 2a and cos 3a, with u of both; of another curve and of the plate nothing."""
    def step(owner, size, u, *wave):
        none = np.zeros((8, 2))
        return Shift(TimeSeries(owner, 'name', none, none, 'rad', *wave), np.array(size), np.array(u), 0.0)

    event = Event(4, 4, 4, (step('table', [3.0, 4.0], [0.3, 0.4], 'crz', 2), step('plate', [9.0, 9.0], [1.0, 1.0]),
                            step('table', [1.0, 0.0], [0.2, 0.2], 'crz', 3),
                            step('table', [7.0, 7.0], [1.0, 1.0], 'ctx', 1)))
    angle = np.deg2rad([0.0, 30.0, 45.0, 200.0])
    value, u = event.difference('crz', angle)
    assert value == pytest.approx(3 * np.cos(2 * angle) + 4 * np.sin(2 * angle) + np.cos(3 * angle))
    assert u[0] == pytest.approx(np.hypot(0.3, 0.2)) and u[2] == pytest.approx(np.hypot(0.4, 0.2))
    assert event.curves == {'crz', 'ctx'}


def test_what_changes_together_is_one_event():
    """Of two owners, the stronger first; size and uncertainty are those of the change."""
    changes = [(place, 40, 12.0) for place in (15, 16, 17)] + [(2, 40, 8.0)]
    [event] = find_events(*history(1, changes=changes))
    assert event.run == 40
    assert event.earliest <= 40 <= event.latest
    assert event.owners == ('plate', 'table')
    assert [step.series.name for step in event.steps][-1] == 'series 2'
    for step, size in zip(event.steps, (12.0, 12.0, 12.0, 8.0), strict=True):
        assert np.all(np.abs(step.size - size * np.array([0.6, 0.8])) < 4 * step.u)
        assert step.p < 0.002


@pytest.mark.parametrize('size', [100.0, 1e3, 1e5])
def test_a_plate_that_was_exchanged_is_one_event(size):
    """Far larger than any scatter, so that the probability is 0 at many places: it lies at its date all the same."""
    days, series, temperature = history(4, changes=[(place, 40, size) for place in range(12, 24)] + [(2, 20, 8.0)])
    events = find_events(days, series, temperature)
    assert [(event.run, event.owners) for event in events] == [(20, ('table',)), (40, ('plate',))]
    assert (events[1].earliest, events[1].latest, len(events[1].steps)) == (40, 40, 12)


@pytest.mark.parametrize('unit', [1e-7, 1.0, 1e3, 1e7])
@pytest.mark.parametrize('at', [2, 20, 38])
def test_events_do_not_depend_on_the_unit(unit, at):
    """A time constant of minutes, in seconds, changes as a curve does, in metres."""
    values = np.random.default_rng(3).standard_normal((40, 1))
    values[at:] += 15
    found = find_events(WEEK * np.arange(40), [TimeSeries('effect', 'tau', unit * values, np.full((40, 1), unit))])
    assert [event.run for event in found] == [at]


def test_two_changes_of_one_series_are_two_events():
    """There and back."""
    events = find_events(*history(2, changes=[(5, 30, 9.0), (5, 55, -9.0)]))
    assert [event.run for event in events] == [30, 55]


def test_scatter_beyond_u_is_no_change():
    """Runs that scatter three times as much as they state: limits follow the scatter."""
    assert sum(len(find_events(*history(seed, scatter=3.0))) for seed in range(10)) == 0


def test_few_or_unsorted_runs():
    """Nothing is said of fewer than LEAST_RUNS; the order of time is wanted."""
    days, series, temperature = history(3, runs=LEAST_RUNS - 1, changes=[(0, 4, 100.0)])
    assert find_events(days, series, temperature) == ()
    with pytest.raises(InvalidData, match='expected the runs in the order of time'):
        find_events(days[::-1], series, temperature)


def test_runs_without_a_value_are_left_out():
    """An effect that was in the model later."""
    days, series, temperature = history(4, changes=[(0, 50, 9.0)], many=2)
    series[0].values[:25] = np.nan
    [event] = find_events(days, series, temperature)
    assert event.run == 50


def test_a_tolerance_is_reached_when_the_line_says():
    """1 µm in 100 days from 2 µm to 5 µm; the interval is at most twice the present one, at least half of it."""
    days = 10.0 * np.arange(11)
    values = np.outer(2e-6 + 1e-8 * days, [0.5, 0.0, -0.5])
    made = forecast(days, values, np.full(11, 1e-11), 5e-6)
    assert abs(made.expected - 200.0) < 1e-6
    assert 190 < made.soonest < 200
    assert made.interval == 20.0
    assert forecast(days, values, np.full(11, 1e-11), 2.9e-6).interval == 5.0
    assert forecast(days, values[::-1], np.full(11, 1e-11), 5e-6).expected == np.inf
    beyond = forecast(days, values, np.full(11, 1e-11), 2.5e-6)
    assert (beyond.expected, beyond.soonest) == (0.0, 0.0)
    assert abs(beyond.level - 3e-6) < 1e-12
    assert forecast(days, values[::-1], np.full(11, 1e-11), 1e-6).expected == 0.0, 'it falls, and is above the limit'
    with pytest.raises(InvalidData, match='expected at least 3 runs at different times, found 2'):
        forecast(days[:2], values[:2], np.ones(2), 1.0)


def test_noise_that_grows_is_no_growing_error():
    """Curves of 0.5 µm whose noise grows tenfold: mean slope of 100 histories within 0.06 µm per year, and fewer than
    one in twenty beyond its U; the ranges of the runs grow by 0.7 µm per year."""
    rng = np.random.default_rng(11)
    days = 30.0 * np.arange(20)
    u = np.linspace(0.05, 0.5, 20)
    made = [forecast(days, 0.25 * np.cos(nominal_angles(6)) + u[:, None] * rng.standard_normal((20, 6)),
                     np.sqrt(2) * u, np.inf) for _ in range(100)]
    assert abs(np.mean([365.25 * one.slope for one in made])) < 0.06
    assert np.mean([one.slope > 2 * one.slope_u for one in made]) < 0.05


def test_a_course_beyond_scatter_is_told():
    """From 1 to 3 over 20 runs; not in scatter alone."""
    rng = np.random.default_rng(12)
    days, noise = 30.0 * np.arange(20), 0.2 * rng.standard_normal((40, 20))
    first, last = course(days, np.linspace(1, 3, 20) + noise[0], np.full(20, 0.2))
    assert abs(first - 1) < 0.4 and abs(last - 3) < 0.4
    assert sum(course(days, one, np.full(20, 0.2)) is not None for one in noise) == 0
    assert course(days[:7], np.linspace(1, 3, 7), np.full(7, 0.2)) is None


def test_harmonics_of_a_known_curve():
    """Amplitudes return; u as a Monte Carlo of 4000 draws gives it, within 5 %."""
    angle = nominal_angles(12)
    curve = 3.0 * np.cos(2 * angle) - 2.0 * np.sin(5 * angle)
    values, u = harmonics(angle, curve, np.full(12, 0.5))
    wanted = np.zeros((5, 2))
    wanted[1, 0], wanted[4, 1] = 3.0, -2.0
    assert np.allclose(values, wanted, atol=1e-12)
    rng = np.random.default_rng(9)
    drawn = harmonics(angle, curve + 0.5 * rng.standard_normal((4000, 12)), np.full(12, 0.5))[0]
    assert np.allclose(drawn.std(axis=0) / u, 1.0, atol=0.05)
