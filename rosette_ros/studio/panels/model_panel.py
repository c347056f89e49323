# SPDX-License-Identifier: Apache-2.0
"""The model: its parts, its errors, the ladder, undo and redo; and custom terms."""

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from itertools import zip_longest

from nicegui import ui

from rosette_ros.analysis import LadderStep
from rosette_ros.core.effects.custom import AMPLITUDE, DIRECTIONS, FUNCTIONS, NAMES, PER
from rosette_ros.core.run.errors import InvalidModel, one_line
from rosette_ros.core.run.number_words import UNKNOWN
from rosette_ros.presentation import tables
from rosette_ros.presentation.formatting import CROSS_VALIDATION, micro
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.widgets import button, card, input_field, marked, row
from rosette_ros.studio.studio_session import OpenedRun

Entry = dict[str, str]
"""A custom term as in a model file."""


class ModelPanel:
    """Parts that can be removed, three numbers, and the error ladder."""

    def __init__(self, controller: Controller, act: Callable[..., None]) -> None:
        """Build it; act(method, *arguments): calls a method of the session."""
        self._session, self._act = controller.session, act
        with card('Model and its error', 'model'):
            with ui.element('div').classes('numbers'):
                self._fit = self._number('residual', 'rms-fit')
                self._cross_validation = self._number(CROSS_VALIDATION, 'rms-cross-validation')
                self._noise = self._number('repeatability', 'rms-noise')
            self._parts = widgets.Area(ui.element('div').props('role=list aria-label="Parts of the model"'))
            with row():
                self._undo = button('Undo', lambda: act(self._session.undo), 'undo', 'undo', hint='Undo (u)')
                self._redo = button('Redo', lambda: act(self._session.redo), 'redo', 'redo', hint='Redo (r)')
                self._last = ui.label('').classes('soft small')
            self._ladder = widgets.Area(marked(ui.element('div').classes('small'), 'ladder'))

    def _number(self, words: str, mark: str) -> ui.label:
        with ui.element('div'):
            ui.label(words).classes('soft small')
            with ui.element('div').classes('value'):
                made = marked(ui.label(UNKNOWN).style('display: inline'), mark)
                ui.html(' µm', sanitize=False, tag='small')
        return made

    def show(self, opened: OpenedRun) -> None:
        """Show the model."""
        session, results, noise = self._session, self._session.results, opened.run.repeatability
        self._fit.set_text(micro(results.fit.rms) if results.fit else UNKNOWN)
        self._cross_validation.set_text(micro(results.ladder[-1].cross_validation) if results.ladder else UNKNOWN)
        self._noise.set_text(micro(noise) if noise else 'not known')
        fitted = results.fit.effects if results.fit else ()
        sizes = ('',) * len(session.model.base) + tuple(
            tables.size_words(one.name, one.parameters, one.setting, opened.run) for one in fitted)
        self._parts.show(self._show_parts, session.model_parts, sizes)
        self._undo.set_enabled(bool(session.undo_words))
        self._redo.set_enabled(bool(session.redo_words))
        self._last.set_text(f'last: {session.undo_words}' if session.undo_words else '')
        ladder = results.summary.ladder if results.summary else results.ladder
        self._ladder.show(_show_ladder, ladder, len(session.model.terms) + 1)

    def _show_parts(self, names: Sequence[str], sizes: Sequence[str]) -> None:
        for place, (name, size) in enumerate(zip_longest(names, sizes, fillvalue='')):
            with marked(ui.element('div').classes('part').props('role=listitem'), f'part-{name}'):
                with ui.element('div').classes('grow'):
                    widgets.named(name)
                    marked(ui.label(size).classes('small'), f'size-{name}')
                button('', partial(self._act, self._session.remove, place), 'close', f'remove-{name}',
                       hint=f'Remove {name} from the model').props('round size=sm')


def _show_ladder(ladder: Sequence[LadderStep] | None, present: int) -> None:
    """Show the error of each model from the base on; those beyond `present` are proposed."""
    if ladder:
        icons = ['check' if place < present else 'question_mark' for place in range(len(ladder))]
        widgets.plain_table(tables.nested_models(ladder).select('model', 'rms_um', 'held_out_rms_um'), icons)


class CustomTermPanel:
    """Name, direction, expression and amplitudes of a custom term; errors are shown while it is written."""

    def __init__(self, controller: Controller, on_preview: Callable[[Entry], Awaitable[None]],
                 on_add: Callable[[Entry], None]) -> None:
        self._session = controller.session
        known = ', '.join(f'{name} ({words})' for name, (_, words) in NAMES.items())
        with widgets.folded_card('Custom term', 'custom-term'):
            with row():
                self._name = input_field(ui.input('name', value='own'), 'custom-name', 'width: 70px')
                self._direction = input_field(ui.select(list(DIRECTIONS), label='direction', value='z'),
                                              'custom-direction', 'min-width: 98px')
                self._per = input_field(ui.select(list(PER), label='amplitude per', value='all'), 'custom-per',
                                        'min-width: 136px')
            self._expression = input_field(ui.input('expression, e.g. t*cos(3*alpha)'), 'custom-expression',
                                           'width: 100%')
            ui.label(f'Names: {known}; functions: {", ".join(FUNCTIONS)}. {AMPLITUDE}').classes('soft small')
            self._error = widgets.ErrorLine('custom-error')
            with row():
                self._buttons = (
                    button('Preview', lambda: on_preview(self.entry), 'visibility', 'custom-preview'),
                    button('Add', lambda: on_add(self.entry), 'add', 'custom-add', strong=True))
        for one in (self._name, self._direction, self._per, self._expression):
            one.on_value_change(self._check)
        self._check()

    @property
    def entry(self) -> Entry:
        """The term as in a model file."""
        return {'own': self._name.value, 'direction': self._direction.value, 'expression': self._expression.value,
                'per': self._per.value}

    def _check(self) -> None:
        words = ''
        try:
            if self._expression.value:
                self._session.model.with_entry(self.entry)
        except InvalidModel as error:
            words = one_line(error)
        self._error.set(words)
        for one in self._buttons:
            one.set_enabled(bool(self._expression.value) and not words)

    def show(self, _: OpenedRun) -> None:
        """Check the term with the model as it is."""
        self._check()
