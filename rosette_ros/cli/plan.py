# SPDX-License-Identifier: Apache-2.0
"""rosette plan: the target list of a scheme, Table 1 of Kniel et al. (2019) for any n."""

import sys

import numpy as np
from rich.markup import escape

from rosette_ros.cli.arguments import add_formats, positive, whole
from rosette_ros.cli.screen import console, pairs, print_json, table
from rosette_ros.core.scheme import ORDERS, TURNINGS, plan
from rosette_ros.core.travel import travel
from rosette_ros.words import exact, fixed

MOST_BALLS = 1000
ANGLE_PLACES = 9
"""Decimals of an angle that is no whole number of degrees: 1e-9 deg is 3 pm at 182.5 mm."""
HEADER = 'seq,cmm_position,table_position,ball,x_mm,y_mm,z_mm,table_angle_deg'
WIDEST_MAP = 20
"""Most balls for which the map of the scheme fits on a screen."""


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('--balls', metavar='N', type=whole(None, MOST_BALLS), required=True,
                        help='balls on the plate = table positions')
    parser.add_argument('--radius-mm', metavar='R', type=positive('mm'), required=True,
                        help='radius of the circle of ball centres')
    parser.add_argument('--order', required=True, help=f'one of {", ".join(ORDERS)}')
    parser.add_argument('--seed', type=whole(0, 2**63 - 1), default=0,
                        help='draws the order random (default 0)')
    parser.add_argument('--turning', default='forward',
                        help=f'sense of the table: {" or ".join(TURNINGS)} (default forward)')
    add_formats(parser, csv='print the list as a table, coordinates with two decimals')


def run(options):
    """Print the plan."""
    scheme = plan(options.balls, options.order, options.seed, options.turning)
    radius = 1e-3 * options.radius_mm
    if options.csv:
        sys.stdout.write(format_table(scheme, options.radius_mm))
    elif options.json:
        print_json(plan_json(scheme, radius))
    else:
        show(scheme, options.radius_mm)


def rows(scheme, radius_mm):
    """Yield the texts of each target in the order of HEADER; no coordinate reads -0.00."""
    centres = scheme.centres(radius_mm)
    for seq, (k, i, j, centre) in enumerate(zip(
            scheme.cmm_position, scheme.table_position, scheme.ball, centres, strict=True), 1):
        yield (str(seq), str(k), str(i), str(j), *(fixed(float(value), 2) for value in centre),
               exact(360 * (int(i) - 1) / scheme.n, ANGLE_PLACES))


def format_table(scheme, radius_mm):
    """Return the target list as CSV text."""
    return '\n'.join([HEADER, *(','.join(row) for row in rows(scheme, radius_mm))]) + '\n'


def plan_json(scheme, radius):
    """Return the plan as plain lists and dicts, SI, schema rosette-plan/1."""
    way = travel(scheme, radius)
    return {
        'schema': 'rosette-plan/1', 'n': scheme.n, 'radius_m': radius, 'order': scheme.order,
        'seed': scheme.seed, 'cmm_position': scheme.cmm_position.tolist(),
        'table_position': scheme.table_position.tolist(), 'ball': scheme.ball.tolist(),
        'table_angle_rad': scheme.table_angle.tolist(), 'approach': scheme.approach.tolist(),
        'centre_m': scheme.centres(radius).tolist(),
        'travel': {'table_rad': way.table_angle, 'table_moves': way.table_moves,
                   'cmm_m': way.cmm_way, 'cmm_moves': way.cmm_moves}}


def show(scheme, radius_mm):
    """Print the plan for a person: the map, the list, what it costs in motion."""
    out = console()
    out.print(f'[bold]{scheme.n**2} targets[/]: {scheme.n} balls on a circle of R = '
              f'{exact(radius_mm, 6)} mm, {scheme.n} table positions, '
              f'order {escape(scheme.order)}')
    if scheme.n <= WIDEST_MAP:
        out.print(sequence_map(scheme))
    listing = table('seq', 'CMM pos.', 'table pos.', 'ball', 'x / mm', 'y / mm', 'z / mm',
                    'table / deg', 'turn', title='Targets')
    for row, sense in zip(rows(scheme, radius_mm), scheme.approach, strict=True):
        listing.add_row(*row, '+' if sense > 0 else '−')
    out.print(listing)
    way = travel(scheme, 1e-3 * radius_mm)
    out.print(pairs([
        ('Table', f'turns {way.table_turns:.4g} times round in {way.table_moves} moves'),
        ('CMM', f'goes {way.cmm_way:.4g} m in {way.cmm_moves} moves (straight from ball to ball)'),
        ('Order', CASES[scheme.order]),
    ]))


def sequence_map(scheme):
    """Return the map of the scheme: which measurement is made where (the paper's Figure 3)."""
    grid = np.zeros((scheme.n, scheme.n), dtype=int)
    grid[scheme.table_position - 1, scheme.ball - 1] = np.arange(1, scheme.n**2 + 1)
    made = table('table\\ball', *map(str, range(1, scheme.n + 1)),
                 title='When each ball is measured')
    for position, line in enumerate(grid, 1):
        made.add_row(str(position), *map(str, line))
    return made


CASES = {
    'row': 'table outside, CMM and plate inside (case 1): acceptance after VDI/VDE 2617-4',
    'diagonal': 'CMM outside, table and plate inside (case 2): mean systematic error of the table',
    'column': 'ball outside, CMM and table inside (case 3): table and CMM alike',
    'random': 'shuffled: drift in time is spread over all positions',
    'sensitive': 'designed: shows every effect of the library with little travel',
}
