# SPDX-License-Identifier: Apache-2.0
"""rosette diagnose: which physical effect the model lacks, how sure that is, and what the run cannot show."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape

from rosette_ros.analysis import MOST_BALLS_ADVISED, advise_run, cross_check, diagnose
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, head, pairs, print_json, print_parts
from rosette_ros.cli.verdict_card import print_card
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.error_summary import doubt_of, fit_lines
from rosette_ros.core.planning.visibility import Visibility, visibility
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation import tables
from rosette_ros.presentation.error_results import errors
from rosette_ros.presentation.explanation_results import explanations
from rosette_ros.presentation.json_output import diagnosis_json
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.result_words import check_words

NEXT_BEST = 4
"""So many explanations, and effects that are not identified, are shown."""
CANDIDATE_COLUMNS = (
    'effect', 'probability', 'p', 'visible_fraction', 'rms_after_um', 'held_out_rms_after_um',
    'look_alikes')


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--model')
    parser.add_argument('--check', metavar='RUN_B', help='another run of the same cell: are the effects that are '
                        'identified in RUN confirmed there?')
    add_shared(parser, '--json')


def run(options: Namespace) -> None:
    """Print the diagnosis."""
    measured, model = open_run(options.run_path), read_model(options.model)
    other = open_run(options.check) if options.check else None
    diagnosis = diagnose(measured, model)
    check, invisible = None if other is None else cross_check(other, diagnosis), invisible_effects(diagnosis)
    if options.json:
        print_json(diagnosis_json(diagnosis, invisible, check))
        return
    out = console()
    out.print(head(measured))
    print_card(out, diagnosis.verdict, options.run_path, options.model)
    show(out, diagnosis, invisible)
    if check is not None:
        colour = {True: 'green', False: 'red', None: 'yellow'}[check.confirmed]
        out.print(f'\n[bold]Checked on {escape(check.before.run.run_id or check.before.run.source)}[/], which had no '
                  f'part in the search\n[{colour}]{escape(check_words(check))}[/]')
        print_parts(out, [tables.cross_check(check)])


def invisible_effects(diagnosis: Diagnosis) -> tuple[Visibility, ...]:
    """Return the Visibility of every effect that the run could not have shown."""
    final, names = diagnosis.final, diagnosis.invisible
    return visibility(final.run, final.sigma, final.model.base, names=names) if names else ()


def show(out: Console, diagnosis: Diagnosis, invisible: Sequence[Visibility]) -> None:
    """Print what is behind the verdict; invisible: of the effects that the run could not have shown."""
    refused, measured = '; '.join(f'{name}: {reason}' for name, reason in diagnosis.unavailable), diagnosis.fit.run
    advice = advice_words(advise_run(measured)) if invisible and measured.n <= MOST_BALLS_ADVISED else ''
    notes = [(title, escape(text)) for title, text in (('Not judged', refused), ('Next order', advice)) if text]
    claimed = [one for one in diagnosis.candidates if one.claimed]
    others = [one for one in diagnosis.candidates if not one.claimed][:NEXT_BEST]
    found = diagnosis.with_cause
    print_parts(out, [
        errors(fit_lines(diagnosis.fit, doubt=doubt_of(diagnosis.verdict)), found=fit_lines(found) if found else ()),
        tables.effects([(one.effect, one.setting, one.parameters) for one in claimed],
                       'Parameters of the missing effects, all fitted together'),
        explanations(diagnosis).first(NEXT_BEST),
        tables.candidates(others, measured, 'The next best').select(*CANDIDATE_COLUMNS),
        tables.bias(invisible, measured.rotation), pairs(notes) if notes else None])
