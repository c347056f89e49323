# SPDX-License-Identifier: Apache-2.0
"""Deviations of plate and CMM as arrows where they stand: x and y as drawn, z as colour."""

import numpy as np

from rosette_ros.core.geometry import nominal_angles
from rosette_ros.pictures.style import DIVERGING, GRID, INK, QUIET, colour_bar, figure
from rosette_ros.pictures.style import title as write_title

LONGEST = 0.33
"""Length of the longest arrow in radii of the circle of balls."""
MOST_NUMBERS = 24
STEPS = (1.0, 2.0, 5.0)


def deviations(plate, cmm, radius):
    """Return a figure of two panels: deviations of the plate's balls and of the CMM's positions.

    plate, cmm: (n, 3), m; radius: m. Each panel has a scale of its own, shown by an arrow in µm.
    """
    made = figure(10, 5.3, None)
    parts = (('Ball plate: where each ball lies beside its nominal place', 'ball', plate),
             ('CMM: what it shows beside the truth, by position', 'position', cmm))
    for place, (title, what, values) in enumerate(parts):
        panel = made.add_axes((0.01 + 0.5 * place, 0.13, 0.46, 0.78), xticks=(), yticks=())
        _panel(panel, title, 1e6 * values, 1e3 * radius)
        bar = made.add_axes((0.1 + 0.5 * place, 0.095, 0.28, 0.025), xticks=(), yticks=())
        _bar(bar, 1e6 * values[:, 2], what)
    return made


def scale_arrow(longest):
    """Return a round length of about half the longest arrow, same unit: 1, 2 or 5 times 10^k.

    >>> scale_arrow(37.0), scale_arrow(0.9)
    (20.0, 0.5)
    """
    if not longest > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(longest))
    steps = [step * factor * power for factor in (0.1, 1.0) for step in STEPS]
    return float(f'{max(step for step in steps if step <= 0.6 * longest):.3g}')


def _panel(panel, title, values, radius):
    n = len(values)
    beta = nominal_angles(n)
    x, y = radius * np.cos(beta), radius * np.sin(beta)
    longest = float(np.hypot(values[:, 0], values[:, 1]).max())
    per_um = LONGEST * radius / longest if longest > 0 else 1.0
    turn = np.linspace(0, 2 * np.pi, 181)
    panel.plot(radius * np.cos(turn), radius * np.sin(turn), color=GRID, linewidth=1)
    panel.plot([-0.04 * radius, 0.04 * radius, np.nan, 0, 0],
               [0, 0, np.nan, -0.04 * radius, 0.04 * radius], color=QUIET, linewidth=0.8)
    limit = max(float(np.abs(values[:, 2]).max()), 1e-9)
    panel.scatter(x, y, c=values[:, 2], cmap=DIVERGING, vmin=-limit, vmax=limit, s=70,
                  edgecolors=INK, linewidths=0.6, zorder=3)
    arrows = {'angles': 'xy', 'scale_units': 'xy', 'color': INK, 'width': 0.0055, 'zorder': 4}
    panel.quiver(x, y, values[:, 0], values[:, 1], scale=1 / per_um, **arrows)
    every = -(-n // MOST_NUMBERS)
    for number in range(0, n, every):
        panel.text(0.8 * x[number], 0.8 * y[number], str(number + 1), ha='center', va='center',
                   fontsize=9, color=QUIET, zorder=2)
    length = scale_arrow(longest)
    edge = 1.5 * radius
    panel.quiver([-0.5 * length * per_um], [-1.46 * radius], [length], [0], scale=1 / per_um, **arrows)
    panel.text(0, -1.41 * radius, f'{length:g} µm', ha='center', va='bottom', fontsize=10,
               color=INK)
    _axes_cross(panel, radius)
    panel.set(xlim=(-edge, edge), ylim=(-1.53 * radius, 1.4 * radius), aspect='equal')
    write_title(panel, title)
    panel.axis('off')


def _axes_cross(panel, radius):
    """Draw where x and y point."""
    x, y, length = -1.4 * radius, -1.4 * radius, 0.28 * radius
    panel.quiver([x, x], [y, y], [length, 0], [0, length], angles='xy', scale_units='xy', scale=1,
                 color=QUIET, width=0.004)
    panel.text(x + 1.15 * length, y, 'x', ha='left', va='center', fontsize=9, color=QUIET)
    panel.text(x, y + 1.15 * length, 'y', ha='center', va='bottom', fontsize=9, color=QUIET)


def _bar(axes, values, what):
    colour_bar(axes, max(float(np.abs(values).max()), 1e-9), f'z of each {what}, µm', False)
