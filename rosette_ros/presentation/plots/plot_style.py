# SPDX-License-Identifier: Apache-2.0
"""How every figure looks: colours that the colour-blind distinguish, axes, grids, labels."""

import io
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import MaxNLocator

from rosette_ros.core.run.records import Floats
from rosette_ros.io.text_file import write_bytes

INK, GRID, GREY = '#222222', '#d9d9d9', '#666666'
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#56b4e9', '#e69f00')
"""Palette of Okabe and Ito (2008), in the order of use."""
BEFORE, AFTER = COLOURS[1], COLOURS[0]
"""Colours of the model as given and of the model with all identified effects."""
MARKERS = ('o', 's', '^', 'D', 'v', 'P')
DASHED = (0, (4, 2))
DIVERGING = 'RdBu_r'
"""Colour map of signed values about zero."""
WIDTH = 7.2
"""Of every figure, inch: that of the text on a page of A4, so that texts are printed in their own size."""
SMALL, TEXT, HEAD = 8, 8.5, 9.5
"""Sizes of texts in points; smaller ones are not readable on paper."""
DPI = 200
STEPS, LEAST_NUMBERS = 5, 3
"""Most steps of an axis with round numbers, and fewest numbers on it: two do not show the scale between them."""
STYLE: dict[Any, Any] = {
    **{key: value for key, value in dict.items(mpl.rcParamsDefault) if key != 'backend'},
    'svg.fonttype': 'none',  # text stays text in SVG: it can be searched, copied and read aloud
    'font.size': SMALL, 'path.simplify': False, 'figure.facecolor': 'white', 'figure.titlesize': SMALL,
    'figure.constrained_layout.use': True, 'figure.constrained_layout.h_pad': 0.03,
    'figure.constrained_layout.w_pad': 0.03, 'text.color': INK, 'hatch.linewidth': 0.5, 'axes.spines.top': False,
    'axes.spines.right': False, 'axes.edgecolor': INK, 'axes.axisbelow': True, 'axes.xmargin': 0.02,
    'axes.labelcolor': INK, 'axes.labelsize': TEXT, 'axes.titlesize': TEXT, 'axes.titlelocation': 'left',
    'axes.titlecolor': INK, 'grid.color': GRID, 'grid.linewidth': 0.6, 'xtick.labelcolor': INK, 'ytick.labelcolor': INK,
    'xtick.major.size': 0, 'ytick.major.size': 0, 'legend.fontsize': TEXT, 'legend.frameon': False}
mpl.rcParams.update(STYLE)
"""A matplotlibrc is for its owner's figures: here a result looks the same on every computer."""
Marks = Mapping[float, str] | Mapping[int, str]
"""Places on an axis and their texts."""
FAINT, DARK = 0.1, 0.6
"""Shares of the largest value: smaller ones have no visible colour, larger ones a dark one."""
BEHIND = {'facecolor': 'white', 'edgecolor': 'none', 'pad': 0.8, 'alpha': 0.85}
"""Background of numbers on lines."""


def figure(height: float, rows: int = 1, columns: int = 1, **look: Any) -> tuple[Figure, Any]:
    """Return a figure of a height in inches, and its axes, an array (rows, columns); look: as of `subplots`."""
    made = Figure(figsize=(WIDTH, height))
    FigureCanvasAgg(made)
    return made, made.subplots(rows, columns, squeeze=False, **look)


def scale(panel: Axes, x: Marks | None = None, y: Marks | None = None, grid: str = 'xy', numbers: str = 'xy',
          steps: tuple[int, int] = (STEPS, STEPS)) -> None:
    """Draw grid and numbers of axes; x, y: {place: text}, None for round numbers with at most `steps` steps,
    or those of the next finer step where fewer than LEAST_NUMBERS would be seen."""
    for name, axis, places, most in (('x', panel.xaxis, x, steps[0]), ('y', panel.yaxis, y, steps[1])):
        if places is None:
            axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10], min_n_ticks=LEAST_NUMBERS))
        else:
            axis.set_ticks(list(places), list(places.values()))
        axis.set_tick_params(label1On=name in numbers)
        axis.grid(name in grid)


