# SPDX-License-Identifier: Apache-2.0
"""The form of a ball as a random surface: spherical harmonics of degrees 2 to 5, equally strong and in any attitude."""

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.run.geometry import Floats

DEGREES = (2, 3, 4, 5)
"""Degree 0 is the radius, degree 1 a shift of the centre."""


def form_basis(direction: Floats) -> Floats:
    """Return the heights of the 32 harmonics at unit vectors (..., 3), as (..., 32).

        Y_lm = N_lm P_l^m(cos theta) (cos m az, sin m az),  sum over m of Y_lm^2 = 1 / 4 for each l

    so that independent coefficients of standard deviation s make a surface of standard deviation s everywhere.
    """
    azimuth, height = np.arctan2(direction[..., 1], direction[..., 0]), np.clip(direction[..., 2], -1.0, 1.0)
    columns = []
    for degree in DEGREES:
        for order in range(degree + 1):
            ratio = scipy.special.factorial(degree - order) / scipy.special.factorial(degree + order)
            wave = np.sqrt((1 if order == 0 else 2) * ratio / len(DEGREES)) * scipy.special.lpmv(order, degree, height)
            columns += [wave * np.cos(order * azimuth)] + ([wave * np.sin(order * azimuth)] if order else [])
    return np.stack(columns, axis=-1)


def standard_height(form: float) -> float:
    """Return the standard deviation of a surface whose heights lie evenly in a range `form` (GUM 4.3.7), m."""
    return form / 12**0.5
