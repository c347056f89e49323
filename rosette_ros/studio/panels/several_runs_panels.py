# SPDX-License-Identifier: Apache-2.0
"""What comes of several opened runs: their curves laid over each other, and their result as one."""

from collections.abc import Awaitable, Callable, Sequence

from nicegui import ui

from rosette_ros.core.error_summary import difference
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.records import ErrorMotions
from rosette_ros.presentation.error_results import differences
from rosette_ros.presentation.joint_results import joint_errors, joint_rows, reversal_means, sharing_table
from rosette_ros.presentation.plots.plot_style import COLOURS
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import DASHES, Curves, curves_figure
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.figures_panel import WIDTH
from rosette_ros.studio.panels.widgets import marked, plain_table, set_words
from rosette_ros.studio.studio_session import OpenedRun

Start = Callable[[Sequence[int]], Awaitable[None]]
"""Takes the places of the chosen runs."""


class RunsPanel:
    """Opened runs to choose from, a button, and the result."""

    def __init__(self, controller: Controller, heading: str, mark: str, label: str, words: str, icon: str,
                 on_start: Start) -> None:
        """Build it; label: of the choice; words, icon: of the button."""
        self._controller = controller
        with widgets.folded_card(heading, mark):
            self._note = ui.label('').classes('soft small')
            with widgets.row():
                choice = ui.select({}, label=label, multiple=True)
                self._chosen = widgets.input_field(choice, f'{mark}-runs', 'min-width: 320px')
                self._start = widgets.button(words, lambda: on_start(sorted(choice.value)), icon, f'{mark}-go')
            self._result = widgets.result_area(f'{mark}-result')

    def _offer(self, runs: dict[int, str], is_enough: bool, note: str, missing: str) -> None:
        """Show the runs that can be chosen, by their places; note, missing: words where they are enough, and not."""
        if runs != self._chosen.options:
            self._chosen.set_options(runs, value=list(runs))
        self._start.set_enabled(is_enough)
        set_words(self._note, note if is_enough else missing)


class OverlayPanel(RunsPanel):
    """The curves of other opened runs over those of this run, and what they are less this run's."""

    def __init__(self, controller: Controller, on_lay: Start) -> None:
        """Build it; on_lay(places): evaluate other opened runs under the present model."""
        super().__init__(controller, 'Runs laid over each other', 'overlay', 'other runs', 'Lay over', 'layers', on_lay)

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result where it is of the run and the model that are shown."""
        runs = {place: one.name for place, one in enumerate(self._controller.session.runs) if one is not opened}
        self._offer(runs, bool(runs), 'Their curves under the present model.', 'Open a second run first.')
        self._result.show(_fill_overlay, self._controller.of_present(self._controller.overlaid))


class JointPanel(RunsPanel):
    """Opened runs evaluated as one: curves, reversal, what is shared, what became known."""

    def __init__(self, controller: Controller, on_evaluate: Start) -> None:
        """Build it; on_evaluate(places): evaluate opened runs as one."""
        super().__init__(controller, 'Several runs as one', 'joint', 'runs', 'Evaluate', 'join_full', on_evaluate)

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result."""
        runs = dict(enumerate(one.name for one in self._controller.session.runs))
        self._offer(runs, len(runs) > 1, 'What they share is taken from the runs, and tested.',
                    'Open a second run of the same cell first.')
        self._result.show(_fill_joint, self._controller.joint)


def _fill_overlay(every: dict[str, ErrorMotions] | None) -> None:
    if not every:
        return
    (first, motions), *others = every.items()
    looks = [(COLOURS[place % len(COLOURS)], DASHES[place % len(DASHES)]) for place in range(len(every))]
    _draw('Six error motions of all runs, with U (k = 2)', [
        Curves(name, one, *look) for (name, one), look in zip(every.items(), looks, strict=True)], 'overlay-figure')
    found = {name: less for name, one in others if (less := difference(one, motions)) is not None}
    for name, _ in others:
        if name not in found:
            ui.label(f'{name}: measured at other table angles; no differences.')
    if found:
        _draw(f'Differences: each run less {first}, with U (k = 2) of both', [
            Curves(name, found[name], *look) for (name, _), look in zip(others, looks[1:], strict=True)
            if name in found], 'overlay-differences')
        table = differences(found)
        plain_table(table)
        ui.label(table.note).classes('soft')


def _fill_joint(result: JointResult | None) -> None:
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
        Curves(one.words, motions, COLOURS[place % len(COLOURS)])
        for place, (one, motions) in enumerate(result.curves)])
    for one, means in zip(result.reversals, reversal_means(result), strict=True):
        _draw('Reversal: clockwise less counter-clockwise', [Curves('reversal', one.motions, COLOURS[0])])
        plain_table(means)


def _draw(words: str, curves: Sequence[Curves], mark: str = '') -> None:
    ui.label(words).classes('title')
    widgets.Figure(430, words, mark, WIDTH).draw((words,), curves_figure, curves)
