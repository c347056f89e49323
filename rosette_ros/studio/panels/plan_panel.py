# SPDX-License-Identifier: Apache-2.0
"""The planner beside a running cell: choose order, places, touches or a time, see what is determined, start it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import background_tasks, ui

from rosette_ros.core.errors import RosetteError, one_line
from rosette_ros.core.planning.plan_comparison import Outlook, best_outlook, outlook_of_order
from rosette_ros.core.scheme import ORDERS
from rosette_ros.core.touches import TOUCHES, Pace
from rosette_ros.presentation.plan_results import comparison
from rosette_ros.studio.controller import Controller, Superseded
from rosette_ros.studio.figures import PlotlyFigure, pairs_figure
from rosette_ros.studio.panels.widgets import (
    Area,
    ErrorLine,
    Figure,
    button,
    card,
    fact_list,
    input_field,
    marked,
    row,
    set_words,
    whole_field,
)

if TYPE_CHECKING:
    from rosette_ros.studio.cell_watcher import CellWatcher

BALLS = range(3, 73)
FACTS = ('readings', 'cmm_positions', 'duration_h', 'rank', 'relative_uncertainty', 'U_ctx_um', 'U_ctz_um',
         'U_crx_urad', 'U_crz_urad')
LONGEST = 120.0
"""Most time that may be taken for a plan, s."""


class PlanPanel:
    """Fields of a plan, what it determines, and its picture; calculated in a process of its own."""

    def __init__(self, controller: Controller, watcher: 'CellWatcher') -> None:
        self._watcher, self._worker = watcher, controller.planner
        self._made: Outlook | None = None
        self._is_building = True
        with card('Plan', 'plan'):
            with row():
                self._order = input_field(ui.select(list(ORDERS), label='order', value='there_and_back',
                                                    on_change=self._change), 'plan-order', 'width: 230px')
                self._balls = whole_field('balls', 12, BALLS, 'plan-balls', self._change, '90px')
            with row():
                self._radius = self._text('radius / mm', '182.5', 'plan-radius', '100px')
                self._places = self._text('CMM positions', '', 'plan-places', '230px')
                self._places.props('stack-label placeholder="all; 6, 50 % or 1,4,6,9"')
            with row():
                touches = {0: 'usual', **{number: str(number) for number in TOUCHES}}
                self._touches = input_field(ui.select(touches, label='touches', value=0, on_change=self._change),
                                            'plan-touches', 'width: 105px')
                self._touch = self._text('touch / s', f'{Pace.touch:g}', 'plan-touch', '90px')
                self._table_move = self._text('table move / s', f'{Pace.table_move:g}', 'plan-table-move', '115px')
            with row():
                self._hours = self._text('time / h', '', 'plan-hours', '90px', calculates=False)
                self._propose = button('Propose a plan', self._on_propose, 'schedule', 'plan-propose',
                                       hint='Order, positions and touches that are best in this time where the frame '
                                            'wanders by 0.1 µm in an hour')
            self._error = ErrorLine('plan-error')
            self._facts = Area(marked(ui.element('div'), 'plan-facts'))
            self._words = marked(ui.label('').classes('small').props('role=status aria-live=polite'), 'plan-words')
            self._start = button('Start this plan', self._on_start, 'play_arrow', 'plan-start', strong=True)
        self._is_building, self._can_start = False, False
        self._start.set_enabled(False)

    def build_picture(self) -> None:
        """Build the card of the picture."""
        with card('Plan: pairs of table position and CMM position in the order of measuring', 'plan-picture'):
            self._picture = Figure(330, 'Pairs of table position and CMM position in the order of measuring')
        self._change()

    def allow_start(self, is_allowed: bool) -> None:
        """Set whether the cell could begin a calibration now."""
        self._can_start = is_allowed
        self._start.set_enabled(is_allowed and self._made is not None)

    def _text(self, label: str, value: str, mark: str, width: str, calculates: bool = True) -> ui.input:
        made = ui.input(label, value=value, on_change=self._change if calculates else None).props('debounce=500')
        return input_field(made, mark, f'width: {width}')

    def _change(self) -> None:
        """Calculate what the fields say; what was calculated before is dropped."""
        if not self._is_building:
            background_tasks.create(self._calculate(self._fields, outlook_of_order))

    async def _calculate(self, fields: Callable[[], tuple[Any, ...]], make: Callable[..., Outlook]) -> None:
        made, words = None, ''
        try:
            made = await self._worker.run(make, *fields(), within=LONGEST)
        except Superseded:
            return
        except RosetteError as error:
            words = one_line(error)
        if self._start.is_deleted:
            return  # the page was closed meanwhile
        self._error.set(words)
        self._made = made
        self.allow_start(self._can_start)
        self._facts.show(_show_facts, made)
        set_words(self._words, _words(made) if made else '')
        if made is not None:
            self._picture.draw((made,), _figure, made)

    def _cell(self) -> tuple[Any, ...]:
        """Return balls, radius and pace."""
        return (_balls(self._balls.value), 1e-3 * _positive(self._radius.value, 'radius'), Pace(
            _positive(self._touch.value, 'touch'), _positive(self._table_move.value, 'table move')))

    def _fields(self) -> tuple[Any, ...]:
        """Return the arguments of outlook_of_order."""
        return (*self._cell(), self._order.value, self._places.value.strip(), self._touches.value)

    async def _on_propose(self) -> None:
        """Set the fields to the plan that is best in the time."""
        def fields() -> tuple[Any, ...]:
            return (*self._cell(), _positive(self._hours.value, 'time'))

        await self._calculate(fields, best_outlook)
        if self._made is not None:
            scheme = self._made.scheme
            used = np.unique(scheme.cmm_position)
            self._is_building = True
            self._order.set_value(scheme.order)
            self._places.set_value(', '.join(map(str, used)) if used.size < scheme.n else str(scheme.n))
            self._touches.set_value(int(scheme.touches[0]))
            self._is_building = False

    def _on_start(self) -> None:
        if self._made is not None:
            scheme, used = self._made.scheme, np.unique(self._made.scheme.cmm_position)
            self._watcher.calibrate(order=scheme.order, balls=scheme.n, radius=self._made.radius, turning='forward',
                                    cmm_positions=', '.join(map(str, used)), touches=int(scheme.touches[0]))


def _balls(value: float | None) -> int:
    """Return the number of balls that a field holds."""
    if value is None or value not in BALLS:
        raise RosetteError(f'balls: wanted a whole number in {BALLS[0]}..{BALLS[-1]}, got {value}')
    return int(value)


def _positive(text: str, name: str) -> float:
    """Return the positive number that a field holds."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e5:
        raise RosetteError(f'{name}: wanted a positive number, got {text!r:.40}')
    return value


def _show_facts(made: Outlook | None) -> None:
    if made is not None:
        fact_list(comparison([made]).select(*FACTS))


def _words(made: Outlook) -> str:
    """Return in sentences what a plan shows and does not."""
    hidden = [name for name in made.judged if name not in made.shown]
    effects = f'Shows {len(made.shown)} of {len(made.judged)} effects well. ' if made.effects else ''
    weak = f'Weakly or not at all: {", ".join(hidden)}. ' if hidden else ''
    return f'{effects}{weak}Unobservable: {"; ".join(made.expectation.unobservable)}.'


def _figure(made: Outlook) -> PlotlyFigure:
    return pairs_figure(made.scheme)
