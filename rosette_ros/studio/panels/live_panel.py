# SPDX-License-Identifier: Apache-2.0
"""The tab of a running cell: start, cancel, progress, curves so far, health, warnings and faults."""

import importlib
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

from nicegui import run, ui

from rosette_ros.analysis import analyse
from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import CellError, InvalidData, NotDeterminable, RosetteError, one_line
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.run.scheme import ORDERS
from rosette_ros.io.messages import PHASE_WORDS, CalibrationProgress, phase_name
from rosette_ros.nodes.names import DOMAINS, NAMESPACE, SEQUENCER
from rosette_ros.presentation.plots.plot_style import AFTER
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import Curves, curves_figure, filling_figure, plan_view_figure
from rosette_ros.studio.live_state import Fault, Health, NodeHealth
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.figures_panel import WIDTH
from rosette_ros.studio.panels.widgets import Area, Figure, button, card, input_field, marked, row

if TYPE_CHECKING:
    from rosette_ros.studio.cell_watcher import CellWatcher

OpenLog = Callable[[str], Awaitable[None]]
HEALTH = {Health.HEALTHY: ('check_circle', 'var(--good)'), Health.WARNING: ('warning', 'var(--doubtful)'),
          Health.FAULT: ('error', 'var(--bad)'), Health.SILENT: ('volume_off', 'var(--bad)')}
"""Icon and colour of a level of health; its word is the level itself."""
CURVES_PERIOD = 0.6
"""Curves so far are calculated at most so often, s."""
MOST_CELLS = 4
"""So many cells are watched at once; of more, the one connected first is dropped."""
SEEDS = range(2**53)
PERCENT = range(51, 100)
"""Probabilities until which a run may be measured."""


class LivePanel:
    """Connects to a cell, and shows it from then on; nothing of ROS is loaded before."""

    def __init__(self, controller: Controller, cells: 'CellWatchers', domain: int | None, namespace: str,
                 on_open: OpenLog) -> None:
        """Build it; on_open(path): opens a log."""
        self._controller, self._cells, self._on_open = controller, cells, on_open
        with card('Cell', 'cell'):
            with row():
                self._domain = widgets.whole_field('ROS domain', domain, DOMAINS, 'domain')
                self._domain.props('placeholder="of the environment"')
                self._namespace = input_field(ui.input('namespace', value=namespace), 'namespace', 'width: 130px')
                self._connect = button('Connect', self.connect, 'link', 'connect', strong=True)
            self._error = widgets.ErrorLine('cell-error')
        with ui.element('div') as self._place:
            ui.label('Connect to a running cell to see its progress, curves and health.').classes('soft')

    async def connect(self) -> None:
        """Join the domain and show the cell."""
        self._error.set('')
        if not self._domain.validate():
            return
        self._connect.set_enabled(False)
        try:
            domain = None if self._domain.value is None else int(self._domain.value)
            watcher = await run.io_bound(self._cells.watch, domain, self._namespace.value.strip() or NAMESPACE)
        except RosetteError as error:
            self._error.set(one_line(error))
        else:
            self._connect.set_text('Connect again')
            self._place.clear()
            with self._place:
                if watcher is not None:  # None while the studio is shut down
                    CellPanel(self._controller, watcher, self._on_open)
        finally:
            self._connect.set_enabled(True)


