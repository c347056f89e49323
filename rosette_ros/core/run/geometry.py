# SPDX-License-Identifier: Apache-2.0
"""Angles, rotations, frames and how the table frame is found: right-handed, z along the table axis, radians, metres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.numpy_parts import postpone_unused

postpone_unused()

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TWO_PI = 2.0 * np.pi
SAME_ANGLE = 1e-6
"""Nominal table angles that differ by no more are the same, rad."""


def wrap(angle: ArrayLike) -> Floats:
    """Return an angle of any shape, rad, brought into [-pi, pi)."""
    wrapped: Floats = (np.asarray(angle, dtype=float) + np.pi) % TWO_PI - np.pi
    return wrapped


def same_angles(one: Floats, other: Floats) -> bool:
    """Return whether two rows of angles, rad, are equally many and differ by at most SAME_ANGLE and whole turns."""
    return one.shape == other.shape and bool(np.abs(wrap(one - other)).max(initial=0) <= SAME_ANGLE)


def nominal_angles(n: int) -> Floats:
    """Return phi_i = 2 pi (i - 1) / n for i = 1..n, shape (n,), rad."""
    return TWO_PI * np.arange(n) / n


def radial(angle: Floats) -> Floats:
    """Return the radial unit vectors at azimuths (...), rad, (..., 3)."""
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def rotate_z(angle: ArrayLike, vector: ArrayLike) -> Floats:
    """Return R_z(angle) vector; angle (...), rad, and vector (..., 3) broadcast."""
    angle, vector = np.asarray(angle, dtype=float), np.asarray(vector, dtype=float)
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    z = np.broadcast_to(z, np.broadcast_shapes(np.shape(z), np.shape(c)))
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def turned_frame(angle: float, points: Floats, rotation: Floats | None) -> tuple[Floats, Floats | None]:
    """Return points (N, 3) of a frame, and its rotation in another one where known, once it is turned about its z.

    angle: by which it is turned, rad; 0 changes no bit.
    """
    if angle == 0:
        return points, rotation
    return rotate_z(-angle, points), None if rotation is None else rotation @ rotation_matrix([0.0, 0.0, angle])


def rotation_matrix(vector: ArrayLike) -> Floats:
    """Return the exact rotation matrix (..., 3, 3) of a rotation vector (..., 3), rad (Rodrigues)."""
    vector = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape, 3)
    # np.sinc is sin(pi x)/(pi x): both factors stay exact as the angle goes to zero.
    half = np.sinc(angle / TWO_PI)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross))


def rotation_along(z: Floats, x: Floats) -> Floats:
    """Return the rotation (3, 3) of a frame with a unit vector z as its axis, whose x is x (3,) put across it."""
    x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def rigid_motion(displacement: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Return shift s (3,), m, and rotation r (3,), rad, of the small rigid motion that is nearest to displacements.

        d_j = s + r x p_j,  least squares over the balls j whose d_j is known

    displacement: (n, 3), m, NaN where it is not known; place: (n, 3), m.
    """
    known = np.isfinite(displacement).all(axis=1)
    columns = np.concatenate([np.broadcast_to(np.eye(3), (len(place), 3, 3)),
                              np.swapaxes(np.cross(np.eye(3)[None], place[:, None]), 1, 2)], axis=2)
    found = np.linalg.lstsq(columns[known].reshape(-1, 6), displacement[known].ravel())[0]
    return found[:3], found[3:]


def clamping(plate: Floats, radius: float) -> tuple[Floats, Floats, Floats]:
    """Return how a plate lies on the table, shift (3,), m, and rotation (3,), rad, and its deviations freed of that.

    plate: deviations of the balls (n, 3), m, NaN where not known; radius: of their circle, m.
    """
    beta = nominal_angles(len(plate))
    place = radius * np.stack([np.cos(beta), np.sin(beta), np.zeros(beta.size)], axis=-1)
    shift, turn = rigid_motion(plate, place)
    return shift, turn, np.asarray(plate - shift - np.cross(turn, place))


