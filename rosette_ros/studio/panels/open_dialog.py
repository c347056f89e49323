# SPDX-License-Identifier: Apache-2.0
"""Opening a run: by its path, from suggested ones, or by upload."""

import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from nicegui import ui
from nicegui.events import UploadEventArguments

from rosette_ros.core.run.errors import RosetteError, one_line
from rosette_ros.core.run.records import Run
from rosette_ros.presentation.report import open_source
from rosette_ros.presentation.report.provenance import Source
from rosette_ros.studio.access_control import MOST_UPLOAD, TOO_LARGE
from rosette_ros.studio.calculations import read_upload
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.widgets import ErrorLine, button, input_field, marked, row
from rosette_ros.studio.worker import Superseded, WorkerFailed

READ_MEMORY, READ_WITHIN = 2 << 30, 60.0
"""Most memory and time for reading a run that was uploaded, bytes and s."""
MOST_NAME = 120
"""Longest name of a file, bytes; systems take 255."""


class OpenDialog:
    """The dialog in which a run is chosen; what is wrong with it is shown there."""

    def __init__(self, controller: Controller, suggestions: Sequence[str], folder: str,
                 on_opened: Callable[[], object]) -> None:
        """Build it; folder: for uploads; on_opened(): called when a run was opened."""
        self._controller, self._folder, self._on_opened = controller, folder, on_opened
        with ui.dialog() as self.dialog, ui.element('div').classes('card').style('width: 560px; max-width: 94vw'):
            ui.html('Open a run', sanitize=False, tag='h2')
            self._path = ui.input('path of a log directory, .mcap file or CSV table', autocomplete=list(suggestions))
            input_field(self._path.on('keydown.enter', self._open_path), 'open-path')
            with row():
                self._run_id = input_field(ui.input('run id, if there are several'), 'open-run-id', 'flex: 1 1 260px')
                button('Open', self._open_path, 'folder_open', 'open-go', strong=True)
                self._busy = ui.spinner(size='22px')
            if suggestions:
                ui.label('Runs found').classes('soft small')
                with ui.element('div').style('display: grid; max-height: 180px; overflow: auto'):
                    for path in suggestions[:30]:
                        button(path, lambda path=path: self.open(path), 'description') \
                            .props('align=left').style('width: 100%')
            ui.label(f'or upload one: an .mcap file or a CSV table of at most {MOST_UPLOAD >> 20} MB')
            self._upload = ui.upload(on_upload=self._take, on_rejected=self._reject, auto_upload=True,
                                     max_file_size=MOST_UPLOAD, label='Upload a file').classes('drop')
            marked(self._upload.props('flat bordered aria-label="Upload a file"'), 'upload')
            self._error = ErrorLine('open-error')
            button('Close', self.dialog.close, 'close', 'open-close')
        self._busy.set_visibility(False)

    def show(self) -> None:
        """Let a run be chosen."""
        self._error.set('')
        self.dialog.open()

    async def _open_path(self) -> None:
        if self._path.value.strip():
            await self.open(os.path.expanduser(self._path.value.strip()))

    async def open(self, path: str, asked: bool = True, run_id: str = '') -> None:
        """Open a path, or show what is wrong with it; asked: in the dialog, which else stays as a person has it."""
        await self._open(open_source, Path(path), run_id or self._run_id.value.strip() or None, asked=asked)

    async def _take(self, event: UploadEventArguments) -> None:
        """Take an uploaded file: it is read as a run, and as nothing else."""
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            path = Path(folder, safe_name(event.file.name))
            await event.file.save(path)
            await self._open(read_upload, path, within=READ_WITHIN, memory=READ_MEMORY)
        self._upload.reset()

    async def _open(self, read: Callable[..., tuple[Run, Source]], path: Path, *arguments: object, asked: bool = True,
                    **limits: Any) -> None:
        if asked:
            self._error.set('')
        self._busy.set_visibility(True)
        try:
            await self._controller.open(read, path, *arguments, **limits)
        except Superseded:
            pass
        except RosetteError as error:
            self._error.set((f'{path.name}: ' if isinstance(error, WorkerFailed) else '') + one_line(error))
            self.dialog.open()
        else:
            if asked:
                self.dialog.close()
            self._on_opened()
        finally:
            self._busy.set_visibility(False)

    def _reject(self) -> None:
        self._error.set(f'upload: {TOO_LARGE}; open a larger file by its path')


def safe_name(name: str) -> str:
    """Return the last part of a file's name, without characters that mean something to a system."""
    plain = PurePosixPath(name.replace('\\', '/')).name
    kept = ''.join(letter if letter.isprintable() and letter not in '<>:"|?*' else '_' for letter in plain)
    return kept.encode()[-MOST_NAME:].decode(errors='ignore').lstrip('.') or 'upload'
