# SPDX-License-Identifier: Apache-2.0
"""Readings until the cause is known: blocks that are chosen against the order that goes on, stopped by the same rule.

    python -m benchmarks.blind.until --order interleaved --machines 100

Each machine hides one or two effects, which show with 9 to 12 sigma in its complete first run. Both ways begin with the
fewest readings of the order, in steps of n, that determine the curves, and follow it as long as nothing is missing.
Then one measures what is chosen (core/planning/next_readings.py), the other the order, repeated without end, until what
is missing has a name and every name is settled; that nothing is missing is taken from a complete run only. It is asked
after n readings each, 2 n from the complete run on, and given up after MOST runs.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.blind.answers import Record
from benchmarks.blind.runs import CHECK, SIGMA, Plan, scaled, situation, state_repeatability
from benchmarks.blind.trial import NotShown
from rosette_ros.analysis import analyse
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.planning.block_ways import NEXT
from rosette_ros.core.planning.next_readings import NextReadings, next_readings, standing
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.run.scheme import Scheme, Way
from rosette_ros.simulation.hidden_effect import Draw
from rosette_ros.simulation.hidden_kinds import KINDS as HIDDEN
from rosette_ros.simulation.hidden_kinds import NAMED

MOST = 2
"""Runs of n * n readings after which it is given up."""
STRONG = 9.0, 12.0
HEAD = ('| machines | blocks | number | settled | wrong name then | not all named | no block helps | readings, median '
        '| beyond the common begin | h, median of settled |\n|---|---|---|---|---|---|---|---|---|---|')
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
        runs = [machine.run(made.scheme) for machine in self._machines]
        shifts = [scaled(clean, run.centre - runs[0].centre, float(rng.uniform(*STRONG))) for run in runs[1:]]
        if any(shift is None for _, shift in shifts):
            raise NotShown(f'{name}: hidden')
        self._factor = [float(np.linalg.norm(shift) / np.linalg.norm(_centred(run.centre - runs[0].centre)))
                        for run, (_, shift) in zip(runs[1:], shifts) if shift is not None]
        self._machines = [made.machine(), *(made.machine(one) for one in drawn)]
        first = [machine.calibrate(on(made.scheme, 0, fewest(clean))) for machine in self._machines]
        runs = [run for run, _, _ in first]
        self._frames, self._begin = [alignment.frame for _, alignment, _ in first], first[0][2].time[0]
        check = SIGMA * self._noise.standard_normal((CHECK, 3))
        centre = self._centres([run.centre for run in runs])
        self.run = state_repeatability(runs[0].replace(
            table_position=runs[0].table_position, centre=centre, repeatability=None, repeatability_dof=None), check)
        self._ordered = self.run.size

    def follow(self) -> None:
        """Measure what is next in the order, without end."""
        step = self.step
        self.measure(on(self.made.scheme, self._ordered, step))
        self._ordered += step

    @property
    def is_complete(self) -> bool:
        """Whether as many readings are made as a complete run has."""
        return self.run.size >= self.made.n**2

    @property
    def step(self) -> int:
        """Readings after which it is asked again."""
        return self.made.n * (1 + self.is_complete)

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
        joined = {name: np.concatenate([getattr(run, name), new]) for name, new in more.items()}
        went = Way(joined['table_position'], joined['ball'], joined['approach'], np.arange(len(joined['ball'])))
        self.run = run.replace(repeats=True, cmm_sense=went.cmm_sense(run.n, run.rotation), **joined)  # as a log has it


def _centred(shift: Floats) -> Floats:
    return np.asarray(shift - shift.mean(axis=0))


def fewest(run: Run) -> int:
    """Return how many of the readings of a run, in steps of n, determine the curves."""
    for size in range(run.n, run.size, run.n):
        try:
            analyse(run.take(np.arange(size)))
        except NotDeterminable:
            continue
        return size
    return run.size


@dataclass(frozen=True)
class Search:
    """One machine by its number: what it hides, and in which order it measures."""

    order: str
    number: int
    n: int = 12
    until: float = 0.95

    @property
    def kinds(self) -> tuple[str, ...]:
        """What it hides: one or two effects."""
        rng = np.random.default_rng([crc32(self.order.encode()), self.number])
        return tuple(rng.choice(KIND, 1 + self.number % 2, replace=False).tolist())

    def records(self) -> list[Record]:
        """Return how many readings it took, and what was said then, by chosen blocks and by the order."""
        name = f'until {self.order} {self.number} {"+".join(self.kinds)}'
        cell = Cell(Plan(self.n, self.order, crc32(name.encode()) % 2**31), name, self.kinds)
        begin, path = cell.run.size, list[Any]()
        while (found := self._judged(cell)).is_settled and not self._ends(cell, found):
            path.append(_point(cell, found))
            cell.follow()
        return [{'name': name, 'kinds': self.kinds, 'begin': begin, 'chosen': chosen,
                 **self._settled(deepcopy(cell), chosen, list(path))} for chosen in (True, False)]

    def _judged(self, cell: Cell) -> NextReadings:
        """Return what is known as soon as the readings of the order are enough to judge."""
        while True:
            try:
                return standing(cell.run, until=self.until)
            except NotDeterminable:
                cell.follow()

    def _ends(self, cell: Cell, found: NextReadings) -> bool:
        return found.is_settled and (found.contenders[0].members != () or cell.is_complete)

    def _settled(self, cell: Cell, chosen: bool, path: list[Any]) -> Record:
        """Return how a machine of which something is in doubt goes on."""
        seconds = 0.0
        while True:
            began = time.process_time()
            found = next_readings(cell.run, readings=cell.step, until=self.until) if chosen else standing(
                cell.run, until=self.until)
            seconds = max(seconds, time.process_time() - began)
            path.append(_point(cell, found))
            given_up = (cell.is_complete and found.is_hopeless) or cell.run.size >= MOST * self.n**2
            if given_up or self._ends(cell, found):
                break
            if found.targets is None:
                cell.follow()
            else:
                cell.measure(found.targets)
        return {'readings': cell.run.size, 'settled': found.is_settled, 'hopeless': found.is_hopeless,
                'hours': float(cell.run.time[-1]) / 3600, 'path': path, 'said': list(found.contenders[0].members),
                'right': _is_right(found, self.kinds), 'seconds': seconds}


def _point(cell: Cell, found: NextReadings) -> list[Any]:
    """Return what was known after so many readings."""
    return [cell.run.size, {' + '.join(one.members): round(one.probability, 4) for one in found.contenders[:4]}]


def _is_right(found: NextReadings, kinds: Sequence[str]) -> bool:
    return sorted(found.contenders[0].members) == sorted(kinds)


def on(scheme: Scheme, start: int, count: int) -> Scheme:
    """Return the next readings of an order that is repeated without end."""
    at = (start + np.arange(count)) % scheme.ball.size
    return Scheme(scheme.n, NEXT, 0, scheme.table_position[at], scheme.ball[at], scheme.approach[at])


def work(search: Search) -> list[Record]:
    """Return the records of a machine, by both ways; one that shows nothing, or cannot be judged, is skipped."""
    of = {'order': search.order, 'n': search.n, 'number': search.number}
    try:
        return [{**of, **one} for one in search.records()]
    except (NotShown, NotDeterminable) as why:
        return [{**of, 'chosen': chosen, 'name': str(why), 'skipped': True} for chosen in (True, False)]


def main(argv: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind.until', description=__doc__.splitlines()[0])
    parser.add_argument('--order', default='interleaved')
    parser.add_argument('--machines', type=int, default=100)
    parser.add_argument('--first', type=int, default=1)
    parser.add_argument('--balls', type=int, default=12)
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path, metavar='FILE', help='keep every machine; those it has are not repeated')
    options = parser.parse_args(argv)
    records = json.loads(options.json.read_text()) if options.json and options.json.exists() else []
    known = {(one['order'], one['n'], one['number']) for one in records}
    todo = [Search(options.order, number, options.balls)
            for number in range(options.first, options.first + options.machines)
            if (options.order, options.balls, number) not in known]
    with multiprocessing.get_context('spawn').Pool(options.jobs) as pool:
        for both in pool.imap_unordered(work, todo):
            records += both
            if options.json:
                options.json.write_text(json.dumps(records, indent=0))
    print(table([one for one in records if (one['order'], one['n']) == (options.order, options.balls)]))
    return 0


def table(records: Sequence[Record]) -> str:
    """Return the table of both ways as Markdown, of the machines at which both have ended."""
    rows = [HEAD]
    every = {way: {one['name']: one for one in records if one['chosen'] == is_chosen and 'skipped' not in one}
             for way, is_chosen in (('chosen', True), ('repeated', False))}
    names = sorted(set(every['chosen']) & set(every['repeated']))
    open_ones = [name for name in names if every['chosen'][name]['path'] != every['repeated'][name]['path']]
    for what, some in (('all', names), ('in doubt at some step', open_ones)):
        medians = []
        for way, own in every.items():
            each = [own[name] for name in some]
            known = [one['settled'] and one['right'] for one in each]
            size = [one['readings'] if is_known else np.inf for one, is_known in zip(each, known)] or [np.nan]
            beyond = [one['readings'] - one['begin'] if is_known else np.inf for one, is_known in zip(each, known)]
            medians.append((float(np.median(size)), float(np.median(beyond or [np.nan]))))
            settled = [one for one in each if one['settled']]
            wrong = sum(bool(set(one['said']) & EFFECTS.keys() - set(one['kinds'])) for one in settled)
            fewer, hopeless = len(settled) - sum(known) - wrong, sum(one['hopeless'] for one in each)
            hours = float(np.median([one['hours'] for one in settled] or [np.nan]))
            rows.append(f'| {what} | {way} | {len(each)} | {len(settled)} | {wrong} | {fewer} | {hopeless} '
                        f'| {medians[-1][0]:.0f} | {medians[-1][1]:.0f} | {hours:.2f} |')
        (one, more), (other, others) = medians
        rows.append(f'| | ratio | | | | | | {one / other:.2f} | {more / others if others else np.nan:.2f} | |')
    slowest = max((one['seconds'] for one in every['chosen'].values()), default=0.0)
    said = f'A block, the diagnosis before it included, took {slowest:.1f} s of a processor at most.'
    return '\n'.join([*rows, '', said])


if __name__ == '__main__':
    sys.exit(main())
