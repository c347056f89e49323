# SPDX-License-Identifier: Apache-2.0
"""The effects of the library, and the model file to which they are added and from which they are removed."""

import argparse
import contextlib
import math
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape

from rosette_ros.analysis import MOST_BALLS_JUDGED, Change, analyse, change, judge
from rosette_ros.api.effect_library import amplitudes, effects
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, head, pairs, print_json, print_parts, print_table
from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.effects.composed import COMPOSED, effect
from rosette_ros.core.effects.custom import AMPLITUDE, DIRECTIONS, FUNCTIONS, NAMES, PER
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.model.model import BASE_TERMS, NOISE_TERMS, Model, Term
from rosette_ros.core.run.errors import InvalidModel, NotDeterminable
from rosette_ros.core.run.number_words import significant
from rosette_ros.core.run.records import Run
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.model_file import read_model, write_model
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.error_results import change_errors, curve_changes
from rosette_ros.presentation.formatting import micro, model_words
from rosette_ros.presentation.json_output import change_json
from rosette_ros.presentation.table_format import Table, words
from rosette_ros.presentation.tables import fitted_effects
from rosette_ros.words.effect_words import capital, scale_of
from rosette_ros.words.motion_words import titles

ADD, REMOVE = 'add', 'remove'
CARRIES = {'all': 'settings and sizes hold for the next run of the same cell',
           'shape': 'the settings hold for the next run, phases and sizes do not',
           'nothing': 'nothing of it: an event of this run'}
"""What of an effect a later run shares."""
KINDS = {'scale': 'searched and refined', 'phase': 'searched and refined',
         'instant': 'searched: all that a run can tell apart', 'choice': 'one of a few, all are tried'}


def effects_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('name', metavar='NAME', nargs='?', help='one effect, explained')
    add_shared(parser, '--angle-unit', '--json')


def run_effects(options: Namespace) -> None:
    """Print the library or one effect."""
    made = effects(options.name)
    chosen = made.chosen
    if options.json:
        print_json(made.to_mapping())
    elif options.name is None:
        out = console()
        print_table(out, Table('library', 'Effects that a model may have and a diagnosis may name', (
            words('name', 'name', [one.name for one in chosen]),
            words('meaning', 'meaning', [one.meaning for one in chosen]))))
        out.print(f'\nThe first three are the base model. {len(COMPOSED)} more laws are put together of motions and '
                  'courses, such as axis_tilt_pulse (docs/effects.md). [bold]rosette effects NAME[/] explains one; '
                  'custom terms: [bold]rosette add --help[/].')
    else:
        show_effect(chosen[0])


def facts(one: Effect) -> list[tuple[str, str]]:
    """Return what is known of an effect, as (name, text)."""
    return [('Possible origin', one.look), ('Added to p', one.formula),
            ('Needs', ', '.join((*one.depends_on, *['a table axis that is not vertical'] * one.needs_tilt))
             or 'nothing but the indices'),
            ('In the next run', CARRIES[one.carries]), ('Source', one.source)]


def parameters(one: Effect) -> Table:
    """Return the table of the parameters of an effect; without rows where it has none."""
    every = [*((quantity, 'fitted') for quantity in amplitudes(one)),
             *((quantity, KINDS[quantity.kind]) for quantity in one.searched)]
    return Table('parameters', 'Parameters', (
        words('parameter', 'parameter', [quantity.name for quantity, _ in every]),
        words('meaning', 'meaning', [quantity.meaning for quantity, _ in every]),
        words('unit_si', 'SI unit', [quantity.unit for quantity, _ in every]),
        words('unit', 'shown in', [scale_of(quantity.unit, quantity.name).unit for quantity, _ in every]),
        words('how', 'how', [how for _, how in every])))


