# SPDX-License-Identifier: Apache-2.0
"""rosette info: what is in a run, a log or a table, without evaluating it."""

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.markup import escape

from rosette_ros.cli.arguments import add_formats, add_run
from rosette_ros.cli.main import UsageError
from rosette_ros.cli.screen import console, pairs, print_json, table
from rosette_ros.core.errors import InvalidData, RosetteError
from rosette_ros.data.assemble import Phase, pair
from rosette_ros.data.log_reader import RESUMES_KEY, read_log
from rosette_ros.data.open_run import is_log, open_run
from rosette_ros.data.repair import repair_log
from rosette_ros.nodes.programme import phase_name
from rosette_ros.words import duration, exact, fixed, pauses


@dataclass(frozen=True)
class PhaseFacts:
    """How much of a phase was measured: targets asked for (of the run all n²), those with an answer that counts."""

    asked: int
    answered: int


@dataclass(frozen=True)
class RunFacts:
    """One run, SI; None where the file does not tell.

    phases: PhaseFacts by name; ended: how the run ended, in words; temperature_range_C: lowest and
    highest; pauses: where the measurement stood still, in words; problem: why it cannot be evaluated,
    None where it can.
    """

    run_id: str
    order: str | None
    n: int
    radius_m: float
    phases: dict
    completeness: float
    duration_s: float | None
    pauses: str
    temperature_range_C: tuple | None
    repeatability_m: float | None
    repeatability_dof: float | None
    published_curves: int
    model: str | None
    ended: str | None
    problem: str | None


