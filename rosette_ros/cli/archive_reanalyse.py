# SPDX-License-Identifier: Apache-2.0
"""rosette archive reanalyse: all runs of an archive under another model, side by side."""

import sys
from argparse import ArgumentParser, Namespace

from rosette_ros.archive.engines import DaskEngine
from rosette_ros.archive.reanalysis import RunChange, conclusion, logs_of, side_by_side
from rosette_ros.archive.run_adding import add_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.cli.archive_add import add_engine, progress
from rosette_ros.cli.arguments import UsageError, add_formats, add_shared
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.core.errors import counted
from rosette_ros.core.records import CURVES
from rosette_ros.io.model_file import read_model
from rosette_ros.presentation.formatting import fixed
from rosette_ros.presentation.json_output import by_curve, plain
from rosette_ros.presentation.table_format import Table, column, micrometre_column, words

SCHEMA = 'rosette-archive-reanalysis/1'


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('archive', metavar='ARCHIVE', help='folder of the archive')
    add_shared(parser, '--model', required=True, help='model file (YAML) under which all runs are evaluated')
    parser.add_argument('--before', metavar='FILE', help='model to compare with (default: the base model)')
    add_engine(parser)
    add_formats(parser, csv='print a line for each run as CSV')


def run(options: Namespace) -> None:
    """Evaluate what is not known under either model, and print both side by side."""
    before, after = read_model(options.before), read_model(options.model)
    if before == after:
        raise UsageError(f'archive reanalyse: wanted two models, got one twice: {after}')
    archive = RunArchive(options.archive)
    logs, gone = logs_of(archive)
    with DaskEngine(options.scheduler, options.workers) as engine, progress() as show:
        for model in (before, after):
            add_logs(archive, logs, engine, model, on_progress=show)
    changes = side_by_side(archive, before, after)
    said = conclusion(changes, [name for name in after.names if name not in before.names])
    if options.json:
        print_json({'schema': SCHEMA, 'before': before.to_mapping(), 'after': after.to_mapping(), 'conclusion': said,
                    'gone': gone, 'runs': [_json(one) for one in changes]})
        return
    table = _table(changes)
    if options.csv:
        sys.stdout.write(table.csv())
        return
    out = console()
    if gone:
        out.print(f'{counted(len(gone), "log")} no longer where it was found, such as {gone[0]}', markup=False)
    for sentence in said:
        out.print(sentence, markup=False)
    print_parts(out, [table])


def _table(changes: list[RunChange]) -> Table:
    return Table('reanalysis', 'Before and after', (
        words('measured', 'measured', [f'{one.measured_at:%Y-%m-%d}' if one.measured_at else '' for one in changes]),
        words('table', 'table', [one.table_serial for one in changes]),
        words('run', 'run', [one.run_id for one in changes]),
        micrometre_column('before_um', 'before', [one.before for one in changes]),
        micrometre_column('after_um', 'after', [one.after for one in changes]),
        column('change_of_U', 'curves move, of U', [max(one.of_u) for one in changes], lambda value: fixed(value, 2)),
        words('curve', 'most', [CURVES[one.of_u.index(max(one.of_u))] for one in changes]),
        words('had', 'had', [' + '.join(one.had) for one in changes])),
        levels=tuple('strong' if one.had else '' for one in changes),
        note='before, after: residual; had: effects of the model after that are there for certain')


def _json(one: RunChange) -> dict[str, object]:
    return {**plain({**vars(one), 'measured_at': one.measured_at and one.measured_at.isoformat(), 'had': one.had}),
            'change': by_curve(one.change), 'of_u': by_curve(one.of_u)}
