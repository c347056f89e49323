# SPDX-License-Identifier: Apache-2.0
"""CALYPSO characteristics (chr.txt): tabs between cells, a row for each characteristic of a feature."""

import re

from rosette_ros.io.foreign.foreign_table import ForeignTable

COLUMNS = {'name': 'id', 'axis': 'idsymbol', 'value': 'actual'}


def read(text: str, source: str) -> ForeignTable | None:
    """Return the table as it is; None where its first column is not the inspection plan."""
    if not text.startswith('planid\t'):
        return None
    lines = [(line, row) for line, row in enumerate(re.split('\r\n|\r|\n', text), 1) if row.strip() != 'END']
    names, first = (row.split('\t') for _, row in (*lines, (0, ''))[:2])
    cells = dict(zip(names, first))
    is_apart = cells.get('featureid', '').strip() not in ('', cells.get('id', '').strip())  # ids are of characteristics
    return ForeignTable(lines, {**COLUMNS, 'name': 'featureid'} if is_apart else COLUMNS)
