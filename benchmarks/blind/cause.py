# SPDX-License-Identifier: Apache-2.0
"""The contract of a cause that the library of effects does not have, and what several causes need.

To add a cause, write its class and a line of CAUSES: the hooks of rosette_ros.simulation.hidden_effect.HOOKS
that it needs, `draw`, and what is true of it. A name of `right` is the cause; one of `part` is a true part of it; one
of `family` is fair only where its shape describes the cause in that run, within what noise lets see. `body` is what
moves, one of BODIES or several that move alike: along z frame and plate do.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rosette_ros.core.run.records import Floats, Run
from rosette_ros.simulation.hidden_effect import Draw
from rosette_ros.simulation.motion import Moment

Vector = tuple[float, float, float]
Names = tuple[str, ...]
Variables = tuple[frozenset[str], ...]

DRIFTS: Names = ('frame_drift', 'frame_drift_onset', 'frame_drift_curved', 'frame_warmup', 'frame_temperature',
                 'frame_temperature_lag')
"""Shapes of a drift of the frame."""
BODIES: dict[str, Names] = {
    'frame': ('table angle',), 'plate': ('table angle',), 'table or plate turning': ('CMM position', 'ball'),
    'table axis tilting': ('CMM position',), 'plate tilting': ('ball',), 'plate growing': ('CMM position', 'ball'),
    'scales and squareness of the CMM': ('CMM position',), 'plate distorting': ('CMM position', 'ball')}
PARTS = {'first scale of the CMM', 'second scale of the CMM', 'squareness of the CMM'}
"""What else is said of the scales and squareness of the CMM."""
"""What can move; and on what else, any of them, another displacement of frame or plate depends that is the same."""
CLIMATE: dict[str, Any] = {'climate': {'cycle_K': 0.1, 'cycle_min': 70.0}}
"""A climate in which the temperature goes up and down during a run."""


@dataclass(frozen=True)
class Cause(ABC):
    """A cause; variables: what it depends on, alternatives; groups: settings of the machine; turning: of the plan."""

    right: ClassVar[Names] = ()
    part: ClassVar[Names] = ()
    family: ClassVar[Names] = ()
    variables: ClassVar[Variables] = ()
    body: ClassVar[Names] = ()
    groups: ClassVar[dict[str, Any]] = {}
    turning: ClassVar[str] = 'forward'

    @classmethod
    @abstractmethod
    def draw(cls, by: Draw, clean: Run) -> Self:
        """Draw one that moves the balls by about the size; clean: the run without it."""


def said(*alternatives: str) -> Variables:
    """Return alternatives of what a cause depends on: 'ball + time' are two variables of one alternative."""
    return tuple(frozenset(alternative.split(' + ')) for alternative in alternatives)


def since(moment: Moment, hour: float) -> Floats:
    """Return the time since an hour, zero before it, (N, Q), h."""
    return np.maximum(moment.hours - hour, 0.0)


def settling(moment: Moment, hour: float, constant_h: float) -> Floats:
    """Return 1 − exp(−(t − t0)/τ), zero before t0, (N, Q)."""
    return -np.expm1(-since(moment, hour) / constant_h)


def turned_share(moment: Moment, total: float) -> Floats:
    """Return the angle turned in any sense since the first of these readings, in units of `total` rad, (N, 1)."""
    return (moment.turned - moment.turned[0]) / total


def total_turned(run: Run) -> float:
    """Return the angle by which the table turns in a run, whatever the sense, rad."""
    return float(np.abs(np.diff(run.table_travel)).sum())


def place(moment: Moment, radius: float) -> Floats:
    """Return where the ball stands about the table's axis, x and y, (N, 1, 2), m."""
    at = moment.angle + moment.azimuth
    return radius * np.stack([np.cos(at), np.sin(at)], axis=-1)
