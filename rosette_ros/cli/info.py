# SPDX-License-Identifier: Apache-2.0
"""rosette info: what is in a run, a log or a table, without evaluating it."""

from argparse import ArgumentParser, Namespace
from dataclasses import asdict, astuple, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.markup import escape

from rosette_ros.cli.arguments import UsageError, add_formats, add_run
from rosette_ros.cli.console import console, pairs, print_json, print_parts
from rosette_ros.core.errors import InvalidData, RosetteError
from rosette_ros.core.records import Run
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_repair import repair_log
from rosette_ros.io.log_run import RESUMES_KEY, LogRun
from rosette_ros.io.messages import Phase, phase_name
from rosette_ros.io.open_run import is_log, open_run
from rosette_ros.io.run_assembly import RunAnswers
from rosette_ros.presentation.formatting import duration, fixed, millimetres, pauses, repeatability_words
from rosette_ros.presentation.table_format import Table, column, words

SCHEMA = 'rosette-info/1'


@dataclass(frozen=True)
class PhaseFacts:
    """How much of a phase was measured: targets asked for (of the run all n²), those with an answer that counts."""

    asked: int
    answered: int


@dataclass(frozen=True)
class RunFacts:
    """One run, SI; None where the file does not hold it.

    phases: by name; ended: how the run ended; temperature_range_C: lowest and highest; pauses: where the measurement
    stood still; problem: why it cannot be evaluated, None where it can.
    """

    run_id: str
    n: int
    radius_m: float
    phases: dict[str, PhaseFacts]
    order: str | None = None
    completeness: float = 0.0
    duration_s: float | None = None
    pauses: str = ''
    temperature_range_C: tuple[float, float] | None = None
    repeatability_m: float | None = None
    repeatability_dof: float | None = None
    published_curves: int = 0
    model: str | None = None
    ended: str | None = None
    problem: str | None = None


