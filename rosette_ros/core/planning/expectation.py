# SPDX-License-Identifier: Apache-2.0
"""What a planned run determines before anything is measured: rank, uncertainty of the curves, time."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.model.base_model import BaseLines
from rosette_ros.core.model.base_space import base_space
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.records import Floats
from rosette_ros.core.scheme import Scheme


@dataclass(frozen=True, eq=False)
class Expectation:
    """What a run of N readings will determine.

    rank: of the base model, of full_rank for a complete run; u: (n, 6) standard uncertainties of the curves for a
    standard deviation of 1 of each coordinate, - and 1/m; penalty: u relative to that of a complete run, rms over the
    curves; ideal: sqrt(n^2 / N), the penalty if no information were lost; duration: s.
    """

    rank: int
    full_rank: int
    u: Floats
    penalty: float
    ideal: float
    duration: float


def expect(scheme: Scheme, radius: float) -> Expectation:
    """Return the Expectation of a scheme; radius: m. Raises NotDeterminable where it does not determine the curves."""
    run = planned_run(scheme, radius)
    space = base_space(run, radius)
    n, variance = scheme.n, space.curve_cofactor()
    plane, axial = (n - 2) / n**2, (n - 1) / n**2
    complete = np.array([plane, plane, axial, 2 * plane / radius**2, 2 * plane / radius**2, axial / radius**2])
    return Expectation(space.rank, BaseLines.of(n).rank, np.sqrt(variance),
                       float(np.sqrt(np.mean(variance / complete))), float(n / np.sqrt(run.size)),
                       float(run.time[-1]))
