# SPDX-License-Identifier: Apache-2.0
"""What every panel is made of: buttons, cards and figures, with their names for keyboard and screen reader."""

from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any, TypeVar

from matplotlib.figure import Figure as Picture
from nicegui import background_tasks, run, ui
from nicegui.events import ClickEventArguments, GenericEventArguments, Handler

from rosette_ros.presentation.formatting import glued
from rosette_ros.presentation.report.page_parts import inline_svgs
from rosette_ros.presentation.table_format import Table
from rosette_ros.studio.figures import PlotlyFigure
from rosette_ros.words.effect_words import plain_name

CLICKED = '(event) => emit([event.points[0].curveNumber, event.points[0].pointNumber])'
"""What the browser sends of a click into a figure."""
Element = TypeVar('Element', bound=ui.element)
DRAWING = Lock()
"""Settings of matplotlib are those of the whole process."""


def button(words: str, action: Handler[ClickEventArguments], icon: str | None = None, mark: str = '',
           strong: bool = False, hint: str = '') -> ui.button:
    """Return a button; mark: its name for tests; strong: the one that is meant to be pressed next."""
    made = ui.button(words, on_click=action, icon=icon, color=None)
    made.props(f'no-caps dense {"unelevated" if strong else "flat"} padding="4px 10px"')
    made.classes('strong' if strong else 'plain')
    if hint:
        made.props(f'title="{hint}"' if words else f'title="{hint}" aria-label="{hint}"')
    return marked(made, mark)


def marked(element: Element, mark: str) -> Element:
    """Return the element with a name for tests."""
    return element.props(f'data-testid={mark}') if mark else element


def row() -> ui.element:
    """Return a row of elements."""
    return ui.element('div').classes('row')


def folded_card(heading: str, mark: str) -> ui.expansion:
    """Return a card that shows its content on request."""
    with card('', mark):
        return ui.expansion(heading, value=False).props('dense')


def card(heading: str = '', mark: str = '') -> ui.element:
    """Return a card with a heading."""
    made = ui.element('section').classes('card')
    if heading:
        made.props(f'aria-label="{heading}"')
        with made:
            ui.html(heading, sanitize=False, tag='h2')
    return marked(made, mark)


def input_field(element: Element, mark: str, style: str = '') -> Element:
    """Return an input or a choice as all panels show it."""
    return marked(element.props('dense outlined options-dense').style(style), mark)


def whole_field(words: str, value: int | None, known: range, mark: str) -> ui.number:
    """Return a field for a whole number; what is no such number is refused by `validate`."""
    made = ui.number(words, value=value, validation={
        f'expected a whole number from {known[0]} to {known[-1]}': lambda given: given is None or given in known})
    return input_field(made.props('hide-bottom-space debounce=400'), mark, 'width: 150px')


def picture(drawn: str, words: str, mark: str = '') -> None:
    """Show a figure of the report, SVG; words: for a screen reader."""
    marked(ui.html(drawn, sanitize=False), mark).classes('paper').props(f'role=img aria-label="{words}"')


class ErrorLine:
    """Words of an error with an icon; not there while there is no error."""

    def __init__(self, mark: str) -> None:
        with ui.element('div').classes('error').props('role=alert') as self._box:
            ui.icon('error').props('aria-hidden=true')
            self._label = marked(ui.label(''), mark)
        self.set('')

    def set(self, words: str) -> None:
        """Show the words of an error, or none."""
        self._label.set_text(words)
        self._box.set_visibility(bool(words))


class Area:
    """A part of a panel that is built again only where what it shows has changed."""

    def __init__(self, element: ui.element) -> None:
        self._element, self._shown = element, object()

    def show(self, build: Callable[..., object], *what: object) -> None:
        """Build it with build(*what) unless that was shown last."""
        if what != self._shown:
            self._shown = what
            self._element.clear()
            with self._element:
                build(*what)


def result_area(mark: str) -> Area:
    """Return the area of a result, which a screen reader tells when it changes."""
    return Area(marked(ui.element('div').classes('list small').props('role=status aria-live=polite'), mark))


