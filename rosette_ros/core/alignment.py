# SPDX-License-Identifier: Apache-2.0
"""Finding the table axis and the local frame: steps (a)-(d) of Kniel et al. (2019), section 2.2."""

import numpy as np

from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.geometry import Frame


def table_frame(axis_points, plane_points):
    """Return the table frame in the frame of the given points.

    z is the table axis, x goes through ball 1, the origin is where the axis meets the plane of the
    ball centres. axis_points: (m, 3) centres of one ball at m >= 3 table positions in the order of
    counter-clockwise turning, m; plane_points: (n, 3) centres of all balls at table angle 0, ball 1
    first, m.

    Raises NotDeterminable where the points do not span a circle or a plane.
    """
    axis_points = np.asarray(axis_points, dtype=float)
    plane_points = np.asarray(plane_points, dtype=float)
    z = _normal(axis_points, 'table axis: centres of one ball at several table positions')
    turning = np.cross(axis_points - axis_points.mean(axis=0),
                       np.roll(axis_points, -1, axis=0) - axis_points.mean(axis=0)).sum(axis=0)
    z = z if z @ turning > 0 else -z
    on_axis = _circle_centre(axis_points, z)
    normal = _normal(plane_points, 'plane of the balls: centres of all balls')
    if abs(normal @ z) < 0.5:
        raise NotDeterminable(
            'local frame: wanted the plane of the balls about perpendicular to the table axis, got '
            f'{np.rad2deg(np.arccos(abs(normal @ z))):.1f} deg between its normal and the axis; '
            'check that the targets are the balls that were asked for')
    origin = on_axis + z * (normal @ (plane_points.mean(axis=0) - on_axis)) / (normal @ z)
    x = plane_points[0] - origin
    x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    return Frame(np.stack([x, np.cross(z, x), z], axis=-1), origin)


def _normal(points, what):
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 3:
        raise NotDeterminable(f'{what}: wanted at least 3 points, got shape {points.shape}')
    singular, vectors = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1:]
    if singular[1] < 1e-6 * singular[0] or singular[0] == 0:
        raise NotDeterminable(f'{what}: wanted points that span a plane, got points on a line; '
                              'measure more positions')
    return vectors[2]


def _circle_centre(points, normal):
    """Return the centre of the least-squares circle of points in the plane across `normal`."""
    u = np.linalg.svd(normal[None, :])[2][1]
    v = np.cross(normal, u)
    mean = points.mean(axis=0)
    flat = (points - mean) @ np.stack([u, v], axis=-1)
    # |p|^2 = 2 c.p + (r^2 - |c|^2) is linear in centre c; points are centred, so it is well scaled.
    matrix = np.column_stack([2 * flat, np.ones(len(flat))])
    centre = np.linalg.lstsq(matrix, (flat**2).sum(axis=1), rcond=None)[0][:2]
    return mean + centre[0] * u + centre[1] * v
