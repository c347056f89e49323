# SPDX-License-Identifier: Apache-2.0
"""Polar plots of radial and tilt motion after ISO 230-7: deviation outwards over the table angle, reference circle."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rosette_ros.core.error_summary import AxisError, error_lines, once_per_turn
from rosette_ros.core.records import CURVES, ErrorMotions, Floats
from rosette_ros.presentation.formatting import COVERAGE_FACTOR, CURVE_UNITS, fixed, iso_name
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.presentation.plots.result_plots import MEANING, scale_arrow

SHOWN = ('ctx', 'cty', 'crx', 'cry')
BASE = 1.0
"""Radius of the circle of no deviation; the largest deviation is drawn as LARGEST of it."""
LARGEST = 0.55
TURN = np.linspace(0, 2 * np.pi, 361)


def polar_motions(motions: ErrorMotions) -> Figure:
    """Return a figure of four polar plots, µm and µrad.

    The reference circle is the least-squares one: its offset from the centre is the once-per-turn part of the error,
    the distance of the curve from it the rest."""
    made, handles = style.figure(2.3), list[Any]()
    lines = {line.curve: line for line in error_lines(motions)}
    for place, curve in enumerate(SHOWN):
        panel = made.add_axes((0.005 + 0.25 * place, 0.12, 0.24, 0.8))
        handles = _panel(panel, 1e6 * motions[curve], COVERAGE_FACTOR * 1e6 * motions.uncertainty(curve), motions.angle,
                         CURVE_UNITS[CURVES.index(curve)], lines[curve])
        style.title(panel, f'{curve} ({iso_name(curve, motions.rotation)}), {MEANING[curve]}', fontsize=style.TEXT)
    style.legend(made, handles, ['measured', f'U (k = {COVERAGE_FACTOR})', 'no deviation',
                                 'reference circle (least squares)'])
    return made


def _panel(panel: Axes, values: Floats, expanded: Floats, angle: Floats, unit: str, line: AxisError) -> list[Any]:
    """Draw one curve (n,) with its U; return the handles of the legend."""
    top = float(np.max(np.abs(values) + expanded)) or 1.0
    per_unit = LARGEST * BASE / top
    theta = np.append(angle, angle[0] + 2 * np.pi)
    radius, spread = (per_unit * np.append(one, one[0]) for one in (values, expanded))
    grey: dict[str, Any] = {'color': style.GRID, 'linewidth': 0.6, 'zorder': 0}
    for degrees in range(0, 360, 60):
        x, y = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        panel.plot([0, 1.62 * x], [0, 1.62 * y], **grey)
        panel.text(1.74 * x, 1.74 * y, f'{degrees}°', ha='center', va='center', fontsize=style.SMALL, color=style.GREY)
    base, = panel.plot(BASE * np.cos(TURN), BASE * np.sin(TURN), color=style.GREY, linewidth=0.9)
    edge = np.concatenate([BASE + radius + spread, (BASE + radius - spread)[::-1]])
    around = np.concatenate([theta, theta[::-1]])
    band, = panel.fill(edge * np.cos(around), edge * np.sin(around), color=style.AFTER, alpha=0.2, linewidth=0)
    curve, = panel.plot((BASE + radius) * np.cos(theta), (BASE + radius) * np.sin(theta), color=style.AFTER,
                        linewidth=1.3, marker='o', markersize=3)
    once = once_per_turn(values, angle)
    mean = BASE + per_unit * float(np.mean(values))
    circle, = panel.plot(per_unit * once.real + mean * np.cos(TURN), per_unit * once.imag + mean * np.sin(TURN),
                         color=style.BEFORE, linewidth=1.1, linestyle=style.DASHED)
    length = scale_arrow(top)
    panel.plot([-1.8, -1.8 + per_unit * length], [-2.05, -2.05], color=style.INK, linewidth=1.4, marker='|')
    words = f'range {fixed(1e6 * line.range, 2)}, residual {fixed(1e6 * line.residual, 2)} {unit}'
    for x, y, text in ((-1.65 + per_unit * length, -2.05, f'{length:g} {unit}'), (-1.9, -2.42, words)):
        panel.text(x, y, text, ha='left', va='center', fontsize=style.SMALL, color=style.INK)
    panel.set(xlim=(-2.15, 2.15), ylim=(-2.55, 1.9), aspect='equal')
    panel.axis('off')
    return [curve, band, base, circle]
