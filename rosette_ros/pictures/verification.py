# SPDX-License-Identifier: Apache-2.0
"""Runs that must agree: how far each is from their mean."""

import numpy as np

from rosette_ros.core.records import CURVES
from rosette_ros.pictures.curves import ANGLES, LAYOUT, empty_panels
from rosette_ros.pictures.style import COLOURS, MARKERS, label_of, scale


def differences(labels, angle, values, spread, reference=None):
    """Return a figure of six panels: curves of several runs less their mean, µm and µrad.

    labels: of the m runs; angle: (n,) rad; values: (m, n, 6), m and rad, NaN where a run is left out;
    spread: (6,) standard deviation that noise explains, drawn twice as a grey band; reference: (6,) a
    second one, drawn as dashed lines, or None.
    """
    columns = min(len(labels), 3)
    made, grid = empty_panels('', -(-len(labels) // columns))
    degrees = np.append(np.rad2deg(angle), 360 + np.rad2deg(angle[0]))
    for panel, curve in zip(grid, LAYOUT, strict=True):
        which = CURVES.index(curve)
        panel.axhspan(-2e6 * spread[which], 2e6 * spread[which], color='#999999', alpha=0.18, linewidth=0)
        if reference is not None:
            for side in (-1e6, 1e6):
                panel.axhline(side * reference[which], color='#444444', linewidth=1, linestyle=(0, (4, 2)))
        lines = [panel.plot(degrees, 1e6 * np.append(one[:, which], one[0, which]), linewidth=1.4,
                            color=COLOURS[place % len(COLOURS)], markersize=4,
                            marker=MARKERS[place % len(MARKERS)])[0]
                 for place, one in enumerate(values)]
        scale(panel, ANGLES, numbers='xy' if panel in grid[-2:] else 'y')
    made.legend(lines, [label_of(label) for label in labels], loc='lower center', ncols=columns,
                frameon=False, fontsize=10)
    return made
