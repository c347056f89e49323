# SPDX-License-Identifier: Apache-2.0
"""The page: puts the panels together, and turns what a person does into work for the desk."""

from importlib import resources

from nicegui import background_tasks, ui

from rosette_ros.core.errors import RosetteError
from rosette_ros.data.model_file import format_model
from rosette_ros.web.candidates_panel import CandidatesPanel
from rosette_ros.web.desk import one_line
from rosette_ros.web.errand import Stale
from rosette_ros.web.figures_panel import FiguresPanel
from rosette_ros.web.gallery import Gallery
from rosette_ros.web.live_panel import LivePanel
from rosette_ros.web.model_panel import ModelPanel
from rosette_ros.web.opening import OpenDialog
from rosette_ros.web.tools_panel import CheckPanel, OwnTermPanel
from rosette_ros.web.verdict_panel import VerdictPanel
from rosette_ros.web.widgets import button, marked, set_words

KEYS = {'o': 'open a run', 'p': 'preview what is missing most', 'a': 'add what is previewed, or what is missing most',
        'Escape': 'close the preview', 'u': 'undo', 'r': 'redo', 'v': 'switch between model now and preview',
        's': 'save the model', 'd': 'light or dark', '?': 'show the keys'}
RUN, LIVE = 'Run', 'Live cell'
THEMES = {None: ('brightness_auto', 'Colours follow the system (d)'), True: ('dark_mode', 'Dark (d)'),
          False: ('light_mode', 'Light (d)')}


