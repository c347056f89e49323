# SPDX-License-Identifier: Apache-2.0
"""The results of the diagnosis: the verdict, the candidates that the model may lack, and the check on a second run."""

from collections.abc import Awaitable, Callable, Sequence

from nicegui import ui

from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.recovered_shape import Shape
from rosette_ros.core.diagnosis.second_run import CrossCheck
from rosette_ros.core.diagnosis.verdict import Level, Verdict
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.records import Run
from rosette_ros.presentation import tables
from rosette_ros.presentation.explanation_results import causes
from rosette_ros.presentation.formatting import duration, glued, micro
from rosette_ros.presentation.identity_words import SIMULATED
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import shape_figure, shape_height
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.widgets import button, card, marked, row
from rosette_ros.studio.studio_session import OpenedRun
from rosette_ros.words.effect_words import MEANINGS, words_of
from rosette_ros.words.motion_words import titles
from rosette_ros.words.result_words import check_words, reason_words
from rosette_ros.words.verdict_words import HEADLINES, verdict_text

Action = Callable[[str, Setting | None], Awaitable[None] | None]
"""Takes the name of an effect and its setting."""
ICONS = {'': 'hourglass_empty', Level.GOOD: 'check_circle', Level.DOUBTFUL: 'help', Level.BAD: 'error'}
STEPS = {'evaluate': 'fitting the model', 'compare': 'comparing model and readings',
         'diagnose': 'searching for missing effects', 'ladder': 'adding the effects found, one by one',
         'advise': 'comparing orders for the next run'}
SECONDS_PER_READING = 0.004
"""Time that a diagnosis takes for each reading, roughly."""
NEXT_BEST = 5
"""So many candidates that are not claimed are listed."""
OF_OTHERS = ('p', 'rms_before_um', 'rms_after_um')
OF_CLAIMED = (*OF_OTHERS, 'size', 'look_alikes')
OF_CHECKED = ('effect', 'outcome', 'p', 'rms_before_um', 'rms_after_um', 'same_size')
"""Columns of the tables that are shown."""


def apply(action: Action, candidate: MissingEffect | None) -> Awaitable[None] | None:
    """Call an action with a candidate and the setting found for it."""
    return action(candidate.name, candidate.setting or None) if candidate else None


