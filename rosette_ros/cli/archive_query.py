# SPDX-License-Identifier: Apache-2.0
"""rosette archive query: what an archive says, by SQL or by ready questions, as table, CSV or JSON."""

import datetime
import json
import sys
from argparse import ArgumentParser, Namespace
from typing import Any

import pyarrow as pa

from rosette_ros.archive.archive_questions import SERIAL, VIEWS, Question, ask, ask_for
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import COLUMNS
from rosette_ros.cli.arguments import UsageError, add_formats, add_shared
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.core.errors import counted
from rosette_ros.presentation.json_output import plain
from rosette_ros.presentation.table_format import Column, Table, column, words

SCHEMA = 'rosette-archive-query/1'


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    parser.add_argument('sql', metavar='SQL', nargs='?', default='', help=f'a question in SQL (DuckDB) over the views '
                        f'runs, {", ".join(VIEWS)}; in place of the questions below')
    for word, name in SERIAL.items():
        parser.add_argument(f'--{word}', metavar='SERIAL' if name.endswith('serial') else 'NAME', default='',
                            help=f'runs of this {word}{" (good, doubtful, bad)" if word == "level" else ""}')
    parser.add_argument('--since', metavar='TIME', default='', help='measured then or later, such as 2026-04-12')
    parser.add_argument('--until', metavar='TIME', default='', help='measured before this time')
    parser.add_argument('--effect', metavar='NAME', default='', help='with this effect in the model or named by the '
                        'diagnosis')
    parser.add_argument('--model', metavar='HASH', default='', help='evaluated under the model of this hash, or its '
                        'beginning (default: under any)')
    parser.add_argument('--problems', action='store_true', help='logs that could not be evaluated, and why')
    parser.add_argument('--columns', action='store_true', help='explain the columns of runs')
    add_formats(parser, csv='print the answer as CSV')


def run(options: Namespace) -> None:
    """Print the answer."""
    archive = RunArchive(options.archive)
    equal = {word: vars(options)[word] for word in SERIAL if vars(options)[word]}
    wanted = Question(equal, options.since, options.until, options.effect, options.problems,
                      options.model)
    if options.sql and wanted != Question({}):
        raise UsageError('archive query: wanted SQL or a ready question, got both; put all into the SQL')
    if options.columns:
        answer = pa.table(dict(zip(('column', 'type', 'meaning'), zip(*((name, str(kind), meaning) for
                                                                         name, kind, meaning in COLUMNS)))))
    else:
        answer = ask(archive, options.sql) if options.sql else ask_for(archive, wanted)
    if options.json:
        print_json({'schema': SCHEMA, 'columns': answer.column_names,
                    'rows': [{key: plain(_value(value)) for key, value in row.items()} for row in answer.to_pylist()]})
        return
    table = Table('answer', counted(answer.num_rows, 'row'), tuple(
        _column(name, values.to_pylist()) for name, values in zip(answer.column_names, answer.columns)))
    if options.csv:
        sys.stdout.write(table.csv())
    else:
        print_parts(console(), [table] if table.rows else ['no rows'])


def _column(name: str, values: list[Any]) -> Column:
    exact = [_value(value, as_text=True) for value in values]
    if any(isinstance(value, (int, float)) and not isinstance(value, bool) for value in exact):
        return column(name, name, exact, lambda value: f'{value:.6g}' if isinstance(value, float) else _shown(value))
    return words(name, name, [_shown(value) for value in exact])


def _shown(value: Any) -> str:
    return '' if value is None else str(value)


def _value(value: Any, as_text: bool = False) -> Any:
    """Return a value of an answer as one of JSON, or of one cell of a table: times in ISO 8601, in UTC unless naive."""
    if isinstance(value, datetime.datetime):
        shown = value.astimezone(datetime.UTC) if value.tzinfo else value
        return shown.isoformat(' ', 'seconds').removesuffix('+00:00') if as_text else value.isoformat()
    if isinstance(value, dict):
        value = {key: _value(one) for key, one in value.items()}
    elif isinstance(value, list):
        value = [_value(one) for one in value]
        if as_text and all(isinstance(one, str) for one in value):
            return '; '.join(value)
    elif not isinstance(value, (str, int, float, bool, type(None))):
        return str(value)  # a date, a decimal
    return json.dumps(plain(value), ensure_ascii=False) if as_text and isinstance(value, (dict, list)) else value
