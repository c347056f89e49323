# SPDX-License-Identifier: Apache-2.0
"""The path of the tip around a ball, seen from above and from the side."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from rosette_ros.core.records import Bools, Floats
from rosette_ros.presentation.plots import plot_style as style

_VIEWS = ((0, 1, 'seen against the axis'), (0, 2, 'seen from the side'))


def probe_path(points: Floats, is_touch: Bools, radius: float, shaft: tuple[float, float],
               neighbours: Floats) -> Figure:
    """Return a figure of tip centres (N, 3), which begin and end in the clearance plane.

    All lengths in mm, coordinates from the centre of the ball, z along the axis. is_touch: (N,); radius: of the ball;
    shaft: its radius and length; neighbours: (m, 3) centres of the balls beside it."""
    made = style.figure(3.8)
    made.subplots_adjust(left=0.08, right=0.99, bottom=0.12, top=0.92, wspace=0.2)
    reach = 1.15 * np.abs(points[:, :2]).max()
    for panel, (across, up, words) in zip(style.panels(made, 1, 2)[0], _VIEWS):
        for place, centre in enumerate((np.zeros(3), *neighbours)):
            at = centre[across], centre[up]
            look: dict[str, Any] = {'facecolor': 'none' if place else style.GRID,
                                    'edgecolor': style.GREY, 'linewidth': 0.6}
            if up == 2:
                panel.add_patch(Rectangle((at[0] - shaft[0], at[1] - shaft[1]), 2 * shaft[0], shaft[1], **look))
            panel.add_patch(Circle(at, radius, **look))
        panel.plot(points[:, across], points[:, up], color=style.AFTER, linewidth=0.8, label='way of the tip')
        panel.plot(*points[is_touch][:, [across, up]].T, linestyle='none', markersize=3.5, marker='o',
                   color=style.BEFORE, label='touches')
        low, high = (-reach, reach) if up == 1 else (-shaft[1], 1.05 * points[:, 2].max())
        panel.set_xlim(-reach, reach)
        panel.set_ylim(low, high)
        panel.set_aspect('equal')
        style.scale(panel)
        panel.set_xlabel('x / mm')
        panel.set_ylabel(f'{"xyz"[up]} / mm')
        style.title(panel, words, fontsize=style.TEXT)
    style.legend(made, *panel.get_legend_handles_labels())
    return made
