# SPDX-License-Identifier: Apache-2.0
"""What every verb prints with: a console, tables, the verdict, JSON."""

import importlib
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO, Any

import rich.table
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.segment import Segment

from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import visible, visible_json
from rosette_ros.core.run.records import Run
from rosette_ros.core.table.correction_check import CorrectionCheck
from rosette_ros.io.reading_checks import Check
from rosette_ros.presentation.formatting import (
    glued,
    model_words,
    residual_words,
    run_size,
    uncertainty_words,
    unmeasured_words,
)
from rosette_ros.presentation.table_format import Column, Table, words
from rosette_ros.words.reading_words import notes_of, remark_words
from rosette_ros.words.result_words import ConclusionText

WIDTH = 100
"""Widest output, columns; what is no terminal gets this width."""
COLOURS = {'good': 'green', 'doubtful': 'yellow', 'bad': 'red', 'strong': 'bold', '': None}
HEAD = 10
"""The head of a column is not wrapped narrower than this where the table has room."""
LONG = 24
"""Texts of more characters are wrapped."""


class _Screen(Console):
    """A console that lets no text control the terminal."""

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        """Return the text of segments, those of the console's own control as they are."""
        return super()._render_buffer(one if one.control else Segment(visible(one.text), one.style) for one in buffer)


def console(file: IO[str] | None = None) -> Console:
    """Return a console on stdout (or `file`), without colour where it is no terminal."""
    out = _Screen(file=file or sys.stdout, highlight=False, emoji=False, markup=True)
    if not out.is_terminal or out.width > WIDTH:
        out.width = WIDTH
    return out


@contextmanager
def doing(words: str, steps: int = 0) -> Iterator[Callable[..., None]]:
    """Show on a terminal's stderr what is done, for how long, and how far it is, while the block runs.

    Yields what is called with the next words, '' for the same, and the steps done since; steps: of all, 0 where that
    is not known."""
    screen = console(sys.stderr)
    if not screen.is_terminal:
        yield lambda words='', done=1: None
        return
    parts = importlib.import_module('rich.progress')
    columns = [parts.SpinnerColumn(), parts.TextColumn('{task.description}'), *(
        [parts.BarColumn(bar_width=24), parts.MofNCompleteColumn()] if steps else []), parts.TimeElapsedColumn()]
    with parts.Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task(escape(words), total=steps or None)
        yield lambda words='', done=1: bar.update(task, description=escape(words) or None, advance=done)


def print_table(out: Console, data: Table) -> None:
    """Print a table: its title, rows and note.

    Heads are wrapped narrower where it does not fit otherwise. Numbers and names are never cut: lines go on then."""
    heads = _heads(data, HEAD)
    if _least(data, heads) > out.width:
        heads = _heads(data, 1)
    made = rich.table.Table(box=box.SIMPLE_HEAD, padding=(0, 1), collapse_padding=True, pad_edge=False, show_edge=False)
    for column, head in zip(data.shown, heads):
        made.add_column(head, justify='right' if column.number else 'left', overflow='fold', no_wrap=_is_whole(column),
                        min_width=_longest_word(column))
    for place, row in enumerate(data.rows):
        made.add_row(*map(escape, row), style=COLOURS[data.level(place)])
    for place, row in enumerate(data.footer):
        if place == 0:
            made.add_section()
        made.add_row(*map(escape, row), style='bold')
    out.print(f'[bold]{escape(data.title)}[/]')
    width = out.width
    out.width = max(width, _least(data, heads))
    out.print(made, crop=False)
    out.width = width
    if data.note:
        out.print(escape(data.note))


def _longest_word(column: Column) -> int:
    return max((len(word) for text in (*(column.shown or ()), *column.footer) for word in text.split()), default=0)


def _is_whole(column: Column) -> bool:
    return column.number or _width(column) <= LONG


def _least(data: Table, heads: Iterable[str]) -> int:
    """Return the columns of the screen that a table needs at least."""
    widths = [max(_width(column) if _is_whole(column) else _longest_word(column), *map(len, head.splitlines()), 0)
              for column, head in zip(data.shown, heads)]
    return sum(widths) + 2 * (len(widths) - 1)


def _width(column: Column) -> int:
    texts = (*(column.shown or ()), *column.footer)
    return max((len(line) for text in texts for line in text.splitlines()), default=0)


def _heads(data: Table, least: int) -> list[str]:
    """Return the heads of the columns, wrapped about as narrow as their cells, each unit in a line of its own."""
    return ['\n'.join([*textwrap.wrap(column.name, max(_width(column), least), break_long_words=False),
                       *filter(None, [column.unit])]) for column in data.shown]


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
    lines = (f'[bold]{escape(run.run_id or run.source)}[/]: {run_size(run)}',
             *map(escape, (unmeasured_words(run), *notes_of(run))))
    return '\n'.join(filter(None, lines))


def warn(run: Run) -> None:
    """Print what is wrong with the readings as a whole, a line each, on stderr: for output without a verdict."""
    for remark in run.remarks:
        print(visible(f'rosette: {remark_words(remark)}'), file=sys.stderr)


def fit_rows(fit: Fit) -> list[tuple[str, str]]:
    """Return what was fitted, how well it fits and what cannot be measured, as rows of `pairs`."""
    unused = [f'; deviations of {what} {", ".join(map(str, places))}: not measured' for what, used in (
        ('balls', fit.run.ball), ('the CMM at positions', fit.run.cmm_position))
        if (places := sorted({*range(1, fit.run.n + 1)} - {*used.tolist()}))]
    return [('Model', f'{escape(model_words(fit.model))} (rank {fit.rank}, {fit.dof} degrees of freedom)'),
            ('Residual', residual_words(fit)), ('Uncertainty', uncertainty_words(fit)),
            ('Removed', f'cannot be measured by this method: {"; ".join(fit.gauge)}{"".join(unused)}')]


def print_verdict(out: Console, verdict: VerdictText | ConclusionText | CorrectionCheck) -> None:
    """Print a verdict as it stands: its sentence, and what to do."""
    say(out, verdict.sentence, COLOURS[verdict.level])
    say(out, verdict.action)


def say(out: Console, text: str, style: str | None = None) -> None:
    """Print a sentence; no line breaks between a number and its unit."""
    for line in textwrap.wrap(glued(text), out.width, break_long_words=False, break_on_hyphens=False):
        out.print(escape(line.replace('\u00a0', ' ')), style=style, soft_wrap=True)


def print_parts(out: Console, parts: Iterable[Any]) -> None:
    """Print tables and other parts, each after an empty line; not what is None, or a table without rows."""
    for part in parts:
        if part is not None and not (isinstance(part, Table) and not part.rows):
            out.print()
            if isinstance(part, Table):
                print_table(out, part)
            else:
                out.print(part)


def print_checks(name: str, title: str, checks: 'Sequence[Check]', note: str = '') -> None:
    """Print the checks of a CMM as a table."""
    print_parts(console(), [Table(name, title, (
        words('passed', '', [{True: '✓', False: '✗', None: '–'}[one.passed] for one in checks]),
        words('check', 'check', [one.name for one in checks]), words('found', 'found', [one.text for one in checks])),
        levels=tuple('bad' if one.passed is False else '' for one in checks), note=note)])


def print_json(mapping: Mapping[str, Any]) -> None:
    """Print one JSON object, strict: no NaN, no Infinity."""
    sys.stdout.write(f'{visible_json(mapping)}\n')