def show_effect(one: Effect) -> None:
    """Print everything about one effect."""
    out, table = console(), parameters(one)
    out.print(f'[bold]{one.name}[/]: {escape(one.meaning)}')
    print_parts(out, [pairs([(name, escape(text)) for name, text in facts(one)])])
    if table.rows:
        print_parts(out, [table, 'The name stands for columns of this form, fitted together with the base '
                          'model. Values in model files and --set are in SI units.'])


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = (
        'A user-defined term is amplitude x direction x expression, for example\n'
        '  rosette add wave --model m.yaml --direction z --expression "t*cos(3*alpha)"\n'
        f'Expressions know {", ".join(NAMES)}\nand the functions {", ".join(FUNCTIONS)}.\n{AMPLITUDE}')
    parser.add_argument('effects', metavar='EFFECT', nargs='+', help='names of effects (rosette effects), of '
                        f'parts of the base model or of the noise ({", ".join(NOISE_TERMS)}), or, with --expression, '
                        'of a user-defined term')
    add_file(parser)
    parser.add_argument('--set', metavar='NAME=VALUE', dest='settings', action='append',
                        type=assignment, default=[], help='fix a searched parameter of the effect, '
                        'SI units, as in a model file: --set tau=600; may be repeated')
    parser.add_argument('--direction', metavar='D', help=f'of a user-defined term: {", ".join(DIRECTIONS)}')
    parser.add_argument('--expression', metavar='E', help='of a user-defined term')
    parser.add_argument('--per', metavar='P', help=f'one amplitude for each: {", ".join(PER)} (default all)')
    add_shared(parser, '--angle-unit', '--json')


def assignment(text: str) -> tuple[str, int | float | str]:
    """Return (name, value) of NAME=VALUE; a value that is no number is a text."""
    name, equals, value = text.partition('=')
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f'expected NAME=VALUE such as tau=600, found {text!r}')
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return name, kind(value)
    return name, value


def run_add(options: Namespace) -> None:
    """Add to the model file."""
    before = model_before(options.model)
    change_file(options, ADD, options.effects, before, extended(before, options))


def extended(model: Model, options: Namespace) -> Model:
    """Return the model with what the options ask for; raise InvalidModel."""
    settings = dict(options.settings)
    name, *others = options.effects
    own = {key: value for key in ('direction', 'expression', 'per') if (value := getattr(options, key)) is not None}
    if own and settings:
        raise InvalidModel(f'{name}: expected either --set for an effect of the library or '
                           '--direction and --expression for a user-defined term, found both')
    if others and (own or settings):
        raise InvalidModel(f'expected one effect with settings of its own, found {", ".join(options.effects)}; add one '
                           'after the other')
    if own:
        return model.with_entry({'own': name, **own})
    others = (*BASE_TERMS, *NOISE_TERMS)
    for one in options.effects:
        term = None if one in others else Term(effect(one, others), Setting(settings))
        if one in (*model.base, *model.noise) or (term and not term.is_open and str(term) in map(str, model.terms)):
            raise InvalidModel(f'{term or one} is already in {options.model}')
        model = model.with_effect(one, settings)
    return model


def add_file(parser: ArgumentParser) -> None:
    """Add the arguments --model and --run."""
    parser.add_argument('--model', metavar='FILE', required=True,
                        help='model file (YAML) to change, made from the base model where there is none. It is '
                        'rewritten at once, without the comments in it; --force is not needed')
    parser.add_argument('--run', metavar='RUN', dest='run_path',
                        help='log directory, .mcap file or CSV: show the residual before and after')
    add_shared(parser, '--columns')


def model_before(path: str) -> Model:
    """Return the model of a file, the base model where there is none."""
    return read_model(path) if Path(path).exists() else Model()


