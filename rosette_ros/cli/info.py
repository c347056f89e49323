# SPDX-License-Identifier: Apache-2.0
"""What is in a run: its phases, times and conditions, and what is wrong with it."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, pairs, print_json, print_parts
from rosette_ros.core.run.errors import RosetteError
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.remarks import RemarkKind
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_run import NOTES_KEY, RESUMES_KEY, LogRun
from rosette_ros.io.messages import Phase, phase_name
from rosette_ros.io.open_run import is_log, open_run
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.identity_words import NOTHING, SIMULATED, identity_rows
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.words.effect_words import fixed
from rosette_ros.words.reading_words import notes_of, remark_words


def info_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--columns', '--json')


def run_info(options: Namespace) -> None:
    """Print what is in the run."""
    path = Path(options.run_path)
    facts = log_facts(path) if is_log(path) else table_facts(path, options.columns)
    if options.json:
        print_json(facts)
    else:
        show_info(facts)


def table_facts(path: Path, columns: str | None = None) -> dict[str, Any]:
    """Return what a ball-centre table holds, as `log_facts`; columns: of one of another program."""
    found = open_run(path, columns_of=read_columns(columns))
    phases = {'run': {'asked': text.wanted_size(found), 'answered': found.size}}
    return _facts(path, 'table', [path], [_run_facts(found.run_id, found.n, found.radius, phases, found)])


def log_facts(path: Path) -> dict[str, Any]:
    """Return what a log holds, schema rosette-info/1: SI, times of the log in ns since the epoch, None if not known."""
    log = read_log(path)
    topics = sorted((topic.name, topic.type_name, topic.messages) for topic in log.topics)
    return _facts(path, 'log', log.files, [_logged(log, name) for name, found in log.runs.items() if found.targets],
                  topics=[dict(zip(('name', 'type', 'messages'), topic, strict=True)) for topic in topics],
                  messages=log.messages, start_ns=log.start_ns, end_ns=log.end_ns, truncated=log.truncated,
                  problems=[*log.problems, *log.unasked], resumes=log.custom_data.get(RESUMES_KEY))


def _facts(path: Path, kind: str, files: Iterable[Path], runs: list[dict[str, Any]], **of_log: Any) -> dict[str, Any]:
    return {'schema': 'rosette-info/1', 'path': str(path), 'kind': kind, 'files': [str(file) for file in files],
            'runs': runs, 'topics': [], 'messages': None, 'start_ns': None, 'end_ns': None, 'truncated': False,
            'problems': [], 'resumes': None, **of_log}


def _logged(log: LogRun, run_id: str) -> dict[str, Any]:
    """Return what a log holds of one run; as `_run_facts`."""
    state, answers = {one.run_id: one for one in log.states}.get(run_id), log.runs[run_id]
    identity = log.identity(run_id)
    first, published = answers.targets[0], [one for one in log.error_motions if one.run_id == run_id]
    phases, stopped = counts_of(log, run_id), broken_off(log, run_id)
    found = problem = None
    unused = {reason: count for reason, count in answers.unused().items() if count}
    try:
        found = log.to_run(run_id)
    except RosetteError as error:
        problem = None if stopped else str(error)
    remarks = [remark_words(one) for one in (found.remarks if found else RunAssembly(answers).remarks)
               if one.kind is not RemarkKind.LOG_DAMAGED]
    noted = dict.fromkeys([*(notes_of(found) if found else ()), *log.custom_data.get(NOTES_KEY, '').splitlines()])
    return _run_facts(run_id, first.balls, first.radius, phases, found, order=state.order if state else None,
                      notes=[one for one in noted if one not in remarks],
                      balls=np.unique(found.ball).size if found and is_done(log, run_id) else first.balls,
                      broken_off=stopped, **({'missing': ''} if stopped else {}), unused=unused, remarks=remarks,
                      identity=dict(identity.entries), tolerances=dict(identity.tolerances),
                      published_curves=len(published), model=published[-1].model_name if published else None,
                      ended=f'{phase_name(state.phase).lower()}: {state.text}' if state else None, problem=problem,
                      simulated=log.simulated)


def is_done(log: LogRun, run_id: str) -> bool:
    """Return whether a run came to its end."""
    return any(one.run_id == run_id and one.phase == Phase.DONE for one in log.states)


def counts_of(log: LogRun, run_id: str) -> dict[str, dict[str, int]]:
    """Return what was asked and answered in each phase of a run; of one that was broken off all n² are asked."""
    answers = log.runs[run_id]
    planned = {} if is_done(log, run_id) else {Phase.RUN: max(target.balls for target in answers.targets) ** 2}
    return {phase.name.lower(): {'asked': max(asked, planned.get(phase, 0)), 'answered': answered}
            for phase, (asked, answered) in answers.counts().items()}


def broken_off(log: LogRun, run_id: str) -> str:
    """Return after how much a run was cancelled or failed: 'cancelled after 2 of 144'; '' where it was not."""
    state = next((one for one in log.states if one.run_id == run_id), None)
    if state is None or state.phase not in (Phase.CANCELLED, Phase.FAILED):
        return ''
    done = counts_of(log, run_id).get('run', {'asked': log.runs[run_id].targets[0].balls**2, 'answered': 0})
    return f'{phase_name(state.phase).lower()} after {done["answered"]} of {done["asked"]}'


def _run_facts(run_id: str, n: int, radius: float, phases: dict[str, dict[str, int]], found: Run | None,
               **of_log: Any) -> dict[str, Any]:
    known = found.temperature[np.isfinite(found.temperature)] if found else np.array([])
    return {'run_id': run_id, 'n': n, 'balls': np.unique(found.ball).size if found else n, 'radius_m': radius,
            'phases': phases, 'order': None, 'completeness': found.completeness if found else 0.0,
            'duration_s': text.seconds_of(found) if found else None, 'pauses': text.pauses(found) if found else '',
            'temperature_range_C': [float(known.min()), float(known.max())] if known.size else None,
            'repeatability_m': found.repeatability if found else None,
            'repeatability_dof': found.repeatability_dof if found else None,
            'repeatability_axes_m': found.repeatability_axes if found else None,
            'notes': notes_of(found) if found else (), 'missing': text.unmeasured_words(found) if found else '',
            'remarks': tuple(map(remark_words, found.remarks)) if found else (), 'unused': {},
            'published_curves': 0, 'model': None,
            'simulated': found.simulated if found else None, 'ended': None, 'broken_off': '', 'problem': None,
            'identity': {}, 'tolerances': {}, **of_log}


def show_info(facts: dict[str, Any]) -> None:
    """Print the facts for a person."""
    out, topics = console(), facts['topics']
    out.print(f'[bold]{facts["kind"].capitalize()}[/] {escape(facts["path"])}', soft_wrap=True)
    rows = []
    if facts['messages'] is not None:
        rows.append(('Files', escape(', '.join(Path(file).name for file in facts['files']))))
        start, end = facts['start_ns'], facts['end_ns']
        is_counted = facts['runs'] and not any(one['duration_s'] for one in facts['runs'])
        long = (', no times' if is_counted else f', {text.duration(1e-9 * (end - start))}, no date'
                if facts['messages'] else '')
        times = f', {text.instant(start)} to {text.instant(end)}' if text.instant(start) else long
        rows.append(('Messages', f'{facts["messages"]} in {len(topics)} topics{times}'))
    if facts['resumes']:
        rows.append(('Continues', f'{escape(facts["resumes"])}, whose ball centres are in this log too'))
    if facts['truncated']:
        rows.append(('Truncated', '[red]the log ends in the middle; all complete records were read[/]'))
    rows += [('Problem', f'[red]{escape(problem)}[/]') for problem in facts['problems']]
    if rows:
        out.print(pairs(rows))
    print_parts(out, [pairs(run_rows(one)) for one in facts['runs']])
    print_parts(out, [Table('topics', 'Topics', (
        column('messages', 'messages', [topic['messages'] for topic in topics], str),
        words('topic', 'topic', [topic['name'] for topic in topics]),
        words('type', 'type', [topic['type'] for topic in topics])))])


def run_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what is known of one run as (name, text) rows."""
    degrees = facts['temperature_range_C']
    rows = [('Run', escape(facts['run_id'] or 'without a name')),
            ('SIMULATED', SIMULATED.partition(': ')[2] if facts['simulated'] else ''),
            ('Plate', ', '.join(filter(None, (text.plate_words(facts['n'], facts['balls'], facts['radius_m']),
                                              facts['broken_off'])))),
            ('Measured', ', '.join(f'{name.replace("_", " ")} {phase["answered"]} of {phase["asked"]}'
                                   for name, phase in facts['phases'].items())),
            *(('Note', escape(note)) for note in (facts['missing'], *facts['notes'])),
            ('Order', escape(facts['order'] or '')),
            ('Duration', text.run_duration(facts['duration_s'] or 0.0)),
            ('Pauses', facts['pauses']),
            ('Not used', ', '.join(f'{count} answers {reason}' for reason, count in facts['unused'].items())),
            ('Temperature', f'{" to ".join(fixed(one, 3) for one in degrees)} °C' if degrees else ''),
            ('Repeatability', text.repeatability_words(
                facts['repeatability_m'], facts['repeatability_dof'], facts['repeatability_axes_m'])),
            ('Published', f'error motions, {facts["published_curves"]}×, model {escape(facts["model"] or "")}'
             if facts['published_curves'] else ''),
            ('Ended', escape(facts['ended'] or '')), *((name, escape(words)) for name, words in (
                identity_rows(Identity(facts['identity'], facts['tolerances'])) if facts['identity'] else
                [('Identity', NOTHING)])),
            *(('Doubtful', f'[yellow]{escape(remark)}[/]') for remark in facts['remarks']),
            ('Problem', f'[red]{escape(facts["problem"])}[/]' if facts['problem'] else '')]
    return [row for row in rows if row[1]]


IMPLEMENTED = {'info': (info_arguments, run_info)}
