# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the texts of a figure: cut off, too small, over another text, over the panel beside."""

from itertools import combinations
from unittest import mock

from matplotlib.text import Text
from matplotlib.transforms import Bbox

from rosette_ros.presentation.plots.plot_style import SMALL

APART = 2.0
"""Least distance of texts in a line, pixels of 1/100 inch."""


def texts_of(made):
    """Return (text, box in pixels, size in points) of every text that is drawn."""
    drawn = []
    with mock.patch.object(Text, 'draw', lambda text, _: drawn.append(text)):
        made.draw_without_rendering()
        return [(one.get_text(), one.get_window_extent(), one.get_fontsize()) for one in drawn
                if one.get_visible() and one.get_text().strip()]


def faults(made):
    """Return in words what is wrong, nothing where all can be read."""
    texts = texts_of(made)
    panels = [panel.bbox for panel in made.axes if panel.get_visible() and panel.axison and panel.name != 'polar']
    out = [f'{text}: beyond the figure' for text, box, _ in texts
           if box.x0 < 0 or box.y0 < 0 or box.x1 > made.bbox.x1 or box.y1 > made.bbox.y1]
    out += [f'{text}: {size} points' for text, _, size in texts if size < SMALL]
    out += [f'{text}: over a panel' for text, box, _ in texts for panel in panels
            if _overlap(box, panel) and not panel.contains(*(box.p0 + box.p1) / 2)]
    return out + [f'{one[0]}: over {other[0]}' for one, other in combinations(texts, 2)
                  if _overlap(Bbox.from_extents(one[1].x0 - APART, *one[1].extents[1:]), other[1])]


def _overlap(one, other):
    return min(one.x1, other.x1) > max(one.x0, other.x0) and min(one.y1, other.y1) > max(one.y0, other.y0)
