# SPDX-License-Identifier: Apache-2.0
"""Bars to compare: residuals of nested models, of candidates, sensitivity to effects, parts of the uncertainty."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rosette_ros.analysis import LadderStep
from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.model.least_squares import HIDDEN_SHARE
from rosette_ros.core.run.records import Floats
from rosette_ros.core.sight.visibility import Visibility
from rosette_ros.core.uncertainty.budget_monte_carlo import MonteCarlo
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.presentation.tables import nested_names
from rosette_ros.words.effect_words import decimals, fixed

BAR = 0.34
ROW = 0.165
"""Height of a row of one line, inch."""
HIDDEN_LOOK: dict[str, Any] = {'facecolor': 'white', 'edgecolor': style.BEFORE}
WORDS = 0.5
"""Length of the words beside a bar, in shares."""
LONGEST_NAME = 28
"""Characters of a name beside its bar; the rest is cut."""
LOOKS: dict[str, dict[str, Any]] = {'A': {'facecolor': style.COLOURS[0], 'edgecolor': style.COLOURS[0]},
         'B': {'facecolor': style.COLOURS[5], 'edgecolor': style.INK, 'hatch': '/////', 'linewidth': 0.6},
         'bound': {'facecolor': 'white', 'edgecolor': style.INK, 'linewidth': 0.8},
         'combined': {'facecolor': style.INK, 'edgecolor': style.INK}}
LABELS = {'A': 'type A: by statistics', 'B': 'type B: other knowledge', 'bound': 'bound of hidden effects',
          'combined': 'combined u'}
LABEL_LENGTH = 34
LEAST = 0.005
"""Share of the longest bar below which none is drawn."""


def ladder(steps: Sequence[LadderStep], repeatability: float | None = None, dof: float | None = None) -> Figure:
    """Return a figure: residuals of nested models by fit and cross-validation, µm; repeatability: m, band by dof."""
    rows = np.arange(len(steps))
    made, [[panel]] = style.figure(0.45 * len(steps) + 0.5)
    fitted = np.array([1e6 * step.fit.rms for step in steps])
    validated = np.array([1e6 * step.cross_validation for step in steps])
    for sizes, offset, colour, hatch, label in ((fitted, -BAR / 2, style.AFTER, '', 'residual of the fit'),
                                                (validated, BAR / 2, style.COLOURS[4], '////', text.CROSS_VALIDATION)):
        panel.barh(rows + offset, sizes, BAR, color=colour, label=label, hatch=hatch, edgecolor='white', linewidth=0)
        for row, size in zip(rows, sizes, strict=True):
            panel.annotate(f'{size:.3f}', (size, row + offset), (4, 0), textcoords='offset points', va='center',
                           bbox=style.BEHIND)
    known = 1e6 * (repeatability or 0.0)
    if repeatability is not None:
        spread = 2 * known / np.sqrt(2 * dof) if dof else 0.0
        panel.axvspan(known - spread, known + spread, color=style.INK, alpha=0.13, linewidth=0)
        panel.axvline(known, color=style.INK, linewidth=1.6, linestyle=style.DASHED,
                      label=f'repeatability, {known:.3f} µm')
    panel.set_xlim(0, 1.13 * max(*fitted, *validated, known, 1e-9))
    _name_rows(panel, nested_names(steps), 'residual of a coordinate in µm (rms)', None, len(steps))
    style.legend_of(made, [panel])
    return made


def candidates(every: Sequence[MissingEffect], noise: float | None = None) -> Figure:
    """Return a figure: how each candidate lowers the residual, µm; noise: standard deviation, m."""
    rows = np.arange(len(every))
    before = np.array([1e6 * one.before for one in every])
    after = np.array([1e6 * one.after for one in every])
    made, [[panel]] = style.figure(0.24 * len(every) + 0.5)
    panel.hlines(rows, np.minimum(before, after), np.maximum(before, after), color='#bbbbbb', linewidth=3)
    panel.plot(before, rows, linestyle='none', marker='o', markersize=6, color=style.BEFORE,
               markerfacecolor='white', markeredgewidth=1.6, label='without it')
    for chosen, marker, label in ((True, 'o', 'with it: identified'), (False, 'd', 'with it: not identified')):
        mask = np.array([one.claimed == chosen for one in every])
        if mask.any():
            panel.plot(after[mask], rows[mask], linestyle='none', marker=marker, markersize=6,
                       color=style.AFTER if chosen else style.GREY, label=label)
    if noise is not None:
        panel.axvline(1e6 * noise, color=style.INK, linewidth=1.4, linestyle=style.DASHED, label='repeatability')
    _name_rows(panel, [one.name for one in every], 'residual of a coordinate in µm (rms)', None, len(every))
    style.legend_of(made, [panel])
    return made


def visibility(every: Sequence[Visibility], best: Sequence[Visibility] = (),
               labels: tuple[str, str] = ('this order', 'recommended order')) -> Figure:
    """Return a figure: the typical sensitivity of an order to every effect, beside the recommended one."""
    rows = -(-len(every) // 2)
    height = ROW * rows + 0.5
    made, panels = style.figure(height, 1, 2)
    recommended = {one.name: one.typical_share for one in best if not one.reason}
    for panel, part in zip(panels[0], (every[:rows], every[rows:]), strict=True):
        shown = [np.nan if one.reason else one.typical_share for one in part]
        wanted = np.array([recommended.get(one.name, np.nan) for one in part])
        _bars_of_shares(panel, part, np.nan_to_num(shown), wanted)
        if best:
            panel.plot(wanted, range(len(part)), linestyle='none', marker='D', markersize=4.5, color=style.INK,
                       markerfacecolor='white', markeredgewidth=1.3)
        panel.set_xlim(0, 1.02)
        marks = {share / 100: f'{share} %' for share in range(0, 101, 25)}
        _name_rows(panel, [one.name for one in part], text.SENSITIVITY, marks, rows)
    looks = [(Patch(color=style.AFTER), labels[0]),
             (Patch(**HIDDEN_LOOK), f'hidden (nowhere above {text.percent(HIDDEN_SHARE)})')]
    if best:
        looks.append((panel.lines[0], labels[1]))
    style.legend(made, [look for look, _ in looks], [style.label_of(label) for _, label in looks])
    return made


def _bars_of_shares(panel: Axes, every: Sequence[Visibility], shares: Floats, marks: Floats) -> None:
    """Draw bars, and words where there are none to see, to the right of a mark that would be in them."""
    rows = np.arange(shares.size)
    hidden = np.array([bool(one.reason) or one.hidden for one in every])
    panel.barh(rows[~hidden], shares[~hidden], 0.62, color=style.AFTER)
    panel.barh(rows[hidden], shares[hidden], 0.62, **HIDDEN_LOOK)
    for row in rows[hidden]:
        label, colour = ('not judged', style.GREY) if every[row].reason else ('hidden', style.BEFORE)
        start = float(marks[row] if marks[row] < shares[row] + WORDS else shares[row])
        panel.annotate(label, (start, row), (5, 0), textcoords='offset points', va='center', color=colour)


def _name_rows(panel: Axes, names: Sequence[str], label: str, marks: style.Marks | None, rows: int) -> None:
    cut = [f'{name[:LONGEST_NAME - 1]}…' if len(name) > LONGEST_NAME else name for name in names]
    panel.set_ylim(rows - 0.4, -0.6)
    style.scale(panel, marks, {row: style.label_of(name) for row, name in enumerate(cut)}, 'x', steps=(8, 8))
    panel.set_xlabel(label)


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
                digits, gap = decimals(float(values[row, place])), 0.05 if found and kind == 'combined' else 0.02
                panel.text(values[row, place] + gap * top, row, fixed(values[row, place], digits), va='center')
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
