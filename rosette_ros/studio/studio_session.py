# SPDX-License-Identifier: Apache-2.0
"""State of one browser's studio: opened runs, the model with undo, results, a preview. No page, no calculation.

Calculations take time elsewhere; a Ticket names the run and the model that a result belongs to. A result is kept under
its ticket, and shown only while that run and that model are shown.
"""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

from rosette_ros.analysis import MOST_BALLS_JUDGED, Change, Known, LadderStep, RunResult, Summary, Verdict
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import Run
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.presentation.report.provenance import Source
from rosette_ros.studio.stated import Stated

MOST_KEPT = 24
"""Results of so many pairs of run and model are kept."""
Ticket = tuple[Run, Model]
"""What a result belongs to."""


@dataclass(frozen=True, eq=False)
class OpenedRun:
    """An opened run and its name on the page.

    logged: where it comes from, and who, what and where of its log, None where that is not known; stated: besides."""

    name: str
    run: Run
    logged: Source | None = None
    stated: Stated = field(default_factory=Stated)

    @cached_property
    def source(self) -> Source | None:
        """Where it comes from, with what is stated in place of what its log says."""
        given = self.stated.identity
        if self.logged is None or not (given.entries or given.tolerances):
            return self.logged
        identity, changed = self.logged.identity.with_changes(given)
        return replace(self.logged, identity=identity, contradictions=(*self.logged.contradictions, *changed))

    @property
    def is_large(self) -> bool:
        """Whether it has so many balls that the diagnosis runs on request only."""
        return self.run.n > MOST_BALLS_JUDGED


@dataclass(frozen=True, eq=False)
class RunResults:
    """The results of a run under a model so far.

    previewed: what a preview has calculated; refusal: why the run cannot determine the model; problem: what else
    failed; inputs: stated for the uncertainty budget, None for nothing."""

    previewed: LadderStep | None = None
    fit: Fit | None = None
    ladder: tuple[LadderStep, ...] | None = None
    summary: Summary | None = None
    refusal: Verdict | None = None
    problem: str = ''
    inputs: BudgetInputs | None = None

    @property
    def verdict(self) -> Verdict | None:
        """The one verdict."""
        return self.summary.verdict if self.summary else self.refusal

    @cached_property
    def result(self) -> RunResult | None:
        """The result, which is as modelled until what is missing was looked for."""
        fit, found = (self.summary.fit, self.summary.diagnosis) if self.summary else (self.fit, None)
        if fit is None:
            return None
        bare = RunResult(fit, found)
        return bare if self.inputs is None or bare.budget is None else RunResult(fit, found, self.inputs)

    def with_inputs(self, inputs: BudgetInputs | None) -> 'RunResults':
        """Return these where inputs of the uncertainty budget are stated."""
        if inputs is None:
            return self
        summary = replace(self.summary, environment=inputs.environment) if self.summary else None
        return replace(self, summary=summary, inputs=inputs)


class Preview(NamedTuple):
    """What adding an effect would change."""

    name: str
    change: Change


class KeptResults:
    """The results that were asked for last, by their tickets; all browsers share them, as a run has one result."""

    def __init__(self) -> None:
        self._results: OrderedDict[Ticket, RunResults] = OrderedDict()

    def of(self, ticket: Ticket) -> RunResults:
        """Return the results of a run under a model so far."""
        if ticket in self._results:
            self._results.move_to_end(ticket)
        return self._results.get(ticket, RunResults())

    def keep(self, ticket: Ticket, **results: Any) -> None:
        """Keep results, fields of RunResults."""
        self._results[ticket] = replace(self.of(ticket), **results)
        while len(self._results) > MOST_KEPT:
            self._results.popitem(last=False)

    def known(self, run: Run, model: Model) -> Known:
        """Return what is known of a run on the way from the base terms to a model and beyond it."""
        every = [results for (other, _), results in self._results.items() if other == run]
        steps = {step.fit.model: step for one in every for step in (*(one.ladder or ()), one.previewed) if step and all(
            one == other for one, other in zip(step.fit.model.terms, model.terms))}
        return Known(tuple(steps.values()), next((one.summary.advice for one in every if one.summary), None))


