# SPDX-License-Identifier: Apache-2.0
"""rosette plan: the target list of a scheme, Table 1 of Kniel et al. (2019) for any n, or plans for a given time."""

import argparse
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.markup import escape

from rosette_ros import program
from rosette_ros.cli.arguments import UsageError, add_formats, add_places, positive, whole
from rosette_ros.cli.console import console, pairs, print_json, print_parts
from rosette_ros.core.planning.advice import SECONDS_PER_BALL
from rosette_ros.core.planning.budget import propose
from rosette_ros.core.planning.expectation import Expectation, expect
from rosette_ros.core.records import CURVES
from rosette_ros.core.scheme import ORDERS, TURNINGS, Scheme, places_in_use, plan
from rosette_ros.core.touches import Pace
from rosette_ros.io.csv_parser import COLUMNS, SCHEMA
from rosette_ros.presentation.formatting import exact, plain, signs
from rosette_ros.presentation.table_format import Table, column

MOST_BALLS = 1000
ANGLE_PLACES = 9
"""Decimals of an angle that is no whole number of degrees: 1e-9 deg is 3 pm at 182.5 mm."""
HEADER = 'seq,cmm_position,table_position,ball,x_mm,y_mm,z_mm,table_angle_deg'
WIDEST_MAP = 20
"""Most balls for which the map of the scheme fits on a screen."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_plan(parser, MOST_BALLS, needs_order=False)
    add_places(parser)
    parser.add_argument('--sigma-um', metavar='S', type=positive('µm'), default=0.1,
                        help='standard deviation of a coordinate, for the expected uncertainties (default 0.1)')
    parser.add_argument('--hours', type=positive('h'), help='propose plans that take no longer, instead of --order')
    parser.add_argument('--drift-um', metavar='D', type=positive('µm'), default=0.0, help='with --hours: standard '
                        'deviation of a random walk of the frame after an hour (default: none)')
    parser.add_argument('--touch-s', metavar='S', type=positive('s'), default=Pace.touch,
                        help=f'with --hours: time of a touch (default {Pace.touch:g} s)')
    parser.add_argument('--table-move-s', metavar='S', type=positive('s'), default=Pace.table_move,
                        help=f'with --hours: time of a move of the table (default {Pace.table_move:g} s)')
    group = add_formats(parser, csv='print the list as a table, coordinates with two decimals')
    group.add_argument('--csv-template', action='store_true', help='print an empty ball-centre table, to be filled in; '
                       'rows that stay without coordinates are missing balls')


def add_plan(parser: argparse.ArgumentParser, most_balls: int, radius_mm: float | None = None,
             needs_order: bool = True) -> None:
    """Add what plans a run: --balls, --order, --radius-mm, required where it has no default, --turning, --seed."""
    required, default = radius_mm is None, '' if radius_mm is None else f' (default {radius_mm:g})'
    parser.add_argument('--balls', metavar='N', type=whole(None, most_balls), required=required,
                        help='balls on the plate = table positions')
    parser.add_argument('--order', required=required and needs_order, help=f'one of {", ".join(ORDERS)}')
    parser.add_argument('--radius-mm', metavar='R', type=positive('mm'), required=required, default=radius_mm,
                        help=f'radius of the circle of ball centres{default}')
    parser.add_argument('--turning', default='forward',
                        help=f'sense of the table: {" or ".join(TURNINGS)} (default forward)')
    parser.add_argument('--seed', type=whole(0, 2**63 - 1), default=0, help='draws the order random (default 0)')


def run(options: argparse.Namespace) -> None:
    """Print the plan."""
    if (options.hours is None) == (options.order is None):
        raise UsageError('plan: wanted either --order or --hours')
    if options.hours is not None:
        return show_proposals(options)
    scheme = plan(options.balls, options.order, options.seed, options.turning,
                  *(places_in_use(text, options.balls) for text in (options.cmm_positions, options.balls_in_use)))
    if options.csv_template:
        sys.stdout.write(template(scheme, options.radius_mm))
    elif options.csv:
        lines = (','.join(row) for row in rows(scheme, options.radius_mm))
        sys.stdout.write('\n'.join([HEADER, *lines]) + '\n')
    elif options.json:
        print_json(plan_json(scheme, 1e-3 * options.radius_mm, 1e-6 * options.sigma_um))
    else:
        show(scheme, options.radius_mm, options.sigma_um)


def show_proposals(options: argparse.Namespace) -> None:
    """Print the plans that a given time allows, best first."""
    if options.csv or options.csv_template:
        raise UsageError('--hours: wanted a list of plans as text or --json; choose one with --order, then --csv')
    sigma, drift, radius = 1e-6 * options.sigma_um, 1e-6 * options.drift_um, 1e-3 * options.radius_mm
    found = propose(options.balls, radius, options.hours, sigma, drift, Pace(options.touch_s, options.table_move_s))
    if options.json:
        print_json({'schema': 'rosette-proposals/1', 'n': options.balls, 'radius_m': radius,
                    'hours': options.hours, 'sigma_m': sigma, 'drift_m_per_sqrt_h': drift, 'plans': [
                        {'order': one.scheme.order, 'touches': one.touches, 'readings': one.scheme.ball.size,
                         'cmm_positions': np.unique(one.scheme.cmm_position).tolist(), 'duration_s': one.duration,
                         'relative_error': one.error, 'u': dict(zip(CURVES, one.u.tolist()))} for one in found]})
        return None
    out, best = console(), found[0]
    beside = f' and a frame that wanders by {options.drift_um:g} µm in an hour' if drift else ''
    out.print(f'{options.balls} balls in {options.hours:g} h, σ = {options.sigma_um:g} µm from 20 touches{beside}')
    print_parts(out, [Table('proposals', 'Plans that fit, best first', (
        column('order', 'order', [one.scheme.order for one in found], str),
        column('positions', 'CMM positions', [np.unique(one.scheme.cmm_position).size for one in found], str),
        column('readings', 'readings', [one.scheme.ball.size for one in found], str),
        column('touches', 'touches', [one.touches for one in found], str),
        column('hours', 'time', [one.duration / 3600 for one in found], lambda hours: f'{hours:.2f}', 'h'),
        column('error', 'error', [one.error for one in found], lambda error: f'{error:.2f}'),
        *(column(f'U_{curve}', f'U {curve}', [2e6 * one.u[k] for one in found], lambda value: f'{value:.2g}',
                 'µm' if k < 3 else 'µrad') for k, curve in enumerate(CURVES))))])
    places = '' if np.unique(best.scheme.cmm_position).size == options.balls else ' --cmm-positions ' + ','.join(
        map(str, np.unique(best.scheme.cmm_position)))
    out.print('\nerror: of the curves, relative to the uncertainty of a complete run of 20 touches without drift; U: '
              f'expanded, k = 2\nMeasure with: {program()} calibrate --order {best.scheme.order}{places} --touches '
              f'{best.touches}', soft_wrap=True)
    return None


def rows(scheme: Scheme, radius_mm: float) -> Iterator[tuple[str, ...]]:
    """Yield the texts of each target in the order of HEADER; no coordinate reads -0.00."""
    centres = scheme.centres(radius_mm)
    for seq, (k, i, j, centre) in enumerate(zip(
            scheme.cmm_position, scheme.table_position, scheme.ball, centres, strict=True), 1):
        yield (str(seq), str(k), str(i), str(j), *(plain(float(value), 2) for value in centre),
               exact(360 * (int(i) - 1) / scheme.n, ANGLE_PLACES))


def template(scheme: Scheme, radius_mm: float) -> str:
    """Return a ball-centre table whose coordinates, times and temperatures are to be filled in."""
    lines = [f'# schema: {SCHEMA}', f'# radius_mm: {radius_mm!r}', f'# balls: {scheme.n}', ','.join(COLUMNS)]
    for (seq, k, i, j, *_, angle), approach in zip(rows(scheme, radius_mm), scheme.approach.tolist(), strict=True):
        given = {'seq': seq, 'table_position': i, 'ball': j, 'cmm_position': k, 'table_angle_deg': angle,
                 'approach': str(approach)}
        lines.append(','.join(given.get(name, '') for name in COLUMNS))
    return '\n'.join([*lines, ''])


def plan_json(scheme: Scheme, radius: float, sigma: float) -> dict[str, Any]:
    """Return the plan as plain lists and dicts, SI, schema rosette-plan/1; sigma: of a coordinate, m."""
    way, expected = scheme.travel(radius), expect(scheme, radius)
    return {
        'schema': 'rosette-plan/1', 'n': scheme.n, 'radius_m': radius, 'order': scheme.order, 'seed': scheme.seed,
        'cmm_position': scheme.cmm_position.tolist(), 'table_position': scheme.table_position.tolist(),
        'ball': scheme.ball.tolist(), 'table_angle_rad': scheme.table_angle.tolist(),
        'approach': scheme.approach.tolist(), 'centre_m': scheme.centres(radius).tolist(),
        'travel': {'table_rad': way.table_angle, 'table_moves': way.table_moves,
                   'cmm_m': way.cmm_way, 'cmm_moves': way.cmm_moves},
        'expected': {'sigma_m': sigma, 'rank': expected.rank, 'rank_of_a_complete_run': expected.full_rank,
                     'u': dict(zip(CURVES, (sigma * expected.u).T.tolist())), 'relative_uncertainty': expected.penalty,
                     'ideal_relative_uncertainty': expected.ideal, 'duration_s': expected.duration}}


def show(scheme: Scheme, radius_mm: float, sigma_um: float) -> None:
    """Print the plan for a person: the map, the list, the motion that it takes, what it determines."""
    out, way, expected = console(), scheme.travel(1e-3 * radius_mm), expect(scheme, 1e-3 * radius_mm)
    out.print(f'[bold]{scheme.ball.size} targets[/]: {scheme.n} balls on a circle of R = {exact(radius_mm, 6)} mm, '
              f'{scheme.n} table positions, order {escape(scheme.order)}')
    in_use = [(name, places) for name, places in (('CMM positions', np.unique(scheme.cmm_position)),
                                                  ('Balls', np.unique(scheme.ball))) if places.size < scheme.n]
    print_parts(out, [sequence_map(scheme) if scheme.n <= WIDEST_MAP else None, targets(scheme, radius_mm),
                      uncertainties(expected, sigma_um), pairs([
        *((name, f'{", ".join(map(str, places))} of {scheme.n} in use; deviations of the others are not measured')
          for name, places in in_use),
        ('Table', f'{way.table_turns:.4g} turns in {way.table_moves} moves'),
        ('CMM', f'{way.cmm_way:.4g} m in {way.cmm_moves} moves (straight from ball to ball)'),
        ('Determines', f'rank {expected.rank} of {expected.full_rank} of a complete run; curves with '
                       f'{expected.penalty:.2f} times the uncertainty of one (at best {expected.ideal:.2f} for so many '
                       'readings)'),
        ('Time', f'{expected.duration / 3600:.1f} h at {SECONDS_PER_BALL:g} s a ball and usual speeds'),
        ('Order', CASES[scheme.order]), ('Paper', 'Kniel et al., Measurement 2019')])])


def targets(scheme: Scheme, radius_mm: float) -> Table:
    """Return the table of the targets."""
    heads = ('seq', 'CMM position', 'table position', 'ball', 'x', 'y', 'z', 'table angle')
    units = ('', '', '', '', 'mm', 'mm', 'mm', '°')
    texts = zip(*rows(scheme, radius_mm), strict=True)
    return Table('targets', 'Targets', (
        *(column(*one) for one in zip(HEADER.split(','), heads, texts, [signs] * len(heads), units)),
        column('approach', 'turn', scheme.approach, lambda sense: '+' if sense > 0 else '−')))


def uncertainties(expected: Expectation, sigma_um: float) -> Table:
    """Return the table of the uncertainties that a plan is expected to give the curves."""
    u = 2 * sigma_um * np.sqrt(np.mean(expected.u**2, axis=0))
    return Table('expected', f'Expected expanded uncertainty (k = 2) where σ is {sigma_um:g} µm', (
        column('curve', 'curve', CURVES, str), column('U', 'U', u, lambda value: f'{value:.3g}'),
        column('unit', '', ['µm'] * 3 + ['µrad'] * 3, str)))


def sequence_map(scheme: Scheme) -> Table:
    """Return the map of the scheme: which measurement is made where (Figure 3 of the paper)."""
    grid = np.zeros((scheme.n, scheme.n), dtype=int)
    first = slice(None, None, -1)  # of several measurements the first is shown
    grid[scheme.table_position[first] - 1, scheme.ball[first] - 1] = np.arange(scheme.ball.size, 0, -1)
    every = range(1, scheme.n + 1)
    return Table('sequence', 'When each ball is measured', (
        column('table_position', 'table \\ ball', every, str),
        *(column(f'ball_{ball}', str(ball), grid[:, ball - 1], lambda seq: str(seq) if seq else '−')
          for ball in every)))


CASES = {
    'row': 'table outside, CMM and plate inside (case 1 of the paper): acceptance after VDI/VDE 2617-4',
    'diagonal': 'CMM outside, table and plate inside (case 2 of the paper): mean systematic error of the table',
    'column': 'ball outside, CMM and table inside (case 3 of the paper): table and CMM alike',
    'random': 'shuffled: drift in time is spread over all positions',
    'sensitive': 'designed: shows every effect of the library with little travel',
    'there_and_back': 'diagonal at half the CMM positions, then the same backwards: shows every effect of the library',
    'row_there_and_back': 'row at half the CMM positions, then the same backwards: quickest where the table moves '
                          'slowly',
}
