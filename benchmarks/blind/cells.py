# SPDX-License-Identifier: Apache-2.0
"""Cells: six runs each of one machine, with causes that come again, and how it is judged what is said of them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from benchmarks.blind.answers import Record
from benchmarks.blind.library import COMPOSED, LIBRARY
from benchmarks.blind.runs import Plan, noisy, scaled, situation
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.free import OF, TIMES
from rosette_ros.core.joint.cell_rates import CellRates
from rosette_ros.core.joint.run_causes import causes_in
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import Scheme, plan
from rosette_ros.simulation.hidden_effect import Draw, HiddenEffect
from rosette_ros.simulation.hidden_kinds import KINDS as HIDDEN
from rosette_ros.simulation.hidden_kinds import NAMED

CELLS, CLEAN, RUNS = 60, 4, 6
"""Cells of the set; one of so many hides nothing that comes again; runs of each."""
ORDERS = ('interleaved', 'random', 'interleaved', 'diagonal')
"""As laboratories take them."""
HERE, NEW = 0.7, 0.1
"""Share of the runs in which a cause of the cell is, and in which one is that the cell has not."""
STRENGTHS = 4.0, 7.0
"""Visible norm of a cause in a run, σ, drawn anew in each."""
CONSTANTS = ('time_constant_h', 'period_min', 'scale_turns', 'order', 'ball', 'direction')
"""What of a cause belongs to the machine and is the same in all runs; all else is drawn anew."""
COMING = tuple(name for name in NAMED if LAWS[name].carries != 'nothing')
"""What may come again: no events."""


SAID, LIKELY = 0.01, 0.5
"""Probabilities from which on a name is kept, and counts as said."""
BINS = 0.03, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97
"""Edges of the stated probabilities."""


@dataclass(frozen=True)
class CellPlan(Plan):
    """A Plan whose random order is not drawn from the seed of the machine."""

    draw: int = 0

    @property
    def scheme(self) -> Scheme:
        """The order in which it measures."""
        return plan(self.n, self.order, self.draw, self.turning)


@dataclass(frozen=True)
class HiddenRun:
    """A run of a cell; names: of all that it hides; new: those that the cell has not."""

    run: Run
    names: tuple[str, ...]
    new: tuple[str, ...]
    order: str


def causes_of_cell(cell: int) -> tuple[str, ...]:
    """Return the causes of a cell, none of a clean one."""
    if cell % CLEAN == CLEAN - 1:
        return ()
    rng = _generator(cell, 'causes')
    return tuple(str(one) for one in rng.choice(COMING, int(rng.integers(2, 4)), replace=False))


def runs_of(cell: int, n: int = 12, strength: float = 0.0) -> list[HiddenRun]:
    """Return the runs of a cell; strength: of its causes, σ, drawn from STRENGTHS where it is 0."""
    causes, first = causes_of_cell(cell), dict[str, HiddenEffect]()
    return [_run_of(cell, k, causes, first, n, strength) for k in range(RUNS)]


def _run_of(cell: int, k: int, causes: Sequence[str], first: dict[str, HiddenEffect], n: int,
            strength: float) -> HiddenRun:
    rng, machine = _generator(cell, f'run {k}'), int(_generator(cell, 'machine').integers(1, 2**31))
    here = [name for name in causes if rng.uniform() < HERE]
    others = [name for name in NAMED if name not in causes and name != 'outlier']
    new = [str(rng.choice(others))] if rng.uniform() < NEW else []
    order, draw = str(rng.choice(ORDERS)), int(rng.integers(1, 2**31))
    orders = dict.fromkeys((order, *ORDERS))
    for order in orders:
        made = CellPlan(n, order, machine, draw=draw)
        clean, simulated = made.measure()
        by, shifts = Draw(_generator(cell, f'effects {k}'), 1.0, situation(clean, simulated)), {}
        for name in (*here, *new):
            one = HIDDEN[name].draw(by)
            if name in causes:
                kept = {key: value for key, value in dict(first.setdefault(name, one)).items() if key in CONSTANTS}
                one = one.model_copy(update=kept)
            size = strength or float(_generator(cell, f'size {k} {name}').uniform(*STRENGTHS))
            shifts[name] = scaled(clean, made.measure(one)[0].centre - clean.centre, size)[1]
        if all(one is not None for one in shifts.values()):
            break
    shown = {name: one for name, one in shifts.items() if one is not None}
    shift = sum(shown.values(), np.zeros((clean.size, 3)))
    run, _ = noisy(clean, 'white', _generator(cell, f'noise {k}'), True, shift)
    run = replace(run, run_id=f'cell {cell} run {k + 1}', source=f'cell {cell} run {k + 1}')
    return HiddenRun(run, tuple(shown), tuple(name for name in new if name in shown), order)


def _generator(cell: int, what: str) -> np.random.Generator:
    return np.random.default_rng([77, cell, crc32(what.encode())])


def agrees(said: str, hidden: str) -> bool:
    """Return whether a name says the same body and kind of dependence as what is hidden."""
    body, variables = (COMPOSED | LIBRARY)[hidden]
    if OF in said:
        with_what, _, moved = said.partition(OF)
        return moved in body and frozenset(with_what.split(TIMES)) in variables
    moves, with_which = (COMPOSED | LIBRARY).get(said, ((), ()))
    return said == hidden or bool({*moves} & {*body} and {*with_which} & {*variables})


def cell_record(cell: int, n: int = 12) -> Record:
    """Return what is said of the runs of a cell, each by itself and together, and what they hide."""
    hidden, causes, seconds = runs_of(cell, n), [], 0.0
    for one in hidden:
        began = time.perf_counter()
        causes.append(causes_in(RunSearch(one.run, Model())))
        seconds += time.perf_counter() - began
    began = time.perf_counter()
    rates = CellRates(causes)
    together = time.perf_counter() - began
    return {
        'cell': cell, 'causes': list(causes_of_cell(cell)), 'seconds': seconds, 'seconds_together': together,
        'properties': {name: p for name in rates.candidates if (p := rates.again(name)) > SAID},
        'runs': [{
            'hidden': list(one.names), 'new': list(one.new), 'order': one.order,
            'kinds': {name: [said.of([each for each in said.names if agrees(each, name)], p)
                             for p in (said.p, rates.posteriors[place])] for name in one.names},
            'names': {name: [alone, together_p] for name, alone in said.alone.items() for together_p in [
                rates.p(place, name)] if max(alone, together_p) > SAID}}
            for place, (one, said) in enumerate(zip(hidden, causes))]}


def cell_table(records: Sequence[Record]) -> str:
    """Return the figures of cells in Markdown, of single runs and of their cells."""
    alone, together = (np.mean([one[key] for one in records]) for key in ('seconds', 'seconds_together'))
    rows = [f'{len(records)} cells of {RUNS} runs; a cell took {together:.2f} s beside {alone:.1f} s for its runs.', '',
            '| | one run alone | with the cell |', '|---|---|---|']
    runs = [run for one in records for run in one['runs']]

    def counted(title: str, some: Sequence[tuple[bool, bool]]) -> None:
        shares = [f'{sum(each[k] for each in some)} of {len(some)} ({100 * np.mean([each[k] for each in some]):.0f} %)'
                  for k in (0, 1)] if some else ['', '']
        rows.append(f'| {title} | {shares[0]} | {shares[1]} |')

    def above(run: Record, key: str, wanted: Callable[[str], bool]) -> list[tuple[bool, bool]]:
        return [(p[0] > LIKELY, p[1] > LIKELY) for name in run['hidden'] if wanted(name)
                for p in [run[key].get(name, [0.0, 0.0])]]

    again = [(run, set(run['hidden']) - set(run['new'])) for run in runs]
    counted('a cause that comes again, in a run, above 0.5: by body and kind',
            [each for run, some in again for each in above(run, 'kinds', some.__contains__)])
    counted('by its name', [each for run, some in again for each in above(run, 'names', some.__contains__)])
    counted('a cause that is new to the cell, by its name',
            [each for run in runs for each in above(run, 'names', run['new'].__contains__)])
    counted('by body and kind', [each for run in runs for each in above(run, 'kinds', run['new'].__contains__)])

    def false(run: Record, is_kind: bool = False) -> tuple[bool, bool]:
        wrong = [p for name, p in run['names'].items() if name not in run['hidden'] and not (
            is_kind and any(agrees(name, one) for one in run['hidden']))]
        return any(p[0] > LIKELY for p in wrong), any(p[1] > LIKELY for p in wrong)

    counted('runs with a name above 0.5 that is not true', [false(run) for run in runs])
    counted('of these by body and kind, too', [false(run, True) for run in runs])
    counted('runs that hide nothing with a name', [false(run) for run in runs if not run['hidden']])
    found = [(name in one['causes'], p) for one in records for name, p in one['properties'].items() if p > LIKELY]
    clean = [one for one in records if not one['causes']]
    spared = sum(max(one['properties'].values(), default=0.0) <= LIKELY for one in clean)
    rows += ['', f'Of {sum(len(one["causes"]) for one in records)} causes that come again '
             f'{sum(true for true, _ in found)} are said to be properties of their cells, and '
             f'{sum(not true for true, _ in found)} that are none. {spared} of {len(clean)} clean cells have none.', '',
             '| stated probability | names, alone | true | names, with the cell | true |',
             '|---|---|---|---|---|']
    for low, high in zip(BINS, (*BINS[1:], 1.01)):
        cells = []
        for k in (0, 1):
            some = [(p[k], name in run['hidden']) for run in runs for name, p in run['names'].items()
                    if low <= p[k] < high]
            cells += [f'{len(some)}, stated {np.mean([p for p, _ in some]):.2f}', f'{np.mean([t for _, t in some]):.2f}'
                      ] if some else ['0', '']
        rows.append(f'| {low:g} to {min(high, 1):g} | {" | ".join(cells)} |')
    return '\n'.join(rows)
