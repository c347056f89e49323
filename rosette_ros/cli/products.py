# SPDX-License-Identifier: Apache-2.0
"""What follows from a run: a correction, whether it did what it promised, the uncertainty budget."""

import re
from argparse import ArgumentParser, Namespace
from contextlib import nullcontext
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from rosette_ros.api.correction_targets import STEPS, TURN, correction_file, is_controller
from rosette_ros.api.evaluating import Corrected, budgeted, corrected, corrected_jointly
from rosette_ros.cli.arguments import UsageError, add_shared, number, picture_file, plots, positive, whole
from rosette_ros.cli.console import COLOURS, console, doing, head, print_json, print_parts, print_verdict, warn
from rosette_ros.cli.opened import Opened, add_archived, add_joint, is_joint, joint, take_archived
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.correction_check import backward_share, check_correction
from rosette_ros.core.uncertainty.budget_monte_carlo import MonteCarlo
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.invocation import command
from rosette_ros.io.controller_tables import Axis
from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.open_run import joint_identity
from rosette_ros.io.text_file import refuse_output, write_text
from rosette_ros.presentation.budget_results import agreement_words, budget_tables, together_words
from rosette_ros.presentation.correction_results import check_json, check_table, correction_table
from rosette_ros.words.budget_words import not_considered
from rosette_ros.words.verdict_words import verdict_text

NOT_CONFIRMED = 1
"""Exit code; 0 where the correction did what it promised."""
FEWEST_TRIALS, MOST_TRIALS = 100, 1_000_000
MOST_LINES, MOST_RANGE = 100_000, 36_000
"""Lines of a table, and its farthest angle, deg; controllers read fewer."""


def correct_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='*')
    add_archived(parser)
    add_shared(parser, '--run-id', '--columns', '--model')
    add_joint(parser)
    add_shared(parser, '--identity', '--inputs', '--environment', '--angle-unit')
    parser.add_argument('--for', dest='target', choices=('ros', *STEPS), default='ros',
                        help='ros: rosette-correction/1 (YAML) for table_corrector, verify and the simulated machine; '
                             'csv: a table; linuxcnc: a compensation file, COMP_FILE_TYPE = 1; sinumerik-enc, '
                             'sinumerik-cec, heidenhain (.COM), fanuc (pitch errors): tables of controllers '
                             '(default ros)')
    parser.add_argument('-o', '--output', metavar='FILE', required=True, help='file to write')
    parser.add_argument('--curves', metavar='LIST', help='which errors are taken off, such as crz,ctz (default: all '
                        'six; for a controller crz, since it turns the table only)')
    parser.add_argument('--step', metavar='DEG', type=positive('deg'),
                        help='distance of the lines of a table (default 5; 2 for linuxcnc, 3.2768 for heidenhain)')
    parser.add_argument('--range', metavar=('MIN', 'MAX'), nargs=2, type=number('deg', MOST_RANGE),
                        help='angles of the table, deg; for linuxcnc MIN_LIMIT and MAX_LIMIT of the axis '
                             '(default 0 360)')
    parser.add_argument('--axis', metavar='NAME', help="the controller's axis (default C); C': of ISO 841, a table "
                        'that carries the workpiece, which counts clockwise')
    parser.add_argument('--sign', choices=('1', '-1'), help='sense in which the axis counts: 1 counter-clockwise seen '
                        "from above (default; with C' -1)")
    parser.add_argument('--zero', metavar='DEG', type=number('deg', 360),
                        help='where the axis is at table angle 0 (default 0)')
    parser.add_argument('--invert', action='store_true', default=None, help='of sinumerik-cec, heidenhain and '
                        'fanuc: the controller takes the values the other way, which a trial at one position shows')
    parser.add_argument('--detection-unit', metavar='DEG', type=positive('deg'), help='of fanuc (default 0.0001)')
    add_shared(parser, '--force')


def run_correct(options: Namespace) -> None:
    """Write the file and say what is in it."""
    chosen = ('crz',) if is_controller(options.target) else CURVES
    if options.curves is not None:
        chosen = tuple(options.curves.split(','))
    if [one for one in chosen if one not in CURVES]:
        raise UsageError(f'--curves: expected some of {",".join(CURVES)}, found {options.curves!r}')
    for name, targets in (('step', [*STEPS]), ('range', ['csv', 'linuxcnc']), ('detection_unit', ['fanuc']),
                          ('invert', ['sinumerik-cec', 'heidenhain', 'fanuc']),
                          *((one, [*STEPS][1:]) for one in ('axis', 'sign', 'zero'))):
        if getattr(options, name) is not None and options.target not in targets:
            raise UsageError(f'correct: --{name.replace("_", "-")} goes with --for {", ".join(targets)} only; leave '
                             'it out')
    axis = options.axis or 'C'
    if not re.fullmatch(r"[A-Za-z]\w*'?", axis):
        raise UsageError(f'--axis: expected the name of an axis such as C, C1 or C\', found {axis!r}')
    controller = Axis(axis.rstrip("'"), int(options.sign or (-1 if axis.endswith("'") else 1)), options.zero or 0.0,
                      options.detection_unit or 1e-4, -1 if options.invert else 1)
    if options.target == 'ros' and Path(options.output).suffix.lower() == '.csv':
        raise UsageError(f'--output: expected a name for YAML with --for ros, found {options.output!r}; --for csv '
                         'writes a '
                         'table')
    low, high = options.range or TURN
    if not low < high:
        raise UsageError(f'correct: --range: expected MIN below MAX, found {low:g} and {high:g}')
    step = options.step or STEPS.get(options.target, 0.0)
    if step and (high - low) / step > MOST_LINES:
        raise UsageError(f'correct: expected a table of at most {MOST_LINES} lines, found --range {low:g} {high:g} '
                         'with '
                         f'--step {step:g}; take a larger --step or a smaller --range')
    refuse_output(options.output, options.force)
    made = _correction(options, chosen)
    correction, verdict, unknown = made.correction, made.verdict, made.unknown
    text, notes = correction_file(correction, options.target, made.serial, step, (low, high), controller)
    write_text(options.output, text, options.force)
    out = console()
    if verdict:
        out.print(f'[{COLOURS[verdict.level]}]{escape(verdict_text(verdict).sentence)}[/]')
    if made.which:
        out.print(f'Curves: {made.which}.')
    print_parts(out, [correction_table(correction)])
    lines = list(notes)
    if unknown:
        lines.append(f'Not corrected, as the runs do not tell it: the mean of the reversal of {", ".join(unknown)}.')
    lines.append(f'File: {options.output}')
    if options.target == 'ros':
        lines.append('After a run with the correction, whether it did what it promised:\n  '
                     + command('verify', options.run_path[0], 'AFTER', '--correction', options.output,
                               *(('--model', options.model) if options.model else ())))
    out.print('\n' + escape('\n'.join(lines)), soft_wrap=True)


