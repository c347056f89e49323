# SPDX-License-Identifier: Apache-2.0
"""One table for two readers: exact numbers for a spreadsheet, rounded ones for a page."""

import csv
import io
import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One column: `key` with its unit heads the file, `head` the page.

    values: as they go into the file; shown: as texts on the page, None for a column of the file alone;
    number: whether it stands flush right.
    """

    key: str
    head: str
    values: tuple
    shown: tuple | None
    number: bool = True


@dataclass(frozen=True)
class Table:
    """A table with a name (of its file), a title and columns of the same length."""

    name: str
    title: str
    columns: tuple[Column, ...]

    @property
    def shown(self):
        """The columns that stand on the page."""
        return tuple(column for column in self.columns if column.shown is not None)

    @property
    def rows(self):
        """The rows of the page, each a tuple of (text, whether it is a number)."""
        numbers = [column.number for column in self.shown]
        return tuple(tuple(zip(row, numbers, strict=True))
                     for row in zip(*(column.shown for column in self.shown), strict=True))

    def csv(self):
        """Return the table as CSV text; numbers are exact, what is not finite is left empty."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator='\n')
        writer.writerow([column.key for column in self.columns])
        writer.writerows(zip(*(map(_cell, column.values) for column in self.columns), strict=True))
        return stream.getvalue()


def column(key, head, values, show=None, number=True):
    """Return a Column; show: makes a text of a value, None leaves it to the file."""
    values = tuple(value.item() if hasattr(value, 'item') else value for value in values)
    return Column(key, head, values, tuple(map(show, values)) if show else None, number)


def words(key, head, values):
    """Return a Column of texts."""
    return column(key, head, values, str, number=False)


def _cell(value):
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ''
    return repr(value + 0.0) if isinstance(value, float) else value
