# SPDX-License-Identifier: Apache-2.0
"""rosette verify: whether a correction did what it promised, by a run before and one after."""

from argparse import ArgumentParser, Namespace

from rosette_ros.analysis import analyse
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, head, print_json, print_parts, print_verdict, warn
from rosette_ros.core.correction_check import backward_share, check_correction
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_identified
from rosette_ros.presentation.correction_results import check_json, check_table

NOT_CONFIRMED = 1
"""Exit code; 0 where the correction did what it promised."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    for when in ('before', 'after'):
        parser.add_argument(when, metavar=when.upper(), help=f'run {when} the correction: log or table')
    parser.add_argument('--correction', metavar='FILE', required=True,
                        help='the correction (rosette correct RUN --for ros)')
    add_shared(parser, '--model', '--json')


def run(options: Namespace) -> int:
    """Print what became of each error; return 0 where the correction did what it promised, else 1."""
    correction, serial = read_correction(options.correction)
    model = read_model(options.model)
    opened = [open_identified(path) for path in (options.before, options.after)]
    before, after = (analyse(run, model) for run, _, _ in opened)
    others = [f'{path}: is of table {identity["table.serial"]}, the correction of table {serial}'
              for path, (_, identity, _) in zip((options.before, options.after), opened)
              if serial and identity['table.serial'] not in ('', serial)]
    first, second = (fit.error_motions.turned_back(fit.run.table_offset) for fit in (before, after))
    check = check_correction(first, second, correction, others,
                             (backward_share(before.run), backward_share(after.run)))
    code = 0 if check.level is Level.GOOD else NOT_CONFIRMED
    if options.json:
        print_json({**check_json(check, (before.run.run_id, after.run.run_id)), 'remarks': others})
        return code
    out = console()
    for fit in (before, after):
        out.print(head(fit.run))
        warn(fit.run)
    if before.run.table_offset:
        out.print('The curves below are along x and y of table angle 0, as those of the correction.')
    print_verdict(out, check)
    print_parts(out, [check_table(check)])
    return code
