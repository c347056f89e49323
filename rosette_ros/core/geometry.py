# SPDX-License-Identifier: Apache-2.0
"""Angles, rotations and rigid transforms: right-handed, z along the table axis, radians, metres."""

from dataclasses import dataclass

import numpy as np

TWO_PI = 2.0 * np.pi


def wrap(angle):
    """Return `angle` brought into [-pi, pi), same shape, rad."""
    return (np.asarray(angle, dtype=float) + np.pi) % TWO_PI - np.pi


def nominal_angles(n):
    """Return phi_i = 2 pi (i - 1) / n for i = 1..n, shape (n,), rad."""
    return TWO_PI * np.arange(n) / n


def rotate_z(angle, vector):
    """Return R_z(angle) vector.

    `angle` has shape (...), rad; `vector` has shape (..., 3); they broadcast.
    """
    angle, vector = np.asarray(angle, dtype=float), np.asarray(vector, dtype=float)
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    z = np.broadcast_to(z, np.broadcast_shapes(np.shape(z), np.shape(c)))
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def rotation_matrix(vector):
    """Return the exact rotation matrix of a rotation vector (Rodrigues).

    `vector` has shape (..., 3), rad; the result (..., 3, 3).
    """
    vector = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape, 3)
    # np.sinc is sin(pi x)/(pi x): both factors stay exact as the angle goes to zero.
    half = np.sinc(angle / TWO_PI)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross)


@dataclass(frozen=True)
class Frame:
    """A right-handed frame given in another: p_outer = rotation p_inner + origin.

    `rotation` has shape (3, 3), its columns are the inner axes; `origin` has shape (3,), m.
    """

    rotation: np.ndarray
    origin: np.ndarray

    @staticmethod
    def identity():
        """Return the frame that changes nothing."""
        return Frame(np.eye(3), np.zeros(3))

    def to_outer(self, points):
        """Return points of the inner frame in the outer one, shape (..., 3), m."""
        return np.asarray(points) @ self.rotation.T + self.origin

    def to_inner(self, points):
        """Return points of the outer frame in the inner one, shape (..., 3), m."""
        return (np.asarray(points) - self.origin) @ self.rotation

    def quaternion(self):
        """Return the unit quaternion (x, y, z, w) of the rotation, w >= 0."""
        r = self.rotation
        # The largest of the four squared components is taken first: no small divisor.
        squares = np.array([
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
            1 + r[0, 0] + r[1, 1] + r[2, 2],
        ])
        largest = int(np.argmax(squares))
        products = np.array([
            [squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]],
        ])
        q = products[largest] / np.linalg.norm(products[largest])
        return q if q[3] >= 0 else -q

    @staticmethod
    def from_quaternion(quaternion, origin):
        """Return the frame of a quaternion (x, y, z, w) and an origin (3,), m."""
        x, y, z, w = np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion)
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])
        return Frame(rotation, np.asarray(origin, dtype=float))
