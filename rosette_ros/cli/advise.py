# SPDX-License-Identifier: Apache-2.0
"""rosette advise: what an order of measurement can show, and what to measure next."""

import math

from rich.markup import escape

from rosette_ros.analysis import advise, advise_run
from rosette_ros.cli.arguments import add_formats, positive, whole
from rosette_ros.cli.human import sentence
from rosette_ros.cli.main import UsageError
from rosette_ros.cli.screen import console, print_json, table
from rosette_ros.core.effects.library import effect
from rosette_ros.core.scheme import ORDERS, TURNINGS
from rosette_ros.data.open_run import open_run
from rosette_ros.diagnosis_json import advice_json
from rosette_ros.words import duration, exact, fixed, micro, percent

MOST_BALLS = 72
RADIUS_MM = 182.5
HIDDEN, WEAK = 0.05, 0.3


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('run_path', metavar='RUN', nargs='?', help='log directory, .mcap file or '
                        'ball-centre table (CSV); instead of a run, --balls and --order')
    parser.add_argument('--balls', metavar='N', type=whole(None, MOST_BALLS),
                        help='balls on the plate = table positions')
    parser.add_argument('--order', help=f'one of {", ".join(ORDERS)}')
    parser.add_argument('--radius-mm', metavar='R', type=positive('mm'), default=RADIUS_MM,
                        help=f'radius of the circle of ball centres (default {RADIUS_MM:g})')
    parser.add_argument('--turning', default='forward',
                        help=f'sense of the table: {" or ".join(TURNINGS)} (default forward)')
    parser.add_argument('--seed', type=whole(0, 2**63 - 1), default=0,
                        help='draws the order random (default 0)')
    parser.add_argument('--show', metavar='EFFECT', action='append', default=[],
                        help='an effect that the next run must show; may stand several times '
                        '(default: all that the present order shows badly)')
    add_formats(parser)


def run(options):
    """Print the advice."""
    wanted = tuple(effect(name).name for name in options.show)
    planned = (options.balls, options.order)
    if options.run_path is not None and planned == (None, None):
        measured = open_run(options.run_path)
        advice = advise_run(measured, wanted, options.seed)
        n, radius, run_id = measured.n, measured.radius, measured.run_id
    elif options.run_path is None and None not in planned:
        n, radius, run_id = options.balls, 1e-3 * options.radius_mm, ''
        advice = advise(n, options.order, radius, wanted=wanted, turning=options.turning,
                        seed=options.seed)
    else:
        raise UsageError('advise: wanted either RUN or both --balls and --order')
    if options.json:
        print_json(advice_json(advice, n, radius, run_id))
    else:
        show(advice, n, radius)


def show(advice, n, radius):
    """Print an Advice for a person."""
    out = console()
    out.print(f'[bold]{n} balls on R = {exact(1e3 * radius, 6)} mm, order '
              f'{escape(advice.present.label)}[/]\n{sentence(advice.text)}\n')
    out.print(effect_table(advice))
    out.print()
    out.print(order_table(advice))
    if advice.best.label != advice.present.label:
        best = advice.best
        turning = '' if best.label == best.order else f' --turning {best.turning}'
        out.print(f'\nIts target list: rosette plan --balls {n} --radius-mm '
                  f'{exact(1e3 * radius, 6)} --order {best.order} --seed {best.seed}{turning}',
                  soft_wrap=True)


def effect_table(advice):
    """Return what present and recommended order show of every effect."""
    made = table(title='What the orders show: visible share; smallest rms size that is found')
    for name, side in (('effect', 'left'), (f'now\n{advice.present.label}', 'right'),
                       ('µm', 'right'), (f'next\n{advice.best.label}', 'right'), ('µm', 'right'),
                       ('looks now like', 'left')):
        made.add_column(name, justify=side, no_wrap=name in ('effect', 'µm'), overflow='fold')
    best = {entry.name: entry for entry in advice.best.visibilities}
    for now in advice.present.visibilities:
        made.add_row(escape(now.name), *_shown(now), *_shown(best[now.name]),
                     escape(', '.join(now.alike)))
    return made


def _shown(entry):
    """Return typical share and detectable size of an effect in one order."""
    if entry.reason:
        return 'not judged', '–'
    share = percent(entry.typical_share)
    if entry.typical_share < HIDDEN:
        share = f'[red]{share}[/]'
    elif entry.typical_share < WEAK:
        share = f'[yellow]{share}[/]'
    return share, micro(entry.detectable, 2) if math.isfinite(entry.detectable) else '–'


def order_table(advice):
    """Return the comparison of the orders for what is wanted."""
    made = table(title='Orders compared by what they show worst')
    for name, side in (('order', 'left'), ('worst', 'left'), ('visible', 'right'),
                       ('moves take', 'right'), ('whole run', 'right')):
        made.add_column(name, justify=side, no_wrap=True)
    for order in sorted(advice.orders, key=lambda order: -order.worst):
        made.add_row(escape(order.label), order.worst_effect, fixed(100 * order.worst, 0) + ' %',
                     duration(order.travel_time), duration(order.duration),
                     style='bold' if order.label == advice.best.label else None)
    return made
