# SPDX-License-Identifier: Apache-2.0
"""Arguments that several verbs share, and how their texts become values."""

import argparse
import math
import re
from collections.abc import Callable

from rosette_ros.core.errors import RosetteError
from rosette_ros.nodes.names import NAMESPACE


class UsageError(RosetteError):
    """The command was not given as it is meant."""


def whole(low: int | None, high: int) -> Callable[[str], int]:
    """Return a reader of whole numbers in low .. high; low None: no lower bound."""
    span = f'of at most {high}' if low is None else f'in {low} .. {high}'

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = high + 1
        if value > high or (low is not None and value < low):
            raise argparse.ArgumentTypeError(f'wanted a whole number {span}, got {text!r}')
        return value
    return read


def positive(unit: str) -> Callable[[str], float]:
    """Return a reader of positive finite numbers in a unit."""
    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0 < value < math.inf:
            raise argparse.ArgumentTypeError(f'wanted a positive number ({unit}), got {text!r}')
        return value
    return read


def namespace(text: str) -> str:
    """Read a namespace, with or without the slash in front."""
    bare = text.strip('/')
    if not re.fullmatch(r'([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?', bare, re.ASCII):
        raise argparse.ArgumentTypeError(f'wanted a namespace such as cell2 (letters, digits and "_", none begins '
                                         f'with a digit), got {text!r}')
    return bare


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the argument RUN."""
    parser.add_argument('run_path', metavar='RUN', help='log directory, .mcap file or ball-centre table (CSV)')


def add_run_id(parser: argparse.ArgumentParser) -> None:
    """Add the argument --run-id."""
    parser.add_argument('--run-id', metavar='ID', help='which run, where a log holds several (rosette info names them)')


def add_model(parser: argparse.ArgumentParser) -> None:
    """Add the argument --model."""
    parser.add_argument('--model', metavar='FILE', help='model file (YAML); without it the base model: table motions, '
                        'plate deviations, CMM deviations')


def add_formats(parser: argparse.ArgumentParser, csv: str | None = None) -> None:
    """Add --json and, with words for it, --csv; one excludes the other."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument('--json', action='store_true', help='print one JSON object and nothing else')
    if csv:
        group.add_argument('--csv', action='store_true', help=csv)


def add_logs(parser: argparse.ArgumentParser) -> None:
    """Add the argument --output, the folder of logs."""
    parser.add_argument('-o', '--output', metavar='DIR', default='rosette-runs',
                        help='folder of the logs, one folder per run (default rosette-runs)')


def add_domain(parser: argparse.ArgumentParser, default: str = 'that of the environment') -> None:
    """Add the argument --domain."""
    parser.add_argument('--domain', metavar='ID', type=whole(0, 232), help=f'ROS domain (default: {default})')


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Add the argument --namespace."""
    parser.add_argument('--namespace', metavar='NS', type=namespace, default=NAMESPACE,
                        help=f'namespace of the cell (default {NAMESPACE})')