class CellPanel:
    """The present state of a cell."""

    def __init__(self, controller: Controller, watcher: 'CellWatcher', on_open: OpenLog) -> None:
        self._controller, self._watcher, self._on_open = controller, watcher, on_open
        self._curves_due, self._curves_of, self._curves_run = 0.0, ('', 0), ''
        with ui.element('div').classes('halves'):
            with ui.element('div').classes('side'):
                with card('Calibration', 'calibration'):
                    self._build_calibration()
                with card('Nodes', 'health'):
                    self._health = Area(marked(ui.element('div').classes('health'), 'health-table'))
                with card('Warnings and faults', 'faults'):
                    self._faults = Area(marked(ui.element('div').classes('list small').props('role=log'), 'fault-list'))
            with ui.element('div').classes('main'):
                with card('Six error motions so far, with U (k = 2)', 'live-curves') as self._curves_card:
                    self._curves_words = marked(ui.label('').classes('soft small'), 'live-words')
                    self._curves = Figure(400, 'Curves so far', 'live-figure', WIDTH)
                with card('The cell from above', 'plan-view') as self._view_card:
                    self._view = Figure(460, 'Table, balls and CMM positions from above', 'plan-view-figure')
                with card('Ball centres so far: distance from their places on the plate as it lies',
                          'filling') as self._filling_card:
                    self._filling = Figure(320, 'Ball centres so far')
        self._curves_card.set_visibility(False)
        self._view_card.set_visibility(False)
        ui.timer(0.3, self._update)

    def _build_calibration(self) -> None:
        with row():
            orders = {'': 'as configured', **{name: name for name in ORDERS}}
            self._order = input_field(ui.select(orders, label='order', value=''), 'order', 'width: 190px')
            self._seed = widgets.whole_field('seed', 0, SEEDS, 'seed')
            self._until = widgets.whole_field('until, %', None, PERCENT, 'until')
        with row():
            self._start = button('Start', self._calibrate, 'play_arrow', 'start', strong=True)
            self._cancel = button('Cancel', self._watcher.cancel, 'stop', 'cancel')
        self._hint = ui.label('The sequencer has not reported yet: start the cell, check domain and namespace.')
        marked(self._hint.classes('soft small'), 'start-hint')
        self._phase = marked(ui.label('').props('role=status aria-live=polite'), 'phase')
        self._bar = ui.linear_progress(0, show_value=False, size='10px').props('aria-label="Progress"')
        self._text = marked(ui.label('').classes('soft small'), 'progress-text')
        self._end = marked(ui.label(''), 'outcome')
        self._open = button('Open this log', self._open_log, 'folder_open', 'open-log', strong=True)

    def _calibrate(self) -> None:
        if self._seed.validate() and self._until.validate():
            self._watcher.calibrate(order=self._order.value, seed=int(self._seed.value or 0),
                                    until_probability=(self._until.value or 0) / 100)

    async def _open_log(self) -> None:
        if self._watcher.outcome and self._watcher.outcome.log:
            await self._on_open(str(self._watcher.outcome.log))

    async def _update(self) -> None:
        with self._watcher.lock:
            state = self._watcher.state
            progress, verdict, motions, faults = state.progress, state.verdict, state.motions, tuple(state.faults)
            balls, cells, run_id, health = state.balls, state.cells, state.run_id, state.health(time.monotonic())
            view = state.view()
        self._show_calibration(progress, verdict)
        heard = any(one.name == SEQUENCER and one.level != Health.SILENT for one in health)
        self._start.set_enabled(heard and not (self._watcher.is_calibrating or progress.is_running))
        self._hint.set_visibility(not heard)
        self._health.show(self._show_health, [one._replace(received=0.0) for one in health])
        self._faults.show(self._show_faults, faults)
        self._view_card.set_visibility(bool(view.balls))
        if view.balls:
            self._view.draw((run_id, view), plan_view_figure, view)
        self._filling_card.set_visibility(bool(cells))
        if cells:
            self._filling.draw((run_id, len(cells)), filling_figure, balls, cells)
        if motions is not None:
            which = f', {motions.which}' if motions.which else ''
            self._show_curves(motions.motions, f'Result of {f"run {run_id}" if run_id else "the last run"}{which}.')
        elif run_id != self._curves_run:
            self._show_curves(None, f'No ball centre of run {run_id} yet.')
        if motions is None:
            await self._show_part(run_id, len(cells))
        self._curves_run = run_id

    def _show_calibration(self, progress: CalibrationProgress, verdict: VerdictText | None) -> None:
        phase = PHASE_WORDS.get(progress.phase) or phase_name(progress.phase)
        self._phase.set_text(f'{phase}, order {progress.order}' if progress.order else phase)
        count = f'{progress.done} of {progress.total} ball centres. ' if progress.total else ''
        self._text.set_text(f'{count}{progress.text[:1].upper()}{progress.text[1:]}')
        self._bar.set_value(progress.done / progress.total if progress.total else 0)
        calibrating = self._watcher.is_calibrating
        outcome, words = None if calibrating else self._watcher.outcome, self._watcher.problem
        if outcome is not None and not outcome.success:
            words = outcome.message
        elif verdict is not None and not progress.is_running:
            words = f'{verdict.sentence} {verdict.action}'
        self._cancel.set_enabled(calibrating)
        self._end.set_text(words)
        self._open.set_visibility(outcome is not None and bool(outcome.log))

    def _show_health(self, health: list[NodeHealth]) -> None:
        for one in health:
            icon, colour = HEALTH[one.level]
            ui.icon(icon).style(f'color: {colour}; font-size: 20px').props('aria-hidden=true')
            ui.label(f'{one.name}: {one.level}').style('font-weight: 600')
            ui.label(one.sentence).classes('soft small wrap')
        if not health:
            ui.label('No node of this cell has reported yet.').style('grid-column: 1 / -1')

    def _show_faults(self, faults: tuple[Fault, ...]) -> None:
        for one in faults:
            icon, colour = HEALTH[one.level]
            with row().classes('told'):
                ui.icon(icon).style(f'color: {colour}').props(f'aria-label={one.level}')
                ui.label(f'{one.clock}  {one.words}').classes('wrap')
        if not faults:
            ui.label('None.').classes('soft')

    async def _show_part(self, run_id: str, count: int) -> None:
        """Show the curves of the ball centres so far, as soon as they determine the model."""
        now = time.monotonic()
        if not count or now < self._curves_due or self._curves_of == (run_id, count):
            return
        self._curves_due, self._curves_of = now + CURVES_PERIOD, (run_id, count)
        words, motions = f'{count} ball centres of run {run_id}', None
        try:
            fit = await self._controller.do_quick(self._analyse_part)
        except (InvalidData, NotDeterminable) as error:
            words += f': {one_line(error)}'
        else:
            words, motions = f'{fit.run.size} of {fit.run.n**2} ball centres of run {fit.run.run_id}', fit.error_motions
        if self._watcher.state.run_id == run_id and self._watcher.state.motions is None:
            self._show_curves(motions, words)

    def _show_curves(self, motions: ErrorMotions | None, words: str) -> None:
        """Show curves, or none, with what they are."""
        self._curves_words.set_text(words)
        self._curves.draw((motions,), curves_figure, [] if motions is None else [Curves('cell', motions, AFTER)])
        self._curves_card.set_visibility(True)

    def _analyse_part(self) -> Fit:
        with self._watcher.lock:
            part = self._watcher.state.part_of_run()
        return analyse(part)


class CellWatchers:
    """The watchers of all pages, one for each domain and namespace; ROS is loaded with the first. For any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watchers: dict[tuple[int | None, str], CellWatcher] = {}

    def watch(self, domain: int | None, namespace: str) -> 'CellWatcher':
        """Return the watcher of a cell; raises CellError where ROS is missing or refuses."""
        key = (domain, namespace)
        with self._lock:
            if key not in self._watchers:
                try:
                    module = importlib.import_module('rosette_ros.studio.cell_watcher')
                except ImportError as error:
                    raise CellError(f'live cell: expected ROS 2 (rclpy and rosette_msgs), found: {error}; start the '
                                    'studio in a ROS 2 workspace in which they are built') from error
                while len(self._watchers) >= MOST_CELLS:
                    self._watchers.pop(next(iter(self._watchers))).close()
                self._watchers[key] = module.CellWatcher(domain, namespace)
            return self._watchers[key]

    def close(self) -> None:
        """Leave all cells."""
        with self._lock:
            for watcher in self._watchers.values():
                watcher.close()
            self._watchers.clear()
