# SPDX-License-Identifier: Apache-2.0
"""What several runs say of their cell: causes against runs."""

import math

from matplotlib.figure import Figure

from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation.cell_results import CausesOfRuns
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.words.effect_words import decimals, fixed

ROW, SIZED_ROW = 0.34, 0.5
"""Height of a cause, and of one with sizes below its dots, inch."""
AREA = 190.0
"""Of the dot of a certain cause, points squared."""
MOST_SIZES, MOST_NUMBERS = 6, 20
"""Runs up to which the size is written below each dot, and up to which each has its number."""
COLOURS = 'cividis'


def causes_against_runs(found: CausesOfRuns) -> Figure:
    """Return a figure: a dot for each cause in each run, its area the probability, its colour the size, µm rms; open
    where the run has no size of it. Runs are numbered as they are given."""
    is_sized = len(found.runs) <= MOST_SIZES
    made, [[panel]] = style.figure((SIZED_ROW if is_sized else ROW) * len(found.causes) + 0.9)
    named = [one for one in found.dots if one.size is not None]
    others = [one for one in found.dots if one.size is None]
    panel.scatter([one.run + 1 for one in others], [one.cause for one in others], s=[
        AREA * one.probability for one in others], facecolors='white', edgecolors=style.GREY, linewidths=1.2, zorder=3)
    if named:
        panel.scatter([one.run + 1 for one in named], [one.cause for one in named], s=[
            AREA * one.probability for one in named], c=[1e6 * (one.size or 0.0) for one in named], cmap=COLOURS,
            edgecolors=style.INK, linewidths=0.6, zorder=4)
        style.colour_bar(made, panel, 'µm rms')
    for one in named if is_sized else ():
        panel.annotate(_size(1e6 * (one.size or 0.0), 1e6 * COVERAGE_FACTOR * one.u), (one.run + 1, one.cause), (0, -9),
                       textcoords='offset points', ha='center', va='top', fontsize=style.SMALL, bbox=style.BEHIND)
    step = math.ceil(len(found.runs) / MOST_NUMBERS)
    style.scale(panel, {place: str(place) for place in range(1, len(found.runs) + 1, step)},
                {place: style.label_of(name) for place, name in enumerate(found.causes)})
    panel.set_xlim(0.5, len(found.runs) + 0.5)
    panel.set_ylim(len(found.causes) - 0.4, -0.5)
    panel.set_xlabel('run')
    return made


def _size(size: float, spread: float) -> str:
    places = decimals(spread, 1)
    return f'{fixed(size, places)} ± {fixed(spread, places)}'
