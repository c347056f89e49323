# SPDX-License-Identifier: Apache-2.0
"""Several opened runs evaluated as one: curves, reversal, what is shared, what became known."""

from collections.abc import Awaitable, Callable, Sequence

from nicegui import ui

from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.presentation.joint_results import joint_errors, joint_rows, reversal_means, sharing_table
from rosette_ros.presentation.plots.plot_style import COLOURS
from rosette_ros.studio import figures
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.widgets import (
    Area,
    Figure,
    button,
    folded_card,
    input_field,
    marked,
    plain_table,
    row,
    set_words,
)
from rosette_ros.studio.studio_session import OpenedRun

WIDTH = 720
"""Least width of figures with three panels side by side, px."""


class JointPanel:
    """The opened runs to choose from, and their result as one."""

    def __init__(self, controller: Controller, on_evaluate: Callable[[Sequence[int]], Awaitable[None]]) -> None:
        """Build it; on_evaluate(places): evaluate opened runs as one."""
        self._controller = controller
        with folded_card('Several runs as one', 'joint'):
            self._note = ui.label('').classes('soft small')
            with row():
                self._chosen = input_field(ui.select({}, label='runs', multiple=True), 'joint-runs', 'min-width: 320px')
                self._start = button('Evaluate', lambda: on_evaluate(sorted(self._chosen.value)), 'join_full',
                                     'joint-go')
            result = ui.element('div').classes('list small').props('role=status aria-live=polite')
            self._result = Area(marked(result, 'joint-result'))

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result."""
        runs = dict(enumerate(one.name for one in self._controller.session.runs))
        if runs != self._chosen.options:
            self._chosen.set_options(runs, value=list(runs))
        self._start.set_enabled(len(runs) > 1)
        set_words(self._note, 'What they share is taken from the runs, and tested.' if len(runs) > 1 else
                  'Open a second run of the same cell first.')
        self._result.show(_fill, self._controller.joint)


def _fill(result: JointResult | None) -> None:
    if result is None:
        return
    verdict = conclude(result)
    marked(ui.label(verdict.sentence).classes('title'), 'joint-verdict')
    ui.label(verdict.action)
    for name, words in joint_rows(result):
        ui.label(f'{name}: {words}.')
    for note in result.notes:
        ui.label(note).classes('soft')
    plain_table(sharing_table(result))
    for table in joint_errors(result):
        ui.label(table.title).classes('title')
        plain_table(table)
        ui.label(table.note).classes('soft')
    _draw('Six error motions of all runs, with U (k = 2)', [
        figures.Curves(one.words, motions, COLOURS[place % len(COLOURS)])
        for place, (one, motions) in enumerate(result.curves)])
    for one, means in zip(result.reversals, reversal_means(result), strict=True):
        _draw('Reversal: clockwise less counter-clockwise', [figures.Curves('reversal', one.motions, COLOURS[0])])
        plain_table(means)


def _draw(words: str, curves: Sequence[figures.Curves]) -> None:
    ui.label(words).classes('title')
    Figure(430, words, least=WIDTH).draw((words,), figures.curves_figure, curves)
