# SPDX-License-Identifier: Apache-2.0
"""Runs the calculations of a Session and updates the panels: quick ones first, the diagnosis afterwards.

Quick work runs in a thread, slow work in a process that is ended as soon as its result is not wanted any more, so that
a long diagnosis delays nothing. A result that belongs to another run or model by now is kept, but not shown.
"""

import asyncio
import multiprocessing
import resource
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar

from nicegui import Event

from rosette_ros.analysis import analyse, change, cross_check, evaluate_jointly, ladder, summarise
from rosette_ros.core.budget_inputs import BudgetInputs
from rosette_ros.core.diagnosis.second_run import CrossCheck
from rosette_ros.core.diagnosis.verdict import not_determinable
from rosette_ros.core.error_summary import doubt_of
from rosette_ros.core.errors import NotDeterminable, RosetteError, one_line
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.records import ErrorMotions, Run
from rosette_ros.core.uncertainty_budget import Budget, budget, touch_scatter
from rosette_ros.io.budget_file import read_budget
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import is_log
from rosette_ros.presentation.plots.touch_plots import touch_directions, touch_residuals
from rosette_ros.presentation.report import report_html
from rosette_ros.presentation.report.page_parts import inline_svgs
from rosette_ros.presentation.report.provenance import Source
from rosette_ros.presentation.report.run_page import NO_TOUCHES, touches_of
from rosette_ros.presentation.table_format import Table
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table
from rosette_ros.studio.studio_session import OpenedRun, Preview, Session, Ticket

T = TypeVar('T')
STEP, VALUE, ERROR = 'step', 'value', 'error'
"""What the process sends."""
READ_MEMORY = 2 << 30
"""Most memory for reading a run that was uploaded, bytes; it takes READ_WITHIN at most."""
LOOK_AGAIN = 0.1  # s
_CONTEXT = multiprocessing.get_context('forkserver')
_CONTEXT.set_forkserver_preload(['rosette_ros.analysis', 'rosette_ros.presentation.report'])


class Superseded(Exception):
    """The result is not wanted any more."""


class WorkerFailed(RosetteError):
    """The process has ended without a result."""


@dataclass(frozen=True)
class ShownTouches:
    """What the touches of a run show: (name, text) rows, pictures (SVG) by their words, tables; missing: why not."""

    rows: tuple[tuple[str, str], ...] = ()
    pictures: Mapping[str, str] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    missing: tuple[str, ...] = ()


