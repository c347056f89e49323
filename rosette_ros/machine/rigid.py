# SPDX-License-Identifier: Apache-2.0
"""Exact rotations applied to many points at once, without building matrices.

The live cell measures one ball at a time, where the count of array operations is the cost.
"""

import numpy as np

_NO_ANGLE = 1e-300


def spun(angle, points):
    """Return R_z(angle) points; angle (N, .), rad, broadcasts against points (N, ., 3)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    out = np.empty((*np.broadcast_shapes(c.shape, x.shape), 3))
    out[..., 0] = c * x - s * y
    out[..., 1] = s * x + c * y
    out[..., 2] = points[..., 2]
    return out


def turned(vector, points):
    """Return points (N, ., 3) turned by rotation vectors (N, ., 3), rad.

        p' = p + sinc(a) w x p + sinc(a/2)^2 / 2 w x (w x p),  a = |w|,  sinc(a) = sin(a) / a

    Source: Rodrigues' formula, written so that it is exact down to no rotation at all.
    """
    # The sine of the smallest angle is that angle: no rotation needs no case of its own.
    angle = np.maximum(np.sqrt(np.vecdot(vector, vector)), _NO_ANGLE)[..., None]
    half = np.sin(0.5 * angle) / (0.5 * angle)
    once = _cross(vector, points)
    return points + (np.sin(angle) / angle) * once + (0.5 * half * half) * _cross(vector, once)


def _cross(a, b):
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = ay * bz - az * by
    out[..., 1] = az * bx - ax * bz
    out[..., 2] = ax * by - ay * bx
    return out