@dataclass(frozen=True)
class TopicFacts:
    """One topic of a log."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True)
class Facts:
    """What a file holds; times of a log in ns since the epoch; resumes: the log that it goes on from."""

    schema: str
    path: str
    kind: str
    files: tuple
    runs: tuple
    topics: tuple
    messages: int | None
    start_ns: int | None
    end_ns: int | None
    truncated: bool
    problems: tuple
    resumes: str | None = None


def add_arguments(parser):
    """Declare what the verb takes."""
    add_run(parser)
    add_formats(parser)
    parser.add_argument('--repair', action='store_true',
                        help='write what can be read of a log that was cut short, or lost its '
                        'metadata.yaml, as a whole new log beside it; the old one is not touched')
    parser.add_argument('-o', '--output', metavar='DIR',
                        help='where the repaired log goes (default: RUN_repaired)')


def run(options):
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


def repaired(path, options):
    """Repair a log and return the path of the new one, of which the facts are told."""
    if not is_log(path):
        raise InvalidData(f'{path}: wanted a log to repair, got a ball-centre table; mend it in an '
                          'editor')
    done = repair_log(path, options.output)
    if not options.json:
        out = console()
        out.print(pairs([('Problem', escape(problem)) for problem in done.problems]))
        out.print(f'[green]Repaired[/]: {done.messages} messages are in {escape(str(done.directory))}; '
                  f'{escape(str(path))} was not touched\n', soft_wrap=True)
    return done.directory


def table_facts(path):
    """Return the Facts of a ball-centre table."""
    run = open_run(path)
    phases = {'run': PhaseFacts(run.n**2, run.size)}
    return Facts(
        'rosette-info/1', str(path), 'table', (str(path),),
        (_run_facts(run, run.run_id, None, phases, 0, None, None),), (), None, None, None,
        False, ())


def log_facts(path):
    """Return the Facts of a log."""
    log = read_log(path)
    topics = tuple(TopicFacts(topic.name, topic.type_name, topic.messages)
                   for topic in sorted(log.topics, key=lambda topic: topic.name))
    names = dict.fromkeys(log.targets.run_id[row] for row in range(len(log.targets)))
    return Facts(
        'rosette-info/1', str(path), 'log', tuple(str(file) for file in log.files),
        tuple(_logged_run(log, run_id) for run_id in names), topics, log.messages, log.start_ns,
        log.end_ns, log.truncated, tuple(log.problems), log.custom_data.get(RESUMES_KEY))


def _logged_run(log, run_id):
    """Return the RunFacts of one run of a log."""
    states = {state.run_id: state for state in log.states}
    state = states.get(run_id)
    order = state.order if state else None
    ended = f'{phase_name(state.phase).lower()}: {state.text}' if state else None
    published = [one for one in log.error_motions if one.run_id == run_id]
    model = published[-1].model_name if published else None
    phases = _phases(log, run_id)
    try:
        run = log.to_run(run_id)
    except RosetteError as error:
        row = int(np.flatnonzero(log.targets.run_id.equal(run_id))[0])
        return RunFacts(run_id, order, int(log.targets.balls[row]), float(log.targets.radius[row]),
                        phases, 0.0, None, '', None, None, None, len(published), model, ended,
                        str(error))
    return _run_facts(run, run_id, order, phases, len(published), model, ended)


def _run_facts(run, run_id, order, phases, published, model, ended):
    known = run.temperature[np.isfinite(run.temperature)]
    temperature = (float(known.min()), float(known.max())) if known.size else None
    return RunFacts(
        run_id, order, run.n, run.radius, phases, run.completeness, float(np.ptp(run.time)),
        pauses(run), temperature, run.repeatability, run.repeatability_dof, published, model, ended, None)


def _phases(log, run_id):
    """Return PhaseFacts by the name of the phase."""
    own = log.targets.run_id.equal(run_id)
    answered = log.targets.phase[pair(log.targets, log.answers, run_id).target]
    planned = {Phase.RUN: int(log.targets.balls[own].max()) ** 2}  # also of a run that was broken off
    return {phase.name.lower(): PhaseFacts(
        max(int(np.unique(log.targets.seq[own & (log.targets.phase == phase)]).size), planned.get(phase, 0)),
        int(np.count_nonzero(answered == phase)))
        for phase in Phase if np.any(own & (log.targets.phase == phase))}


def show(facts):
    """Print the facts for a person."""
    out = console()
    out.print(f'[bold]{facts.kind.capitalize()}[/] {escape(facts.path)}', soft_wrap=True)
    rows = []
    if facts.messages is not None:
        rows.append(('Files', escape(', '.join(Path(file).name for file in facts.files))))
        times = f', {_instant(facts.start_ns)} to {_instant(facts.end_ns)}' * bool(facts.messages)
        rows.append(('Messages', f'{facts.messages} in {len(facts.topics)} topics{times}'))
    if facts.resumes:
        rows.append(('Goes on from', f'{escape(facts.resumes)}, whose ball centres are in this log too'))
    if facts.truncated:
        rows.append(('Cut short', '[red]the log ends in the middle; what is whole was read[/]'))
    rows += [('Problem', f'[red]{escape(problem)}[/]') for problem in facts.problems]
    if rows:
        out.print(pairs(rows))
    for one in facts.runs:
        out.print()
        out.print(pairs(run_rows(one)))
    if facts.topics:
        listing = table('messages', title='Topics')
        for name in ('topic', 'type'):
            listing.add_column(name, justify='left', overflow='fold')
        for topic in facts.topics:
            listing.add_row(str(topic.messages), escape(topic.name), escape(topic.type))
        out.print()
        out.print(listing)


def run_rows(run):
    """Return what is known of one run as (name, text) rows."""
    rows = [('Run', escape(run.run_id or 'without a name')),
            ('Plate', f'{run.n} balls on R = {exact(1e3 * run.radius_m, 6)} mm'),
            ('Measured', ', '.join(f'{name.replace("_", " ")} {phase.answered} of {phase.asked}'
                                   for name, phase in run.phases.items()))]
    if run.order:
        rows.append(('Order', escape(run.order)))
    if run.duration_s:
        rows.append(('Duration', f'{duration(run.duration_s)} from the first ball of the run to '
                                 'the last'))
    if run.pauses:
        rows.append(('Pauses', run.pauses))
    if run.temperature_range_C:
        low, high = run.temperature_range_C
        rows.append(('Temperature', f'{low:.3f} to {high:.3f} °C'))
    rows.append(('Repeatability', repeatability_words(run)))
    if run.published_curves:
        rows.append(('Published', f'error motions, {run.published_curves}×, model '
                                  f'{escape(run.model)}'))
    if run.ended:
        rows.append(('Ended', escape(run.ended)))
    if run.problem:
        rows.append(('Problem', f'[red]{escape(run.problem)}[/]'))
    return rows


def repeatability_words(run):
    """Return the repeatability in words."""
    if run.repeatability_m is None:
        return 'not known'
    dof = '' if run.repeatability_dof is None else (
        f', {run.repeatability_dof:g} degrees of freedom')
    return f'{fixed(1e6 * run.repeatability_m, 4)} µm per coordinate{dof}'


def _instant(stamp_ns):
    return datetime.fromtimestamp(stamp_ns * 1e-9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