def change_file(options: Namespace, action: str, effects: Sequence[str], before: Model, after: Model) -> None:
    """Change the model file and show what that does to a run; raises first where the run cannot determine the model."""
    name, measured = ' '.join(effects), open_run(
        options.run_path, columns_of=read_columns(options.columns)) if options.run_path else None
    done, words = (None, '') if measured is None else compared(measured, action, effects, before, after)
    write_model(after, options.model, force=True)
    if options.json:
        print_json(change_json(action, name, options.model, (before, after), done, words))
        return
    out = console()
    out.print(f'{escape(str(options.model))}: {escape(model_words(after))}', soft_wrap=True)
    if measured is not None:
        out.print(f'\n{head(measured)}')
        out.print(f'[bold]{escape(words)}[/]')
        print_parts(out, () if done is None else (change_errors(done), curve_changes(done),
                                                  fitted_effects(done.after, 'Effects in the model now')))
    elif action == ADD:
        out.print('With --run RUN the residual before and after is shown.')


def compared(measured: Run, action: str, effects: Sequence[str], before: Model,
             after: Model) -> tuple[Change | None, str]:
    """Return the change on a run and its meaning, None where the old model did not fit; may raise NotDeterminable."""
    try:
        done = change(measured, before, after)
    except NotDeterminable as error:
        if action == ADD:
            raise
        analyse(measured, after)
        return None, f'The model before could not be fitted: {error}'
    if action != ADD or done.after.run.n > MOST_BALLS_JUDGED:
        return done, judgement(action, effects, done)
    verdict = judge(done.after.run, done.after.model)
    return done, ' '.join([judgement(action, effects, done, verdict.missing), *no_longer_needed(done, verdict)])


def judgement(action: str, effects: Sequence[str], done: Change, missing: Sequence[MissingEffect] = ()) -> str:
    """Return in sentences whether a change is for the better; missing: what the model lacks after it."""
    name, is_one = titles(effects), len(effects) == 1
    it, verb = ('it', 's') if is_one else ('them', '')
    before, after = done.cross_validation_before, done.cross_validation_after
    errors = f'{micro(before)} to {micro(after)} µm'
    if not (math.isfinite(before) and math.isfinite(after)):
        return f'Whether {name} help{verb} cannot be judged: too few readings for a cross-validation.'
    if action == ADD:
        first = max(missing, key=lambda one: one.before**2 - one.after**2, default=None)
        other = f'{titles([first.name])} ({first.name})' if first else ''
        if done.helps:
            text = f'{capital(name)} help{verb}: the cross-validation residual falls from {errors}.'
            if first is None:
                return text
            left, gained = first.before**2 - first.after**2, done.before.rms**2 - done.after.rms**2
            more = f'But {other} explains {significant(left / gained, 2)} times more.' if left > gained > 0 else (
                f'{capital(other)} is still missing.')
            return f'{text} {more}'
        does = 'does' if is_one else 'do'
        chance = f'{capital(name)} {does} not lower the cross-validation residual by more than chance'
        return f'{chance} ({errors}) while {other} is missing: add that first.' if first else (
            f'{chance} ({errors}): noise is all that is described. Take {it} out of the model again.')
    if done.hurts:
        return (f'{capital(name)} is needed: without it the cross-validation residual rises from {errors}. '
                'Add it again.')
    return (f'{capital(name)} is not needed: without it the cross-validation residual changes from {errors}, no more '
            'than by chance.')


def no_longer_needed(done: Change, verdict: Verdict) -> list[str]:
    """Return in a sentence which effects a model does not need after another one was added."""
    unused = [one for one in verdict.not_needed if one in done.before.model.names]
    return [f'No longer needed: {titles(unused)}; remove {", ".join(unused)}.'] if unused else []


def remove_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('effect', metavar='EFFECT', help='name as in the model; the last of several with one name')
    add_file(parser)
    add_shared(parser, '--angle-unit', '--json')


def run_remove(options: Namespace) -> None:
    """Remove from the model file."""
    before = model_before(options.model)
    change_file(options, REMOVE, [options.effect], before, before.without_effect(options.effect))


IMPLEMENTED = {
    'effects': (effects_arguments, run_effects), 'add': (add_arguments, run_add),
    'remove': (remove_arguments, run_remove)}
