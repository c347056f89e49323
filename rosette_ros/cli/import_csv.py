# SPDX-License-Identifier: Apache-2.0
"""rosette import: a ball-centre table (CSV) becomes a log directory that every ROS tool opens."""

import os
from pathlib import Path

from rich.markup import escape

from rosette_ros.cli.screen import console
from rosette_ros.cli.summary import head
from rosette_ros.data.csv_table import read_csv
from rosette_ros.data.run_log import write_log
from rosette_ros.data.schemas import TypeLibrary


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('table', metavar='CSV', help='ball-centre table, rosette-ball-centres/1')
    parser.add_argument('-o', '--output', metavar='RUN', required=True,
                        help='log directory to make; a log that is there already is never touched')


def run(options):
    """Write the log."""
    run = read_csv(options.table)
    log = write_log(run, Path(options.output), TypeLibrary.from_environment(os.environ))
    out = console()
    out.print(head(run))
    out.print(f'Log: {escape(str(log))}', soft_wrap=True)
