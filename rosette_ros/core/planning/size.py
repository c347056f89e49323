# SPDX-License-Identifier: Apache-2.0
"""Up to which size of a plate orders and next readings are compared."""

from rosette_ros.core.run.errors import InvalidPlan

MOST_BALLS = 72
"""Next readings of so many balls take 2.2 GB, of 120 balls 6.9 GB."""


def refuse_more(n: int, where: str) -> None:
    """Raise InvalidPlan where a plate has more than MOST_BALLS balls; where: what asks for it, for the message."""
    if n > MOST_BALLS:
        raise InvalidPlan(f'{where}: expected at most {MOST_BALLS} balls, found {n}: for more it takes minutes and '
                          'memory (72 balls: 2 GB, 120 balls: 7 GB); measure a whole plan, and diagnose it')
