# SPDX-License-Identifier: Apache-2.0
"""Whether the readings of several runs allow that these share something."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import scipy  # which loads its parts where they are used

from rosette_ros.core.joint.joint_model import JointModel
from rosette_ros.core.joint.joint_solution import JointSolution
from rosette_ros.core.run.errors import NotDeterminable

CONTRADICTED = 1e-3
"""Probability below which the data contradict that something is shared: several such tests are made at once."""
NO_NOISE = 1e-12
"""Scatter of a coordinate that rounding makes, m: less of it decides nothing."""


@dataclass(frozen=True)
class SharingTest:
    """Whether the data allow that something is shared: F of the readings with and without it.

    item: of Sharing.items, or 'sense': that both senses of turning have the same curves; dof: of the difference; p:
    chance of as large an F where it holds, None where the data cannot tell; is_used: whether it is in the model.
    """

    item: str
    f: float
    dof: int
    p: float | None
    is_used: bool

    @property
    def is_contradicted(self) -> bool:
        """Whether the data contradict it."""
        return self.p is not None and self.p < CONTRADICTED


def tested(solution: JointSolution, item: str) -> SharingTest:
    """Return the test of an item that the runs of a solution share, with what they have beside the model."""
    runs, sharing, beside = solution.model.runs, solution.model.sharing, solution.beside
    try:
        free = ([JointSolution(JointModel([run], sharing.of_one()), beside.alone(place))
                 for place, run in enumerate(runs)] if sharing.is_all(item) else
                [JointSolution(JointModel(runs, sharing.without(item)), beside)])
    except NotDeterminable:  # too little else joins the runs
        return SharingTest(item, 0.0, 0, None, True)
    return _f_test(item, [solution], free)


def sense_tested(solution: JointSolution) -> SharingTest:
    """Return the test of whether both senses of turning have the same curves."""
    together = JointSolution(JointModel(solution.model.runs, solution.model.sharing.without('sense')), solution.beside)
    return replace(_f_test('sense', [together], [solution]), is_used=False)


def _f_test(item: str, shared: Sequence[JointSolution], free: Sequence[JointSolution]) -> SharingTest:
    """Return the test of what is shared against what is free, each in one solution or in one of each run."""
    dof, free_dof = sum(one.rank for one in free) - sum(one.rank for one in shared), sum(one.dof for one in free)
    if dof <= 0 or free_dof <= 0:
        return SharingTest(item, 0.0, 0, None, True)
    rss = sum(one.rss for one in free)
    f = max(sum(one.rss for one in shared) - rss, 0.0) / dof / max(rss / free_dof, NO_NOISE**2)
    return SharingTest(item, f, dof, float(scipy.special.fdtrc(dof, free_dof, f)), True)
