# SPDX-License-Identifier: Apache-2.0
"""Which numbers a quantity of a calibration can have, in any unit in use: what is beyond is a slip, and is refused."""

from typing import TypeGuard

LARGEST, SMALLEST = 1e12, 1e-30
"""Sizes in any unit that are in use; squares of them and their inverses are numbers, too."""


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a number is finite and no larger than a quantity can be; true and false are no numbers."""
    return isinstance(value, (int, float)) and type(value) is not bool and abs(value) <= LARGEST


def is_size(value: object) -> TypeGuard[float]:
    """Return whether a number is a positive one that a quantity can have."""
    return is_number(value) and value >= SMALLEST
