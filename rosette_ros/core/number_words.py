# SPDX-License-Identifier: Apache-2.0
"""Numbers with significant digits, the same in sentences and in tables."""

import math

UNKNOWN = '–'
MOST_DECIMALS = 9
"""A smaller number has an exponent."""
SMALLEST_P = 1e-6


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


def p_words(p: float) -> str:
    """Return that of a lack-of-fit test as 'p-value of the lack-of-fit test: 0.37'."""
    return f'p-value of the lack-of-fit test: {p_value(p)}'
