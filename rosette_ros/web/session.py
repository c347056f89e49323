# SPDX-License-Identifier: Apache-2.0
"""What a person has on the desk: opened runs, the model with undo, what was found, a preview. No page.

Work goes on elsewhere and takes its time; a Ticket says what it was asked about. What comes back is
kept under its ticket, and shown only where the desk still asks the same.
"""

from collections import OrderedDict
from dataclasses import dataclass, field

from rosette_ros.analysis import Change, Report, Rung
from rosette_ros.core.advice import Advice
from rosette_ros.core.base import BASE_TERMS
from rosette_ros.core.compare import Comparison
from rosette_ros.core.diagnosis import Diagnosis
from rosette_ros.core.effects.contract import Setting
from rosette_ros.core.errors import InvalidModel
from rosette_ros.core.model import Model, Term
from rosette_ros.core.records import Run
from rosette_ros.report.sources import Source
from rosette_ros.story import Story, verdict_of

MOST_KEPT = 24
"""So many pairs of run and model keep what was found about them."""
MOST_READINGS = 4000
"""Above so many readings the diagnosis waits until it is asked for: it would take minutes."""


@dataclass(frozen=True, eq=False)
class OpenedRun:
    """A run on the desk, with the name that stands on it and, where it is known, where it comes from."""

    key: int
    name: str
    run: Run
    source: Source | None = None


@dataclass(frozen=True)
class Ticket:
    """What a piece of work was asked about: which run under which model."""

    run_key: int
    model: str


@dataclass(eq=False)
class Findings:
    """What has been found of one run under one model so far; None: not yet."""

    report: Report | None = None
    comparison: Comparison | None = None
    own_rungs: tuple[Rung, ...] | None = None
    diagnosis: Diagnosis | None = None
    rungs: tuple[Rung, ...] | None = None
    problem: str = ''


@dataclass(frozen=True, eq=False)
class Preview:
    """What adding an effect would do: its name, the model with it, and the Change."""

    name: str
    model: Model
    change: Change


@dataclass(frozen=True)
class _Entry:
    """A model that was on the desk, and what led to it."""

    model: Model
    words: str