class VerdictPanel:
    """The banner: outcome by icon, words and colour; sentence; action; the calculation that is running."""

    def __init__(self, controller: Controller, on_preview: Callable[[], Awaitable[None]], on_add: Callable[[], None],
                 on_diagnose: Callable[[], None], on_settle: Callable[[], Awaitable[None]]) -> None:
        """Build it; on_preview(), on_add(): take all missing effects together; on_settle(): choose the readings that
        settle what is in doubt."""
        self._controller = controller
        self._box = marked(ui.element('section').classes('verdict').props('aria-label="Verdict"'), 'verdict')
        with self._box:
            self._icon = ui.icon('hourglass_empty').props('aria-hidden=true')
            with ui.element('div').classes('text').props('role=status aria-live=polite'):
                self._simulated = marked(ui.label(SIMULATED).classes('error'), 'simulated')
                self._outcome, self._sentence = (
                    marked(ui.label('').classes(name), f'verdict-{name}') for name in ('outcome', 'sentence'))
                self._causes = widgets.Area(marked(ui.element('div'), 'verdict-causes'))
                self._next = marked(ui.label(''), 'verdict-next')
                self._action = marked(ui.label('').classes('action'), 'verdict-action')
                with ui.element('div').classes('progress small') as self._progress:
                    ui.spinner(size='18px').props('aria-hidden=true')
                    self._step = marked(ui.label(''), 'step')
            with ui.element('div').classes('actions'):
                self._preview = button('Preview', on_preview, 'visibility', 'verdict-preview', True,
                                       'Show what it changes (p)')
                self._add = button('Add', on_add, 'add', 'verdict-add', hint='Add to the model (a)')
                self._settle = button('Settle this', on_settle, 'rule', 'verdict-settle', hint='Choose the readings '
                                      'that tell the explanations apart, and save them as a plan')
                self._diagnose = button('Diagnose', on_diagnose, 'search', 'diagnose', strong=True)

    def show(self, opened: OpenedRun) -> None:
        """Show the verdict, or what is known before it."""
        results, step = self._controller.session.results, self._controller.step
        verdict = results.verdict
        self._simulated.set_visibility(opened.run.simulated)
        waits = opened.is_large and not (step or verdict or results.problem)
        if verdict:
            text = verdict_text(verdict)
            level = verdict.level.value
            words = HEADLINES[verdict.outcome], glued(text.sentence), glued(' '.join((*text.limits, text.action)))
        elif results.problem:
            level, words = Level.BAD.value, ('Error', results.problem, '')
        else:
            time = f'about {duration(opened.run.size * SECONDS_PER_READING)}'
            level, words = '', ('Not judged yet',
                                f'The residual is {micro(results.fit.rms)} µm.' if results.fit else '',
                                f'The run has {opened.run.size:,} readings: the diagnosis takes {time} and starts '
                                'on request.' if waits else '')
        self._icon.set_name(ICONS[level])
        self._box.classes(remove=' '.join(Level), add=level)
        for label, shown in zip((self._outcome, self._sentence, self._action), words, strict=True):
            label.set_text(shown)
        self._progress.set_visibility(bool(step))
        if step:
            self._step.set_text(f'step {list(STEPS).index(step) + 1} of {len(STEPS)}: {STEPS[step]} …')
        self._diagnose.set_visibility(waits)
        missing = results.summary.diagnosis.missing if results.summary else ()
        what = 'it' if len(missing) == 1 else f'all {len(missing)}'
        for one, verb in ((self._preview, 'Preview'), (self._add, 'Add')):
            one.set_visibility(bool(missing) and self._controller.session.preview is None)
            one.set_text(f'{verb} {what}')
        self._settle.set_visibility(bool(verdict and verdict.is_open))
        self._next.set_text((self._controller.answer('next') or ('',))[0])
        self._causes.show(self._show_causes, verdict)

    def _show_causes(self, verdict: Verdict | None) -> None:
        if verdict and (verdict.missing or verdict.unnamed):
            widgets.plain_table(causes(verdict), as_cards=True)


