# SPDX-License-Identifier: Apache-2.0
"""Where rigid bodies carry points: rotations exact, for one run or many trials at once.

Points, rotation vectors and shifts are (..., 3) and broadcast; m and rad."""

import numpy as np

from rosette_ros.core.run.geometry import Floats, nominal_angles, rotate_z, rotation_matrix


def moved(points: Floats, rotation: Floats, shift: Floats | float = 0.0) -> Floats:
    """Return R(rotation) points + shift."""
    return np.asarray((rotation_matrix(rotation) @ points[..., None])[..., 0] + shift)


def on_table(points: Floats, angle: Floats, curves: Floats) -> Floats:
    """Return where a turned table carries points on it: R(Theta) R_z(angle) points + T; curves: (..., 6), T, Theta."""
    return moved(rotate_z(angle, points), curves[..., 3:], curves[..., :3])


def axis_tilt(cmm: Floats, lever: float) -> Floats:
    """Return the tilt of the axis in the frame, (m, 3): the common tilt of the CMM measurement errors, (m, n, 3).

    lever: radius at which they are, m. NaN is left out, at the same positions in all m."""
    known = np.isfinite(cmm[0, :, 2])
    angle = nominal_angles(cmm.shape[1])[known]
    plane = np.stack([lever * np.sin(angle), -lever * np.cos(angle), np.ones(angle.size)], axis=-1)
    return np.asarray((cmm[:, known, 2] @ np.linalg.pinv(plane).T) * np.array([1.0, 1.0, 0.0]))
