# SPDX-License-Identifier: Apache-2.0
"""The figures: six curves, residual maps, residual against time; of the model as it is or with the preview."""

from collections.abc import Callable

from nicegui import ui

from rosette_ros.analysis import Change, RunResult, Which
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import RosetteError
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.uncertainty.error_summary import fit_lines
from rosette_ros.presentation import tables
from rosette_ros.presentation.error_results import change_errors, curve_changes, errors, errors_of
from rosette_ros.presentation.identity_words import NOTHING, identity_rows
from rosette_ros.presentation.plots.plot_style import AFTER, BEFORE
from rosette_ros.presentation.plots.result_plots import deviations, polar_motions
from rosette_ros.presentation.report.provenance import Source
from rosette_ros.studio import figures
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.widgets import Area, Figure, button, card, marked, plain_table, row
from rosette_ros.studio.studio_session import OpenedRun, Preview
from rosette_ros.words.effect_words import words_of

PREVIEWED = 'with preview'
NOW = str(Which.MODELLED)
WIDTH = 720
"""Least width of figures with three panels side by side, px."""


class FiguresPanel:
    """Curves, maps and time series; drawn again only where what they show has changed."""

    def __init__(self, controller: Controller, on_add: Callable[[], None], on_drop: Callable[[], None]) -> None:
        """Build it; on_add, on_drop: add the preview to the model, or close it."""
        self._controller = controller
        self._run: OpenedRun | None = None
        with card('', 'preview').classes('preview') as self._preview_card:
            with row():
                self._busy = marked(ui.spinner(size='22px').props('aria-label="Calculating"'), 'preview-busy')
                self._title = marked(ui.label('').props('role=heading aria-level=2').classes('title'), 'preview-title')
                self._switch = ui.toggle([NOW, PREVIEWED], value=NOW, on_change=self._draw)
                marked(self._switch.props('no-caps dense unelevated toggle-color=primary'), 'switch')
                self._add = button('Add', on_add, 'add', 'preview-add', strong=True, hint='Add it to the model (a)')
                button('Close preview', on_drop, 'close', 'preview-drop', hint='Leave the model as it is (Esc)')
            self._words = marked(ui.label('').props('role=status aria-live=polite'), 'preview-words')
            with ui.expansion('Change of the curves', value=False).props('dense').classes('small'):
                self._changes = Area(ui.element('div'))
        with card('Six error motions, with U (k = 2)', 'curves') as self._curves_card:
            self._errors = Area(marked(ui.element('div').classes('small'), 'errors'))
            self._curves = Figure(430, 'Six error motions against the table angle', 'curves-figure', WIDTH)
            with ui.expansion('Radial and tilt motion, polar', value=True).props('dense').classes('small'):
                self._polar = Figure(0, 'Polar plots of radial and tilt motion', 'polar-figure')
            with ui.expansion('Ball plate and CMM', value=False).props('dense').classes('small'):
                self._plate = Figure(0, 'Deviations of the balls of the plate and of the CMM', 'plate-figure')
            with ui.expansion('Who, what, where', value=False).props('dense').classes('small'):
                self._identity = Area(marked(ui.element('div').classes('facts'), 'identity'))
        with card('', 'maps') as self._maps_card:
            with row():
                ui.html('Residuals by table position and ball', sanitize=False, tag='h2')
                self._whose = marked(ui.label('').classes('soft small'), 'maps-model')
            self._maps = Figure(300, 'Residual maps, one per axis', 'maps-figure', least=WIDTH)
            with row():
                self._reading = ui.number('reading', value=None, format='%d', on_change=self._draw)
                self._reading.props('clearable hide-bottom-space debounce=400')
                widgets.input_field(self._reading, 'reading', 'width: 150px')
                ui.label('Click a reading in the maps or against time, or enter its number: it is marked in all '
                         'figures.').classes('soft small')
            self._facts = Area(marked(ui.element('div').classes('small'), 'reading-facts'))
        with card('Residuals against time', 'times') as self._times_card:
            self._times = Figure(340, 'Residuals in x, y, z against time', 'times-figure')
        self._maps.on_click(self._choose_in_map)
        self._times.on_click(self._choose_in_time)

    def show(self, opened: OpenedRun) -> None:
        """Show the figures."""
        session = self._controller.session
        fit, preview = session.results.fit, session.preview
        busy = self._controller.previewing
        self._changes.show(self._show_preview, preview)
        self._preview_card.set_visibility(bool(preview or busy))
        self._busy.set_visibility(bool(busy))
        self._words.set_visibility(not busy)
        self._switch.set_enabled(preview is not None)
        self._add.set_enabled(preview is not None and not busy)
        names = (busy or (preview.name if preview else '')).split(' and ')
        self._title.set_text(f'{"Calculating" if busy else "Preview"}: with {" and ".join(map(words_of, names))}')
        is_failed = session.results.refusal is not None or bool(session.results.problem)
        if fit is None and opened is self._run and not is_failed:
            return  # the figures stay for the moment that it takes to fit the new model
        self._run = opened
        for one in (self._curves_card, self._maps_card, self._times_card):
            one.set_visibility(fit is not None)
        self._draw()

    def _draw(self) -> None:
        fit, preview = self._controller.session.results.fit, self._controller.session.preview
        result = self._controller.session.results.result
        if fit is None or result is None:
            return
        after, shown = preview.change.after if preview else None, self._shown or fit
        self._whose.set_text(f'{PREVIEWED}: {preview.name}' if preview and shown is after else NOW)
        self._errors.show(_show_errors, shown, result if shown is fit else None, self._run)
        self._identity.show(_show_identity, self._run)
        main = result.curves if after is None else result.modelled
        if after is not None:
            curves = [figures.Curves(NOW, main.motions, BEFORE),
                      figures.Curves(PREVIEWED, after.error_motions, AFTER, 'dot')]
        else:
            curves = [figures.Curves(main.which, main.motions, AFTER)]
            curves += [figures.Curves(one.which, one.motions, BEFORE, 'dot') for one in [result.beside] if one]
        chosen, run = self._chosen(shown), shown.run
        angle = None if chosen is None else float(run.table_angle[chosen] + run.table_offset)
        self._curves.draw((main, after, angle), figures.curves_figure, curves, angle)
        self._polar.draw((shown, main), polar_motions, main.motions if shown is fit else shown.error_motions)
        self._plate.draw((shown,), deviations, shown.plate, shown.cmm, run.radius)
        self._maps.draw((shown, fit, chosen), figures.maps_figure, shown, fit, chosen)
        self._times.draw((shown, after, chosen), figures.time_figure, shown,
                         AFTER if after is None or shown is after else BEFORE, chosen)
        self._facts.show(_show_reading, shown, chosen)

    @property
    def _shown(self) -> Fit | None:
        """The fit of maps and time series."""
        fit, preview = self._controller.session.results.fit, self._controller.session.preview
        return preview.change.after if preview and self._switch.value == PREVIEWED else fit

    def _chosen(self, fit: Fit) -> int | None:
        """Return the index of the chosen reading."""
        number = self._reading.value
        return int(number) - 1 if number is not None and 1 <= number <= fit.run.size else None

    def _choose_in_map(self, axis: int, point: list[int]) -> None:
        if (fit := self._shown) is not None and len(point) == 2:
            found = figures.reading_in_map(fit, axis, *point)
            self._reading.set_value(None if found is None else found + 1)

    def _choose_in_time(self, axis: int, point: list[int]) -> None:
        if (fit := self._shown) is not None:
            self._reading.set_value(figures.reading_in_time(fit, axis, point[0]) + 1)

    def switch(self) -> None:
        """Show the maps of the other model, where there is a preview."""
        if self._controller.session.preview is not None:
            self._switch.set_value(NOW if self._switch.value == PREVIEWED else PREVIEWED)

    def _show_preview(self, preview: Preview | None) -> None:
        self._switch.set_value(PREVIEWED if preview else NOW)
        if preview is not None:
            self._words.set_text(preview_words(preview.change))
            plain_table(curve_changes(preview.change))