@dataclass(frozen=True)
class Frame:
    """A right-handed frame given in another: p_outer = rotation p_inner + origin.

    rotation: (3, 3), its columns are the inner axes; origin: (3,), m.
    """

    rotation: Floats
    origin: Floats

    @staticmethod
    def identity() -> 'Frame':
        """Return the frame that changes nothing."""
        return Frame(np.eye(3), np.zeros(3))

    def to_outer(self, points: ArrayLike) -> Floats:
        """Return points (..., 3) of the inner frame in the outer one, m."""
        return np.asarray(np.asarray(points) @ self.rotation.T + self.origin)

    def to_inner(self, points: ArrayLike) -> Floats:
        """Return points (..., 3) of the outer frame in the inner one, m."""
        return np.asarray((np.asarray(points) - self.origin) @ self.rotation)

    def turned(self, angle: float) -> 'Frame':
        """Return the frame turned about its own z by an angle, rad."""
        return Frame(self.rotation @ rotation_matrix([0.0, 0.0, angle]), self.origin) if angle else self

    def quaternion(self) -> Floats:
        """Return the unit quaternion (x, y, z, w) of the rotation, w >= 0."""
        r = self.rotation
        # The largest of the four squared components is taken first: no small divisor.
        x, y, z = np.diag(r)
        squares = np.array([1 + x - y - z, 1 - x + y - z, 1 - x - y + z, 1 + x + y + z])
        largest = int(np.argmax(squares))
        products = np.array([
            [squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]]])
        q: Floats = products[largest] / np.linalg.norm(products[largest])
        return q if q[3] >= 0 else -q

    @staticmethod
    def from_quaternion(quaternion: ArrayLike, origin: ArrayLike) -> 'Frame':
        """Return the frame of a quaternion (x, y, z, w) and an origin (3,), m."""
        quaternion = np.asarray(quaternion, dtype=float)
        x, y, z, w = quaternion / np.linalg.norm(quaternion)
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        return Frame(rotation, np.asarray(origin, dtype=float))


def table_frame(axis_points: ArrayLike, plane_points: ArrayLike) -> Frame:
    """Return the table frame in the frame of the given points: steps (a)-(d) of Kniel et al. (2019), section 2.2.

    z is the table axis, x goes through ball 1, the origin is where the axis meets the plane of the ball centres.
    axis_points: (m, 3) centres of one ball at m >= 3 table positions in the order of counter-clockwise turning, m;
    plane_points: (n, 3) centres of all balls at table angle 0, ball 1 first, m.

    Raises NotDeterminable where the points do not span a circle or a plane.
    """
    axis_points = np.asarray(axis_points, dtype=float)
    plane_points = np.asarray(plane_points, dtype=float)
    z = _normal(axis_points, 'table axis: centres of one ball at several table positions')
    mean = axis_points.mean(axis=0)
    turning = np.cross(axis_points - mean, np.roll(axis_points, -1, axis=0) - mean).sum(axis=0)
    z = z if z @ turning > 0 else -z
    on_axis = _circle_centre(axis_points, z)
    normal = _normal(plane_points, 'plane of the balls: centres of all balls')
    if abs(normal @ z) < 0.5:
        angle = np.rad2deg(np.arccos(abs(normal @ z)))
        raise NotDeterminable('local frame: expected the plane of the balls about perpendicular to the table axis, '
                              'found '
                              f'{angle:.1f} deg between its normal and the axis; check that the targets are the balls '
                              'that were asked for')
    origin = on_axis + z * (normal @ (plane_points.mean(axis=0) - on_axis)) / (normal @ z)
    return Frame(rotation_along(z, plane_points[0] - origin), origin)


def fitted_frame(points: ArrayLike, places: ArrayLike) -> Frame:
    """Return the frame in which points (N, 3) are nearest to places (N, 3), by least squares: Kabsch (1976)."""
    points, places = np.asarray(points, dtype=float), np.asarray(places, dtype=float)
    mean, centre = points.mean(axis=0), places.mean(axis=0)
    left, _, right = np.linalg.svd((points - mean).T @ (places - centre))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return Frame(rotation, mean - rotation @ centre)


def _normal(points: Floats, what: str) -> Floats:
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 3:
        raise NotDeterminable(f'{what}: expected at least 3 points, found shape {points.shape}')
    singular, vectors = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1:]
    if singular[1] < 1e-6 * singular[0] or singular[0] == 0:
        raise NotDeterminable(f'{what}: expected points that span a plane, found points on a line; measure more '
                              'positions')
    return np.asarray(vectors[2])


def _circle_centre(points: Floats, normal: Floats) -> Floats:
    """Return the centre of the least-squares circle of points in the plane across `normal`."""
    u = np.linalg.svd(normal[None, :])[2][1]
    v = np.cross(normal, u)
    mean = points.mean(axis=0)
    flat = (points - mean) @ np.stack([u, v], axis=-1)
    # |p|^2 = 2 c.p + (r^2 - |c|^2) is linear in centre c; points are centred, so it is well scaled.
    matrix = np.column_stack([2 * flat, np.ones(len(flat))])
    centre = np.linalg.lstsq(matrix, (flat**2).sum(axis=1), rcond=None)[0][:2]
    return np.asarray(mean + centre[0] * u + centre[1] * v)


def travel_to(travel: float, angle: float, approach: int) -> float:
    """Return the travel of a table, rad, that turns from a travel to an angle, rad, in the sense of approach (else
    forward); where it stands there already it stays."""
    off = float(wrap(angle - travel))
    if abs(off) <= SAME_ANGLE:
        return travel + off
    step = (angle - travel) % TWO_PI
    return travel + (step - TWO_PI if approach < 0 else step)
