# SPDX-License-Identifier: Apache-2.0
"""Opening a run: by its path, from those that are near, or by upload."""

import tempfile
from dataclasses import replace
from pathlib import Path, PurePosixPath

from nicegui import ui

from rosette_ros.core.errors import RosetteError
from rosette_ros.report import open_source
from rosette_ros.web.desk import one_line
from rosette_ros.web.door import MOST_UPLOAD
from rosette_ros.web.widgets import button, marked, set_words

MOST_NAME = 120
"""Bytes of the longest name of a file; systems take 255."""


class OpenDialog:
    """The dialog in which a run is chosen; what is wrong with it is told there."""

    def __init__(self, desk, suggestions, folder, on_opened):
        """Build it; folder: where uploads are put; on_opened(): called once a run is on the desk."""
        self._desk, self._folder, self._on_opened = desk, folder, on_opened
        with ui.dialog() as self.dialog, ui.element('div').classes('card').style('width: 560px; max-width: 94vw'):
            ui.html('Open a run', sanitize=False, tag='h2')
            self._path = ui.input('path of a log directory, .mcap file or CSV table',
                                  autocomplete=list(suggestions))
            marked(self._path.props('dense outlined').on('keydown.enter', self._open_path), 'open-path')
            with ui.element('div').classes('row'):
                self._run_id = ui.input('run id, where a log holds several')
                marked(self._run_id.props('dense outlined').style('flex: 1 1 260px'), 'open-run-id')
                self._go = button('Open', self._open_path, 'folder_open', 'open-go', strong=True)
                self._busy = ui.spinner(size='22px')
            if suggestions:
                ui.label('Near at hand').classes('soft small')
                with ui.element('div').style('display: grid; max-height: 180px; overflow: auto'):
                    for path in suggestions[:30]:
                        made = button(path, lambda path=path: self.open(path), 'description')
                        made.props('align=left').style('width: 100%')
            ui.label(f'or upload one: an .mcap file or a CSV table of at most {MOST_UPLOAD >> 20} MB')
            self._upload = ui.upload(on_upload=self._take, on_rejected=self._reject, auto_upload=True,
                                     max_file_size=MOST_UPLOAD, label='Upload a file').classes('drop')
            marked(self._upload.props('flat bordered aria-label="Upload a file"'), 'upload')
            with ui.element('div').classes('error').props('role=alert') as self._error_box:
                ui.icon('error').props('aria-hidden=true')
                self._error = marked(ui.label(''), 'open-error')
            button('Close', self.dialog.close, 'close', 'open-close')
        self._say('')
        self._busy.set_visibility(False)

    def show(self):
        """Let a run be chosen."""
        self._say('')
        self.dialog.open()

    async def _open_path(self):
        if self._path.value.strip():
            await self.open(self._path.value.strip())

    async def open(self, path):
        """Open a path, or say what is wrong with it."""
        self._say('')
        self._busy.set_visibility(True)
        try:
            await self._desk.open(path, self._run_id.value.strip() or None)
        except RosetteError as error:
            self._say(one_line(error))
            self.dialog.open()
            return
        finally:
            self._busy.set_visibility(False)
        self.dialog.close()
        self._on_opened()

    async def _take(self, event):
        """Take an uploaded file: it is read as a run, and as nothing else."""
        self._say('')
        name = safe_name(event.file.name)
        folder = tempfile.mkdtemp(dir=self._folder)
        path = Path(folder, name)
        self._busy.set_visibility(True)
        try:
            await event.file.save(path)
            run, source = await self._desk.do_quick(read_upload, path)
        except RosetteError as error:
            self._say(one_line(error))
            return
        finally:
            path.unlink(missing_ok=True)
            Path(folder).rmdir()
            self._busy.set_visibility(False)
            self._upload.reset()
        self._desk.put(run, name, source)
        self.dialog.close()
        self._on_opened()

    def _reject(self):
        self._say(f'wanted one file of at most {MOST_UPLOAD >> 20} MB, got more; open a larger one by its path')

    def _say(self, words):
        set_words(self._error, words)
        self._error_box.set_visibility(bool(words))


def read_upload(path):
    """Return Run and Source of an uploaded file; both name the file as the person knows it."""
    try:
        run, source = open_source(path)
    except RosetteError as error:
        raise type(error)(str(error).replace(f'{path.parent}/', '')) from None
    files = tuple(replace(one, path=path.name) for one in source.files)
    return run.replace(source=path.name), replace(source, path=path.name, files=files)


def safe_name(name):
    """Return the last part of a file's name, with nothing in it that means something to a system."""
    plain = PurePosixPath(name.replace('\\', '/')).name
    kept = ''.join(letter if letter.isprintable() and letter not in '<>:"|?*' else '_' for letter in plain)
    return kept.encode()[-MOST_NAME:].decode(errors='ignore').lstrip('.') or 'upload'
