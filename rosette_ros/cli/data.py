# SPDX-License-Identifier: Apache-2.0
"""Data in and out: a table to a log, a run to a table."""

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from rich.markup import escape

from rosette_ros.cli.arguments import SHARED, UsageError, add_shared
from rosette_ros.cli.console import console, head, warn
from rosette_ros.invocation import command
from rosette_ros.io.ball_centre_table import format_csv, read_csv, table_bytes, write_csv
from rosette_ros.io.column_map import ColumnMap, format_columns
from rosette_ros.io.csv_parser import proposal_for, read_columns
from rosette_ros.io.foreign.formats import READERS
from rosette_ros.io.open_run import open_run
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.text_file import write_text
from rosette_ros.io.type_definitions import StoredTypes
from rosette_ros.words.reading_words import notes_of, remark_words

ASKED = {'x': 'x of the ball centre', 'y': 'y', 'z': 'z', 'ball': 'number of the ball', 'table': 'table position',
         'angle': 'table angle in degrees, counter-clockwise (-NAME: clockwise)', 'name': 'name of the feature',
         'pattern': 'pattern of the names: {ball}, {table}, {angle}, {axis} and * for any text',
         'axis': 'axis, where each coordinate has a row', 'value': 'its value', 'time': 'time, s or date with time',
         'temperature': 'temperature, °C', 'radius_mm': 'radius of the circle of ball centres, mm',
         'frame': 'frame of the coordinates, table or machine'}
"""What is asked about a table, by entry of a map."""
FIRST_BYTES, FIRST_LINES = 4096, 4
"""What is shown of a table before."""


def import_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('table', metavar='FILE', help='ball-centre table, rosette-ball-centres/1, or a table of '
                        f'another program; read too: {", ".join(READERS)}')
    parser.add_argument('-o', '--output', metavar='RUN', help='log directory to make; an existing log is never changed')
    add_shared(parser, '--columns', help=f'{SHARED["--columns"]["help"]}; without it they are proposed on a terminal')
    parser.add_argument('--save', metavar='MAP', help='file to write with what the columns are, for --columns')
    add_shared(parser, '--force', help='overwrite the file of --save')


def run_import(options: Namespace) -> None:
    """Write the log, the map of the columns, or both."""
    if not (options.output or options.save):
        raise UsageError('import: expected -o RUN, --save MAP or both, found none')
    columns = read_columns(options.columns)
    if columns is None and sys.stdin.isatty() and sys.stdout.isatty():
        columns = asked_columns(options.table)
    measured = read_csv(options.table, columns)
    if options.save and columns is None:
        raise UsageError(f'{options.table}: is a ball-centre table, whose columns are known; leave out --save')
    said = (*notes_of(measured), *map(remark_words, measured.remarks))
    log = write_log(measured, Path(options.output), StoredTypes(), said) if options.output else ''
    out = console()
    out.print(head(measured))
    warn(measured)
    if log:
        out.print(f'Log: {escape(str(log))}', soft_wrap=True)
    if options.save and columns:
        write_text(options.save, format_columns(columns), options.force)
        out.print(f'Columns: {escape(options.save)}; the next time:\n  '
                  + escape(command('evaluate', options.table, '--columns', options.save)), soft_wrap=True)


def asked_columns(path: str) -> ColumnMap | None:
    """Return what the user says about the columns of a table, None where it is a ball-centre table."""
    whole, _ = table_bytes(path)
    found = proposal_for(whole, path)
    if found is None:
        return None
    out = console()
    for line in whole[:FIRST_BYTES].decode(errors='replace').splitlines()[:FIRST_LINES]:
        out.print(escape(line[:out.width]), style='dim')
    out.print(escape('What are the columns? Enter takes what stands in [brackets], - leaves it out.'))
    given = found.entries
    for key, question in ASKED.items():
        try:
            answer = input(f'{question} [{given.get(key, "-")}]: ').strip()
        except EOFError:
            raise UsageError('import: the answers ended; say the columns by --columns') from None
        if answer == '-':
            given.pop(key, None)
        elif answer:
            given[key] = answer
    return read_columns(given)


def export_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--run-id', '--columns', '--force')
    parser.add_argument('-o', '--output', metavar='CSV', required=True,
                        help='table to write; - for the standard output')


def run_export(options: Namespace) -> None:
    """Write the table."""
    measured = open_run(options.run_path, options.run_id, read_columns(options.columns))
    warn(measured)
    if options.output == '-':
        sys.stdout.write(format_csv(measured))
        return
    write_csv(measured, options.output, options.force)
    out = console()
    out.print(head(measured))
    out.print(f'Table: {escape(options.output)}', soft_wrap=True)


IMPLEMENTED = {'import': (import_arguments, run_import), 'export': (export_arguments, run_export)}
