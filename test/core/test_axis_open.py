# SPDX-License-Identifier: Apache-2.0
"""A curve in time along x or y: where the order of measurement turns one into the other, that is said."""

from benchmarks.blind.causes_table import displaced
from benchmarks.blind.runs import Plan, noisy
from rosette_ros.core.diagnosis.diagnosis import find


def told(order, seed):
    """Return what is told of a frame that follows a temperature that was not recorded, 40 sigma, all axes."""
    made = Plan(12, order, seed)
    cause, clean, _, shift = displaced('temperature_missing', made, 40.0, (1, 1, 1))
    return find(cause.recorded(noisy(clean, made, 'white', True, shift, 'temperature_missing')[0])).unexplained_text


def test_an_axis_that_the_order_hardly_shows_is_not_excluded():
    """In order diagonal a course along x is nearly another course along y; in order random it is not."""
    diagonal = told('diagonal', 9610)
    assert diagonal.startswith('it changes with time along a curve, in y and z, perhaps in x too, which this order '
                               'hardly shows, not as ')
    assert told('random', 9611) == 'it changes with time along a curve, in x, y and z'
