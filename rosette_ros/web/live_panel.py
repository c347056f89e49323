# SPDX-License-Identifier: Apache-2.0
"""The tab of a running cell: start, cancel, progress, curves that grow, health, faults."""

import asyncio
import importlib
import time

from nicegui import ui

from rosette_ros.analysis import analyse
from rosette_ros.core.errors import CellError, InvalidData, NotDeterminable, RosetteError
from rosette_ros.core.scheme import ORDERS
from rosette_ros.nodes.names import NAMESPACE
from rosette_ros.web.cell_state import FAULTY, HEALTHY, SILENCE, WARNING
from rosette_ros.web.desk import one_line
from rosette_ros.web.figures import NOW, Line, curves_figure, filling_figure
from rosette_ros.web.widgets import button, card, marked, set_words

PHASES = {'IDLE': 'nothing is on', 'REPEATABILITY': 'repeatability check', 'ALIGNMENT': 'finding the table axis',
          'RUN': 'measuring the run', 'DRIFT_CHECK': 'drift check', 'EVALUATION': 'evaluation', 'DONE': 'done',
          'CANCELLED': 'cancelled', 'FAILED': 'failed'}
HEALTH = {HEALTHY: ('check_circle', 'var(--good)'), WARNING: ('warning', 'var(--doubtful)'),
          FAULTY: ('error', 'var(--bad)'), SILENCE: ('volume_off', 'var(--bad)')}
"""Level of health: icon and colour; the word is the level itself."""
PERIOD = 0.3
CURVES_PERIOD = 0.6


