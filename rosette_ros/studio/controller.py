# SPDX-License-Identifier: Apache-2.0
"""Runs the calculations of a Session and updates the panels as soon as a part is there.

Previews run in a thread, slow work in a process that is ended as soon as its result is not wanted any more, so that
a long diagnosis delays nothing. A result that belongs to another run or model by now is kept, but not shown.
"""

import asyncio
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from nicegui import Event

from rosette_ros.analysis import LadderStep, advise_run, analyse, change, cross_check, summarise
from rosette_ros.api.evaluating import Corrected, correction_of
from rosette_ros.core.diagnosis.second_run import CrossCheck
from rosette_ros.core.diagnosis.verdict import not_determinable
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import NotDeterminable, RosetteError, one_line
from rosette_ros.core.run.records import Run
from rosette_ros.core.uncertainty.stated_environment import CLASSES
from rosette_ros.presentation.report import report_html
from rosette_ros.presentation.report.provenance import Source
from rosette_ros.studio.calculations import (
    budget_with_touches,
    certified,
    curves_by_name,
    joint_of,
    next_plan,
    shown_touches,
    shown_way,
)
from rosette_ros.studio.stated import Stated
from rosette_ros.studio.studio_session import KeptResults, OpenedRun, Preview, Session, Ticket
from rosette_ros.studio.worker import Superseded, Worker

T = TypeVar('T')
LOOK_AGAIN = 0.1  # s
SUMMARY = 'summary'


