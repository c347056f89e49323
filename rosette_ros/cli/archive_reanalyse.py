# SPDX-License-Identifier: Apache-2.0
"""rosette archive reanalyse: all runs of an archive under another model, side by side."""

import sys
from argparse import ArgumentParser, Namespace

from rosette_ros.archive import reanalysis
from rosette_ros.archive.engines import DaskEngine
from rosette_ros.archive.reanalysis import RunChange, TrendComparison
from rosette_ros.archive.run_adding import add_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.table_history import History
from rosette_ros.cli.archive_add import add_engine, progress
from rosette_ros.cli.arguments import UsageError, add_formats, add_shared
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.core.diagnosis.verdict import CERTAIN
from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.errors import counted
from rosette_ros.core.records import CURVES
from rosette_ros.core.trend import Event
from rosette_ros.io.model_file import read_model
from rosette_ros.presentation.formatting import fixed, names
from rosette_ros.presentation.json_output import by_curve, plain
from rosette_ros.presentation.table_format import Table, column, micrometre_column, words
from rosette_ros.presentation.trend_results import size_words, slope_words

SCHEMA = 'rosette-archive-reanalysis/1'


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
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
    logs, gone = reanalysis.logs_of(archive)
    with DaskEngine(options.scheduler, options.workers) as engine, progress() as show:
        for model in (before, after):
            add_logs(archive, logs, engine, model, keep_identity=True, on_progress=show)
    changes = reanalysis.side_by_side(archive, before, after)
    trends = reanalysis.trends_side_by_side(archive, before, after)
    added = [term for term in after.terms if term.name not in before.names]
    said = (*reanalysis.conclusion(changes, added, archive, reanalysis.not_evaluated(archive, before, after)),
            *reanalysis.trend_conclusion(trends))
    if options.json:
        print_json({'schema': SCHEMA, 'before': before.to_mapping(), 'after': after.to_mapping(), 'conclusion': said,
                    'gone': gone, 'runs': [_json(one) for one in changes],
                    'trends': [_trend_json(one) for one in trends]})
        return
    table = _table(changes)
    if options.csv:
        sys.stdout.write(table.csv())
        return
    out = console()
    if gone:
        out.print(f'{counted(len(gone), "log")} not found where {"it was" if len(gone) == 1 else "they were"}, such as '
                  f'{gone[0]}', markup=False)
    for sentence in said:
        out.print(sentence, markup=False, soft_wrap=True)
    print_parts(out, [table, *_trend_tables(trends)])


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
        note=f'before, after: residual; had: effects of the model after with a parameter of {CERTAIN} standard '
             'uncertainties')


def _trend_tables(trends: list[TrendComparison]) -> list[Table]:
    """Return the changes under both models, and the slopes that alter."""
    changes = [(one, *pair) for one in trends for pair in one.events]
    slopes = [(one, curve) for one in trends for curve in one.slopes if one.altered(curve) > 1]
    tables = [Table('changes', 'Changes of the tables, before and after', (
        words('table', 'table', [one.before.serial for one, *_ in changes]),
        words('between', 'between', [_between(one.before, first) or _between(one.after, second)
                                     for one, first, second in changes]),
        words('before', 'before', [_told(first) for _, first, _ in changes]),
        words('after', 'after', [_told(second) for *_, second in changes])),
        note='Size of what moved most, in units of its U (k = 2); –: no change under this model')] if changes else []
    if slopes:
        tables.append(Table('slopes', 'Slopes that alter by more than U', (
            words('table', 'table', [one.before.serial for one, _ in slopes]),
            words('error', 'error', [curve for _, curve in slopes]),
            words('before', 'before, per year', [slope_words(one.slopes[curve][0], curve) for one, curve in slopes]),
            words('after', 'after, per year', [slope_words(one.slopes[curve][1], curve) for one, curve in slopes]))))
    return tables


def _between(history: History, event: Event | None) -> str:
    if event is None:
        return ''
    return f'{history.dates[event.earliest - 1]:%Y-%m-%d} and {history.dates[event.latest]:%Y-%m-%d}'


def _told(event: Event | None) -> str:
    if event is None:
        return '–'
    return f'{names(event.owners)}: {event.steps[0].series.name} {size_words(event.steps[0])}'


def _trend_json(one: TrendComparison) -> dict[str, object]:
    return {'table': one.before.serial, 'runs': len(one.before.runs),
            'changes': [{name: event and {'between': _between(history, event), 'run_id': history.runs[event.run],
                                          'owners': list(event.owners), 'quantity': event.steps[0].series.name,
                                          'size_in_U': event.steps[0].strength / COVERAGE_FACTOR}
                         for name, history, event in zip(('before', 'after'), (one.before, one.after), pair)}
                        for pair in one.events],
            'slopes': {curve: {name: {'per_day': found.slope, 'u_per_day': found.slope_u}
                               for name, found in zip(('before', 'after'), pair)}
                       for curve, pair in one.slopes.items()}}


def _json(one: RunChange) -> dict[str, object]:
    return {**plain({**vars(one), 'measured_at': one.measured_at and one.measured_at.isoformat(), 'had': one.had}),
            'change': by_curve(one.change), 'of_u': by_curve(one.of_u)}
