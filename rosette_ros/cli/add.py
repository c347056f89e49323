# SPDX-License-Identifier: Apache-2.0
"""rosette add: adds an effect, a base term or a user-defined term to a model file; what `remove` shares with it."""

import argparse
import contextlib
import math
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape

from rosette_ros.analysis import Change, analyse, change
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, head, print_json, print_parts
from rosette_ros.core.effects.custom import AMPLITUDE, DIRECTIONS, FUNCTIONS, NAMES, PER
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import effect
from rosette_ros.core.errors import InvalidModel, NotDeterminable
from rosette_ros.core.model.model import BASE_TERMS, NOISE_TERMS, Model, Term
from rosette_ros.core.records import Run
from rosette_ros.io.model_file import read_model, write_model
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.formatting import micro, model_words
from rosette_ros.presentation.json_output import change_json
from rosette_ros.presentation.tables import change_errors, curve_changes, fitted_effects
from rosette_ros.words.effect_words import capital
from rosette_ros.words.verdict_words import titles

ADD, REMOVE = 'add', 'remove'


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    add_shared(parser, '--json')


def assignment(text: str) -> tuple[str, int | float | str]:
    """Return (name, value) of NAME=VALUE; a value that is no number is a text."""
    name, equals, value = text.partition('=')
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f'wanted NAME=VALUE such as tau=600, got {text!r}')
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return name, kind(value)
    return name, value


def run(options: argparse.Namespace) -> None:
    """Add to the model file."""
    before = model_before(options.model)
    change_file(options, ADD, options.effects, before, extended(before, options))


def extended(model: Model, options: argparse.Namespace) -> Model:
    """Return the model with what the options ask for; raise InvalidModel."""
    settings = dict(options.settings)
    name, *others = options.effects
    own = {key: value for key in ('direction', 'expression', 'per') if (value := getattr(options, key)) is not None}
    if own and settings:
        raise InvalidModel(f'{name}: wanted either --set for an effect of the library or '
                           '--direction and --expression for a user-defined term, got both')
    if others and (own or settings):
        raise InvalidModel(f'wanted one effect with settings of its own, got {", ".join(options.effects)}; add one '
                           'after the other')
    if own:
        return model.with_entry({'own': name, **own})
    for one in options.effects:
        term = None if one in (*BASE_TERMS, *NOISE_TERMS) else Term(effect(one), Setting(settings))
        if one in (*model.base, *model.noise) or (term and not term.is_open and str(term) in map(str, model.terms)):
            raise InvalidModel(f'{term or one} is already in {options.model}')
        model = model.with_effect(one, settings)
    return model


def add_file(parser: argparse.ArgumentParser) -> None:
    """Add the arguments --model and --run."""
    parser.add_argument('--model', metavar='FILE', required=True,
                        help='model file (YAML) to change, made from the base model where there is none. It is '
                        'rewritten at once, without the comments in it; --force is not needed')
    parser.add_argument('--run', metavar='RUN', dest='run_path',
                        help='log directory, .mcap file or CSV: show the error before and after')


def model_before(path: str) -> Model:
    """Return the model of a file, the base model where there is none."""
    return read_model(path) if Path(path).exists() else Model()


def change_file(options: argparse.Namespace, action: str, effects: Sequence[str], before: Model, after: Model) -> None:
    """Change the model file and show what that does to a run; raises first where the run cannot determine the model."""
    name, measured = ' '.join(effects), open_run(options.run_path) if options.run_path else None
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
                                                  fitted_effects(done.after.effects, 'Effects in the model now')))
    elif action == ADD:
        out.print('With --run RUN the error before and after is shown.')


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
    return done, judgement(action, effects, done)


def judgement(action: str, effects: Sequence[str], done: Change) -> str:
    """Return a sentence on whether a change is for the better."""
    name, is_one = titles(effects), len(effects) == 1
    it, verb = ('it', 's') if is_one else ('them', '')
    before, after = done.cross_validation_before, done.cross_validation_after
    errors = f'{micro(before)} to {micro(after)} µm'
    if not (math.isfinite(before) and math.isfinite(after)):
        return f'Whether {name} help{verb} cannot be judged: too few readings for a cross-validation.'
    if action == ADD:
        return f'{capital(name)} help{verb}: the cross-validation error falls from {errors}.' if done.helps else (
            f'{capital(name)} {"does" if is_one else "do"} not lower the cross-validation error by more than chance '
            f'({errors}): noise is all that is described. Take {it} out of the model again.')
    if done.hurts:
        return f'{capital(name)} is needed: without it the cross-validation error rises from {errors}. Add it again.'
    return (f'{capital(name)} is not needed: without it the cross-validation error changes from {errors}, no more than '
            'by chance.')