class Controller:
    """A Session with its calculations; `changed` is emitted for the views; kept: results that sessions share.

    step: the one of analysis.STEPS that is running, '' when none is; previewing: what a preview is calculated of, ''
    when none is; error: words of what failed last; check: name of a second run and what it shows of the diagnosis.
    What else is asked for has a name, a worker that ends when the same is asked again, and an `answer`.
    """

    def __init__(self, kept: KeptResults | None = None) -> None:
        self.session, self.changed = Session(kept or KeptResults()), Event[[]]()
        self.step = self.error = self.previewing = ''
        self.check: tuple[str, CrossCheck] | None = None
        self._quick, self._workers = ThreadPoolExecutor(1, 'quick'), defaultdict[str, Worker](Worker)
        self._answers: dict[str, tuple[object, Any]] = {}
        self._refreshed: Ticket | None = None
        self._asked = 0

    @property
    def is_shown(self) -> bool:
        """Whether an open page shows it."""
        return bool(self.changed.callbacks)

    # Actions

    def act(self, action: Callable[..., object], *arguments: object) -> None:
        """Call a method of the session that changes what is shown, and show it."""
        action(*arguments)
        self.error, self.check = '', None
        self.changed.emit()

    def fail(self, error: Exception) -> None:
        """Show the words of an error."""
        self.error = one_line(error)
        self.changed.emit()

    async def open(self, read: Callable[..., tuple[Run, Source]], path: Path, *arguments: object,
                   within: float | None = None, memory: int | None = None) -> None:
        """Read a run with read(path, ...) in another process and show it; within, memory: as of Worker.run.

        Raises RosetteError in the words of the command line.
        """
        run, source = await self._workers['open'].run(read, path, *arguments, within=within, memory=memory)
        self.act(self.session.open, run, path.name or str(path), source)

    async def report(self) -> str | None:
        """Return the report of what is shown, HTML; None while its summary is not complete."""
        summary, current = self.session.results.summary, self.session.current
        if summary is None or current is None:
            return None
        return await self._workers[SUMMARY].run(report_html, summary, current.source, inputs=current.stated.inputs)

    async def state(self, stated: Stated) -> None:
        """Take what is stated of the run that is shown; raises InvalidData where it does not fit the run."""
        self.session.state(stated)
        results = self.session.results
        await self.do_quick(lambda: results.result and results.result.curves.motions)
        self.act(lambda: None)

    async def certify(self) -> None:
        """Make the certificate of the run that is shown, under the model; raises InvalidData where data lack."""
        if current := self.session.current:
            await self.ask('certificate', certified, current.run, current.source, self.session.model, current.stated,
                           of=(self.session.ticket, current.stated))

    def corrected(self, curves: Sequence[str]) -> Corrected | None:
        """Return the correction by the result that is shown, None while there is none; raises InvalidData where the
        run gives none."""
        current, result = self.session.current, self.session.results.result
        if current is None or result is None:
            return None
        serial = current.source.identity['table.serial'] if current.source else ''
        return correction_of(current.run, result, serial, tuple(curves), current.name)

    async def ask(self, what: str, function: Callable[..., T], *arguments: object, of: object = None) -> T:
        """Return function(*arguments), calculated in another process, and keep it as the answer to `what`; of: the
        ticket or the opened run that it belongs to, None for neither. Superseded where the same is asked again."""
        result = await self._workers[what].run(function, *arguments)
        self._answers[what], self.error = (of, result), ''
        self.changed.emit()
        return result

    def answer(self, what: str) -> Any:
        """Return the last answer where it belongs to what is shown, else None."""
        of, result = self._answers.get(what, (None, None))
        session = self.session
        stated = session.current and session.current.stated
        return result if of in (None, session.ticket, session.current, (session.ticket, stated)) else None

    async def preview(self, name: str, make: Callable[[], Model]) -> None:
        """Calculate what the model of `make` would change; show it as a preview."""
        session, ticket, self.error = self.session, self.session.ticket, ''
        if session.current is None:
            return
        model, self.previewing = make(), name
        self._asked = asked = self._asked + 1
        self.changed.emit()
        try:
            run = session.current.run
            result = await self.do_quick(self._if_current(ticket, change), run, session.model, model,
                                         session.kept.known(run, model).steps)
            session.keep((run, model), previewed=LadderStep.of(result.after, result.cross_validation_after))
            if session.is_current(ticket) and asked == self._asked:
                session.set_preview(Preview(name, result))
        finally:
            if asked == self._asked:
                self.previewing = ''
                self.changed.emit()

    def drop_preview(self) -> None:
        """Show the model as it is, also where a preview is still being calculated."""
        self._asked, self.previewing = self._asked + 1, ''
        self.act(self.session.set_preview, None)

    async def cross_check(self, place: int) -> None:
        """Check on another opened run what the diagnosis of this one claims."""
        ticket, other = self.session.ticket, self.session.runs[place]
        while self.step and self.session.results.summary is None:  # asked while this run is being diagnosed
            await asyncio.sleep(LOOK_AGAIN)
        if self.session.results.summary is None and self.session.is_current(ticket):
            await self.refresh(unasked=False)
        summary = self.session.results.summary
        if summary is None or not self.session.is_current(ticket):
            return
        result = await self._workers[SUMMARY].run(cross_check, other.run, summary.diagnosis)
        if self.session.is_current(ticket):
            self.check = (other.name, result)
            self.changed.emit()

    async def evaluate_jointly(self, places: Sequence[int]) -> None:
        """Evaluate opened runs as one."""
        await self.ask('joint', joint_of, [self.session.runs[place] for place in places])

    async def compare_orders(self, environment: str) -> None:
        """Compare orders for the next run; environment: a class that is stated, '' for none."""
        if current := self.session.current:
            await self.ask('orders', advise_run, current.run, (), 0, CLASSES.get(environment), of=current)

    async def make_budget(self) -> None:
        """Calculate the uncertainty budget of the run under the model, with what is stated."""
        results, current = self.session.results, self.session.current
        if results.fit and current:
            await self.ask('budget', budget_with_touches, results.fit, current.source, current.stated.inputs,
                           results.summary and results.summary.diagnosis, of=(self.session.ticket, current.stated))

    async def read_touches(self) -> None:
        """Fit spheres to the touches in the log of the run that is shown."""
        if current := self.session.current:
            await self.ask('touches', shown_touches, current.source, of=current)

    async def show_way(self) -> None:
        """Calculate how the run that is shown, measured until it is known, came to its cause."""
        if (current := self.session.current) and current.source:
            await self.ask('way', shown_way, current.run, self.session.model, current.source, of=self.session.ticket)

    async def settle(self) -> str:
        """Choose the readings that settle what is in doubt; return a plan file with them, '' where there are none."""
        if (current := self.session.current) is None:
            return ''
        return (await self.ask('next', next_plan, current.run, self.session.model, of=self.session.ticket))[1]

    async def lay_over(self, places: Sequence[int]) -> None:
        """Evaluate other opened runs under the model, to draw their curves over those of this one."""
        if current := self.session.current:
            every = [(one.name, one.run) for one in (current, *(self.session.runs[place] for place in places))]
            await self.ask('overlay', curves_by_name, every, self.session.model, of=self.session.ticket)

    # Calculations

    async def refresh(self, unasked: bool = True) -> None:
        """Calculate all results for the run under the model; unasked: but for the diagnosis of a large run."""
        session, ticket = self.session, self.session.ticket
        if ticket is None or session.current is None:
            return
        if ticket != self._refreshed:
            self._workers[SUMMARY].stop()
        self._refreshed = ticket
        try:
            await self._calculate(ticket, session.current, session.model, unasked)
        except Superseded:
            return
        except NotDeterminable as error:
            session.keep(ticket, refusal=not_determinable(
                one_line(error), [str(term) for term in session.model.terms]))
        except RosetteError as error:
            session.keep(ticket, problem=one_line(error))
        self._begin(ticket, '')

    async def _calculate(self, ticket: Ticket, opened: OpenedRun, model: Model, unasked: bool) -> None:
        results, run = self.session.results, opened.run
        self._begin(ticket, 'evaluate')
        if opened.is_large and unasked:
            if results.fit is None:
                self._keep(ticket, fit=await self._workers[SUMMARY].run(analyse, run, model))
        elif results.summary is None:
            self._keep(ticket, summary=await self._workers[SUMMARY].run(
                summarise, run, model, known=self.session.kept.known(run, model),
                calls={'on_step': lambda step: self._begin(ticket, step),
                       'on_part': lambda name, part: self._keep(ticket, **{name: part})}))

    def _begin(self, ticket: Ticket, step: str) -> None:
        if self.session.is_current(ticket) and step != self.step:
            self.step = step
            self.changed.emit()

    def _keep(self, ticket: Ticket, **results: object) -> None:
        if self.session.keep(ticket, **results):
            self.changed.emit()

    def _if_current(self, ticket: Ticket | None, function: Callable[..., T]) -> Callable[..., T]:
        """Return a function that only begins while its ticket is current."""
        def begin(*arguments: object) -> T:
            if not self.session.is_current(ticket):
                raise Superseded
            return function(*arguments)
        return begin

    async def do_quick(self, function: Callable[..., T], *arguments: object) -> T:
        """Call a function in the thread for quick work."""
        return await asyncio.get_running_loop().run_in_executor(self._quick, function, *arguments)

    def close(self) -> None:
        """End the calculations."""
        for worker in self._workers.values():
            worker.stop()
        self._quick.shutdown(wait=False, cancel_futures=True)