def colour_bar(made: Figure, panels: Any, label: str, upright: bool = True) -> Axes:
    """Draw beside or below panels what the colours of the last thing drawn in the last of them stand for."""
    last = np.ravel(panels)[-1]
    colours = next(one for one in (*last.images, *last.collections) if one.get_array() is not None)
    bar = made.colorbar(colours, ax=panels, location='right' if upright else 'bottom', pad=0.02,
                        **({'aspect': 40} if upright else {'aspect': 22, 'shrink': 0.6}))
    bar.outline.set_visible(False)
    axes: Axes = bar.ax
    if upright:
        axes.set_title(label, loc='center', fontsize=SMALL)
    else:
        axes.set_xlabel(label, fontsize=SMALL)
    return axes


def look_of(place: int) -> dict[str, Any]:
    """Return colour and marker of the series at a place, from 0 on."""
    return {'color': COLOURS[place % len(COLOURS)], 'marker': MARKERS[place % len(MARKERS)]}


def legend(made: Figure, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """Write a legend below the panels of a figure, which grows by its lines."""
    columns = next(count for count in range(len(labels), 0, -1) if count == 1 or _legend_width(labels, count) < WIDTH)
    made.set_figheight(made.get_figheight() + 0.19 * -(-len(labels) // columns))
    made.legend(handles, labels, loc='outside lower center', ncols=columns, borderaxespad=0.1, labelspacing=0.3)


def _legend_width(labels: Sequence[str], columns: int) -> float:
    """Return about how wide a legend is, inch; matplotlib fills it column by column."""
    per_column = [len(labels) // columns + (place < len(labels) % columns) for place in range(columns)]
    ends = np.cumsum([0, *per_column])
    return sum(0.55 * TEXT * max(map(len, labels[a:b])) + 36 for a, b in pairwise(ends)) / 72


def legend_of(made: Figure, panels: Iterable[Axes]) -> None:
    """Write a legend of all that has a label in panels, each label once."""
    known = {label: handle for panel in panels for handle, label in zip(*panel.get_legend_handles_labels())}
    legend(made, list(known.values()), list(known))


def mark_negative(panel: Axes, x: Floats, y: Floats, values: Floats, limit: float, length: float) -> None:
    """Draw a bar, as a minus sign, at every place with a negative value that its colour shows: it is seen in grey too.

    limit: of the colours; length: of a bar. Bars on dark colours are white."""
    for low, high, colour in ((FAINT, DARK, INK), (DARK, np.inf, 'white')):
        chosen = (-values > low * limit) & (-values <= high * limit)
        ends = np.stack([x[chosen] - length / 2, y[chosen], x[chosen] + length / 2, y[chosen]], axis=1).reshape(-1, 2)
        panel.add_artist(segments(ends, edgecolor=colour, linewidth=0.9, zorder=5))


def segments(ends: Floats, **look: Any) -> PathPatch:
    """Return lines from the first to the second, the third to the fourth ... of points (2 k, 2), as one path."""
    path = Outline(ends, np.tile([Outline.MOVETO, Outline.LINETO], len(ends) // 2))
    path.should_simplify = False
    return PathPatch(path, fill=False, **look)


def label_of(text: str) -> str:
    """Return any text as a label: one line, nothing in it taken as a formula or as hidden."""
    words = ' '.join(''.join(one for one in text if one.isprintable() or one.isspace()).split())
    words = words.replace('\\', '/').replace('$', r'\$')
    return f' {words}' if words.startswith('_') else words


def save(made: Figure, path: Path | str, force: bool = False) -> None:
    """Write a figure as `write_bytes` does; the ending of `path` chooses the format (png, svg, pdf)."""
    stream = io.BytesIO()
    made.savefig(stream, dpi=DPI, format=Path(path).suffix[1:])
    write_bytes(path, stream.getvalue(), force)


def save_all(made: Mapping[str, Figure], folder: Path, ending: str, force: bool = False) -> list[Path]:
    """Write figures into a folder, each as its name with an ending; return the paths."""
    paths = [folder / f'{name}.{ending}' for name in made]
    for one, path in zip(made.values(), paths, strict=True):
        save(one, path, force)
    return paths
