# SPDX-License-Identifier: Apache-2.0
"""The runs of a folder: what their logs say is listed without loading what would judge them."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.markup import escape

from rosette_ros.cli.arguments import add_shared, load
from rosette_ros.cli.console import console, doing, print_json, print_parts
from rosette_ros.cli.info import broken_off, counts_of
from rosette_ros.core.diagnosis.verdict import Outcome, VerdictText
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import RosetteError, counted
from rosette_ros.core.run.number_words import UNKNOWN
from rosette_ros.core.run.records import Run
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import read_log, runs_in, written
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.open_run import is_log, open_run
from rosette_ros.presentation.formatting import instant, micro
from rosette_ros.presentation.table_format import Table, column, verdict_json, words
from rosette_ros.words.verdict_words import SHORT, verdict_text


def runs_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('folder', metavar='FOLDER', nargs='?', default='rosette-runs',
                        help='folder of logs and tables (default rosette-runs)')
    parser.add_argument('--long', action='store_true', help='each verdict in its sentence, and what is no run')
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
    found.sort(key=lambda one: written(one['path']) if one['begun'] is None else one['begun'], reverse=True)
    if options.json:
        print_json({'schema': 'rosette-runs/1', 'folder': options.folder, 'runs': found})
        return
    shown = [one for one in found if options.long or one['is_run']]
    out.print(f'[bold]{counted(len(shown), "run")}[/] in {escape(options.folder)}')
    print_parts(out, [runs_table(shown, options.long)])


def runs_table(found: Sequence[dict[str, Any]], is_long: bool = False) -> Table:
    """Return runs in a line each; is_long: with each verdict in its sentence."""
    short = [SHORT[Outcome(one['outcome'])] if one['outcome'] else one['ended'] or one['problem'] for one in found]
    return Table('runs', 'Newest first', (
        words('run', 'run', [Path(one['path']).name for one in found]),
        words('measured', 'measured, UTC', [one['measured'] for one in found]),
        words('table', 'table', [one['table'] for one in found]),
        words('order', 'order', [one['order'] for one in found]),
        words('n', 'n', [one['n'] or '' for one in found]),
        column('residual_um', 'residual', [one['residual_m'] for one in found],
               lambda value: UNKNOWN if value is None else micro(value), 'µm'),
        words('verdict', 'verdict', [one['verdict'] or one['problem'] for one in found] if is_long else short),
        words('tolerances', 'tolerances', [one['conformity'] or '' for one in found]),
        *([words('judged', 'judged', [one['judged'] for one in found])] if is_long else [])),
        levels=tuple(one['level'] or '' for one in found),
        note='judged: by its cell at the end of the run, as its log holds it; or now, from the readings' if is_long
        else 'Sentences: --long')


def run_facts(path: Path) -> dict[str, Any]:
    """Return what is known of one run, SI; problem: why it has no verdict, '' where it has one; is_run: whether it is a
    run at all, sound or not; begun: s since the epoch, as its log or table says; conformity: with all tolerances that
    its identity states, None without any.

    The verdict of its cell on the base model is taken from the log: to judge 20 runs anew takes half a minute."""
    facts = dict[str, Any](path=str(path), is_run=True, run_id='', begun=None, measured='', table='', order='', n=None,
                           readings=None, residual_m=None, conformity=None, **verdict_json(None), judged='', ended='',
                           problem='')
    try:
        if not is_log(path):
            facts['is_run'] = False
            run = open_run(path)
            facts['is_run'] = True
            return facts | _of_table(run)
        log = read_log(path)
        return facts | _of_log(log, facts)
    except RosetteError as error:
        return facts | {'problem': str(error)}


def _of_table(run: Run) -> dict[str, Any]:
    return {**_measured(run), 'begun': run.begun,
            'measured': '' if run.begun is None else _minute(round(1e9 * run.begun)), **_judged(run, Identity(), None)}


def _of_log(log: LogRun, facts: dict[str, Any]) -> dict[str, Any]:
    facts['begun'] = 1e-9 * log.start_ns if instant(log.start_ns) else None
    begun = [(name, run.targets[0].balls) for name, run in log.runs.items() if run.targets]
    if len(begun) == 1:
        (name, n), = begun
        state = next((one for one in log.states if one.run_id == name), None)
        facts |= {'run_id': name, 'measured': _minute(log.begun_ns(name)), 'order': state.order if state else '',
                  'n': n, 'table': log.identity(name)['table.serial']}
        if stopped := broken_off(log, name):
            return {'readings': counts_of(log, name).get('run', {}).get('answered', 0),
                    'problem': f'{n} balls, {stopped}', 'ended': stopped}
    run = log.to_run()
    known = None if log.problems else log.verdicts.get((run.run_id, str(Model())))
    published = log.latest_error_motions(run.run_id)
    return {**_measured(run), 'order': facts['order'],
            **({'residual_m': published.rms} if published and published.model_name == str(Model()) else {}),
            **_judged(run, log.identity(run.run_id), known)}


def _minute(stamp_ns: int) -> str:
    """Return a time to the minute, '' where it is none."""
    return instant(stamp_ns)[:16]


def _measured(run: Run) -> dict[str, Any]:
    advice = load('rosette_ros.core.planning.advice', 'runs')
    return {'run_id': run.run_id, 'n': run.n, 'readings': run.size, 'order': advice.scheme_of(run).order}


def _judged(run: Run, identity: Identity, known: VerdictText | None) -> dict[str, Any]:
    """Return the verdict on a run, that of its cell where it is known, and whether it keeps its tolerances."""
    analysis, limits = load('rosette_ros.analysis', 'runs'), identity.limits(run.rotation)
    made, fitted = dict[str, Any](), None
    if not known and run.n > analysis.MOST_BALLS_JUDGED:
        problem = f'more than {analysis.MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN'
        return {'problem': problem, 'ended': 'not judged'}
    if not known:
        found = analysis.find(run)
        known, fitted = verdict_text(found.verdict), found.fit
        made = {'judged': 'now', 'residual_m': fitted.rms}
    else:
        made = {'judged': 'cell'}
    if limits:
        fitted = fitted or analysis.analyse(run)
        unseen = known.unseen or analysis.unseen(fitted)  # no message carries it
        made['conformity'] = analysis.conformity_of(fitted, replace(known, unseen=unseen), limits)
    return {**verdict_json(known), **made}


IMPLEMENTED = {'runs': (runs_arguments, run_runs)}
