# SPDX-License-Identifier: Apache-2.0
"""From which probability on something is claimed, and said as found."""

CLAIM = 0.7
"""Probability of a cause, with what this run cannot tell from it, from which on it is claimed."""
SURE = 0.9
"""Probability from which on something is said as found; below it is suspected."""
