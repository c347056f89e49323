# SPDX-License-Identifier: Apache-2.0
"""From which probability on something is looked at, listed, claimed and said as found."""

HEARD = 1e-3
"""Probability of a hypothesis below which nobody asks what it says: its share counts in no sum that is told."""
LISTED = 0.03
"""Probability from which on an explanation is fitted, a law is said and, over that of a name, another name is listed
that the run cannot tell from it."""
WHOLE = 0.95
"""Probability that the explanations that are listed, the readings between which an event lies, and the bodies and
variables that are said, hold together."""
CLAIM = 0.7
"""Probability of a cause, with what this run cannot tell from it, from which on it is claimed."""
SURE = 0.9
"""Probability from which on something is said as found; below it is suspected."""
GUARD = 0.05
"""Search-wide probability of noise alone above which no name is claimed, whatever it is worth, and no effect of a
model is needed: what users were promised."""
