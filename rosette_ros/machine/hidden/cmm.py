# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002, ARG003 (every effect is asked and drawn alike)
"""What the coordinate measuring machine and its probe add: reversal, single bad readings, dust."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rosette_ros.machine.hidden.base import UM, HiddenEffect, along, drawn_time, drawn_vector
from rosette_ros.machine.settings import NotNegative, Number, Vector


class CmmReversal(HiddenEffect):
    """An axis leans to the side it came from: half the value before, half after."""

    kind: Literal['cmm_reversal'] = 'cmm_reversal'
    value_um: Vector

    def probe_shift(self, moment):
        """Return half the value per axis in the sense of its last move."""
        return 0.5 * UM * np.asarray(self.value_um) * moment.cmm_sense

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one in x and y."""
        return cls(value_um=drawn_vector(rng, size_um, axes=2))


class Outlier(HiddenEffect):
    """The reading that is being made at one time is off: something shook."""

    kind: Literal['outlier'] = 'outlier'
    shift_um: Vector
    at_h: NotNegative

    def probe_shift(self, moment):
        """Return the shift in the reading that `at_h` falls into."""
        return along(self.shift_um, _while_made(moment, self.at_h))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one; a single reading sees it, so it is larger."""
        return cls(shift_um=drawn_vector(rng, size_um * situation.balls),
                   at_h=drawn_time(rng, situation))


class TouchDust(HiddenEffect):
    """A speck of dust under one touch of the reading that is being made at one time."""

    kind: Literal['touch_dust'] = 'touch_dust'
    thickness_um: Number
    touch: Annotated[int, Field(ge=1, description='number of the touch')]
    at_h: NotNegative

    def surface(self, moment, direction, touches):
        """Return the thickness of the dust at its touch."""
        number = np.arange(1, direction.shape[-2] + 1)
        return UM * self.thickness_um * (_while_made(moment, self.at_h) & (number == self.touch))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one; a twentieth of it reaches the centre of a single reading."""
        return cls(thickness_um=5 * size_um * situation.balls, touch=int(rng.integers(1, 21)),
                   at_h=drawn_time(rng, situation))


def _while_made(moment, at_h):
    """Return in which reading a time falls, from its first move to its last touch, (N, 1)."""
    return (moment.began <= at_h * 3600.0) & (at_h * 3600.0 < moment.ended)
