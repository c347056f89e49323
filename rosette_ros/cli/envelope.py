# SPDX-License-Identifier: Apache-2.0
"""rosette envelope: opens the envelope of `demo --hidden`: what was hidden, beside what is found."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rosette_ros.cli import hidden_demo
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console
from rosette_ros.core.errors import InvalidData


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path')


def run(options: Namespace) -> None:
    """Print all results and open the envelope; raises InvalidData where the run has none."""
    path = Path(options.run_path)
    if not (path / hidden_demo.ENVELOPE).is_file():
        raise InvalidData(f'{path}: wanted the log of `rosette demo --hidden`, got none with {hidden_demo.ENVELOPE}')
    hidden_demo.tell(console(), path)
