# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget of the run under the model: contributions in a table and as bars, what is not considered."""

from collections.abc import Awaitable, Callable

from nicegui import ui

from rosette_ros.core.uncertainty_budget import Budget
from rosette_ros.presentation.budget_results import contributions, stated_inputs
from rosette_ros.studio import figures
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.figures_panel import WIDTH
from rosette_ros.studio.panels.widgets import Figure, button, folded_card, input_field, plain_table, result_area, row
from rosette_ros.studio.studio_session import OpenedRun


class BudgetPanel:
    """What contributes how much to U of each curve; calculated on request."""

    def __init__(self, controller: Controller, on_make: Callable[[str], Awaitable[None]]) -> None:
        """Build it; on_make(path): calculate the budget, path: of a file of inputs, '' for none."""
        self._controller = controller
        with folded_card('Uncertainty budget (GUM)', 'budget'):
            ui.label('What the readings do not tell (form of balls, thermal coefficients, alignment, radius) comes '
                     'from a file of inputs, as of rosette budget --inputs.').classes('soft small')
            with row():
                path = input_field(ui.input('file of inputs (YAML), optional'), 'budget-inputs', 'min-width: 320px')
                button('Calculate', lambda: on_make((path.value or '').strip()), 'stacked_bar_chart', 'budget-go')
            self._result = result_area('budget-result')

    def show(self, opened: OpenedRun) -> None:
        """Show the budget, where it is of the run and the model that are shown."""
        self._result.show(_fill, self._controller.of_present(self._controller.budget))


def _fill(made: Budget | None) -> None:
    if made is None:
        return
    table = contributions(made)
    plain_table(table)
    ui.label(table.note).classes('soft')
    Figure(figures.budget_height(made), 'Standard uncertainty of each curve by contribution', 'budget-figure',
           WIDTH).draw((made,), figures.budget_figure, made)
    plain_table(stated_inputs(made))
    ui.label('Not considered').classes('title')
    for sentence in made.open:
        ui.label(sentence)
