# SPDX-License-Identifier: Apache-2.0
"""What a function of the interface returns: words when printed, a card in a notebook, JSON, tables, DataFrames."""

import html
import importlib
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from rosette_ros.core.run.errors import InvalidData, RosetteError, visible_json
from rosette_ros.io.text_file import write_bytes
from rosette_ros.presentation.table_format import Table
from rosette_ros.presentation.workbook import workbook
from rosette_ros.requirements import missing_words

COLOURS = {'good': '#2e7d32', 'doubtful': '#b26a00', 'bad': '#c62828'}
MOST_ROWS = 40
"""Rows of a table in a card."""
DPI = 72
"""Of pictures in a notebook."""


class PackageMissing(RosetteError):
    """A package that is asked for is not installed."""


def loaded(module: str, what: str) -> ModuleType:
    """Import what only some results need; raises PackageMissing, with how it is installed, where it is not there."""
    os.environ.setdefault('MATPLOTLIBRC', os.devnull)
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package in ('', 'rosette_ros'):
            raise
        raise PackageMissing(f'{what}: {missing_words(package)}') from error


def plots(name: str) -> ModuleType:
    """Import the pictures of a subject, and with them matplotlib."""
    return loaded(f'rosette_ros.presentation.plots.{name}', 'pictures')


def json_text(mapping: Mapping[str, Any]) -> str:
    """Return one JSON object, strict: no NaN, no Infinity."""
    return visible_json(mapping)


def frame_of(table: Table) -> Any:
    """Return a Table as a DataFrame: exact values under the names of its CSV; attrs: title, note, units of columns."""
    pandas = loaded('pandas', 'to_frame')
    made = pandas.DataFrame({one.key: list(one.values) for one in table.columns})
    made.attrs = {'title': table.title, 'note': table.note,
                  'units': {one.key: one.unit for one in table.columns if one.unit}}
    return made


def html_of(table: Table) -> str:
    """Return a Table for people as HTML."""
    rows = table.rows[:MOST_ROWS]
    more = f'<p>{len(table.rows) - len(rows)} more rows: to_frame()</p>' if len(table.rows) > len(rows) else ''
    note = f'<p>{html.escape(table.note)}</p>' if table.note else ''
    return (f'<p><b>{html.escape(table.title)}</b></p><table><thead>{_row([one.head for one in table.shown], "th")}'
            f'</thead><tbody>{"".join(_row(row, "td") for row in (*rows, *table.footer))}</tbody></table>{more}{note}')


def _row(cells: Sequence[str], tag: str) -> str:
    return f'<tr>{"".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)}</tr>'


class Result:
    """A result; `level` colours its card: 'good', 'doubtful', 'bad' or ''; `source`: name of its run."""

    level = ''
    source = ''

    def to_mapping(self) -> dict[str, Any]:
        """Return it as plain lists, dicts and numbers in SI units: what the command line prints with --json."""
        raise NotImplementedError

    def sentences(self) -> tuple[str, ...]:
        """Return what it says in words."""
        raise NotImplementedError

    def tables(self) -> tuple[Table, ...]:
        """Return its tables, the first one being the chief one."""
        raise NotImplementedError

    def json(self) -> str:
        """Return the line that the command line prints with --json."""
        return json_text(self.to_mapping())

    def to_frame(self, name: str = '') -> Any:
        """Return its chief table, or that of a name, as a DataFrame (pandas); units and title are in its attrs."""
        every = {one.name: one for one in self.tables()}
        if name and name not in every:
            raise RosetteError(f'to_frame: expected one of {", ".join(every)}, found {name!r}')
        return frame_of(every[name] if name else next(iter(every.values())))

    def save_workbook(self, path: str | Path, force: bool = False) -> None:
        """Write it as a workbook for Excel (.xlsx): the verdict, and a sheet for each table.

        Raises InvalidData where the file exists, unless `force`, and where its name ends otherwise."""
        if Path(path).suffix.lower() != '.xlsx':
            raise InvalidData(f'{path}: expected a name that ends in .xlsx')
        made = workbook(loaded('openpyxl', 'workbook'), self.sentences(), self.level, self.tables(), self.source)
        write_bytes(path, made, force)

    def __str__(self) -> str:
        return '\n'.join(self.sentences())

    def __repr__(self) -> str:
        return f'<{type(self).__name__}: {" ".join(self.sentences()) or "nothing to say"}>'

    def _repr_html_(self) -> str:
        colour = COLOURS.get(self.level, '#607d8b')
        words = ''.join(f'<p>{html.escape(one)}</p>' for one in self.sentences())
        return (f'<div style="border-left: 4px solid {colour}; padding-left: 12px">{words}'
                f'{"".join(html_of(one) for one in self.tables()[:2] if one.rows)}</div>')


class DrawnResult(Result):
    """A result with a picture."""

    def draw(self) -> Any:
        """Return its picture as the plots make it."""
        raise NotImplementedError

    def plot(self) -> Any:
        """Return its picture, a matplotlib Figure, which a notebook shows."""
        return in_notebook(self.draw())

    def save_plot(self, path: str | Path, force: bool = False) -> None:
        """Write its picture (.png, .svg or .pdf); raises InvalidData where the file exists, unless `force`."""
        plots('plot_style').save(self.draw(), path, force)


def in_notebook(figure: Any) -> Any:
    """Return a Figure that a notebook shows; one that pyplot did not make is words there."""
    def png() -> bytes:
        stream = io.BytesIO()
        figure.savefig(stream, format='png', dpi=DPI)
        return stream.getvalue()

    figure._repr_png_ = png
    return figure
