# SPDX-License-Identifier: Apache-2.0
"""The correction of the table by the result that is shown: which errors, for what, what would be left; then the file.
"""

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from rosette_ros.api.correction_targets import ROS, STEPS, correction_file, is_controller
from rosette_ros.api.evaluating import Corrected
from rosette_ros.core.run.errors import RosetteError, one_line
from rosette_ros.core.run.records import CURVES
from rosette_ros.io.controller_tables import Axis
from rosette_ros.presentation.correction_results import correction_table
from rosette_ros.presentation.plots.plot_style import AFTER, BEFORE
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import Curves, curves_figure
from rosette_ros.studio.panels.figures_panel import WIDTH
from rosette_ros.studio.panels.widgets import Area, ErrorLine, Figure, button, input_field, marked, plain_table, row

TARGETS = {ROS: 'ROS (YAML)', 'csv': 'table (CSV)', 'linuxcnc': 'LinuxCNC', 'sinumerik-enc': 'SINUMERIK ENC',
           'sinumerik-cec': 'SINUMERIK CEC', 'heidenhain': 'HEIDENHAIN', 'fanuc': 'FANUC'}
SENSES = {1: 'counter-clockwise from above', -1: 'clockwise from above (C′)'}
ENDINGS = {ROS: 'yaml', 'csv': 'csv', 'linuxcnc': 'comp', 'heidenhain': 'com'}
"""Of the names of the files; the others are read under any name."""
SHOWN_LINES = 12
"""Lines of a file that are shown."""


class CorrectionDialog:
    """What is chosen is shown at once: what is corrected, what would be left, the first lines of the file."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._text = ''
        with ui.dialog() as self.dialog, ui.element('div').classes('card').style('width: 860px; max-width: 94vw'):
            ui.html('Correction of the table', sanitize=False, tag='h2')
            with row():
                self._target = input_field(ui.select(TARGETS, label='for', value=ROS, on_change=self._choose),
                                           'correction-target', 'width: 190px')
                self._curves = input_field(ui.select(list(CURVES), label='error motions', value=list(CURVES),
                                                     multiple=True, on_change=self._show), 'correction-curves',
                                           'min-width: 240px')
                self._step = input_field(ui.number('lines every, °', on_change=self._show).props('debounce=400'),
                                         'correction-step', 'width: 130px')
            with row() as self._axis:
                self._name = input_field(ui.input('axis', value='C', on_change=self._show), 'correction-axis',
                                         'width: 70px')
                self._sense = input_field(ui.select(SENSES, label='counts', value=1, on_change=self._show),
                                          'correction-sense', 'width: 230px')
                self._zero = input_field(ui.number('at table angle 0, °', value=0.0, on_change=self._show).props(
                    'debounce=400'), 'correction-zero', 'width: 150px')
            self._error = ErrorLine('correction-error')
            with row():
                self._save = button('Save', self._download, 'save', 'correction-save', strong=True)
                button('Close', self.dialog.close, 'close', 'correction-close')
            self._words = Area(marked(ui.element('div').classes('list small').props('role=status aria-live=polite'),
                                      'correction-preview'))
            ui.label('Error motions as they are, and what would be left').classes('title')
            self._figure = Figure(430, 'Error motions as they are, and with the correction', 'correction-figure', WIDTH)

    def open(self) -> None:
        """Show the correction by the result that is shown."""
        self.dialog.open()
        self._show()

    def _choose(self, event: ValueChangeEventArguments) -> None:
        self._curves.set_value(['crz'] if is_controller(event.value) else list(CURVES))
        self._show()

    def _show(self) -> None:
        if not self.dialog.value:
            return
        target, curves = str(self._target.value), [one for one in CURVES if one in self._curves.value]
        self._step.set_visibility(target in STEPS)
        self._axis.set_visibility(is_controller(target))
        self._error.set('')
        self._text = ''
        try:
            made = self._controller.corrected(curves)
            if made is not None:
                axis = Axis(self._name.value.strip() or 'C', self._sense.value, self._zero.value or 0.0)
                self._text, notes = correction_file(made.correction, target, made.serial, self._step.value or 0.0,
                                                    axis=axis)
                self._words.show(_fill, made, notes, self._text)
                self._draw(made)
        except RosetteError as error:
            self._error.set(one_line(error))
        self._save.set_enabled(bool(self._text))

    def _draw(self, made: Corrected) -> None:
        """Draw the curves, and what the correction leaves of them."""
        now, left = made.correction.forward, made.correction.left
        self._figure.draw((now, made.correction.corrected), curves_figure, [
            Curves('as they are', now, BEFORE), Curves('with the correction', left, AFTER, 'dot')])

    def _download(self) -> None:
        current, target = self._controller.session.current, str(self._target.value)
        if current is not None and self._text:
            name = f'{current.run.run_id or "run"}-correction.{ENDINGS.get(target, "ini")}'
            ui.download.content(self._text, name, 'text/plain')


def _fill(made: Corrected, notes: tuple[str, ...], text: str) -> None:
    if made.which:
        ui.label(f'Curves: {made.which}.')
    plain_table(correction_table(made.correction))
    for words in notes:
        ui.label(words)
    lines = text.splitlines()
    more = f'\n… {len(lines) - SHOWN_LINES} more lines' if len(lines) > SHOWN_LINES else ''
    shown = '\n'.join(lines[:SHOWN_LINES]) + more
    marked(ui.label(shown).classes('file'), 'correction-text')
