# SPDX-License-Identifier: Apache-2.0
"""A table as data: exact values for files, rounded texts for the terminal, the report and the studio."""

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from rosette_ros.presentation.formatting import MICRO_DECIMALS, fixed, signed


@dataclass(frozen=True)
class Column:
    """One column: `key` with its unit heads the file, `name` and `unit` the page.

    values: exact, for the file; shown: as texts, None for a column of the file alone; number: whether it is aligned
    right; footer: texts below it, as many in all columns of a table.
    """

    key: str
    name: str
    values: tuple[Any, ...]
    shown: tuple[str, ...] | None
    unit: str = ''
    number: bool = True
    footer: tuple[str, ...] = ()

    @property
    def head(self) -> str:
        """Name and unit in one line."""
        return f'{self.name} / {self.unit}' if self.unit else self.name


@dataclass(frozen=True)
class Table:
    """A table with a name (of its file), a title, columns of the same length, and a note below.

    levels: how each row is emphasised: 'bad', 'doubtful', 'good', 'strong' or ''; empty where none is.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    levels: tuple[str, ...] = ()
    note: str = ''

    @property
    def shown(self) -> tuple[Column, ...]:
        """The columns for people."""
        return tuple(column for column in self.columns if column.shown is not None)

    @property
    def rows(self) -> tuple[tuple[str, ...], ...]:
        """The rows of texts, without the footer."""
        return tuple(zip(*(column.shown or () for column in self.shown), strict=True))

    @property
    def footer(self) -> tuple[tuple[str, ...], ...]:
        """The rows below the others: totals, uncertainties."""
        return tuple(zip(*(column.footer for column in self.shown), strict=True))

    def level(self, row: int) -> str:
        """Return how a row is emphasised."""
        return self.levels[row] if self.levels else ''

    def select(self, *keys: str) -> 'Table':
        """Return the table with some of its columns, in the order of `keys`, those that it has."""
        found = {column.key: column for column in self.columns}
        return replace(self, columns=tuple(found[key] for key in keys if key in found))

    def first(self, count: int) -> 'Table':
        """Return the table with its first rows."""
        return self.only(range(min(count, len(self.columns[0].values))))

    def only(self, rows: Sequence[int]) -> 'Table':
        """Return the table with some of its rows, in the order of `rows`."""
        return replace(self, levels=tuple(self.level(row) for row in rows), columns=tuple(replace(
            one, values=tuple(one.values[row] for row in rows),
            shown=None if one.shown is None else tuple(one.shown[row] for row in rows)) for one in self.columns))

    def csv(self) -> str:
        """Return the table as CSV text; numbers are exact, what is not finite is left empty."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator='\n')
        writer.writerow([column.key for column in self.columns])
        writer.writerows(zip(*(map(_cell, column.values) for column in self.columns), strict=True))
        return stream.getvalue()


def column(key: str, name: str, values: Iterable[Any], show: Callable[[Any], str] | None = None, unit: str = '',
           number: bool = True, footer: Iterable[str] = ()) -> Column:
    """Return a Column; show: makes a text of a value, None leaves the values to the file."""
    exact = tuple(value.item() if hasattr(value, 'item') else value for value in values)
    return Column(key, name, exact, tuple(map(show, exact)) if show else None, unit, number, tuple(footer))


def words(key: str, name: str, values: Iterable[Any], footer: Iterable[str] = ()) -> Column:
    """Return a Column of texts."""
    return column(key, name, values, str, number=False, footer=footer)


def micrometre_column(key: str, name: str, metres: Iterable[float], places: int = MICRO_DECIMALS,
                      sign: bool = False) -> Column:
    """Return a Column of lengths in µm."""
    return column(key, name, [1e6 * value for value in metres], partial(signed if sign else fixed, places=places), 'µm')


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ''
    return repr(value + 0.0) if isinstance(value, float) else value
