# SPDX-License-Identifier: Apache-2.0
"""What a run says: its error motions, which effect is missing, where a model fails."""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from rosette_ros.analysis import (
    MOST_BALLS_ADVISED,
    MOST_BALLS_JUDGED,
    RunResult,
    advise_run,
    diagnose,
)
from rosette_ros.api import evaluating
from rosette_ros.api.cells import diagnosed_cell
from rosette_ros.api.evaluating import Evaluation, JointEvaluation, evaluated
from rosette_ros.api.measurement import model_of, read
from rosette_ros.cli.arguments import UsageError, add_formats, add_shared, picture_file, plots, positive
from rosette_ros.cli.console import (
    COLOURS,
    console,
    doing,
    fit_rows,
    head,
    pairs,
    print_json,
    print_parts,
    print_verdict,
    say,
    warn,
)
from rosette_ros.cli.opened import Opened, add_archived, add_joint, every_run, is_joint, joint, take_archived
from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.verdict import Outcome, Verdict
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.planning.next_readings import BLOCK
from rosette_ros.core.run.errors import visible
from rosette_ros.core.run.number_words import micrometres
from rosette_ros.core.sight.visibility import Visibility
from rosette_ros.invocation import command
from rosette_ros.io.text_file import refuse_output
from rosette_ros.presentation import joint_results as results
from rosette_ros.presentation import tables
from rosette_ros.presentation.budget_results import environment_words, hidden_table
from rosette_ros.presentation.error_results import errors_of, four_axis_table
from rosette_ros.presentation.explanation_results import causes, explanations
from rosette_ros.presentation.formatting import uncertainty_words
from rosette_ros.presentation.tables import deviations, fitted_effects
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.effect_words import capital
from rosette_ros.words.joint_words import note_words
from rosette_ros.words.motion_words import titles
from rosette_ros.words.reading_words import readings_notes, remark_words
from rosette_ros.words.result_words import DOES_NOT_FIT, check_words, comparison_words, conclusion_text
from rosette_ros.words.verdict_words import HEADLINES, NOTHING_TO_DO, verdict_text

NEXT_BEST = 4
"""So many explanations, and effects that are not identified, are shown."""
CANDIDATE_COLUMNS = ('effect', 'probability', 'p', 'visible_fraction', 'rms_after_um', 'look_alikes')
WIDEST_MAP = 40
"""Most balls for which the map of the readings fits on a screen."""
LOW, HIGH = 2.0, 3.0
"""Residual of a reading in σ from which it is shown as a digit, and in red."""
ON_REQUEST = f'Plates of more than {MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN'
LACKS = 3
"""Exit code of `evaluate --check` where a run lacks something."""
NEW_MODEL = 'model.yaml'
"""Model file of a command where the run was judged without one."""


def evaluate_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='*')
    add_archived(parser)
    add_shared(parser, '--run-id', '--columns', '--model')
    add_joint(parser)
    add_shared(parser, '--identity', '--refit-spheres', '--inputs', '--environment', '--experience', '--any-cell',
               '--angle-unit')
    parser.add_argument('--test-spheres', metavar=('R_MM', 'HEIGHT_MM'), nargs=2, type=positive('mm'), help='also the '
                        'four-axis errors (ISO 10360-3) of two opposite test spheres at this radius, one in the plane '
                        'of the balls, one so far above it, calculated from the error motions')
    parser.add_argument('--xlsx', metavar='FILE', help='write verdict and tables as a workbook for Excel, too')
    parser.add_argument('--dfq', metavar='FILE', help='write ranges, U and tolerances as Q-DAS K-fields (AQDEF) for '
                        'statistical process control, too')
    parser.add_argument('--qif', metavar='FILE', help='write them as a QIF 3.0 document, too')
    add_shared(parser, '--force')
    parser.add_argument('--check', action='store_true', help=f'end with exit code {LACKS} where the model lacks '
                        'something, or where that was not judged')
    add_formats(parser, csv='print the six curves as a table with standard uncertainties; verdict, model and ranges '
                'with U in lines that begin with #')


