# SPDX-License-Identifier: Apache-2.0
"""The model: its parts, its errors, the ladder, undo and redo."""

from nicegui import ui

from rosette_ros.web.figures import ladder_figure
from rosette_ros.web.widgets import button, card, marked, set_words
from rosette_ros.words import micro


class ModelPanel:
    """Parts that can be removed, three numbers, and the error ladder."""

    def __init__(self, desk, gallery, act):
        """Build it; act(name, *arguments): what the session shall do."""
        self._desk, self._gallery, self._act = desk, gallery, act
        self._parts_shown = None
        with card('Model and its error', 'model') as self._card:
            with ui.element('div').classes('numbers'):
                self._fit = self._number('residual, fit', 'rms-fit')
                self._held = self._number('readings left out', 'rms-held')
                self._noise = self._number('noise', 'rms-noise')
            with ui.element('div').classes('row').props('role=list aria-label="Parts of the model"') as self._parts:
                pass
            with ui.element('div').classes('row'):
                self._undo = button('Undo', lambda: act('undo'), 'undo', 'undo', hint='Undo (u)')
                self._redo = button('Redo', lambda: act('redo'), 'redo', 'redo', hint='Redo (r)')
                self._last = ui.label('').classes('soft small')
            with ui.element('div') as self._ladder_box:
                self._ladder = gallery.picture(210, 'Error of each model, from the base model on')

    def _number(self, words, mark):
        with ui.element('div'):
            ui.label(words).classes('soft small')
            with ui.element('div').classes('value'):
                made = marked(ui.label('–').style('display: inline'), mark)
                ui.html(' µm', sanitize=False, tag='small')
        return made

    def show(self):
        """Show what is on the desk."""
        session = self._desk.session
        self._card.set_visibility(session.current is not None)
        if session.current is None:
            return
        found = session.found
        rungs = found.rungs or found.own_rungs
        report, noise = found.report, session.current.run.repeatability
        set_words(self._fit, micro(report.fit.rms) if report else '–')
        own = found.own_rungs
        set_words(self._held, micro(own[-1].held_out) if own else '–')
        set_words(self._noise, micro(noise) if noise else 'not known')
        self._show_parts(session)
        self._undo.set_enabled(bool(session.undo_words))
        self._redo.set_enabled(bool(session.redo_words))
        set_words(self._last, f'last: {session.undo_words}' if session.undo_words else '')
        self._ladder_box.set_visibility(bool(rungs))
        if rungs:
            present = len(session.model.terms) + 1
            self._gallery.draw(self._ladder, (rungs,), ladder_figure, rungs, present, noise)

    def _show_parts(self, session):
        parts = session.model_parts
        if parts == self._parts_shown:
            return
        self._parts_shown = parts
        self._parts.clear()
        with self._parts:
            for place, name in enumerate(parts):
                self._part(place, name)

    def _part(self, place, name):
        with marked(ui.element('div').classes('part').props('role=listitem'), f'part-{name}'):
            ui.label(name)
            button('', lambda: self._act('remove', place), 'close', f'remove-{name}',
                   hint=f'Remove {name} from the model').props('round size=sm')
