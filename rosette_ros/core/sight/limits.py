# SPDX-License-Identifier: Apache-2.0
"""From which probability on something is listed, claimed and said as found, and what cannot be told apart."""

import math

LISTED = 0.05
"""Probability from which on something is told at all: an explanation, a law, another name over that of the one in whose
place it may be. What is told, variables and bodies too, holds all but this together, and noise alone does as well as a
claim more seldom."""
CLAIM = 0.7
"""Probability of a cause, with what this run cannot tell from it, from which on it is claimed."""
SURE = 0.9
"""Probability from which on something is said as found; below it is suspected."""
DETECTABLE = 6.0
"""Norm of what is not absorbed, in sigma, that the search finds nearly always."""
ALIKE = 1 - 2 * math.log(1 / LISTED) / DETECTABLE**2
"""Share of what an order shows of one thing that another describes where it cannot tell them apart.

What the other leaves of one of the size d, which is found, moves the log Bayes factor between them by an expected
d^2 (1 - share) / 2; below ln(1 / LISTED) the other one remains listed."""


def are_alike(worth: float, other: float, effects: int = 1) -> bool:
    """Return whether effects cannot be told apart from something else, by their log Bayes factors against nothing.

    What is stronger than so many effects that are just found counts as these: no law of a list is exact, and it shows
    the difference."""
    return worth - other < math.log(1 / LISTED) * max(1.0, worth / (effects * DETECTABLE**2 / 2))