@dataclass(eq=False)
class Session:
    """The desk: runs, the model with undo and redo, findings, a preview."""

    runs: tuple[OpenedRun, ...] = ()
    current: OpenedRun | None = None
    preview: Preview | None = None
    _history: list = field(default_factory=lambda: [_Entry(Model(), 'base model')])
    _place: int = 0
    _found: OrderedDict = field(default_factory=OrderedDict)
    _advice: dict = field(default_factory=dict)

    # Runs

    def open(self, run, name, source=None):
        """Put a run on the desk, look at it and return its OpenedRun; the model stays."""
        key = 1 + max((one.key for one in self.runs), default=0)
        opened = OpenedRun(key, self._free_name(name), run, source)
        self.runs = (*self.runs, opened)
        self.select(key)
        return opened

    def select(self, key):
        """Look at another run that was opened."""
        self.current = self.run_of(key)
        self.preview = None

    def run_of(self, key):
        """Return the OpenedRun of a key."""
        return next(one for one in self.runs if one.key == key)

    def _free_name(self, name):
        taken = {one.name for one in self.runs}
        names = (name, *(f'{name} ({count})' for count in range(2, len(taken) + 3)))
        return next(one for one in names if one not in taken)

    # The model

    @property
    def model(self):
        """The Model on the desk."""
        return self._history[self._place].model

    def change_model(self, model, words):
        """Put another model on the desk; what was undone before is forgotten."""
        del self._history[self._place + 1:]
        self._history.append(_Entry(model, words))
        self._place += 1
        self.preview = None

    def add(self, name, setting=None):
        """Add an effect; one that is there already is added with its setting fixed."""
        self.change_model(self.model_with(name, setting), f'add {name}')

    def add_entry(self, entry):
        """Add an entry as in a model file, such as an own term; raises InvalidModel."""
        name = entry if isinstance(entry, str) else entry.get('own') or entry.get('name')
        self.change_model(self.model.with_entry(entry), f'add {name}')

    def remove(self, place):
        """Remove the term at a place of model_parts."""
        part = self.model_parts[place]
        self.change_model(_without(self.model, place), f'remove {part}')

    def model_with(self, name, setting=None):
        """Return the model with an effect more; raises InvalidModel for an unknown name."""
        model = self.model
        if name in BASE_TERMS or name not in [term.name for term in model.terms]:
            return model.with_effect(name)
        if not setting:
            raise InvalidModel(f'model: {name} is in the model already')
        return model.with_effect(name, Setting(setting))

    @property
    def model_parts(self):
        """The base terms and effects in order, as they are named."""
        return (*self.model.base, *map(str, self.model.terms))

    @property
    def undo_words(self):
        """What undo would take back; empty where there is nothing."""
        return self._history[self._place].words if self._place else ''

    @property
    def redo_words(self):
        """What redo would do again; empty where there is nothing."""
        following = self._history[self._place + 1:]
        return following[0].words if following else ''

    def undo(self):
        """Go back to the model before; return what was taken back."""
        words = self.undo_words
        if words:
            self._place -= 1
            self.preview = None
        return words

    def redo(self):
        """Go forward again; return what was done again."""
        words = self.redo_words
        if words:
            self._place += 1
            self.preview = None
        return words

    # What was found

    @property
    def ticket(self):
        """The Ticket of what the desk asks now, None where no run is open."""
        if self.current is None:
            return None
        return Ticket(self.current.key, f'{self.model.hash}{self.model.repeated}')

    def is_current(self, ticket):
        """Return whether the desk still asks what a ticket was about."""
        return ticket is not None and ticket == self.ticket

    def keep(self, ticket, **found):
        """Keep what was found; return whether the desk still asks for it."""
        entry = self._found.setdefault(ticket, Findings())
        self._found.move_to_end(ticket)
        for name, value in found.items():
            setattr(entry, name, value)
        while len(self._found) > MOST_KEPT:
            self._found.popitem(last=False)
        return self.is_current(ticket)

    def keep_advice(self, run_key, advice):
        """Keep the Advice for the next run; it depends on the run alone. None: too many balls."""
        self._advice[run_key] = advice

    def has_advice(self, run_key):
        """Return whether the advice for a run was worked out, or found too dear."""
        return run_key in self._advice

    @property
    def advice(self) -> Advice | None:
        """The Advice for the run that is looked at, None where there is none (yet)."""
        return self._advice.get(self.current.key) if self.current else None

    @property
    def found(self):
        """The Findings about what the desk asks now."""
        return self._found.get(self.ticket) or Findings()

    @property
    def is_large(self):
        """Whether the run has so many readings that the diagnosis waits to be asked for."""
        return self.current is not None and self.current.run.size > MOST_READINGS

    @property
    def verdict(self):
        """The Verdict, None as long as nothing was diagnosed."""
        diagnosis = self.found.diagnosis
        return verdict_of(diagnosis, self.advice) if diagnosis else None

    @property
    def story(self):
        """The Story of what the desk asks now, None as long as parts of it are missing."""
        found = self.found
        if None in (found.report, found.comparison, found.diagnosis, found.rungs):
            return None
        return Story(found.report, found.comparison, found.diagnosis, found.rungs, self.advice,
                     self.verdict)

    # A preview

    def keep_preview(self, ticket, name, model, change):
        """Show what a change would do, unless the desk asks something else by now."""
        if not self.is_current(ticket):
            return False
        self.preview = Preview(name, model, change)
        return True

    def drop_preview(self):
        """Show the model as it is."""
        self.preview = None


def _without(model, place):
    """Return a model without its part at a place, base terms first."""
    base = tuple(term for k, term in enumerate(model.base) if k != place)
    first = place - len(model.base)
    terms: tuple[Term, ...] = tuple(term for k, term in enumerate(model.terms) if k != first)
    return Model(base, terms, model.repeated)
