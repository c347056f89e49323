# SPDX-License-Identifier: Apache-2.0
"""SI values as a person reads them: µm and µrad, minutes; in one place for every screen."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Scale:
    """How an SI value is shown: times `factor`, in `unit`."""

    factor: float
    unit: str


SCALES = {
    '1': Scale(1.0, ''), 's': Scale(1 / 60, 'min'),
    'm': Scale(1e6, 'µm'), 'rad': Scale(1e6, 'µrad'),
    'm/s': Scale(3.6e9, 'µm/h'), 'rad/s': Scale(3.6e9, 'µrad/h'), '1/s': Scale(3.6e9, 'ppm/h'),
    'm/K': Scale(1e6, 'µm/K'), '1/K': Scale(1e6, 'ppm/K'),
}
"""SI unit: how it is shown; a unit that is not here is shown as it is."""

OF_PARAMETER = {'psi0': Scale(0.5 / math.pi, 'turns'), 'nu': Scale(1.0, 'per turn')}
"""Parameters that are no small deviations and have a scale of their own, by name."""


def scale_of(unit, parameter=''):
    """Return the Scale of an SI unit, or of a parameter that has its own.

    >>> scale_of('m/s').unit, round(scale_of('m/s').factor * 1e-10, 3)
    ('µm/h', 0.36)
    """
    return OF_PARAMETER.get(parameter) or SCALES.get(unit, Scale(1.0, unit))
