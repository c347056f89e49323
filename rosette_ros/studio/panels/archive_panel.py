# SPDX-License-Identifier: Apache-2.0
"""The runs of an archive: filter, curves over each other, differences, the trend of a table; a click opens a run."""

import asyncio
import importlib
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from rosette_ros.core.run.errors import InvalidData, RosetteError, counted, one_line
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.presentation.cell_results import CausesOfRuns
from rosette_ros.presentation.formatting import curve_units
from rosette_ros.presentation.plots.plot_style import COLOURS
from rosette_ros.presentation.table_format import Table
from rosette_ros.requirements import missing_words
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import Curves, causes_figure, curves_figure, trend_figure
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.diagnosis_panel import ICONS
from rosette_ros.studio.panels.figures_panel import WIDTH
from rosette_ros.studio.panels.widgets import Figure, button, card, input_field, marked, picture, plain_table, row
from rosette_ros.studio.worker import Superseded

if TYPE_CHECKING:
    from rosette_ros.archive.table_history import TableTrend
    from rosette_ros.studio.archive_view import ArchiveRuns

OpenRun = Callable[[str, str], Awaitable[None]]
MOST_CURVES = 12
"""Runs whose curves are drawn over each other."""
COLUMNS = (('measured', 'measured, UTC'), ('table', 'table'), ('run_id', 'run'), ('cell', 'cell'), ('n', 'n'),
           ('rms', 'residual / µm'), ('level', 'verdict'), ('tolerances', 'tolerances'), ('lacks', 'lacks'))
"""Columns of the list; the ranges of the six curves follow the residual."""
STATE = """<q-td :props="props"><span :class="'state ' + props.row.FIELD"><q-icon v-if="props.value"
    :name="props.row.FIELD_icon" aria-hidden="true"/> {{ props.value }}</span></q-td>"""
"""A cell with the icon and the colour of a level; FIELD: that of the row."""
ANY = '(any)'


