# SPDX-License-Identifier: Apache-2.0
"""PC-DMIS: its report as text is no table, and is refused with what to export instead."""

import re

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.foreign.foreign_table import ForeignTable

_DIMENSION = re.compile(r'^DIM \S+ ?= ?LOCATION OF \w+ ', re.MULTILINE)
_FIRST = 1 << 16


def read(text: str, source: str) -> ForeignTable | None:
    """Return None where the text is no report; raises InvalidData where it is one."""
    if not _DIMENSION.search(text[:_FIRST]):
        return None
    raise InvalidData(f'{source}: expected a table of ball centres, found a PC-DMIS report as text; export the '
                      'locations as CSV with the columns Feature, Axis, Meas, or as QIF or Q-DAS (.dfq)')
