# SPDX-License-Identifier: Apache-2.0
"""How likely a run has an effect, before its readings are looked at: one answer for the diagnosis and for U.

Effects come as a Poisson process: EXPECTED in a run, of which A_FREE have no name, shared out over the families that
are looked at but for what each has to find, SEARCHED. The odds that a family is there are its rate, exp(log_prior). A
diagnosis looks for those that can be seen, SEEN of all; U is of all.
"""

import math
from collections.abc import Sequence

import numpy as np

from rosette_ros.core.effects.free import bodies_beside
from rosette_ros.core.model.experience import Experience
from rosette_ros.core.sight.bank import CauseFamily

EXPECTED = 2.0
"""Effects that a run is expected to have, of any size."""
SEEN = 0.5
"""Share of them that are large enough to be looked for: EXPECTED x SEEN is calibrated on simulated clean runs."""
A_FREE = 0.2
"""Share of the causes in cells that the library does not name."""
SEARCHED = 1.0
"""Each number that has to be searched makes a cause rarer by e: so many particular things are seldom true."""


def with_priors(families: Sequence[CauseFamily], seen: float = SEEN,
                experience: Experience | None = None) -> Sequence[CauseFamily]:
    """Share the expected effects out over the families of a run, and return these.

    seen: share of the effects that are meant, 1 for those of any size; experience: of the cell, whose odds take the
    place of those of any cell where it knows a cause."""
    free = A_FREE if any(family.is_free for family in families) else 0.0
    for is_free in (False, True):
        some = [family for family in families if family.is_free == is_free]
        weight = np.array([math.exp(log_found(family)) / (bodies_beside(family.name) if is_free else 1)
                           for family in some])  # each part of the cell moves as often, by any of its bodies
        share = EXPECTED * seen * (free if is_free else 1 - free)
        for family, own in zip(some, weight / weight.sum() if len(some) else ()):
            family.log_prior = math.log(share * own)
            if experience and (known := experience.by_name.get(family.name)):
                family.learnt = math.log(known.rate / (1 - known.rate)) + log_found(family) - family.log_prior
                family.log_prior += family.learnt
    return families


def log_found(family: CauseFamily) -> float:
    """Return the log of the factor by which what a family has to find makes it rarer in each run.

    It is part of its prior, and of no rate: moments and constants are searched anew however often a cell has it."""
    return -SEARCHED * (family.name.count('×') if family.is_free else sum(
        one.kind != 'choice' for one in family.effect.searched))
