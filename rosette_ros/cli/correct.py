# SPDX-License-Identifier: Apache-2.0
"""rosette correct: what a controller has to take off, from a run, or from runs in both senses of turning."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np
from rich.markup import escape

from rosette_ros import command
from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, evaluate_jointly, judge
from rosette_ros.cli.arguments import UsageError, add_shared, positive
from rosette_ros.cli.console import COLOURS, console, print_parts
from rosette_ros.cli.joint_arguments import add_joint, is_joint
from rosette_ros.core.correction import Correction
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.records import CURVES
from rosette_ros.io.correction_file import correction_csv, format_correction, linuxcnc_compensation
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import joint_identity, open_identified, open_readings
from rosette_ros.io.sharing_file import read_sharing
from rosette_ros.io.text_file import refuse_output, write_text
from rosette_ros.presentation.correction_results import correction_table
from rosette_ros.presentation.formatting import SCALES, exact
from rosette_ros.words.verdict_words import verdict_text

STEPS = {'csv': 5.0, 'linuxcnc': 2.0}
"""Default distance of the lines of a table, deg."""
MOST_LINES = 100_000
"""Lines of a table; LinuxCNC reads fewer."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='+')
    add_shared(parser, '--run-id', '--model')
    add_joint(parser)
    add_shared(parser, '--identity')
    parser.add_argument('--for', dest='target', choices=('ros', 'csv', 'linuxcnc'), default='ros',
                        help='ros: rosette-correction/1 (YAML) for table_corrector, verify and the simulated machine; '
                             'csv: a table; linuxcnc: a compensation file, COMP_FILE_TYPE = 1 (default ros)')
    parser.add_argument('-o', '--output', metavar='FILE', required=True, help='file to write')
    parser.add_argument('--curves', metavar='LIST', help='which errors are taken off, such as crz,ctz (default: all '
                        'six; for linuxcnc crz, since it turns the table only)')
    parser.add_argument('--step', metavar='DEG', type=positive('deg'),
                        help='distance of the lines of a table (default 5 for csv, 2 for linuxcnc)')
    parser.add_argument('--range', metavar=('MIN', 'MAX'), nargs=2, type=float,
                        help='angles of the table, deg; for linuxcnc MIN_LIMIT and MAX_LIMIT of the axis '
                             '(default 0 360)')
    add_shared(parser, '--force')


def run(options: Namespace) -> None:
    """Write the file and say what is in it."""
    corrected = CURVES if options.target != 'linuxcnc' else ('crz',)
    if options.curves is not None:
        corrected = tuple(options.curves.split(','))
    if [one for one in corrected if one not in CURVES]:
        raise UsageError(f'--curves: wanted some of {",".join(CURVES)}, got {options.curves!r}')
    if options.target == 'ros' and (options.step or options.range):
        raise UsageError(f'correct: --{"step" if options.step else "range"} goes with --for csv or linuxcnc only; '
                         'leave it out')
    if options.target == 'ros' and Path(options.output).suffix.lower() == '.csv':
        raise UsageError(f'--output: wanted a name for YAML with --for ros, got {options.output!r}; --for csv writes a '
                         'table')
    low, high = options.range or (0.0, 360.0)
    if not low < high:
        raise UsageError(f'correct: --range: wanted MIN below MAX, got {low:g} and {high:g}')
    step = options.step or STEPS.get(options.target, 0.0)
    if step and (high - low) / step > MOST_LINES:
        raise UsageError(f'correct: wanted a table of at most {MOST_LINES} lines, got --range {low:g} {high:g} with '
                         f'--step {step:g}; take a larger --step or a smaller --range')
    refuse_output(options.output, options.force)
    correction, table, verdict, unknown = _correction(options, corrected)
    if options.target == 'linuxcnc':
        text = linuxcnc_compensation(correction, low, high, step)
    elif options.target == 'csv':
        text = correction_csv(correction, np.deg2rad(np.append(np.arange(low, high - 1e-9, step), high)))
    else:
        text = format_correction(correction, table)
    write_text(options.output, text, options.force)
    out = console()
    if verdict:
        out.print(f'[{COLOURS[verdict.level]}]{escape(verdict_text(verdict).sentence)}[/]')
        if verdict.model_fails:
            out.print('What the model lacks may be in these curves: add it first (rosette add).')
    print_parts(out, [correction_table(correction)])
    lines = [f'Harmonics: up to {correction.harmonics} of the table angle, those that the run determines.']
    if unknown:
        lines.append(f'Not corrected, as the runs do not tell it: the mean of the reversal of {", ".join(unknown)}.')
    if step:
        bound = dict(zip(CURVES, correction.curvature() * np.deg2rad(step)**2 / 8))
        missed = ((max([bound[one] for one in corrected if one.startswith(kind)], default=None), unit)
                  for kind, unit in (('ct', 'm'), ('cr', 'rad')))
        lines.append(f'Straight lines between the angles of the table miss {", ".join(corrected)} by at most '
                     f'{" and ".join(_in_unit(size, unit) for size, unit in missed if size is not None)}.')
    lines.append(f'File: {options.output}')
    if options.target == 'ros':
        lines.append('After a run with the correction, whether it did what it promised:\n  '
                     + command('verify', options.run_path[0], 'AFTER', '--correction', options.output,
                               *(('--model', options.model) if options.model else ())))
    out.print('\n' + escape('\n'.join(lines)), soft_wrap=True)


def _correction(options: Namespace, corrected: tuple[str, ...]
                ) -> tuple[Correction, str, Verdict | None, list[str]]:
    """Return the Correction, the table's serial number, the verdict of one run, and curves of unknown mean reversal."""
    if is_joint(options):
        result = evaluate_jointly([open_readings(path, options.run_id) for path in options.run_path],
                                  read_sharing(options.share, len(options.run_path)))
        identity = joint_identity(options.run_path, options.run_id, options.identity)[0]
        first, runs = result.curves[0][0].name, result.solution.model.runs
        by_sense = {table.sense: motions for table, motions in result.curves if table.name == first}
        forward, backward = (by_sense.get(sense, by_sense.get(0)) for sense in (1, -1))
        known = [one for one in (forward, backward) if one is not None]
        unknown = [curve for curve, *are_known in zip(CURVES, *[one.is_known for one in result.reversals
                                                                if one.table == first])
                   if curve in corrected and not all(are_known)]
        return (Correction(known[0], known[-1], corrected, '+'.join(one.run_id for one in runs),
                           any(one.simulated for one in runs)), identity['table.serial'], None, unknown)
    run, identity, _ = open_identified(options.run_path[0], options.run_id, options.identity)
    if run.table_offset:
        raise UsageError(f'{options.run_path[0]}: wanted a run whose table position 1 is at angle 0, got '
                         f'{np.rad2deg(run.table_offset):.6g} deg; with --joint its curves are in the axes of angle 0')
    fit = analyse(run, read_model(options.model))
    verdict = judge(fit.run, fit.model) if run.n <= MOST_BALLS_JUDGED else None
    motions = fit.error_motions
    return Correction(motions, motions, corrected, run.run_id, run.simulated), identity['table.serial'], verdict, []


def _in_unit(size: float, unit: str) -> str:
    factor, name = SCALES[unit]
    return f'{exact(size * factor, 4)} {name}'