def run_evaluate(options: Namespace) -> int:
    """Print the evaluation; return LACKS where --check is given and the model lacks something, else 0."""
    where = [1e-3 * one for one in options.test_spheres or ()]
    for path in filter(None, (options.xlsx, options.dfq, options.qif)):
        refuse_output(path, options.force)
    take_archived(options)
    if is_joint(options):
        for name in ('dfq', 'qif'):
            if getattr(options, name):
                raise UsageError(f'--{name}: expected one run, found several as one; leave it out')
        every = joint(options, where)
        if options.xlsx:
            every.save_workbook(options.xlsx, options.force)
        show_joint(options, every)
        conclusion = conclude(every.result)
        return _checked(options, conclusion.model_fails, conclusion_text(conclusion).sentence)
    made = evaluated(Opened(options, options.run_path[0]), options.refit_spheres, where)
    if options.xlsx:
        made.save_workbook(options.xlsx, options.force)
    for path in filter(None, (options.dfq, options.qif)):
        made.save_spc(path, options.force)
    if options.csv or made.verdict is None:
        warn(made.fit.run)
    if options.csv:
        sys.stdout.write(tables.curves_csv(made.result, made.tolerances))
    elif options.json:
        print_json(made.to_mapping())
    else:
        show_evaluation(made, options)
    if made.verdict is None:
        return _checked(options, options.check, ON_REQUEST)
    return _checked(options, made.verdict.model_fails, verdict_text(made.verdict).sentence)


def _checked(options: Namespace, lacks: bool, words: str) -> int:
    """Say on stderr that something is missing, where stdout is no terminal; return the exit code."""
    if lacks and not sys.stdout.isatty():
        print(visible(f'rosette: {words}'), file=sys.stderr)
    return LACKS if lacks and options.check else 0


def show_evaluation(made: Evaluation, options: Namespace) -> None:
    """Print the evaluation of a run for a person."""
    out, fit, result = console(), made.fit, made.result
    (whole, *whole_beside), (curves, *curves_beside) = (errors_of(result, made.tolerances), tables.curves_of(result))
    told, which = result.curves.budget, result.modelled.which if result.beside else ''
    out.print(head(fit.run))
    if made.verdict:
        print_card(out, made.verdict, options.run_path[0], options.model)
    else:
        out.print(ON_REQUEST)
    print_parts(out, [
        whole, *four_axis_table(made.spheres, f', {result.curves.which}' * bool(which)), curves,
        hidden_table(told) if told else None, *whole_beside, *curves_beside,
        deviations(fit, which), fitted_effects(fit, 'Effects in the model'),
        pairs([*([('Fit', which)] if which else []), *fit_rows(fit),
               *([('Environment', environment_words(told.inputs.environment))] if told else [])])])
    if made.refit:
        print_parts(out, [sphere_table(made.refit), pairs(sphere_rows(made.refit))])


def show_joint(options: Namespace, made: JointEvaluation) -> None:
    """Print the joint evaluation of all runs."""
    result = made.result
    if options.json:
        print_json(made.to_mapping())
    elif options.csv:
        sys.stdout.write(results.joint_csv(result, made.tolerances))
    else:
        out = console()
        for one in result.solution.model.runs:
            out.print(escape('\n'.join((results.joint_head(one), *readings_notes(one)))))
        for note in result.notes:
            out.print(escape(note_words(note)), soft_wrap=True)
        print_verdict(out, conclusion_text(conclude(result)))
        print_parts(out, [*results.joint_errors(result, made.tolerances), *four_axis_table(made.spheres),
                          results.sharing_table(result), *results.joint_effects(result),
                          *results.joint_curves(result),
                          pairs((name, escape(words)) for name, words in results.joint_rows(result))])


def diagnose_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='*', help='log directory, .mcap file or ball-centre table (CSV); several runs '
               'of one cell are diagnosed together')
    add_archived(parser)
    add_shared(parser, '--columns', '--model', '--experience', '--any-cell', '--angle-unit')
    parser.add_argument('--check', metavar='RUN_B', help='another run of the same cell: are the effects that are '
                        'identified in RUN confirmed there?')
    add_shared(parser, '--json')


