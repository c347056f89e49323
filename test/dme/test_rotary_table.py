# SPDX-License-Identifier: Apache-2.0
"""Which angles a table is sent through."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.dme.dme_settings import DmeTableSettings
from rosette_ros.dme.rotary_table import TableState, commanded, turning_steps, unwrapped

FREE, LIMITED = DmeTableSettings(), DmeTableSettings(limits_deg=(0.0, 360.0))


@pytest.mark.parametrize(('settings', 'now', 'target', 'sense', 'steps'), [
    (FREE, 0, 30, 1, [30]), (FREE, 0, 30, -1, [-110, -220, -330]), (FREE, 330, 0, 1, [360]), (FREE, 30, 30, 1, []),
    (FREE, 350, 10, 0, [370]), (FREE, 90, 90.01, -1, []), (LIMITED, 330, 0, 1, [360]), (LIMITED, 0, 30, -1, [40, 30]),
    (LIMITED, 360, 240, 1, [230, 240]), (LIMITED, 5, 0, -1, [0]), (LIMITED, 360, 5, 1, [0, 5]),
])
def test_steps(settings, now, target, sense, steps):
    """Short ones, the last in the wanted sense; a table with limits turns back."""
    found = turning_steps(settings, TableState(now, sense), target, sense)
    assert found[-len(steps):] == pytest.approx(steps, abs=1e-3) if steps else found == []


@pytest.mark.parametrize(('settings', 'now', 'known', 'sense', 'steps'), [
    (FREE, 30, 1, -1, [60, 30]), (FREE, 30, 0, 1, [0, 30]), (FREE, 390.01, -1, 1, [360, 390]), (FREE, 30, -1, 0, []),
    (LIMITED, 0, 0, 1, [110, 220, 330, 360]), (LIMITED, 0, 1, -1, [30, 0]),
    (DmeTableSettings(turn='none'), 0, 0, 1, [])])
def test_a_table_that_stands_there_comes_again(settings, now, known, sense, steps):
    """From one step before, unless it is known to have come so; a table with limits from where it can."""
    assert turning_steps(settings, TableState(now, known), now % 360, sense) == pytest.approx(steps, abs=0.02)


@given(st.floats(-1000, 1000), st.integers(0, 71), st.sampled_from([-1, 1]), st.sampled_from([FREE, LIMITED]))
def test_laws_of_turning(now, place, sense, settings):
    """It ends at the target, in the wanted sense, by steps below 180 degrees, within the limits."""
    now = now % 360 if settings.limits_deg else now
    try:
        steps = turning_steps(settings, TableState(now, sense), 5.0 * place, sense)
    except InvalidPlan as error:
        assert place == 0 and settings.limits_deg and 'expected a way there' in str(error)
        return
    if steps:
        way = [now, *steps]
        assert (way[-1] - 5.0 * place) % 360 == pytest.approx(0, abs=1e-6) or (
            way[-1] - 5.0 * place) % 360 == pytest.approx(360, abs=1e-6)
        assert (way[-1] - way[-2]) * sense > 0
        assert max(abs(a - b) for a, b in pairwise(way)) < 180
        if settings.limits_deg:
            assert all(-1e-6 <= one <= 360 + 1e-6 for one in steps)


@pytest.mark.parametrize(('settings', 'angle', 'value'), [
    (FREE, 390, 30), (FREE, -30, 330), (LIMITED, 360, 360), (DmeTableSettings(reading='cumulative'), 390, 390),
    (DmeTableSettings(sign=-1, zero_deg=10.0), 30, 340)])
def test_commanded(settings, angle, value):
    """R as the server counts it, and back."""
    assert commanded(settings, angle) == pytest.approx(value)
    assert unwrapped(settings, value, angle + 50) == pytest.approx(angle)


def test_a_way_that_there_is_not():
    """In words."""
    settings = DmeTableSettings(limits_deg=(0.0, 359.9995), zero_deg=0.0003)
    with pytest.raises(InvalidPlan, match='table angle 359.999 deg: expected a way there clockwise within R 0 .. 360'):
        turning_steps(settings, TableState(300, -1), 359.9989, -1)
