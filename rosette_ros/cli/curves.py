# SPDX-License-Identifier: Apache-2.0
"""Curves of two sources side by side: a run against another, against a correction, against a table of the maker."""

import sys
from argparse import ArgumentParser, Namespace

from rich.markup import escape

from rosette_ros.api.curve_sources import compare_curves
from rosette_ros.cli.arguments import add_formats, add_shared
from rosette_ros.cli.console import console, doing, print_json, print_parts


def compare_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    for name, letter in (('first', 'A'), ('second', 'B')):
        parser.add_argument(name, metavar=letter, help='curves (CSV with '
                            'table_angle_deg, ctz_um, crz_urad ... and u_ or U_ of them), a correction (YAML), or a '
                            'run')
    add_shared(parser, '--columns', '--angle-unit')
    add_formats(parser, csv='print the differences at each angle as a table')


def run_compare(options: Namespace) -> None:
    """Print the comparison."""
    with doing('comparing'):
        made = compare_curves(options.first, options.second, options.columns)
    table, differences = made.tables()
    if options.json:
        print_json(made.to_mapping())
    elif options.csv:
        sys.stdout.write(differences.csv())
    else:
        out = console()
        for sentence in made.sentences():
            out.print(escape(sentence), soft_wrap=True)
        print_parts(out, [table])


IMPLEMENTED = {'compare-curves': (compare_arguments, run_compare)}
