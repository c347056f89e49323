# SPDX-License-Identifier: Apache-2.0
"""A curve in time along x or y: where the order of measurement turns one into the other, that is said."""

import numpy as np

from benchmarks.blind.runs import SIGMA, Plan, noisy, visible_part
from rosette_ros.core.diagnosis.diagnosis import find
from rosette_ros.words.verdict_words import unexplained_words


def told(order, seed, way, constant):
    """Return what is told of a frame that follows a temperature that was not recorded, 40 sigma, all axes.

    way: (3,) relative sizes along x, y and z; constant: time constant, s.
    """
    clean, machine = Plan(12, order, seed, groups=(('climate', {'cycle_K': 0.1, 'cycle_min': 70.0}),)).measure()
    warming = machine.climate.warming(machine.time - clean.time[-1] + clean.time)
    late = warming.copy()
    for at, share in enumerate(np.exp(-np.diff(clean.time) / constant), start=1):
        late[at] = share * late[at - 1] + (1 - share) * (warming[at - 1] + warming[at]) / 2
    shift = np.outer(late - late.mean(), way)
    shift *= 40 * SIGMA / np.linalg.norm(visible_part(clean, shift))
    run = noisy(clean, 'white', np.random.default_rng(seed), True, shift)[0]
    return unexplained_words(find(run.replace(temperature=np.full(run.size, np.nan))).verdict)


def test_an_axis_that_the_order_hardly_shows_is_not_excluded():
    """In order diagonal a course along x is nearly another course along y; in order random it is not."""
    diagonal = told('diagonal', 9611, (2.0, 9.2, 3.5), 244)
    assert diagonal.startswith('it changes with time along a curve, in y and z, perhaps in x too, which this order '
                               'hardly shows, not as ')
    assert told('random', 9611, (-5.1, 6.8, -5.3), 594) == 'it changes with time along a curve, in x, y and z'