class Page:
    """One open page: the panels of a Desk."""

    def __init__(self, desk, wanted, folder, cells):
        """Build the page of a desk; folder: for uploads; cells: the Cells of all pages."""
        self.desk, self._wanted = desk, wanted
        self._client = ui.context.client
        self._busy = False
        self._gallery = Gallery()
        ui.add_css(resources.files('rosette_ros.web').joinpath('style.css').read_text('utf-8'))
        ui.colors(primary='#00598c')
        self._dark = ui.dark_mode(None)
        self._dialog = OpenDialog(desk, wanted.suggestions, folder, self.refresh)
        self._build_bar()
        with ui.element('main').classes('sheet'):
            with self._tab(RUN):
                self._build_sheet()
            with self._tab(LIVE):
                self._live = LivePanel(desk, self._gallery, cells, (wanted.domain, wanted.namespace), self._open_log)
        self._build_help()
        ui.keyboard(self._on_key, repeating=False, ignore=['input', 'select', 'textarea'])
        self._panels = (self._verdict, self._model, self._candidates, self._own, self._check, self._figures)
        desk.watch(self.show)
        self._client.on_delete(lambda: desk.unwatch(self.show))

    async def begin(self, is_new):
        """Show what is on the desk; a new desk gets the runs of the command line."""
        self.show()
        if is_new and self._wanted.runs:
            background_tasks.create(self._open_all())
        elif self.desk.session.current is None:
            self._dialog.show()

    async def _open_all(self):
        with self._client:
            for path in reversed(self._wanted.runs):
                await self._dialog.open(path)

    # Building

    def _build_bar(self):
        with ui.element('header').classes('bar'):
            ui.html('rosette studio', sanitize=False, tag='h1')
            with ui.tabs(value=RUN).props('no-caps dense') as self._tabs:
                marked(ui.tab(RUN), 'tab-run')
                marked(ui.tab(LIVE), 'tab-live')
            self._runs = ui.select({}, label='run', on_change=self._choose)
            marked(self._runs.props('dense outlined options-dense').classes('run-choice'), 'run')
            button('Open', self._dialog.show, 'folder_open', 'open', hint='Open a run (o)')
            ui.element('div').classes('grow')
            self._save = button('Save model', self._save_model, 'save', 'save-model', hint='Save the model (s)')
            self._report = button('Report', self._save_report, 'summarize', 'save-report',
                                  hint='Save the report, one HTML file')
            self._theme = button('', self._turn_theme, THEMES[None][0], 'theme', hint=THEMES[None][1])
            button('', lambda: self._help.open(), 'keyboard', 'help', hint='Keys (?)')

    def _tab(self, name):
        """Return the part of the page that is seen while a tab is chosen; pictures in it stay alive."""
        made = ui.element('div').classes('tab').props(f'role=tabpanel aria-label="{name}"')
        return made.bind_visibility_from(self._tabs, 'value', lambda value: value == name)

    def _build_sheet(self):
        with ui.element('div').classes('error').props('role=alert') as self._error_box:
            ui.icon('error').props('aria-hidden=true')
            self._error = marked(ui.label(''), 'error')
        self._empty = ui.label('No run is open: open a log or a table of ball centres.').classes('soft')
        self._verdict = VerdictPanel(self.desk, self._preview_first, self._diagnose)
        with ui.element('div').classes('halves'):
            with ui.element('div').classes('side'):
                self._model = ModelPanel(self.desk, self._gallery, self.act)
                self._candidates = CandidatesPanel(self.desk, self.preview, self.add)
                self._own = OwnTermPanel(self.desk, self._preview_entry, lambda entry: self.act('add_entry', entry))
                self._check = CheckPanel(self.desk, self._cross_check)
            with ui.element('div').classes('main'):
                self._figures = FiguresPanel(self.desk, self._gallery, self._add_preview, self._drop_preview)

    def _build_help(self):
        with ui.dialog() as self._help, ui.element('div').classes('card'):
            ui.html('Keys', sanitize=False, tag='h2')
            with ui.element('table').classes('plain-table'):
                for key, words in KEYS.items():
                    with ui.element('tr'):
                        with ui.element('td'):
                            ui.label('Esc' if key == 'Escape' else key).classes('key')
                        with ui.element('td'):
                            ui.label(words)
            ui.label('Tab and Enter reach everything else.').classes('soft small')
            button('Close', self._help.close, 'close', 'help-close')

    # Showing

    def show(self):
        """Show what is on the desk."""
        session = self.desk.session
        runs = {one.key: one.name for one in session.runs}
        current = session.current.key if session.current else None
        if runs != self._runs.options or self._runs.value != current:
            self._runs.set_options(runs, value=current)
        set_words(self._error, self.desk.error)
        self._error_box.set_visibility(bool(self.desk.error))
        self._empty.set_visibility(session.current is None)
        self._save.set_enabled(session.current is not None)
        self._report.set_enabled(session.story is not None and not self._busy)
        for panel in self._panels:
            panel.show()

    def refresh(self, unasked=True):
        """Find out beside the page what there is to know."""
        background_tasks.create(self.desk.refresh(unasked))

    async def _open_log(self, path):
        await self._dialog.open(path)
        if not self._dialog.dialog.value:
            self._tabs.set_value(RUN)

    # What a person does

    def act(self, action, *arguments):
        """Let the session do something; find out what follows."""
        try:
            self.desk.act(action, *arguments)
        except RosetteError as error:
            self._fail(error)
        self.refresh()

    def add(self, name, setting=None):
        """Add an effect to the model."""
        self.act('add', name, setting)

    async def preview(self, name, setting=None):
        """Show what adding an effect would do."""
        await self._preview(name, lambda: self.desk.session.model_with(name, setting))

    async def _preview_entry(self, entry):
        await self._preview(entry['own'], lambda: self.desk.session.model.with_entry(entry))

    async def _preview(self, name, make):
        self.desk.error = ''
        try:
            await self.desk.preview(name, make())
        except Stale:
            return
        except RosetteError as error:
            self._fail(error)

    async def _preview_first(self, first):
        if first is not None:
            await self.preview(first.effect, dict(first.setting) or None)

    def _add_preview(self):
        preview = self.desk.session.preview
        if preview is not None:
            self.act('change_model', preview.model, f'add {preview.name}')

    def _drop_preview(self):
        self.desk.act('drop_preview')

    async def _cross_check(self, key):
        try:
            await self.desk.cross_check(key)
        except Stale:
            return
        except RosetteError as error:
            self._fail(error)

    def _diagnose(self):
        self.refresh(unasked=False)

    def _choose(self, event):
        current = self.desk.session.current
        if event.value is not None and (current is None or event.value != current.key):
            self.desk.select(event.value)
            self.refresh()

    def _fail(self, error):
        self.desk.error = one_line(error)
        self.desk.tell()

    def _save_model(self):
        if self.desk.session.current is not None:
            ui.download.content(format_model(self.desk.session.model), 'model.yaml', 'application/yaml')

    async def _save_report(self):
        self._busy = True
        self.show()
        try:
            report = await self.desk.report()
        except Stale:
            return
        except RosetteError as error:
            self._fail(error)
            return
        finally:
            self._busy = False
            self.show()
        if report is not None:
            ui.download.content(report, f'{self.desk.session.current.run.run_id or "report"}.html', 'text/html')

    def _turn_theme(self):
        order = (None, True, False)
        self._dark.set_value(order[(order.index(self._dark.value) + 1) % len(order)])
        icon, words = THEMES[self._dark.value]
        self._theme.set_icon(icon)
        self._theme.props(f'title="{words}" aria-label="{words}"')

    async def _on_key(self, event):
        if not event.action.keydown or event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta:
            return
        if self._dialog.dialog.value or self._help.value:
            return
        key = event.key.name
        if self._tabs.value != RUN and key not in ('d', '?'):
            return
        actions = {'o': self._dialog.show, 'u': lambda: self.act('undo'), 'r': lambda: self.act('redo'),
                   's': self._save_model, 'd': self._turn_theme, '?': self._help.open,
                   'Escape': self._drop_preview, 'v': self._figures.switch, 'a': self._add_best}
        if key == 'p':
            await self._preview_first(self._verdict.first)
        elif key in actions:
            actions[key]()

    def _add_best(self):
        if self.desk.session.preview is not None:
            self._add_preview()
        elif self._verdict.first is not None:
            self.add(self._verdict.first.effect, dict(self._verdict.first.setting) or None)
