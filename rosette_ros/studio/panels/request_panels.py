# SPDX-License-Identifier: Apache-2.0
"""What is calculated on request: budget, orders for the next run, touches, way to the cause, several runs."""

from collections.abc import Awaitable, Callable, Sequence

from nicegui import ui

from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.planning.advice import Advice
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.uncertainty.error_summary import difference
from rosette_ros.core.uncertainty.stated_environment import CLASSES
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.presentation.budget_results import contributions, hidden_table, stated_inputs
from rosette_ros.presentation.error_results import differences
from rosette_ros.presentation.joint_results import joint_errors, joint_rows, reversal_means, sharing_table
from rosette_ros.presentation.plots.comparison_plots import budget_bars
from rosette_ros.presentation.plots.plot_style import COLOURS
from rosette_ros.presentation.tables import orders
from rosette_ros.studio.calculations import ShownTouches
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import DASHES, Curves, curves_figure
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.figures_panel import WIDTH
from rosette_ros.studio.panels.widgets import button, input_field, marked, plain_table, row
from rosette_ros.studio.studio_session import OpenedRun
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.budget_words import not_considered
from rosette_ros.words.joint_words import note_words
from rosette_ros.words.result_words import conclusion_text

Start = Callable[[Sequence[int]], Awaitable[None]]
"""Takes the places of the chosen runs."""


class BudgetPanel:
    """What contributes how much to U of each curve; calculated on request."""

    def __init__(self, controller: Controller, on_make: Callable[[], Awaitable[None]]) -> None:
        """Build it; on_make(): calculate the budget."""
        self._controller = controller
        with widgets.folded_card('Uncertainty budget (GUM)', 'budget'):
            ui.label('What the readings do not tell (form of balls, thermal coefficients, alignment, radius, '
                     'environment) is stated by the button "Identity, inputs" above.').classes('soft small')
            with row():
                button('Calculate', on_make, 'stacked_bar_chart', 'budget-go')
            self._result = widgets.result_area('budget-result')

    def show(self, opened: OpenedRun) -> None:
        """Show the budget, where it is of the run and the model that are shown."""
        self._result.show(_fill_budget, self._controller.answer('budget'))


class OrdersPanel:
    """What each order would show in the next run and, in an environment, U that it would give; on request."""

    def __init__(self, controller: Controller, on_compare: Callable[[str], Awaitable[None]]) -> None:
        """Build it; on_compare(environment): compare the orders."""
        self._controller = controller
        with widgets.folded_card('Orders for the next run', 'orders'):
            with row():
                offered = {'': 'none stated', **{name: name for name in CLASSES}}
                environment = input_field(ui.select(offered, label='environment', value=''), 'orders-environment',
                                          'width: 160px')
                button('Compare', lambda: on_compare(environment.value), 'route', 'orders-go')
            self._result = widgets.result_area('orders-result')

    def show(self, opened: OpenedRun) -> None:
        """Show the comparison, where it is of the run that is shown."""
        self._result.show(_fill_orders, self._controller.answer('orders'))


class TouchPanel:
    """The touches in the log of the run that is shown; read on request."""

    def __init__(self, controller: Controller, on_read: Callable[[], Awaitable[None]]) -> None:
        """Build it; on_read(): read and fit the touches."""
        self._controller = controller
        with widgets.folded_card('Touches', 'touches'):
            button('Fit the spheres', on_read, 'sports_baseball', 'touches-go')
            self._result = widgets.result_area('touches-result')

    def show(self, opened: OpenedRun) -> None:
        """Show what was found, where it is of the run that is shown."""
        self._result.show(_fill_touches, self._controller.answer('touches'))


class WayPanel:
    """How a run that was measured until it is known came to its cause; calculated on request."""

    def __init__(self, controller: Controller, on_show: Callable[[], Awaitable[None]]) -> None:
        """Build it; on_show(): judge the run after each block."""
        self._controller = controller
        with widgets.card('Way to the cause', 'way') as self._card:
            button('Judge after each block', on_show, 'timeline', 'way-go')
            self._result = widgets.result_area('way-result')

    def show(self, opened: OpenedRun) -> None:
        """Show the way of a run to which readings were added, where it is of the run and the model that are shown."""
        self._card.set_visibility(opened.source is not None and len(opened.source.asked) > 1)
        self._result.show(_fill_way, self._controller.answer('way'))


class RunsPanel:
    """Opened runs to choose from, a button, and the result; label: of the choice; words, icon: of the button."""

    heading = mark = label = words = icon = ''

    def __init__(self, controller: Controller, on_start: Start) -> None:
        """Build it; on_start(places): evaluate opened runs."""
        self._controller, mark = controller, self.mark
        with widgets.folded_card(self.heading, mark):
            self._note = ui.label('').classes('soft small')
            with row():
                choice = ui.select({}, label=self.label, multiple=True)
                self._chosen = input_field(choice, f'{mark}-runs', 'min-width: 320px')
                self._start = button(self.words, lambda: on_start(sorted(choice.value)), self.icon, f'{mark}-go')
            self._result = widgets.result_area(f'{mark}-result')

    def _offer(self, runs: dict[int, str], is_enough: bool, note: str, missing: str) -> None:
        """Show the runs that can be chosen, by their places; note, missing: words where they are enough, and not."""
        if runs != self._chosen.options:
            self._chosen.set_options(runs, value=list(runs))
        self._start.set_enabled(is_enough)
        self._note.set_text(note if is_enough else missing)