def preview_words(change: Change) -> str:
    """Return what a Change does to the residual, and whether it helps."""
    rows = change_errors(change).select('quantity', 'before', 'after', 'unit').rows
    errors = '; '.join(f'{quantity} {before} → {after} {unit}'.strip() for quantity, before, after, unit in rows)
    judged = 'It helps' if change.helps else 'It makes the residual larger' if change.hurts else 'It does not help'
    return f'{judged}: {errors}.'


def _show_errors(fit: Fit, result: RunResult | None, opened: OpenedRun | None) -> None:
    """Show the errors of a result, or those of the fit of a preview, which decides no tolerance."""
    limits, words = dict[str, Tolerance](), ''
    try:
        limits = _source(opened).identity.limits(fit.run.rotation)
    except RosetteError as error:
        words = f'{error}. '
    every = errors_of(result, limits) if result else (errors(fit_lines(fit)),)
    for one in every:
        if len(every) > 1:
            ui.label(one.title).classes('soft')
        plain_table(one)
    ui.label(f'{words}{every[0].note}').classes('soft')


def _show_reading(fit: Fit, chosen: int | None) -> None:
    if chosen is not None:
        plain_table(tables.reading(fit, chosen))


def _show_identity(opened: OpenedRun | None) -> None:
    source = _source(opened)
    for name, words in identity_rows(source.identity, source.contradictions) or [('', NOTHING)]:
        ui.label(name).classes('soft')
        ui.label(words)


def _source(opened: OpenedRun | None) -> Source:
    return opened.source if opened and opened.source else Source('', ())
