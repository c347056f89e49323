# SPDX-License-Identifier: Apache-2.0
"""What the model may lack: candidates of the diagnosis, and every other effect of the library."""

from nicegui import ui

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.web.widgets import button, card, marked, set_words
from rosette_ros.words import MEANINGS, chance, fall, setting_words, shown_parameter

NEXT_BEST = 5
"""So many candidates that are not claimed are listed."""
MOST_PARAMETERS = 3


class CandidatesPanel:
    """The list of candidates; one can be chosen, previewed and added."""

    def __init__(self, desk, on_preview, on_add):
        """Build it; on_preview(name, setting), on_add(name, setting): what the buttons do."""
        self._desk, self._on_preview, self._on_add = desk, on_preview, on_add
        self._diagnosis = None
        self._rows = {}
        with card('What may be missing', 'candidates') as self._card:
            self._note = marked(ui.label('').classes('soft small'), 'candidates-note')
            self._list = ui.element('div').style('display: grid; gap: 8px')
            with ui.expansion('Another effect of the library', value=False).props('dense').classes('small'):
                names = {name: name for name in sorted(EFFECTS)}
                self._other = ui.select(names, label='effect', with_input=True, on_change=self._explain)
                marked(self._other.props('dense outlined options-dense').style('width: 100%'), 'other-effect')
                self._meaning = ui.label('').classes('soft small')
                with ui.element('div').classes('row'):
                    button('Preview', lambda: self._other.value and on_preview(self._other.value, None),
                           'visibility', 'other-preview')
                    button('Add', lambda: self._other.value and on_add(self._other.value, None), 'add', 'other-add')

    def _explain(self):
        effect = EFFECTS.get(self._other.value)
        set_words(self._meaning, f'{effect.meaning} Look at: {effect.look}' if effect else '')

    def show(self):
        """Show what is on the desk."""
        session = self._desk.session
        self._card.set_visibility(session.current is not None)
        diagnosis = session.found.diagnosis
        if diagnosis is not self._diagnosis:
            self._diagnosis = diagnosis
            self._fill(diagnosis)
        words = '' if diagnosis else ('Not looked for yet.' if not self._desk.step else 'Looking …')
        if diagnosis and not any(one.claimed for one in diagnosis.candidates):
            words = 'Nothing is claimed.'
        set_words(self._note, words)
        self._note.set_visibility(bool(words))
        chosen = session.preview.name if session.preview else ''
        for name, row in self._rows.items():
            row.classes(add='chosen' if name == chosen else '', remove='' if name == chosen else 'chosen')

    def _fill(self, diagnosis):
        self._list.clear()
        self._rows = {}
        if diagnosis is None:
            return
        claimed = [one for one in diagnosis.candidates if one.claimed]
        others = [one for one in diagnosis.candidates if not one.claimed][:NEXT_BEST]
        with self._list:
            for one in claimed:
                if one.effect not in self._rows:
                    self._rows[one.effect] = self._row(one)
            if others:
                with ui.expansion('Not claimed: the next best').props('dense').classes('small'), \
                        ui.element('div').style('display: grid; gap: 8px'):
                    for one in others:
                        if one.effect not in self._rows:
                            self._rows[one.effect] = self._row(one)
            if diagnosis.invisible:
                ui.label(f'This order of measurement cannot show: {", ".join(diagnosis.invisible)}.').classes('small')

    def _row(self, one):
        setting = dict(one.setting) or None
        with marked(ui.element('article').classes('candidate'), f'candidate-{one.effect}') as row:
            if one.claimed:
                row.classes('claimed')
            with ui.element('div').classes('row'):
                ui.label(one.effect).classes('name')
                with ui.element('span').classes('badge' if one.claimed else 'badge soft'):
                    ui.icon('error' if one.claimed else 'radio_button_unchecked').props('aria-hidden=true')
                    ui.label('missing' if one.claimed else 'not claimed')
            if one.effect in MEANINGS:
                ui.label(MEANINGS[one.effect].meaning).classes('small')
            with ui.element('div').classes('facts'):
                for name, words in facts(one):
                    ui.label(name)
                    ui.label(words)
            with ui.element('div').classes('row'):
                button('Preview', lambda: self._on_preview(one.effect, setting), 'visibility',
                       f'preview-{one.effect}', hint=f'Show what adding {one.effect} would do')
                button('Add', lambda: self._on_add(one.effect, setting), 'add', f'add-{one.effect}',
                       strong=one.claimed, hint=f'Add {one.effect} to the model')
        return row


def facts(one):
    """Return (name, words) of a candidate: probability, errors; of one that is claimed all that is known."""
    lines = [('chance of noise', chance(one.p)), ('residual / µm', fall(one.rms_before, one.rms_after))]
    if not one.claimed:
        return lines
    lines.append(('left out / µm', fall(one.held_out_before, one.held_out_after)))
    if one.parameters:
        shown = sorted(one.parameters, key=lambda p: -abs(p.value / p.u) if p.u else 0)[:MOST_PARAMETERS]
        lines.append(('size, U (k=2)', '; '.join(
            f'{p.name} {" ".join(part for part in shown_parameter(p) if part)}' for p in shown)))
    if one.setting:
        at = setting_words(one.effect, one.setting, [p.name for p in one.parameters])
        if at:
            lines.append(('found at', at))
    lines.append(('looks like', ', '.join(one.look_alikes) or 'nothing else'))
    return lines
