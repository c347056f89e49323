# SPDX-License-Identifier: Apache-2.0
"""The truth about a machine, as seen in a table frame: for tests and for opening envelopes only.

All is given in the conventions of the measurement equation, T and Theta at the frame's origin:

    p = R_z(phi) (b + P) + T + Theta x R_z(phi) b + M
"""

import numpy as np

from rosette_ros.core.geometry import Frame, rotate_z, rotation_matrix


def table_curves(error, angle, true, frame):
    """Return (ctx, cty, ctz, crx, cry, crz) of the table in a frame, (m, 6), m and rad.

    error: (m, 6) of the table in its true frame at `angle` (m,), rad; true, frame: Frame of the
    bearing and Frame asked for, both in the machine frame. Seen in another frame, an error-free
    table has an offset and once-per-turn parts: those that eccentricity and tilt look like.
    """
    between = _between(true, frame)
    body = rotation_matrix(error[:, 3:]) @ _turns(angle)
    body = between.rotation @ body @ between.rotation.T
    shift = error[:, :3] @ between.rotation.T + between.origin - body @ between.origin
    tilt = _rotation_vector(body @ np.swapaxes(_turns(angle), 1, 2))
    return np.concatenate([shift, tilt], axis=1)


def plate_deviations(on_table, nominal, true, frame):
    """Return P_j of balls (n, 3) on the table, in the turning frame, against `nominal`, m."""
    return _between(true, frame).to_outer(on_table) - nominal


def cmm_deviations(cmm, nominal, frame):
    """Return M_k of a CMM at the nominal centres (n, 3) in a frame, (n, 3), m."""
    return cmm.error(frame.to_outer(nominal)) @ frame.rotation


def _between(true, frame):
    """Return the bearing's frame in the frame asked for."""
    return Frame(frame.rotation.T @ true.rotation, frame.to_inner(true.origin))


def _turns(angle):
    """Return R_z(angle) as matrices, (m, 3, 3)."""
    return np.swapaxes(rotate_z(np.asarray(angle)[:, None], np.eye(3)), 1, 2)


def _rotation_vector(rotation):
    """Return the rotation vectors (m, 3) of small rotations (m, 3, 3), rad."""
    sine = 0.5 * np.stack([rotation[:, 2, 1] - rotation[:, 1, 2],
                           rotation[:, 0, 2] - rotation[:, 2, 0],
                           rotation[:, 1, 0] - rotation[:, 0, 1]], axis=-1)
    size = np.linalg.norm(sine, axis=-1, keepdims=True)
    return sine / np.sinc(np.arcsin(size) / np.pi)