class LivePanel:
    """A cell as it is now; nothing of ROS is loaded before somebody connects."""

    def __init__(self, desk, gallery, cells, where, on_open):
        """Build it; cells: where watches are kept; where: domain and namespace; on_open(path): opens a log."""
        self._desk, self._gallery, self._cells, self._on_open = desk, gallery, cells, on_open
        self._watch = None
        self._shown = {}
        self._curves_due = 0.0
        self._part = (None, 0)
        with ui.element('div').classes('live'):
            with ui.element('div').classes('side'):
                self._build_controls(*where)
                self._build_health()
            with ui.element('div').classes('main'):
                self._build_pictures()
        self._timer = ui.timer(PERIOD, self._tick, active=False)
        self._set_connected(False)

    def _build_controls(self, domain, namespace):
        with card('Cell', 'cell'):
            with ui.element('div').classes('row'):
                self._domain = ui.number('ROS domain', value=domain, min=0, max=232, precision=0,
                                         placeholder='of the environment')
                marked(self._domain.props('dense outlined').style('width: 130px'), 'domain')
                self._namespace = ui.input('namespace', value=namespace)
                marked(self._namespace.props('dense outlined').style('width: 130px'), 'namespace')
                self._connect = button('Connect', self.connect, 'link', 'connect', strong=True)
            self._error = marked(ui.label('').classes('error').props('role=alert'), 'cell-error')
        with card('Calibration', 'calibration') as self._calibration:
            with ui.element('div').classes('row'):
                self._order = ui.select({'': 'as configured', **{name: name for name in ORDERS}}, label='order',
                                        value='')
                marked(self._order.props('dense outlined options-dense').style('width: 190px'), 'order')
                self._seed = ui.number('seed', value=0, min=0, max=2**53, precision=0)
                marked(self._seed.props('dense outlined').style('width: 100px'), 'seed')
            with ui.element('div').classes('row'):
                self._start = button('Start', self._begin, 'play_arrow', 'start', strong=True)
                self._cancel = button('Cancel', lambda: self._watch.cancel(), 'stop', 'cancel')
            self._phase = marked(ui.label('').props('role=status aria-live=polite'), 'phase')
            self._bar = ui.linear_progress(0, show_value=False, size='10px').props('aria-label="Progress"')
            self._text = marked(ui.label('').classes('soft small'), 'progress-text')
            self._end = marked(ui.label(''), 'outcome')
            self._open = button('Open this log', self._open_log, 'folder_open', 'open-log', strong=True)

    def _build_health(self):
        with card('Nodes', 'health') as self._health_card:
            self._health = marked(ui.element('div').classes('health'), 'health-table')
        with card('Faults', 'faults') as self._faults_card:
            self._faults = marked(ui.element('div').style('display: grid; gap: 4px').props('role=log'), 'fault-list')

    def _build_pictures(self):
        self._hint = ui.label('Connect to a running cell: its progress, curves and health appear here.') \
            .classes('soft')
        with card('Six error motions so far, with U (k = 2)', 'live-curves') as self._curves_card:
            self._curves_words = marked(ui.label('').classes('soft small'), 'live-words')
            self._curves = self._gallery.picture(400, 'Curves so far')
        with card('Ball centres so far: distance from the expected place', 'filling') as self._filling_card:
            self._filling = self._gallery.picture(320, 'Ball centres so far')

    # What a person does

    async def connect(self):
        """Join the domain and listen to the cell."""
        self._say('')
        self._connect.set_enabled(False)
        try:
            domain = None if self._domain.value is None else int(self._domain.value)
            self._watch = await asyncio.get_running_loop().run_in_executor(
                None, self._cells.watch, domain, self._namespace.value.strip() or NAMESPACE)
        except RosetteError as error:
            self._say(one_line(error))
            return
        finally:
            self._connect.set_enabled(True)
        self._set_connected(True)
        self._shown = {}

    def _begin(self):
        self._watch.calibrate(self._order.value, int(self._seed.value or 0))
        self._say('')

    async def _open_log(self):
        outcome = self._watch.outcome
        if outcome is not None and outcome.log:
            await self._on_open(str(outcome.log))

    def _say(self, words):
        set_words(self._error, words)
        self._error.set_visibility(bool(words))

    def _set_connected(self, connected):
        for one in (self._calibration, self._health_card, self._faults_card, self._curves_card, self._filling_card):
            one.set_visibility(connected)
        self._hint.set_visibility(not connected)
        self._timer.active = connected
        self._connect.set_text('Connect again' if connected else 'Connect')

    # What the cell does

    async def _tick(self):
        """Show what was heard since the last time."""
        watch = self._watch
        with watch.lock:
            state, now = watch.state, time.monotonic()
            progress, health, faults = state.progress, state.health(now), tuple(state.faults)
            balls, cells, motions, run_id = state.balls, state.cells, state.motions, state.run_id
        self._show_progress(watch, progress)
        self._show_health(health)
        self._show_faults(faults)
        if balls and (run_id, len(cells)) != self._shown.get('cells'):
            self._shown['cells'] = (run_id, len(cells))
            self._gallery.draw(self._filling, (cells,), filling_figure, balls, cells)
        self._filling_card.set_visibility(bool(cells))
        await self._show_curves(watch, run_id, len(cells), balls, motions)

    def _show_progress(self, watch, progress):
        phase = PHASES.get(progress.phase, progress.phase)
        set_words(self._phase, f'{phase}{f", order {progress.order}" if progress.order else ""}')
        set_words(self._text, f'{progress.done} of {progress.total} ball centres. {progress.text}'
                  if progress.total else progress.text)
        self._bar.set_value(progress.done / progress.total if progress.total else 0)
        asking, outcome = watch.is_asking, watch.outcome
        self._start.set_enabled(not (asking or progress.is_running))
        self._cancel.set_enabled(asking)
        words = watch.problem
        if outcome is not None and not asking:
            words = 'Done: the curves are the result.' if outcome.success else outcome.message
        set_words(self._end, words)
        self._end.set_visibility(bool(words))
        self._open.set_visibility(outcome is not None and bool(outcome.log) and not asking)

    def _show_health(self, health):
        key = tuple((one.name, one.level, one.sentence) for one in health)
        if key == self._shown.get('health'):
            return
        self._shown['health'] = key
        self._health.clear()
        with self._health:
            for one in health:
                icon, colour = HEALTH[one.level]
                ui.icon(icon).style(f'color: {colour}; font-size: 20px').props('aria-hidden=true')
                ui.label(f'{one.name}: {one.level}').style('font-weight: 600')
                ui.label(one.sentence).classes('soft small').style('overflow-wrap: anywhere')
            if not health:
                ui.label('No node of this cell was heard yet.').style('grid-column: 1 / -1')

    def _show_faults(self, faults):
        if faults == self._shown.get('faults'):
            return
        self._shown['faults'] = faults
        self._faults.clear()
        with self._faults:
            for clock, words in faults:
                ui.label(f'{clock}  {words}').classes('small').style('overflow-wrap: anywhere')
            if not faults:
                ui.label('None.').classes('soft small')

    async def _show_curves(self, watch, run_id, count, balls, motions):
        """Show the curves of the evaluator, and before that those of the part that has come."""
        if motions is not None:
            if motions is not self._shown.get('motions'):
                self._shown['motions'] = motions
                self._draw(motions, f'Run {run_id}: result of the evaluator.' if run_id else 'Result of the last run.')
            return
        now = time.monotonic()
        if (run_id, count) == self._part or now < self._curves_due or not count:
            self._curves_card.set_visibility(bool(self._shown.get('drawn')))
            return
        self._curves_due, self._part = now + CURVES_PERIOD, (run_id, count)
        try:
            report = await self._desk.do_quick(_analyse_part, watch)
        except (InvalidData, NotDeterminable) as error:
            set_words(self._curves_words, f'{count} of {balls**2} ball centres: {one_line(error)}')
            return
        self._draw(report.error_motions, f'{count} of {balls**2} ball centres of run {run_id}')

    def _draw(self, motions, words):
        set_words(self._curves_words, words)
        self._gallery.draw(self._curves, (motions,), curves_figure, [Line('cell', motions, NOW)])
        self._shown['drawn'] = True
        self._curves_card.set_visibility(True)


def _analyse_part(watch):
    with watch.lock:
        part = watch.state.part_of_run()
    return analyse(part)


class Cells:
    """The watches of all pages, one for each domain and namespace; ROS is loaded with the first."""

    MOST = 4

    def __init__(self):
        """Watch nothing."""
        self._watches = {}

    def watch(self, domain, namespace):
        """Return the CellWatch of a cell; raises CellError where ROS is missing or refuses."""
        key = (domain, namespace)
        if key not in self._watches:
            try:
                module = importlib.import_module('rosette_ros.web.cell_watch')
            except ImportError as error:
                raise CellError(f'live cell: wanted ROS 2 (rclpy and rosette_msgs), got: {error}; take the '
                                'rosette of `make setup`, or source a workspace in which it is built') from error
            while len(self._watches) >= self.MOST:
                self._watches.pop(next(iter(self._watches))).close()
            self._watches[key] = module.CellWatch(domain, namespace)
        return self._watches[key]

    def close(self):
        """Leave all cells."""
        for watch in self._watches.values():
            watch.close()
        self._watches.clear()