def named(name: str) -> None:
    """Show an effect in words, and its identifier."""
    plain = plain_name(name)
    with ui.element('span').classes('name'):
        ui.label(f'{plain[:1].upper()}{plain[1:]}' or name)
        if plain:
            ui.label(name).classes('soft small')


def fact_list(table: Table) -> None:
    """Show the first row of a table, each column as a line; empty cells are left out."""
    with ui.element('div').classes('facts'):
        for column, text in zip(table.shown, table.rows[0], strict=True):
            if text:
                ui.label(column.head)
                ui.label(glued(text))


def plain_table(table: Table, icons: Sequence[str] = (), levels: Sequence[str] = (), as_cards: bool = False) -> None:
    """Show a table; icons: one in front of each row; levels: their colours; as_cards: a row is a card on a telephone.
    """
    looks = 'plain-table as-cards' if as_cards else 'plain-table'
    with ui.element('div').classes('scroll').props('tabindex=0'), \
            ui.element('table').classes(looks).props(f'aria-label="{table.title}"'):
        rows = [('th', [column.head for column in table.shown]), *(('td', row) for row in table.rows),
                *(('th', row) for row in table.footer)]
        for place, (tag, row) in enumerate(rows):
            with ui.element('tr').classes('' if tag == 'td' else 'heads'):
                if icons:
                    with ui.element('td'):
                        ui.icon(icons[place - 1] if tag == 'td' else '').props('aria-hidden=true').classes(
                            f'state {levels[place - 1]}' if levels and tag == 'td' else '')
                for column, text in zip(table.shown, row, strict=True):
                    with ui.element(tag).classes('number' if column.number else '') as cell:
                        if as_cards and tag == 'td':
                            cell.props(f'data-head="{column.head}"')
                        ui.label(glued(text))


def _content_of(make: Callable[..., object], arguments: tuple[object, ...], name: str) -> object:
    """Return what make(*arguments) draws: Plotly's figure, or one of the report as SVG whose ids begin with a name."""
    with DRAWING:
        made = make(*arguments)
        return str(inline_svgs({name: made})[name]) if isinstance(made, Picture) else made


class Figure:
    """A Plotly figure, or one of the report, drawn in the background and only where it changes; the browser gets none
    before there is something to draw.

    words: for a screen reader; least: width below which it is scrolled, so that its texts do not overlap, px.
    """

    def __init__(self, height: int, words: str, mark: str = '', least: int = 0) -> None:
        self._place = ui.element('div').classes('scroll').props('tabindex=0' if least else '')
        self._place.style(f'min-height: {height}px')
        self._style, self._words = f'width: 100%; min-width: {least}px; height: {height}px', words
        self._mark = mark
        self._plot: ui.plotly | None = None
        self._clicked: Callable[[GenericEventArguments], object] | None = None
        self._key: tuple[object, ...] = ()

    def draw(self, key: tuple[object, ...], make: Callable[..., PlotlyFigure | Picture], *arguments: object) -> None:
        """Draw make(*arguments) unless `key` was drawn last; returns at once, and draws the last of several."""
        if key != self._key:
            self._key = key
            background_tasks.create_lazy(self._draw(make, arguments), name=f'figure {id(self)}')

    def on_click(self, chosen: Callable[[int, list[int]], object]) -> None:
        """Await chosen(number of the trace, indices of the point in it) where a point is clicked; before `draw`."""
        def clicked(event: GenericEventArguments) -> object:
            trace, point = event.args
            return chosen(int(trace), [int(one) for one in (point if isinstance(point, list) else [point])])
        self._clicked = clicked

    async def _draw(self, make: Callable[..., PlotlyFigure | Picture], arguments: tuple[object, ...]) -> None:
        content: Any = await run.io_bound(_content_of, make, arguments, f'figure{id(self)}')
        if content is None or self._place.is_deleted:  # the server, or the page, ends
            return
        if isinstance(content, str):
            self._place.clear()
            with self._place:
                picture(content, self._words, self._mark)
            return
        if self._plot is not None:
            self._plot.update_figure(content)
            return
        with self._place:
            self._plot = marked(ui.plotly(content), self._mark).style(self._style)
        self._plot.props(f'role=img aria-label="{self._words}"')
        if self._clicked is not None:
            self._plot.on('plotly_click', self._clicked, js_handler=CLICKED)
