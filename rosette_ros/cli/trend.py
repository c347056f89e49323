# SPDX-License-Identifier: Apache-2.0
"""rosette trend: how a table changes over the runs of an archive, what changed when, when to calibrate again."""

from argparse import ArgumentParser, Namespace

from matplotlib.figure import Figure

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.table_history import PEAK_TO_VALLEY, read_history
from rosette_ros.archive.table_trend import TableTrend, trend_of
from rosette_ros.cli.arguments import add_shared, made_folder
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.records import CURVES
from rosette_ros.io.text_file import refuse_output, write_text
from rosette_ros.presentation.json_output import CURVE_KEYS, Json, by_curve, plain
from rosette_ros.presentation.plots import plot_style, trend_plots
from rosette_ros.presentation.report.trend_page import trend_html
from rosette_ros.presentation.trend_results import Charts, charts_table, component_name

SCHEMA = 'rosette-trend/1'


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'archive')
    parser.add_argument('--table', metavar='SERIAL', default='', help='serial number of the table (default: runs that '
                        'state none)')
    parser.add_argument('--model', metavar='HASH', default='', help='hash of the model, or its beginning (default: '
                        'that of most runs)')
    parser.add_argument('-o', '--output', metavar='FILE', help='write the trend as a page (HTML)')
    parser.add_argument('--figures', metavar='DIR', help='write the pictures (PNG): errors over time, control charts')
    add_shared(parser, '--force', '--json')


def run(options: Namespace) -> None:
    """Print the trend."""
    if options.output:
        refuse_output(options.output, options.force)
    history = read_history(RunArchive(options.archive), options.table, options.model)
    trend, charts = trend_of(history), history.charts()
    pictures = _pictures(trend, charts) if options.figures or options.output else {}
    paths = plot_style.save_all({f'trend_{name}': figure for name, figure in pictures.items()}, made_folder(
        options.figures, 'to write to', ''), 'png', options.force) if options.figures else []
    said = [f'Table {history.serial or "without serial number"}, {history.dates[0]:%Y-%m-%d} to '
            f'{history.dates[-1]:%Y-%m-%d}, model {history.model_hash[:12]}',
            f'{trend.sentence}.', *trend.notes]
    if options.output:
        write_text(options.output, trend_html(
            history.serial, history.model_hash, history.dates, said[1:],
            [*trend.tables, charts_table(charts, history.dates)], pictures, options.command_line, history.simulated),
            options.force)
    if options.json:
        print_json(_json(trend, charts))
        return
    out = console()
    for words in said:
        out.print(words, markup=False, soft_wrap=True)
    print_parts(out, trend.tables)
    for path in paths:
        out.print(f'Picture: {path}', markup=False, soft_wrap=True)
    if options.output:
        out.print(f'Page: {options.output}', markup=False, soft_wrap=True)


def _json(trend: TableTrend, charts: Charts) -> Json:
    """Return the trend, schema rosette-trend/1."""
    history, events = trend.history, trend.events
    runs, dates, names = history.runs, history.dates, dict(zip(CURVES, CURVE_KEYS, strict=True))
    return plain({
        'schema': SCHEMA, 'table': history.serial, 'model_hash': history.model_hash, 'level': trend.level,
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
        'residual_course_m': history.residual_course(events),
        'charts': [{'quantity': series.name, 'component': part, 'ewma': one.ewma, 'ewma_limit': one.ewma_limit,
                    'cusum_high': one.high, 'cusum_low': one.low, 'cusum_limit': one.cusum_limit,
                    'alarms': [runs[alarm] for alarm in one.alarms]} for series, part, one in charts]})


def _pictures(trend: TableTrend, charts: Charts) -> dict[str, Figure]:
    """Return the pictures by name; that of what moved most at the last change where there is one."""
    history, events = trend.history, trend.events
    every = [(series.name, chart) for series, _, chart in charts]
    summary = [one for one in every if PEAK_TO_VALLEY in one[0] or one[0].startswith('residual')]
    harmonics = [one for one in every if one not in summary]
    moved = {}
    if events:
        series, part, chart = history.chart_of(events[-1])
        moved['control_chart'] = trend_plots.events_over_time(history.dates, series, chart,
                                                              component_name(series, part), events)
    return {'ranges': trend_plots.ranges_over_time(history.dates, history.range, history.U, history.tolerances, events,
                                                   trend.forecasts),
            'summary': trend_plots.charts_over_time(history.dates, summary, 2),
            **({'harmonics': trend_plots.charts_over_time(history.dates, harmonics, 3)} if harmonics else {}),
            **moved}
