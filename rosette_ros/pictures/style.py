# SPDX-License-Identifier: Apache-2.0
"""How every picture looks: colours that the colour-blind tell apart, quiet axes."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

INK, GRID = '#222222', '#d9d9d9'
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#56b4e9', '#e69f00')
"""Palette of Okabe and Ito (2008), in the order of use."""
MARKERS = ('o', 's', '^', 'D', 'v', 'P')
DPI = 150


def figure(width, height):
    """Return an empty figure of a size in inches, laid out so that nothing overlaps."""
    made = Figure(figsize=(width, height), layout='constrained', facecolor='white')
    FigureCanvasAgg(made)
    return made


def quieten(axes):
    """Give axes the house look."""
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)
    for side in ('left', 'bottom'):
        axes.spines[side].set_color(INK)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, labelsize=9)
    axes.margins(x=0.02)
