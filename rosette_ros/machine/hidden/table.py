# SPDX-License-Identifier: Apache-2.0
"""What the table does beside its repeatable errors: drifts, backlash, bearing, growth."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rosette_ros.machine.hidden.base import UM, HiddenEffect, along, drawn_sign, drawn_vector
from rosette_ros.machine.settings import Number, Pair, Positive


class TableZeroDrift(HiddenEffect):
    """The zero of the angle encoder drifts."""

    kind: Literal['table_zero_drift'] = 'table_zero_drift'
    rate_urad_per_h: Number

    def table_turn(self, moment):
        """Return rate * t."""
        return self.rate_urad_per_h * UM * moment.hours

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that moves the balls by about `size_um` during the run."""
        rate = size_um / situation.radius / situation.duration_h
        return cls(rate_urad_per_h=drawn_sign(rng) * rate)


class AxisTiltDrift(HiddenEffect):
    """The bed bends: the table's axis tilts steadily about x and y."""

    kind: Literal['axis_tilt_drift'] = 'axis_tilt_drift'
    rate_urad_per_h: Pair

    def axis_tilt(self, moment):
        """Return rate * t about x and y."""
        return along((*self.rate_urad_per_h, 0.0), moment.hours)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that lifts the balls by about `size_um` during the run."""
        rate = size_um / situation.radius / situation.duration_h
        return cls(rate_urad_per_h=drawn_vector(rng, rate, axes=2)[:2])


class TableBacklash(HiddenEffect):
    """The table stops elsewhere when it comes from the other side: half before, half after."""

    kind: Literal['table_backlash'] = 'table_backlash'
    width_urad: Number

    def table_turn(self, moment):
        """Return half the width in the sense of the last move."""
        return 0.5 * self.width_urad * UM * moment.approach

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that moves the balls by `size_um` between the senses."""
        return cls(width_urad=drawn_sign(rng) * size_um / situation.radius)


class AsynchronousMotion(HiddenEffect):
    """The bearing's cage turns at its own pace: the axis wanders with nu times the travel.

    Radial motion is an orbit, tilt motion a cone, axial motion up and down.
    """

    kind: Literal['asynchronous_motion'] = 'asynchronous_motion'
    order: Annotated[float, Field(gt=0, le=50, description='periods per turn, not whole')]
    radial_um: Number = 0.0
    axial_um: Number = 0.0
    tilt_urad: Number = 0.0
    phase_deg: Number = 0.0

    def _phase(self, moment):
        return self.order * moment.travel + np.deg2rad(self.phase_deg)

    def table_shift(self, moment):
        """Return the radial orbit and the axial wave."""
        cosine, sine = np.cos(self._phase(moment)), np.sin(self._phase(moment))
        return (along((self.radial_um, 0.0, self.axial_um), cosine)
                + along((0.0, self.radial_um, 0.0), sine))

    def table_tilt(self, moment):
        """Return the cone of the axis."""
        cosine, sine = np.cos(self._phase(moment)), np.sin(self._phase(moment))
        return along((self.tilt_urad, 0.0, 0.0), cosine) + along((0.0, self.tilt_urad, 0.0), sine)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one of the three motions with an order as cages have it."""
        sizes = {'radial_um': size_um, 'axial_um': size_um,
                 'tilt_urad': size_um / situation.radius}
        motion = str(rng.choice(list(sizes)))
        return cls(order=float(rng.uniform(0.37, 0.47)), phase_deg=float(rng.uniform(0, 360)),
                   **{motion: sizes[motion]})


class TableWarmup(HiddenEffect):
    """The bearing warms as it turns and lifts: growth * (1 - exp(-turned / scale)).

    Turning warms in either sense, so the sum of all angles counts.
    """

    kind: Literal['table_warmup'] = 'table_warmup'
    growth_um: Number
    scale_turns: Positive

    def table_shift(self, moment):
        """Return the axial growth."""
        turns = moment.turned / (2 * np.pi)
        return along((0.0, 0.0, self.growth_um), -np.expm1(-turns / self.scale_turns))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that settles within a tenth to half of a diagonal run."""
        return cls(growth_um=drawn_sign(rng) * size_um,
                   scale_turns=situation.balls * float(rng.uniform(0.1, 0.5)))


