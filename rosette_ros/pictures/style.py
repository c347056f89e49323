# SPDX-License-Identifier: Apache-2.0
"""How every picture looks: colours that the colour-blind tell apart, quiet axes."""

import math

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from rosette_ros.core.errors import InvalidData

INK, GRID, QUIET = '#222222', '#d9d9d9', '#666666'
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#56b4e9', '#e69f00')
"""Palette of Okabe and Ito (2008), in the order of use."""
BEFORE, AFTER = COLOURS[1], COLOURS[0]
"""Colours of the model as it was given and of the model with all that is claimed."""
MARKERS = ('o', 's', '^', 'D', 'v', 'P')
DIVERGING = 'RdBu_r'
"""Colour map of signed values about zero: red and blue stay apart for the colour-blind."""
DPI = 150
STEPS = 5
LOOK = {'svg.fonttype': 'none', 'font.size': 10, 'path.simplify': False}
"""Text stays text in SVG: it can be searched, copied and read aloud."""
QUIET_AXES = {
    'axes.spines.top': False, 'axes.spines.right': False, 'axes.edgecolor': INK, 'axes.xmargin': 0.02,
    'axes.labelcolor': INK}
SHADES = np.linspace(-1, 1, 101)
BEHIND = {'facecolor': 'white', 'edgecolor': 'none', 'pad': 0.8, 'alpha': 0.85}
"""Behind numbers that stand on lines."""


def figure(width, height, layout='constrained'):
    """Return an empty figure of a size in inches, laid out so that nothing overlaps.

    layout: 'constrained', or None where the places are given by hand, which is quicker.
    """
    made = Figure(figsize=(width, height), layout=layout, facecolor='white')
    FigureCanvasAgg(made)
    return made


def panels(made, rows=1, columns=1, ratios=None):
    """Return quiet axes of a figure, (rows, columns), without numbers: `scale` writes them."""
    with mpl.rc_context(QUIET_AXES):
        grid = made.subplots(rows, columns, squeeze=False, width_ratios=ratios,
                             subplot_kw={'xticks': (), 'yticks': ()})
    return grid


def scale(panel, x=None, y=None, grid='xy', numbers='xy', steps=(STEPS, STEPS)):
    """Draw the grid and the numbers of axes whose limits are set.

    x, y: {place: text}, None for round numbers; grid, numbers: for which of x and y they are drawn;
    steps: most steps along x and y. One line and a few texts take a quarter of the time of as many
    ticks of the library.
    """
    (left, right), (low, high) = panel.get_xlim(), panel.get_ylim()
    x = round_numbers(left, right, steps[0]) if x is None else x
    y = round_numbers(low, high, steps[1]) if y is None else y
    lines = [[place, low, place, high] for place in x] if 'x' in grid else []
    lines += [[left, place, right, place] for place in y] if 'y' in grid else []
    if lines:
        ends = np.pad(np.array(lines, dtype=float).reshape(-1, 2, 2), ((0, 0), (0, 1), (0, 0)),
                      constant_values=np.nan).reshape(-1, 2)
        panel.add_artist(Line2D(*ends.T, color=GRID, linewidth=0.6, zorder=0.5))
    if 'x' in numbers:
        below, _, _ = panel.get_xaxis_text1_transform(4)
        for place, text in x.items():
            panel.text(place, 0, text, transform=below, ha='center', va='top', fontsize=9, color=INK)
    if 'y' in numbers:
        beside, _, _ = panel.get_yaxis_text1_transform(4)
        for place, text in y.items():
            panel.text(0, place, text, transform=beside, ha='right', va='center', fontsize=9, color=INK)
    panel.xaxis.labelpad, panel.yaxis.labelpad = 16, 32


def round_numbers(low, high, steps=STEPS):
    """Return {number: text} of the round numbers from low to high, at most `steps` apart.

    >>> round_numbers(-0.31, 0.42, 4)
    {-0.2: '−0.2', 0.0: '0.0', 0.2: '0.2', 0.4: '0.4'}
    """
    low, high = min(low, high), max(low, high)
    places = MaxNLocator(steps, steps=[1, 2, 5, 10]).tick_values(low, high)
    step = places[1] - places[0]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    inside = [round(float(place), decimals + 2) + 0.0 for place in places
              if low - 1e-9 * step <= place <= high + 1e-9 * step]
    return {place: f'{place:.{decimals}f}'.replace('-', '−') for place in inside}


def colour_bar(axes, limit, label, upright):
    """Draw into axes what the colours from -limit to limit stand for."""
    shades = SHADES[:, None] if upright else SHADES[None, :]
    edges = (0, 1, -limit, limit) if upright else (-limit, limit, 0, 1)
    axes.imshow(shades, cmap=DIVERGING, aspect='auto', extent=edges, origin='lower',
                interpolation='none')
    axes.set(xticks=(), yticks=())
    if upright:
        scale(axes, {}, None, '', 'y', (0, 9))
        axes.set_title(label, y=1.0, pad=4, fontsize=9, color=INK)
    else:
        scale(axes, None, {}, '', 'x')
        axes.set_xlabel(label, fontsize=9, color=INK)


def line(panel, x, y, **look):
    """Draw a line into axes whose limits are set already, and return it; quicker than `plot`."""
    return panel.add_artist(Line2D(x, y, **look))


def band(panel, low, high, label=None):
    """Draw a grey band over the whole width of axes whose limits are set already."""
    (left, right), _ = panel.get_xlim(), panel.get_ylim()
    panel.add_artist(Rectangle((left, low), right - left, high - low, facecolor='#999999', alpha=0.18,
                               linewidth=0, label=label))


def title(panel, text, size=11):
    """Write a title over axes, on the left; its height is fixed, which is quicker than found."""
    panel.set_title(text, loc='left', y=1.0, pad=5, fontsize=size, color=INK)


def label_of(text):
    """Return any text as a label: one line, nothing in it taken as a formula or as hidden."""
    line = ' '.join(''.join(one for one in text if one.isprintable() or one.isspace()).split())
    line = line.replace('\\', '/').replace('$', r'\$')
    return f' {line}' if line.startswith('_') else line


def save(made, path):
    """Write a figure; the ending of `path` says as what (png, svg, pdf)."""
    try:
        with mpl.rc_context(LOOK):
            made.savefig(path, dpi=DPI)
    except OSError as error:
        raise InvalidData(f'{path}: cannot be written: {error.strerror}') from error
