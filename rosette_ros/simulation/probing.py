# SPDX-License-Identifier: Apache-2.0
"""Probing a ball: touches on horizontal circles, contact with a real sphere, least-squares centre, the reading.

Source: Kniel et al. (2019), section 2.2: 20 points on 5 horizontal circles of 4, the top circle
1 mm below the pole, the lowest 1 mm below the equator, none at the pole. The pole is on the free side of the plate: up
for a vertical table axis, along the axis for any other.
"""

import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Generic, TypeVar

import numpy as np
from pydantic import Field

from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.core.run.errors import CellError, InvalidPlan
from rosette_ros.core.run.records import Floats, Ints
from rosette_ros.core.run.touches import TOUCHES, centre_factors, circles_of, touch_directions
from rosette_ros.simulation.setting_types import NotNegative, Positive, Settings, Share


class BallNotFound(CellError):  # noqa: N818
    """The probe went where a ball was expected and touched none."""


Whole = TypeVar('Whole', int, Ints)
Real = TypeVar('Real', float, Floats)


@dataclass(frozen=True, eq=False)
class BallReading(Generic[Whole, Real]):
    """One measured ball centre.

    table_position, ball: one-based; time: mean of its touches, s since power-on; began, ended: first move and last
    touch, s; table_angle: of the encoder in [0, 2 pi), rad; table_travel: unwrapped since power-on, rad; approach:
    sense of the last table move, 0 before the first; centre: (3,) machine frame, m; form_error: range of the touches
    about the sphere, m; temperature: of the thermometer, degree Celsius; touch_point: (Q, 3) centres of the tip from
    which the centre follows, machine frame, m; touch_normal: (Q, 3) unit vectors against which it came, away from the
    ball; touch_time: (Q,) s.
    """

    table_position: Whole
    ball: Whole
    time: Real
    began: Real
    ended: Real
    table_angle: Real
    table_travel: Real
    approach: Whole
    centre: Floats
    form_error: Real
    temperature: Real
    touch_point: Floats
    touch_normal: Floats
    touch_time: Floats


class BallReadings(BallReading[Ints, Floats]):
    """N readings in measuring order: the fields of BallReading as arrays (N, ...)."""

    @property
    def size(self) -> int:
        """N, the number of readings."""
        return self.time.size

    def __getitem__(self, place: int) -> BallReading[int, float]:
        """Return one reading, counted from zero."""
        return BallReading(**{name: values[place].item() if values.ndim == 1 else values[place]
                              for name, values in vars(self).items()})


class ProbingSettings(Settings):
    """Twenty touches on five horizontal circles, and how well a ball centre repeats."""

    repeatability_um: NotNegative = Field(0.1, description='sd of each ball-centre coordinate')
    touch_share: Share = Field(
        0.8, description='share of the touches in the sd of the worst coordinate, the rest is positioning')
    circles: Annotated[int, Field(ge=2, le=20)] = 5
    points_per_circle: Annotated[int, Field(ge=3, le=50)] = 4
    below_pole_mm: Positive = Field(1.0, description='height of the top circle below the pole')
    below_equator_mm: NotNegative = Field(1.0, description='lowest circle below the equator')
    tip_radius_mm: Positive = 2.5


class TouchPattern:
    """Where a ball is touched, and how well.

    direction: (Q, 3) unit vectors from its centre, in the order of touching, top circle first, z towards the pole;
    points_per_circle: evenly spaced from +x; axes: (3, 3) of the pole's frame in the machine; radius: of the ball, tip:
    of the probe's tip, m; touch_noise: sd of a touch along its normal, position_noise: (3,) sd of the CMM per axis of
    the pole's frame and ball, m.

    They make every coordinate of a ball centre repeat alike: repeatability^2 = (factor_axis * touch)^2 +
    position_axis^2. The touches take `touch_share` of the worst coordinate, the positioning of the CMM the rest.
    """

    def __init__(self, settings: ProbingSettings, ball_radius: float) -> None:
        self.radius, self.tip = ball_radius, 1e-3 * settings.tip_radius_mm
        self._heights = (1 - 1e-3 * settings.below_pole_mm / ball_radius,
                         -1e-3 * settings.below_equator_mm / ball_radius)
        self.axes: Floats = np.eye(3)
        self._touch_on(settings.circles, settings.points_per_circle)
        total, factors = 1e-6 * settings.repeatability_um, centre_factors(self.direction)
        self.touch_noise = settings.touch_share * total / factors.max()
        self.position_noise = np.sqrt(np.maximum(total**2 - (factors * self.touch_noise)**2, 0.0))

    def _touch_on(self, circles: int, points: int) -> None:
        self.direction = touch_directions(circles, points, *self._heights)
        self.points_per_circle = points

    def of(self, touches: int) -> 'TouchPattern':
        """Return the pattern of another number of touches, each as good; raises InvalidPlan for one that is none."""
        if touches in (0, self.size):
            return self
        if touches not in TOUCHES:
            raise InvalidPlan(f'touches: expected one of {", ".join(map(str, TOUCHES))}, or 0 for {self.size}, found '
                              f'{touches}')
        other = copy.copy(self)
        other._touch_on(*circles_of(touches))
        return other

    def towards(self, pole: Floats) -> 'TouchPattern':
        """Return the pattern about another pole, a direction (3,) in the machine."""
        other = copy.copy(self)
        other.axes = _axes_along(*pole.tolist())
        return other

    @property
    def size(self) -> int:
        """Q, the number of touches."""
        return len(self.direction)


@lru_cache(maxsize=64)
def _axes_along(*pole: float) -> Floats:
    """Return `axis_rotation` of a pole: the live cell asks ball after ball for that of the table."""
    return axis_rotation(pole)


def contact(aim: Floats, direction: Floats, centre: Floats, reach: Floats | float) -> Floats:
    """Return how far the tip's centre is from the aim when it touches, (N, Q), m.

    The tip comes along the line aim + s * direction and stops at distance `reach` from the ball's centre: s^2 - 2 s
    u.(c - a) + |c - a|^2 = reach^2. aim: (N, 1, 3); direction: (Q, 3); centre: (N, Q or 1, 3); reach: radius of ball
    and tip, scalar or (N, Q), m.
    """
    off = centre - aim
    along = np.vecdot(off, direction)
    return along + np.sqrt(along * along - np.vecdot(off, off) + reach * reach)
