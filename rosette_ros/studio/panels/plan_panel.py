# SPDX-License-Identifier: Apache-2.0
"""The planner beside a running cell: choose a plan, see what it determines, compare it with others, start it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import background_tasks, ui
from nicegui.events import UploadEventArguments

from rosette_ros.core.errors import RosetteError, one_line
from rosette_ros.core.planning.plan_comparison import Outlook, best_outlook, better, outlook_of_order, point_of
from rosette_ros.core.scheme import ORDERS
from rosette_ros.core.touches import TOUCHES, Pace
from rosette_ros.io.plan_file import MOST_BYTES, MeasuringPlan, format_plan
from rosette_ros.presentation.plan_results import comparison
from rosette_ros.studio.calculations import outlook_of_file
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.figures import pairs_figure, uncertainty_figure
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.open_dialog import safe_name
from rosette_ros.studio.panels.widgets import Area, Figure, button, card, input_field, marked, row
from rosette_ros.studio.worker import Superseded

if TYPE_CHECKING:
    from rosette_ros.studio.cell_watcher import CellWatcher

BALLS = range(3, 73)
FACTS = ('plan', 'readings', 'cmm_positions', 'duration_h', 'rank', 'relative_uncertainty', 'U_ctx_um', 'U_ctz_um',
         'U_crx_urad', 'U_crz_urad')
MOST_KEPT = 5
LONGEST = 120.0
"""Most time that may be taken for a plan, s."""
CALCULATING = 'Calculating …'


class PlanPanel:
    """Fields of a plan, what it determines, its picture, and plans that were kept beside it.

    What a plan determines is calculated in a process of its own.
    """

    def __init__(self, controller: Controller, watcher: 'CellWatcher') -> None:
        self._watcher, self._worker = watcher, controller.planner
        self._made: Outlook | None = None
        self._kept: list[Outlook] = []
        self._is_file = False
        self._is_building = True
        with card('Plan', 'plan'):
            with row():
                self._order = input_field(ui.select(list(ORDERS), label='order', value='there_and_back',
                                                    on_change=self._change), 'plan-order', 'width: 230px')
                self._balls = widgets.whole_field('balls', 12, BALLS, 'plan-balls', self._change, '90px')
            with row():
                self._radius = self._text('radius / mm', '182.5', 'plan-radius', '100px')
                self._offset = self._text('first angle / °', '0', 'plan-offset', '100px')
            with row():
                self._places, self._in_use = (
                    self._text(words, '', mark, '112px').props('stack-label placeholder="all; 6, 50 %"')
                    for words, mark in (('CMM positions', 'plan-places'), ('balls in use', 'plan-balls-of')))
            with row():
                touches = {0: 'usual', **{number: str(number) for number in TOUCHES}}
                self._touches = input_field(ui.select(touches, label='touches', value=0, on_change=self._change),
                                            'plan-touches', 'width: 105px')
                self._touch = self._text('touch / s', f'{Pace.touch:g}', 'plan-touch', '90px')
                self._table_move = self._text('table move / s', f'{Pace.table_move:g}', 'plan-table-move', '115px')
            with row():
                self._hours = self._text('time / h', '', 'plan-hours', '90px', calculates=False)
                self._drift = self._text('drift / µm', '0.1', 'plan-drift', '90px', calculates=False)
                button('Propose a plan', self._on_propose, 'schedule', 'plan-propose',
                       hint='Order, positions and touches that are best in this time where the frame wanders by this '
                            'drift in an hour')
            self._upload = ui.upload(label='or a plan file', on_upload=self._on_file, auto_upload=True,
                                     on_rejected=self._on_rejected, max_file_size=MOST_BYTES).classes('drop')
            self._upload.style('max-height: 46px; overflow: hidden')
            marked(self._upload.props('flat bordered aria-label="Plan file"'), 'plan-file')
            self._error = widgets.ErrorLine('plan-error')
            self._facts = Area(marked(ui.element('div'), 'plan-facts'))
            self._words = marked(ui.label('').classes('small').props('role=status aria-live=polite'), 'plan-words')
            with row():
                self._start = button('Start this plan', self._on_start, 'play_arrow', 'plan-start', strong=True)
                self._keep = button('Keep to compare', self._on_keep, 'add', 'plan-keep')
        self._is_building, self._can_start = False, False
        self._start.set_enabled(False)

    def build_picture(self) -> None:
        """Build the card of the picture."""
        with card('Plan: pairs of table position and CMM position in the order of measuring', 'plan-picture'):
            self._picture = Figure(330, 'Pairs of table position and CMM position in the order of measuring')
        with card('Plans side by side', 'plan-comparison') as self._comparison:
            self._table = Area(marked(ui.element('div').classes('list small'), 'plan-table'))
            self._shares = Figure(330, 'Uncertainty of the curves against the share of the readings', 'plan-shares')
            button('Forget the plans that were kept', self._on_forget, 'clear', 'plan-forget')
        self._comparison.set_visibility(False)
        self._change()

    def allow_start(self, is_allowed: bool) -> None:
        """Set whether the cell could begin a calibration now."""
        self._can_start = is_allowed
        self._start.set_enabled(is_allowed and self._made is not None)
        self._keep.set_enabled(self._made is not None)

    def _text(self, label: str, value: str, mark: str, width: str, calculates: bool = True) -> ui.input:
        made = ui.input(label, value=value, on_change=self._change if calculates else None).props('debounce=500')
        return input_field(made, mark, f'width: {width}')

    def _change(self) -> None:
        """Calculate what the fields say; what was calculated before is dropped."""
        if not self._is_building:
            self._is_file = False
            self._set(None)
            background_tasks.create(self._calculate(self._fields, outlook_of_order))

    async def _calculate(self, fields: Callable[[], tuple[Any, ...]], make: Callable[..., Outlook]) -> None:
        made, words = None, ''
        self._set(None)
        self._words.set_text(CALCULATING)
        try:
            made = await self._worker.run(make, *fields(), within=LONGEST)
        except Superseded:
            return
        except RosetteError as error:
            words = one_line(error)
        if self._start.is_deleted:
            return  # the page was closed meanwhile
        self._error.set(words)
        self._set(made)
        self._facts.show(_show_facts, made)
        self._words.set_text(_words(made) if made else '')
        if made is not None:
            self._picture.draw((made,), pairs_figure, made.scheme)
            self._compare()

    def _set(self, made: Outlook | None) -> None:
        """Take what the fields say as calculated; None: not yet, so that nothing older is started or kept."""
        self._made = made
        self.allow_start(self._can_start)

    @property
    def _is_new(self) -> bool:
        """Whether the present plan is none of those that were kept."""
        return self._made is not None and _readings(self._made) not in map(_readings, self._kept)

    def _compare(self) -> None:
        """Show the plans that were kept beside the present one."""
        plans = [*self._kept, *([self._made] if self._made and self._is_new else [])]
        self._comparison.set_visibility(bool(self._kept))
        if self._kept:
            self._table.show(_show_comparison, *plans)
            self._shares.draw(tuple(plans), uncertainty_figure, plans[0].scheme.n, list(map(point_of, plans)))

    def _on_keep(self) -> None:
        if self._made is not None and self._is_new:
            self._kept = [*self._kept[1 - MOST_KEPT:], self._made]
            self._compare()

    def _on_forget(self) -> None:
        self._kept = []
        self._compare()

    def _on_rejected(self) -> None:
        self._error.set(f'plan file: wanted at most {MOST_BYTES >> 20} MB')

    async def _on_file(self, event: UploadEventArguments) -> None:
        """Take the readings of a plan file until a field changes."""
        data = await event.file.read()
        self._upload.reset()
        self._is_file = True
        await self._calculate(lambda: (data, safe_name(event.file.name), self._pace()), outlook_of_file)

    def _cell(self) -> tuple[Any, ...]:
        """Return balls, radius and pace."""
        return _balls(self._balls.value), 1e-3 * _positive(self._radius.value, 'radius'), self._pace()

    def _pace(self) -> Pace:
        return Pace(_positive(self._touch.value, 'touch'), _positive(self._table_move.value, 'table move'))

    def _fields(self) -> tuple[Any, ...]:
        """Return the arguments of outlook_of_order."""
        return (*self._cell(), self._order.value, self._places.value.strip(), self._touches.value,
                self._in_use.value.strip(), _positive(self._offset.value, 'first angle', or_zero=True))

    async def _on_propose(self) -> None:
        """Set the fields to the plan that is best in the time."""
        def fields() -> tuple[Any, ...]:
            return (*self._cell(), _positive(self._hours.value, 'time'),
                    1e-6 * _positive(self._drift.value, 'drift', or_zero=True))

        self._is_file = False
        await self._calculate(fields, best_outlook)
        if self._made is not None:
            scheme = self._made.scheme
            used = np.unique(scheme.cmm_position)
            self._is_building = True
            self._order.set_value(scheme.order)
            self._places.set_value(', '.join(map(str, used)) if used.size < scheme.n else str(scheme.n))
            self._in_use.set_value('')
            self._offset.set_value('0')
            self._touches.set_value(int(scheme.touches[0]))
            self._is_building = False

    def _on_start(self) -> None:
        if self._made is None:
            return
        scheme, radius = self._made.scheme, self._made.radius
        if self._is_file:
            self._watcher.calibrate(plan=format_plan(MeasuringPlan(scheme, radius)))
            return
        place, used = ('balls_in_use', scheme.ball) if np.unique(scheme.ball).size < scheme.n else (
            'cmm_positions', scheme.cmm_position)
        self._watcher.calibrate(
            order=scheme.order, balls=scheme.n, radius=radius, turning='forward', touches=int(scheme.touches[0]),
            table_offset=scheme.table_offset, **{place: ', '.join(map(str, np.unique(used)))})


def _readings(made: Outlook) -> tuple[Any, ...]:
    """Return what two plans have in common that are the same: readings in their order, touches, place and pace."""
    scheme = made.scheme
    return (scheme.n, made.radius, made.expectation.duration, *(part.tobytes() for part in (
        scheme.table_position, scheme.ball, scheme.touches, scheme.approach)), scheme.table_offset)


def _balls(value: float | None) -> int:
    """Return the number of balls that a field holds."""
    if value is None or value not in BALLS:
        raise RosetteError(f'balls: wanted a whole number in {BALLS[0]}..{BALLS[-1]}, got {value}')
    return int(value)


def _positive(text: str, name: str, or_zero: bool = False) -> float:
    """Return the positive number that a field holds."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < 1e5 or (value == 0 and not or_zero):
        raise RosetteError(f'{name}: wanted a positive number{" or 0" * or_zero}, got {text!r:.40}')
    return value


def _show_facts(made: Outlook | None) -> None:
    if made is not None:
        widgets.fact_list(comparison([made]).select(*FACTS))


def _show_comparison(*plans: Outlook) -> None:
    widgets.plain_table(comparison(plans))
    for sentence in better(plans):
        ui.label(sentence)


def _words(made: Outlook) -> str:
    """Return in sentences what a plan shows and does not."""
    hidden = [name for name in made.judged if name not in made.shown]
    effects = f'Shows {len(made.shown)} of {len(made.judged)} effects well. ' if made.effects else ''
    weak = f'Weakly or not at all: {", ".join(hidden)}. ' if hidden else ''
    return f'{effects}{weak}Unobservable: {"; ".join(made.expectation.unobservable)}.'
