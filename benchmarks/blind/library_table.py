# SPDX-License-Identifier: Apache-2.0
"""Effects of the library that the machine hides: are they named, and are their parameters right?"""

import itertools
from argparse import Namespace
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.blind.answers import Claim, Record, ask
from benchmarks.blind.library_effects import covered, hide
from benchmarks.blind.noise_kinds import AXES
from benchmarks.blind.runs import SIGMA, Plan, noisy
from rosette_ros.simulation.hidden import NAMED

NAME = 'library'
KNOWN = NAMED
HEADING = ('| order | hidden | runs | named | first | identified instead | unexplained | within U | rms/σ |\n'
           '|---|---|---|---|---|---|---|---|---|')
LIBRARY = tuple(kind for kind in NAMED if kind != 'touch_dust')


def tasks(arguments: Namespace) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Yield the group and the arguments of `trial` of every run."""
    kinds, together = arguments.library or LIBRARY, arguments.together
    strength = (arguments.strength or [12.0])[0]
    for order in arguments.orders:
        for group in kinds if together == 1 else [f'{together} together']:
            for seed in arguments.seeds:
                drawn = np.random.default_rng([seed, together]).choice(kinds, together, replace=False).tolist()
                yield f'{order}, {group}', (
                    [group] if together == 1 else drawn, Plan(arguments.n, order, seed, arguments.turning), strength,
                    arguments.beside, arguments.stated != 'no')


def trial(kinds: list[str], made: Plan, strength: float, beside: str, stated: bool) -> Record:
    """Return the record of one run that hides one effect of each kind."""
    hidden = hide(made, kinds, strength, AXES.get(beside, (1, 1, 1)))
    head = {'hidden': kinds, 'strength': strength, 'shares': hidden.shares, 'noise': beside, 'stated': stated,
            **asdict(made)}
    if hidden.shifts is None:
        return {**head, 'judged': 'not observable'}
    run = noisy(hidden.clean, made, beside, stated, sum(hidden.shifts), ' '.join(kinds))[0]
    answer, found = ask(run)
    first = any(kind == claim.effect or kind in claim.alike for claim in answer.claims[:1] for kind in kinds)
    return {**head, 'judged': 'named' if is_named(answer.claims, kinds) else 'wrong', 'first': first,
            'covered': covered(run, found, kinds, hidden.shifts), **asdict(answer)}


def is_named(claims: tuple[Claim, ...], kinds: list[str]) -> bool:
    """Return whether the set of claims is the set of hidden effects, look-alikes allowed."""
    return len(claims) == len(kinds) and any(
        all(kind == claim.effect or kind in claim.alike for claim, kind in zip(claims, order))
        for order in itertools.permutations(kinds))


def is_good(record: Record) -> bool:
    """Return whether the set of names is the hidden one."""
    return record['judged'] in ('named', 'not observable')


def row(group: str, records: list[Record]) -> str:
    """Return the line of a group."""
    order, name = group.split(', ')
    seen = [record for record in records if record['judged'] != 'not observable']
    if not seen:
        return f'| {order} | {name} | not observable | | | | | | |'
    instead = Counter(' + '.join(claim['effect'] for claim in record.get('claims', ())) or 'nothing'
                      for record in seen if not is_good(record))
    said = ', '.join(f'{names} ({count})' for names, count in instead.most_common(3))
    within = [one for record in seen for one in record.get('covered', ())]
    rms = np.median([record['rms'] for record in seen if 'rms' in record] or [np.nan]) / SIGMA
    return (f'| {order} | {name} | {len(seen)} | {sum(map(is_good, seen))} | '
            f'{sum(bool(record.get("first")) for record in seen)} | {said} | '
            f'{sum(bool(record.get("unexplained")) for record in seen)} | '
            f'{f"{sum(within)} of {len(within)}" if within else ""} | {rms:.2f} |')


def total(groups: dict[str, list[Record]]) -> str:
    """Return the line under the table."""
    seen = [record for records in groups.values() for record in records if record['judged'] != 'not observable']
    within = [one for record in seen for one in record.get('covered', ())]
    return (f'Runs: {len(seen)}; set correct: {sum(map(is_good, seen))}; first effect correct: '
            f'{sum(bool(record.get("first")) for record in seen)}; parameters within U: {sum(within)} of {len(within)}')
