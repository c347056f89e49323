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

from rosette_ros import command
from rosette_ros.analysis import (
    MOST_BALLS_ADVISED,
    MOST_BALLS_JUDGED,
    advise_run,
    compare,
    cross_check,
    diagnose,
    judge,
    ladder,
)
from rosette_ros.cli.arguments import add_formats, add_shared, picture_file, plots, positive
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
from rosette_ros.cli.opened import Opened, add_joint, is_joint, joint_result
from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.verdict import Outcome, Verdict
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.run_to_run import joint_spheres
from rosette_ros.core.run.number_words import micrometres
from rosette_ros.core.sight.visibility import Visibility, visibility
from rosette_ros.core.uncertainty.error_summary import ONE_SENSE, doubt_of, fit_lines, four_axis_errors
from rosette_ros.core.uncertainty.uncertainty_budget import stated_lines
from rosette_ros.io.open_run import joint_identity, open_run
from rosette_ros.io.text_file import refuse_output
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.presentation import joint_results as results
from rosette_ros.presentation import tables
from rosette_ros.presentation.budget_results import environment_json, environment_words, hidden_table
from rosette_ros.presentation.error_results import errors, four_axis_json, four_axis_table
from rosette_ros.presentation.explanation_results import causes, explanations
from rosette_ros.presentation.formatting import FOUND, NOW, uncertainty_words
from rosette_ros.presentation.json_output import comparison_json, diagnosis_json, evaluation_json
from rosette_ros.presentation.tables import curves, deviations, fitted_effects
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table, spheres_json
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.effect_words import capital
from rosette_ros.words.joint_words import note_words
from rosette_ros.words.reading_words import readings_notes, remark_words
from rosette_ros.words.result_words import DOES_NOT_FIT, check_words, comparison_words, conclusion_text
from rosette_ros.words.verdict_words import HEADLINES, NOTHING_TO_DO, titles, verdict_text

NEXT_BEST = 4
"""So many explanations, and effects that are not identified, are shown."""
CANDIDATE_COLUMNS = ('effect', 'probability', 'p', 'visible_fraction', 'rms_after_um', 'look_alikes')
WIDEST_MAP = 40
"""Most balls for which the map of the readings fits on a screen."""
LOW, HIGH = 2.0, 3.0
"""Residual of a reading in σ from which it is shown as a digit, and in red."""
NEW_MODEL = 'model.yaml'
"""Model file of a command where the run was judged without one."""


def evaluate_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='+')
    add_shared(parser, '--run-id', '--columns', '--model')
    add_joint(parser)
    add_shared(parser, '--identity', '--refit-spheres', '--inputs', '--environment', '--angle-unit')
    parser.add_argument('--test-spheres', metavar=('R_MM', 'HEIGHT_MM'), nargs=2, type=positive('mm'), help='also the '
                        'four-axis errors (ISO 10360-3) of two opposite test spheres at this radius, one in the plane '
                        'of the balls, one so far above it, calculated from the error motions')
    add_formats(parser, csv='print the six curves as a table with standard uncertainties')


def run_evaluate(options: Namespace) -> None:
    """Print the evaluation."""
    if is_joint(options):
        evaluate_runs_jointly(options)
        return
    opened, refit = Opened(options, options.run_path[0]), None
    if options.refit_spheres:
        opened.run, refit = open_refitted(opened.path, options.run_id)
    fit, tolerances = opened.fit, opened.identity.limits(opened.run.rotation)
    if options.csv or opened.verdict is None:
        warn(fit.run)
    made = opened.budget_of(fit)
    motions, lines = stated_lines(fit, made, tolerances, doubt_of(opened.verdict))
    if options.csv:
        sys.stdout.write(curves(motions).csv())
        return
    final = opened.finding.with_cause if opened.finding else None
    best = opened.budget_of(final) if final else None
    found, found_lines = stated_lines(final, best) if final else (None, ())
    where = [1e-3 * one for one in options.test_spheres or ()]
    spheres = [('rotary table', four_axis_errors([found or motions], *where), ONE_SENSE)] if where else []
    if options.json:
        more = ({'spheres': spheres_json(refit)} if refit else {}) | four_axis_json(spheres)
        print_json({**evaluation_json(fit, opened.verdict, lines, final, made, best), **environment_json(best or made),
                    **more})
        return
    out = console()
    out.print(head(fit.run))
    if opened.verdict:
        print_card(out, opened.verdict, options.run_path[0], options.model)
    else:
        out.print(f'Plates of more than {MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN')
    told = best or made
    print_parts(out, [
        errors(lines, found=found_lines), *four_axis_table(spheres, f', {FOUND}' * bool(found)),
        curves(motions, NOW if found else ''),
        *([curves(found, FOUND)] if found else []), hidden_table(told) if told else None, deviations(fit),
        fitted_effects(fit, 'Effects in the model'),
        pairs([*fit_rows(fit), *([('Environment', environment_words(told.inputs.environment))] if told else [])])])
    if refit:
        print_parts(out, [sphere_table(refit), pairs(sphere_rows(refit))])


