# SPDX-License-Identifier: Apache-2.0
"""Many runs of many cells, a row each; how a table changes over them, when to calibrate again."""

import datetime
import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any

import pyarrow as pa
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from rosette_ros.archive import reanalysis
from rosette_ros.archive.archive_questions import VIEWS, ask, ask_for, environment_of_cell
from rosette_ros.archive.plant import plant_json, plant_of, plant_table
from rosette_ros.archive.reanalysis import RunChange, TrendComparison
from rosette_ros.archive.run_adding import Added, Engine, add_logs, find_logs
from rosette_ros.archive.run_archive import RunArchive, local_folder
from rosette_ros.archive.run_question import Question
from rosette_ros.archive.run_row import COLUMNS
from rosette_ros.archive.stored_causes import experience_of_cell
from rosette_ros.archive.table_history import History, TableTrend, read_history, trend_of
from rosette_ros.cli.arguments import UsageError, add_formats, add_shared, load, made_folder, whole
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.cli.questions import add_question, question_of
from rosette_ros.core.diagnosis.verdict import CERTAIN
from rosette_ros.core.run.errors import counted
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.trend import Event
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.stated_environment import CLASSES
from rosette_ros.invocation import command
from rosette_ros.io.budget_file import environment_of, format_environment, read_stated, source_of
from rosette_ros.io.experience_file import format_experience
from rosette_ros.io.identity_file import read_identity
from rosette_ros.io.model_file import read_model
from rosette_ros.io.text_file import refuse_output, write_text
from rosette_ros.presentation.json_output import CURVE_KEYS, Json, by_curve, plain
from rosette_ros.presentation.plots.plot_style import save_all
from rosette_ros.presentation.table_format import Column, Table, column, micrometre_column, words
from rosette_ros.presentation.trend_results import size_words, slope_words, trend_html
from rosette_ros.words.effect_words import fixed, names

MOST_WORKERS = 4096


def add_logs_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('folders', metavar='FOLDER', nargs='+', help='folder with logs, at any depth, a log, or a URL '
                        'that fsspec knows (s3://... with its driver)')
    add_shared(parser, '--into', '--model', '--inputs', '--environment')
    add_shared(parser, '--identity', help='who, what and where (YAML, rosette-identity/1), for all logs that are new, '
               'in place of what they state')
    parser.add_argument('--force', action='store_true', help='evaluate all logs again, also those that are known')
    add_engine(parser)
    add_shared(parser, '--json')


