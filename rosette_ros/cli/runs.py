# SPDX-License-Identifier: Apache-2.0
"""The runs of a folder: what their logs say is listed without loading what would judge them."""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from rich.markup import escape

from rosette_ros.cli.arguments import add_shared, load
from rosette_ros.cli.console import console, doing, print_json, print_parts
from rosette_ros.cli.info import broken_off, counts_of
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import RosetteError, counted
from rosette_ros.io.log_reader import read_log, runs_in
from rosette_ros.io.open_run import is_log, open_run
from rosette_ros.presentation.table_format import Table, verdict_json, words
from rosette_ros.words.verdict_words import verdict_text


def runs_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('folder', metavar='FOLDER', nargs='?', default='rosette-runs',
                        help='folder of logs and tables (default rosette-runs)')
    add_shared(parser, '--json')


def run_runs(options: Namespace) -> None:
    """Print the runs."""
    out = console()
    paths = runs_in(options.folder)
    with doing('', len(paths)) as step:
        found = []
        for path in paths:
            step(path.name, 0)
            found.append(run_facts(path))
            step()
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


def run_facts(path: Path) -> dict[str, Any]:
    """Return what is known of one run; problem: why it has no verdict, '' where it has one.

    The verdict of its cell on the base model is taken from the log: to judge 20 runs anew takes half a minute."""
    problem, verdict, n, size, judged = '', None, None, None, ''
    try:
        log = read_log(path) if is_log(path) else None
        begun = [(name, run.targets[0].balls) for name, run in log.runs.items() if run.targets] if log else []
        if log and len(begun) == 1 and (stopped := broken_off(log, begun[0][0])):
            (name, n), = begun
            size = counts_of(log, name).get('run', {}).get('answered', 0)
            return {'path': str(path), 'n': n, 'readings': size, **verdict_json(None), 'judged': '',
                    'problem': f'{n} balls, {stopped}'}
        measured = log.to_run() if log else open_run(path)
        n, size = measured.n, measured.size
        if log and not log.problems and (verdict := log.verdicts.get((measured.run_id, str(Model())))):
            judged = 'cell'
        elif n <= (analysis := load('rosette_ros.analysis', 'runs')).MOST_BALLS_JUDGED:
            verdict, judged = verdict_text(analysis.judge(measured)), 'now'
        else:
            problem = f'more than {analysis.MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN'
    except RosetteError as error:
        problem = str(error)
    return {'path': str(path), 'n': n, 'readings': size, **verdict_json(verdict), 'judged': judged,
            'problem': problem}


IMPLEMENTED = {'runs': (runs_arguments, run_runs)}
