# SPDX-License-Identifier: Apache-2.0
"""rosette hold: keeps a cell that calibrates itself from beginning, and releases it."""

import argparse
import getpass
import socket

from rosette_ros.cell.client import CellClient
from rosette_ros.cli.arguments import UsageError, add_shared
from rosette_ros.cli.console import console
from rosette_ros.core.errors import CellError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument('--why', metavar='WORDS', default='', help='hold it, for this reason (default: say who holds it)')
    what.add_argument('--release', action='store_true', help='end the hold')
    parser.add_argument('--who', metavar='NAME', help='person or job that holds it (default: user@computer)')
    add_shared(parser, '--namespace', '--domain')


def run(options: argparse.Namespace) -> None:
    """Hold, release or ask, and print who holds the cell."""
    if options.who is not None and not options.who.strip():
        raise UsageError('--who: wanted the name of a person or a job, got nothing')
    who = options.who or f'{getpass.getuser()}@{socket.gethostname()}'
    with CellClient(options.domain, options.namespace) as client:
        done, words, _ = client.hold(who if options.why or options.release else '', options.why, options.release)
    if not done:
        raise CellError(f'cell /{options.namespace}: {words}')
    console().print(words, markup=False, soft_wrap=True)
