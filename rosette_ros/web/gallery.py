# SPDX-License-Identifier: Apache-2.0
"""Draws the pictures of a page one after the other, so that numbers are there before them.

A picture that is asked for again before it was drawn is drawn once, as it was asked for last.
"""

import asyncio

from nicegui import background_tasks, run, ui

PAUSE = 0.02
"""Between two pictures the browser is left alone for so long, s."""


class Gallery:
    """The pictures of one page; `draw` returns at once."""

    def __init__(self):
        """Start with bare walls."""
        self._shown = {}
        self._wanted = {}
        self._task = None

    def picture(self, height, words):
        """Return a Plotly picture, empty as yet; words: what a screen reader says of it."""
        made = ui.plotly({'data': [], 'layout': {}, 'config': {}})
        return made.style(f'width: 100%; height: {height}px').props(f'role=img aria-label="{words}"')

    def draw(self, picture, key, make, *arguments):
        """Draw make(*arguments), a figure, unless the picture shows the very things of `key` already."""
        shown = self._shown.get(picture, ())
        if len(shown) == len(key) and all(a is b for a, b in zip(shown, key)):
            return
        self._shown[picture] = key
        self._wanted[picture] = (make, arguments)
        if self._task is None or self._task.done():
            self._task = background_tasks.create(self._draw_all())

    async def _draw_all(self):
        while self._wanted:
            await asyncio.sleep(PAUSE)
            picture = next(iter(self._wanted))
            make, arguments = self._wanted.pop(picture)
            figure = await run.io_bound(make, *arguments)
            if picture not in self._wanted and not picture.is_deleted:
                picture.update_figure(figure)
