# SPDX-License-Identifier: Apache-2.0
"""rosette runs: the runs in a folder, newest first, with their verdicts."""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from rich.markup import escape

from rosette_ros.analysis import MOST_BALLS_JUDGED, judge
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, print_json, print_parts
from rosette_ros.cli.info import broken_off
from rosette_ros.core.errors import RosetteError, counted
from rosette_ros.core.model.model import Model
from rosette_ros.io.bag_metadata import runs_in
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import is_log, open_run
from rosette_ros.presentation.json_output import verdict_json
from rosette_ros.presentation.table_format import Table, words
from rosette_ros.words.verdict_words import verdict_text


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('folder', metavar='FOLDER', nargs='?', default='rosette-runs',
                        help='folder of logs and tables (default rosette-runs)')
    add_shared(parser, '--json')


def run(options: Namespace) -> None:
    """Print the runs."""
    out = console()
    paths = runs_in(options.folder)
    with out.status('') as status:
        found = []
        for place, path in enumerate(paths, 1):
            status.update(f'{place} of {len(paths)}: {escape(path.name)}')
            found.append(facts(path))
    if options.json:
        print_json({'schema': 'rosette-runs/1', 'folder': options.folder, 'runs': found})
        return
    out.print(f'[bold]{counted(len(found), "run")}[/] in {escape(options.folder)}')
    print_parts(out, [Table('runs', 'Newest first', (
        words('run', 'run', [Path(one['path']).name for one in found]),
        words('balls', 'balls', [one['n'] or '' for one in found]),
        words('verdict', 'verdict', [one['verdict'] or one['problem'] for one in found]),
        words('judged', 'judged', [one['judged'] for one in found])),
        levels=tuple(one['level'] or '' for one in found),
        note='judged: by its cell at the end of the run, as its log holds it; or now, from the readings')])


def facts(path: Path) -> dict[str, Any]:
    """Return what is known of one run; problem: why it has no verdict, '' where it has one.

    The verdict of its cell on the base model is taken from the log: to judge 20 runs anew takes half a minute."""
    problem, verdict, n, size, judged = '', None, None, None, ''
    try:
        log = read_log(path) if is_log(path) else None
        measured = log.to_run() if log else open_run(path)
        n, size = measured.n, measured.size
        if log and (words := broken_off(log, measured.run_id)):
            problem = f'{n} balls, {words}'
        elif log and not log.problems and (verdict := log.verdicts.get((measured.run_id, str(Model())))):
            judged = 'cell'
        elif n <= MOST_BALLS_JUDGED:
            verdict, judged = verdict_text(judge(measured)), 'now'
        else:
            problem = f'more than {MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN'
    except RosetteError as error:
        problem = str(error)
    return {'path': str(path), 'n': n, 'readings': size, **verdict_json(verdict), 'judged': judged,
            'problem': problem}
