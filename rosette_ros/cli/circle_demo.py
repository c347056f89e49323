# SPDX-License-Identifier: Apache-2.0
"""rosette demo --circle: calibrate, find what the model lacks, add it, correct the table, calibrate again.

The machine drifts while it is measured, and its table has errors of micrometres. The correction is given to the machine
between the two runs; machine, clock and noise continue.
"""

from argparse import Namespace
from functools import partial

from rich.markup import escape

from rosette_ros import command
from rosette_ros.analysis import analyse, summarise
from rosette_ros.cli.console import console, pairs, print_parts, print_table, print_verdict
from rosette_ros.cli.demo_cell import demo_cell, shown, write_machine
from rosette_ros.cli.hidden_demo import MODEL, section
from rosette_ros.core.correction import Correction
from rosette_ros.core.correction_check import check_correction
from rosette_ros.core.error_summary import error_lines
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.io.correction_file import format_correction
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.model_file import write_model
from rosette_ros.io.open_run import open_identified
from rosette_ros.presentation.correction_results import check_table
from rosette_ros.presentation.formatting import CURVE_UNITS, fixed, millimetres
from rosette_ros.presentation.plots.plot_style import save
from rosette_ros.presentation.plots.result_plots import Series, six_curves
from rosette_ros.presentation.table_format import Table, column, micrometre_column, words
from rosette_ros.presentation.tables import nested_models
from rosette_ros.simulation import MachineConfig
from rosette_ros.words.verdict_words import verdict_text

TABLE = {'translation_um': 0.8, 'rotation_urad': 5.0, 'axial_correction': False, 'angular_correction': False,
         'harmonics': 2}
"""A table that has not been corrected; six balls determine two harmonics, and a part of the third."""
HIDDEN = ({'kind': 'frame_drift', 'rate_um_per_h': (6.0, 0.0, 4.0)},
          {'kind': 'table_zero_drift', 'rate_urad_per_h': 40.0})
CORRECTION = 'correction.yaml'
NUMBERED = ('1. calibrated: base model', '2. with the effects found', '3. corrected, calibrated again')


def run(options: Namespace) -> None:
    """Go round once, and show all stages in a table and a picture."""
    config = MachineConfig().changed(seed=options.seed, plate={'balls': options.balls}, table=TABLE, hidden=HIDDEN,
                                     placement={'axis': options.axis})
    order, out = options.order or 'sensitive', console()
    what = f'[bold]Calibrate, correct, calibrate again[/]: {options.balls} balls, order {order}'
    with demo_cell(out, what, config, options.domain, options.output, options.identity) as running:
        section(out, '1', 'calibrate')
        before_path = running.calibrate(order, options.seed, 'turning: forward')
        run, identity, _ = open_identified(before_path)
        before = summarise(run)
        print_verdict(out, verdict_text(before.verdict))
        section(out, '2', 'add what is missing: the error falls')
        final = before.final
        print_table(out, nested_models(before.ladder))
        section(out, '3', 'correct, and calibrate again')
        correction = Correction(final.error_motions, final.error_motions, run_id=final.run.run_id, simulated=True)
        (running.machine.parent / CORRECTION).write_text(format_correction(correction, identity['table.serial']),
                                                        encoding='utf-8')
        write_machine(config.changed(table={'correction_file': CORRECTION}), running.machine)
        after_path = running.calibrate(order, options.seed + 1, 'turning: forward')
        after = analyse(read_log(after_path).to_run(), final.model)
        seconds = running.seconds
    section(out, '4', 'verify')
    check = check_correction(final.error_motions, after.error_motions, correction)
    print_verdict(out, check)
    fits = (before.fit, final, after)
    print_parts(out, [check_table(check), stages(fits)])
    picture, model = after_path / 'circle.png', after_path / MODEL
    write_model(final.model, model, force=True)
    title = f'Error motions of a simulated rotary table: {final.run.n} balls on R = {millimetres(final.run.radius)}'
    labels = (f'{NUMBERED[0]}, which does not fit: no U', *NUMBERED[1:])
    save(six_curves([Series(label, fit.error_motions, banded=fit is not before.fit) for label, fit in
                     zip(labels, fits, strict=True)], title), picture)
    out.print(f'\nTook {seconds:.1f} s\n')
    logs = f'{shown(before_path)}\n{shown(after_path)}'
    out.print(pairs([(name, escape(text)) for name, text in (
        ('Picture', shown(picture)), ('Logs', logs), ('Correction', shown(after_path / CORRECTION)),
        ('Model', shown(model)))]))
    again = command('verify', shown(before_path), shown(after_path), '--correction', shown(after_path / CORRECTION),
                    '--model', shown(model))
    out.print(f'\nAgain from the logs:\n  {escape(again)}', soft_wrap=True)


def stages(fits: tuple[Fit, Fit, Fit]) -> Table:
    """Return how residual and errors fall from stage to stage."""
    return Table('stages', 'What became of the error', (
        words('stage', 'stage', NUMBERED),
        micrometre_column('residual_um', 'residual', [fit.rms for fit in fits]),
        *(column(of_all[0].curve, of_all[0].curve, [1e6 * one.range for one in of_all], partial(fixed, places=2), unit)
          for of_all, unit in zip(zip(*(error_lines(fit.error_motions) for fit in fits)), CURVE_UNITS))),
        note='Residual: standard deviation of a coordinate; errors: peak to valley.')