@dataclass(frozen=True)
class TopicFacts:
    """One topic of a log."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True)
class Facts:
    """What a file holds; times of a log in ns since the epoch; resumes: the log that this one continues."""

    schema: str
    path: str
    kind: str
    files: tuple[str, ...]
    runs: tuple[RunFacts, ...]
    topics: tuple[TopicFacts, ...] = ()
    messages: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    truncated: bool = False
    problems: tuple[str, ...] = ()
    resumes: str | None = None


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_run(parser)
    add_formats(parser)
    parser.add_argument('--repair', action='store_true', help='write what can be read of a log that was cut short, or '
                        'lost its metadata.yaml, as a whole new log beside it; the old one is not touched')
    parser.add_argument('-o', '--output', metavar='DIR', help='where the repaired log goes (default: RUN_repaired)')


def run(options: Namespace) -> None:
    """Print what is in the run."""
    path = Path(options.run_path)
    if options.output and not options.repair:
        raise UsageError('-o: is for the repaired log; add --repair')
    if options.repair:
        path = repaired(path, options)
    facts = log_facts(path) if is_log(path) else table_facts(path)
    if options.json:
        print_json(asdict(facts))
    else:
        show(facts)


def repaired(path: Path, options: Namespace) -> Path:
    """Repair a log and return the path of the new one."""
    if not is_log(path):
        raise InvalidData(f'{path}: wanted a log to repair, got a ball-centre table; correct it in an editor')
    done = repair_log(path, options.output)
    if not options.json:
        out = console()
        out.print(pairs([('Problem', escape(problem)) for problem in done.problems]))
        out.print(f'[green]Repaired[/]: {done.messages} messages are in {escape(str(done.directory))}; '
                  f'{escape(str(path))} was not touched\n', soft_wrap=True)
    return done.directory


def table_facts(path: Path) -> Facts:
    """Return the Facts of a ball-centre table."""
    found = open_run(path)
    facts = RunFacts(found.run_id, found.n, found.radius, {'run': PhaseFacts(found.n**2, found.size)})
    return Facts(SCHEMA, str(path), 'table', (str(path),), (_measured(facts, found),))


def log_facts(path: Path) -> Facts:
    """Return the Facts of a log."""
    log = read_log(path)
    topics = sorted((TopicFacts(topic.name, topic.type_name, topic.messages) for topic in log.topics), key=astuple)
    runs = tuple(_logged(log, name) for name, found in log.runs.items() if found.targets)
    return Facts(SCHEMA, str(path), 'log', tuple(map(str, log.files)), runs, tuple(topics), log.messages, log.start_ns,
                 log.end_ns, log.truncated, log.problems, log.custom_data.get(RESUMES_KEY))


def _logged(log: LogRun, run_id: str) -> RunFacts:
    """Return the RunFacts of one run of a log."""
    state, first = {one.run_id: one for one in log.states}.get(run_id), log.runs[run_id].targets[0]
    published = [one for one in log.error_motions if one.run_id == run_id]
    facts = RunFacts(
        run_id, first.balls, first.radius, _phases(log.runs[run_id]),
        order=state.order if state else None, published_curves=len(published),
        model=published[-1].model_name if published else None,
        ended=f'{phase_name(state.phase).lower()}: {state.text}' if state else None)
    try:
        return _measured(facts, log.to_run(run_id))
    except RosetteError as error:
        return replace(facts, problem=str(error))


def _measured(facts: RunFacts, found: Run) -> RunFacts:
    """Return facts with those of the readings."""
    known = found.temperature[np.isfinite(found.temperature)]
    return replace(
        facts, completeness=found.completeness, duration_s=float(np.ptp(found.time)), pauses=pauses(found),
        temperature_range_C=(float(known.min()), float(known.max())) if known.size else None,
        repeatability_m=found.repeatability, repeatability_dof=found.repeatability_dof)


def _phases(found: RunAnswers) -> dict[str, PhaseFacts]:
    """Return PhaseFacts by the name of the phase."""
    planned = {Phase.RUN: max(target.balls for target in found.targets) ** 2}  # also of a run that was broken off
    return {phase.name.lower(): PhaseFacts(max(asked, planned.get(phase, 0)), answered)
            for phase, (asked, answered) in found.counts().items()}


def show(facts: Facts) -> None:
    """Print the facts for a person."""
    out = console()
    out.print(f'[bold]{facts.kind.capitalize()}[/] {escape(facts.path)}', soft_wrap=True)
    rows = []
    if facts.messages is not None:
        rows.append(('Files', escape(', '.join(Path(file).name for file in facts.files))))
        times = f', {_instant(facts.start_ns or 0)} to {_instant(facts.end_ns or 0)}' if facts.messages else ''
        rows.append(('Messages', f'{facts.messages} in {len(facts.topics)} topics{times}'))
    if facts.resumes:
        rows.append(('Continues', f'{escape(facts.resumes)}, whose ball centres are in this log too'))
    if facts.truncated:
        rows.append(('Truncated', '[red]the log ends in the middle; all complete records were read[/]'))
    rows += [('Problem', f'[red]{escape(problem)}[/]') for problem in facts.problems]
    if rows:
        out.print(pairs(rows))
    print_parts(out, [pairs(run_rows(one)) for one in facts.runs])
    print_parts(out, [Table('topics', 'Topics', (
        column('messages', 'messages', [topic.messages for topic in facts.topics], str),
        words('topic', 'topic', [topic.name for topic in facts.topics]),
        words('type', 'type', [topic.type for topic in facts.topics])))])


def run_rows(facts: RunFacts) -> list[tuple[str, str]]:
    """Return what is known of one run as (name, text) rows."""
    low, high = facts.temperature_range_C or (0.0, 0.0)
    rows = [('Run', escape(facts.run_id or 'without a name')),
            ('Plate', f'{facts.n} balls on R = {millimetres(facts.radius_m)}'),
            ('Measured', ', '.join(f'{name.replace("_", " ")} {phase.answered} of {phase.asked}'
                                   for name, phase in facts.phases.items())),
            ('Order', escape(facts.order or '')),
            ('Duration', f'{duration(facts.duration_s)} from the first ball of the run to the last'
             if facts.duration_s else ''),
            ('Pauses', facts.pauses),
            ('Temperature', f'{fixed(low, 3)} to {fixed(high, 3)} °C' if facts.temperature_range_C else ''),
            ('Repeatability', repeatability_words(facts.repeatability_m, facts.repeatability_dof)),
            ('Published', f'error motions, {facts.published_curves}×, model {escape(facts.model or "")}'
             if facts.published_curves else ''),
            ('Ended', escape(facts.ended or '')),
            ('Problem', f'[red]{escape(facts.problem)}[/]' if facts.problem else '')]
    return [(name, text) for name, text in rows if text]


def _instant(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns * 1e-9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
