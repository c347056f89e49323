# SPDX-License-Identifier: Apache-2.0
"""What several runs say of their cell."""

import datetime
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from rosette_ros.analysis import MOST_BALLS_ADVISED, MOST_BALLS_JUDGED, advise_run
from rosette_ros.api.measurement import Measurement
from rosette_ros.api.result import DrawnResult, plots
from rosette_ros.core.joint.cell_diagnosis import CellCause, CellDiagnosis, diagnose_cell, refuse_unlike, searched
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.records import Run
from rosette_ros.io.identity_file import Identity
from rosette_ros.presentation.cell_results import causes_in_runs, causes_of_runs, cell_causes, cell_json, cell_runs
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.cell_words import cell_words, order_words

OF_CELL = {'table.serial': 'table', 'cmm.serial': 'CMM'}
"""Entries of the identity that are the same in all runs of a cell, in words."""
_LOAD = re.compile(r'(?:^|[^\d.,\s]\s*)(\d+(?:[.,]\d{1,2})?)\s*kg')


class CellDiagnosed(DrawnResult):
    """What comes again in the runs of a cell, and what was there once; found: as the core has it."""

    def __init__(self, found: CellDiagnosis, first: Run) -> None:
        self.found, self._first, self.level = found, first, found.level.value

    @property
    def causes(self) -> tuple[CellCause, ...]:
        """The causes that come again, the likeliest first."""
        return self.found.properties

    @cached_property
    def orders(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """The order of measurement that would show what none of the runs could, with what it would show of it."""
        hidden, run = self.found.hidden, self._first
        if not hidden or run.n > MOST_BALLS_ADVISED:
            return ()
        best = advise_run(run, hidden).best
        shown = tuple(name for name in hidden if name in best.shares and not best.shares[name].hidden)
        return ((best.label, shown),) if shown else ()

    def to_mapping(self) -> dict[str, Any]:
        return cell_json(self.found, self.sentences(), self.orders)

    def sentences(self) -> tuple[str, ...]:
        return (*cell_words(self.found), *(order_words(names, order) for order, names in self.orders))

    def tables(self) -> tuple[Table, ...]:
        return cell_causes(self.found), causes_in_runs(self.found), cell_runs(self.found)

    def draw(self) -> Any:
        return plots('cell_plots').causes_against_runs(causes_of_runs(self.found))


def diagnosed_cell(every: Sequence[Measurement], model: Model,
                   step: Callable[[str, int], object] = lambda name, done: None) -> CellDiagnosed:
    """Return what the runs of a cell say of it; step: called with the name of each run before it is searched, done 0,
    and with '' and 1 after it.

    Raises InvalidData where they are not of one cell, or one is given twice."""
    _refuse_other_cells(every)
    refuse_unlike([(one.name, one.run) for one in every])
    runs = []
    for one in every:
        step(one.name, 0)
        runs.append(searched(one.name, one.run, model, conditions_of(one.run, one.identity)))
        step('', 1)
    return CellDiagnosed(diagnose_cell(runs), every[0].run)


def cell_of(every: Sequence[Measurement]) -> CellDiagnosis | None:
    """Return what runs say of their cell under the base model; None where they are not runs of one cell that are
    diagnosed unasked."""
    if any(one.has_plate or one.run.n > MOST_BALLS_JUDGED for one in every):
        return None
    try:
        return diagnosed_cell(every, Model()).found
    except (InvalidData, NotDeterminable):
        return None


def conditions_of(run: Run, identity: Identity) -> Mapping[str, float]:
    """Return by what sizes may change in a run beside its temperature: date, in days, and load, in kg, where stated."""
    out = {}
    if run.begun is not None:
        out['date'] = run.begun / 86400
    elif day := identity['measured.begin']:
        out['date'] = float((datetime.date.fromisoformat(day[:10]) - datetime.date(1970, 1, 1)).days)
    if load := _LOAD.search(identity['conditions.load']):
        out['load'] = float(load[1].replace(',', '.'))
    return out


def _refuse_other_cells(every: Sequence[Measurement]) -> None:
    for entry, words in OF_CELL.items():
        stated = [(one.name, serial) for one in every if (serial := one.identity[entry])]
        for name, serial in stated[1:]:
            if serial != stated[0][1]:
                raise InvalidData(f'{name}: expected a run of {words} {stated[0][1]}, as {stated[0][0]} is, found '
                                  f'{words} {serial}; diagnose the runs of each cell by themselves')
