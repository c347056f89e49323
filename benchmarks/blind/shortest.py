# SPDX-License-Identifier: Apache-2.0
"""The shortest plan, grown by chosen blocks to as many readings as a complete run has, beside that run.

    python -m benchmarks.blind.shortest --machines 60

Machines hide nothing. Of each: readings of the plan and at the end, U of the worst point over that of the complete run,
and what is said to be missing by either.
"""

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.blind.runs import Plan
from benchmarks.blind.until import Cell, on
from rosette_ros.core.planning.next_readings import next_readings, standing
from rosette_ros.core.run.reduced_sets import best_members, fewest_members
from rosette_ros.core.run.scheme import Scheme, plan


class ShortestPlan(Plan):
    """A plan at the fewest CMM positions that determine the curves."""

    @property
    def scheme(self) -> Scheme:
        """The order in which it measures."""
        members = best_members(self.n, fewest_members(self.n))
        return plan(self.n, self.order, self.seed, self.turning, cmm_positions=[one + 1 for one in members])


def measured(made: Plan, name: str) -> Cell:
    """Return a cell that has measured a whole plan."""
    cell = Cell(made, name, ())
    if left := made.scheme.ball.size - cell.run.size:
        cell.measure(on(made.scheme, cell.run.size, left))
    return cell


def compared(number: int, n: int) -> tuple[int, int, float, tuple[str, ...], tuple[str, ...]]:
    """Return readings of the shortest plan and at the end, the ratio of U, and what the two runs are said to lack."""
    name = f'shortest {number}'
    whole, short = (measured(kind(n, 'interleaved', number), name) for kind in (Plan, ShortestPlan))
    begin = short.run.size
    while short.run.size < n**2:
        block = next_readings(short.run, readings=min(n, n**2 - short.run.size), uncertainty=0.0).targets
        if block is None:
            break
        short.measure(block)
    found = standing(short.run), standing(whole.run)
    said = (one.contenders[0].members for one in found)
    return begin, short.run.size, found[0].uncertainty / found[1].uncertainty, *said


def main(argv: Sequence[str] | None = None) -> int:
    """Print each machine and the ratios together."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind.shortest', description=__doc__.splitlines()[0])
    parser.add_argument('--machines', type=int, default=60)
    parser.add_argument('--first', type=int, default=1)
    parser.add_argument('--balls', type=int, default=12)
    options = parser.parse_args(argv)
    ratios = []
    for number in range(options.first, options.first + options.machines):
        begin, end, ratio, *said = compared(number, options.balls)
        ratios.append(ratio)
        words = [' + '.join(names) or 'nothing' for names in said]
        print(f'{number}: {begin} -> {end} readings, U {ratio:.2f} of the complete run, likeliest: {words[0]} '
              f'(complete run: {words[1]})', flush=True)
    within = sum(ratio <= 1.1 for ratio in ratios)
    print(f'U over that of the complete run: median {np.median(ratios):.2f}, at most 1.1 for {within} of {len(ratios)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
