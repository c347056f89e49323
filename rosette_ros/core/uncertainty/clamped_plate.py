# SPDX-License-Identifier: Apache-2.0
"""How the plate of a fit lies on the table, and its deviations freed of that, with their uncertainties."""

from dataclasses import dataclass

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.model.base_space import BaseParameters, BaseSpace
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.geometry import Floats, clamping, nominal_angles


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
    of_motions, less = _cofactors(space)
    # of three balls nothing is left but rounding
    u, u_freed = (fit.weighted_sigma * np.sqrt(np.maximum(one, 0)) for one in (
        of_motions + fit.joint.share(motions)[0], space.deviation_cofactors()[0] - less + fit.joint.share(rest)))
    return ClampedPlate(shift, turn, freed, u, u_freed)


def _cofactors(space: BaseSpace) -> tuple[Floats, Floats]:
    """Return the variances of shift and turn, (6,), and how much less those of the freed deviations are, (n, 3).

    With C the covariance of z, or of x and y, and Q the motions of a body, orthonormal: C less its part in Q."""
    n, phi = space.n, nominal_angles(space.n)
    c, s, one, o = np.cos(phi), np.sin(phi), np.ones(n), np.zeros(n)
    plates = [[one, s, -c]], [[one, o, -s], [o, one, c]]  # shift and tilt of z; shift and turn of x and y
    of_motions, less = [], []
    for (factor, known), plate in zip(space.systems, plates, strict=True):
        motions = np.zeros((known.size, 3))
        motions[3 * n:(3 + len(plate)) * n] = np.concatenate([np.stack(axis, axis=-1) for axis in plate])
        motions *= known[:, None]
        rows = factor.seen(np.asarray(np.linalg.pinv(motions), dtype=float))
        of_motions.append(np.sum(rows.T * factor.solved(rows.T), axis=0))
        q = scipy.linalg.orth(motions)
        mixed = factor.in_gauge(factor.solved(factor.seen(q.T).T))
        less += np.split(np.sum(q * (2 * mixed - q @ (q.T @ mixed)), axis=1)[3 * n:(3 + len(plate)) * n], len(plate))
    z, xy = of_motions
    squares = np.array([*xy[:2], *z, xy[2]]) / np.repeat([1.0, space.lever**2], 3)
    return squares, np.stack([less[1], less[2], less[0]], axis=-1)