class Controller:
    """A Session with its calculations; `changed` is emitted for the views.

    step: the one of analysis.STEPS that is running, '' when none is; previewing: what a preview is calculated of, ''
    when none is; error: words of what failed last; check: name of a second run and what it shows of the diagnosis;
    planner, joiner, archivist, budgeter, toucher: calculate what plans determine, several runs as one, trends, the
    uncertainty budget, and spheres through touches; joint: the result of several runs; budget, overlaid: that
    budget, and curves of runs by name, this run's first, with the ticket that they belong to; touches: what they show,
    with their run.
    """

    def __init__(self) -> None:
        self.session, self.changed = Session(), Event[[]]()
        self.step = self.error = self.previewing = ''
        self.check: tuple[str, CrossCheck] | None = None
        self._quick, self._worker, self._reader = ThreadPoolExecutor(1, 'quick'), Worker(), Worker()
        self.planner, self.joiner, self.archivist = Worker(), Worker(), Worker()
        self.budgeter, self.toucher = Worker(), Worker()
        self.touches: tuple[OpenedRun, ShownTouches] | None = None
        self.budget: tuple[Ticket | None, Budget] | None = None
        self.overlaid: tuple[Ticket | None, dict[str, ErrorMotions]] | None = None
        self._refreshed: Ticket | None = None
        self._asked = 0
        self.joint: JointResult | None = None

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
        run, source = await self._reader.run(read, path, *arguments, within=within, memory=memory)
        self.act(self.session.open, run, path.name or str(path), source)

    async def report(self) -> str | None:
        """Return the report of what is shown, HTML; None while its summary is not complete."""
        summary, current = self.session.results.summary, self.session.current
        return await self._worker.run(report_html, summary, current.source) if summary and current else None

    async def preview(self, name: str, make: Callable[[], Model]) -> None:
        """Calculate what the model of `make` would change; show it as a preview."""
        session, ticket, self.error = self.session, self.session.ticket, ''
        if session.current is None:
            return
        model, self.previewing = make(), name
        self._asked = asked = self._asked + 1
        self.changed.emit()
        try:
            result = await self.do_quick(self._if_current(ticket, change), session.current.run, session.model, model)
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
        result = await self._worker.run(cross_check, other.run, summary.diagnosis)
        if self.session.is_current(ticket):
            self.check = (other.name, result)
            self.changed.emit()

    async def evaluate_jointly(self, places: Sequence[int]) -> None:
        """Evaluate opened runs as one."""
        self.joint = await self.joiner.run(joint_of, [self.session.runs[place] for place in places])
        self.error = ''
        self.changed.emit()

    async def make_budget(self, path: str) -> None:
        """Calculate the uncertainty budget of the run under the model; path: of a file of inputs, '' for none."""
        results, ticket, current = self.session.results, self.session.ticket, self.session.current
        inputs = read_budget(path) if path else None
        if results.fit is None or current is None:
            return
        self.budget = ticket, await self.budgeter.run(
            budget_of, results.fit, current.source, inputs, doubt_of(results.verdict))
        self.error = ''
        self.changed.emit()

    async def read_touches(self) -> None:
        """Fit spheres to the touches in the log of the run that is shown."""
        current = self.session.current
        if current is None:
            return
        self.touches, self.error = (current, await self.toucher.run(shown_touches, current.source)), ''
        self.changed.emit()

    async def lay_over(self, places: Sequence[int]) -> None:
        """Evaluate other opened runs under the model, to draw their curves over those of this one."""
        session, ticket, model = self.session, self.session.ticket, self.session.model
        if session.current is None:
            return
        every = {}
        for one in (session.current, *(session.runs[place] for place in places)):
            every[one.name] = (await self.do_quick(self._if_current(ticket, analyse), one.run, model)).error_motions
        self.overlaid, self.error = (ticket, every), ''
        self.changed.emit()

    def of_present(self, kept: tuple[Ticket | None, T] | None) -> T | None:
        """Return what was kept with its ticket, where that is the ticket of what is shown."""
        return kept[1] if kept and self.session.is_current(kept[0]) else None

    # Calculations

    async def refresh(self, unasked: bool = True) -> None:
        """Calculate all results for the run under the model; unasked: but for the diagnosis of a large run."""
        session, ticket = self.session, self.session.ticket
        if ticket is None or session.current is None:
            return
        if ticket != self._refreshed:
            self._worker.stop()
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
        except Exception as error:
            session.keep(ticket, problem=f'a program error, reported on the console: {one_line(error)}')
            self._begin(ticket, '')
            raise
        self._begin(ticket, '')

    async def _calculate(self, ticket: Ticket, opened: OpenedRun, model: Model, unasked: bool) -> None:
        session, run = self.session, opened.run
        self._begin(ticket, 'evaluate')
        if session.results.fit is None:
            self._keep(ticket, fit=await self.do_quick(self._if_current(ticket, analyse), run, model))
        if session.results.ladder is None and not opened.is_large:
            self._keep(ticket, ladder=await self.do_quick(self._if_current(ticket, ladder), run, model))
        if session.results.summary is None and not (unasked and opened.is_large):
            self._keep(ticket, summary=await self._worker.run(summarise, run, model,
                                                              on_step=lambda step: self._begin(ticket, step)))

    def _begin(self, ticket: Ticket, step: str) -> None:
        if self.session.is_current(ticket) and step != self.step:
            self.step = step
            self.changed.emit()

    def _keep(self, ticket: Ticket, **results: object) -> None:
        if not self.session.keep(ticket, **results):
            raise Superseded
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
        for worker in (self._worker, self._reader, self.planner, self.joiner, self.archivist, self.budgeter,
                       self.toucher):
            worker.stop()
        self._quick.shutdown(wait=False, cancel_futures=True)


