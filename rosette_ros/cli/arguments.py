# SPDX-License-Identifier: Apache-2.0
"""Arguments that several verbs share, and how their texts become values."""

import argparse
import math


def whole(low, high):
    """Return a reader of whole numbers in low .. high; low None: no lower bound."""
    def read(text):
        span = f'of at most {high}' if low is None else f'in {low} .. {high}'
        wanted = f'wanted a whole number {span}, got {text!r}'
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(wanted) from None
        if value > high or (low is not None and value < low):
            raise argparse.ArgumentTypeError(wanted)
        return value
    return read


def positive(unit):
    """Return a reader of positive finite numbers in a unit."""
    def read(text):
        wanted = f'wanted a positive number ({unit}), got {text!r}'
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(wanted) from None
        if not (math.isfinite(value) and value > 0):
            raise argparse.ArgumentTypeError(wanted)
        return value
    return read


def add_run(parser):
    """Add the argument RUN."""
    parser.add_argument('run_path', metavar='RUN',
                        help='log directory, .mcap file or ball-centre table (CSV)')


def add_run_id(parser):
    """Add the argument --run-id."""
    parser.add_argument('--run-id', metavar='ID', help='which run, where a log holds several '
                        '(rosette info names them)')


def add_formats(parser, csv=None):
    """Add --json and, with words for it, --csv; one excludes the other."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument('--json', action='store_true',
                       help='print one JSON object and nothing else')
    if csv:
        group.add_argument('--csv', action='store_true', help=csv)
