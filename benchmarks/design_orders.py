# SPDX-License-Identifier: Apache-2.0
"""Design the order `interleaved` anew and keep what is better than the order that is shipped.

    python -m benchmarks.design_orders 12 24 72 [--seed 1] [--steps 4000] [--heat 0.05]

Writes the tables in rosette_ros/core/run/interleaved_order.py. Up to ten balls the order is designed
reading by reading after the sweeps, beyond that by sweeps alone; benchmarks/order_cost.py says what counts.
"""

import argparse
import string
from pathlib import Path

import numpy as np

from benchmarks.order_cost import Judge, Order
from rosette_ros.core.run import interleaved_order as sensitive_order
from rosette_ros.core.run.interleaved_order import DIGITS, WIDEST_GAP, Sweeps, order_from_text, shortest_way

MODULE = Path(sensitive_order.__file__)
TABLES = {'READINGS': sensitive_order.READINGS, 'SWEEPS': sensitive_order.SWEEPS}
WIDTH = 110
MOST_SINGLE = 10
"""Most balls for which an order is designed reading by reading."""


def sweeps_text(sweeps):
    """Return v, the gaps (plus 36 where a sweep goes backwards) and w, as strings of digits."""
    turns = sweeps.gap + (WIDEST_GAP + 1) * (sweeps.sense < 0)
    return tuple(''.join(DIGITS[digit] for digit in row) for row in (sweeps.ball, turns, sweeps.shift))


def reading_text(position, ball, approach):
    """Return readings, zero-based, n <= 10, as text: a letter and a digit each.

    The letter is the table position, a capital where the table last turned backwards; the digit is the ball.
    """
    return ''.join(string.ascii_letters[i + 26 * (sense < 0)] + str(j)
                   for i, j, sense in zip(position, ball, approach, strict=True))


def anneal(state, change, cost, steps, heat, rng):
    """Return (cost, state) of the best state met on a walk that accepts worse ones ever less often.

    change: (state, rng) -> state; cost: state -> float; heat: rise in cost accepted at first.
    """
    value = cost(state)
    best = value, state
    for step in range(steps):
        warmth = heat * (1 - step / steps)**2 + 1e-5
        tried = change(state, rng)
        tried_value = cost(tried)
        if tried_value < value or rng.random() < np.exp((value - tried_value) / warmth):
            state, value = tried, tried_value
            if value < best[0]:
                best = value, state
    return best


def design_sweeps(n, seed=0, steps=4000, heat=0.005, pace=None):
    """Return (cost, Sweeps) found by annealing the sweeps that a rule makes."""
    judge = Judge(n, pace)
    return anneal(Sweeps.by_rule(n), _other_sweeps, lambda sweeps: judge(swept(sweeps)).cost(),
                  steps, heat, np.random.default_rng(seed))


def swept(sweeps):
    """Return the Order of Sweeps, the table going the shortest way."""
    position, ball = sweeps.readings()
    n = sweeps.ball.size
    return Order(n, position, ball, shortest_way(n, position))


def _other_sweeps(sweeps, rng):
    n = sweeps.ball.size
    ball, sense, gap, shift = (part.copy() for part in (sweeps.ball, sweeps.sense, sweeps.gap, sweeps.shift))
    choice, (a, b) = rng.random(), rng.integers(0, n, 2)
    if choice < 0.5:
        ball[[a, b]] = ball[[b, a]]
    elif choice < 0.58:
        sense[a] = -sense[a]
    elif choice < 0.7:
        sense[[a, b]] = sense[[b, a]]
    elif choice < 0.78:
        # Wide gaps cost time, but part the cycles of the bearing from cycles in time.
        gap[a] = rng.integers(0, 4 if choice < 0.74 else min(n // 2, WIDEST_GAP) + 1)
    elif choice < 0.88:
        shift[min(a, b):max(a, b)] += rng.integers(-3, 4)
    else:
        # The CMM keeps to one sense over a part of the table.
        a, b = min(a, b), max(a, b) + 1
        shift[a:b] = shift[a] + rng.choice([-3, -2, 0, 1]) * np.arange(b - a)
    return Sweeps(ball, sense, gap, shift % n)


def design_readings(start, seed=0, steps=20000, heat=0.05, pace=None):
    """Return (cost, Order) found by annealing an Order reading by reading: for few balls."""
    rng = np.random.default_rng(seed)
    judge = Judge(start.n, pace)
    long_way = start.approach != shortest_way(start.n, start.position)
    cost, state = anneal((start.position, start.ball, long_way), _other_readings,
                         lambda state: judge(_order(start.n, *state)).cost(), steps, heat, rng)
    return cost, _order(start.n, *state)


def _order(n, position, ball, long_way):
    """Return the Order in which the table goes the long way round to the marked readings."""
    sense = np.where(long_way, -1, 1) * shortest_way(n, position)
    moved = np.diff(position, prepend=-1) != 0
    sense[0] = 1
    last = np.maximum.accumulate(np.where(moved, np.arange(position.size), 0))
    return Order(n, position, ball, sense[last])


def _other_readings(state, rng):
    position, ball, long_way = state
    size = position.size
    place = np.arange(size)
    choice, (a, b) = rng.random(), np.sort(rng.integers(0, size, 2))
    if choice < 0.1:
        long_way = long_way ^ (place == a)
    elif choice < 0.35:
        a, b = rng.choice(np.flatnonzero(position == position[a]), 2, replace=False)
        ball = ball.copy()
        ball[[a, b]] = ball[[b, a]]
    elif choice < 0.8:
        place[[a, b]] = place[[b, a]]
    elif choice < 0.9:
        place[a:b + 1] = place[a:b + 1][::-1]
    else:
        rest, c = np.delete(place, slice(a, b + 1)), rng.integers(0, size - (b - a))
        place = np.concatenate([rest[:c], place[a:b + 1], rest[c:]])
    return position[place], ball[place], long_way


def source(tables, text):
    """Return the source of the module with other tables."""
    for name, entries in tables.items():
        lines = ''.join(f'    {n}: {literal(entries[n])},\n' for n in sorted(entries))
        start = text.index(f'\n{name} = {{\n') + len(f'\n{name} = {{\n')
        text = text[:start] + lines + text[text.index('}\n', start):]
    return text


def literal(texts):
    """Return a string, or a tuple of strings, as source, in lines of the module's width."""
    if isinstance(texts, str):
        pieces = [texts[at:at + WIDTH] for at in range(0, len(texts), WIDTH)]
        return repr(texts) if len(pieces) == 1 else f"({''.join(f'{chr(10)}        {piece!r}' for piece in pieces)})"
    one_line = repr(texts)
    return one_line if len(one_line) < WIDTH else f"({','.join(f'{chr(10)}        {text!r}' for text in texts)})"


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
    name, text = 'SWEEPS', sweeps_text(sweeps)
    if n <= MOST_SINGLE:
        cost, order = design_readings(swept(sweeps), seed, 5 * steps, heat)
        name, text = 'READINGS', reading_text(order.position, order.ball, order.approach)
    old = order_of(n, TABLES)
    before = judge(old).cost() if old else float('inf')
    if cost < before:
        for table in TABLES.values():
            table.pop(n, None)
        TABLES[name][n] = text
        MODULE.write_text(source(TABLES, MODULE.read_text(encoding='utf-8')), encoding='utf-8')
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
