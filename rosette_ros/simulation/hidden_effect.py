# SPDX-License-Identifier: Apache-2.0
"""The contract of a hidden effect: what it moves, turns or deforms, at each touch.

An effect writes only its own physics: parameters with units, each with what draws it (Drawn), and the hooks it needs.
The machine calls every hook of every effect and composes the rigid bodies exactly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.records import Floats
from rosette_ros.simulation.setting_types import Settings

UM = 1e-6
"""One micrometre or one microradian."""
HOOKS = {
    'frame_shift': 'shift of the table relative to the probe, machine frame, m',
    'axis_tilt': "tilt of the table's axis, rotation vector in the table frame, rad",
    'table_shift': 'shift of the turning part, in the table frame, m',
    'table_tilt': 'tilt of the turning part, rotation vector in the table frame, rad',
    'table_turn': 'angle by which the turning part is ahead of its encoder, rad',
    'plate_shift': 'shift of the plate on the table, in the turning frame, m',
    'plate_turn': 'turn of the plate on the table about the axis, rad',
    'plate_growth': 'relative growth of the plate in its plane',
    'ball_shift': 'shift of the measured ball on the plate, in the turning frame, m',
    'surface': 'how much the ball stands out at its touch points, m',
    'probe_shift': 'what the CMM adds to each coordinate it shows, machine frame, m',
    'noise_factor': 'factor on the noise of a reading, broadcasts to (N, 1)',
}
"""Methods that an effect may have, by name, and what each returns at a Moment.

The array broadcasts to (N, Q) or, for vectors, (N, Q, 3). `surface` is also given the (N, Q, 3) unit vectors from the
ball's centre to the touch points, z towards the pole, and the TouchPattern.
"""


@dataclass(frozen=True)
class Situation:
    """The run that effects are drawn for: n; radius, m; begin after power-on and duration, h; repeatability, µm."""

    balls: int
    radius: float
    start_h: float
    duration_h: float
    sigma_um: float

    @property
    def scale_um(self) -> float:
        """What sizes are drawn in units of: the repeatability, 0.1 µm where that is zero."""
        return self.sigma_um if self.sigma_um > 0 else 0.1


@dataclass(frozen=True)
class Draw:
    """What an effect draws its parameters from: the generator, the size in the readings, the run it shows in."""

    rng: np.random.Generator
    size_um: float
    run: Situation

    @property
    def angle_urad(self) -> float:
        """Rotation that moves the balls by the size."""
        return self.size_um / self.run.radius

    def between(self, low: float, high: float) -> float:
        """Return a number, all alike likely."""
        return float(self.rng.uniform(low, high))

    def sign(self) -> float:
        """Return +1.0 or -1.0."""
        return float(self.rng.choice([-1.0, 1.0]))

    def ball(self) -> int:
        """Return the number of a ball."""
        return int(self.rng.integers(1, self.run.balls + 1))

    def time(self) -> float:
        """Return a time in the middle of the run, h since power-on."""
        return self.run.start_h + self.run.duration_h * self.between(0.3, 0.8)

    def vector(self, size: float, axes: int = 3) -> tuple[float, float, float]:
        """Return a vector of length `size` in a drawn direction; axes: 3, or 2 for one in the x-y plane."""
        direction = self.rng.standard_normal(3)
        direction[axes:] = 0.0
        x, y, z = (size * direction / np.linalg.norm(direction)).tolist()
        return x, y, z


@dataclass(frozen=True)
class Drawn:
    """What draws a parameter of an effect; stands in the annotation of its field. Fields are drawn in their order."""

    value: Callable[[Draw], object]


class HiddenEffect(Settings):
    """One physical effect that the machine does not publish; its methods are named in HOOKS.

    is_named: whether the library of effects has a name for it; needs_tilt: whether it needs a table axis that is not
    vertical. Unnamed kinds and those are drawn only when asked for.
    """

    is_named: ClassVar[bool] = True
    needs_tilt: ClassVar[bool] = False
    kind: str

    @classmethod
    def draw(cls, by: Draw) -> Self:
        """Draw one that moves the balls by about `by.size_um` during the run; more where few readings see it."""
        return cls.model_validate({name: one.value(by) for name, field in cls.model_fields.items()
                                   for one in field.metadata if isinstance(one, Drawn)})


def acting(effects: Sequence[HiddenEffect]) -> dict[str, tuple[Callable[..., Floats], ...]]:
    """Return, for each hook's name, the methods of those effects that have it."""
    return {hook: tuple(getattr(effect, hook) for effect in effects if hasattr(effect, hook)) for hook in HOOKS}


def along(vector: ArrayLike, course: ArrayLike) -> Floats:
    """Return a fixed vector (3,) [um or urad] times a course (N, Q), as (N, Q, 3) in SI."""
    return np.asarray(vector) * UM * np.asarray(course)[..., None]
