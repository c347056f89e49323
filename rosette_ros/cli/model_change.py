# SPDX-License-Identifier: Apache-2.0
"""What `add` and `remove` share: the model file, the error before and after, whether it helps."""

import math
from pathlib import Path

from rich.markup import escape

from rosette_ros.analysis import analyse, change
from rosette_ros.cli.human import parameter_table
from rosette_ros.cli.screen import console, print_json, table
from rosette_ros.cli.summary import head
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model import Model
from rosette_ros.core.records import CURVES
from rosette_ros.data.model_file import read_model, write_model
from rosette_ros.data.open_run import open_run
from rosette_ros.diagnosis_json import change_json
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.words import micro

ADD, REMOVE = 'add', 'remove'


def add_file(parser):
    """Add the arguments --model and --run."""
    parser.add_argument('--model', metavar='FILE', required=True,
                        help='model file (YAML) to change; where none is, it is made from the base '
                        'model. It is written anew at once and whole, comments in it are lost; '
                        'this verb is meant to change it and asks for no --force')
    parser.add_argument('--run', metavar='RUN', dest='run_path',
                        help='log directory, .mcap file or CSV: show the error before and after')


def model_before(path):
    """Return the Model of a file, the base model where there is none."""
    return read_model(path) if Path(path).exists() else Model()


def carry_out(options, action, name, before, after):
    """Write the model after a change and tell what it does to a run, where one is given.

    Raises before anything is written where the run cannot tell what the new model asks.
    """
    measured = open_run(options.run_path) if options.run_path else None
    done, words = (None, '') if measured is None else compared(measured, action, name, before,
                                                               after)
    write_model(after, options.model, force=True)
    if options.json:
        print_json(change_json(action, name, options.model, (before, after), done, words))
        return
    out = console()
    out.print(f'{escape(str(options.model))}: {escape(str(after))}', soft_wrap=True)
    if measured is not None:
        out.print(f'\n{head(measured)}')
        show(out, done, words)
    elif action == ADD:
        out.print('With --run RUN the error before and after is shown.')


def compared(measured, action, name, before, after):
    """Return the Change on a run and what it means; no Change where the old model did not fit.

    Raises NotDeterminable where the run cannot tell what the new model asks.
    """
    try:
        done = change(measured, before, after)
    except NotDeterminable as error:
        if action == ADD:
            raise
        analyse(measured, after)
        return None, f'The model before could not be fitted: {error}'
    return done, judgement(action, name, done)


def judgement(action, name, done):
    """Return a plain sentence on whether a Change is for the better."""
    before, after = done.held_out_before, done.held_out_after
    errors = f'{micro(before)} to {micro(after)} µm'
    if not (math.isfinite(before) and math.isfinite(after)):
        return (f'Whether {name} helps cannot be judged: with so few readings none can be left '
                'out of the fit.')
    if action == ADD and done.helps:
        return f'{name} helps: the error in readings left out of the fit falls from {errors}.'
    if action == ADD:
        return (f'{name} does not lower the error in readings left out: it only describes noise '
                f'({errors}). Take it out with rosette remove {name}.')
    if done.hurts:
        return (f'{name} is needed: without it the error in readings left out rises from '
                f'{errors}. Put it back with rosette add {name}.')
    return (f'{name} is not needed: without it the error in readings left out goes from {errors}, '
            'no more than by chance.')


def show(out, done, words):
    """Print a Change for a person."""
    out.print(f'[bold]{escape(words)}[/]')
    if done is None:
        return
    out.print()
    out.print(error_table(done))
    out.print()
    out.print(curve_change_table(done))
    effects = done.after.effects
    if effects:
        out.print()
        out.print(parameter_table([(one.name, one.setting, one.parameters) for one in effects],
                                  'Effects in the model now'))


def error_table(done):
    """Return the table of errors before and after."""
    made = table('', 'before', 'after', title='Error')
    reports = done.before, done.after
    made.add_row('residual / µm', *(micro(report.fit.rms) for report in reports))
    chis = [report.fit.reduced_chi_square for report in reports]
    if None not in chis:
        made.add_row('reduced χ²', *(f'{chi:.3g}' for chi in chis))
    made.add_row('readings left out / µm', micro(done.held_out_before),
                 micro(done.held_out_after))
    made.add_row('degrees of freedom', *(str(report.fit.dof) for report in reports))
    return made


def curve_change_table(done):
    """Return the table of what becomes of the curves: largest change, uncertainties."""
    units = ['µm' if curve.startswith('ct') else 'µrad' for curve in CURVES]
    made = table('', *(f'{curve}\n{unit}' for curve, unit in zip(CURVES, units, strict=True)),
                 title='The six curves')
    made.add_row('largest change', *(micro(float(value)) for value in done.curve_change))
    for when, report in (('before', done.before), ('after', done.after)):
        largest = COVERAGE_FACTOR * report.error_motions.u.max(axis=0)
        made.add_row(f'U (k={COVERAGE_FACTOR}) {when}', *(micro(float(u)) for u in largest))
    return made
