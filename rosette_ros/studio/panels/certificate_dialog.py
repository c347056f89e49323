# SPDX-License-Identifier: Apache-2.0
"""The calibration certificate of the run that is shown: what it will state, then the files."""

from collections.abc import Callable

from nicegui import ui

from rosette_ros.core.run.errors import RosetteError, one_line
from rosette_ros.io.identity_file import Identity, words_of_entry
from rosette_ros.presentation.identity_words import SIMULATED, identity_rows
from rosette_ros.studio.calculations import MadeCertificate
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.widgets import Area, ErrorLine, button, marked, plain_table, row
from rosette_ros.studio.studio_session import OpenedRun
from rosette_ros.studio.worker import Superseded


class CertificateDialog:
    """Makes a certificate in the background, shows what it states, and saves it as XML (DCC) and as pages (PDF)."""

    def __init__(self, controller: Controller, on_state: Callable[[], None]) -> None:
        """Build it; on_state(): let who, what and where be stated."""
        self._controller = controller
        with ui.dialog() as self.dialog, ui.element('div').classes('card').style('width: 860px; max-width: 94vw'):
            ui.html('Calibration certificate', sanitize=False, tag='h2')
            self._before = Area(marked(ui.element('div').classes('list small'), 'certificate-before'))
            self._error = ErrorLine('certificate-error')
            with row():
                button('Identity, inputs', on_state, 'badge', 'certificate-state')
                self._make = button('Make', self._certify, 'workspace_premium', 'certificate-make', strong=True)
                self._busy = marked(ui.spinner(size='22px').props('aria-label="Calculating"'), 'certificate-busy')
            self._preview = Area(marked(ui.element('div').classes('list small').props('role=status aria-live=polite'),
                                        'certificate-preview'))
            button('Close', self.dialog.close, 'close', 'certificate-close')
        self._busy.set_visibility(False)

    def open(self) -> None:
        """Let a certificate be made."""
        self._error.set('')
        self.dialog.open()

    def show(self, opened: OpenedRun) -> None:
        """Show what is stated, what lacks, and the certificate where it was made of that."""
        self._before.show(_fill_stated, opened.source.identity if opened.source else Identity(), opened.run.simulated)
        self._preview.show(_fill_made, self._controller.answer('certificate'))

    async def _certify(self) -> None:
        self._error.set('')
        self._busy.set_visibility(True)
        self._make.set_enabled(False)
        try:
            await self._controller.certify()
        except Superseded:
            return
        except RosetteError as error:
            self._error.set(one_line(error))
        finally:
            self._busy.set_visibility(False)
            self._make.set_enabled(True)


def _fill_stated(identity: Identity, is_simulated: bool) -> None:
    if is_simulated:
        ui.label(SIMULATED).classes('error')
    with ui.element('div').classes('facts'):
        for name, words in identity_rows(identity) or [
                ('Not stated (ISO/IEC 17025)', ', '.join(map(words_of_entry, identity.missing)))]:
            ui.label(name)
            ui.label(words)


def _fill_made(made: MadeCertificate | None) -> None:
    if made is None:
        return
    with row():
        button('Save XML (DCC)', lambda: ui.download.content(made.xml, f'{made.name}.xml', 'application/xml'), 'save',
               'certificate-xml', strong=True)
        button('Save pages (PDF)', lambda: ui.download.content(made.pages, f'{made.name}.pdf', 'application/pdf'),
               'picture_as_pdf', 'certificate-pdf', strong=True)
    ui.label(made.judgement).classes(f'judged {made.level}')
    for words in made.contradictions:
        ui.label(f'Contradiction: {words}').classes('error')
    for table in made.tables:
        ui.label(table.title).classes('title')
        plain_table(table)
        ui.label(table.note).classes('soft')
