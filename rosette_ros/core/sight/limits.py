# SPDX-License-Identifier: Apache-2.0
"""From which probability on something is listed, claimed and said as found."""

LISTED = 0.05
"""Probability from which on something is told at all: an explanation, a law, another name over that of the one in whose
place it may be. What is told, variables and bodies too, holds all but this together, and noise alone does as well as a
claim more seldom."""
CLAIM = 0.7
"""Probability of a cause, with what this run cannot tell from it, from which on it is claimed."""
SURE = 0.9
"""Probability from which on something is said as found; below it is suspected."""
