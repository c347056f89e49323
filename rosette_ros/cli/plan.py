# SPDX-License-Identifier: Apache-2.0
"""What a plan measures and determines, plans side by side; what an order can show.

The list of an order is Table 1 of Kniel et al. (2019) for any n.
"""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.markup import escape

from rosette_ros.api.plans import USUAL_RADIUS_MM, Plan, advise, next_readings, plan
from rosette_ros.cli import arguments
from rosette_ros.cli.arguments import UsageError, add_shared, number, positive, whole
from rosette_ros.cli.console import console, doing, pairs, print_json, print_parts, warn
from rosette_ros.cli.opened import Opened
from rosette_ros.core.planning.advice import Advice
from rosette_ros.core.planning.next_readings import UNTIL
from rosette_ros.core.planning.plan_comparison import MOST_BALLS as MOST_JUDGED
from rosette_ros.core.planning.plan_comparison import Outlook
from rosette_ros.core.planning.size import MOST_BALLS as MOST_ADVISED
from rosette_ros.core.run import axes
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.scheme import ORDERS, TURNINGS
from rosette_ros.core.run.touches import TOUCHES, Pace
from rosette_ros.invocation import command, program
from rosette_ros.presentation import plan_results as results
from rosette_ros.presentation import tables
from rosette_ros.presentation.formatting import millimetres
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.effect_words import exact
from rosette_ros.words.plan_words import better_words

MOST_BALLS = 1000
WIDEST_MAP = 20
"""Most balls for which the map of the scheme fits on a screen."""
MOST_NEXT = 1000
"""Next readings that may be asked for at once."""


def plan_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('plans', metavar='PLAN', nargs='*', help='plan files or orders, several to compare them; an '
                        'order may name its CMM positions as in there_and_back:8, diagonal:50%% or row:1,5,7,10')
    add_plan(parser, MOST_BALLS)
    arguments.add_places(parser)
    arguments.add_table_offset(parser)
    arguments.add_shared(parser, '--plate')
    parser.add_argument('--touches', type=int, choices=TOUCHES, help='touches of each ball (default: as the CMM '
                        'usually does)')
    parser.add_argument('--sigma-um', metavar='S', type=positive('µm'), default=0.1, help='standard deviation of a '
                        'coordinate from 20 touches, for the expected uncertainties (default 0.1)')
    parser.add_argument('--touch-s', metavar='S', type=positive('s'), help='time of a touch, the way to '
                        f'the ball included (default {Pace.touch:g})')
    parser.add_argument('--table-move-s', metavar='S', type=positive('s'), help='time of a move of the table (default: '
                        'at usual speeds)')
    parser.add_argument('--axis', metavar=('X', 'Y', 'Z'), type=number('a direction'), nargs=3,
                        help='direction of the table axis in the machine, for what the plan shows of gravity and of '
                        'the axes of the CMM (default 0 0 1)')
    parser.add_argument('-o', '--output', metavar='FILE', help='write the plan as a file for calibrate --plan, CSV')
    parser.add_argument('--figures', metavar='DIR', help='write the pictures of the plan, or of the comparison')
    arguments.add_shared(parser, '--inputs', '--environment')
    arguments.add_shared(parser, '--experience', help='with --environment: what earlier runs of the cell have taught '
                         '(YAML, rosette-experience/1), so that U of what an order hides is that of this cell')
    arguments.add_shared(parser, '--angle-unit', '--format', '--force')
    group = arguments.add_formats(parser, csv='print the list as a table, coordinates with two decimals; of several '
                                  'plans what they determine')
    group.add_argument('--csv-template', action='store_true', help='print an empty ball-centre table, to be filled in; '
                       'rows that stay without coordinates are missing balls')


def add_plan(parser: ArgumentParser, most_balls: int, radius_mm: float | None = None) -> None:
    """Add what plans a run: --balls, --order, --radius-mm, --turning, --seed."""
    default = '' if radius_mm is None else f' (default {radius_mm:g})'
    parser.add_argument('--balls', metavar='N', type=whole(None, most_balls),
                        help='balls on the plate = table positions')
    parser.add_argument('--order', help=f'one of {", ".join(ORDERS)}')
    parser.add_argument('--radius-mm', metavar='R', type=positive('mm'), default=radius_mm,
                        help=f'radius of the circle of ball centres{default}')
    parser.add_argument('--turning', default='forward',
                        help=f'sense of the table: {" or ".join(TURNINGS)} (default forward)')
    parser.add_argument('--seed', type=whole(0, 2**63 - 1), default=0, help='draws the order random (default 0)')


