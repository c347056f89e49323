# SPDX-License-Identifier: Apache-2.0
"""The page: panels, clicks and keys that are actions of a controller, one for each browser; how it is served."""

import asyncio
import ipaddress
import secrets
import socket
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from importlib import resources
from tempfile import TemporaryDirectory

from nicegui import app, background_tasks, ui
from nicegui.events import KeyEventArguments, ValueChangeEventArguments

from rosette_ros.analysis import claimed_model
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import CellError, InvalidConfig, RosetteError
from rosette_ros.io.model_file import format_model
from rosette_ros.nodes.names import NAMESPACE
from rosette_ros.studio.access_control import LOOPBACK, AccessControl
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.archive_panel import ArchivePanel
from rosette_ros.studio.panels.certificate_dialog import CertificateDialog
from rosette_ros.studio.panels.correction_dialog import CorrectionDialog
from rosette_ros.studio.panels.diagnosis_panel import CandidatesPanel, CrossCheckPanel, VerdictPanel
from rosette_ros.studio.panels.figures_panel import FiguresPanel
from rosette_ros.studio.panels.live_panel import CellWatchers, LivePanel
from rosette_ros.studio.panels.model_panel import CustomTermPanel, Entry, ModelPanel
from rosette_ros.studio.panels.open_dialog import OpenDialog
from rosette_ros.studio.panels.request_panels import (
    BudgetPanel,
    JointPanel,
    OrdersPanel,
    OverlayPanel,
    TouchPanel,
    WayPanel,
)
from rosette_ros.studio.panels.stated_dialog import StatedDialog
from rosette_ros.studio.panels.widgets import ErrorLine, button, input_field, marked
from rosette_ros.studio.studio_session import KeptResults
from rosette_ros.studio.worker import Superseded, prepare

RUN, LIVE, ARCHIVE = 'Run', 'Live cell', 'Archive'
THEMES = {None: ('brightness_auto', 'Colours follow the system (d)'), True: ('dark_mode', 'Dark (d)'),
          False: ('light_mode', 'Light (d)')}
MOST_BROWSERS = 16
"""The state of so many browsers is kept; of more, that of the one without a page not seen for longest is dropped."""
CONNECTED_WITHIN = 30.0
"""A page whose websocket is not open after so long is forgotten, s."""
REMOVED_FIGURE = """<script>addEventListener('unhandledrejection', event => {
    if (event.reason?.message?.startsWith('Resize must be passed a displayed plot div')) event.preventDefault();
})</script>"""
"""A figure that is removed before its browser has drawn it cannot follow the size of the window; nobody needs it to."""


@dataclass(frozen=True)
class StudioOptions:
    """Options of the command line; port: 0 for a free one; domain: None for that of the environment."""

    runs: tuple[str, ...] = ()
    suggestions: tuple[str, ...] = ()
    host: str = '127.0.0.1'
    port: int = 0
    token: str | None = None
    domain: int | None = None
    browser: bool = True
    namespace: str = NAMESPACE
    archive: str = ''