class ArchivePanel:
    """An archive by its folder; what it shows is read in the background."""

    def __init__(self, controller: Controller, folder: str, on_open: OpenRun) -> None:
        """Build it; folder: of the archive at first, '' for none; on_open(path, run_id): open a run."""
        self._controller, self._on_open = controller, on_open
        self._runs: ArchiveRuns | None = None
        self._is_filling = False
        self._points: list[list[tuple[str, str]]] = []
        with card('Archive of runs', 'archive'):
            with row():
                self._folder = input_field(ui.input('folder of the archive', value=folder), 'archive-folder',
                                           'flex: 1 1 320px')
                self._folder.on('keydown.enter', self.open)
                button('Open', self.open, 'folder_open', 'archive-open', strong=True)
            with row():
                self._table = self._choice('table', 'archive-table')
                self._model = self._choice('model', 'archive-model')
                self._since, self._until, self._effect = (
                    input_field(ui.input(words, on_change=self._filter).props('debounce=500'), f'archive-{mark}',
                                'width: 150px')
                    for words, mark in (('since (2026-01-31)', 'since'), ('until', 'until'), ('effect', 'effect')))
            self._error = widgets.ErrorLine('archive-error')
            self._words = marked(ui.label('').classes('soft small').props('role=status aria-live=polite'),
                                 'archive-words')
            ranges = [(curve, f'{curve} / {unit}') for curve, unit in zip(CURVES, curve_units(), strict=True)]
            place = [key for key, _ in COLUMNS].index('rms') + 1
            self._list = ui.table(columns=[{'name': key, 'label': head, 'field': key, 'sortable': True, 'align': 'left'}
                                           for key, head in (*COLUMNS[:place], *ranges, *COLUMNS[place:])],
                                  rows=[], row_key='key', selection='multiple', pagination=10)
            for column, level in (('level', 'level'), ('tolerances', 'tolerance_level')):
                self._list.add_slot(f'body-cell-{column}', STATE.replace('FIELD', level))
            marked(self._list.props('dense flat aria-label="Runs of the archive"'), 'archive-runs')
            self._list.on('rowClick', self._clicked, js_handler='(event, row) => emit(row.key)')
            with row() as self._actions:
                button('Curves of the chosen runs', lambda: self._do(self._draw_curves, False), 'stacked_line_chart',
                       'archive-overlay')
                button('Differences to the earliest', lambda: self._do(self._draw_curves, True), 'difference',
                       'archive-differences')
                button('Trend of the table', lambda: self._do(self._draw_trend), 'trending_up', 'archive-trend')
                button('Causes against runs', lambda: self._do(self._draw_causes), 'scatter_plot', 'archive-causes')
                button('All tables', lambda: self._do(self._show_plant), 'factory', 'archive-plant')
                self._busy = ui.spinner(size='22px')
            self._plant = widgets.Area(marked(ui.element('div').classes('list small'), 'archive-plant-table'))
        self._busy.set_visibility(False)
        with card('', 'archive-result') as self._result:
            self._title = marked(ui.label('').classes('title'), 'archive-title')
            self._figure = Figure(470, 'Curves of runs, or errors of a table over time', 'archive-figure', WIDTH)
            self._figure.on_click(self._point_clicked)
            self._tables = widgets.Area(marked(ui.element('div').classes('list small'), 'archive-tables'))
        self._show()

    def _choice(self, words: str, mark: str) -> ui.select:
        return input_field(ui.select({'': ANY}, label=words, value='', on_change=self._filter), mark, 'width: 190px')

    async def open(self) -> None:
        """Open the archive in the field."""
        self._runs = None
        self._plant.show(lambda: None)
        await self._filter()
        if self._runs is not None and any(self._runs.tables):
            await self._do(self._show_plant)

    async def _filter(self) -> None:
        """Read the runs that the filter leaves."""
        if self._is_filling or not self._folder.value.strip():
            return
        try:
            view, questions = map(importlib.import_module, (
                'rosette_ros.studio.archive_view', 'rosette_ros.archive.run_question'))
        except ImportError as error:
            self._fail(InvalidData(f'archive: {missing_words(error.name or "duckdb")}'))
            return
        equal = {'table': self._table.value} if self._runs and self._table.value else {}
        question = questions.Question(equal, self._since.value.strip(), self._until.value.strip(),
                                      self._effect.value.strip())
        await self._do(self._list_runs, view, question)

    async def _list_runs(self, view: Any, question: Any) -> None:
        runs: ArchiveRuns = await asyncio.to_thread(
            view.list_runs, self._folder.value.strip(), question, self._model.value if self._runs else '')
        self._runs = runs
        self._is_filling = True
        self._table.set_options({'': ANY, **{name: name for name in runs.tables if name}}, value=(
            self._table.value if self._table.value in runs.tables else ''))
        self._model.set_options({key: f'{key[:12]} ({number})' for key, number in runs.models}, value=runs.model)
        self._is_filling = False
        self._list.selected.clear()
        self._list.rows[:] = [{**line, **{f'{level}_icon': ICONS[line[level]] for level in (
            'level', 'tolerance_level')}} for line in runs.lines]
        self._list.update()
        self._show()

    async def _do(self, work: Callable[..., Awaitable[None]], *arguments: Any) -> None:
        self._error.set('')
        self._busy.set_visibility(True)
        try:
            await work(*arguments)
        except Superseded:
            return
        except RosetteError as error:
            self._fail(error)
        finally:
            self._busy.set_visibility(False)

    def _fail(self, error: RosetteError) -> None:
        self._error.set(one_line(error))

    def _show(self) -> None:
        self._actions.set_visibility(self._runs is not None)
        self._list.set_visibility(self._runs is not None)
        self._result.set_visibility(bool(self._title.text))
        if self._runs is not None:
            shown, total = len(self._runs.lines), self._runs.total
            self._words.set_text(f'{shown} of {counted(total, "run")} under model {self._runs.model[:12]}; a click '
                                 'on a run opens it')

    # What is chosen

    async def _draw_curves(self, less_first: bool) -> None:
        keys, least = [one['key'] for one in self._list.selected], 2 if less_first else 1
        if self._runs is None or not least <= len(keys) <= MOST_CURVES:
            raise InvalidData(f'expected {least} to {MOST_CURVES} runs to be chosen in the list, found {len(keys)}')
        view = importlib.import_module('rosette_ros.studio.archive_view')
        curves: list[tuple[str, ErrorMotions]] = await asyncio.to_thread(
            view.curves_of, self._folder.value.strip(), keys, self._runs.model)
        curves = view.less_earliest(curves) if less_first else curves
        drawn = [Curves(name, motions, COLOURS[place % len(COLOURS)]) for place, (name, motions) in enumerate(curves)]
        words = 'Six error motions less those of the earliest run' if less_first else 'Six error motions'
        self._points = []
        self._draw(f'{words}, with U (k = 2)', (words, self._runs.model, tuple(keys)), curves_figure, drawn)
        self._tables.show(lambda: None)

    async def _draw_trend(self) -> None:
        if self._runs is None:
            return
        tables = {one['table'] for one in self._list.rows}
        table = self._table.value or (tables.pop() if len(tables) == 1 else None)
        if table is None:
            raise InvalidData('expected one table to be chosen, found several in the list')
        view = importlib.import_module('rosette_ros.studio.archive_view')
        folder, model = self._folder.value.strip(), self._runs.model
        trend: TableTrend
        trend, changes = await self._controller.ask('trend', view.table_trend, folder, table, model)
        history = trend.history
        self._points = [list(zip(history.paths, history.runs, strict=True))] * len(CURVES)
        self._draw(f'Table {table or "without serial number"}: error motions over time, with U (k = 2); shaded: '
                   'between which runs it changed', ('trend', folder, table, model, history.runs), trend_figure,
                   history.dates, history.range, history.U, history.tolerances,
                   [(event.earliest - 1, event.latest, event.curves) for event in trend.events])
        self._tables.show(_fill, trend, changes)

    async def _draw_causes(self) -> None:
        if self._runs is None:
            return
        chosen = self._list.selected or self._list.rows
        view, keys = importlib.import_module('rosette_ros.studio.archive_view'), [one['key'] for one in chosen]
        found, places = await asyncio.to_thread(view.causes_of, self._folder.value.strip(), keys, self._runs.model)
        self._points = [[places[one.run] for one in found.dots if (one.size is not None) == is_named]
                        for is_named in (True, False)]
        self._draw('Causes against runs: the area of a dot is the probability by its run alone, its colour the size; '
                   'open: not named by the run', ('causes', self._runs.model, tuple(keys)), causes_figure, found)
        self._tables.show(_fill_causes, found)

    async def _show_plant(self) -> None:
        view = importlib.import_module('rosette_ros.studio.archive_view')
        table: Table = await asyncio.to_thread(view.plant_table_of, self._folder.value.strip())
        self._plant.show(_fill_plant, table)

    def _draw(self, words: str, key: tuple[object, ...], make: Callable[..., Any], *arguments: object) -> None:
        self._title.set_text(words)
        self._show()
        self._figure.draw(key, make, *arguments)

    # Opening runs

    async def _clicked(self, event: GenericEventArguments) -> None:
        line = next((one for one in self._list.rows if one['key'] == event.args), None)
        if line is not None:
            await self._on_open(line['path'], line['run_id'])

    async def _point_clicked(self, trace: int, points: list[int]) -> None:
        if trace < len(self._points) and points:
            await self._on_open(*self._points[trace][points[0]])


def _fill(trend: 'TableTrend', changes: str) -> None:
    marked(ui.label(trend.sentence), 'archive-sentence')
    for words in trend.notes:
        ui.label(words)
    for table in trend.tables:
        plain_table(table)
    if changes:
        picture(changes, 'What changed of the error motions, new less old, with U (k = 2), against the table angle',
                'archive-changes')


def _fill_causes(found: CausesOfRuns) -> None:
    """Say it where there is none."""
    if not found.causes:
        ui.label('No run has a cause with a probability above one half.')


def _fill_plant(table: Table) -> None:
    ui.label(table.title).classes('title')
    plain_table(table, [ICONS[level] for level in table.levels], table.levels)
    ui.label(table.note)
