# SPDX-License-Identifier: Apache-2.0
"""The paper's closed form: six error motions of a complete run by sums alone.

Source: Kniel et al. (2019), equations (1)-(16); the limit `nw` of the sum in (16) stands for n.
"""

import numpy as np

from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.geometry import nominal_angles


def closed_form(run):
    """Return the six curves of a complete run, (n, 6), m and rad, in the order of CURVES.

    Raises NotDeterminable where a ball centre is missing or stands twice.
    """
    if not run.is_complete:
        raise NotDeterminable(
            f'{run.source}: the closed form needs every ball once in every table position, '
            f'{run.n**2} ball centres; found {run.size}. Use the least-squares fit')
    n = run.n
    x, y, z = (_grid(run, axis) for axis in range(3))
    phi = nominal_angles(n)
    c, s = np.cos(phi), np.sin(phi)
    alpha = phi[:, None] + phi[None, :]
    ca, sa = np.cos(alpha), np.sin(alpha)

    ctz = z.mean(axis=1) - z.mean()                                             # (1)
    mx, my = x.mean(axis=1) - x.mean(), y.mean(axis=1) - y.mean()               # (4), (5)
    a, b = np.mean(mx * c + my * s), np.mean(-mx * s + my * c)                  # (6), (7)
    ctx, cty = mx - a * c + b * s, my - a * s - b * c                           # (2), (3)
    radius = np.mean(x * ca + y * sa)                                           # (10)
    rz = np.mean(-x * sa + y * ca, axis=1) / radius                             # (9)
    crz = rz - rz.mean()                                                        # (8)
    rx = 2 * np.mean(z * sa, axis=1) / radius                                   # (13)
    ry = -2 * np.mean(z * ca, axis=1) / radius                                  # (14)
    c_tilt, d_tilt = np.mean(rx * c + ry * s), np.mean(-rx * s + ry * c)        # (15), (16)
    crx = rx - rx.mean() - c_tilt * c + d_tilt * s                              # (11)
    cry = ry - ry.mean() - c_tilt * s - d_tilt * c                              # (12)
    return np.stack([ctx, cty, ctz, crx, cry, crz], axis=-1)


def _grid(run, axis):
    """Return one coordinate as (table position, ball), (n, n), m."""
    grid = np.empty((run.n, run.n))
    grid[run.table_position - 1, run.ball - 1] = run.centre[:, axis]
    return grid