def run_diagnose(options: Namespace) -> None:
    """Print the diagnosis."""
    take_archived(options)
    if len(options.run_path) > 1:
        show_cell(options)
        return
    path, = options.run_path
    opened, other = Opened(options, path), read(options.check, options.columns) if options.check else None
    with doing('diagnosing'):
        found = evaluating.diagnose(opened.measured, opened.model, other)
    if options.json:
        print_json(found.to_mapping())
        return
    out, check = console(), found.check
    out.print(head(opened.run))
    print_card(out, found.verdict, path, options.model)
    show_diagnosis(out, found.diagnosis, found.invisible)
    if check is not None:
        colour = {True: 'green', False: 'red', None: 'yellow'}[check.confirmed]
        out.print(f'\n[bold]Checked on {escape(check.before.run.run_id or check.before.run.source)}[/], which had no '
                  f'part in the search\n[{colour}]{escape(check_words(check))}[/]')
        print_parts(out, [tables.cross_check(check)])


def show_cell(options: Namespace) -> None:
    """Print what several runs say of their cell."""
    for name in ('check', 'experience'):
        if vars(options)[name]:
            raise UsageError(f'diagnose: expected one RUN with --{name}, found several, which say it together; leave '
                             'one of both out')
    every = every_run(options)
    with doing('diagnosing', len(every)) as step:
        found = diagnosed_cell(every, model_of(options.model), step)
    if options.json:
        print_json(found.to_mapping())
        return
    out = console()
    colour = COLOURS[found.level]
    for place, sentence in enumerate(found.sentences()):
        say(out, sentence, None if place else colour)
    print_parts(out, found.tables())


def show_diagnosis(out: Console, diagnosis: Diagnosis, invisible: Sequence[Visibility]) -> None:
    """Print what is behind the verdict; invisible: of the effects that the run could not have shown."""
    measured, reasons = diagnosis.fit.run, dict.fromkeys(reason for _, reason in diagnosis.unavailable)
    refused = '; '.join(f'{reason}: {titles(name for name, other in diagnosis.unavailable if other == reason)}'
                        for reason in reasons)
    advice = advice_words(advise_run(measured)) if invisible and measured.n <= MOST_BALLS_ADVISED else ''
    notes = [(title, escape(text)) for title, text in (('Not judged', refused), ('Next order', advice)) if text]
    claimed = [one for one in diagnosis.candidates if one.claimed]
    others = [one for one in diagnosis.candidates if not one.claimed][:NEXT_BEST]
    print_parts(out, [
        *errors_of(RunResult(diagnosis.fit, diagnosis)),
        tables.effects([(one.name, one.setting, one.parameters) for one in claimed],
                       'Parameters of the missing effects, all fitted together', measured.time_unit),
        explanations(diagnosis).first(NEXT_BEST),
        tables.candidates(others, measured, 'The next best').select(*CANDIDATE_COLUMNS),
        tables.bias(invisible, measured.rotation), pairs(notes) if notes else None])


def compare_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--columns', '--model', '--angle-unit')
    parser.add_argument('--ladder', action='store_true',
                        help='the residual of nested models: from the base model on, effect by effect')
    parser.add_argument('--noise-picture', metavar='FILE', type=picture_file,
                        help='write the picture of the noise that the report has: quantiles, scatter by axis, ball, '
                        'CMM position and time, correlation of neighbours (.png, .svg or .pdf)')
    add_shared(parser, '--force', '--json')


def run_compare(options: Namespace) -> None:
    """Print the comparison."""
    if options.noise_picture:
        refuse_output(options.noise_picture, options.force)
    opened = Opened(options)
    made = evaluating.compare(opened.measured, opened.model, options.ladder)
    comparison, verdict = made.comparison, made.verdict
    if options.noise_picture:
        plots('plot_style').save(plots('residual_plots').noise(diagnose(opened.run, opened.model).final),
                                 options.noise_picture, options.force)
    if options.json:
        print_json(made.to_mapping())
        return
    out = console()
    out.print(head(opened.run))
    show_comparison(out, comparison, verdict)
    print_parts(out, [tables.nested_models(made.steps)])
    if verdict.missing or verdict.unnamed:
        model = ('--model', options.model) if options.model else ()
        out.print(f'\nWhat is missing:\n  {escape(command("diagnose", options.run_path, *model))}', soft_wrap=True)
    if options.noise_picture:
        out.print(f'\nPicture of the noise: {escape(str(options.noise_picture))}')


