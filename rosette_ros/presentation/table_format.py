# SPDX-License-Identifier: Apache-2.0
"""A result as data, declared once: exact values for JSON and CSV, rounded texts for terminal, report and studio."""

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.run.errors import visible
from rosette_ros.presentation.formatting import signed
from rosette_ros.words.effect_words import MICRO_DECIMALS, fixed


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

    def csv(self, heading: Iterable[tuple[str, Any]] = ()) -> str:
        """Return the table as CSV text; numbers are exact, what is not finite is left empty, and what would control a
        terminal is a question mark.

        heading: (key, value) of lines '# key: value' above it."""
        stream = io.StringIO()
        for key, value in heading:
            stream.write(f'# {key}: {" ".join(str(_cell(value)).split())}\n')
        writer = csv.writer(stream, lineterminator='\n')
        writer.writerow([column.key for column in self.columns])
        writer.writerows(zip(*(map(_cell, column.values) for column in self.columns), strict=True))
        return visible(stream.getvalue())


STANDARD = 1
"""Coverage factor k of every `u`: standard uncertainties."""
UNITS = {'µm': (1e6, 'm', 'um'), 'mm': (1e3, 'm', 'mm'), 'h': (1 / 3600, 's', 'h')}
"""Unit that people see: factor to it, and how the SI unit and itself end a key."""


@dataclass(frozen=True)
class Field:
    """A quantity of a record, from which its column and its entry in JSON derive.

    key: in JSON, with the SI unit at its end (rms_m); in CSV it ends as `unit` does (rms_um). name: heads the column,
    '' for CSV alone. get: value of a record, or the attribute that has it (default: the key without unit). show: text
    of a value in `unit`; text: the same from the record, where it takes more than the value. files: 'csv', 'json' where
    it is in one of them only.
    """

    key: str
    name: str = ''
    get: Callable[[Any], Any] | str = ''
    show: Callable[[Any], str] = str
    unit: str = ''
    text: Callable[[Any], str] | None = None
    number: bool = True
    files: str = 'csv json'

    def value(self, record: Any) -> Any:
        """Return the exact value, SI."""
        if callable(self.get):
            return self.get(record)
        return getattr(record, self.get or self.key.removesuffix(f'_{self._ends[1]}'))

    @property
    def _ends(self) -> tuple[float, str, str]:
        return UNITS.get(self.unit, (1.0, '?', '?'))

    def column(self, records: Sequence[Any]) -> Column:
        """Return the column of records: lists joined, yes or no, numbers in `unit`."""
        factor, si, ending = self._ends
        key = self.key if factor == 1 else f'{self.key.removesuffix(si)}{ending}'
        values = [_flat(self.value(one), factor) for one in records]
        shown = tuple(map(self.text, records)) if self.text else tuple(map(self.show, values))
        return replace(column(key, self.name, values), unit=self.unit, number=self.number,
                       shown=shown if self.name else None)


def fields_table(name: str, title: str, fields: Iterable[Field], records: Sequence[Any],
                 levels: Iterable[str] = (), note: str = '') -> 'Table':
    """Return the table of records by their fields."""
    return Table(name, title, tuple(one.column(records) for one in fields if 'csv' in one.files), tuple(levels), note)


def fields_json(fields: Iterable[Field], record: Any) -> dict[str, Any]:
    """Return a record by its fields, SI."""
    return {one.key: one.value(record) for one in fields if 'json' in one.files}


def parameters_json(parameters: 'Iterable[Parameter]') -> dict[str, Any]:
    """Return parameters by name."""
    return {one.name: {'value': one.value, 'u': one.u, 'coverage_factor': STANDARD, 'unit': one.unit}
            for one in parameters}


def micrometres_field(key: str, name: str, get: Callable[[Any], Any] | str = '', places: int = MICRO_DECIMALS,
                      sign: bool = False) -> Field:
    """Return the Field of a length that is shown in µm."""
    return Field(key, name, get, partial(signed if sign else fixed, places=places), 'µm')


def _flat(value: Any, factor: float) -> Any:
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if isinstance(value, (list, tuple)):
        return ', '.join(map(str, value))
    return value if factor == 1 or value is None else factor * value


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
    if isinstance(value, str):  # a program reads numbers with the signs of ASCII
        return _MINUS.sub('-', value)
    return repr(value + 0.0) if isinstance(value, float) else value


_MINUS = re.compile(r'−(?=[\d.])')


def verdict_json(verdict: VerdictText | None) -> dict[str, Any]:
    """Return the verdict of a run, the same keys in every object that has one; all null where none was asked for."""
    if verdict is None:
        return dict.fromkeys(('outcome', 'level', 'verdict', 'action'))
    return {'outcome': verdict.outcome.value, 'level': verdict.level.value, 'verdict': verdict.sentence,
            'action': verdict.action}
