# SPDX-License-Identifier: Apache-2.0
"""What the machine shows of its balls, as a real cell would: nothing of its errors."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.errors import CellError
from rosette_ros.core.geometry import Frame


class BallNotFound(CellError):  # noqa: N818
    """The probe went where a ball was expected and touched none."""


@dataclass(frozen=True, eq=False)
class Reading:
    """One measured ball centre.

    table_position, ball: one-based; time: mean of its touches, s since power-on; began, ended:
    first move and last touch, s; table_angle: of the encoder in [0, 2 pi), rad; table_travel:
    unwrapped since power-on, rad; approach: sense of the last table move, 0 before the first;
    centre: (3,) machine frame, m; form_error: range of the touches about the sphere, m;
    temperature: of the thermometer, degree Celsius.
    """

    table_position: int
    ball: int
    time: float
    began: float
    ended: float
    table_angle: float
    table_travel: float
    approach: int
    centre: np.ndarray
    form_error: float
    temperature: float


@dataclass(frozen=True, eq=False)
class Readings:
    """N readings in measuring order: the fields of Reading as arrays (N,), centre (N, 3)."""

    table_position: np.ndarray
    ball: np.ndarray
    time: np.ndarray
    began: np.ndarray
    ended: np.ndarray
    table_angle: np.ndarray
    table_travel: np.ndarray
    approach: np.ndarray
    centre: np.ndarray
    form_error: np.ndarray
    temperature: np.ndarray

    @property
    def size(self):
        """N, the number of readings."""
        return self.time.size

    def __getitem__(self, place):
        """Return one Reading, counted from zero."""
        return Reading(
            int(self.table_position[place]), int(self.ball[place]), float(self.time[place]),
            float(self.began[place]), float(self.ended[place]), float(self.table_angle[place]),
            float(self.table_travel[place]), int(self.approach[place]), self.centre[place],
            float(self.form_error[place]), float(self.temperature[place]))


@dataclass(frozen=True, eq=False)
class Alignment:
    """What is known before a run.

    frame: the table frame in the machine frame; repeatability: sd of a ball-centre coordinate, m,
    None if it was not measured; dof: its degrees of freedom, None if not measured.
    """

    frame: Frame
    repeatability: float | None = None
    dof: int | None = None
