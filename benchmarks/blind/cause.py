# SPDX-License-Identifier: Apache-2.0
"""The contract of a foreign cause: physics, and what a true answer may say of it.

To add a cause, write its class: the hooks of rosette_ros.simulation.hidden.hidden_effect.HOOKS that it needs, `draw`,
and what would be true of it; and a line of foreign_causes. A name of `right` is the cause or its family. A name of
`part` is a true part of it. A name of `family` is true only where its shape describes the cause in that run, within
what noise lets see.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rosette_ros.core.records import Floats, Run
from rosette_ros.simulation.hidden.hidden_effect import Draw

Vector = tuple[float, float, float]
Names = tuple[str, ...]

DRIFTS: Names = ('frame_drift', 'frame_drift_onset', 'frame_drift_curved', 'frame_warmup', 'frame_temperature',
                 'frame_temperature_lag')
"""Shapes of a drift of the frame."""


@dataclass(frozen=True)
class Cause(ABC):
    """A cause; groups: settings of the machine on which it can be seen; turning: of the plan that shows it.

    variables: what it depends on, each alternative a set of keys of answers.VARIABLES; frame: of its directions.
    """

    right: ClassVar[Names] = ()
    part: ClassVar[Names] = ()
    family: ClassVar[Names] = ()
    variables: ClassVar[tuple[frozenset[str], ...]] = ()
    groups: ClassVar[dict[str, Any]] = {}
    turning: ClassVar[str] = 'forward'
    frame: ClassVar[str] = 'machine'

    @classmethod
    @abstractmethod
    def draw(cls, by: Draw) -> Self:
        """Draw one that moves the balls by about the size."""

    def recorded(self, run: Run) -> Run:
        """Return the run as it is recorded."""
        return run


def said(*words: str) -> tuple[frozenset[str], ...]:
    """Return alternatives of what a cause depends on: 'ball time' are two variables of one alternative."""
    return tuple(frozenset(alternative.split()) for alternative in words)


def lagged(hours: Floats, value: Floats, constant: float) -> Floats:
    """Return what follows a value with a time constant [h], in equilibrium with the first one, (N,)."""
    out, step = value.copy(), np.diff(hours)
    for place in range(1, value.size):
        # exact where the value goes along a line between two readings
        decay = np.exp(-step[place - 1] / constant)
        rate = (value[place] - value[place - 1]) / step[place - 1]
        out[place] = value[place] - rate * constant + (out[place - 1] - value[place - 1] + rate * constant) * decay
    return out
