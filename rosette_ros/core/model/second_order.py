# SPDX-License-Identifier: Apache-2.0
"""What the linear measurement equation leaves out: products of rotations with rotations and with displacements.

Plate and table are rigid, so that the ball is at

    p = R(eps) (R(w) (R(Theta_i) R_z(phi_i + zeta) (G (b_j + P_j) + s) + T_i)) + M_k

with the tilt w, turn zeta, growth G and shift s of the effects, and the tilt eps of the axis in the frame, which the
linear gauge counts as a deviation of the CMM. Less its linear part this is a known offset to the readings, once all
that it consists of is known: by Gauss and Newton, from fit to fit.
"""

import numpy as np

from rosette_ros.core.effects.effect import BodyMotion
from rosette_ros.core.geometry import nominal_angles, radial, rotate_z, rotation_matrix
from rosette_ros.core.model.base_space import BaseParameters, BaseSpace
from rosette_ros.core.records import Floats, Run

NEGLIGIBLE = 1e-9
"""Second-order terms that change neither curves nor residuals by more, m, are left out,"""
SHARE = 0.03
"""nor by more than this share of what the fit leaves: it is negligible."""
ROUNDING, CONVERGED = 1e-15, 1e-12
"""Changes of the offset of any ball, m: the last step changes it by less than rounding, at worst by a picometre."""
MOST_STEPS = 40


def second_order(run: Run, lever: float, base: BaseParameters, motion: BodyMotion | None) -> Floats:
    """Return the exact place of every ball less that of the linear equation, (N, 3), m; (1, 3) zeros where negligible.

    lever: radius at which the rotations of the linear equation act, m; base: its parameters, of one column; motion: of
    the effects.
    """
    curves, plate, cmm = base.curves[0], base.plate[0], base.cmm[0]
    place, ball = run.table_position - 1, run.ball - 1
    nominal = rotate_z(run.phi, plate[ball])
    tilt, delta = _axis_tilt(cmm, lever), run.angle_deviation
    largest = _length(curves[:, 3:]) + _length(tilt) + (_length(motion.rotation) if motion else 0.0)
    growth = float(np.abs(motion.growth).max()) if motion else 0.0
    off = _length(plate) + run.radius * float(np.abs(delta).max()) + (_length(motion.shift) if motion else 0.0)
    # a bound that costs nothing
    if (largest + growth) * off + (largest + growth)**2 * run.radius + largest * _length(curves[:, :3]) < NEGLIGIBLE:
        return turned_plate(run, base)
    balls = run.radius * radial(nominal_angles(run.n))
    at = (balls + plate)[ball]
    arm = lever * radial(run.alpha)
    linear = np.cross(curves[place, 3:] + tilt, arm) + curves[place, :3] + nominal
    turn = delta
    if motion is not None:
        centre = np.nanmean(plate, axis=0)
        at = at + motion.shift + motion.beyond + motion.growth[:, None] * np.array([1.0, 1.0, 0.0]) * (at - centre)
        turn = delta + motion.rotation[:, 2]
        arm = arm * (run.radius / lever)
        linear = linear + np.cross(motion.rotation, arm) + motion.growth[:, None] * arm
        linear = linear + rotate_z(run.phi, motion.shift)
    exact = _rotated(rotation_matrix(curves[:, 3:])[place], rotate_z(run.phi + turn, at)) + curves[place, :3]
    if motion is not None:
        exact = _rotated(rotation_matrix(motion.rotation * np.array([1.0, 1.0, 0.0])), exact)
    out: Floats = exact @ rotation_matrix(tilt).T - rotate_z(run.phi + delta, balls[ball]) - linear
    return out


def turned_plate(run: Run, base: BaseParameters) -> Floats:
    """Return of that only the turn of the plate's deviations from nominal to actual angles; (1, 3) zeros for none."""
    if not np.any(run.angle_deviation):
        return np.zeros((1, 3))
    nominal = rotate_z(run.phi, base.plate[0][run.ball - 1])
    return rotate_z(run.angle_deviation, nominal) - nominal


def is_negligible(space: BaseSpace, terms: Floats, rms: float) -> bool:
    """Return whether terms (N, 3), m, change residuals and curves by little; rms: of the residuals, m."""
    if np.abs(terms).max() <= NEGLIGIBLE:
        return True
    left = space.whitening.inverse(space.residual(terms[None]))
    curves = np.abs(space.parameters(terms[None]).curves[0]).max(axis=0) * np.repeat([1.0, space.lever], 3)
    return bool(max(np.abs(left).max(), curves.max()) <= max(NEGLIGIBLE, SHARE * rms))


def _axis_tilt(cmm: Floats, lever: float) -> Floats:
    """Return the tilt of the axis in the frame, (3,), rad: the common tilt of the CMM's deviations, NaN left out."""
    known = np.isfinite(cmm[:, 2])
    angle = nominal_angles(len(cmm))[known]
    plane = lever * np.stack([np.sin(angle), -np.cos(angle), np.full(angle.size, 1 / lever)], axis=-1)
    return np.append(np.linalg.lstsq(plane, cmm[known, 2], rcond=None)[0][:2], 0.0)


def _rotated(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _length(vectors: Floats) -> float:
    return float(np.sqrt(np.nanmax(np.sum(vectors**2, axis=-1))))
