# SPDX-License-Identifier: Apache-2.0
"""rosette remove: takes an effect, a term of one's own or a base term out of a model file."""

from rosette_ros.cli.arguments import add_formats
from rosette_ros.cli.model_change import REMOVE, add_file, carry_out, model_before


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('effect', metavar='EFFECT', help='name as it stands in the model; of '
                        'several with one name the last')
    add_file(parser)
    add_formats(parser)


def run(options):
    """Remove from the model file."""
    before = model_before(options.model)
    carry_out(options, REMOVE, options.effect, before, before.without_effect(options.effect))
