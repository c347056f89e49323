# SPDX-License-Identifier: Apache-2.0
"""Power: how strong has an effect of the library to be to be named?

For each run the strength is bisected with the same noise, so that half of the runs are named at the median of what is
found; a factor between two versions of the diagnosis is told by the same runs.
"""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks.blind.answers import Record, ask
from benchmarks.blind.library_effects import hide
from benchmarks.blind.library_table import LIBRARY, is_good, is_named
from benchmarks.blind.noise_kinds import AXES
from benchmarks.blind.proportion import share
from benchmarks.blind.runs import Plan, noisy
from rosette_ros.simulation.hidden import NAMED

NAME = 'power'
KNOWN = NAMED
HEADING = ('| hidden | runs | named at 12 σ | 95 % | half are named at | 95 % | instead at 12 σ |\n'
           '|---|---|---|---|---|---|---|')
STEPS = np.geomspace(2.5, 12.0, 33)
"""Strengths that are tried: 5 % apart."""


def tasks(arguments: Namespace) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Yield the group and the arguments of `trial` of every run."""
    for kind in arguments.power or LIBRARY:
        for order in arguments.orders:
            for seed in arguments.seeds:
                yield kind, (kind, Plan(arguments.n, order, seed, arguments.turning), arguments.beside,
                             arguments.stated != 'no')


def trial(kind: str, made: Plan, beside: str, stated: bool) -> Record:
    """Return the record of one run: the names at 12 σ, and the least strength at which the effect is named."""
    hidden = hide(made, [kind], 1.0, AXES.get(beside, (1, 1, 1)))
    head = {'hidden': kind, 'noise': beside, 'stated': stated, **asdict(made)}
    if hidden.shifts is None:
        return {**head, 'judged': 'not observable'}

    def ask_at(step: int) -> Any:
        return ask(noisy(hidden.clean, made, beside, stated, STEPS[step] * hidden.shifts[0], kind)[0])[0]

    top = ask_at(len(STEPS) - 1)
    named = is_named(top.claims, [kind])
    low, high = 0, len(STEPS) - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if is_named(ask_at(middle).claims, [kind]) else (middle + 1, high)
    # where it is named nowhere on the way but not at 12 σ either, it has no threshold
    threshold = float(STEPS[low]) if low < len(STEPS) - 1 or named else np.inf
    return {**head, 'judged': 'named' if named else 'wrong', 'threshold': threshold, **asdict(top)}


def median(thresholds: list[float]) -> tuple[float, float, float]:
    """Return the median and its 95 % interval, which holds for any distribution."""
    ordered = np.sort(thresholds)
    low = int(binom.ppf(0.025, ordered.size, 0.5))
    return float(np.median(ordered)), float(ordered[max(low - 1, 0)]), float(ordered[min(ordered.size - low,
                                                                                        ordered.size - 1)])


def row(group: str, records: list[Record]) -> str:
    """Return the line of a group."""
    seen = [record for record in records if record['judged'] != 'not observable']
    if not seen:
        return f'| {group} | not observable |' + ' |' * 5
    half, low, high = median([record.get('threshold', np.inf) for record in seen])
    instead = ', '.join(sorted({' + '.join(claim['effect'] for claim in record.get('claims', ())) or 'nothing'
                                for record in seen if not is_good(record)}))
    return (f'| {group} | {len(seen)} | {share(sum(map(is_good, seen)), len(seen))} | {half:.1f} σ | '
            f'{low:.1f}–{high:.1f} σ | {instead} |')


def difference(pairs: list[tuple[Record, Record]]) -> str:
    """Return how the strengths at which the same runs are named have changed."""
    both = [(was['threshold'], now['threshold']) for was, now in pairs
            if np.isfinite(was.get('threshold', np.inf)) and np.isfinite(now.get('threshold', np.inf))]
    if not both:
        return 'no same runs'
    change = np.diff(np.log(both), axis=1)
    spread = 2 * change.std() / np.sqrt(len(change))
    return (f'half were named at {np.median([was for was, _ in both]):.2f} σ, now at '
            f'{np.median([now for _, now in both]):.2f} σ; the same {len(both)} runs need '
            f'{100 * np.expm1(change.mean()):+.1f} % strength (± {100 * spread:.1f} %)')


def total(groups: dict[str, list[Record]]) -> str:
    """Return the line under the table."""
    seen = [record for records in groups.values() for record in records if record['judged'] != 'not observable']
    return f'Runs: {len(seen)}; named at 12 σ: {share(sum(map(is_good, seen)), len(seen)).replace(" | ", ", ")}'
