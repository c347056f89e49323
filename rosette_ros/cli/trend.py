# SPDX-License-Identifier: Apache-2.0
"""rosette trend: how a table changes over the runs of an archive, what changed when, when to calibrate again."""

from argparse import ArgumentParser, Namespace

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.table_history import History, read_history
from rosette_ros.cli.arguments import add_shared, made_folder
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.core.errors import counted
from rosette_ros.core.trend import Event, control_chart
from rosette_ros.presentation.plots import plot_style, trend_plots
from rosette_ros.presentation.trend_results import events_table, forecast_table, trend_json


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('archive', metavar='ARCHIVE', help='folder of the archive')
    parser.add_argument('--table', metavar='SERIAL', default='', help='serial number of the table (default: runs that '
                        'state none)')
    parser.add_argument('--model', metavar='HASH', default='', help='hash of the model, or its beginning (default: '
                        'that of most runs)')
    parser.add_argument('--figures', metavar='DIR', help='write the pictures: errors over time, control chart')
    parser.add_argument('--force', action='store_true', help='replace pictures that are there')
    add_shared(parser, '--json')


def run(options: Namespace) -> None:
    """Print the trend."""
    history = read_history(RunArchive(options.archive), options.table, options.model)
    events = history.events()
    exchanged = [history.exchanged(event.run) for event in events]
    forecasts = history.forecasts(events)
    paths = _draw(history, events, options) if options.figures else []
    if options.json:
        print_json(trend_json(history.serial, history.model_hash, history.dates, history.runs,
                              (history.range, history.U), events, exchanged, forecasts))
        return
    out = console()
    out.print(f'Table {history.serial or "without serial number"}: {counted(len(history.runs), "run")} from '
              f'{history.dates[0]:%Y-%m-%d} to {history.dates[-1]:%Y-%m-%d}, model {history.model_hash[:12]}')
    unlimited = [] if forecasts else ['No tolerances are stated (identity file, tolerances): nothing to forecast.']
    if events:
        print_parts(out, [events_table(events, history.dates, history.runs, exchanged)])
    else:
        out.print('No change beyond the scatter of the runs: curves, plate, CMM, effects and residual; slopes in time '
                  'and temperature are no changes.', soft_wrap=True)
    print_parts(out, [forecast_table(forecasts, history.dates[-1])] if forecasts else unlimited)
    for path in paths:
        out.print(f'Picture: {path}', markup=False)


def _draw(history: History, events: tuple[Event, ...], options: Namespace) -> list[str]:
    """Write the pictures; return their paths."""
    moved = events[-1].steps[0].series if events else history.quantities[0]
    tests = len(history.runs) * sum(one.values.shape[1] for one in history.quantities)
    part = int(abs(moved.values[-1] - moved.values[0]).argmax())
    chart = control_chart(moved.values[:, part], moved.u[:, part], tests)
    made = {'ranges': trend_plots.ranges_over_time(history.dates, history.range, history.U, history.tolerances, events,
                                                   history.forecasts(events)),
            'control_chart': trend_plots.events_over_time(history.dates, chart, moved.name, events)}
    folder = made_folder(options.figures, 'to write to', '')
    for name, figure in made.items():
        plot_style.save(figure, folder / f'trend_{name}.png', options.force)
    return [str(folder / f'trend_{name}.png') for name in made]