def show_comparison(out: Console, comparison: Comparison, verdict: Verdict) -> None:
    """Print whether the model fits, and where it does not."""
    sigma, source = tables.noise_of(comparison.fit)
    if verdict.missing or verdict.unnamed:
        say(out, DOES_NOT_FIT, COLOURS[verdict.level])
        for remark in comparison.fit.run.remarks:
            say(out, f'{capital(remark_words(remark))}.')
    else:
        print_verdict(out, verdict_text(verdict))
    say(out, f'{comparison_words(comparison)} Residuals are given in σ = {micrometres(sigma)}, {source}; '
        f'uncertainties of the curves follow {uncertainty_words(comparison.fit)}.')
    print_parts(out, [tables.axes(comparison), tables.places(comparison), reading_map(comparison, sigma),
                      tables.worst_readings(comparison)])


def reading_map(comparison: Comparison, sigma: float) -> Text | None:
    """Return the map of all readings, rows table positions, columns balls; None where it is too wide."""
    run = comparison.fit.run
    if run.n > WIDEST_MAP:
        return None
    grid = np.full((run.n, run.n), np.nan)
    np.fmax.at(grid, (run.table_position - 1, run.ball - 1), comparison.sizes / sigma)
    text = Text('Residual of every reading in σ', style='bold')
    text.append(f' (· below {LOW:g}, digits up to 9; blank: not measured)\n', style='default')
    text.append(f'table\\ball {" ".join(str(ball % 10) for ball in range(1, run.n + 1))}', style='dim')
    for position, line in enumerate(grid, 1):
        text.append(f'\n{position:>10} ', style='dim')
        for size in line:
            text.append(*_mark(size))
    return text


def _mark(size: float) -> tuple[str, str]:
    if np.isnan(size):
        return '  ', 'default'
    return ('· ', 'dim') if size < LOW else (f'{min(int(size), 9)} ', 'red' if size >= HIGH else 'yellow')


def print_card(out: Console, verdict: Verdict, run_path: Path | str, model: Path | str | None = None) -> None:
    """Print the card of a verdict on a run; model: the file of the model that was judged, None for the base model."""
    text = verdict_text(verdict)
    has_headline = verdict.outcome != Outcome.FITS  # whose sentence says it
    if has_headline:
        out.print(f'[bold {COLOURS[verdict.level]}]{HEADLINES[verdict.outcome]}[/]')
    say(out, text.sentence, None if has_headline else COLOURS[verdict.level])
    if verdict.missing or verdict.unnamed:
        print_parts(out, [causes(verdict)])
        out.print()
    for sentence in (*text.limits, *([text.action] if text.action != NOTHING_TO_DO else [])):
        say(out, sentence)
    for what in _commands(verdict):
        line = command('add', *what, '--model', model or NEW_MODEL, '--run', run_path)
        out.print(f'  {escape(line)}', soft_wrap=True)
    if verdict.is_open:
        line = command('advise', run_path, '--readings', str(BLOCK), *(['--model', model] if model else []))
        out.print(f'  {escape(line)}', soft_wrap=True)


def _commands(verdict: Verdict) -> Iterator[list[str]]:
    """Yield what to add: all causes together, then each motion without a name."""
    if verdict.missing:
        yield [one.name for one in verdict.missing]
    for one in verdict.unnamed:
        yield [FREE.name, *(word for name, value in one.setting.items() for word in ('--set', f'{name}={value}'))]


IMPLEMENTED = {
    'evaluate': (evaluate_arguments, run_evaluate), 'diagnose': (diagnose_arguments, run_diagnose),
    'compare': (compare_arguments, run_compare)}