def evaluate_runs_jointly(options: Namespace) -> None:
    """Print the joint evaluation of all runs."""
    result = joint_result(options)
    identity = joint_identity(options.run_path, options.run_id, options.identity)[0]
    tolerances = identity.limits(result.solution.model.runs[0].rotation)
    spheres = joint_spheres(result, *(1e-3 * one for one in options.test_spheres)) if options.test_spheres else []
    if options.json:
        print_json({**results.joint_json(result, tolerances), **four_axis_json(spheres)})
    elif options.csv:
        sys.stdout.write(results.joint_csv(result))
    else:
        out = console()
        for one in result.solution.model.runs:
            out.print(escape('\n'.join((results.joint_head(one), *readings_notes(one)))))
        for note in result.notes:
            out.print(escape(note_words(note)), soft_wrap=True)
        print_verdict(out, conclusion_text(conclude(result)))
        print_parts(out, [*results.joint_errors(result, tolerances), *four_axis_table(spheres),
                          results.sharing_table(result),
                          *results.joint_curves(result),
                          pairs((name, escape(words)) for name, words in results.joint_rows(result))])


def diagnose_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--columns', '--model', '--angle-unit')
    parser.add_argument('--check', metavar='RUN_B', help='another run of the same cell: are the effects that are '
                        'identified in RUN confirmed there?')
    add_shared(parser, '--json')


def run_diagnose(options: Namespace) -> None:
    """Print the diagnosis."""
    opened, other = Opened(options), open_run(options.check) if options.check else None
    with doing('diagnosing'):
        diagnosis = diagnose(opened.run, opened.model)
    check, invisible = None if other is None else cross_check(other, diagnosis), invisible_effects(diagnosis)
    if options.json:
        print_json(diagnosis_json(diagnosis, invisible, check))
        return
    out = console()
    out.print(head(opened.run))
    print_card(out, diagnosis.verdict, options.run_path, options.model)
    show_diagnosis(out, diagnosis, invisible)
    if check is not None:
        colour = {True: 'green', False: 'red', None: 'yellow'}[check.confirmed]
        out.print(f'\n[bold]Checked on {escape(check.before.run.run_id or check.before.run.source)}[/], which had no '
                  f'part in the search\n[{colour}]{escape(check_words(check))}[/]')
        print_parts(out, [tables.cross_check(check)])


def invisible_effects(diagnosis: Diagnosis) -> tuple[Visibility, ...]:
    """Return the Visibility of every effect that the run could not have shown."""
    final, names = diagnosis.final, diagnosis.invisible
    return visibility(final.run, final.sigma, final.model.base, names=names) if names else ()


def show_diagnosis(out: Console, diagnosis: Diagnosis, invisible: Sequence[Visibility]) -> None:
    """Print what is behind the verdict; invisible: of the effects that the run could not have shown."""
    measured, reasons = diagnosis.fit.run, dict.fromkeys(reason for _, reason in diagnosis.unavailable)
    refused = '; '.join(f'{reason}: {titles(name for name, other in diagnosis.unavailable if other == reason)}'
                        for reason in reasons)
    advice = advice_words(advise_run(measured)) if invisible and measured.n <= MOST_BALLS_ADVISED else ''
    notes = [(title, escape(text)) for title, text in (('Not judged', refused), ('Next order', advice)) if text]
    claimed = [one for one in diagnosis.candidates if one.claimed]
    others = [one for one in diagnosis.candidates if not one.claimed][:NEXT_BEST]
    found = diagnosis.with_cause
    print_parts(out, [
        errors(fit_lines(diagnosis.fit, doubt=doubt_of(diagnosis.verdict)), found=fit_lines(found) if found else ()),
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
    comparison, verdict = compare(opened.run, opened.model), judge(opened.run, opened.model)
    steps = ladder(opened.run, opened.model) if options.ladder else ()
    if options.noise_picture:
        plots('plot_style').save(plots('residual_plots').noise(diagnose(opened.run, opened.model).final),
                                 options.noise_picture, options.force)
    if options.json:
        print_json(comparison_json(comparison, verdict, steps))
        return
    out = console()
    out.print(head(opened.run))
    show_comparison(out, comparison, verdict)
    print_parts(out, [tables.nested_models(steps)])
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
    if verdict.missing:
        print_parts(out, [causes(verdict)])
        out.print()
    for sentence in (*text.limits, *([text.action] if text.action != NOTHING_TO_DO else [])):
        say(out, sentence)
    for what in _commands(verdict):
        line = command('add', *what, '--model', model or NEW_MODEL, '--run', run_path)
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