class OverlayPanel(RunsPanel):
    """The curves of other opened runs over those of this run, and what they are less this run's."""

    heading, mark, label, words, icon = 'Runs laid over each other', 'overlay', 'other runs', 'Lay over', 'layers'

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result where it is of the run and the model that are shown."""
        runs = {place: one.name for place, one in enumerate(self._controller.session.runs) if one is not opened}
        self._offer(runs, bool(runs), 'Their curves as modelled now.', 'Open a second run first.')
        self._result.show(_fill_overlay, self._controller.answer('overlay'))


class JointPanel(RunsPanel):
    """Opened runs evaluated as one: curves, reversal, what is shared, what became known."""

    heading, mark, label, words, icon = 'Several runs as one', 'joint', 'runs', 'Evaluate', 'join_full'

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result."""
        runs = dict(enumerate(one.name for one in self._controller.session.runs))
        self._offer(runs, len(runs) > 1, 'What they share is taken from the runs, and tested.',
                    'Open a second run of the same cell first.')
        self._result.show(_fill_joint, self._controller.answer('joint'))


def _fill_orders(advice: Advice | None) -> None:
    if advice is not None:
        ui.label(advice_words(advice))
        table = orders(advice)
        plain_table(table.select(*(one.key for one in table.columns if not one.key.startswith('visible_fraction'))))


def _fill_budget(made: Budget | None) -> None:
    if made is None:
        return
    table = contributions(made)
    plain_table(table)
    ui.label(table.note).classes('soft')
    widgets.Figure(0, 'Standard uncertainty of each curve by contribution', 'budget-figure').draw(
        (made,), budget_bars, made)
    if hidden := hidden_table(made):
        ui.label(hidden.title).classes('title')
        plain_table(hidden)
    plain_table(stated_inputs(made))
    ui.label('Not considered').classes('title')
    for sentence in not_considered(made):
        ui.label(sentence)


def _fill_touches(shown: ShownTouches | None) -> None:
    if shown is None:
        return
    for words in shown.missing:
        ui.label(words)
    with ui.element('div').classes('facts'):
        for name, words in shown.rows:
            ui.label(name).classes('soft')
            ui.label(words)
    for words, drawn in shown.pictures.items():
        widgets.picture(drawn, words)
        ui.label(words).classes('soft')
    for table in shown.tables:
        plain_table(table)
        ui.label(table.note).classes('soft')


def _fill_way(drawn: str | None) -> None:
    if drawn:
        widgets.picture(drawn, 'Probability of the leading explanations, and U, against readings', 'way-figure')


def _fill_overlay(every: dict[str, ErrorMotions] | None) -> None:
    if not every:
        return
    (first, motions), *others = every.items()
    looks = [(COLOURS[place % len(COLOURS)], DASHES[place % len(DASHES)]) for place in range(len(every))]
    _draw_curves('Six error motions of all runs, with U (k = 2)', [
        Curves(name, one, *look) for (name, one), look in zip(every.items(), looks, strict=True)], 'overlay-figure')
    found = {name: less for name, one in others if (less := difference(one, motions)) is not None}
    for name, _ in others:
        if name not in found:
            ui.label(f'{name}: measured at other table angles; no differences.')
    if found:
        _draw_curves(f'Differences: each run less {first}, with U (k = 2) of both', [
            Curves(name, found[name], *look) for (name, _), look in zip(others, looks[1:], strict=True)
            if name in found], 'overlay-differences')
        table = differences(found)
        plain_table(table)
        ui.label(table.note).classes('soft')


def _fill_joint(result: JointResult | None) -> None:
    if result is None:
        return
    verdict = conclusion_text(conclude(result))
    marked(ui.label(verdict.sentence).classes('title'), 'joint-verdict')
    ui.label(verdict.action)
    for name, words in joint_rows(result):
        ui.label(f'{name}: {words}.')
    for note in result.notes:
        ui.label(note_words(note)).classes('soft')
    plain_table(sharing_table(result))
    for table in joint_errors(result):
        ui.label(table.title).classes('title')
        plain_table(table)
        ui.label(table.note).classes('soft')
    _draw_curves('Six error motions of all runs, with U (k = 2)', [
        Curves(one.words, motions, COLOURS[place % len(COLOURS)])
        for place, (one, motions) in enumerate(result.curves)])
    for one, means in zip(result.reversals, reversal_means(result), strict=True):
        _draw_curves('Reversal: counter-clockwise less clockwise', [Curves('reversal', one.motions, COLOURS[0])])
        plain_table(means)


def _draw_curves(words: str, curves: Sequence[Curves], mark: str = '') -> None:
    ui.label(words).classes('title')
    widgets.Figure(430, words, mark, WIDTH).draw((words,), curves_figure, curves)