class CandidatesPanel:
    """The candidates of the diagnosis and every other effect of the library; each can be previewed and added."""

    def __init__(self, controller: Controller, on_preview: Action, on_add: Action) -> None:
        self._controller, self._on_preview, self._on_add = controller, on_preview, on_add
        self._cards: dict[str, ui.element] = {}
        with card('Effects that may be missing', 'candidates'):
            self._note = marked(ui.label('').classes('soft small'), 'candidates-note')
            self._list = widgets.Area(ui.element('div').classes('list'))
            with ui.expansion('Another effect of the library', value=False).props('dense').classes('small'):
                options = {name: words_of(name) for name in EFFECTS}
                self._other = ui.select(options, label='effect', with_input=True, on_change=self._explain)
                widgets.input_field(self._other, 'other-effect', 'width: 100%')
                with row():
                    for words, icon, action in (('Preview', 'visibility', on_preview), ('Add', 'add', on_add)):
                        button(words, lambda action=action: self._other.value and action(self._other.value, None), icon,
                               f'other-{words.lower()}')
                self._meaning = ui.label('').classes('soft small')  # below: buttons that move are missed

    def _explain(self) -> None:
        effect = MEANINGS.get(self._other.value or '')
        self._meaning.set_text(f'{effect.meaning} Possible origin: {effect.look}' if effect else '')

    def show(self, _: OpenedRun) -> None:
        """Show the candidates."""
        session = self._controller.session
        diagnosis = session.results.summary.diagnosis if session.results.summary else None
        self._list.show(self._fill, diagnosis)
        if diagnosis is None:
            words = 'Searching …' if self._controller.step else 'Not searched yet.'
        else:
            words = '' if diagnosis.missing else 'No effect of the library is missing.'
        self._note.set_text(words)
        for name, one in self._cards.items():
            is_chosen = session.preview is not None and name in session.preview.name.split(' and ')
            one.classes(add='chosen' if is_chosen else '', remove='' if is_chosen else 'chosen')

    def _fill(self, diagnosis: Diagnosis | None) -> None:
        self._cards = {}
        if diagnosis is None:
            return
        run = diagnosis.fit.run
        claimed = {one.name: one for one in reversed(diagnosis.candidates) if one.claimed}
        others = [one for one in diagnosis.candidates if one.name not in claimed][:NEXT_BEST]
        for one in reversed(claimed.values()):
            self._add_card(one, run, OF_CLAIMED,
                           [shape for shape in diagnosis.recovered if shape.claim == one.name])
        for place, shape in enumerate(shape for shape in diagnosis.recovered if not shape.claim):
            with marked(ui.element('article').classes('candidate claimed'), f'shape-{place}'):
                ui.label(f'No name: {shape.words}.').classes('small')
                _draw_shape(shape)
        if others:
            with ui.expansion('The next best').props('dense').classes('small'), \
                    ui.element('div').classes('list'):
                for one in others:
                    self._add_card(one, run, OF_OTHERS)
        if hidden := diagnosis.verdict.hidden:
            ui.label(f'This run could not have shown {titles(hidden)}.').classes('small')

    def _add_card(self, one: MissingEffect, run: Run, columns: tuple[str, ...], shapes: Sequence[Shape] = ()) -> None:
        with marked(ui.element('article').classes('candidate'), f'candidate-{one.name}') as self._cards[one.name]:
            self._cards[one.name].classes('claimed' if one.claimed else '')
            with row():
                widgets.named(one.name)
                with ui.element('span').classes('badge' if one.claimed else 'badge soft'):
                    ui.icon('error' if one.claimed else 'radio_button_unchecked').props('aria-hidden=true')
                    ui.label('missing' if one.claimed else 'not missing')
            if one.name in MEANINGS:
                ui.label(MEANINGS[one.name].meaning).classes('small')
            widgets.fact_list(tables.candidates([one], run).select(*columns))
            for shape in shapes:
                _draw_shape(shape)
            with row():
                button('Preview', lambda: apply(self._on_preview, one), 'visibility', f'preview-{one.name}',
                       hint=f'Show what adding {one.name} would change')
                button('Add', lambda: apply(self._on_add, one), 'add', f'add-{one.name}', strong=one.claimed,
                       hint=f'Add {one.name} to the model')


def _draw_shape(shape: Shape) -> None:
    """Show what was recovered of a shape, with its band, beside the claim."""
    words = f'Course that the readings show against {shape.variable}' + (
        ', and that of the effect found' if shape.claim else '')
    widgets.Figure(shape_height(shape), words, 'shape-figure').draw((shape,), shape_figure, shape)


class CrossCheckPanel:
    """Whether the effects found in this run are found in another one, too."""

    def __init__(self, controller: Controller, on_check: Callable[[int], Awaitable[None]]) -> None:
        self._controller = controller
        with widgets.folded_card('Check on a second run', 'check'):
            self._note = ui.label('').classes('soft small')
            with row():
                self._other = widgets.input_field(ui.select({}, label='second run'), 'check-run', 'min-width: 190px')
                self._start = button('Check', lambda: on_check(self._other.value), 'fact_check', 'check-go')
            self._result = widgets.result_area('check-result')

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result."""
        session = self._controller.session
        others = {place: one.name for place, one in enumerate(session.runs) if one is not opened}
        if others != self._other.options:
            self._other.set_options(others, value=self._other.value if self._other.value in others else
                                    next(iter(others), None))
        claims = session.results.summary is not None and bool(session.results.summary.diagnosis.terms)
        self._start.set_enabled(claims and bool(others))
        self._note.set_text('Open a second run of the same cell first.' if not others else (
            'The effects found in this run are fitted to the second one, which had no part in finding them.' if claims
            else 'No effect is found in this run, so there is nothing to check.'))
        self._result.show(self._fill, *(self._controller.check or ('', None)))

    def _fill(self, name: str, check: CrossCheck | None) -> None:
        if check is not None:
            table = tables.cross_check(check)
            ui.label(f'{name}: {check_words(check)}')
            widgets.plain_table(table.select(*OF_CHECKED), [ICONS[Level(one or Level.GOOD)] for one in table.levels])
            for one in check.effects:
                ui.label(f'{one.name}: {reason_words(one)}')
            ui.label(table.note).classes('soft')
