# SPDX-License-Identifier: Apache-2.0
"""rosette remove: removes an effect, a base term or a user-defined term from a model file."""

import argparse

from rosette_ros.cli.add import REMOVE, add_file, change_file, model_before
from rosette_ros.cli.arguments import add_shared


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('effect', metavar='EFFECT', help='name as in the model; the last of several with one name')
    add_file(parser)
    add_shared(parser, '--json')


def run(options: argparse.Namespace) -> None:
    """Remove from the model file."""
    before = model_before(options.model)
    change_file(options, REMOVE, [options.effect], before, before.without_effect(options.effect))
