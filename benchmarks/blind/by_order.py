# SPDX-License-Identifier: Apache-2.0
"""Coverage by order: how often U (k = 2) contains the true curves of the same machines, measured in each order.

Machines of the demo hide one to three effects of 2 to 30 times the noise. U is that of the readings alone, and that in
the environment from which the effects are drawn: each kind alike, sizes evenly on a logarithmic scale.

    python -m benchmarks.blind.by_order --machines 60 --json by_order.json --page docs/blind.md
"""

import argparse
import json
import multiprocessing
import os
import time
import traceback
from functools import cache
from math import log, sqrt
from pathlib import Path

import numpy as np

from benchmarks.blind.answers import Record
from benchmarks.blind.runs import true_curves
from rosette_ros.analysis import explanations_of, find
from rosette_ros.cli.hidden_demo import SIZES
from rosette_ros.core.run.records import ErrorMotions, Floats, Run, remove_gauge
from rosette_ros.core.run.scheme import BACK, COMPLETE_ORDERS, plan
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.stated_environment import Environment, Size
from rosette_ros.core.uncertainty.uncertainty_budget import budget
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.hidden_kinds import NAMED, HiddenDraw

ORDERS = (*COMPLETE_ORDERS, 'there_and_back')
NOISE = 1e-7
"""Repeatability of the machines, m."""
GOOD = 0.8
"""Share of the points of a run that U contains at least where it is of use."""
BEGIN, END = '<!-- coverage by order -->', '<!-- end of coverage by order -->'


@cache
def environment(n: int) -> Environment:
    """Return the environment from which effects are drawn: the standard deviation of each from run to run at a ball.

    A size that is drawn evenly on a logarithmic scale has the mean square (b^2 - a^2) / (2 ln(b / a)); what one ball or
    one reading shows is drawn larger by the root of how few readings these are."""
    draw = HiddenDraw(seed=0, **SIZES)
    low, high = draw.smallest_sigma * NOISE, draw.largest_sigma * NOISE
    there = (draw.fewest + draw.most) / 2 / len(NAMED)
    size = sqrt(there * (high**2 - low**2) / (2 * log(high / low)))
    larger = {'ball_slip': sqrt(n), 'ball_form': sqrt(n), 'outlier': n}
    return Environment('drawn', {}, {kind: Size(size * larger.get(kind, 1), 'as it is drawn') for kind in NAMED})


def run_of(n: int, order: str, seed: int, hides: bool) -> tuple[Machine, Run, Floats]:
    """Return a machine, its run in an order, and its true curves without what no run knows."""
    config = MachineConfig().changed(seed=seed, plate={'balls': n}, **(
        {'hidden': {'seed': seed * 7919, **SIZES}} if hides else {}))
    machine, scheme = Machine(config), plan(n, order, seed)
    run = machine.run(scheme)
    quiet = MachineConfig().changed(seed=seed, plate={'balls': n}, probing={'repeatability_um': 0.0})
    whole = scheme if order in COMPLETE_ORDERS else plan(n, BACK[order], seed)
    return machine, run, remove_gauge(true_curves(Machine(quiet).run(whole)))


def measured(n: int, order: str, seed: int, hides: bool) -> Record:
    """Return what U of a machine's run in an order contains."""
    machine, run, truth = run_of(n, order, seed, hides)
    found, began = find(run), time.process_time()
    made = budget(found.final, BudgetInputs(environment=environment(n)),
                  explanations=explanations_of(found, found.final)).error_motions
    took = time.process_time() - began
    alone = found.final.error_motions
    return {'order': order, 'seed': seed, 'hides': hides, 'kinds': [one.kind for one in machine.hidden],
            'outcome': found.verdict.outcome.value, 'missing': list(found.missing), 'seconds': took,
            'alone': _inside(alone, truth), 'inside': _inside(made, truth),
            'growth': float(np.median(made.u / alone.u))}


def _inside(motions: ErrorMotions, truth: Floats) -> float:
    error = remove_gauge(motions.values, motions.angle) - truth
    return float(np.mean(np.abs(error) <= 2 * motions.u))


def work(task: tuple[int, str, int, bool]) -> Record:
    """Return the record of one run; one that fails is told."""
    try:
        return measured(*task)
    except Exception:
        return {'order': task[1], 'seed': task[2], 'hides': task[3], 'failed': traceback.format_exc()}


def table(records: list[Record]) -> str:
    """Return the table of coverage by order, in Markdown."""
    rows = ['| order | runs | U of the readings alone: inside | runs below 80 % | verdict fits | with the environment: '
            'inside | runs below 80 % | verdict fits | U, times |', '|---|---|---|---|---|---|---|---|---|']
    for hides in (True, False):
        for order in ORDERS:
            some = [one for one in records if one['order'] == order and one['hides'] == hides]
            if not some:
                continue
            cells = [f'{order}{"" if hides else ", nothing hidden"}', str(len(some))]
            for key in ('alone', 'inside'):
                share = np.array([one[key] for one in some])
                fits = np.array([one['outcome'] == 'fits' for one in some])
                cells += [_percent(share), str(int((share < GOOD).sum())),
                          f'{_percent(share[fits])} of {fits.sum()}' if fits.any() else '']
            cells.append(f'{np.median([one["growth"] for one in some]):.2f}')
            rows.append(f'| {" | ".join(cells)} |')
    return '\n'.join(rows)


def _percent(shares: Floats) -> str:
    error = 2 * float(np.std(shares, ddof=1)) / sqrt(len(shares)) if len(shares) > 1 else float('nan')
    return f'{100 * float(shares.mean()):.1f} ± {100 * error:.1f} %'


def main() -> int:
    """Measure, judge and print the table; return 1 where a run failed."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind.by_order', description=__doc__.splitlines()[0])
    parser.add_argument('--orders', nargs='+', choices=ORDERS, default=list(ORDERS), metavar='ORDER')
    parser.add_argument('--machines', type=int, default=60, help='in each order (default 60)')
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('-n', '--balls', dest='n', type=int, default=12)
    parser.add_argument('--clean', action='store_true', help='machines that hide nothing')
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path, metavar='FILE', help='keep every run; those that it has are not repeated')
    parser.add_argument('--page', type=Path, metavar='FILE', help=f'write the table into a page, after {BEGIN}')
    options = parser.parse_args()
    records = json.loads(options.json.read_text()) if options.json and options.json.exists() else []
    known = {(one['order'], one['seed'], one['hides']) for one in records}
    tasks = [(options.n, order, seed, not options.clean) for seed in range(
        options.first_seed, options.first_seed + options.machines) for order in options.orders
        if (order, seed, not options.clean) not in known]
    with multiprocessing.Pool(options.jobs, maxtasksperchild=20) as pool:
        for one in pool.imap_unordered(work, tasks):
            if 'failed' in one:
                print(one['failed'])
                return 1
            records.append(one)
            if options.json:
                options.json.write_text(json.dumps(sorted(records, key=lambda each: (
                    each['order'], each['hides'], each['seed'])), indent=0))
    made = table(records)
    print(made)
    if options.page:
        page = options.page.read_text()
        head, _, rest = page.partition(BEGIN)
        options.page.write_text(f'{head}{BEGIN}\n{made}\n{END}{rest.partition(END)[2]}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
