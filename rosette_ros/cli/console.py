# SPDX-License-Identifier: Apache-2.0
"""What every verb prints with: a console, tables, the verdict, JSON."""

import json
import sys
import textwrap
from collections.abc import Iterable, Mapping
from typing import IO, TYPE_CHECKING, Any

import rich.table
from rich import box
from rich.console import Console, Group
from rich.markup import escape

from rosette_ros.core.records import Run
from rosette_ros.presentation.formatting import missing_words, residual_words, run_size, uncertainty_words
from rosette_ros.presentation.table_format import Column, Table

if TYPE_CHECKING:  # plan and info start without the least squares
    from rosette_ros.core.diagnosis.verdict import Verdict
    from rosette_ros.core.model.least_squares import Fit
    from rosette_ros.presentation.report.verification import Conclusion

WIDTH = 100
"""Widest output, columns; what is no terminal gets this width."""
COLOURS = {'good': 'green', 'doubtful': 'yellow', 'bad': 'red', 'strong': 'bold', '': None}
LONG = 24
"""Texts of more characters are wrapped."""


def console(file: IO[str] | None = None) -> Console:
    """Return a console on stdout (or `file`), without colour where it is no terminal."""
    out = Console(file=file or sys.stdout, highlight=False, emoji=False, markup=True)
    if not out.is_terminal or out.width > WIDTH:
        out.width = WIDTH
    return out


def rich_table(data: Table) -> Group:
    """Return a Table for the terminal: its title, rows and note."""
    made = rich.table.Table(box=box.SIMPLE_HEAD, padding=(0, 1), collapse_padding=True, pad_edge=False, show_edge=False)
    for column in data.shown:
        made.add_column(_head(column), justify='right' if column.number else 'left', overflow='fold',
                        no_wrap=column.number or _width(column) <= LONG)
    for place, row in enumerate(data.rows):
        made.add_row(*map(escape, row), style=COLOURS[data.level(place)])
    for place, row in enumerate(data.footer):
        if place == 0:
            made.add_section()
        made.add_row(*map(escape, row), style='bold')
    return Group(f'[bold]{escape(data.title)}[/]', made, *([escape(data.note)] if data.note else []))


def _width(column: Column) -> int:
    texts = (*(column.shown or ()), *column.footer)
    return max((len(line) for text in texts for line in text.splitlines()), default=0)


def _head(column: Column) -> str:
    """Return the head of a column, wrapped about as narrow as its cells, its unit in a line of its own."""
    lines = textwrap.wrap(column.name, max(_width(column), 10), break_long_words=False)
    return '\n'.join([*lines, *([column.unit] if column.unit else [])])


def pairs(rows: Iterable[tuple[str, str]]) -> rich.table.Table:
    """Return a table of (name, text) rows without lines, texts wrapped."""
    made = rich.table.Table.grid(padding=(0, 2))
    made.add_column(no_wrap=True, style='bold')
    made.add_column(overflow='fold')
    for name, text in rows:
        made.add_row(name, text)
    return made


def head(run: Run) -> str:
    """Return what was measured in a line, and in further ones what is missing and how a table was read."""
    lines = (f'[bold]{escape(run.run_id or run.source)}[/]: {run_size(run)}', missing_words(run), *run.notes)
    return '\n'.join(filter(None, lines))


def warn(run: Run) -> None:
    """Print what is wrong with the readings as a whole, a line each, on stderr: for output without a verdict."""
    for remark in run.remarks:
        print(f'rosette: {remark}', file=sys.stderr)


def fit_rows(fit: 'Fit') -> list[tuple[str, str]]:
    """Return what was fitted, how well it fits and what is not observable, as rows of `pairs`."""
    return [('Model', f'{escape(" + ".join(fit.model.names) or "nothing")} (rank {fit.rank}, {fit.dof} degrees of '
                      'freedom)'),
            ('Residual', residual_words(fit)), ('Uncertainty', uncertainty_words(fit)),
            ('Not observable', f'by any three-rosette run, and removed from the curves: {"; ".join(fit.gauge)}')]


def print_verdict(out: Console, verdict: 'Verdict | Conclusion') -> None:
    """Print a verdict as it stands: its sentence, and what to do."""
    out.print(f'[{COLOURS[verdict.level]}]{escape(verdict.sentence)}[/]')
    out.print(escape(verdict.action))


def print_parts(out: Console, parts: Iterable[Any]) -> None:
    """Print tables and other parts, each after an empty line; not what is None, or a table without rows."""
    for part in parts:
        if part is not None and not (isinstance(part, Table) and not part.rows):
            out.print()
            out.print(rich_table(part) if isinstance(part, Table) else part)


def print_json(mapping: Mapping[str, Any]) -> None:
    """Print one JSON object, strict: no NaN, no Infinity."""
    json.dump(mapping, sys.stdout, allow_nan=False, ensure_ascii=False)
    sys.stdout.write('\n')
