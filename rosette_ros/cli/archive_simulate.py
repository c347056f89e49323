# SPDX-License-Identifier: Apache-2.0
"""rosette archive simulate: years of a simulated cell by an ageing script, evaluated into an archive."""

import datetime
import hashlib
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable

from rich.progress import track

from rosette_ros import command
from rosette_ros.analysis import analyse
from rosette_ros.archive.reanalysis import WITHOUT_LOG
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import Row, evaluation_row, heading
from rosette_ros.cli.arguments import UsageError, add_shared
from rosette_ros.cli.console import console
from rosette_ros.core.errors import counted
from rosette_ros.core.model.model import Model
from rosette_ros.core.records import Run
from rosette_ros.io.identity_file import Identity, format_identity, read_identity
from rosette_ros.io.model_file import read_model
from rosette_ros.simulation.ageing import YEAR, read_ageing

BEGIN = '2024-01-01'


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('script', metavar='SCRIPT', help='ageing script (YAML): interval, seasons, changes of the '
                        'machine (docs/archive.md); rows are kept, no logs: reanalyse needs logs')
    parser.add_argument('--begin', metavar='DAY', default=BEGIN, help='day of the first run, UTC unless it states an '
                        f'offset (default: {BEGIN})')
    add_shared(parser, '--into', '--model', '--identity')


def run(options: Namespace) -> None:
    """Measure, evaluate, and keep a row of each run."""
    script, model = read_ageing(options.script), read_model(options.model)
    identity = read_identity(options.identity) if options.identity else Identity({'table.serial': 'SIMULATED'})
    try:
        begin = datetime.datetime.fromisoformat(options.begin)
        begin = begin.astimezone(datetime.UTC) if begin.tzinfo else begin.replace(tzinfo=datetime.UTC)
        begin + datetime.timedelta(days=script.days[-1] + 1)
    except (ValueError, OverflowError) as error:
        raise UsageError(f'--begin: wanted a day such as {BEGIN}, got {options.begin!r}') from error
    archive = RunArchive(options.into, make=True)
    out = console(sys.stderr)
    runs = track(script.iter_runs(), 'measuring', script.runs, console=out, transient=True,
                 disable=not out.is_terminal)
    archive.add(simulated_rows(runs, begin, identity, model))
    serial = identity['table.serial']
    following = command('trend', options.into, *(('--table', serial) if serial else ()))
    console().print(f'{counted(script.runs, "run")} of {script.days[-1] / YEAR:.1f} years in {options.into}; next: '
                    f'{following}', markup=False, soft_wrap=True)


def simulated_rows(runs: Iterable[tuple[float, Run]], begin: datetime.datetime, identity: Identity,
                   model: Model) -> list[Row]:
    """Return a row of every (day, Run), curves evaluated and nothing diagnosed."""
    rows = []
    for day, measured in runs:
        date = begin + datetime.timedelta(days=day)
        rows.append({**heading(_digest(measured, identity, date), f'{WITHOUT_LOG}{measured.run_id}', '', model,
                               datetime.datetime.now(datetime.UTC), measured.run_id),
                     **evaluation_row(analyse(measured, model), identity=identity), 'measured_at': date,
                     'ended_at': date + datetime.timedelta(seconds=float(measured.time[-1]))})
    return rows


def _digest(measured: Run, identity: Identity, date: datetime.datetime) -> str:
    """Return what stands for the content of a log: the same centres at another table or time are another run."""
    stated = f'{format_identity(identity)}{date.isoformat()}'
    return hashlib.sha256(stated.encode() + measured.centre.tobytes()).hexdigest()
