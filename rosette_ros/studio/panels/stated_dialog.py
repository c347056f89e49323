# SPDX-License-Identifier: Apache-2.0
"""What is stated of the run that is shown: identity, tolerances, environment, inputs of U; from files and in a form."""

from collections.abc import Awaitable, Callable

from nicegui import ui
from nicegui.events import UploadEventArguments

from rosette_ros.core.run.axes import iso_names
from rosette_ros.core.run.errors import RosetteError, one_line
from rosette_ros.core.run.records import SI_UNITS
from rosette_ros.core.uncertainty.budget_inputs import SECTIONS as INPUTS
from rosette_ros.core.uncertainty.stated_environment import CLASSES
from rosette_ros.io.identity_file import AT, MOST_BYTES, SECTIONS, Identity, words_of_entry
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.widgets import ErrorLine, button, input_field, marked, row
from rosette_ros.studio.stated import OF_FILE, Stated
from rosette_ros.studio.studio_session import OpenedRun

GROUPS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ('Rotary table', ('table',)), ('Conditions and days', ('conditions', 'measured', 'place')),
    ('Certificate and signature', ('certificate', 'traceability', 'operator', 'signer')),
    ('Laboratory', ('laboratory',)), ('Customer', ('customer',)),
    ('CMM, probe, plate, thermometer', ('cmm', 'probe', 'plate', 'thermometer')))
"""Headings of the form, and the sections of an identity below each."""
UNITS = {'um': 'µm', 'urad': 'µrad', 'K': 'K', 'um_per_K': 'µm/K', 'um_per_m_K': 'µm/(m K)'}
"""Units as the names of entries end."""
SAMPLES = {'m': '1.5 µm', 'rad': '2 µrad or 0.4 arcsec'}


