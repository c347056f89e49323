# SPDX-License-Identifier: Apache-2.0
"""Numbers with significant digits, the same in sentences and in tables."""

import math
from typing import NamedTuple, Self

UNKNOWN = '–'
MOST_DECIMALS = 9
"""A smaller number has an exponent."""
SMALLEST_P = 1e-6
ARC_SECOND = math.pi / 648000


class Scale(NamedTuple):
    """How an SI value is shown: times `factor`, in `unit`."""

    factor: float
    unit: str


class Tolerance(float):
    """An upper limit of a range, m or rad, with the number and the unit in which it was stated: '1', 'arcsec'."""

    number: str
    unit: str

    def __new__(cls, value: float, number: str, unit: str) -> Self:
        """Return a limit of so many m or rad."""
        made = super().__new__(cls, value)
        made.number, made.unit = number, unit
        return made

    def __getnewargs__(self) -> tuple[float, str, str]:  # type: ignore[override]
        """Return what makes it again, in another process too."""
        return float(self), self.number, self.unit


ANGLES = {'urad': Scale(1e6, 'µrad'), 'arcsec': Scale(1 / ARC_SECOND, 'arcsec')}
"""Units of small angles, by the names that --angle-unit takes."""
SCALES = {'1': Scale(1.0, ''), 's': Scale(1 / 60, 'min'), 'm': Scale(1e6, 'µm'),
          'm/s': Scale(3.6e9, 'µm/h'), 'm/s^2': Scale(1.296e13, 'µm/h²'), '1/s': Scale(3.6e9, 'ppm/h'),
          'm/m': Scale(1e6, 'ppm'), 'm/K': Scale(1e6, 'µm/K'), '1/K': Scale(1e6, 'ppm/K'),
          'reading': Scale(1.0, 'readings'), 'm/reading': Scale(1e6, 'µm/reading'),
          'm/reading^2': Scale(1e6, 'µm/reading²'), '1/reading': Scale(1e6, 'ppm/reading')}
"""SI unit: how it is shown; a unit that is not here is shown as it is. Those of angles: `show_angles`."""


def show_angles(unit: str) -> None:
    """Show small angles in a unit of ANGLES from now on, in all that this process prints and draws."""
    factor, name = ANGLES[unit]
    SCALES.update({f'rad{per}': Scale(factor * times, f'{name}{shown}') for per, times, shown in (
        ('', 1, ''), ('/s', 3600, '/h'), ('/K', 1, '/K'), ('/reading', 1, '/reading'))})


def angle_unit() -> str:
    """Return the name of the unit that `show_angles` was given last."""
    return next(name for name, one in ANGLES.items() if one == SCALES['rad'])


show_angles('urad')


def significant(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, large ones in full: 0.0950, 736, 0.0000409."""
    if not math.isfinite(value):
        return UNKNOWN
    rounded = float(f'{value:.{digits - 1}e}')
    if not rounded:
        return '0'
    places = digits - 1 - math.floor(math.log10(abs(rounded)))
    text = f'{value:.{max(places, 0)}f}' if places <= MOST_DECIMALS else f'{value:.{digits - 1}e}'.replace('e-0', 'e-')
    return text.replace('-', '−')


def multiple(value: float) -> str:
    """Return how many times as large something is: 1.07, 736, 0.00098, 'more than a million'."""
    if value > 1e6:
        return 'more than a million'
    return f'{value:.2f}' if 0.1 <= value < 100 else significant(value, 2 if value < 0.1 else 3)


def micrometres(metres: float, digits: int = 3) -> str:
    """Return a length with significant digits and its unit: 0.0950 µm."""
    return f'{significant(1e6 * metres, digits)} µm'


def p_value(p: float) -> str:
    """Return a probability with two significant digits: '<1e−6', '4.2e−5', '0.37', '>0.99'; '–' where it is none."""
    if not math.isfinite(p):
        return '–'
    if p < SMALLEST_P or p > 0.995:
        return '>0.99' if p > 0.995 else '<1e−6'
    return f'{p:.2g}' if p >= 1e-4 else f'{p:.1e}'.replace('e-0', 'e−')


def p_equation(p: float) -> str:
    """Return a probability as 'p = 0.37' or 'p <1e−6'."""
    value = p_value(p)
    return f'p {value}' if value.startswith(('<', '>')) else f'p = {value}'


def p_words(p: float) -> str:
    """Return that of a lack-of-fit test as 'p-value of the lack-of-fit test: 0.37'."""
    return f'p-value of the lack-of-fit test: {p_value(p)}'