def run_plan(options: Namespace) -> None:
    """Print the plan, or several plans."""
    if options.environment and options.order is None and not options.plans:
        options.plans = [*ORDERS]
    if (options.order is not None) == bool(options.plans):
        raise UsageError('plan: expected either --order, or plan files and orders to compare')
    if options.format and not options.figures:
        raise UsageError('plan: --format goes with --figures only; leave it out')
    try:
        axes.axis_rotation(options.axis) if options.axis else None
    except InvalidData as error:
        raise UsageError(f'--axis: {error}') from None
    made = plan(*(options.plans or [options.order]), balls=options.balls, radius_mm=options.radius_mm,
                turning=options.turning, seed=options.seed, cmm_positions=options.cmm_positions,
                balls_in_use=options.balls_in_use, plate=options.plate,
                table_offset_deg=options.table_offset_deg or 0.0, touches=options.touches or 0,
                sigma_um=options.sigma_um, touch_s=options.touch_s or Pace.touch, table_move_s=options.table_move_s,
                axis=options.axis, inputs=options.inputs, environment=options.environment,
                experience=options.experience)
    only = made if isinstance(made, Plan) else None
    if only is None and (options.output or options.csv_template):
        raise UsageError('plan: expected one plan to write, found several; leave out --output and --csv-template')
    if only and options.output:
        if Path(options.output).suffix.lower() != '.csv':
            raise UsageError(f'--output: expected a name that ends in .csv, found {options.output!r}')
        only.write(options.output, options.force)
    if only and (options.csv or options.csv_template):
        scheme, radius_mm = only.measuring.scheme, 1e3 * only.radius
        sys.stdout.write((results.template if options.csv_template else results.target_list)(scheme, radius_mm))
        return
    outlooks = [one.outlook for one in ([only] if only else made.plans)]
    if options.figures:
        draw(outlooks, options)
    if options.json:
        print_json(made.to_mapping())
    elif options.csv:
        sys.stdout.write(results.comparison(outlooks).csv())
    elif only:
        show_plan(only.outlook, options.output)
    else:
        show_comparison(outlooks)


def draw(plans: Sequence[Outlook], options: Namespace) -> None:
    """Write the pictures of plans into the folder of the options; matplotlib is loaded only here."""
    arguments.plots('plot_style').save_all(
        arguments.plots('plan_plots').pictures_of_plans(plans),
        arguments.made_folder(options.figures, 'to write to', ''), options.format or 'svg', options.force)


def show_plan(made: Outlook, output: str | None = None) -> None:
    """Print a plan for a person: map, list, motion, what it determines and shows; output: the file that holds it."""
    out, scheme, expected, radius_mm = console(), made.scheme, made.expectation, 1e3 * made.radius
    way = scheme.travel(made.radius)
    balls, start = np.unique(scheme.ball), f' from {np.rad2deg(scheme.table_offset):g}° on' * bool(scheme.table_offset)
    out.print(f'[bold]{scheme.ball.size} targets[/]: {balls.size} balls on a circle of R = {exact(radius_mm, 6)} mm, '
              f'{scheme.n} table positions{start}, order {escape(scheme.order)}')
    in_use = [(name, places) for name, places in (('CMM positions', np.unique(scheme.cmm_position)),
                                                  ('Ball places', balls)) if places.size < scheme.n]
    print_parts(out, [
        results.sequence_map(scheme) if scheme.n <= WIDEST_MAP else None, results.targets(scheme, radius_mm),
        results.uncertainties(made), results.effects(made), pairs([
            *((name, f'{", ".join(map(str, places))} of {scheme.n} in use; deviations of the others are not measured')
              for name, places in in_use),
            *([] if made.rotation is None else [('Axis', axes.words(made.rotation[:, 2]))]),
            ('Table', f'{way.table_turns:.4g} turns in {way.table_moves} moves'),
            ('CMM', f'{way.cmm_way:.4g} m in {way.cmm_moves} moves (straight from ball to ball)'),
            ('Determines', f'{expected.rank} of the {expected.full_rank} combinations of errors that a complete run '
                           f'determines; the curves with {expected.penalty:.2f} times its uncertainty (at best '
                           f'{expected.ideal:.2f} times with so many readings)'),
            ('Not determined', '; '.join(expected.unobservable)),
            *([] if made.effects else [('Effects', f'are judged up to {MOST_JUDGED} balls')]),
            ('Time', f'{expected.duration / 3600:.2f} h'),
            ('Order', CASES.get(scheme.order, 'own')), ('Paper', 'Kniel et al., Measurement 2019')])])
    if output:
        out.print(f'\nWritten to {escape(output)}. Measure with: {program()} calibrate --plan {escape(output)}',
                  soft_wrap=True)


def show_comparison(plans: Sequence[Outlook]) -> None:
    """Print plans side by side, and which is better where."""
    out = console()
    print_parts(out, [results.comparison(plans), results.shares(plans)])
    out.print()
    for sentence in better_words(plans):
        out.print(escape(sentence))
    if plans[0].environment:
        out.print(escape(f'Least U in the environment {plans[0].environment.name}: '
                         f'{min(plans, key=lambda one: one.penalty).name}.'))
    if not all(one.effects for one in plans):
        out.print(f'Effects are judged up to {MOST_JUDGED} balls.')


