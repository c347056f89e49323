# SPDX-License-Identifier: Apache-2.0
"""The pictures: six curves, residual maps, residual against time; the model now or with the preview."""

from nicegui import ui

from rosette_ros.web.figures import NOW, THEN, Line, curves_figure, maps_figure, time_figure
from rosette_ros.web.widgets import button, card, marked, set_words
from rosette_ros.words import micro

PRESENT, PREVIEWED = 'model now', 'with preview'


class FiguresPanel:
    """Curves, maps and time series, made anew only where what they show has changed."""

    def __init__(self, desk, gallery, on_add, on_drop):
        """Build it; on_add(), on_drop(): take the preview into the model, or away."""
        self._desk, self._gallery = desk, gallery
        self._seen_preview = self._run = None
        self._preview(on_add, on_drop)
        with card('Six error motions, with U (k = 2)', 'curves') as self._curves_card:
            self._curves = gallery.picture(430, 'Six error motions against the table angle')
        with card('', 'maps') as self._maps_card:
            with ui.element('div').classes('row'):
                ui.html('Residuals: table position against ball', sanitize=False, tag='h2')
                self._whose = marked(ui.label('').classes('soft small'), 'maps-model')
            self._maps = gallery.picture(300, 'Residual maps, one per axis')
        with card('Residuals against time', 'times') as self._times_card:
            self._times = gallery.picture(320, 'Residuals in x, y, z against time')

    def _preview(self, on_add, on_drop):
        with card('', 'preview').classes('preview') as self._preview_card:
            with ui.element('div').classes('row'):
                self._title = ui.html('', sanitize=True, tag='h2')
                self._switch = ui.toggle([PRESENT, PREVIEWED], value=PRESENT, on_change=self.show)
                marked(self._switch.props('no-caps dense unelevated toggle-color=primary'), 'switch')
                button('Add', on_add, 'add', 'preview-add', strong=True, hint='Add it to the model (a)')
                button('Close preview', on_drop, 'close', 'preview-drop', hint='Leave the model as it is (Esc)')
            self._words = marked(ui.label('').props('role=status aria-live=polite'), 'preview-words')

    def show(self):
        """Show what is on the desk."""
        session = self._desk.session
        report, preview = session.found.report, session.preview
        if preview is not self._seen_preview:
            self._seen_preview = preview
            self._switch.set_value(PREVIEWED if preview else PRESENT)
        self._show_preview(preview)
        kept = session.current is not None and session.current is self._run and not session.found.problem
        if report is None and kept:
            return  # what is shown stays for the moment that it takes to fit the new model
        self._run = session.current
        for one in (self._curves_card, self._maps_card, self._times_card):
            one.set_visibility(report is not None)
        if report is None:
            return
        after = preview.change.after if preview else None
        whole = after if after is not None and self._switch.value == PREVIEWED else report
        set_words(self._whose, f'{PREVIEWED}: {preview.name}' if whole is not report else PRESENT)
        draw = self._gallery.draw
        draw(self._curves, (report, after), curves_figure, _lines(report, after))
        draw(self._maps, (whole, report), maps_figure, whole, report)
        draw(self._times, (whole,), time_figure, whole)

    def switch(self):
        """Show the maps of the other model, where a preview is on."""
        if self._desk.session.preview is not None:
            self._switch.set_value(PRESENT if self._switch.value == PREVIEWED else PREVIEWED)

    def _show_preview(self, preview):
        self._preview_card.set_visibility(preview is not None)
        if preview is None:
            return
        self._title.set_content(f'Preview: with {preview.name}')
        set_words(self._words, preview_words(preview.change))


def _lines(report, after):
    lines = [Line(PRESENT, report.error_motions, NOW)]
    if after is not None:
        lines.append(Line(PREVIEWED, after.error_motions, THEN, 'dot'))
    return lines


def preview_words(change):
    """Return in words what a Change does: errors, curves, and whether it helps."""
    fit = [one.fit.rms for one in (change.before, change.after)]
    shift = change.curve_change
    judged = 'It helps: readings left out of the fit are described better.' if change.helps else (
        'It makes readings left out worse.' if change.hurts else
        'It does not help: readings left out are described no better than before.')
    return (f'Residual {micro(fit[0])} → {micro(fit[1])} µm; readings left out {micro(change.held_out_before)} → '
            f'{micro(change.held_out_after)} µm; curves change by up to {micro(float(shift[:3].max()))} µm and '
            f'{micro(float(shift[3:].max()))} µrad. {judged}')
