# SPDX-License-Identifier: Apache-2.0
"""A course in time along x or y: where the order turns one into the other, the body is said all the same."""

import numpy as np

from benchmarks.blind.runs import SIGMA, Plan, noisy, visible_part
from rosette_ros.core.diagnosis.diagnosis import find


def test_an_axis_that_the_order_hardly_shows_is_not_excluded():
    """A frame that follows a temperature that was not recorded, 40 sigma, along all axes: in order diagonal a course
    along x is nearly another course along y, and a tilt: the probe is said among what moves with time; in order random
    it is the probe along all axes."""
    told = {}
    for order, way, constant in (('diagonal', (2.0, 9.2, 3.5), 244), ('random', (-5.1, 6.8, -5.3), 594)):
        clean, machine = Plan(9, order, 9611, groups=(('climate', {'cycle_K': 0.1, 'cycle_min': 70.0}),)).measure()
        warming = machine.climate.warming(machine.time - clean.time[-1] + clean.time)
        late = warming.copy()
        for at, share in enumerate(np.exp(-np.diff(clean.time) / constant), start=1):
            late[at] = share * late[at - 1] + (1 - share) * (warming[at - 1] + warming[at]) / 2
        shift = np.outer(late - late.mean(), way)
        shift *= 40 * SIGMA / np.linalg.norm(visible_part(clean, shift))
        run = noisy(clean, 'white', np.random.default_rng(9611), True, shift)[0]
        found = find(run.replace(temperature=np.full(run.size, np.nan)))
        told[order] = found.causes[0], [one.motion for one in found.unnamed]
    for likeliest, _ in told.values():
        assert 'frame' in likeliest.bodies and 'time' in likeliest.may_be and likeliest.probability > 0.9, told
    assert told['random'][1] == ['frame along x, y and z']
