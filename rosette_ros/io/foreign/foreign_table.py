# SPDX-License-Identifier: Apache-2.0
"""What a reader of a format makes of a text: the lines of a table, the unit and the names of its columns."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ForeignTable:
    """A table with tabs between its cells.

    lines: number in the file and text of each line, the names of the columns first; columns: those that are proposed,
    name by quantity of a map (name, axis, value, x, time ...); unit: of the coordinates, '' if it is not said.
    """

    lines: Sequence[tuple[int, str]]
    columns: Mapping[str, str]
    unit: str = ''

    @classmethod
    def of_rows(cls, names: Iterable[str], rows: Iterable[tuple[int, Sequence[str]]], columns: Mapping[str, str],
                unit: str = '') -> 'ForeignTable':
        """Return the table of rows, line in the file and cells in the order of the names of the columns."""
        plain = ((line, '\t'.join(cell.replace('\t', ' ').replace('"', '') for cell in cells)) for line, cells in rows)
        return cls([(1, '\t'.join(names)), *plain], columns, unit)
