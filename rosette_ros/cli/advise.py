# SPDX-License-Identifier: Apache-2.0
"""rosette advise: which effects an order of measurement shows, and what to measure next."""

from argparse import ArgumentParser, Namespace

from rich.markup import escape

from rosette_ros import command
from rosette_ros.analysis import advise, advise_run
from rosette_ros.cli.arguments import UsageError, add_shared
from rosette_ros.cli.console import console, print_json, print_parts, warn
from rosette_ros.cli.plan import USUAL_RADIUS_MM, add_plan
from rosette_ros.core.effects.library import effect
from rosette_ros.core.planning.advice import Advice
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation import tables
from rosette_ros.presentation.formatting import exact, millimetres
from rosette_ros.presentation.json_output import advice_json
from rosette_ros.words.advice_words import advice_words


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('run_path', metavar='RUN', nargs='?', help='log directory, .mcap file or '
                        'ball-centre table (CSV); instead of a run, --balls and --order')
    add_plan(parser, most_balls=72, radius_mm=USUAL_RADIUS_MM)
    parser.add_argument('--show', metavar='EFFECT', action='append', default=[],
                        help='an effect that the next run must show; may be given several times '
                        '(default: all that the present order shows weakly)')
    add_shared(parser, '--json')


def run(options: Namespace) -> None:
    """Print the advice."""
    wanted = tuple(effect(name).name for name in options.show)
    planned = (options.balls, options.order)
    if options.run_path is not None and planned == (None, None):
        measured = open_run(options.run_path)
        warn(measured)
        advice = advise_run(measured, wanted, options.seed)
        n, radius, run_id = measured.n, measured.radius, measured.run_id
    elif options.run_path is None and None not in planned:
        n, radius, run_id = options.balls, 1e-3 * options.radius_mm, ''
        advice = advise(n, options.order, radius, wanted=wanted, turning=options.turning, seed=options.seed)
    else:
        raise UsageError('advise: wanted either RUN or both --balls and --order')
    if options.json:
        print_json(advice_json(advice, n, radius, run_id))
    else:
        show(advice, n, radius)


def show(advice: Advice, n: int, radius: float) -> None:
    """Print an advice; radius: m."""
    out, best = console(), advice.best
    balls = f'{len(advice.balls)} balls at {n} table positions' if advice.balls else f'{n} balls'
    out.print(f'[bold]{balls} on R = {millimetres(radius)}, order {escape(advice.present.label)}[/]\n'
              f'{escape(advice_words(advice))}')
    print_parts(out, [
        tables.visibility(advice.present.visibilities, best.visibilities).select(
            'effect', 'typical_visible_fraction', 'detectable_rms_um', 'recommended_order_visible_fraction',
            'recommended_order_detectable_rms_um', 'remark'),
        tables.orders(advice).select('order', 'mark', 'worst_effect', 'worst_share', 'travel_time_s', 'duration_s')])
    if best.label != advice.present.label:
        turning = () if best.label == best.order else ('--turning', best.turning)
        places = ('--balls-of', ','.join(map(str, advice.balls))) if advice.balls else ()
        made = command('plan', '--balls', n, '--radius-mm', exact(1e3 * radius, 6), '--order', best.order,
                       '--seed', best.seed, *turning, *places)
        out.print(f'\nIts target list: {escape(made)}', soft_wrap=True)
