# SPDX-License-Identifier: Apache-2.0
"""Cells: six runs each of one machine, with causes that come again, and how it is judged what is said of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from benchmarks.blind.library import COMPOSED, LIBRARY
from benchmarks.blind.runs import Plan, noisy, scaled, situation
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.free import OF, TIMES
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import Scheme, plan
from rosette_ros.simulation.hidden_effect import Draw, HiddenEffect
from rosette_ros.simulation.hidden_kinds import KINDS as HIDDEN
from rosette_ros.simulation.hidden_kinds import NAMED

CELLS, CLEAN, RUNS = 60, 4, 6
"""Cells of the set, of which every CLEANth hides nothing that comes again, and runs of each."""
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
