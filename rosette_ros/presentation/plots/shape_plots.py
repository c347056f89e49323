# SPDX-License-Identifier: Apache-2.0
"""Recovered shapes: what a free form makes of the residual, with its band, beside what is claimed."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rosette_ros.core.diagnosis.recovered_shape import Shape, strongest
from rosette_ros.presentation.formatting import COVERAGE_FACTOR
from rosette_ros.presentation.plots import plot_style as style

MOST_CURVES, ROW = 3, 1.9
UNITS = {'s': ('min', 1 / 60), 'rad': ('°', 180 / np.pi), 'K': ('K', 1.0)}
"""Shown unit of a variable, and the factor to it."""


def shapes(every: Sequence[Shape]) -> Figure:
    """Return a figure: a row for each shape, the curves that stand out most, µm, with the band of U (k = 2)."""
    made, panels = style.figure(ROW * len(every) + 0.25, len(every), MOST_CURVES)
    for row, shape in zip(panels, every, strict=True):
        unit, factor = UNITS.get(shape.unit, (shape.unit, 1.0))
        shown = strongest(shape, MOST_CURVES)
        for place, panel in enumerate(row):
            if place >= len(shown):
                panel.set_visible(False)
                continue
            curve = shown[place]
            x, y, spread = factor * shape.values, 1e6 * curve.value, 1e6 * COVERAGE_FACTOR * curve.u
            panel.fill_between(x, y - spread, y + spread, color=style.AFTER, alpha=0.2, linewidth=0,
                               label=f'U (k = {COVERAGE_FACTOR})')
            panel.plot(x, y, color=style.AFTER, linewidth=1.8, label='recovered', marker='o' if x.size < 40 else '',
                       markersize=3)
            if curve.claimed is not None:
                panel.plot(x, 1e6 * curve.claimed, color=style.BEFORE, linewidth=1.6, linestyle=style.DASHED,
                           label='claimed')
            style.scale(panel)
            panel.set(xlabel=f'{shape.variable} / {unit}', ylabel=f'{curve.axis} / µm')
            if curve.carrier:
                panel.annotate(style.label_of(f'× {curve.carrier}'), (1, 1.02), xycoords='axes fraction', ha='right',
                               va='bottom', fontsize=style.TEXT, color=style.GREY)
        row[0].set_title(style.label_of(shape.claim or f'no name: {shape.words}'), pad=16)
    style.legend_of(made, panels.flat)
    return made
