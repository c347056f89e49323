# SPDX-License-Identifier: Apache-2.0
"""Decisions near a limit: how many certificates say 'conforms' falsely, and how much of what U could decide is decided.

Machines of the demo hide one to three effects of 2 to 30 times the noise; each is measured in each order and fitted
with the base model, in the environment from which the effects are drawn. The limit of each range is drawn evenly within
three times its U of the true range. U could decide where the limit is further from the true range than U.

    python -m benchmarks.blind.certificates --machines 170
"""

import argparse
import multiprocessing
import os

import numpy as np

from benchmarks.blind.by_order import ORDERS, environment, run_of
from rosette_ros.analysis import analyse
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.error_summary import Conformity, peak_to_valley
from rosette_ros.core.uncertainty.uncertainty_budget import budget

Decision = tuple[str, float, Conformity]
"""Order; how far the limit is above the true range, in U; what is decided."""
REACH = 3.0
"""Limits are drawn within so many U of the true range."""


def decided(task: tuple[int, str, int]) -> list[Decision]:
    """Return the decisions on the six ranges of a machine, number of balls, order and seed."""
    n, order, seed = task
    _, run, truth = run_of(n, order, seed, True)
    made = budget(analyse(run), BudgetInputs(environment=environment(n)))
    away = np.random.default_rng([seed, ORDERS.index(order)]).uniform(-REACH, REACH, len(CURVES))
    true = peak_to_valley(truth)
    limits = {line.curve: float(one + off * line.expanded) for line, one, off in zip(made.lines(), true, away)}
    return [(order, float(off), line.conformity or Conformity.UNDECIDED)
            for line, off in zip(made.lines(limits), away)]


def table(every: list[Decision]) -> str:
    """Return the table of decisions by order, in Markdown."""
    rows = ['| order | decisions | conforms | of these false | does not conform | of these false | '
            'decided of what U could decide |', '|---|---|---|---|---|---|---|']
    for order in (*ORDERS, 'all'):
        some = [one for one in every if order in (one[0], 'all')]
        if not some:
            continue
        away, said = np.array([one[1] for one in some]), np.array([one[2] for one in some])
        cells = [order, str(len(some))]
        for what, is_false in ((Conformity.CONFORMS, away < 0), (Conformity.FAILS, away >= 0)):
            cells += [str(int(np.sum(said == what))),
                      f'{100 * np.sum((said == what) & is_false) / max(np.sum(said == what), 1):.1f} %']
        could = np.abs(away) > 1
        rows.append(f'| {" | ".join(cells)} | {100 * np.mean(said[could] != Conformity.UNDECIDED):.1f} % |')
    return '\n'.join(rows)


def main() -> int:
    """Draw, decide and print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind.certificates',
                                     description=__doc__.splitlines()[0])
    parser.add_argument('--orders', nargs='+', choices=ORDERS, default=list(ORDERS), metavar='ORDER')
    parser.add_argument('--machines', type=int, default=170, help='in each order (default 170)')
    parser.add_argument('--first-seed', type=int, default=1001)
    parser.add_argument('-n', '--balls', dest='n', type=int, default=6)
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    options = parser.parse_args()
    tasks = [(options.n, order, seed) for seed in range(options.first_seed, options.first_seed + options.machines)
             for order in options.orders]
    with multiprocessing.Pool(options.jobs) as pool:
        print(table([one for some in pool.imap_unordered(decided, tasks, chunksize=8) for one in some]))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
