# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: N815 (the unit kelvin is a capital letter)
"""What plate and balls do on the table: creep, slip, growth, warp, loose and lobed balls."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rosette_ros.machine.hidden.base import (
    UM,
    BallNumber,
    HiddenEffect,
    along,
    drawn_sign,
    drawn_time,
    drawn_vector,
)
from rosette_ros.machine.settings import NotNegative, Number, Vector


class PlateCreep(HiddenEffect):
    """The clamping lets the plate slide steadily."""

    kind: Literal['plate_creep'] = 'plate_creep'
    rate_um_per_h: Vector

    def plate_shift(self, moment):
        """Return rate * t."""
        return along(self.rate_um_per_h, moment.hours)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that slides by about `size_um` during the run."""
        return cls(rate_um_per_h=drawn_vector(rng, size_um / situation.duration_h, axes=2))


class PlateSlip(HiddenEffect):
    """The plate slips once: a shift, and a turn about the axis."""

    kind: Literal['plate_slip'] = 'plate_slip'
    shift_um: Vector
    turn_urad: Number = 0.0
    at_h: NotNegative

    def plate_shift(self, moment):
        """Return the shift from its time on."""
        return along(self.shift_um, moment.hours >= self.at_h)

    def plate_turn(self, moment):
        """Return the turn from its time on."""
        return self.turn_urad * UM * (moment.hours >= self.at_h)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one in the middle of the run."""
        return cls(shift_um=drawn_vector(rng, size_um, axes=2),
                   turn_urad=drawn_sign(rng) * 0.5 * size_um / situation.radius,
                   at_h=drawn_time(rng, situation))


class PlateExpansion(HiddenEffect):
    """The plate grows in its plane, with time or with the temperature."""

    kind: Literal['plate_expansion'] = 'plate_expansion'
    rate_ppm_per_h: Number = 0.0
    coefficient_ppm_per_K: Number = 0.0

    def plate_growth(self, moment):
        """Return the relative growth."""
        return UM * (self.rate_ppm_per_h * moment.hours
                     + self.coefficient_ppm_per_K * moment.warming)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one that moves the balls outwards by about `size_um` during the run."""
        ppm = drawn_sign(rng) * size_um / situation.radius
        if rng.random() < 0.5:
            return cls(rate_ppm_per_h=ppm / situation.duration_h)
        return cls(coefficient_ppm_per_K=ppm / 0.1)


class PlateWarp(HiddenEffect):
    """The plate warps like a saddle: z grows with cos(order * (beta - phase)) * t."""

    kind: Literal['plate_warp'] = 'plate_warp'
    rate_um_per_h: Number
    order: Annotated[int, Field(ge=2, le=12)] = 2
    phase_deg: Number = 0.0

    def ball_shift(self, moment):
        """Return the lift of the measured ball."""
        shape = np.cos(self.order * (moment.azimuth - np.deg2rad(self.phase_deg)))
        return along((0.0, 0.0, self.rate_um_per_h), shape * moment.hours)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw a saddle that lifts the balls by up to `size_um` during the run."""
        return cls(rate_um_per_h=size_um / situation.duration_h,
                   phase_deg=float(rng.uniform(0, 180)))


class BallSlip(HiddenEffect):
    """One ball comes loose and moves on the plate; axes of the turning frame."""

    kind: Literal['ball_slip'] = 'ball_slip'
    ball: BallNumber
    shift_um: Vector
    at_h: NotNegative

    def ball_shift(self, moment):
        """Return the shift of that ball from its time on."""
        return along(self.shift_um, (moment.hours >= self.at_h) & (moment.ball == self.ball))

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw one in the middle of the run; few readings see it, so it is larger."""
        return cls(ball=int(rng.integers(1, situation.balls + 1)),
                   shift_um=drawn_vector(rng, size_um * np.sqrt(situation.balls)),
                   at_h=drawn_time(rng, situation))


class BallForm(HiddenEffect):
    """One ball is lobed and turns under touches that do not turn with it.

    `order` lobes of the surface, at Q touches evenly spaced on each horizontal circle, move the
    found centre in x-y where order + 1 or order - 1 is a multiple of Q, and in z where order is.
    Such orders are a true surface in the ball's frame. An order that even touches cannot see
    stands for touches spaced unevenly: at the touch points the ball then stands out as if its
    centre had moved by centre_um * (cos(m phi + psi), -sin(m phi + psi)). The motion has the form
    (cos, -sin) where order + 1 is a multiple of Q (order 3 for four touches), (cos, +sin) where
    order - 1 is (order 5).
    """

    kind: Literal['ball_form'] = 'ball_form'
    ball: BallNumber
    order: Annotated[int, Field(ge=2, le=30)]
    centre_um: Number = Field(description='amplitude of the apparent motion of the centre')
    direction: Literal['xy', 'z'] = 'xy'
    phase_deg: Number = 0.0

    def surface(self, moment, direction, touches):
        """Return how much this ball stands out at its touch points."""
        height = UM * self.centre_um * (moment.ball == self.ball)
        turn = self.order * moment.angle + np.deg2rad(self.phase_deg)
        azimuth = np.arctan2(direction[..., 1], direction[..., 0])
        around = np.sqrt(direction[..., 0]**2 + direction[..., 1]**2)
        spacing = touches.points_per_circle
        if self.direction == 'z':
            lobes = turn - self.order * azimuth if self.order % spacing == 0 else turn
            return height * direction[..., 2] * np.cos(lobes)
        if (self.order + 1) % spacing == 0:
            return height * around * np.cos(turn - self.order * azimuth)
        if (self.order - 1) % spacing == 0:
            return height * around * np.cos(self.order * azimuth - turn)
        return height * around * np.cos(azimuth + turn)

    @classmethod
    def draw(cls, rng, size_um, situation):
        """Draw what four touches a circle can see; few readings see it, so it is larger."""
        direction, order = [('xy', 3), ('z', 4)][int(rng.integers(2))]
        return cls(ball=int(rng.integers(1, situation.balls + 1)), direction=direction,
                   order=order, centre_um=size_um * np.sqrt(situation.balls),
                   phase_deg=float(rng.uniform(0, 360)))
