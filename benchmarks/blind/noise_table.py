# SPDX-License-Identifier: Apache-2.0
"""Clean runs by kind of noise: how often does the diagnosis name a physical effect where there is none?"""

import re
from argparse import Namespace
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from benchmarks.blind.answers import Answer, Record, ask
from benchmarks.blind.noise_kinds import BEYOND, EVERY, KINDS, chosen
from benchmarks.blind.proportion import percent, share
from benchmarks.blind.runs import Plan, machine_config, measure, noisy
from rosette_ros.simulation import Machine

NAME = 'noise'
KNOWN = (*EVERY, 'beyond')
HEADING = ('| noise | σ | runs | false names | 95 % | besides outlier alone | right names | unexplained | noise told | '
           'named |\n|---|---|---|---|---|---|---|---|---|---|')
TOLD = {
    'white': None, 'z_2_t4': 'z repeats|Student', 'z': 'z repeats', 'x': '[xyz] repeats', 'radial': 'radial',
    't3': 'Student', 't4': 'Student', 'laplace': 'Student', 'contaminated': 'Student', 'outliers': 'Student|outlier',
    'sigma_by_ball': 'ball', 'sigma_by_table': 'table position', 'sigma_by_cmm': 'CMM position',
    'ar': 'correlated|wanders', 'slow': 'of the run scatters', 'rounded': 'rounded', 'flicker': 'correlated|wanders',
    'walk': 'wanders'}
"""Words in which a verdict tells a kind of noise, by how its name begins; None where nothing is to be told."""
NOT_WHITE = 'noise is not'
"""Words of any verdict that tells of noise."""


def tasks(arguments: Namespace) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Yield the group and the arguments of `trial` of every run."""
    for kind in chosen(arguments.noise, KINDS, BEYOND):
        for stated in (True, False) if arguments.stated is None else (arguments.stated == 'yes',):
            for order in arguments.orders:
                for seed in arguments.seeds:
                    yield f'{kind}, {"stated" if stated else "unknown"}', (kind, stated, order, seed, arguments.n)


def trial(kind: str, stated: bool, order: str, seed: int, n: int) -> Record:
    """Return the record of one clean run with noise of a kind."""
    made = Plan(n, order, seed)
    clean = measure(Machine(machine_config(seed, n)), made)[0]
    run, noise = noisy(clean, made, kind, stated)
    answer = ask(run)[0]
    verdict, wrong = judged(answer, noise.outliers)
    return {'noise': kind, 'stated': stated, 'order': order, 'seed': seed, 'n': n, 'judged': verdict, 'wrong': wrong,
            'told': is_told(kind, answer.sentence), **asdict(answer)}


def judged(answer: Answer, outliers: tuple[int, ...]) -> tuple[str, list[str]]:
    """Return the class of an answer and the false names in it.

    The class: 'false', 'false outlier' (no other false name), 'right', 'unexplained' or 'nothing'.
    """
    wrong = sorted({claim.effect for claim in answer.claims
                    if claim.effect != 'outlier' or claim.setting.get('reading') not in outliers})
    if wrong:
        return 'false outlier' if wrong == ['outlier'] else 'false', wrong
    return 'right' if answer.claims else 'unexplained' if answer.unexplained else 'nothing', wrong


def is_told(kind: str, sentence: str) -> bool:
    """Return whether a verdict tells of the noise what is true: its kind, or nothing where it is white."""
    words = next(words for begin, words in TOLD.items() if kind.startswith(begin))
    return bool(re.search(words, sentence)) if words else NOT_WHITE not in sentence


def is_good(record: Record) -> bool:
    """Return whether a record holds no false name."""
    return not record['judged'].startswith(('false', 'failed'))


def row(group: str, records: list[Record]) -> str:
    """Return the line of a group."""
    kind, stated = group.split(', ')
    false = [record for record in records if not is_good(record)]
    count = Counter(record['judged'] for record in records)
    names = Counter(name for record in false for name in record.get('wrong', ()))
    said = ', '.join(f'{name} {many}' for name, many in names.most_common(4))
    told = sum(bool(record.get('told')) for record in records)
    return (f'| {kind} | {stated} | {len(records)} | {share(len(false), len(records))} | '
            f'{percent(count["false"] + count["failed"], len(records))} | {count["right"]} | '
            f'{sum(bool(record.get("unexplained")) for record in records)} | {told} | {said} |')


def total(groups: dict[str, list[Record]]) -> str:
    """Return the line under the table."""
    runs = [record for records in groups.values() for record in records]
    bad = sum(not is_good(record) for record in runs)
    return f'Runs: {len(runs)}; with a false name: {bad} ({percent(bad, len(runs))})'
