# SPDX-License-Identifier: Apache-2.0
"""rosette archive add: evaluates what is new in folders of logs, on all cores or a cluster, into an archive."""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from rosette_ros import command
from rosette_ros.archive.engines import DaskEngine
from rosette_ros.archive.log_finder import find_logs
from rosette_ros.archive.run_adding import Added, add_logs
from rosette_ros.archive.run_archive import RunArchive, local_folder
from rosette_ros.cli.arguments import add_shared, whole
from rosette_ros.cli.console import console, print_json
from rosette_ros.core.errors import counted
from rosette_ros.io.identity_file import read_identity
from rosette_ros.io.model_file import read_model

SCHEMA = 'rosette-archive-add/1'
MOST_WORKERS = 4096


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('folders', metavar='FOLDER', nargs='+', help='folder with logs, at any depth, a log, or a URL '
                        'that fsspec knows (s3://... with its driver)')
    add_shared(parser, '--into', '--model')
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


def run(options: Namespace) -> int:
    """Add and say what was done; 1 where a new log could not be evaluated."""
    local_folder(options.into)  # refused before hours of work
    model = read_model(options.model)
    identity = read_identity(options.identity) if options.identity else None
    logs = find_logs(options.folders)
    with DaskEngine(options.scheduler, options.workers) as engine, progress() as show:
        archive = RunArchive(options.into, make=True)
        added = add_logs(archive, logs, engine, model, identity, options.force, on_progress=show)
    if options.json:
        print_json({'schema': SCHEMA, 'archive': options.into, **vars(added)})
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