class Page:
    """One open page with the panels of a Controller."""

    def __init__(self, controller: Controller, options: StudioOptions, folder: str, cells: CellWatchers) -> None:
        self._controller, self._session, self._options = controller, controller.session, options
        self._client = ui.context.client
        self._is_reporting = False
        self._add = partial(self._act, self._session.add)
        self._dark = ui.dark_mode(None)
        self._dialog = OpenDialog(controller, options.suggestions, folder, self.refresh)
        self._stated = StatedDialog(controller)
        self._certify = CertificateDialog(controller, self._stated.open)
        self._correct = CorrectionDialog(controller)
        self._build_bar()
        with ui.element('div').classes('sheet'):
            with self._tab(RUN):
                self._build_run()
            with self._tab(LIVE):
                LivePanel(controller, cells, options.domain, options.namespace, self._open_log)
            with self._tab(ARCHIVE):
                self._archive = ArchivePanel(controller, options.archive, self._open_log)
        self._keys: dict[str, tuple[str, Callable[[], Awaitable[None] | None]]] = {
            'o': ('open a run', self._dialog.show), 'i': ('state identity and inputs', self._stated.open),
            'p': ('preview all missing effects', self._preview_missing),
            'a': ('add the preview, or all missing effects', self._add_best),
            'Escape': ('close the preview', controller.drop_preview),
            'u': ('undo', partial(self._act, self._session.undo)),
            'r': ('redo', partial(self._act, self._session.redo)),
            'v': ('switch between the model as it is and the preview', self._figures.switch),
            's': ('save the model', self._save_model), 'd': ('light or dark', self._change_theme),
            '?': ('show the keys', lambda: self._help.open())}
        self._build_help()
        ui.keyboard(self._on_key, repeating=False, ignore=['input', 'select', 'textarea'])
        controller.changed.subscribe(self.show)

    def begin(self, is_new: bool) -> None:
        """Show the session; a new one opens the runs of the command line."""
        self.show()
        if is_new and self._options.runs:
            background_tasks.create(self._open_all())
        elif self._session.current is None and not self._options.archive:
            self._dialog.show()
        if self._options.archive:
            self._tabs.set_value(ARCHIVE)
            background_tasks.create(self._open_archive())

    async def _open_all(self) -> None:
        with self._client:
            for path in reversed(self._options.runs):
                await self._dialog.open(path, asked=False)

    async def _open_archive(self) -> None:
        with self._client:
            await self._archive.open()

    # Building

    def _build_bar(self) -> None:
        with ui.element('header').classes('bar'):
            ui.html('rosette studio', sanitize=False, tag='h1')
            with ui.tabs().props('no-caps dense') as self._tabs:
                marked(ui.tab(RUN), 'tab-run')
                marked(ui.tab(LIVE), 'tab-live')
                marked(ui.tab(ARCHIVE), 'tab-archive')
            self._tabs.set_value(RUN)
            self._runs = input_field(ui.select({}, label='run', on_change=self._select), 'run').classes('run-choice')
            button('Open', self._dialog.show, 'folder_open', 'open', hint='Open a run (o)')
            self._identity = button('Identity, inputs', self._stated.open, 'badge', 'state', hint='State who, what, '
                                    'where, tolerances, environment and inputs of U (i)')
            self._certificate = button('Certificate', self._certify.open, 'workspace_premium', 'certificate',
                                       hint='Look at the calibration certificate and save it')
            self._correction = button('Correction', self._correct.open, 'tune', 'correction',
                                      hint='Look at the correction of the table and save it')
            self._save = button('Model', self._save_model, 'save', 'save-model', hint='Save the model (s)')
            self._report = button('Report', self._save_report, 'summarize', 'save-report',
                                  hint='Save the report, one HTML file')
            self._theme = button('', self._change_theme, THEMES[None][0], 'theme', hint=THEMES[None][1])
            button('', lambda: self._help.open(), 'keyboard', 'help', hint='Keys (?)')

    def _tab(self, name: str) -> ui.element:
        """Return the part of the page that is seen while a tab is chosen; figures in it stay drawn."""
        made = ui.element('div').classes('tab').props(f'role=tabpanel aria-label="{name}"')
        return made.bind_visibility_from(self._tabs, 'value', lambda value: value == name)

    def _build_run(self) -> None:
        controller = self._controller
        self._error = ErrorLine('error')
        self._empty = ui.label('No run is open: open a log or a table of ball centres.').classes('soft')
        with ui.element('div').classes('tab') as self._run_sheet:
            self._verdict = VerdictPanel(controller, self._preview_missing, self._add_best,
                                         partial(self.refresh, False), lambda: self._run(self._download_next()))
            with ui.element('div').classes('halves'):
                with ui.element('div').classes('side'):
                    panels = (
                        ModelPanel(controller, self._act), CandidatesPanel(controller, self._preview, self._add),
                        CustomTermPanel(controller, self._preview_entry, partial(self._act, self._session.add_entry)),
                        CrossCheckPanel(controller, lambda place: self._run(controller.cross_check(place))))
                with ui.element('div').classes('main'):
                    self._figures = FiguresPanel(controller, self._add_preview, controller.drop_preview)
                    below = (
                        BudgetPanel(controller, lambda: self._run(controller.make_budget())),
                        OrdersPanel(controller, lambda stated: self._run(controller.compare_orders(stated))),
                        OverlayPanel(controller, lambda places: self._run(controller.lay_over(places))),
                        TouchPanel(controller, lambda: self._run(controller.read_touches())),
                        WayPanel(controller, lambda: self._run(controller.show_way())),
                        JointPanel(controller, lambda places: self._run(controller.evaluate_jointly(places))))
        self._panels = (self._verdict, *panels, self._figures, *below, self._certify)

    def _build_help(self) -> None:
        with ui.dialog() as self._help, ui.element('div').classes('card'):
            ui.html('Keys', sanitize=False, tag='h2')
            with ui.element('div').classes('facts'):
                for key, (words, _) in self._keys.items():
                    ui.label('Esc' if key == 'Escape' else key).classes('key')
                    ui.label(words)
            ui.label('All other controls: Tab and Enter.').classes('soft small')
            button('Close', self._help.close, 'close', 'help-close')

    # Showing

    def show(self) -> None:
        """Show the session."""
        current, runs = self._session.current, dict(enumerate(one.name for one in self._session.runs))
        place = self._session.runs.index(current) if current else None
        if runs != self._runs.options or self._runs.value != place:
            self._runs.set_options(runs, value=place)
        self._error.set(self._controller.error)
        self._empty.set_visibility(current is None)
        results = self._session.results
        is_ready = results.summary is not None or (current is not None and current.is_large and results.fit is not None)
        for one, is_enabled in ((self._save, current is not None), (self._identity, current is not None),
                                (self._certificate, is_ready), (self._correction, is_ready)):
            one.set_enabled(is_enabled)
        self._report.set_enabled(results.summary is not None and not self._is_reporting)
        self._run_sheet.set_visibility(current is not None)
        if current is not None:
            for panel in self._panels:
                panel.show(current)

    def refresh(self, unasked: bool = True) -> None:
        """Calculate in the background what is missing."""
        background_tasks.create(self._controller.refresh(unasked))

    async def _open_log(self, path: str, run_id: str = '') -> None:
        await self._dialog.open(path, run_id=run_id)
        if not self._dialog.dialog.value:
            self._tabs.set_value(RUN)

    # Actions

    async def _run(self, work: Awaitable[None]) -> None:
        try:
            await work
        except Superseded:
            return
        except RosetteError as error:
            self._controller.fail(error)

    def _act(self, action: Callable[..., None], *arguments: object) -> None:
        try:
            self._controller.act(action, *arguments)
        except RosetteError as error:
            self._controller.fail(error)
        self.refresh()

    async def _preview(self, name: str, setting: Setting | None) -> None:
        await self._run(self._controller.preview(name, partial(self._session.model_with, name, setting)))

    async def _preview_entry(self, entry: Entry) -> None:
        await self._run(self._controller.preview(entry['own'], partial(self._session.model.with_entry, entry)))

    @property
    def _missing(self) -> str:
        """The names of all missing effects."""
        summary = self._session.results.summary
        return ' and '.join(summary.diagnosis.missing) if summary else ''

    def _with_missing(self) -> Model:
        summary = self._session.results.summary
        return claimed_model(summary.diagnosis) if summary else self._session.model

    async def _preview_missing(self) -> None:
        if self._missing:
            await self._run(self._controller.preview(self._missing, self._with_missing))

    def _add_preview(self) -> None:
        if self._session.preview is not None:
            name, change = self._session.preview
            self._act(self._session.change_model, change.after.model, f'add {name}')

    def _add_best(self) -> None:
        if self._session.preview is not None:
            self._add_preview()
        elif self._missing:
            self._act(self._session.change_model, self._with_missing(), f'add {self._missing}')

    def _select(self, event: ValueChangeEventArguments) -> None:
        if event.value is not None and self._session.runs[event.value] is not self._session.current:
            self._act(self._session.select, event.value)

    def _save_model(self) -> None:
        if self._session.current is not None:
            ui.download.content(format_model(self._session.model), 'model.yaml', 'application/yaml')

    async def _save_report(self) -> None:
        self._is_reporting = True
        self.show()
        await self._run(self._download_report())
        self._is_reporting = False
        self.show()

    async def _download_report(self) -> None:
        report, current = await self._controller.report(), self._session.current
        if report is not None and current is not None:
            ui.download.content(report, f'{current.run.run_id or "report"}.html', 'text/html')

    async def _download_next(self) -> None:
        if plan := await self._controller.settle():
            ui.download.content(plan, 'next.csv', 'text/csv')

    def _change_theme(self) -> None:
        order = tuple(THEMES)
        self._dark.set_value(order[(order.index(self._dark.value) + 1) % len(order)])
        icon, words = THEMES[self._dark.value]
        self._theme.set_icon(icon)
        self._theme.props(f'title="{words}" aria-label="{words}"')

    async def _on_key(self, event: KeyEventArguments) -> None:
        modifiers, key = event.modifiers, event.key.name
        is_plain = event.action.keydown and not (modifiers.ctrl or modifiers.alt or modifiers.meta)
        dialogs = (self._dialog.dialog, self._help, self._stated.dialog, self._certify.dialog, self._correct.dialog)
        if not is_plain or any(one.value for one in dialogs):
            return
        if self._tabs.value != RUN and key not in ('d', '?'):
            return
        action = self._keys[key][1]() if key in self._keys else None
        if action is not None:
            await action


