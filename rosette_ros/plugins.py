# SPDX-License-Identifier: Apache-2.0
"""What other installed packages add, by entry points: effects (`rosette.effects`) and readers of files
(`rosette.readers`)."""

from functools import cache
from importlib.metadata import entry_points
from typing import Any


@cache
def added(group: str) -> dict[str, Any]:
    """Return what the installed packages add to a group, by the name of the entry point."""
    return {one.name: one.load() for one in entry_points(group=group)}
