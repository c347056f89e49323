# SPDX-License-Identifier: Apache-2.0
"""rosette evaluate: the six error motions of a run, plate and CMM deviations, uncertainties."""

import sys

import numpy as np

from rosette_ros.analysis import analyse
from rosette_ros.cli.arguments import add_formats, add_run, add_run_id
from rosette_ros.cli.screen import console, print_json
from rosette_ros.cli.summary import (
    curve_table,
    deviation_table,
    effect_table,
    fit_summary,
    head,
)
from rosette_ros.core.model import Model
from rosette_ros.core.records import CURVES
from rosette_ros.data.model_file import read_model
from rosette_ros.data.open_run import open_run
from rosette_ros.report_json import evaluation_json


def add_arguments(parser):
    """Declare what the verb takes."""
    add_run(parser)
    add_run_id(parser)
    parser.add_argument('--model', metavar='FILE', help='model file (YAML); without it the base '
                        'model: table motions, plate deviations, CMM deviations')
    add_formats(parser, csv='print the six curves as a table with standard uncertainties')


def run(options):
    """Print the evaluation."""
    model = read_model(options.model) if options.model else Model()
    report = analyse(open_run(options.run_path, options.run_id), model)
    if options.json:
        print_json(evaluation_json(report))
    elif options.csv:
        sys.stdout.write(format_curves(report.error_motions))
    else:
        show(report)


def format_curves(motions):
    """Return the six curves with standard uncertainties as CSV text, µm and µrad."""
    units = ['um' if curve.startswith('ct') else 'urad' for curve in CURVES]
    names = [f'{curve}_{unit}' for curve, unit in zip(CURVES, units, strict=True)]
    lines = [','.join(['table_position', 'table_angle_deg', *names, *(f'u_{n}' for n in names)])]
    numbers = np.column_stack([np.rad2deg(motions.angle), 1e6 * motions.values, 1e6 * motions.u])
    for position, row in enumerate(numbers, 1):
        lines.append(','.join([str(position), *(f'{value:.9f}' for value in row + 0.0)]))
    return '\n'.join(lines) + '\n'


def show(report):
    """Print the evaluation for a person."""
    out = console()
    out.print(head(report.run))
    for part in (curve_table(report.error_motions), deviation_table(report),
                 effect_table(report), fit_summary(report)):
        if part is not None:
            out.print()
            out.print(part)