class Controllers:
    """The Controller of each browser, by the name in its cookie."""

    def __init__(self) -> None:
        self._controllers: OrderedDict[str, Controller] = OrderedDict()
        self._kept = KeptResults()

    def of(self, browser: str) -> tuple[Controller, bool]:
        """Return the Controller of a browser, and whether it is new."""
        is_new = browser not in self._controllers
        if is_new:
            self._controllers[browser] = Controller(self._kept)
        self._controllers.move_to_end(browser)
        unseen = [name for name, one in self._controllers.items() if not one.is_shown and name != browser]
        for name in unseen[:max(len(self._controllers) - MOST_BROWSERS, 0)]:
            self._controllers.pop(name).close()
        return self._controllers[browser], is_new

    def close(self) -> None:
        """End all calculations."""
        for controller in self._controllers.values():
            controller.close()


def serve(options: StudioOptions, on_ready: Callable[[str], object] | None = None) -> None:
    """Serve the studio until it is ended; on_ready(address): when it can be opened; raises CellError for the port."""
    port = free_port(options.host, options.port)
    name = f'[{options.host}]' if ':' in options.host else options.host
    address = f'http://{"localhost" if name in ("0.0.0.0", "[::]") else name}:{port}/'
    controllers, cells = Controllers(), CellWatchers()
    prepare()
    with TemporaryDirectory(prefix='rosette_studio_') as folder:
        async def build() -> None:
            client = ui.context.client
            await client.connected(CONNECTED_WITHIN)  # what only loads the page keeps nothing here
            if client.is_deleted:
                return
            controller, is_new = controllers.of(app.storage.browser['id'])
            Page(controller, options, folder, cells).begin(is_new)

        ui.page('/', title='rosette studio', favicon='◎', language='en-US')(build)
        ui.add_css(resources.files('rosette_ros.studio').joinpath('style.css').read_text('utf-8'), shared=True)
        ui.add_head_html(REMOVED_FIGURE, shared=True)
        app.colors(primary='#00598c')
        if on_ready:
            app.on_startup(lambda: background_tasks.create(_call_when_ready(options.host, port, address, on_ready)))
        app.on_shutdown(controllers.close)
        app.on_shutdown(cells.close)
        app.add_middleware(AccessControl, token=options.token,
                           names=(*LOOPBACK, options.host) if is_loopback(options.host) else None)
        query = f'?token={options.token}' if options.token else ''
        ui.run(host=options.host, port=port, show=f'/{query}' if options.browser else False, reload=False, dark=None,
               tailwind=False, storage_secret=secrets.token_hex(32), show_welcome_message=False,
               session_middleware_kwargs={'session_cookie': f'rosette_{port}', 'same_site': 'lax'},
               reconnect_timeout=30.0, timeout_graceful_shutdown=2)


async def _call_when_ready(host: str, port: int, address: str, on_ready: Callable[[str], object]) -> None:
    """Call on_ready(address) as soon as the port accepts connections."""
    while True:
        try:
            _, writer = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(0.05)
            continue
        writer.close()
        on_ready(address)
        return


def free_port(host: str, port: int) -> int:
    """Return a port that can be listened on; 0 means any. Raises CellError where it is taken."""
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise CellError(f'studio: expected a free port, found {host} port {port}: {error.strerror}; choose '
                            'another --port or --host') from error
        return int(probe.getsockname()[1])


def is_loopback(host: str) -> bool:
    """Return whether an address is this computer's alone; raises InvalidConfig for what is no address."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise InvalidConfig('--host: expected an IP address such as 192.168.1.5, or localhost, found '
                            f'{host!r}') from None
