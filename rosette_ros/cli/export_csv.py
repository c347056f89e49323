# SPDX-License-Identifier: Apache-2.0
"""rosette export: a run becomes a ball-centre table (CSV), exact enough to evaluate from."""

import argparse
import sys

from rich.markup import escape

from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, head, warn
from rosette_ros.io.ball_centre_table import format_csv, write_csv
from rosette_ros.io.open_run import open_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--run-id', '--force')
    parser.add_argument('-o', '--output', metavar='CSV', required=True,
                        help='table to write; - for the standard output')


def run(options: argparse.Namespace) -> None:
    """Write the table."""
    run = open_run(options.run_path, options.run_id)
    warn(run)
    if options.output == '-':
        sys.stdout.write(format_csv(run))
        return
    write_csv(run, options.output, options.force)
    out = console()
    out.print(head(run))
    out.print(f'Table: {escape(options.output)}', soft_wrap=True)
