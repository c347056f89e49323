# SPDX-License-Identifier: Apache-2.0
"""What a person reads first: how it stands, one sentence, what to do."""

from nicegui import ui

from rosette_ros.story import BAD
from rosette_ros.web.desk import SECONDS_PER_READING, STEPS, WORDS
from rosette_ros.web.widgets import LEVELS, button, marked, set_words
from rosette_ros.words import MEANINGS, duration, micro


class VerdictPanel:
    """The banner: level by icon, word and colour; sentence; action; what is being worked on."""

    def __init__(self, desk, on_preview, on_diagnose):
        """Build it; on_preview(candidate), on_diagnose(): what its buttons do."""
        self._desk = desk
        self.first = None
        self._box = marked(ui.element('section').classes('verdict').props('aria-label="Verdict"'), 'verdict')
        with self._box:
            self._icon = ui.icon('hourglass_empty').props('aria-hidden=true')
            with ui.element('div').classes('text').props('role=status aria-live=polite'):
                self._level = marked(ui.label('').classes('level'), 'verdict-level')
                self._sentence = marked(ui.label('').classes('sentence'), 'verdict-sentence')
                self._action = marked(ui.label('').classes('action'), 'verdict-action')
                self._meaning = marked(ui.label('').classes('small'), 'verdict-meaning')
                with ui.element('div').classes('progress small') as self._progress:
                    ui.spinner(size='18px').props('aria-hidden=true')
                    self._step = marked(ui.label(''), 'step')
            self._try = button('', lambda: on_preview(self.first), 'visibility', 'verdict-preview', strong=True)
            self._ask = button('Diagnose', on_diagnose, 'search', 'diagnose', strong=True)

    def show(self):
        """Show what is on the desk."""
        desk, session = self._desk, self._desk.session
        self._box.set_visibility(session.current is not None)
        if session.current is None:
            return
        found, verdict = session.found, session.verdict
        if found.problem:
            self._say('error', 'It does not work', found.problem, 'Undo, or remove what was added.', BAD)
        elif verdict:
            icon, word = LEVELS[verdict.level]
            self._say(icon, word, pretty(verdict.sentence), pretty(verdict.action), verdict.level)
        elif found.report is not None:
            self._say('hourglass_empty', 'Not judged yet', f'The residual is {micro(found.report.fit.rms)} µm.',
                      '', '')
        else:
            self._say('hourglass_empty', 'Not judged yet', '', '', '')
        self._show_progress(desk.step)
        waits = session.is_large and not (desk.step or verdict or found.problem)
        self._ask.set_visibility(waits)
        if waits:
            size = session.current.run.size
            set_words(self._action, f'The run has {size:,} readings: the diagnosis takes about '
                      f'{duration(size * SECONDS_PER_READING)}, so it waits until you ask for it.')
        self._show_first(found.diagnosis)

    def _say(self, icon, word, sentence, action, level):
        self._icon.set_name(icon)
        for label, words in ((self._level, word), (self._sentence, sentence), (self._action, action)):
            set_words(label, words)
            label.set_visibility(bool(words) or label is not self._sentence)
        self._box.classes(remove='good doubtful bad', add=level)

    def _show_progress(self, step):
        self._progress.set_visibility(bool(step))
        if step:
            set_words(self._step, f'step {STEPS.index(step) + 1} of {len(STEPS)}: {WORDS[step]} …')

    def _show_first(self, diagnosis):
        claimed = [one for one in diagnosis.candidates if one.claimed] if diagnosis else []
        self.first = claimed[0] if claimed else None
        self._try.set_visibility(bool(claimed) and self._desk.session.preview is None)
        meant = MEANINGS.get(claimed[0].effect) if claimed else None
        set_words(self._meaning, f'{meant.name}: {meant.meaning} Look at: {meant.look}' if meant else '')
        self._meaning.set_visibility(meant is not None)
        if claimed:
            self._try.set_text(f'Preview {claimed[0].effect}')


def pretty(words):
    """Return a sentence of the core with the sign for micro."""
    return words.replace(' um', ' µm')
