# SPDX-License-Identifier: Apache-2.0
"""Coverage: how often lie the six curves and the amplitudes within their expanded uncertainty (k = 2), by noise?

Curves are compared after their gauge is removed, in clean runs and in runs that hide an effect of the library at 12 σ;
amplitudes where the effect is named. The points of a run are not independent: intervals are made from runs.
"""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.blind.answers import Record, ask
from benchmarks.blind.library_effects import covered, hide
from benchmarks.blind.library_table import LIBRARY
from benchmarks.blind.noise_kinds import AXES, BEYOND, EVERY, KINDS, chosen
from benchmarks.blind.runs import Plan, noisy
from rosette_ros.analysis import analyse
from rosette_ros.core.records import CURVES, ErrorMotions, remove_gauge

NAME = 'coverage'
KNOWN = (*EVERY, 'beyond')
HEADING = ('| noise | runs | curves, clean runs | 95 % | least | curves, effect hidden | 95 % | parameters | 95 % |\n'
           '|---|---|---|---|---|---|---|---|---|')
STRENGTH = 12.0


def tasks(arguments: Namespace) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Yield the group and the arguments of `trial` of every run."""
    for kind in chosen(arguments.coverage, KINDS, BEYOND):
        for order in arguments.orders:
            for seed in arguments.seeds:
                yield kind, (kind, Plan(arguments.n, order, seed), arguments.stated != 'no')


def trial(noise: str, made: Plan, stated: bool) -> Record:
    """Return the record of one clean run and of the same that hides an effect: what lies within U."""
    for kind in made.generator('coverage', noise).permutation(LIBRARY).tolist():
        hidden = hide(made, [kind], STRENGTH, AXES.get(noise, (1, 1, 1)))
        if hidden.shifts is not None:
            break
    truth = analyse(hidden.clean).error_motions
    first, found = ask(noisy(hidden.clean, made, noise, stated)[0])
    clean = within(found.final.error_motions, truth)
    run = noisy(hidden.clean, made, noise, stated, hidden.shifts[0], kind)[0]
    answer, found = ask(run)
    return {'noise': noise, 'hidden': kind, 'stated': stated, **asdict(made), 'judged': 'covered', 'clean': clean,
            'with effect': within(found.final.error_motions, truth),
            'parameters': covered(run, found, [kind], hidden.shifts), 'clean names': first.names, **asdict(answer)}


def within(found: ErrorMotions, truth: ErrorMotions) -> list[float]:
    """Return the share of the points of each curve that lie within U of the truth."""
    error = remove_gauge(found.values, found.angle) - remove_gauge(truth.values, truth.angle)
    return (np.abs(error) <= 2 * found.u).mean(axis=0).tolist()


def of_runs(shares: list[float]) -> str:
    """Return the mean share of runs and, in the next column, its interval, by the scatter between runs."""
    if not shares:
        return ' | '
    mean, spread = np.mean(shares), 2 * np.std(shares) / np.sqrt(len(shares))
    return f'{100 * mean:.1f} % | {100 * (mean - spread):.1f}–{100 * min(mean + spread, 1):.1f} %'


def is_good(record: Record) -> bool:
    """Return whether the run could be diagnosed."""
    return record['judged'] != 'failed'


def row(group: str, records: list[Record]) -> str:
    """Return the line of a group."""
    records = [record for record in records if is_good(record)]
    if not records:
        return f'| {group} | 0 |' + ' |' * 7
    by_curve = np.mean([record['clean'] for record in records], axis=0)
    least = f'{CURVES[by_curve.argmin()]} {100 * by_curve.min():.1f} %'
    curves, hidden = ([float(np.mean(record[key])) for record in records] for key in ('clean', 'with effect'))
    parameters = [float(np.mean(record['parameters'])) for record in records if record['parameters']]
    return f'| {group} | {len(records)} | {of_runs(curves)} | {least} | {of_runs(hidden)} | {of_runs(parameters)} |'


def difference(pairs: list[tuple[Record, Record]]) -> str:
    """Return how the coverage of the same runs has changed."""
    def said(key: str) -> str:
        was, now = (100 * np.mean([one for record in side for one in record.get(key, ())]) for side in zip(*pairs))
        return f'{key} {was:.1f} → {now:.1f} %'
    return '; '.join(said(key) for key in ('clean', 'with effect', 'parameters')) if pairs else 'no same runs'


def total(groups: dict[str, list[Record]]) -> str:
    """Return the line under the table."""
    return f'Runs: {2 * sum(map(len, groups.values()))}'
