# SPDX-License-Identifier: Apache-2.0
"""What is found and has to be said: a kind, by which all is decided, and numbers; words/ makes sentences of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class RemarkKind(StrEnum):
    """What is wrong with readings; words/reading_words.py says each, and what to do."""

    LOG_DAMAGED = 'log damaged'
    TWO_ANSWERS = 'two answers to one target'
    SAME_STAMPS = 'answers have one time'
    SAME_TIME = 'readings have one time'
    CLOCK_SET_BACK = 'clock set back'
    TRAVEL_STAYS = 'travel stays the same'
    TRAVEL_JUMPS = 'travel is not cumulative'
    TRAVEL_DIFFERS = 'travel is not what was asked'
    NO_APPROACH = 'approach is always 0'
    OTHER_APPROACH = 'approach is not what was asked'
    ECHO = 'answers are the expected places'
    ROUNDED = 'readings are rounded'
    REPEATED_ALIKE = 'repeated readings are all the same'
    UNIT_OF_TIME = 'unit of the time in doubt'
    UNIT_OF_REPEATABILITY = 'unit of the repeatability in doubt'
    UNIT_OF_COORDINATES = 'unit of radius and coordinates in doubt'
    UNIT_OF_TEMPERATURE = 'unit of the temperature in doubt'
    NO_TEMPERATURE = 'temperature not measured'
    SAME_TEMPERATURE = 'thermometer stands still'
    GAPS = 'much time between readings'
    OTHER_RADIUS = 'radius is not that of the circle'
    # of a single answer
    OTHER_BALL = 'answer to another place or ball'
    CMM_FAILED = 'the CMM reports a failure'
    NOT_FINITE = 'numbers are not finite'
    OTHER_FRAME = 'answer in another frame'
    OTHER_ANGLE = 'table at another angle'
    FAR_AWAY = 'ball far from the target'


@dataclass(frozen=True)
class Remark:
    """What was found: its kind, and the numbers that are said of it by their names, in SI units."""

    kind: StrEnum
    numbers: Mapping[str, Any] = field(default_factory=dict)


def remark(kind: StrEnum, **numbers: Any) -> Remark:
    """Return the Remark of a kind with its numbers."""
    return Remark(kind, numbers)