def budget_of(fit: Fit, source: Source | None, inputs: BudgetInputs | None, doubt: str) -> Budget:
    """Return the Budget of a fit, with the scatter of touches where the log of the run has them."""
    refit = touches_of(source)[0]
    return budget(fit, inputs, touch_scatter(refit) if refit else None, doubt=doubt)


def shown_touches(source: Source | None) -> ShownTouches:
    """Return what the touches in the log of a run show."""
    refit, missing = touches_of(source)
    if refit is None:
        return ShownTouches(missing=tuple(missing or [NO_TOUCHES]))
    drawn = inline_svgs({'touch_residuals': touch_residuals(refit), 'touch_directions': touch_directions(refit)})
    return ShownTouches(tuple(sphere_rows(refit)), {
        'Distance of each touch from its sphere; below, the radius of each sphere.': str(drawn['touch_residuals']),
        'Mean residuals by direction, seen from the pole: lobing of the probe, form of each ball.':
            str(drawn['touch_directions'])}, (sphere_table(refit),))


def joint_of(opened: Sequence[OpenedRun]) -> JointResult:
    """Return the JointResult of opened runs, with their table frames where their logs are still there."""
    runs = []
    for one in opened:
        path = Path(one.source.path) if one.source else None
        is_there = path is not None and path.exists() and is_log(path)
        runs.append(Readings.of(one.run, read_log(path).frame_of(one.run.run_id) if path and is_there else None))
    return evaluate_jointly(runs)


class Worker:
    """Does one piece of work at a time: the next one ends the one before."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._thread = ThreadPoolExecutor(1, 'worker')

    async def run(self, function: Callable[..., T], *arguments: object, on_step: Callable[[str], None] | None = None,
                  within: float | None = None, memory: int | None = None) -> T:
        """Return function(*arguments), calculated in another process.

        on_step: passed to the function; called here; within, memory: most time, s, and most memory, bytes, that it may
        take. Raises what the function raises, Superseded where `stop` or other work has ended it, and WorkerFailed.
        """
        self.stop()
        loop = asyncio.get_running_loop()
        receiver, sender = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(target=_work, args=(sender, function, arguments, on_step is not None, memory),
                                   daemon=True)
        self._process = process

        def receive() -> tuple[str, Any]:
            _start(process)
            sender.close()
            if self._process is not process:
                process.kill()
            try:
                while (answer := receiver.recv())[0] == STEP:
                    if on_step:
                        loop.call_soon_threadsafe(on_step, answer[1])
                return answer
            except EOFError:
                return ERROR, Superseded() if self._process is not process else WorkerFailed(
                    f'{function.__name__}: its process ended without a result; is there enough memory?')
            finally:
                receiver.close()
                process.join()

        try:
            async with asyncio.timeout(within):
                kind, value = await loop.run_in_executor(self._thread, receive)
        except TimeoutError:
            if self._process is process:
                self.stop()
            raise WorkerFailed(f'wanted a result within {within:g} s, got none') from None
        if self._process is process:
            self._process = None
        if kind == ERROR:
            raise value
        result: T = value
        return result

    def stop(self) -> None:
        """End the work that is running; who waits for it gets Superseded."""
        process, self._process = self._process, None
        if process is not None and process.pid is not None:
            process.kill()


def _start(process: BaseProcess) -> None:
    """Start a process that Ctrl-C does not reach: the studio ends it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(sender: Connection, function: Callable[..., object], arguments: tuple[object, ...], with_steps: bool,
          memory: int | None) -> None:
    """Work in the other process; send the steps, then the value or the error."""
    if memory is not None:
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    steps = {'on_step': lambda step: sender.send((STEP, step))} if with_steps else {}
    try:
        sender.send((VALUE, function(*arguments, **steps)))
    except RosetteError as error:
        sender.send((ERROR, error))
    except MemoryError:
        sender.send((ERROR, WorkerFailed(f'wanted at most {(memory or 0) >> 20} MB of memory, got more')))
