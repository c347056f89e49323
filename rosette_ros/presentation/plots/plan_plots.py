# SPDX-License-Identifier: Apache-2.0
"""Plans as pictures: what is measured when, uncertainty against the share of the readings, effects side by side."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rosette_ros.core.diagnosis.posterior import Explanation
from rosette_ros.core.model.least_squares import HIDDEN_SHARE
from rosette_ros.core.planning.next_readings import SettlingStep, leading
from rosette_ros.core.planning.plan_comparison import Outlook, Point, best_sets, point_of
from rosette_ros.core.run.records import Ints, Run
from rosette_ros.core.run.scheme import Scheme, cmm_position
from rosette_ros.core.sight.visibility import GOOD_SHARE
from rosette_ros.presentation.formatting import SENSITIVITY, percent
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.words.settling_words import contender_words

SEQUENCE = 'viridis'
MOST_JOINED = 400
"""Readings up to which a line joins them."""
MOST_VECTORS = 1500
"""Marks that are drawn one by one in a vector graphic; more are drawn as an image in it."""
LABEL_LENGTH = 26
MOST_LETTERS = 70
"""Of the names of plans beside each other; longer ones stand upright."""


def pictures_of_plans(plans: Sequence[Outlook]) -> dict[str, Figure]:
    """Return the figures of one plan or of several, by name."""
    made = {'pairs' if len(plans) == 1 else f'pairs_{place}': pairs_in_order(plan.scheme, plan.name)
            for place, plan in enumerate(plans, 1)}
    made['uncertainty'] = uncertainty_by_share(plans[0].scheme.n, list(map(point_of, plans)))
    if all(one.effects for one in plans):
        made['shares'] = shares_of_plans(plans)
    return made


def pairs_in_order(measured: Scheme | Run, name: str = '') -> Figure:
    """Return a figure: when each pair of table position and CMM position, and of table position and ball, is measured.

    Of a pair that is measured twice both times are seen, half a mark each; a ring marks the first reading.
    """
    n, table, ball = measured.n, measured.table_position, measured.ball
    (made, panels), size = style.figure(3.65, 1, 2), table.size
    for panel, column, what in zip(panels[0], (cmm_position(n, table, ball), ball),
                                   ('CMM position', 'ball')):
        _draw_pairs(panel, n, table, column, size)
        panel.set_title(f'{style.label_of(name)}: {size} readings' if name and what == 'CMM position' else '')
        marks = {place: str(place) for place in range(1, n + 1, max(1, n // 12))}
        style.scale(panel, marks, marks, '')
        panel.set_xlabel(what)
        panel.set_ylabel('table position' if what == 'CMM position' else '')
    style.colour_bar(made, panels, 'reading')
    return made


def _draw_pairs(panel: Axes, n: int, table: Ints, column: Ints, size: int) -> None:
    number, cell = np.arange(1, size + 1), table * (n + 1) + column
    again = np.isin(np.arange(size), np.setdiff1d(np.arange(size), np.unique(cell, return_index=True)[1]))
    mark = min(60.0, (1.25 * 72 * 2.2 / n)**2 / 2)
    if size <= MOST_JOINED:
        panel.plot(column, table, color=style.GRID, linewidth=0.7, zorder=1)
    twice = bool(again.any())
    for chosen, shape in ((~again, '<' if twice else 's'), (again, '>')):
        if chosen.any():
            shift = (0.2 if shape == '>' else -0.2) * twice
            panel.scatter(column[chosen] + shift, table[chosen], c=number[chosen], s=mark / (1 + 0.6 * twice),
                          marker=shape, cmap=SEQUENCE, vmin=1, vmax=size, linewidths=0, zorder=2,
                          rasterized=size > MOST_VECTORS)
    panel.scatter(column[:1], table[:1], s=2.2 * mark, marker='o', facecolors='none', edgecolors=style.BEFORE, zorder=3)
    panel.set_xlim(0.3, n + 0.7)
    panel.set_ylim(n + 0.7, 0.3)


def uncertainty_by_share(n: int, points: Sequence[Point]) -> Figure:
    """Return a figure: uncertainty of the curves of n balls relative to a complete run against N / n^2.

    Beside the points the best sets of CMM positions, and the ideal sqrt(n^2 / N).
    """
    made, [[panel]] = style.figure(3.0)
    every, sets = [x for _, x, _ in points], best_sets(n)
    lines = panel.plot(*zip(*sets), color=style.GREY, marker='.', markersize=4, linewidth=1,
                       label=f'best sets of CMM positions, {n} balls') if sets else []
    share = np.linspace(min(0.95 * min(every), 0.22), max(1.05, 1.05 * max(every)), 200)
    lines += panel.plot(share, 1 / np.sqrt(share), color=style.INK, linestyle=style.DASHED, linewidth=1.2,
                        label='ideal: √(n²/N)')
    for place, (name, x, y) in enumerate(points):
        under = sum(abs(x - other) < 0.02 and abs(y - before) < 0.1 for _, other, before in points[:place])
        # a larger, hollow mark is seen around the others
        look = style.look_of(place) | ({'markerfacecolor': 'none', 'markeredgewidth': 1.5} if under else {})
        lines += panel.plot([x], [y], linestyle='none', markersize=6 + 3 * min(under, 3),
                            label=style.label_of(name), zorder=5, **look)
    panel.set_xlim(share[0], share[-1])
    panel.set_ylim(0, 1.08 * max(y for _, y in [*sets, *((x, y) for _, x, y in points)]))
    style.scale(panel, steps=(8, 6))
    panel.set_xlabel('share of the n² pairs that is measured, N/n²')
    panel.set_ylabel('relative uncertainty of the curves')
    style.legend(made, lines, [line.get_label() for line in lines])
    return made


def shares_of_plans(plans: Sequence[Outlook]) -> Figure:
    """Return a figure: the typical sensitivity of several plans to each effect, shades with numbers."""
    names = [one.name for one in plans[0].effects]
    values = np.array([[np.nan if one.reason else one.typical_share for one in plan.effects] for plan in plans]).T
    labels = {place: style.label_of(one.name if len(one.name) <= LABEL_LENGTH else f'{one.name[:LABEL_LENGTH - 1]}…')
              for place, one in enumerate(plans)}
    longest = max(map(len, labels.values()))
    upright = longest * len(plans) > MOST_LETTERS
    made, [[panel]] = style.figure(0.168 * len(names) + 0.46 + (0.075 * longest if upright else 0.2))
    panel.imshow(values, cmap='Blues', vmin=0, vmax=1.15, aspect='auto', interpolation='none')
    for row, line in enumerate(values):
        for place, share in enumerate(line):
            text = 'not judged' if np.isnan(share) else percent(share)
            colour = 'white' if share > 0.75 else style.BEFORE if share < HIDDEN_SHARE else style.INK
            panel.text(place, row, text, ha='center', va='center', color=colour,
                       fontweight='bold' if share < HIDDEN_SHARE else 'normal')
    style.scale(panel, labels, {row: style.label_of(name) for row, name in enumerate(names)}, '')
    panel.xaxis.tick_top()
    panel.xaxis.set_tick_params(labelrotation=90 * upright)
    made.suptitle(f'{SENSITIVITY}; well shown from {percent(GOOD_SHARE)} on', x=0.01, ha='left')
    panel.spines[:].set_visible(False)
    return made


def way_to_the_cause(steps: Sequence[SettlingStep], until: float) -> Figure:
    """Return a figure of the probabilities of the leading explanations, and of U, after the readings of each step.

    until: the probability from which on an explanation is settled, 0 for any."""
    made, [[left, right]] = style.figure(2.6, 1, 2)
    readings = [step.readings for step in steps]
    for place, (names, p) in enumerate(leading(steps).items()):
        words = contender_words(Explanation(names, p[-1]))
        left.plot(readings, p, linewidth=1.0, markersize=3, label=words, **style.look_of(place))
    if until:
        left.axhline(until, color=style.GREY, linewidth=1.0, linestyle=style.DASHED,
                     label=f'settled, {100 * until:g} %')
    left.set(ylim=(0, 1.05), xlabel='readings')
    left.set_title('probability of the explanations')
    expanded = [1e6 * step.uncertainty for step in steps]
    right.plot(readings, expanded, color=style.AFTER, linewidth=1.0, marker='o',
               markersize=3)
    right.set(ylim=(0, 1.05 * max(expanded)), xlabel='readings')
    right.set_title('U of the worst point of the curves / µm')
    for panel in (left, right):
        style.scale(panel)
    style.legend_of(made, [left])
    return made
