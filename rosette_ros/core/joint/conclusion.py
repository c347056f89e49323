# SPDX-License-Identifier: Apache-2.0
"""What a joint evaluation decides: whether the runs fit one model, and what they do not share."""

from dataclasses import dataclass
from enum import StrEnum

from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.run.records import UNLIKELY
from rosette_ros.core.uncertainty.stated_environment import Unseen


class JointOutcome(StrEnum):
    """What several runs decide together."""

    FITS = 'fit one model'
    IN_PART = 'fit one model in part'
    UNKNOWN = 'cannot be said: no repeatability'
    REFUTED = 'do not fit one model'
    CONTRADICTED = 'contradict what was declared'


JOINT_LEVELS = {
    JointOutcome.FITS: Level.GOOD, JointOutcome.IN_PART: Level.DOUBTFUL, JointOutcome.UNKNOWN: Level.DOUBTFUL,
    JointOutcome.REFUTED: Level.BAD, JointOutcome.CONTRADICTED: Level.BAD}


@dataclass(frozen=True)
class Conclusion:
    """What several runs say together.

    runs: how many; rms: of the residual, m; p: of lack of fit, None without a repeatability; items: what they were
    declared to share and do not, or do not share, as of ITEMS; unseen: what U contains of what the orders hide.
    """

    outcome: JointOutcome
    runs: int = 1
    rms: float = 0.0
    p: float | None = None
    items: tuple[str, ...] = ()
    unseen: Unseen | None = None

    @property
    def level(self) -> Level:
        """How the outcome is shown."""
        return JOINT_LEVELS[self.outcome]

    @property
    def lacks_environment(self) -> bool:
        """Whether U lacks what the orders hide, as no environment is stated."""
        return self.unseen is not None and not self.unseen.environment

    @property
    def model_fails(self) -> bool:
        """Whether the model is refuted."""
        return self.level is Level.BAD


def fits(result: JointResult) -> bool | None:
    """Return whether the runs fit one model, as of one run: p of lack of fit at least UNLIKELY; None: not known."""
    return None if result.lack_of_fit_p is None else result.lack_of_fit_p >= UNLIKELY


def conclude(result: JointResult) -> Conclusion:
    """Return the Conclusion of a joint evaluation."""
    untrue = tuple(test.item for test in result.tests if test.is_contradicted and test.is_used)
    unused = tuple(test.item for test in result.tests if test.item != 'sense' and not test.is_used)
    if untrue:
        outcome = JointOutcome.CONTRADICTED
    elif fits(result) is False:
        outcome = JointOutcome.REFUTED
    elif unused:
        outcome = JointOutcome.IN_PART
    else:
        outcome = JointOutcome.UNKNOWN if fits(result) is None else JointOutcome.FITS
    return Conclusion(outcome, len(result.solution.model.runs), result.rms, result.lack_of_fit_p, untrue or unused,
                      result.unseen)
