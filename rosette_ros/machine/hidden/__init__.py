# SPDX-License-Identifier: Apache-2.0
"""What the simulated machine can hide: physics of its own, found by nobody but a diagnosis.

A new kind is a class in the file of its family and one line in KINDS.
"""

from typing import Annotated, Union

from pydantic import Field

from rosette_ros.machine.hidden.base import HiddenEffect, Situation, acting
from rosette_ros.machine.hidden.cmm import CmmReversal, Outlier, TouchDust
from rosette_ros.machine.hidden.draw import HiddenDraw
from rosette_ros.machine.hidden.frame import (
    FrameCycle,
    FrameDrift,
    FrameStep,
    FrameTemperature,
    FrameWarmup,
)
from rosette_ros.machine.hidden.plate import (
    BallForm,
    BallSlip,
    PlateCreep,
    PlateExpansion,
    PlateSlip,
    PlateWarp,
)
from rosette_ros.machine.hidden.strange import BedRipple, FrameAcceleration, UnevenNoise
from rosette_ros.machine.hidden.table import (
    AsynchronousMotion,
    AxisTiltDrift,
    TableBacklash,
    TableWarmup,
    TableZeroDrift,
)

KINDS = {
    'frame_drift': FrameDrift,
    'frame_warmup': FrameWarmup,
    'frame_temperature': FrameTemperature,
    'frame_cycle': FrameCycle,
    'frame_step': FrameStep,
    'table_zero_drift': TableZeroDrift,
    'axis_tilt_drift': AxisTiltDrift,
    'table_backlash': TableBacklash,
    'asynchronous_motion': AsynchronousMotion,
    'table_warmup': TableWarmup,
    'plate_creep': PlateCreep,
    'plate_slip': PlateSlip,
    'plate_expansion': PlateExpansion,
    'plate_warp': PlateWarp,
    'ball_slip': BallSlip,
    'ball_form': BallForm,
    'cmm_reversal': CmmReversal,
    'outlier': Outlier,
    'touch_dust': TouchDust,
    'bed_ripple': BedRipple,
    'frame_acceleration': FrameAcceleration,
    'uneven_noise': UnevenNoise,
}
"""Every kind of hidden effect by the name it has in the configuration."""

STRANGE = ('touch_dust', 'bed_ripple', 'frame_acceleration', 'uneven_noise')
"""Kinds for which no library of named effects need have a name; drawn only when asked for."""

NAMED = tuple(kind for kind in KINDS if kind not in STRANGE)
"""Kinds that are drawn unless others are asked for."""

_AnyKind = Annotated[Union[tuple(KINDS.values())], Field(discriminator='kind')]  # noqa: UP007
HiddenList = Annotated[tuple[_AnyKind, ...], Field(strict=False, max_length=100)]


def draw_hidden(order, situation):
    """Return the hidden effects that a HiddenDraw orders, a tuple; the same for the same seed.

    situation: the run they shall show in.
    """
    known = order.kinds or NAMED
    return order.drawn([KINDS[kind] for kind in known], situation)


__all__ = ['KINDS', 'NAMED', 'STRANGE', 'HiddenDraw', 'HiddenEffect', 'HiddenList', 'Situation',
           'acting', 'draw_hidden']