CASES = {
    'row': 'table outside, CMM and plate inside (case 1 of the paper): acceptance after VDI/VDE 2617-4',
    'diagonal': 'CMM outside, table and plate inside (case 2 of the paper): mean systematic error of the table',
    'column': 'ball outside, CMM and table inside (case 3 of the paper): table and CMM alike',
    'random': 'shuffled: drift in time is spread over all positions',
    'interleaved': 'designed: shows every effect of the library, with little travel',
    'there_and_back': 'diagonal at half the CMM positions, then the same backwards: shows every effect of the '
                      'library',
    'row_there_and_back': 'row at half the CMM positions, then the same backwards: quickest where the table moves '
                          'slowly',
}


def advise_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('run_path', metavar='RUN', nargs='?', help='log directory, .mcap file or '
                        'ball-centre table (CSV); instead of a run, --balls and --order')
    add_plan(parser, most_balls=MOST_ADVISED, radius_mm=USUAL_RADIUS_MM)
    parser.add_argument('--show', metavar='EFFECT', action='append', default=[],
                        help='an effect that the next run must show; may be given several times '
                        '(default: all that the present order shows weakly)')
    parser.add_argument('--readings', metavar='N', type=whole(1, MOST_NEXT), help='the next N readings of RUN, by '
                        'which the explanations that are in doubt part most')
    parser.add_argument('--until', metavar='P', type=arguments.until, help='with --readings: probability from which on '
                        f'a cause is settled (default {UNTIL:g})')
    parser.add_argument('--plan', metavar='FILE', help='with --readings: write what was measured, and they, as a plan '
                        'for calibrate --plan, CSV')
    add_shared(parser, '--run-id', '--columns', '--model', '--inputs', '--environment')
    add_shared(parser, '--experience', help='what earlier runs of the cell have taught (YAML, rosette-experience/1): '
               'the next run must show its causes; with --readings: their prior')
    add_shared(parser, '--any-cell', '--angle-unit', '--json', '--force')


def run_advise(options: Namespace) -> None:
    """Print the advice."""
    if options.readings is not None:
        advise_readings(options)
        return
    for name in ('until', 'plan', 'model'):
        if getattr(options, name) is not None:
            raise UsageError(f'advise: --{name} goes with --readings only; leave it out')
    run = options.run_path
    if run is not None and options.balls is None and options.order is None:
        run = Opened(options).run
        warn(run)
    with doing('comparing orders'):
        made = advise(run, balls=options.balls, order=options.order, radius_mm=options.radius_mm,
                      turning=options.turning, seed=options.seed,
                      show=options.show, inputs=options.inputs, environment=options.environment,
                      experience=options.experience)
    if options.json:
        print_json(made.to_mapping())
    else:
        show_advice(made.advice, made.n, made.radius)


def advise_readings(options: Namespace) -> None:
    """Print the next readings of a run, and write them as a plan."""
    if options.run_path is None or options.order is not None or options.show:
        raise UsageError('advise: --readings: expected RUN, without --order and --show')
    if options.plan and Path(options.plan).suffix.lower() != '.csv':
        raise UsageError(f'--plan: expected a name that ends in .csv, found {options.plan!r}')
    opened = Opened(options)
    run = opened.run
    warn(run)
    made = next_readings(run, opened.model, options.readings, options.until or UNTIL)
    if options.plan and made.plan:
        made.plan.write(options.plan, options.force)
    if options.json:
        print_json(made.to_mapping())
        return
    out = console()
    for sentence in made.sentences():
        out.print(escape(sentence), soft_wrap=True)
    if made.plan:
        print_parts(out, made.tables())
        if options.plan:
            out.print(f'\nWritten to {escape(options.plan)}, after the {run.size} readings of the run. '
                      f'Measure with: {program()} calibrate --plan {escape(options.plan)}', soft_wrap=True)


def show_advice(advice: Advice, n: int, radius: float) -> None:
    """Print an advice; radius: m."""
    out, best = console(), advice.best
    balls = f'{len(advice.balls)} balls at {n} table positions' if advice.balls else f'{n} balls'
    out.print(f'[bold]{balls} on R = {millimetres(radius)}, order {escape(advice.present.label)}[/]\n'
              f'{escape(advice_words(advice))}')
    print_parts(out, [
        tables.visibility(advice.present.visibilities, best.visibilities).select(
            'effect', 'typical_visible_fraction', 'detectable_rms_um', 'recommended_order_visible_fraction',
            'recommended_order_detectable_rms_um', 'remark'),
        tables.orders(advice).select('order', 'mark', 'worst_effect', 'worst_share', 'U_ct', 'U_cr',
                                     'travel_time_s', 'duration_s')])
    if best.label != advice.present.label:
        turning = () if best.label == best.order else ('--turning', best.turning)
        places = ('--balls-of', ','.join(map(str, advice.balls))) if advice.balls else ()
        made = command('plan', '--balls', n, '--radius-mm', exact(1e3 * radius, 6), '--order', best.order,
                       '--seed', best.seed, *turning, *places)
        out.print(f'\nIts target list: {escape(made)}', soft_wrap=True)


IMPLEMENTED = {'plan': (plan_arguments, run_plan), 'advise': (advise_arguments, run_advise)}
