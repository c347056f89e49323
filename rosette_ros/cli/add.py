# SPDX-License-Identifier: Apache-2.0
"""rosette add: puts an effect, a base term or a term of one's own into a model file."""

import argparse

from rosette_ros.cli.arguments import add_formats
from rosette_ros.cli.model_change import ADD, add_file, carry_out, model_before
from rosette_ros.core.base import BASE_TERMS
from rosette_ros.core.effects.expression import FUNCTIONS, NAMES
from rosette_ros.core.effects.own import DIRECTIONS, PER
from rosette_ros.core.errors import InvalidModel


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = (
        'A term of your own is amplitude x direction x expression, for example\n'
        '  rosette add wave --model m.yaml --direction z --expression "t*cos(3*alpha)"\n'
        f'Expressions know {", ".join(NAMES)}\nand the functions {", ".join(FUNCTIONS)}.')
    parser.add_argument('effect', metavar='EFFECT', help='name of an effect (rosette effects), of a '
                        'part of the base model, or, with --expression, of a term of your own')
    add_file(parser)
    parser.add_argument('--set', metavar='NAME=VALUE', dest='settings', action='append',
                        type=assignment, default=[], help='fix a searched parameter of the effect, '
                        'SI units, as in a model file: --set tau=600; may stand several times')
    parser.add_argument('--direction', metavar='D', help='of a term of your own: '
                        f'{", ".join(DIRECTIONS)}')
    parser.add_argument('--expression', metavar='E', help='of a term of your own')
    parser.add_argument('--per', metavar='P', help='one amplitude for each: '
                        f'{", ".join(PER)} (default all)')
    add_formats(parser)


def assignment(text):
    """Return (name, value) of NAME=VALUE; a value that is no number is a word."""
    name, equals, value = text.partition('=')
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f'wanted NAME=VALUE such as tau=600, got {text!r}')
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            continue
    return name, value


def run(options):
    """Add to the model file."""
    before = model_before(options.model)
    carry_out(options, ADD, options.effect, before, extended(before, options))


def extended(model, options):
    """Return the model with what the options ask for; raises InvalidModel."""
    name, settings = options.effect, dict(options.settings)
    own = {key: value for key, value in (('direction', options.direction),
                                         ('expression', options.expression),
                                         ('per', options.per)) if value is not None}
    if own and settings:
        raise InvalidModel(f'{name}: wanted either --set for an effect of the library or '
                           '--direction and --expression for a term of your own, got both')
    if own:
        return model.with_entry({'own': name, **own})
    if name in BASE_TERMS and settings:
        raise InvalidModel(f'{name}: wanted no --set, it has no settings, got '
                           f'{", ".join(settings)}')
    return model.with_effect(name, settings)