class StatedDialog:
    """The dialog with files and the form; nothing counts before it is applied."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._stated = Stated()
        self._entries: dict[str, ui.input | ui.select] = {}
        self._tolerances: dict[str, ui.input] = {}
        self._inputs: dict[tuple[str, str], ui.input | ui.number] = {}
        self._environment: ui.select | None = None
        with ui.dialog() as self.dialog, ui.element('div').classes('card').style('width: 860px; max-width: 94vw'):
            ui.html('Identity, tolerances, environment, inputs of U', sanitize=False, tag='h2')
            with row():
                self._path = input_field(ui.input('path of a file (YAML): rosette-identity/1 or rosette-budget/1'),
                                         'state-path', 'flex: 1 1 320px')
                button('Take', self._take_path, 'upload_file', 'state-take')
            self._upload = ui.upload(on_upload=self._take, on_rejected=self._reject, auto_upload=True,
                                     max_file_size=MOST_BYTES, label='or upload such files').classes('drop')
            marked(self._upload.props('flat bordered aria-label="Upload identity or inputs"'), 'state-upload')
            self._form = marked(ui.element('div').classes('list'), 'state-form')
            self._error = ErrorLine('state-error')
            with row().classes('at-foot'):
                button('Apply', self._apply, 'check', 'state-apply', strong=True)
                button('Save identity', lambda: self._save(lambda made: made.identity_text, 'identity.yaml'), 'save',
                       'state-save-identity')
                button('Save inputs', lambda: self._save(lambda made: made.inputs_text, 'inputs.yaml'), 'save',
                       'state-save-inputs')
                button('Close', self.dialog.close, 'close', 'state-close')

    def open(self) -> None:
        """Show what is stated of the run that is shown, with what its log says."""
        current = self._controller.session.current
        if current is not None:
            self._error.set('')
            self._fill(current, current.stated)
            self.dialog.open()

    # Files

    def _take_path(self) -> None:
        if path := self._path.value.strip():
            self._read(lambda: self._stated.with_path(path))

    async def _take(self, event: UploadEventArguments) -> None:
        data = await event.file.read()
        self._read(lambda: self._stated.with_file(data, event.file.name))
        self._upload.reset()

    def _reject(self) -> None:
        self._error.set(f'upload: expected a file of at most {MOST_BYTES} bytes, found more')

    def _read(self, read: Callable[[], Stated]) -> None:
        """Show what a file states in the form."""
        current = self._controller.session.current
        self._error.set('')
        try:
            made = read()
        except RosetteError as error:
            self._error.set(one_line(error))
        else:
            if current is not None:
                self._fill(current, made)

    # The form

    def _fill(self, current: OpenedRun, stated: Stated) -> None:
        """Build the form with what is stated, and what the log of the run says where that is not."""
        self._stated = stated
        logged = current.logged.identity if current.logged else Identity()
        identity = logged.with_changes(stated.identity)[0]
        self._form.clear()
        self._entries, self._tolerances, self._inputs = {}, {}, {}
        with self._form:
            if logged.entries:
                ui.label('What the log states stays where a field is left empty.').classes('soft small')
            for place, (heading, sections) in enumerate(GROUPS):
                with _group(heading, 'state-' + sections[0], place == 0):
                    for section in sections:
                        for name in SECTIONS[section]:
                            self._entries[f'{section}.{name}'] = _entry_field(section, name, identity)
                if place == 0:
                    with _group('Tolerances: largest ranges of the error motions', 'state-tolerances', True):
                        self._fill_tolerances(current, identity)
            with _group('Environment and inputs of U', 'state-inputs', False):
                self._fill_inputs(stated)

    def _fill_tolerances(self, current: OpenedRun, identity: Identity) -> None:
        for curve, iso in iso_names(current.run.rotation).items():
            name = iso.lstrip('-')
            value = identity.tolerances.get(name) or identity.tolerances.get(curve) or ''
            made = ui.input(f'{name} ({curve})', value=value).props(f'placeholder="{SAMPLES[SI_UNITS[curve]]}"')
            self._tolerances[name] = input_field(made, f'tolerance-{curve}')

    def _fill_inputs(self, stated: Stated) -> None:
        offered = {'': 'none stated', **{name: name for name in CLASSES}}
        if stated.environment == OF_FILE:
            offered[OF_FILE] = OF_FILE
        self._environment = input_field(ui.select(offered, label='environment', value=stated.environment),
                                        'state-environment')
        for section, (meaning, entries) in INPUTS.items():
            ui.label(f'{meaning[:1].upper()}{meaning[1:]}').classes('title whole')
            given = stated.budget.get(section) or {}
            for name, entry in entries.items():
                number = ui.number(_label(name), value=given.get(name)).props(f'hint="{entry.words}"')
                self._inputs[section, name] = input_field(number, f'input-{section}-{name}')
            self._inputs[section, 'dof'] = input_field(ui.number('degrees of freedom', value=given.get('dof')),
                                                       f'input-{section}-dof')
            self._inputs[section, 'words'] = input_field(ui.input('whence the numbers are', value=given.get('words')),
                                                         f'input-{section}-words')

    def _made(self) -> Stated:
        """Return what the form states; raises InvalidData in the words of a file."""
        sections: dict[str, dict[str, float | str | None]] = {}
        for (section, name), one in self._inputs.items():
            sections.setdefault(section, {})[name] = one.value
        return self._stated.with_identity({key: one.value for key, one in self._entries.items()}, {
            name: one.value for name, one in self._tolerances.items()}).with_inputs(
                sections, str(self._environment.value) if self._environment else '')

    async def _do(self, work: Callable[[Stated], Awaitable[None]]) -> None:
        self._error.set('')
        try:
            await work(self._made())
        except RosetteError as error:
            self._error.set(one_line(error))

    async def _apply(self) -> None:
        async def apply(made: Stated) -> None:
            await self._controller.state(made)
            self.dialog.close()
        await self._do(apply)

    async def _save(self, text_of: Callable[[Stated], str], name: str) -> None:
        async def save(made: Stated) -> None:
            if text := text_of(made):
                ui.download.content(text, name, 'application/yaml')
            else:
                self._error.set(f'{name}: expected something that is stated, found nothing')
        await self._do(save)


def _label(name: str) -> str:
    """Return the name of an entry with its unit: `u / µm` of `u_um`."""
    quantity, _, unit = name.partition('_')
    return f'{quantity} / {UNITS[unit]}' if unit else quantity


def _group(heading: str, mark: str, is_open: bool) -> ui.element:
    """Return the place of the fields below a heading."""
    with marked(ui.expansion(heading, value=is_open).props('dense'), mark):
        return ui.element('div').classes('fields')


def _entry_field(section: str, name: str, identity: Identity) -> ui.input | ui.select:
    entry = f'{section}.{name}'
    words = words_of_entry(entry)
    if entry == 'place.at':
        return input_field(ui.select(['', *AT], label=words, value=identity[entry]), f'state-{section}-{name}')
    made = ui.input(words, value=identity[entry])
    if name in ('date', 'begin', 'end'):
        made.props('placeholder="2026-04-12"')
    return input_field(made, f'state-{section}-{name}')
