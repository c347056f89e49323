# SPDX-License-Identifier: Apache-2.0
"""Opened runs laid over each other: their curves with U under the same model, and differences with theirs."""

from collections.abc import Awaitable, Callable, Sequence

from nicegui import ui

from rosette_ros.core.error_summary import difference
from rosette_ros.core.records import ErrorMotions
from rosette_ros.presentation.error_results import differences
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


class OverlayPanel:
    """The opened runs to choose from, their curves, and what they are less this run's."""

    def __init__(self, controller: Controller, on_lay: Callable[[Sequence[int]], Awaitable[None]]) -> None:
        """Build it; on_lay(places): evaluate other opened runs under the present model."""
        self._controller = controller
        with folded_card('Runs laid over each other', 'overlay'):
            self._note = ui.label('').classes('soft small')
            with row():
                self._chosen = input_field(ui.select({}, label='other runs', multiple=True), 'overlay-runs',
                                           'min-width: 320px')
                self._start = button('Lay over', lambda: on_lay(sorted(self._chosen.value)), 'layers', 'overlay-go')
            result = ui.element('div').classes('list small').props('role=status aria-live=polite')
            self._result = Area(marked(result, 'overlay-result'))

    def show(self, opened: OpenedRun) -> None:
        """Show the runs that can be chosen, and the result where it is of the run and the model that are shown."""
        runs = {place: one.name for place, one in enumerate(self._controller.session.runs) if one is not opened}
        if runs != self._chosen.options:
            self._chosen.set_options(runs, value=list(runs))
        self._start.set_enabled(bool(runs))
        set_words(self._note, 'Their curves under the present model.' if runs else 'Open a second run first.')
        self._result.show(_fill, self._controller.of_present(self._controller.overlaid))


def _fill(every: dict[str, ErrorMotions] | None) -> None:
    if not every:
        return
    (first, motions), *others = every.items()
    looks = [(COLOURS[place % len(COLOURS)], figures.DASHES[place % len(figures.DASHES)])
             for place in range(len(every))]
    _draw('Six error motions of all runs, with U (k = 2)', 'overlay-figure', [
        figures.Curves(name, one, *look) for (name, one), look in zip(every.items(), looks, strict=True)])
    found = {name: less for name, one in others if (less := difference(one, motions)) is not None}
    for name, _ in others:
        if name not in found:
            ui.label(f'{name}: measured at other table angles; no differences.')
    if found:
        _draw(f'Differences: each run less {first}, with U (k = 2) of both', 'overlay-differences', [
            figures.Curves(name, found[name], *look) for (name, _), look in zip(others, looks[1:], strict=True)
            if name in found])
        table = differences(found)
        plain_table(table)
        ui.label(table.note).classes('soft')


def _draw(words: str, mark: str, curves: Sequence[figures.Curves]) -> None:
    ui.label(words).classes('title')
    Figure(430, words, mark, WIDTH).draw((words,), figures.curves_figure, curves)