def add_engine(parser: ArgumentParser) -> None:
    """Declare where the evaluation runs."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument('--scheduler', metavar='URL', default='', help='address of a Dask scheduler, such as '
                       'tcp://host:8786, whose workers evaluate (default: processes of this computer)')
    group.add_argument('--workers', metavar='N', type=whole(1, MOST_WORKERS), default=0,
                       help='processes on this computer (default: one for each core)')


def engine_of(options: Namespace) -> AbstractContextManager[Engine]:
    """Return what evaluates; Dask is loaded only here."""
    made: AbstractContextManager[Engine] = load('rosette_ros.archive.engines', 'archive').DaskEngine(
        options.scheduler, options.workers)
    return made


def run_add(options: Namespace) -> int:
    """Add and say what was done; 1 where a new log could not be evaluated."""
    local_folder(options.into)  # refused before hours of work
    model = read_model(options.model)
    identity = read_identity(options.identity) if options.identity else None
    environment = environment_of(read_stated(options.inputs, options.environment), source_of(options.inputs))
    logs = find_logs(options.folders)
    with progress() as show, engine_of(options) as engine:
        archive = RunArchive(options.into, make=True)
        added = add_logs(archive, logs, engine, model, identity, options.force, on_progress=show,
                         environment=environment)
    if options.json:
        print_json({'schema': 'rosette-archive-add/1', 'archive': options.into, **vars(added)})
        return int(added.problems > 0)
    out = console()
    out.print(f'{counted(added.found, "log")} found: {added.found - added.new - added.copies} known, '
              f'{added.copies} {"copy" if added.copies == 1 else "copies"}, {added.new} new', markup=False)
    if added.new:
        why = f': {command("archive", "query", options.into, "--problems")}' if added.problems else ''
        out.print(f'{added.evaluated} evaluated, {added.problems} not{why}', markup=False, soft_wrap=True)
    return int(added.problems > 0)


@contextmanager
def progress() -> Iterator[Callable[[Added, int], None]]:
    """Give a function that shows how far an addition is: a bar with rate and time left, on a terminal's stderr.

    Where it is interrupted, KeyboardInterrupt says what is kept."""
    out = console(sys.stderr)
    done = Added()
    with Progress(TextColumn('{task.description}'), BarColumn(bar_width=24), MofNCompleteColumn(), RateColumn(),
                  TimeRemainingColumn(), console=out, transient=True, disable=not out.is_terminal) as bar:
        task = bar.add_task('looking for what is new', total=None)

        def show(added: Added, left: int) -> None:
            nonlocal done
            done = added
            bar.update(task, completed=added.new + added.copies, total=added.new + added.copies + left,
                       description=f'evaluating, {counted(added.problems, "problem")}')
        try:
            yield show
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(f'interrupted; {counted(done.new, "log")} added and kept, the same command goes on '
                                    'from there') from error


class RateColumn(ProgressColumn):
    """Logs per second."""

    def render(self, task: Task) -> Text:
        """Return the rate, empty while it is not known."""
        return Text(f'{task.speed:.2g} logs/s' if task.speed else '')


def query_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    parser.add_argument('sql', metavar='SQL', nargs='?', default='', help='a question in SQL (DuckDB) over the views '
                        f'runs, {", ".join(VIEWS)}; in place of the questions below')
    add_question(parser)
    parser.add_argument('--model', metavar='HASH', default='', help='evaluated under the model of this hash, or its '
                        'beginning (default: under any)')
    parser.add_argument('--problems', action='store_true', help='logs that could not be evaluated, and why')
    parser.add_argument('--columns', action='store_true', help='explain the columns of runs')
    add_formats(parser, csv='print the answer as CSV')


def run_query(options: Namespace) -> None:
    """Print the answer."""
    archive = RunArchive(options.archive)
    wanted = replace(question_of(options), problems=options.problems, model=options.model)
    if options.sql and wanted != Question({}):
        raise UsageError('archive query: expected SQL or a ready question, found both; put all into the SQL')
    if options.columns:
        answer = pa.table(dict(zip(('column', 'type', 'meaning'), zip(*((name, str(kind), meaning) for
                                                                         name, kind, meaning in COLUMNS)))))
    else:
        answer = ask(archive, options.sql) if options.sql else ask_for(archive, wanted)
    if options.json:
        print_json({'schema': 'rosette-archive-query/1', 'columns': answer.column_names,
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


def environment_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    parser.add_argument('--table', metavar='SERIAL', required=True, help='serial number of the table')
    add_shared(parser, '--environment', default='laboratory',
               help='of what none of its runs shows (default laboratory)')
    parser.add_argument('-o', '--output', metavar='FILE', help='write it to a file for --inputs (YAML), in place of '
                        'the screen')
    add_shared(parser, '--force')


def run_environment(options: Namespace) -> None:
    """Print or write the section."""
    if options.output:
        refuse_output(options.output, options.force)
    found = environment_of_cell(RunArchive(options.archive), options.table, CLASSES[options.environment])
    text = format_environment(found)
    _print_or_write(text, options, 'evaluate', '--inputs')


def experience_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    parser.add_argument('--cell', metavar='NAME', default='', help='name of the cell, as archive query --cell takes it')
    parser.add_argument('--table', metavar='SERIAL', default='', help='serial number of the table')
    parser.add_argument('-o', '--output', metavar='FILE', help='write it to a file for --experience (YAML), in place '
                        'of the screen')
    add_shared(parser, '--force')


def run_experience(options: Namespace) -> None:
    """Print or write what the runs of a cell have taught."""
    if not (options.cell or options.table):
        raise UsageError('archive experience: expected --cell NAME or --table SERIAL, found neither')
    if options.output:
        refuse_output(options.output, options.force)
    text = format_experience(experience_of_cell(RunArchive(options.archive), options.cell, options.table))
    _print_or_write(text, options, 'diagnose', '--experience')


def _print_or_write(text: str, options: Namespace, verb: str, option: str) -> None:
    """Print a text, or write it to --output and say which verb takes the file by which option."""
    if not options.output:
        sys.stdout.write(text)
        return
    write_text(options.output, text, options.force)
    use = command(verb, 'RUN', option, options.output)
    console().print(f'Written to {options.output}. Use it with: {use}', markup=False, soft_wrap=True)


def reanalyse_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    add_shared(parser, '--model', required=True, help='model file (YAML) under which all runs are evaluated')
    parser.add_argument('--before', metavar='FILE', help='model to compare with (default: the base model)')
    add_engine(parser)
    add_formats(parser, csv='print a line for each run as CSV')


def run_reanalyse(options: Namespace) -> None:
    """Evaluate what is not known under either model, and print both side by side."""
    before, after = read_model(options.before), read_model(options.model)
    if before == after:
        raise UsageError(f'archive reanalyse: expected two models, found one twice: {after}')
    archive = RunArchive(options.archive)
    logs, gone = reanalysis.logs_of(archive)
    with progress() as show, engine_of(options) as engine:
        for model in (before, after):
            add_logs(archive, logs, engine, model, keep_identity=True, on_progress=show)
    changes = reanalysis.side_by_side(archive, before, after)
    trends = reanalysis.trends_side_by_side(archive, before, after)
    added = [term for term in after.terms if term.name not in before.names]
    said = (*reanalysis.conclusion(changes, added, archive, reanalysis.not_evaluated(archive, before, after)),
            *reanalysis.trend_conclusion(trends))
    if options.json:
        print_json({'schema': 'rosette-archive-reanalysis/1', 'before': before.to_mapping(),
                    'after': after.to_mapping(), 'conclusion': said, 'gone': gone,
                    'runs': [_change_json(one) for one in changes], 'trends': [_trend_json(one) for one in trends]})
        return
    table = _changes_table(changes)
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


def _changes_table(changes: list[RunChange]) -> Table:
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
    keys = dict(zip(CURVES, CURVE_KEYS, strict=True))
    return {'table': one.before.serial, 'runs': len(one.before.runs),
            'changes': [{name: event and {'between': _between(history, event), 'run_id': history.runs[event.run],
                                          'owners': list(event.owners), 'quantity': event.steps[0].series.name,
                                          'size_in_U': event.steps[0].strength / COVERAGE_FACTOR}
                         for name, history, event in zip(('before', 'after'), (one.before, one.after), pair)}
                        for pair in one.events],
            'slopes': {keys[curve]: {name: {'per_day': found.slope, 'u_per_day': found.slope_u}
                               for name, found in zip(('before', 'after'), pair)}
                       for curve, pair in one.slopes.items()}}


def _change_json(one: RunChange) -> dict[str, object]:
    return {**plain({**vars(one), 'measured_at': one.measured_at and one.measured_at.isoformat(), 'had': one.had}),
            'change': by_curve(one.change), 'of_u': by_curve(one.of_u)}


def plant_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive', '--angle-unit')
    add_formats(parser, csv='print a line for each table as CSV')


def run_plant(options: Namespace) -> None:
    """Print all tables, the most urgent first."""
    states = plant_of(RunArchive(options.archive), datetime.datetime.now(datetime.UTC))
    if options.json:
        print_json(plant_json(states))
    elif options.csv:
        sys.stdout.write(plant_table(states).csv())
    else:
        print_parts(console(), [plant_table(states)])


def trend_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    parser.add_argument('--table', metavar='SERIAL', default='', help='serial number of the table (default: runs that '
                        'state none)')
    parser.add_argument('--model', metavar='HASH', default='', help='hash of the model, or its beginning (default: '
                        'that of most runs)')
    parser.add_argument('-o', '--output', metavar='FILE', help='write the trend as a page (HTML)')
    parser.add_argument('--figures', metavar='DIR', help='write the pictures of the errors over time and of what '
                        'changed (PNG)')
    add_shared(parser, '--angle-unit', '--force', '--json')


def run_trend(options: Namespace) -> None:
    """Print the trend."""
    if options.output:
        refuse_output(options.output, options.force)
    history = read_history(RunArchive(options.archive), options.table, options.model)
    trend = trend_of(history)
    pictures = trend.pictures() if options.figures or options.output else {}
    paths = save_all({f'trend_{name}': figure for name, figure in pictures.items()}, made_folder(
        options.figures, 'to write to', ''), 'png', options.force) if options.figures else []
    said = [f'Table {history.serial or "without serial number"}, {history.dates[0]:%Y-%m-%d} to '
            f'{history.dates[-1]:%Y-%m-%d}, model {history.model_hash[:12]}',
            f'{trend.sentence}.', *trend.notes]
    if options.output:
        write_text(options.output, trend_html(
            history.serial, history.model_hash, history.dates, said[1:], trend.tables, pictures, options.command_line,
            history.simulated), options.force)
    if options.json:
        print_json(_table_trend_json(trend))
        return
    out = console()
    for sentence in said:
        out.print(sentence, markup=False, soft_wrap=True)
    print_parts(out, trend.tables)
    for path in paths:
        out.print(f'Picture: {path}', markup=False, soft_wrap=True)
    if options.output:
        out.print(f'Page: {options.output}', markup=False, soft_wrap=True)


def _table_trend_json(trend: TableTrend) -> Json:
    """Return the trend, schema rosette-trend/1."""
    history, events = trend.history, trend.events
    runs, dates, names = history.runs, history.dates, dict(zip(CURVES, CURVE_KEYS, strict=True))
    return plain({
        'schema': 'rosette-trend/1', 'table': history.serial, 'model_hash': history.model_hash, 'level': trend.level,
        'sentence': trend.sentence,
        'runs': [{'run_id': run, 'measured_at': date.isoformat()} for run, date in zip(runs, dates, strict=True)],
        'left_out': history.left_out, 'other_balls': history.other_balls,
        'ranges': by_curve({'value': value, 'U': spread}
                           for value, spread in zip(history.range.T, history.U.T, strict=True)),
        'events': [{
            'run_id': runs[event.run], 'not_before': dates[event.earliest - 1].isoformat(),
            'not_after': dates[event.latest].isoformat(), 'owners': event.owners,
            'exchanged': history.exchanged(event.run), 'steps': [
                {'quantity': step.series.name, 'owner': step.series.owner, 'unit': step.series.unit, 'size': step.size,
                 'U': COVERAGE_FACTOR * step.u, 'p': step.p} for step in event.steps]} for event in events],
        'forecasts': {names[curve]: {
            'level': one.level, 'per_day': one.slope, 'u_per_day': one.slope_u, 'interval_d': one.interval,
            'expected_d': one.expected, 'soonest_d': one.soonest} for curve, one in trend.forecasts.items()},
        'too_few_runs': {names[curve]: count for curve, count in history.too_few(events).items()},
        'residual_course_m': history.residual_course(events)})


IMPLEMENTED = {
    'archive': {
        'add': ('evaluate the logs in folders and keep a row of each run; what is known is not done again',
                add_logs_arguments, run_add),
        'query': ('what an archive says, by SQL or by ready questions', query_arguments, run_query),
        'environment': ('what may move in the cell of a table by its earlier runs, as a section of --inputs',
                        environment_arguments, run_environment),
        'experience': ('what the runs of a cell have taught of its causes, as a file for --experience',
                       experience_arguments, run_experience),
        'plant': ('all tables: last result, conformity, when to calibrate again; the most urgent first',
                  plant_arguments, run_plant),
        'reanalyse': ('evaluate all runs under another model and compare: residuals, curves, which runs had the effect',
                      reanalyse_arguments, run_reanalyse)},
    'trend': (trend_arguments, run_trend)}
"""Another question to an archive is a line here."""
