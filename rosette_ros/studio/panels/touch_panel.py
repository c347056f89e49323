# SPDX-License-Identifier: Apache-2.0
"""What single touches show: spheres fitted again, form of each ball, lobing of the probe; the figures of the report."""

from collections.abc import Awaitable, Callable

from nicegui import ui

from rosette_ros.studio.controller import Controller, ShownTouches
from rosette_ros.studio.panels.widgets import button, folded_card, plain_table, result_area
from rosette_ros.studio.studio_session import OpenedRun


class TouchPanel:
    """The touches in the log of the run that is shown; read on request."""

    def __init__(self, controller: Controller, on_read: Callable[[], Awaitable[None]]) -> None:
        """Build it; on_read(): read and fit the touches."""
        self._controller = controller
        with folded_card('Touches', 'touches'):
            button('Fit the spheres', on_read, 'sports_baseball', 'touches-go')
            self._result = result_area('touches-result')

    def show(self, opened: OpenedRun) -> None:
        """Show what was found, where it is of the run that is shown."""
        kept = self._controller.touches
        self._result.show(_fill, kept[1] if kept and kept[0] is opened else None)


def _fill(shown: ShownTouches | None) -> None:
    if shown is None:
        return
    for words in shown.missing:
        ui.label(words)
    with ui.element('div').classes('facts'):
        for name, words in shown.rows:
            ui.label(name).classes('soft')
            ui.label(words)
    for words, drawn in shown.pictures.items():
        with ui.element('div').classes('scroll'):
            ui.html(drawn, sanitize=False).classes('paper').props(f'role=img aria-label="{words}"')
        ui.label(words).classes('soft')
    for table in shown.tables:
        plain_table(table)
        ui.label(table.note).classes('soft')
