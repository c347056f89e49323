# SPDX-License-Identifier: Apache-2.0
"""Design the order `sensitive` anew and keep what is better than the order that is shipped.

    python tools/design_orders.py 12 24 72 [--seed 1] [--steps 4000] [--heat 0.05]

Writes rosette_ros/core/sensitive_orders.py. Up to ten balls the order is designed reading by
reading after the sweeps, beyond that by sweeps alone; docs/orders.md says how.
"""

import argparse
import ast
from pathlib import Path

from rosette_ros.core.design import MOST_SINGLE, Judge, Order, design_readings, design_sweeps, swept
from rosette_ros.core.sensitive import Sweeps, order_from_text, reading_text

MODULE = Path(__file__).parents[1] / 'rosette_ros' / 'core' / 'sensitive_orders.py'
HEAD = '''# SPDX-License-Identifier: Apache-2.0
"""The orders of measurement that design found; written by tools/design_orders.py."""
'''
NOTES = {
    'READINGS': 'By number of balls: a letter (table position, capital: turned backwards) and a '
                'digit (ball)\nfor each reading.',
    'SWEEPS': 'By number of balls: v, gaps (plus 36: backwards) and w of sensitive.Sweeps, in '
              'digits.'}
WIDTH = 90


def shipped():
    """Return the tables of the module by name."""
    tree = ast.parse(MODULE.read_text(encoding='utf-8'))
    return {node.targets[0].id: ast.literal_eval(node.value)
            for node in tree.body if isinstance(node, ast.Assign)}


def write(tables):
    """Write the module."""
    parts = [HEAD]
    for name, note in NOTES.items():
        parts.append(f'\n{name} = {{\n')
        for n, texts in sorted(tables[name].items()):
            parts.append(f'    {n}: (\n' + lines(texts) + '    ),\n')
        parts.append(f'}}\n"""{note}"""\n')
    MODULE.write_text(''.join(parts), encoding='utf-8')


def lines(texts):
    """Return a string, or a tuple of strings, as lines of source."""
    out = []
    for text in [texts] if isinstance(texts, str) else texts:
        pieces = [repr(text[at:at + WIDTH]) for at in range(0, len(text), WIDTH)]
        ends = [''] * (len(pieces) - 1) + ['' if isinstance(texts, str) else ',']
        out += [f'        {piece}{end}\n' for piece, end in zip(pieces, ends, strict=True)]
    return ''.join(out)


def order_of(n, tables):
    """Return the shipped Order for n balls, None if there is none."""
    if n in tables['READINGS']:
        return Order(n, *order_from_text(tables['READINGS'][n]))
    if n in tables['SWEEPS']:
        return swept(Sweeps.from_text(*tables['SWEEPS'][n]))
    return None


def improve(n, seed, steps, heat):
    """Design an order of n balls and keep it if it is better; return both costs."""
    judge = Judge(n)
    cost, sweeps = design_sweeps(n, seed, steps)
    name, text = 'SWEEPS', sweeps.text()
    if n <= MOST_SINGLE:
        cost, order = design_readings(swept(sweeps), seed, 5 * steps, heat)
        name, text = 'READINGS', reading_text(order.position, order.ball, order.approach)
    tables = shipped()
    old = order_of(n, tables)
    before = judge(old).cost() if old else float('inf')
    if cost < before:
        for table in tables.values():
            table.pop(n, None)
        tables[name][n] = text
        write(tables)
    return before, cost


def main():
    """Improve the orders that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('balls', type=int, nargs='+')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--steps', type=int, default=4000)
    parser.add_argument('--heat', type=float, default=0.05)
    options = parser.parse_args()
    for n in options.balls:
        before, cost = improve(n, options.seed, options.steps, options.heat)
        print(f'{n} balls: cost {before:.4f} shipped, {cost:.4f} designed', flush=True)


if __name__ == '__main__':
    main()