@dataclass(eq=False)
class Session:
    """Opened runs, the model with undo and redo, results, a preview."""

    kept: KeptResults = field(default_factory=KeptResults)
    runs: tuple[OpenedRun, ...] = ()
    current: OpenedRun | None = None
    preview: Preview | None = None
    _history: list[tuple[Model, str]] = field(default_factory=lambda: [(Model(), '')])
    _place: int = 0
    _shown: tuple[RunResults, Stated, RunResults] | None = None

    # Runs

    def open(self, run: Run, name: str, source: Source | None = None) -> OpenedRun:
        """Add a run and show it; the model stays."""
        taken = {one.name for one in self.runs}
        names = (name, *(f'{name} ({count})' for count in range(2, len(taken) + 3)))
        opened = OpenedRun(next(one for one in names if one not in taken), run, source)
        self.runs = (*self.runs, opened)
        self.select(len(self.runs) - 1)
        return opened

    def select(self, place: int) -> None:
        """Show another opened run."""
        self.current, self.preview = self.runs[place], None

    def state(self, stated: Stated) -> None:
        """Replace what is stated of the run that is shown; raises InvalidData where it does not fit the run."""
        if self.current is None:
            return
        changed = replace(self.current, stated=stated)
        if changed.source:
            changed.source.identity.limits(changed.run.rotation)
        self.runs = tuple(changed if one is self.current else one for one in self.runs)
        self.current = changed

    # The model

    @property
    def model(self) -> Model:
        """The model as it is."""
        return self._history[self._place][0]

    def change_model(self, model: Model, words: str) -> None:
        """Replace the model; what was undone before is dropped."""
        self._history[self._place + 1:] = [(model, words)]
        self._go(1)

    def add(self, name: str, setting: Setting | None = None) -> None:
        """Add an effect; one that is in the model already is added with its setting fixed."""
        self.change_model(self.model_with(name, setting), f'add {name}')

    def add_entry(self, entry: Mapping[str, str]) -> None:
        """Add an entry as in a model file, such as a custom term; raises InvalidModel."""
        self.change_model(self.model.with_entry(entry), f'add {entry.get("own") or entry.get("name")}')

    def remove(self, place: int) -> None:
        """Remove the term at a place of model_parts."""
        model, first = self.model, place - len(self.model.base)
        smaller = replace(model, base=tuple(one for k, one in enumerate(model.base) if k != place),
                          terms=tuple(one for k, one in enumerate(model.terms) if k != first))
        self.change_model(smaller, f'remove {self.model_parts[place]}')

    def model_with(self, name: str, setting: Setting | None = None) -> Model:
        """Return the model with another effect; raises InvalidModel for an unknown name and one that cannot repeat."""
        stands = name in [term.name for term in self.model.terms]
        return self.model.with_effect(name, setting if stands else None)

    @property
    def model_parts(self) -> tuple[str, ...]:
        """The names of base terms and effects, in order."""
        return (*self.model.base, *map(str, self.model.terms))

    @property
    def undo_words(self) -> str:
        """What undo would take back; empty where there is nothing."""
        return self._history[self._place][1]

    @property
    def redo_words(self) -> str:
        """What redo would do again; empty where there is nothing."""
        return self._history[self._place + 1][1] if self._place + 1 < len(self._history) else ''

    def undo(self) -> None:
        """Go back to the model before, if there is one."""
        self._go(-1 if self.undo_words else 0)

    def redo(self) -> None:
        """Go forward again, if something was undone."""
        self._go(1 if self.redo_words else 0)

    def _go(self, steps: int) -> None:
        self._place += steps
        self.preview = None

    # Results

    @property
    def ticket(self) -> Ticket | None:
        """The Ticket of the run and the model that are shown, None where no run is open."""
        return (self.current.run, self.model) if self.current else None

    def is_current(self, ticket: Ticket | None) -> bool:
        """Return whether a ticket is that of the run and the model that are shown."""
        return ticket is not None and ticket == self.ticket

    def keep(self, ticket: Ticket, **results: Any) -> bool:
        """Keep results, fields of RunResults; return whether they belong to what is shown."""
        self.kept.keep(ticket, **results)
        return self.is_current(ticket)

    @property
    def results(self) -> RunResults:
        """The results of the run under the model that are shown, with what is stated of it."""
        if self.current is None or self.ticket is None:
            return RunResults()
        kept, stated = self.kept.of(self.ticket), self.current.stated
        if self._shown is None or self._shown[0] is not kept or self._shown[1] is not stated:
            self._shown = kept, stated, kept.with_inputs(stated.inputs)
        return self._shown[2]

    def set_preview(self, preview: Preview | None) -> None:
        """Show what a change would do, or the model as it is."""
        self.preview = preview
