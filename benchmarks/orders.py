# SPDX-License-Identifier: Apache-2.0
"""What each order of measurement shows and costs, as tables.

    python -m benchmarks.orders [--balls 12] [--sizes 6 12 24 36 72] [--seeds 5]
"""

import argparse

import numpy as np

from benchmarks.order_cost import Judge, Order, Pace, journey
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.sight.visibility import visibility

COLUMNS = (('row', 'forward'), ('diagonal', 'forward'), ('diagonal', 'alternate'),
           ('column', 'forward'), ('random', 'forward'), ('random', 'alternate'),
           ('interleaved', 'forward'))
"""Orders with the turning of the table; `interleaved` has senses of its own."""


def order_of(scheme):
    """Return the Order of a Scheme."""
    return Order(scheme.n, scheme.table_position - 1, scheme.ball - 1, scheme.approach)


def run_of(scheme, pace):
    """Return a Run of a scheme at a pace, with a temperature that falls as in a night."""
    order = order_of(scheme)
    way = journey(order, pace)
    t = way.time / way.time[-1]
    return Run(
        scheme.n, pace.radius, scheme.table_position, scheme.ball, scheme.centres(pace.radius),
        time=way.time, approach=scheme.approach, table_travel=way.travel,
        temperature=20 + 0.5 * np.cos(np.pi * t) + 0.25 * np.cos(2 * np.pi * t + 1))


def print_table(head, rows):
    """Print a table in Markdown."""
    print('| ' + ' | '.join(head) + ' |')
    print('|---' * len(head) + '|')
    for row in rows:
        print('| ' + ' | '.join(row) + ' |')
    print()


def typical_shares(n, pace):
    """Print the typical visible share of every effect in every order, as `advise` gives it."""
    seen = [{entry.name: entry for entry in visibility(run_of(plan(n, order, 0, turning), pace))}
            for order, turning in COLUMNS]
    rows = [(name, *(f'{entries[name].typical_share:.2f}' for entries in seen))
            for name in seen[0]]
    print_table(('effect', *(f'{order}, {turning}' if order in ('diagonal', 'random') else order
                             for order, turning in COLUMNS)), rows)


def worst_shares(sizes, seeds, pace):
    """Print, for each size, the worst setting of every effect, `interleaved` against `random`."""
    rows, head = {}, ['share of what any order could show, worst setting']
    for n in sizes:
        judge = Judge(n, pace)
        mine = judge(order_of(plan(n, 'interleaved')))
        drawn = [judge(order_of(plan(n, 'random', seed, 'alternate'))) for seed in range(seeds)]
        head += [f'n = {n}']
        for name, share in mine.shares.items():
            other = np.mean([verdict.shares[name] for verdict in drawn])
            rows.setdefault(name, [name]).append(f'**{share:.2f}** {other:.2f}')
        worst = [min(verdict.shares.values()) for verdict in drawn]
        mean = [np.mean(list(verdict.shares.values())) for verdict in drawn]
        rows.setdefault('worst', ['worst effect']).append(
            f'**{min(mine.shares.values()):.2f}** {np.mean(worst):.2f}')
        rows.setdefault('mean', ['mean of the effects']).append(
            f'**{np.mean(list(mine.shares.values())):.3f}** {np.mean(mean):.3f}')
        motion = [verdict.motion for verdict in drawn]
        rows.setdefault('motion', ['motion per ball, s']).append(
            f'**{mine.motion:.1f}** {np.mean(motion):.1f}')
        alike = [verdict.alike.max() for verdict in drawn]
        rows.setdefault('alike', ['cosine of cycle and bearing']).append(
            f'**{mine.alike.max():.2f}** {np.mean(alike):.2f}')
    print_table(head, rows.values())


def times(sizes, pace):
    """Print the time that each order takes."""
    rows = []
    for order, turning in COLUMNS:
        hours = []
        for n in sizes:
            way = journey(order_of(plan(n, order, 0, turning)), pace)
            hours.append(f'{way.motion / 3600:.2f} of {(way.time[-1] + pace.probing) / 3600:.2f}')
        rows.append((f'{order}, {turning}' if order != 'interleaved' else order, *hours))
    print_table(('hours of motion, of all with 24 s a ball', *(f'n = {n}' for n in sizes)), rows)


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--balls', type=int, default=12)
    parser.add_argument('--sizes', type=int, nargs='+', default=[6, 12, 24, 36, 72])
    parser.add_argument('--seeds', type=int, default=5, help='of the random order')
    options = parser.parse_args()
    pace = Pace()
    typical_shares(options.balls, pace)
    worst_shares(options.sizes, options.seeds, pace)
    times(options.sizes, pace)


if __name__ == '__main__':
    main()
