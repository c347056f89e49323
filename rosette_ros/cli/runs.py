# SPDX-License-Identifier: Apache-2.0
"""rosette runs: the runs in a folder, newest first, with their verdicts."""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from rosette_ros.analysis import MOST_BALLS_JUDGED, judge
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.core.errors import RosetteError
from rosette_ros.io.open_run import open_run, runs_in
from rosette_ros.presentation.json_output import verdict_json
from rosette_ros.presentation.table_format import Table, words


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('folder', metavar='FOLDER', nargs='?', default='rosette-runs',
                        help='folder of logs and tables (default rosette-runs)')
    add_shared(parser, '--json')


def run(options: Namespace) -> None:
    """Print the runs."""
    out = console()
    with out.status('judging'):
        found = [facts(path) for path in runs_in(options.folder)]
    if options.json:
        print_json({'schema': 'rosette-runs/1', 'folder': options.folder, 'runs': found})
        return
    out.print(f'[bold]{len(found)} runs[/] in {options.folder}')
    print_parts(out, [Table('runs', 'Newest first', (
        words('run', 'run', [Path(one['path']).name for one in found]),
        words('balls', 'balls', [one['n'] or '' for one in found]),
        words('verdict', 'verdict', [one['verdict'] or one['problem'] for one in found])),
        levels=tuple(one['level'] or '' for one in found))])


def facts(path: Path) -> dict[str, Any]:
    """Return what is known of one run; problem: why it has no verdict, '' where it has one."""
    problem, verdict, n, size = '', None, None, None
    try:
        measured = open_run(path)
        n, size = measured.n, measured.size
        if n <= MOST_BALLS_JUDGED:
            verdict = judge(measured)
        else:
            problem = f'more than {MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN'
    except RosetteError as error:
        problem = str(error)
    return {'path': str(path), 'n': n, 'readings': size, **verdict_json(verdict), 'problem': problem}
