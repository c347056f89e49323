# SPDX-License-Identifier: Apache-2.0
"""Readings until the cause is known: blocks that are chosen against the order repeated, stopped by the same rule.

    python -m benchmarks.blind.until --order sensitive --machines 100

Each machine hides one or two effects of 9 to 12 sigma in its first run. Both ways go on from there by the same numbers
of readings, STEPS, until the names are settled (core/planning/next_readings.py) or MOST readings are made.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise, repeat
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.blind.answers import Record
from benchmarks.blind.runs import CHECK, SIGMA, Plan, scaled, situation, state_repeatability
from benchmarks.blind.trial import NotShown
from rosette_ros.core.planning.block_ways import NEXT
from rosette_ros.core.planning.next_readings import NextReadings, next_readings, standing
from rosette_ros.core.records import Floats, Run
from rosette_ros.core.scheme import Scheme
from rosette_ros.simulation.hidden_effect import Draw
from rosette_ros.simulation.hidden_kinds import KINDS as HIDDEN
from rosette_ros.simulation.hidden_kinds import NAMED

STEPS = 12, 12, 12, 12, 24, 24
"""Readings after each of which it is asked whether all is settled; the last one again and again."""
MOST = 3
"""Runs of n * n readings after which it is given up."""
STRONG = 9.0, 12.0
HEAD = ('| machines | blocks | number | settled | wrong then | no block helps | readings, median | beyond the first '
        'run | h, median of settled |\n|---|---|---|---|---|---|---|---|---|')
KIND = tuple(name for name in NAMED if name != 'outlier')


class Cell:
    """A cell that goes on measuring: machines with and without each effect in the same state, and the noise."""

    def __init__(self, made: Plan, name: str, kinds: Sequence[str]) -> None:
        rng = np.random.default_rng([crc32(name.encode()), 1])
        self.made, self._noise = made, np.random.default_rng([crc32(name.encode()), 2])
        clean, machine = made.measure()
        by = Draw(rng, 1.0, situation(clean, machine))
        drawn = [HIDDEN[kind].draw(by) for kind in kinds]
        self._machines = [made.machine(), *(made.machine(one) for one in drawn)]
        first = [machine.calibrate(made.scheme) for machine in self._machines]
        runs = [run for run, _, _ in first]
        self._frames, self._begin = [alignment.frame for _, alignment, _ in first], first[0][2].time[0]
        shifts = [scaled(clean, run.centre - runs[0].centre, float(rng.uniform(*STRONG))) for run in runs[1:]]
        if any(shift is None for _, shift in shifts):
            raise NotShown(f'{name}: hidden')
        self._factor = [float(np.linalg.norm(shift) / np.linalg.norm(_centred(run.centre - runs[0].centre)))
                        for run, (_, shift) in zip(runs[1:], shifts) if shift is not None]
        check = SIGMA * self._noise.standard_normal((CHECK, 3))
        self.run = state_repeatability(runs[0].replace(centre=self._centres([run.centre for run in runs]),
                                                       repeatability=None, repeatability_dof=None), check)

    def _centres(self, every: Sequence[Floats]) -> Floats:
        shift = sum((factor * (one - every[0]) for factor, one in zip(self._factor, every[1:])), np.zeros((1, 3)))
        return np.asarray(every[0] + shift + SIGMA * self._noise.standard_normal(every[0].shape))

    def measure(self, scheme: Scheme) -> None:
        """Measure a block after what was measured."""
        nominal, found = scheme.centres(self.run.radius), []
        for machine, frame in zip(self._machines, self._frames):
            found.append(machine.measure_many(scheme.table_position, scheme.ball, scheme.approach,
                                              frame.to_outer(nominal), wait=scheme.wait))
        of, centres = found[0], [frame.to_inner(one.centre) for frame, one in zip(self._frames, found)]
        run = self.run
        more = {'table_position': of.table_position, 'ball': of.ball, 'centre': self._centres(centres),
                'time': of.time - self._begin, 'table_angle': of.table_angle, 'temperature': of.temperature,
                'approach': of.approach, 'table_travel': of.table_travel, 'session': np.ones(of.ball.size)}
        self.run = run.replace(repeats=True, **{
            name: np.concatenate([getattr(run, name), new]) for name, new in more.items()})


def _centred(shift: Floats) -> Floats:
    return np.asarray(shift - shift.mean(axis=0))


@dataclass(frozen=True)
class Search:
    """One machine by its number: what it hides, in which order it measures, and how it goes on."""

    order: str
    number: int
    chosen: bool
    n: int = 12
    until: float = 0.95

    @property
    def kinds(self) -> tuple[str, ...]:
        """What it hides: one or two effects."""
        rng = np.random.default_rng([crc32(self.order.encode()), self.number])
        return tuple(rng.choice(KIND, 1 + self.number % 2, replace=False).tolist())

    def settled(self) -> Record:
        """Return how many readings it took, and what was said then."""
        name = f'until {self.order} {self.number} {"+".join(self.kinds)}'
        cell = Cell(Plan(self.n, self.order, crc32(name.encode()) % 2**31), name, self.kinds)
        way, seconds, path = 'chosen' if self.chosen else 'repeated', 0.0, list[Any]()
        found = self._found(cell.run, STEPS[0])
        for step, ahead in pairwise(chain(STEPS, repeat(STEPS[-1]))):
            path.append([cell.run.size, {' + '.join(one.names): round(one.probability, 4)
                                         for one in found.contenders[:4]}])
            if found.is_settled or found.is_hopeless or cell.run.size >= MOST * self.n**2:
                break
            cell.measure(found.targets or _on(cell.made.scheme, cell.run.size, step))
            began = time.perf_counter()
            found = self._found(cell.run, ahead)
            seconds = max(seconds, time.perf_counter() - began)
        return {'name': name, 'kinds': self.kinds, 'way': way, 'readings': cell.run.size, 'settled': found.is_settled,
                'hopeless': found.is_hopeless, 'hours': float(cell.run.time[-1]) / 3600, 'path': path,
                'said': list(found.contenders[0].names), 'right': _is_right(found, self.kinds), 'seconds': seconds}

    def _found(self, run: Run, readings: int) -> NextReadings:
        return next_readings(run, readings=readings, until=self.until) if self.chosen else standing(
            run, until=self.until)


def _is_right(found: NextReadings, kinds: Sequence[str]) -> bool:
    return sorted(found.contenders[0].names) == sorted(kinds)


def _on(scheme: Scheme, start: int, count: int) -> Scheme:
    """Return the next readings of an order that is repeated without end."""
    at = (start + np.arange(count)) % scheme.ball.size
    return Scheme(scheme.n, NEXT, 0, scheme.table_position[at], scheme.ball[at], scheme.approach[at])


def work(search: Search) -> Record:
    """Return the record of a machine; one that shows nothing is skipped."""
    try:
        return search.settled()
    except NotShown as why:
        return {'name': str(why), 'skipped': True}


def main(argv: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind.until', description=__doc__.splitlines()[0])
    parser.add_argument('--order', default='sensitive')
    parser.add_argument('--machines', type=int, default=100)
    parser.add_argument('--first', type=int, default=1)
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path)
    options = parser.parse_args(argv)
    todo = [Search(options.order, number, chosen) for number in range(options.first, options.first + options.machines)
            for chosen in (True, False)]
    records = []
    with multiprocessing.get_context('spawn').Pool(options.jobs) as pool:
        for one in pool.imap(work, todo):
            records.append(one)
            if options.json:
                options.json.write_text(json.dumps(records, indent=0))
    print(table(records))
    return 0


def table(records: Sequence[Record]) -> str:
    """Return the table of both ways as Markdown, of the machines at which both have ended."""
    rows = [HEAD]
    every = {way: {one['name']: one for one in records if one.get('way') == way} for way in ('chosen', 'repeated')}
    names = sorted(set(every['chosen']) & set(every['repeated']))
    for what, some in (('all', names), ('in doubt after the first run', [
            name for name in names if every['chosen'][name]['readings'] > every['chosen'][name]['path'][0][0]
            or every['chosen'][name]['hopeless']])):
        medians = []
        for way, own in every.items():
            each = [own[name] for name in some]
            size = [one['readings'] if one['settled'] else np.inf for one in each] or [np.nan]
            beyond = [one['readings'] - one['path'][0][0] if one['settled'] else np.inf for one in each] or [np.nan]
            medians.append((float(np.median(size)), float(np.median(beyond))))
            settled = [one for one in each if one['settled']]
            wrong, hopeless = sum(not one['right'] for one in settled), sum(one['hopeless'] for one in each)
            hours = float(np.median([one['hours'] for one in settled] or [np.nan]))
            rows.append(f'| {what} | {way} | {len(each)} | {len(settled)} | {wrong} | {hopeless} '
                        f'| {medians[-1][0]:.0f} | {medians[-1][1]:.0f} | {hours:.2f} |')
        (one, more), (other, others) = medians
        rows.append(f'| | ratio | | | | | {one / other:.2f} | {more / others if others else np.nan:.2f} | |')
    slowest = max((one['seconds'] for one in every['chosen'].values()), default=0.0)
    return '\n'.join([*rows, '', f'A block, the diagnosis before it included, took {slowest:.1f} s at most.'])


if __name__ == '__main__':
    sys.exit(main())
