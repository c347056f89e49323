# SPDX-License-Identifier: Apache-2.0
"""A term of one's own, with immediate feedback; and the check on a second run."""

from nicegui import ui

from rosette_ros.core.effects.expression import FUNCTIONS, NAMES
from rosette_ros.core.effects.own import DIRECTIONS, PER
from rosette_ros.core.errors import InvalidModel
from rosette_ros.web.desk import one_line
from rosette_ros.web.verdict_panel import pretty
from rosette_ros.web.widgets import button, card, marked, set_words
from rosette_ros.words import chance, fall


class OwnTermPanel:
    """Name, direction, expression, per; what is wrong is told while it is written."""

    def __init__(self, desk, on_preview, on_add):
        """Build it; on_preview(entry), on_add(entry): entry as in a model file."""
        self._desk = desk
        known = ', '.join(f'{name} ({words})' for name, (_, words) in NAMES.items())
        with card('', 'own-term') as self._card, \
                ui.expansion('A term of your own', value=False).props('dense') as self.box:
            with ui.element('div').classes('row'):
                self._name = self._input('name', 'own', 'own-name', 'width: 110px')
                self._direction = self._choice('direction', DIRECTIONS, 'z', 'own-direction')
                self._per = self._choice('one amplitude per', PER, 'all', 'own-per')
            self._expression = self._input('expression, e.g. t*cos(3*alpha)', '', 'own-expression', 'width: 100%')
            ui.label(f'Knows {known}; functions {", ".join(FUNCTIONS)}.').classes('soft small')
            with ui.element('div').classes('error small').props('role=alert') as self._error_box:
                ui.icon('error').props('aria-hidden=true')
                self._error = marked(ui.label(''), 'own-error')
            with ui.element('div').classes('row'):
                self._buttons = [
                    button('Preview', lambda: on_preview(self.entry), 'visibility', 'own-preview'),
                    button('Add', lambda: on_add(self.entry), 'add', 'own-add', strong=True)]
        self._check()

    def _input(self, words, value, mark, style):
        made = ui.input(words, value=value, on_change=lambda: self._check())
        return marked(made.props('dense outlined').style(style), mark)

    def _choice(self, words, values, value, mark):
        made = ui.select(list(values), label=words, value=value, on_change=lambda: self._check())
        return marked(made.props('dense outlined options-dense').style('min-width: 105px'), mark)

    @property
    def entry(self):
        """The term as it would stand in a model file."""
        return {'own': self._name.value, 'direction': self._direction.value,
                'expression': self._expression.value, 'per': self._per.value}

    def _check(self):
        """Tell what is wrong with what is written, in the words of all doors."""
        if not hasattr(self, '_buttons'):
            return
        words = '' if not self._expression.value else self._wrong()
        set_words(self._error, words)
        self._error_box.set_visibility(bool(words))
        for one in self._buttons:
            one.set_enabled(bool(self._expression.value) and not words)

    def _wrong(self):
        try:
            self._desk.session.model.with_entry(self.entry)
        except InvalidModel as error:
            return one_line(error)
        return ''

    def show(self):
        """Show what is on the desk."""
        self._card.set_visibility(self._desk.session.current is not None)
        self._check()


class CheckPanel:
    """Is what this run teaches true in another one?"""

    def __init__(self, desk, on_check):
        """Build it; on_check(key): check on the opened run of this key."""
        self._desk = desk
        self._shown = None
        self._offered = None
        with card('', 'check') as self._card, \
                ui.expansion('Check on a second run', value=False).props('dense'):
            self._note = ui.label('').classes('soft small')
            with ui.element('div').classes('row'):
                self._other = ui.select({}, label='second run')
                marked(self._other.props('dense outlined options-dense').style('min-width: 190px'), 'check-run')
                self._go = button('Check', lambda: self._other.value and on_check(self._other.value),
                                  'fact_check', 'check-go')
            self._result = marked(ui.element('div').props('role=status aria-live=polite'), 'check-result')

    def show(self):
        """Show what is on the desk."""
        session = self._desk.session
        self._card.set_visibility(session.current is not None)
        if session.current is None:
            return
        others = {one.key: one.name for one in session.runs if one is not session.current}
        if others != self._offered:
            self._offered = others
            value = self._other.value if self._other.value in others else next(iter(others), None)
            self._other.set_options(others, value=value)
        diagnosis = session.found.diagnosis
        claims = bool(diagnosis and diagnosis.terms)
        self._go.set_enabled(claims and bool(others))
        set_words(self._note, 'Open a second run of the same cell first.' if not others else (
            'What is claimed here is looked for there, where it had no part in being found.' if claims
            else 'Nothing is claimed of this run, so there is nothing to check.'))
        if self._desk.check is not self._shown:
            self._shown = self._desk.check
            self._fill(self._shown)

    def _fill(self, check):
        self._result.clear()
        if check is None:
            return
        name, done = check
        with self._result:
            ui.label(f'{name}: {pretty(done.text)}').classes('small')
            for one in done.effects:
                words = f'{one.name}: {one.outcome} ({one.reason})'
                if one.p == one.p:
                    words += (f'; chance of noise {chance(one.p)}, residual '
                              f'{fall(one.rms_without, one.rms_with)} µm')
                ui.label(words).classes('small')
