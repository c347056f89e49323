# SPDX-License-Identifier: Apache-2.0
"""Options, processes, progress, JSON and comparison of the blind tests."""

import argparse
import contextlib
import functools
import itertools
import json
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks.blind import causes_table, coverage_table, library_table, noise_table, power_table
from benchmarks.blind.answers import Record
from benchmarks.blind.noise_kinds import EVERY
from benchmarks.blind.runs import ORDERS
from rosette_ros.core.scheme import ORDERS as EVERY_ORDER
from rosette_ros.core.scheme import TURNINGS

TABLES: tuple[ModuleType, ...] = (noise_table, causes_table, library_table, power_table, coverage_table)
UNASKED = TABLES[:3]
"""The tables that are made where none is asked for: the others take hours."""


def options(argv: list[str] | None) -> argparse.Namespace:
    """Return the options of the command."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind', description='Blind tests of the diagnosis.')
    for table in TABLES:
        parser.add_argument(f'--{table.NAME}', nargs='*', metavar='KIND',
                            help=f'{table.__doc__.splitlines()[0]} Some kinds, or all'.replace('%', '%%'))
    parser.add_argument('--orders', nargs='+', choices=EVERY_ORDER, default=list(ORDERS))
    parser.add_argument('--seeds', type=int, default=20, help='runs of each kind and order')
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('--strength', type=float, nargs='+', help='norm of what is visible, in σ')
    parser.add_argument('--beside', default='white', choices=EVERY, metavar='KIND',
                        help='noise beside what --causes, --library and --power hide')
    parser.add_argument('--together', type=int, default=1, help='effects of the library hidden at once')
    parser.add_argument('--turning', choices=TURNINGS, default='forward', help='of runs that hide effects')
    parser.add_argument('-n', '--balls', dest='n', type=int, default=12)
    parser.add_argument('--stated', choices=('yes', 'no'),
                        help='only runs with, or without, a stated repeatability (default: both)')
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path, metavar='FILE', help='write every run and what was said of it')
    parser.add_argument('--compare', type=Path, metavar='OLD.json', help='compare with what an earlier run wrote')
    parser.add_argument('--list', action='store_true', help='print every answer that is not right')
    arguments = parser.parse_args(argv)
    arguments.tables = [one for one in TABLES if getattr(arguments, one.NAME) is not None] or list(UNASKED)
    arguments.seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for complaint in filter(None, (_unknown(table, getattr(arguments, table.NAME)) for table in arguments.tables)):
        parser.error(complaint)
    return arguments


def _unknown(table: ModuleType, asked: list[str] | None) -> str:
    """Return what is wrong with the kinds that were asked for, '' where nothing is."""
    unknown = [kind for kind in asked or () if kind not in table.KNOWN]
    beyond = 'beyond, or ' if 'beyond' in table.KNOWN else ''
    known = ', '.join(kind for kind in table.KNOWN if kind != 'beyond')
    return f'--{table.NAME}: wanted {beyond}some of {known}; got {", ".join(unknown)}' if unknown else ''


def work(task: tuple[str, str, tuple[Any, ...]]) -> tuple[str, Record]:
    """Return the group and the record of one run; one that fails is counted and told."""
    table, group, given = task
    try:
        return group, sys.modules[f'benchmarks.blind.{table}'].trial(*given)
    except Exception:
        return group, {'judged': 'failed', 'given': [str(one) for one in given], 'text': traceback.format_exc()}


def main(argv: list[str] | None = None) -> int:
    """Make the tables; return 1 where a run failed."""
    arguments = options(argv)
    old = json.loads(arguments.compare.read_text()) if arguments.compare else {}
    made: dict[str, dict[str, list[Record]]] = {}
    with contextlib.ExitStack() as stack:
        answers: Callable[..., Iterable[Any]] = map
        if arguments.jobs > 1:
            pool = stack.enter_context(multiprocessing.get_context('spawn').Pool(arguments.jobs))
            answers = functools.partial(pool.imap, chunksize=2)
        for table in arguments.tables:
            made[table.NAME] = _make(table, arguments, answers, old.get(table.NAME, {}))
            if arguments.json:
                arguments.json.write_text(json.dumps(made, indent=0, ensure_ascii=False))
    failed = [record for groups in made.values() for records in groups.values() for record in records
              if record['judged'] == 'failed']
    for record in failed[:3]:
        print(record['given'], record['text'], sep='\n', file=sys.stderr)
    return int(bool(failed))


def _make(table: ModuleType, arguments: argparse.Namespace, answers: Callable[..., Iterable[Any]],
          old: dict[str, list[Record]]) -> dict[str, list[Record]]:
    """Print a table group by group as its runs end, and return the records by group."""
    began = time.perf_counter()
    file = table.__name__.split('.')[-1]
    tasks = [(file, group, given) for group, given in table.tasks(arguments)]
    groups: dict[str, list[Record]] = {}
    print(f'\n{table.__doc__.splitlines()[0]}\n\n{table.HEADING}', flush=True)
    for group, records in itertools.groupby(answers(work, tasks), key=lambda pair: pair[0]):
        groups[group] = [record for _, record in records]
        print(table.row(group, groups[group]), flush=True)
        if arguments.list:
            for record in groups[group]:
                if not table.is_good(record):
                    print('   ', {key: value for key, value in record.items() if key not in ('sentence', 'seconds')})
        if group in old:
            pairs = _same(old[group], groups[group])
            print('   ', table.difference(pairs) if hasattr(table, 'difference') else _difference(table, pairs),
                  flush=True)
    print(f'\n{table.total(groups)}')
    seconds = [record['seconds'] for records in groups.values() for record in records if 'seconds' in record]
    print(f'{len(tasks)} runs in {time.perf_counter() - began:.0f} s; a diagnosis took '
          f'{sum(seconds) / max(len(seconds), 1):.2f} s, at most {max(seconds, default=0):.2f} s', flush=True)
    return groups


def _difference(table: ModuleType, pairs: list[tuple[Record, Record]]) -> str:
    """Return how the answers to the same runs have changed."""
    good = [(table.is_good(was), table.is_good(now)) for was, now in pairs]
    return (f'right before {sum(was for was, _ in good)}, now {sum(now for _, now in good)} of {len(good)} same '
            f'runs; mended {sum(now and not was for was, now in good)}, '
            f'broken {sum(was and not now for was, now in good)}')


def _same(old: list[Record], new: list[Record]) -> list[tuple[Record, Record]]:
    """Return the records of the same runs, old and new."""
    before = {_which(record): record for record in old}
    return [(before[_which(record)], record) for record in new if _which(record) in before]


def _which(record: Record) -> tuple[str, ...]:
    keys = ('order', 'seed', 'n', 'strength', 'stated', 'noise', 'turning', 'hidden')
    return tuple(str(record.get(key)) for key in keys)
