# SPDX-License-Identifier: Apache-2.0
"""What the linear measurement equation leaves out: products of rotations with rotations and with displacements.

Plate and table are rigid, so that the ball is at

    p = R(eps) (R(w) (R(Theta_i) R_z(phi_i + zeta) (G (b_j + P_j) + s) + T_i)) + M_k

with the tilt w, turn zeta, growth G and shift s of the effects, and the tilt eps of the axis in the frame, which the
linear gauge counts as a deviation of the CMM. Less its linear part this is a known offset to the readings, once all
that it consists of is known: by Gauss and Newton, from fit to fit.
"""

import numpy as np

from rosette_ros.core.effects.run_functions import BodyMotion
from rosette_ros.core.model.base_space import BaseParameters, BaseSpace
from rosette_ros.core.model.kinematics import axis_tilt, moved, on_table
from rosette_ros.core.run.geometry import nominal_angles, radial, rotate_z
from rosette_ros.core.run.records import Floats, Run

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
    curves, plate, tilt = base.curves[0], base.plate[0], axis_tilt(base.cmm, lever)
    largest = _length(curves[:, 3:]) + _length(tilt) + (_length(motion.rotation) if motion else 0.0)
    growth = float(np.abs(motion.growth).max()) if motion else 0.0
    turn = run.radius * float(np.abs(run.angle_deviation).max())
    off = _length(plate) + turn + (_length(motion.shift) if motion else 0.0)
    # a bound that costs nothing
    if (largest + growth) * off + (largest + growth)**2 * run.radius + largest * _length(curves[:, :3]) < NEGLIGIBLE:
        return turned_plate(run, base)
    exact: Floats = beyond_linear(run, lever, base, motion)[0]
    return exact


def beyond_linear(run: Run, lever: float, base: BaseParameters, motion: BodyMotion | None = None) -> Floats:
    """Return the exact places of the balls less those of the linear equation, (m, N, 3), m; base: of m columns.

    lever, motion: as of `second_order`.
    """
    ball, tilt = run.ball - 1, axis_tilt(base.cmm, lever)[:, None]
    curves, plate = base.curves[:, run.table_position - 1], base.plate[:, ball]
    balls, arm = run.radius * radial(nominal_angles(run.n))[ball], lever * radial(run.alpha)
    at, turn = balls + plate, run.angle_deviation
    linear = np.cross(curves[..., 3:] + tilt, arm) + curves[..., :3] + rotate_z(run.phi, plate)
    if motion is not None:
        centre = np.nanmean(base.plate, axis=1)[:, None]
        at = at + motion.shift + motion.beyond + motion.growth[:, None] * np.array([1.0, 1.0, 0.0]) * (at - centre)
        turn = turn + motion.rotation[:, 2]
        arm = arm * (run.radius / lever)
        linear = linear + np.cross(motion.rotation, arm) + motion.growth[:, None] * arm
        linear = linear + rotate_z(run.phi, motion.shift)
    exact = on_table(at, run.phi + turn, curves)
    if motion is not None:
        exact = moved(exact, motion.rotation * np.array([1.0, 1.0, 0.0]))
    return np.asarray(moved(exact, tilt) - rotate_z(run.phi + run.angle_deviation, balls) - linear)


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
    curves = np.abs(space.described(terms[None])[0].curves[0]).max(axis=0) * np.repeat([1.0, space.lever], 3)
    return bool(max(np.abs(left).max(), curves.max()) <= max(NEGLIGIBLE, SHARE * rms))


def _length(vectors: Floats) -> float:
    return float(np.sqrt(np.nanmax(np.sum(vectors**2, axis=-1))))