def _correction(options: Namespace, curves: tuple[str, ...]) -> Corrected:
    """Return the correction from the runs of the options."""
    take_archived(options)
    if is_joint(options):
        identity = joint_identity(list(zip(options.run_path, options.run_ids)), options.identity)[0]
        return corrected_jointly(joint(options).result, identity['table.serial'], curves)
    return corrected(Opened(options, options.run_path[0]), curves)


def verify_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    for when in ('before', 'after'):
        parser.add_argument(when, metavar=when.upper(), help=f'run {when} the correction: log or table')
    parser.add_argument('--correction', metavar='FILE', required=True,
                        help='the correction (rosette correct RUN --for ros)')
    add_shared(parser, '--columns', '--model', '--inputs', '--environment', '--angle-unit', '--json')


def run_verify(options: Namespace) -> int:
    """Print what became of each error; return 0 where the correction did what it promised, else 1."""
    correction, serial = read_correction(options.correction)
    opened = [Opened(options, path) for path in (options.before, options.after)]
    before, after = (one.fit for one in opened)
    others = [f'{one.path}: is of table {one.identity["table.serial"]}, the correction of table {serial}'
              for one in opened if serial and one.identity['table.serial'] not in ('', serial)]
    first, second = (one.motions.turned_back(one.run.table_offset) for one in opened)
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


def budget_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--run-id', '--columns', '--model', '--inputs', '--environment', '--angle-unit')
    parser.add_argument('--hidden-effects', action='store_true', help='add bounds of effects that are not in the model '
                        'and that this order of measurement hides')
    parser.add_argument('--monte-carlo', metavar='N', type=whole(FEWEST_TRIALS, MOST_TRIALS),
                        help='repeat the run N times with drawn contributions and compare (GUM S1, S2); '
                        'fewer than 1000 decide nothing, 10000 are usual')
    parser.add_argument('--seed', type=whole(0, 2**63 - 1), help='of the Monte Carlo (default 0)')
    parser.add_argument('-o', '--output', metavar='FILE', type=picture_file,
                        help='draw the bars (.png, .svg or .pdf)')
    add_shared(parser, '--force', '--json')


def run_budget(options: Namespace) -> None:
    """Print the budget."""
    if options.seed is not None and not options.monte_carlo:
        raise UsageError('budget: --seed goes with --monte-carlo only; leave it out')
    if options.output:
        refuse_output(options.output, options.force)
    opened, trials = Opened(options), options.monte_carlo or 0
    with doing('Monte Carlo', trials) if trials else nullcontext(lambda **_: None) as step:
        one = budgeted(opened, options.hidden_effects, trials, options.seed or 0, lambda done: step(done=done))
    made, found = one.made, one.found
    if options.output:
        plots('plot_style').save(plots('comparison_plots').budget_bars(made, found), options.output, options.force)
    if options.json:
        print_json(one.to_mapping())
        return
    out = console()
    opened.begin(out)
    show_budget(out, made, found)
    if not options.hidden_effects:
        out.print('Bounds of effects that this order hides: --hidden-effects')
    if options.output:
        out.print(f'\nPicture: {escape(str(options.output))}', soft_wrap=True)


def show_budget(out: Console, made: Budget, found: MonteCarlo | None = None) -> None:
    """Print a budget, what Monte Carlo says, and what is not considered."""
    print_parts(out, budget_tables(made, found))
    if found:
        colour = {True: 'green', False: 'red', None: 'yellow'}[found.agrees]
        out.print(f'[{colour}]{escape(agreement_words(found))}[/]')
        out.print(escape(together_words(found)))
    out.print('\n[bold]Not considered[/]')
    for sentence in not_considered(made):
        out.print(escape(f'- {sentence}'))


IMPLEMENTED = {
    'correct': (correct_arguments, run_correct), 'verify': (verify_arguments, run_verify),
    'budget': (budget_arguments, run_budget)}
