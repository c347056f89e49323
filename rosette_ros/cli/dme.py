# SPDX-License-Identifier: Apache-2.0
"""rosette dme: a CMM with an I++ DME server."""

import argparse
from collections.abc import Callable

from rosette_ros.cli import dme_client, dme_serve


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    verbs = parser.add_subparsers(metavar='WHAT', required=True)
    for name, (text, arguments, implementation) in WHAT.items():
        made = verbs.add_parser(name, help=text, description=f'{text[0].upper()}{text[1:]}.')
        arguments(made)
        made.set_defaults(carry_out=implementation)


def run(options: argparse.Namespace) -> None:
    """Do what was asked for."""
    options.carry_out(options)


WHAT: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None], Callable[[argparse.Namespace], None]]] = {
    'check': ('connect to an I++ server and say what it can do; nothing moves', dme_client.check_arguments,
              dme_client.check),
    'path': ('the path around a ball, as table and picture; are all paths safe', dme_client.path_arguments,
             dme_client.path),
    'dry-run': ('all moves slowly above the balls, no touch', dme_client.dry_run_arguments, dme_client.dry_run),
    'serve': ('an I++ server with the simulated machine behind it, to try clients', dme_serve.add_arguments,
              dme_serve.run),
}
"""Word: what it does, its arguments, its function. Another one is a line here."""
