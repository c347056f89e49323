# SPDX-License-Identifier: Apache-2.0
"""How the plate of a fit lies on the table, and its deviations freed of that, with their uncertainties."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import Floats, clamping
from rosette_ros.core.model.base_space import BaseParameters
from rosette_ros.core.model.least_squares import Fit


@dataclass(frozen=True, eq=False)
class ClampedPlate:
    """shift, turn: of the plate as a body, (3,), m and rad; freed: its deviations without them, (n, 3), m, NaN where a
    ball was not touched; u, u_freed: standard uncertainties of shift and turn, (6,), and of the deviations."""

    shift: Floats
    turn: Floats
    freed: Floats
    u: Floats
    u_freed: Floats


def clamped_plate(fit: Fit) -> ClampedPlate:
    """Return the ClampedPlate of a fit, in the gauge of the base model."""
    radius, space = fit.run.radius, fit.joint.space

    def motions(bias: BaseParameters) -> Floats:
        return np.array([[np.concatenate(clamping(one, radius)[:2])] for one in bias.plate])

    def rest(bias: BaseParameters) -> Floats:
        return np.array([clamping(one, radius)[2] for one in bias.plate])

    shift, turn, freed = clamping(fit.plate, radius)
    u, u_freed = (fit.weighted_sigma * np.sqrt(one) for one in (
        space.clamping_cofactor() + fit.joint.share(motions)[0], space.freed_cofactor() + fit.joint.share(rest)))
    return ClampedPlate(shift, turn, freed, u, u_freed)
