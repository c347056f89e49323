# SPDX-License-Identifier: Apache-2.0
"""rosette import: a ball-centre table (CSV) becomes a log directory that every ROS tool opens."""

import argparse
import os
from pathlib import Path

from rich.markup import escape

from rosette_ros.cli.console import console, head, warn
from rosette_ros.io.ball_centre_table import read_csv
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.type_definitions import TypeLibrary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('table', metavar='CSV', help='ball-centre table, rosette-ball-centres/1')
    parser.add_argument('-o', '--output', metavar='RUN', required=True,
                        help='log directory to make; an existing log is never changed')


def run(options: argparse.Namespace) -> None:
    """Write the log."""
    run = read_csv(options.table)
    log = write_log(run, Path(options.output), TypeLibrary.from_environment(os.environ))
    out = console()
    out.print(head(run))
    warn(run)
    out.print(f'Log: {escape(str(log))}', soft_wrap=True)
