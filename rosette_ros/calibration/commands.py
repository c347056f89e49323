# SPDX-License-Identifier: Apache-2.0
"""What a calibration asks of whoever drives it, and what it is told: commands, results, limits."""

from dataclasses import dataclass
from typing import NamedTuple

from rosette_ros.core.run.geometry import Frame
from rosette_ros.io.messages import Phase, Target


@dataclass(frozen=True)
class Limits:
    """When to ask again and when to give up; `settings.LIMITS` describes each field, with its unit."""

    answer_timeout: float = 120.0
    attempts: int = 3
    skips: int = 3
    evaluation_timeout: float = 120.0
    return_timeout: float = 60.0
    search: float = 0.02
    distance: float = 0.005
    angle: float = 0.01


class Until(NamedTuple):
    """Until when readings are added to a plan; `settings.UNTIL` describes each field."""

    probability: float
    uncertainty: float
    most: int


class Results(NamedTuple):
    """What the evaluator has published of a run: the error motions by their stamp, ns, their readings and the model by
    their hashes, and whether a diagnosis."""

    stamp_ns: int
    readings_hash: str
    model_hash: str
    diagnosed: bool


@dataclass(frozen=True)
class Ask:
    """Send this target to the CMM, after a wait, s."""

    target: Target
    wait: float = 0.0


@dataclass(frozen=True)
class Locate:
    """Publish the table frame in the machine frame, found at this ROS time, ns."""

    frame: Frame
    stamp_ns: int


@dataclass(frozen=True)
class PublishState:
    """Publish the state: the phase has changed."""


@dataclass(frozen=True)
class PublishRun:
    """Publish all targets and answers: they are complete."""


@dataclass(frozen=True)
class Verify:
    """Find out whether the log holds these results and their readings; then `verified`."""

    results: Results


@dataclass(frozen=True)
class AskNext:
    """Ask the evaluator, which has published these results, for at most so many readings; then `decided`."""

    results: Results
    readings: int


@dataclass(frozen=True)
class Extended:
    """Publish that the plan was extended, or is not any more."""

    text: str


@dataclass(frozen=True)
class Warn:
    """Log a warning."""

    text: str


@dataclass(frozen=True)
class Finish:
    """The calibration has ended in this phase, for this reason."""

    phase: Phase
    text: str


Command = Ask | Locate | PublishState | PublishRun | Verify | AskNext | Extended | Warn | Finish
Commands = tuple[Command, ...]
