# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget as bars: what each influence contributes to each of the six curves."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rosette_ros.core.budget_monte_carlo import MonteCarlo
from rosette_ros.core.uncertainty_budget import Budget
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.plots import plot_style as style

LOOKS: dict[str, dict[str, Any]] = {'A': {'facecolor': style.COLOURS[0], 'edgecolor': style.COLOURS[0]},
         'B': {'facecolor': style.COLOURS[5], 'edgecolor': style.INK, 'hatch': '/////', 'linewidth': 0.6},
         'bound': {'facecolor': 'white', 'edgecolor': style.INK, 'linewidth': 0.8},
         'combined': {'facecolor': style.INK, 'edgecolor': style.INK}}
LABELS = {'A': 'type A: by statistics', 'B': 'type B: other knowledge', 'bound': 'bound of hidden effects',
          'combined': 'combined u'}
LABEL_LENGTH = 34
LEAST = 0.005
"""Share of the longest bar below which none is drawn."""


def budget_bars(made: Budget, found: MonteCarlo | None = None) -> Figure:
    """Return a figure: standard uncertainties by contribution, a panel for each curve; found: Monte Carlo as marks."""
    lines = made.contributions
    names = [*(style.label_of(one.name[:LABEL_LENGTH]) for one in lines), 'combined']
    kinds = [*('bound' if one.is_bound else one.kind for one in lines), 'combined']
    factors, units = text.curve_factors(), text.curve_units()
    values = factors * np.vstack([*(one.mean for one in lines), made.mean])
    rows, height = len(names), 2 * (0.155 * len(names) + 0.52)
    figure, panels = style.figure(height, 2, 3)
    curves = text.curve_names(made.fit.run.rotation)
    for place, panel in enumerate(panels.flat):
        top = float(values[:, place].max()) or 1.0
        for row, kind in enumerate(kinds):
            if values[row, place] >= LEAST * top:
                panel.barh(row, values[row, place], height=0.72, **LOOKS[kind])
                digits, gap = text.decimals(float(values[row, place])), 0.05 if found and kind == 'combined' else 0.02
                panel.text(values[row, place] + gap * top, row, text.fixed(values[row, place], digits), va='center')
        if found:
            panel.plot([factors[place] * found.agreements[place].found], [rows - 1], marker='D', markersize=4.5,
                       markerfacecolor='white', markeredgecolor=style.BEFORE, linestyle='none', zorder=6)
        panel.set_xlim(0, 1.4 * top)
        panel.set_ylim(rows - 0.4, -0.6)
        style.scale(panel, None, {row: names[row] for row in range(rows)}, 'x', 'xy' if place % 3 == 0 else 'x', (3, 3))
        panel.set_title(f'{curves[place]} / {units[place]}')
        panel.axhline(rows - 1.5, color=style.GREY, linewidth=0.7)
    shown = [kind for kind in LOOKS if kind in kinds]
    handles: list[object] = [Patch(**LOOKS[kind]) for kind in shown]
    labels = [LABELS[kind] for kind in shown]
    if found:
        handles += [panels.flat[0].lines[0]]
        labels += [f'Monte Carlo{" without bounds" * ("bound" in kinds)}, {found.trials} trials']
    style.legend(figure, handles, labels)
    return figure
