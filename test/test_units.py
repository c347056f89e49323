# SPDX-License-Identifier: Apache-2.0
"""SI values as a person reads them."""

import math

import pytest

from rosette_ros.core.advice import planned_run
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.scheme import plan
from rosette_ros.units import SCALES, scale_of


@pytest.mark.parametrize(('value', 'unit', 'name', 'shown', 'in_unit'), [
    (1e-6 / 3600, 'm/s', 'd_x', 1.0, 'µm/h'), (2e-6, 'm', 'a', 2.0, 'µm'),
    (3e-6 / 3600, 'rad/s', 'omega', 3.0, 'µrad/h'), (600.0, 's', 'tau', 10.0, 'min'),
    (5e-6, '1/K', 'epsilon', 5.0, 'ppm/K'), (1e-6 / 3600, '1/s', 'epsilon', 1.0, 'ppm/h'),
    (4 * math.pi, 'rad', 'psi0', 2.0, 'turns'), (0.43, '1', 'nu', 0.43, 'per turn'),
    (7.0, 'V', 'x', 7.0, 'V'),
])
def test_scales(value, unit, name, shown, in_unit):
    """One value per unit, worked out by hand."""
    scale = scale_of(unit, name)
    assert value * scale.factor == pytest.approx(shown)
    assert scale.unit == in_unit


def test_every_unit_of_the_library_is_known():
    """An effect with a new unit has to say how it is shown."""
    run = planned_run(plan(6, 'random', turning='alternate'), 0.1825)
    units = {quantity.unit for effect in EFFECTS.values()
             for quantity in (*effect.amplitudes(run, effect.settings(run)[0]),
                              *effect.searched)}
    assert units - {''} <= set(SCALES)
